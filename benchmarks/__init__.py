"""Latency and stability, against peers and against the physical limit."""
