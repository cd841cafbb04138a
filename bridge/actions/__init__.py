"""What the actions of the graph do with its topics and services."""
