"""The closed loop over ROS 2: messages, latency and processes."""
