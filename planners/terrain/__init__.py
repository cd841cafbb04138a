"""The ground around the robot: elevation map and planar patches from point clouds."""
