"""Common ROS 2 code of all nodes: lifecycle, QoS, message conversions, real-time set-up."""
