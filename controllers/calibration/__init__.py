"""Calibration of the IMU, the joint encoders and the foot sensors: laws without clock and files."""
