"""Plants: the boundary between the driver program and a robot, simulated or real."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from importlib.metadata import entry_points
from typing import Any, Protocol, runtime_checkable

from bridge.plants.fault_proxy import FaultProxy
from models.errors import ConfigError
from models.robot_model import RobotModel
from models.scan import Scan
from models.types import JointCommand, RobotState, SensorData, Vector

GROUP = "poise.plants"  #: Entry points of installed plants
BUILT_IN: Mapping[str, str] = {"mujoco": "bridge.plants.mujoco:MujocoPlant"}  #: Plants of this package, by name


class Plant(Protocol):
    """A robot for its driver program: sensors in, commands of the joint drives out.

    The driver calls ``read`` and ``write`` once in every ``period``, in this order. It arms and damps the joints by its
    commands: without gains and torque until the supervisor requests more.
    """

    @property
    def period(self) -> float:
        """Time from one tick to the next [s]."""

    def read(self) -> SensorData:
        """Newest measurements, nan where not measured; the robot's stamp stays the same without a new sample."""

    def write(self, command: JointCommand) -> None:
        """Set the command that the drives track until the next call.

        tau = kp (q_d - q) + kd (v_d - v) + tau_d, limits applied.
        """

    def close(self) -> None:
        """Release the torque and the connection; otherwise the robot may keep its last command."""


@runtime_checkable
class SimulatedPlant(Plant, Protocol):
    """A plant with a world that can be reset, disturbed and inspected.

    Time advances with ``step`` only. Only the driver, the closed loop and scores use these methods; no law does.
    ``faults`` injects faults into sensors and drives.
    """

    faults: FaultProxy

    @property
    def t(self) -> float:
        """Simulated time since ``reset`` [s]."""

    @property
    def held(self) -> bool:
        """Whether the base is held."""

    @property
    def load(self) -> float:
        """True normal force on both soles [N]."""

    @property
    def truth(self) -> RobotState:
        """True state; for scoring only."""

    @property
    def obstacle_centre(self) -> Vector | None:
        """Middle of the obstacle in W (3,) [m]; None for a world without one."""

    def reset(self, seed: int | None = None) -> None:
        """Reset the robot to its start with its base held; a seed replaces that of the sensor noise."""

    def hold(self) -> None:
        """Hold the base where it is."""

    def release(self) -> None:
        """Release the base."""

    def hoist(self, height: float) -> None:
        """Lift the held robot by a height [m]."""

    def push(self, force: tuple[float, float, float] | Vector, duration: float, body: str = "base_link") -> None:
        """Push a body's CoM with a force in W (3,) [N] for a time [s]; ``CommandError`` for invalid arguments."""

    def place_obstacle(self, x: float, y: float) -> None:
        """Place the obstacle on the ground at a point of W [m]; ``CommandError`` for a world without one."""

    def remove_obstacle(self) -> None:
        """Move the obstacle out of the way."""

    def transmit(self, sensors: SensorData) -> SensorData | None:
        """The sample of this tick as the laws receive it; None when a fault suppresses its joints."""

    def transmit_scan(self, scan: Scan) -> Scan | None:
        """A scan as the laws receive it; None when a fault suppresses it."""

    def step(self) -> None:
        """Advance the world by one period."""


def find_plant(name: str) -> Callable[..., Plant]:
    """Class of a built-in plant, entry point of ``poise.plants`` or ``module:Class``; ``ConfigError`` if unknown."""
    installed = {entry.name: entry.value for entry in entry_points(group=GROUP)}
    known = {**installed, **BUILT_IN}
    module, colon, attribute = known.get(name, name).partition(":")
    if not colon:
        raise ConfigError(f"plant: unknown '{name}'; known: {', '.join(sorted(known))}; or give module:Class")
    try:
        found: Callable[..., Plant] = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise ConfigError(f"plant: '{name}' cannot be imported: {error}") from error
    return found


def make_plant(name: str, model: RobotModel, options: Mapping[str, Any]) -> Plant:
    """Plant by its name for ``find_plant`` with keyword arguments; ``ConfigError`` for wrong ones."""
    plant = find_plant(name)
    try:
        return plant(model, **options)
    except (TypeError, OSError) as error:
        raise ConfigError(f"plant '{name}': options {sorted(options)}: {error}") from error
