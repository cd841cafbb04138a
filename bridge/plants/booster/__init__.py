"""Booster's low-level protocol as a plant."""
