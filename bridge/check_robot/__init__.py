"""Trials of a robot description."""
