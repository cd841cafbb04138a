"""Everything that touches the outside: MuJoCo plant, ROS 2, clock, launch, command line."""
