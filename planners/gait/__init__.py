"""Walking: footsteps, DCM reference, step adjustment, swing feet, and the state machine over them."""
