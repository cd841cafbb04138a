"""Plant for robots behind ros2_control: broadcasters in, one command controller out."""
