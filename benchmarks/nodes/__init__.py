"""ROS 2 nodes that exist for measuring only."""
