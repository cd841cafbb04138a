"""State estimation from encoders, inertial unit and foot sensors alone."""
