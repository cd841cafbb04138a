"""``poise teleop``: keyboard or gamepad to words and velocities."""
