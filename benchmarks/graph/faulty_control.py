"""Process of estimator, gait planner and controller with the signal handlers of ``fault_signals.py``."""

from benchmarks.graph import fault_signals
from bridge.nodes.control import main
from controllers.nodes.sample_topics import SampleTopics

if __name__ == "__main__":
    fault_signals.install(SampleTopics, "_pass_on")
    main()
