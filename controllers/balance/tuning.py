"""Changes gains of standing at run time, without a step of the command."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from controllers.balance.controller import BalanceController
from controllers.whole_body.config import BalanceConfig, WholeBodyConfig
from models.errors import CommandError
from models.types import Vector

RAMP_TIME = 0.5  #: Time in which a gain moves to its new value [s]
FACTOR = 2.0  #: Largest ratio of a gain to its configured value, and of the configured value to the gain [-]
DCM_GAIN, HEIGHT_KP, HEIGHT_KD = 0, 5, 6  #: Indices of the gains of the DCM feedback


def _gain(name: str, place: int) -> tuple[str, Callable[[BalanceController], Vector]]:
    return name, lambda law: law.schedule.gains["balance"].standing[place : place + 1]


def _task(task: str, field: str, rows: slice) -> Callable[[BalanceController], Vector]:
    def view(law: BalanceController) -> Vector:
        scheduled = law.schedule.gains.get(task) if field == "weight" else None
        values: Vector = getattr(law.whole_body.tasks[task], field) if scheduled is None else scheduled.standing
        return values[rows]

    return view


def _knobs() -> Iterator[tuple[str, Callable[[BalanceController], Vector]]]:
    yield _gain("balance.dcm_gain", DCM_GAIN)
    yield _gain("whole_body.com.kp", HEIGHT_KP)
    yield _gain("whole_body.com.kd", HEIGHT_KD)
    yield "whole_body.com.weight", _task("com", "weight", slice(0, 2))
    yield "whole_body.com.weight_height", _task("com", "weight", slice(2, 3))
    for task in ("base_orientation", "torso_orientation", "posture"):
        for field in ("kp", "kd", "weight"):
            yield f"whole_body.{task}.{field}", _task(task, field, slice(None))


_KNOBS = dict(_knobs())

#: Names of the gains, as in ``balance.yaml`` and ``whole_body.yaml``, prefixed by the name of the file
TUNABLE = tuple(_KNOBS)


def configured(name: str, balance: BalanceConfig, whole_body: WholeBodyConfig) -> float:
    """Value of a gain in the configuration of the law."""
    root, *path = name.split(".")
    value: Any = {"balance": balance, "whole_body": whole_body}[root]
    for part in path:
        value = getattr(value, part)
    return float(value)


class Tuning:
    """Moves gains of standing linearly to targets within ``ranges`` in ``RAMP_TIME``; gains of zero stay zero."""

    def __init__(self, law: BalanceController) -> None:
        self._values: dict[str, float] = {}
        self._scales: dict[str, tuple[Vector, Vector]] = {}
        for name, view in _KNOBS.items():
            value = configured(name, law.config, law.whole_body.config)
            self._values[name] = value
            rows = view(law)
            self._scales[name] = rows, rows / value if value else np.zeros_like(rows)
        self.ranges = {name: (value / FACTOR, value * FACTOR) for name, value in self._values.items()}
        self._moves: dict[str, tuple[float, float]] = {}
        self._schedule = law.schedule

    @property
    def moving(self) -> bool:
        """Whether a gain is still changing."""
        return bool(self._moves)

    def value(self, name: str) -> float:
        """Current value of a gain."""
        return self._values[name]

    def set(self, name: str, target: float) -> None:
        """Set the target of a gain; ``CommandError`` for an unknown name or a value out of range."""
        if name not in self.ranges:
            raise CommandError(f"unknown gain '{name}'; known: {', '.join(TUNABLE)}")
        low, high = self.ranges[name]
        if not low <= target <= high:
            raise CommandError(f"{name}: {target:g} is outside [{low:g}, {high:g}]")
        value = self._values[name]
        if target != value or name in self._moves:
            self._moves[name] = target, (target - value) / RAMP_TIME

    def finish(self) -> None:
        """Set every gain to its target; for a law that does not run."""
        self.step(2.0 * RAMP_TIME)

    def step(self, dt: float) -> None:
        """Advance by the time of a tick [s]."""
        for name, (target, rate) in list(self._moves.items()):
            value = self._values[name] + rate * dt
            if (target - value) * rate <= 0.0:
                value = target
                del self._moves[name]
            self._values[name] = value
            rows, scale = self._scales[name]
            np.multiply(scale, value, out=rows)
        self._schedule.update()
