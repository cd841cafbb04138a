"""Unitree's low-level protocol of humanoids as a plant."""
