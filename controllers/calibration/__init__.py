"""Calibration of the inertial unit, the joint encoders and the foot sensors: laws without clock and files."""
