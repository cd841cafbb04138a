"""Estimator, gait planner and controller as in the graph, in a process with the signal handlers of ``prod.py``."""

from benchmarks.graph import prod
from bridge.nodes.control import main
from controllers.nodes.sample_topics import SampleTopics

if __name__ == "__main__":
    prod.listen(SampleTopics, "_pass_on")
    main()
