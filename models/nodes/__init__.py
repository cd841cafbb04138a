"""ROS 2 base of all nodes: lifecycle, QoS, message conversions, real-time set-up."""
