"""Physical constants."""

GRAVITY = 9.81
"""Magnitude of free fall [m/s^2]: that of Pinocchio's models, and so of the plant."""
