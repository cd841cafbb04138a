"""Calibration of the IMU, the joint encoders and the foot sensors; no clock and no file access."""
