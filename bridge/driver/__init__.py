"""The driver program: a plant and its joint drivers behind the topics of a robot."""
