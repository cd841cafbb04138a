"""Target detection in the camera image, and head angles towards the target."""
