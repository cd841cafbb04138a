"""What the estimator met, for the diagnostics; a drop-out that goes on is told at once."""

from __future__ import annotations

from dataclasses import fields

from controllers.estimation.estimator import StateEstimator
from controllers.estimation.guard import EstimatorHealth
from controllers.sample_assembler import SampleAssembler
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS
from models.types import Vector

COASTING_TOLD = 0.01
"""Time without usable samples of the inertial unit or the joints that the diagnostics do not wait with [s]."""


class EstimatorReport:
    """Fills a node's diagnostics.

    The supervisor learns of a drop-out by the stamp it began at: it then knows its length at any time, from two
    messages, and they are not at the mercy of how often diagnostics are published.

    Args:
        node: Node that reports.
    """

    def __init__(self, node: PoiseNode) -> None:
        self._node = node
        self._since: int | None = None
        self._tell()

    def update(self, health: EstimatorHealth, stamp: int) -> None:
        """Tell the beginning of a drop-out, and its end.

        Args:
            health: After the newest step.
            stamp: Of that step [ns].
        """
        if self._since is None:
            if health.coasting < COASTING_TOLD:
                return
            self._since = stamp - round(health.coasting * NANOSECONDS)
            self._node.counters["drop-outs"] += 1
        elif health.coasting > 0.0:
            return
        else:
            self._since = None
        self._tell()
        self._node.publish_diagnostics()

    def reset(self) -> None:
        """The estimator starts over."""
        self._since = None
        self._tell()

    def _tell(self) -> None:
        self._node.values[topics.COASTING] = "" if self._since is None else str(self._since)

    def fill(self, law: StateEstimator, assembler: SampleAssembler) -> None:
        """Put the estimator's health into the node's values, each counter by its name, and what pushes the robot."""
        values = self._node.values
        values["samples with mixed stamps"] = str(assembler.incomplete)
        values["ticks without a usable sample"] = str(assembler.dropped)
        values["ticks with a silent sensor"] = str(assembler.silent)
        push = law.push
        values["push [N]"] = _numbers(push.force) if push.active else "none"
        values["impulse of the push [N.s]"] = _numbers(push.impulse)
        for field in fields(law.health):
            value = getattr(law.health, field.name)
            name = field.name.replace("_", " ")
            values[name] = f"{value:.3f}" if isinstance(value, float) else str(value)


def _numbers(values: Vector) -> str:
    return " ".join(f"{value:.1f}" for value in values)
