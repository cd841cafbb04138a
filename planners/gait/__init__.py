"""Walking: footsteps, DCM reference, step adjustment, swing feet and the state machine of the gait."""
