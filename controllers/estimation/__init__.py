"""State estimation from encoders, IMU and foot sensors."""
