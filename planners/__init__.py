"""Laws that look ahead: motions, whole-body inverse kinematics, footsteps."""
