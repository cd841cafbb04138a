"""Timing of the tick, its parts, the closed loop, the graph and the sweeps."""
