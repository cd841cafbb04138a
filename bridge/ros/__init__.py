"""What the bridge needs to close the loop over ROS 2: the driven robot, its messages, latency and processes."""
