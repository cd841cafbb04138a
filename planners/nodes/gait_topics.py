"""State of the gait as topics: phase, footsteps planned and taken, capturability margin."""

import math
from collections import deque
from typing import Any

from nav_msgs.msg import Path
from std_msgs.msg import Float64, String

from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS
from models.nodes.parameters import declare_period
from models.nodes.qos import EVENT, LATCHED, SENSOR
from models.status import GaitStatus
from models.types import FOOT_NAMES
from planners.gait.config import GaitConfig
from planners.gait.planner import GaitPlanner
from planners.gait.route import Footstep
from planners.gait.state import GaitView, capture_margin, coming_steps
from planners.nodes.footstep_messages import path_from_steps

TAKEN_MAX = 20  #: Length of ``gait/footsteps_taken``


def declare_rates(node: PoiseNode) -> tuple[int, int]:
    """Declare the rates of footsteps and margin; returns the times between [ns]."""
    footsteps = declare_period(node, "footstep_rate", 10.0, "the planned footsteps while walking", high=100.0)
    return footsteps, declare_period(node, "margin_rate", 50.0, "the capturability margin in mode walk", high=100.0)


class GaitTopics:
    """Publishes changes after a tick, at the periods of ``declare_rates``; ``margin``: capturability margin [m]."""

    def __init__(self, node: PoiseNode, law: GaitPlanner, periods: tuple[int, int]) -> None:
        self._law, self._periods = law, periods
        self._phase = node.announce(String, topics.GAIT_PHASE, LATCHED)
        self._publish_status = node.announce_status(topics.GAIT_STATUS, LATCHED)
        self._margin = node.announce(Float64, topics.GAIT_CAPTURE_MARGIN, SENSOR)
        self._planned = node.announce(Path, topics.FOOTSTEPS, EVENT)
        self._taken = node.announce(Path, topics.FOOTSTEPS_TAKEN, EVENT)
        self._history: deque[Any] = deque(maxlen=TAKEN_MAX)
        self.reset()

    def reset(self) -> None:
        """A walk begins: publish everything again."""
        self._word, self._steps = "", 0
        self._last_planned = self._last_margin = 0
        self._history.clear()
        self.margin = math.nan

    def publish_phase(self, word: str) -> None:
        """Publish a new word of ``gait/phase``."""
        if word != self._word:
            self._word = word
            self._publish_status(
                GaitStatus(word != topics.GAIT_ABSENT, word in (topics.GAIT_SETTLED, topics.GAIT_ABSENT))
            )
            self._phase.publish(String(data=word))

    def publish(self, stamp: int) -> None:
        """Publish what is due at a stamp [ns]."""
        law = self._law
        if law.settled:
            word = topics.GAIT_SETTLED
        else:
            word = law.phase.value + (f" {FOOT_NAMES[1 - law.stance]}" if law.phase.value == "single" else "")
        view = None
        if stamp - self._last_margin >= self._periods[1]:
            self._last_margin, view = stamp, law.view
            self.margin = capture_margin(view, law.config)
            self._margin.publish(Float64(data=self.margin))
        if law.steps != self._steps:
            self._steps, view = law.steps, view or law.view
            self._history.append((Footstep(law.stance, law.footholds[law.stance]), stamp))
            steps, stamps = zip(*self._history, strict=True)
            self._taken.publish(path_from_steps(stamp, steps, stamps))
        if law.walking and (word != self._word or stamp - self._last_planned >= self._periods[0]):
            self._last_planned = stamp
            self._planned.publish(self._plan(stamp, view or law.view, law.config))
        self.publish_phase(word)

    @staticmethod
    def _plan(stamp: int, view: GaitView, config: GaitConfig) -> Any:
        """Coming footsteps with the times of their touchdown."""
        wait = view.step_time if view.swinging else config.period
        t = stamp + round(max(wait - view.elapsed, 0.0) * NANOSECONDS)
        period = round(config.period * NANOSECONDS)
        feet = (1 - view.stance, view.stance)
        steps = [Footstep(feet[i % 2], hold) for i, hold in enumerate(coming_steps(view, config))]
        return path_from_steps(stamp, steps, [t + i * period for i in range(len(steps))])
