"""Robots behind ros2_control as a plant: broadcasters in, one command controller out."""
