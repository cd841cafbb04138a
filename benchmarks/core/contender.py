"""Any controller in the same tests as poise: push, speed and terrain.

A contender is a class of three methods. It gets the sensors with noise and delay and returns a joint command; start,
plant, drivers, delay, pushes, ground and scores are those of ``ClosedLoop``.
"""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Protocol

from models.errors import ConfigError
from models.robot_model import RobotModel
from models.types import JointCommand, SensorData


class Contender(Protocol):
    """A controller under test."""

    #: Whether its torques are applied directly; otherwise the drivers run their joint PD, with the gains of the robot's
    #: profile, on its positions and velocities, and add its torques
    torque_controlled: bool

    def reset(self, model: RobotModel, seed: int) -> None:
        """Start over with a robot held in its 'stand' posture; ``seed`` is for controllers that draw random numbers."""
        ...

    def set_velocity(self, forward: float, left: float, turn: float) -> None:
        """Walk so fast from now on [m/s, m/s, rad/s], in the frame of the body; zero is to stand."""
        ...

    def step(self, sensors: SensorData, dt: float) -> JointCommand:
        """One tick, ``dt`` [s] after the last, from measured joints, IMU and foot wrenches."""
        ...


def source_of(name: str) -> list[Path]:
    """File of a contender's module; none where there is none, which ``load`` refuses."""
    try:
        spec = find_spec(name.partition(":")[0])
    except (ImportError, ValueError):
        return []
    return [Path(spec.origin)] if spec is not None and spec.origin else []


def load(name: str) -> Contender:
    """Make a contender by ``module:Class``; ``ConfigError`` when it cannot be made or lacks a method."""
    module, _, attribute = name.partition(":")
    try:
        contender: Contender = getattr(import_module(module), attribute)()
    except (ImportError, AttributeError, TypeError, ValueError) as error:
        raise ConfigError(
            f"contender '{name}': not a module:Class that can be made without arguments: {error}"
        ) from error
    lacking = [part for part in ("torque_controlled", "reset", "set_velocity", "step") if not hasattr(contender, part)]
    if lacking:
        raise ConfigError(f"contender '{name}' lacks {', '.join(lacking)}")
    return contender
