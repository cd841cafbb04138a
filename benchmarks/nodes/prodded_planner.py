"""Planner of motions as in the graph, in a process that obeys ``benchmarks/nodes/prod.py``."""

from __future__ import annotations

from benchmarks.nodes import prod
from models.nodes.base import PoiseNode
from planners.nodes.motion_planner import main

if __name__ == "__main__":
    prod.listen(PoiseNode, "publish_diagnostics")
    main()
