"""``poise teleop``: words and velocities from keyboard or gamepad."""
