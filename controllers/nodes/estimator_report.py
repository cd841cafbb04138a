"""Diagnostics and status of the estimator; a persisting drop-out is reported at once."""

from __future__ import annotations

from dataclasses import fields

from controllers.estimation.assembler import SampleAssembler
from controllers.estimation.estimator import StateEstimator
from controllers.estimation.samples import EstimatorHealth
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS
from models.status import EstimatorStatus
from models.types import Vector

COASTING_TOLD = 0.01  #: Time without usable samples after which diagnostics are published at once [s]


class EstimatorReport:
    """Fills a node's diagnostics.

    The supervisor receives the stamp at which a drop-out began, so two messages give its length at any time,
    independent of the rate of the diagnostics.
    """

    def __init__(self, node: PoiseNode) -> None:
        self._node = node
        self._since: int | None = None
        self._publish_status = node.announce_status(topics.ESTIMATOR_STATUS)

    def update(self, health: EstimatorHealth, stamp: int) -> None:
        """Report the beginning and the end of a drop-out from the health after the step at a stamp [ns]."""
        if self._since is None:
            if health.coasting < COASTING_TOLD:
                return
            self._since = stamp - round(health.coasting * NANOSECONDS)
            self._node.counters["drop-outs"] += 1
        elif health.coasting > 0.0:
            return
        else:
            self._since = None
        self._node.publish_diagnostics()

    def reset(self) -> None:
        """The estimator starts over."""
        self._since = None

    def fill(self, law: StateEstimator, assembler: SampleAssembler) -> None:
        """Write the estimator's health, each counter by name, and the estimated push into the node's values."""
        self._publish_status(EstimatorStatus(self._since))
        values = self._node.values
        values["coasting since [ns]"] = "" if self._since is None else str(self._since)
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
