"""Actions of the graph, built on its topics and services."""
