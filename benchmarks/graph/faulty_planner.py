"""Process of the motion planner with the signal handlers of ``fault_signals.py``."""

from benchmarks.graph import fault_signals
from models.nodes.base import PoiseNode
from planners.nodes.motion_planner import main

if __name__ == "__main__":
    fault_signals.install(PoiseNode, "publish_diagnostics")
    main()
