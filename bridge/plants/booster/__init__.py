"""Plant for Booster's low-level protocol."""
