"""Elevation map and planar patches from point clouds, and footsteps on the map."""
