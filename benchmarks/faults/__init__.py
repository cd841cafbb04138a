"""Faults of sensors, motors, users, world, processes and topics, and how the robot reacts."""
