"""Processes and nodes with which benchmarks start, load and disturb a running ROS graph."""
