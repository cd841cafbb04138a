"""Plants: the interface between the driver program and a robot, and the release of a held robot."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.metadata import entry_points
from inspect import signature
from pkgutil import resolve_name
from typing import Any, Protocol, runtime_checkable

import numpy as np
import pinocchio as pin

from bridge.plants.config import LoopConfig
from bridge.plants.fault_proxy import FaultProxy
from models.constants import GRAVITY
from models.errors import ConfigError, PoiseError
from models.robot_model import RobotModel
from models.scan import Scan
from models.types import JointCommand, RobotState, SensorData, Vector

GROUP = "poise.plants"  #: Entry points of installed plants
#: Plants of this package, by name
BUILT_IN: Mapping[str, str] = {
    "mujoco": "bridge.plants.mujoco:MujocoPlant",
    "unitree": "bridge.plants.unitree.plant:UnitreePlant",
    "booster": "bridge.plants.booster.plant:BoosterPlant",
    "ros2_control": "bridge.plants.ros2_control.plant:Ros2ControlPlant",
}


class Plant(Protocol):
    """Interface of a robot to its driver program: sensors in, joint drive commands out.

    The driver calls ``read``, then ``write``, once per ``period``. Its commands also arm and damp the joints: gains and
    torques are zero until the supervisor requests a mode with motion.
    """

    @property
    def period(self) -> float:
        """Time between two ticks [s]."""

    def read(self) -> SensorData:
        """Newest measurements, NaN where not measured; the stamp changes only with a new sample."""

    def write(self, command: JointCommand) -> None:
        """Set the command of the drives until the next call.

        tau = kp (q_d - q) + kd (v_d - v) + tau_d, within the torque limits.
        """

    def close(self) -> None:
        """Release the torque and the connection; without this call the robot may keep its last command."""


@runtime_checkable
class HardwarePlant(Plant, Protocol):
    """A real robot. ``bridge/driver/startup.py`` starts it from its vendor's controller.

    All properties refer to the newest ``read``. The driver calls ``write`` only after the vendor's controller has been
    released or, after a crash, is known to be inactive.
    """

    @property
    def crashed(self) -> bool:
        """Whether the last driver ended without ``close``; the robot may still execute its last command."""

    @property
    def unfinished(self) -> bool:
        """Whether this or a crashed driver has commanded the robot since ``hand_over``, or the guard is armed."""

    @property
    def speed(self) -> float:
        """Speed of the robot's time over real time; below 1 only for a simulated robot."""
        return 1.0

    @property
    def arrived(self) -> bool:
        """Whether a new sample has arrived since the last ``read``; does not block."""

    @property
    def findings(self) -> tuple[str, ...]:
        """Why the robot's messages cannot be used; empty when all checks pass."""

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why even damping must not be commanded: the robot or its active controller is unknown."""
        return ()

    @property
    def evaluates(self) -> bool:
        """Whether the drives evaluate the gains of a command; otherwise the robot gets torques."""
        return True

    @property
    def own_controller(self) -> str:
        """Name of the vendor's controller in messages; empty without one."""

    @property
    def vendor(self) -> str | None:
        """Name of the vendor's active controller; empty when none is active, None while unknown."""

    @property
    def stop(self) -> str:
        """Reason for immediate damping, from the remote controller or a monitor; empty for none."""

    @property
    def foreign(self) -> bool:
        """Whether another program sends commands on the robot's network."""
        return False

    @property
    def jumped(self) -> bool:
        """Whether the robot's clock has jumped: the robot restarted, or nothing has read its clock for too long."""
        return False

    @property
    def pressed(self) -> str:
        """Stop button pressed on the remote controller, except during its test; empty for none."""
        return ""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Reports of the monitors that have no effect."""

    @property
    def holds(self) -> tuple[str, ...]:
        """Reports of the monitors that forbid the start of a motion or a walk."""

    @property
    def report(self) -> Mapping[str, str]:
        """Additional entries of the diagnostics."""

    @property
    def monitored(self) -> Mapping[str, str]:
        """Newest values of the monitors; empty without monitors, or before the first state."""
        return {}

    @property
    def remote_age(self) -> float | None:
        """Time since the last signal of the remote controller [s]; infinite before the first, None without a remote."""
        return None

    @property
    def end_warning(self) -> str:
        """Why ``close`` did not leave the robot in its intended state; empty when it did."""
        return ""

    def executed(self, command: JointCommand) -> JointCommand:
        """The command as the robot executes it: its gains may be reduced."""
        return command

    def hand_over(self) -> None:
        """End all commands, including those of the guard process, because the vendor's controller is active."""

    def release_vendor(self) -> None:
        """Request the end of the vendor's controller; repeats a request that has no answer."""


class Obstacle(Protocol):
    """The movable box of a terrain, if it has one."""

    @property
    def centre(self) -> Vector | None:
        """Centre of the box in W (3,) [m]; None for a terrain without a box."""

    def place(self, x: float, y: float) -> None:
        """Place the box on the ground at (x, y) in W [m]; ``CommandError`` without a box, or for NaN or infinity."""

    def remove(self) -> None:
        """Move the box out of the way; no effect without a box."""


@runtime_checkable
class SimulatedPlant(Plant, Protocol):
    """A plant in a simulated world that can be reset, disturbed and inspected.

    Only ``step`` advances time. The driver, the closed loop and the scoring use these methods; control laws do not.
    ``faults`` injects faults into sensors and drives.
    """

    faults: FaultProxy
    obstacle: Obstacle

    @property
    def t(self) -> float:
        """Simulated time since ``reset`` [s]."""

    @property
    def held(self) -> bool:
        """Whether the base is held."""

    @property
    def load(self) -> float:
        """True normal force, summed over both soles [N]."""

    @property
    def truth(self) -> RobotState:
        """True state; for scoring only."""

    def reset(self, seed: int | None = None) -> None:
        """Reset the robot to its start with its base held; a seed replaces the seed of the sensor noise."""

    def hold(self) -> None:
        """Hold the base at its present pose."""

    def release(self) -> None:
        """Release the base."""

    def hoist(self, height: float) -> None:
        """Lift the held robot by a height [m]."""

    def push(self, force: tuple[float, float, float] | Vector, duration: float, body: str = "base_link") -> None:
        """Push a body at its CoM with a force in W (3,) [N] for a time [s]; ``CommandError`` for invalid arguments."""

    def transmit(self, sensors: SensorData) -> SensorData | None:
        """The sample of this tick as the control laws receive it; None when a fault suppresses the joint states."""

    def transmit_scan(self, scan: Scan) -> Scan | None:
        """A scan as the control laws receive it; None when a fault suppresses it."""

    def step(self) -> None:
        """Advance the world by one period."""


def find_plant(name: str) -> Callable[..., Plant]:
    """Class of a built-in plant, entry point of ``poise.plants`` or ``module:Class``; ``ConfigError`` if unknown."""
    installed = {entry.name: entry.value for entry in entry_points(group=GROUP)}
    known = {**installed, **BUILT_IN}
    if not all((place := known.get(name, name)).partition(":")):
        raise ConfigError(f"plant: unknown '{name}'; known: {', '.join(sorted(known))}; or give module:Class")
    return _resolve(f"plant: '{name}'", place)


def find_guard(name: str) -> Callable[..., Any] | None:
    """Function that creates the guard of a plant, by the plant's name; None for a plant without a guard.

    The attribute ``guard_process`` of the plant's class names it as ``module:function``. It takes the robot, the
    robot's DDS domain and the options of the plant, and returns a ``SilenceGuard`` and its connection. Raises
    ``ConfigError`` as ``find_plant`` does, and if the function cannot be imported.
    """
    place = getattr(find_plant(name), "guard_process", "")
    return _resolve(f"plant '{name}': guard_process '{place}'", place) if place else None


def _resolve(what: str, place: str) -> Callable[..., Any]:
    try:
        found: Callable[..., Any] = resolve_name(place)
    except (ImportError, AttributeError, ValueError) as error:
        raise ConfigError(f"{what} cannot be imported: {error}") from error
    return found


def make_plant(name: str, model: RobotModel, options: Mapping[str, Any]) -> Plant:
    """Create a plant by its name (see ``find_plant``) with keyword arguments; ``ConfigError`` for wrong ones."""
    plant = find_plant(name)
    known = list(signature(plant).parameters.values())[1:]  # without the model
    names = [each.name for each in known if each.kind is not each.VAR_KEYWORD]
    if len(names) == len(known) and (unknown := sorted(set(options).difference(names))):
        public = ", ".join(each for each in names if each != "link")
        raise ConfigError(f"plant '{name}': unknown options {', '.join(unknown)}; known: {public}")
    try:
        return plant(model, **options)
    except (TypeError, OSError) as error:
        raise ConfigError(f"plant '{name}': options {sorted(options)}: {error}") from error


def hanging_command(model: RobotModel) -> JointCommand:
    """Setpoint that holds the 'stand' posture with a fixed base and no load on the feet: tau = g(q)."""
    q = model.standing_configuration("stand")
    gravity = pin.computeGeneralizedGravity(model.pin, model.data(), q)  # (nv,)
    return JointCommand(q=q[7:].copy(), v=np.zeros(model.nj), tau=gravity[6:].copy())


def standing_torques(model: RobotModel, joints: Vector, data: pin.Data) -> Vector:
    """Joint torques (nj,) [N.m] at rest at joint positions (nj,) [rad], soles on the floor: tau = g(q) - sum J' w.

    The weight is shared between the feet so that the CoP is below the CoM. The CoP of each foot is at the CoM's x.
    """
    q = model.planted(joints, data)
    torques = pin.computeGeneralizedGravity(model.pin, data, q)[6:]
    com = pin.centerOfMass(model.pin, data, q)
    pin.computeJointJacobians(model.pin, data, q)
    pin.updateFramePlacements(model.pin, data)
    places = [data.oMf[foot.frame_id].translation for foot in model.feet]
    left = (com[1] - places[1][1]) / (places[0][1] - places[1][1])
    for foot, place, share in zip(model.feet, places, (left, 1.0 - left), strict=True):
        jacobian = pin.getFrameJacobian(model.pin, data, foot.frame_id, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        weight = share * GRAVITY * model.mass
        wrench = np.array([0.0, 0.0, weight, 0.0, -weight * (com[0] - place[0]), 0.0])
        torques = torques - jacobian[:, 6:].T @ wrench
    return np.array(torques)


class ReleaseGate:
    """Detects that the feet of a held robot bear its weight, so that the release causes no transient.

    The gate opens after ``settle_time`` when |F_z - m g| <= load_tolerance m g. F_z is the vertical load on both soles,
    averaged over ``load_window``. The upper tolerance grows in proportion to the time: with weak ankles the controller
    presses the feet down to correct an attitude that the hold keeps. The load is the true one, as a crane measures it.
    """

    def __init__(self, model: RobotModel, config: LoopConfig) -> None:
        self.weight = GRAVITY * model.mass
        self.load = 0.0  #: Last averaged load on both feet [N]
        self.waited = 0.0
        self._config = config
        self._sum, self._window = 0.0, 0.0  # integral of the load [N.s] over the window so far [s]

    def update(self, load: float, dt: float) -> bool:
        """Add a load [N], ``dt`` [s] after the last; returns whether the robot may be released."""
        self.waited += dt
        self._window += dt
        self._sum += dt * load
        if self._window < self._config.load_window:
            return False
        self.load = self._sum / self._window
        self._sum = self._window = 0.0
        excess, least = self.load / self.weight - 1.0, self._config.load_tolerance
        patience = self.waited / self._config.settle_time
        return patience >= 1.0 and -least <= excess <= least * patience


def release_loaded(
    robot: RobotModel,
    plant: SimulatedPlant,
    config: LoopConfig,
    step: Callable[[], None],
    fault: Callable[[], str] = lambda: "",
) -> None:
    """Step a held robot until its feet bear its weight, then release it; ``PoiseError`` when they do not.

    ``fault`` returns why the robot cannot stand; empty while it can.
    """
    gate = ReleaseGate(robot, config)
    while not gate.update(plant.load, plant.period):
        reason = fault()
        if reason or gate.waited > config.settle_limit:
            reason = reason or f"the feet carry {gate.load:.0f} N of {gate.weight:.0f} N"
            raise PoiseError(f"{robot.name} cannot be released after {gate.waited:.1f} s: {reason}")
        step()
    plant.release()
