"""Plant for Unitree's low-level protocol of humanoids."""
