"""From a URDF alone to the profile of a robot: feet, soles, mirror pairs, frames, drives, a standing posture."""
