"""ROS 2 side of the models: what every node shares (lifecycle base, QoS, message conversions, real-time set-up)."""
