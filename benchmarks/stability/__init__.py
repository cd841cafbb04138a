"""What the robot survives and how well it stands, walks and estimates."""
