"""Faults of sensors, motors, users, environment, processes and topics, and the reaction of the robot."""
