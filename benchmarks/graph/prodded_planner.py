"""Planner of motions as in the graph, in a process with the signal handlers of ``prod.py``."""

from benchmarks.graph import prod
from models.nodes.base import PoiseNode
from planners.nodes.motion_planner import main

if __name__ == "__main__":
    prod.listen(PoiseNode, "publish_diagnostics")
    main()
