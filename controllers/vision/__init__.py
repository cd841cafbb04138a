"""Targets in the camera image, and the gaze."""
