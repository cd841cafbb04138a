"""Processes and nodes of a running ROS graph that benchmarks start, load and disturb."""
