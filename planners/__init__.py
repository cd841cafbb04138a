"""Planners: motions, whole-body inverse kinematics, footsteps, terrain."""
