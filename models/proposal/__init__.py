"""Proposal of a robot profile from a URDF alone: feet, soles, mirror pairs, frames, drives, standing posture."""
