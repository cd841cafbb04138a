"""The MuJoCo world: ground, obstacle, and the robots that share one model and state."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
import pinocchio as pin

from bridge.plants.base import Obstacle
from models.errors import CommandError, ConfigError
from models.mujoco_model import MujocoModel, build_mujoco, build_mujoco_world, pin_to_mujoco
from models.mujoco_spec import OBSTACLE, parked
from models.robot_model import RobotModel
from models.terrain import FLAT, Ground, Terrain, terrain_named
from models.types import Vector

SPACING = 1.5  #: Distance along y between robots without a given place [m]
STEP_MAX = 0.001  #: Longest physics step; a longer tick is divided into equal steps [s]
ALONE = ""  #: Name of a single robot in a world; its names in MuJoCo have no prefix


@dataclass(frozen=True, slots=True)
class Place:
    """Start of a robot: midpoint of its soles in W [m], and heading [rad]; ``ConfigError`` for NaN or infinity."""

    x: float = 0.0
    y: float = 0.0
    heading: float = 0.0

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (self.x, self.y, self.heading))):
            raise ConfigError(f"place: ({self.x}, {self.y}) m, {self.heading} rad is not finite")


class Box(Obstacle):
    """The movable box of a terrain, if it has one; changes take effect at the next step."""

    def __init__(self, terrain: Terrain, ground: Ground, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._terrain, self._ground, self._data = terrain, ground, data
        self._mocap = -1 if terrain.obstacle is None else int(model.body(OBSTACLE).mocapid[0])

    def place(self, x: float, y: float) -> None:
        if self._terrain.obstacle is None:
            raise CommandError("obstacle: this terrain has none; start with the terrain 'box' or 'wall'")
        if not (math.isfinite(x) and math.isfinite(y)):
            raise CommandError(f"obstacle: ({x}, {y}) m is not finite")
        height = self._ground.height(x, y) + 0.5 * self._terrain.obstacle.size[2]
        self._data.mocap_pos[self._mocap] = x, y, height

    @property
    def centre(self) -> Vector | None:
        return None if self._mocap < 0 else np.array(self._data.mocap_pos[self._mocap])

    def remove(self) -> None:
        if self._terrain.obstacle is not None:
            self._data.mocap_pos[self._mocap] = parked(self._terrain.obstacle)


class MujocoWorld:
    """One MuJoCo model and state, stepped by the plants of its robots.

    ``step_world`` moves the given robots. The others stand still: their positions and velocities are restored after
    each physics step. Thus each robot can be started or reset separately.

    ``places`` are start poses by name; robots without one are side by side along y, ``SPACING`` apart. ``timestep`` is
    the length of a tick [s], with equal physics steps of at most ``STEP_MAX``; the other arguments are those of
    ``build_mujoco_world``. Raises ``ConfigError`` for an argument out of range, a place of an unknown robot, or two
    robots in contact at the start.
    """

    def __init__(
        self,
        robots: Mapping[str, RobotModel],
        places: Mapping[str, Place] | None = None,
        *,
        friction: float | None = None,
        payload_kg: Mapping[str, float] | None = None,
        terrain: str | Terrain = FLAT,
        timestep: float = 0.001,
        visuals: bool = False,
    ) -> None:
        for name in (*(places or {}), *(payload_kg or {})):
            if name not in robots:
                raise ConfigError(f"world: unknown robot '{name}'; known: {', '.join(robots)}")
        terrain = terrain_named(terrain)
        built = build_mujoco_world(
            robots,
            timestep=physics_step(timestep),
            visuals=visuals,
            friction=friction,
            payload_kg=payload_kg,
            terrain=terrain,
        )
        beside = {name: Place(y=SPACING * number) for number, name in enumerate(robots)}
        self.period, self.substeps = timestep, round(timestep / physics_step(timestep))
        self._models, self.robots, self._places = robots, built, beside | dict(places or {})
        self.model = next(iter(built.values())).model
        self.data = mujoco.MjData(self.model)
        self.ground = Ground(terrain)
        self.obstacle = Box(terrain, self.ground, self.model, self.data)
        for number, mj in enumerate(built.values()):
            self.data.qpos[mj.qpos.start] = SPACING * 100.0 * number  # apart until each is reset to its place
        for name in robots:
            try:
                self.put_back(name)
            except CommandError as error:
                raise ConfigError(f"{error}: place them farther apart") from error

    def robot(self, name: str) -> tuple[RobotModel, MujocoModel]:
        """Models of a robot by name; ``ConfigError`` for an unknown name."""
        if name not in self.robots:
            raise ConfigError(f"world: unknown robot '{name}'; known: {', '.join(self.robots)}")
        return self._models[name], self.robots[name]

    def put_back(self, name: str) -> None:
        """Reset a robot (a single one: the whole world) to its place, held; ``CommandError`` if another is there."""
        robot, mj = self.robot(name)
        data, q = self.data, self._start(name)
        if len(self.robots) == 1:
            mujoco.mj_resetData(self.model, data)
        before = data.qpos[mj.qpos].copy(), data.qvel[mj.qvel].copy()
        data.qpos[mj.qpos], data.qvel[mj.qvel] = pin_to_mujoco(robot, mj, q, np.zeros(robot.nv))
        if len(self.robots) > 1:
            mujoco.mj_fwdPosition(self.model, data)
            if other := self.touching(name):
                data.qpos[mj.qpos], data.qvel[mj.qvel] = before
                mujoco.mj_forward(self.model, data)
                raise CommandError(f"world: the place of {name} is occupied by {other}")
        data.ctrl[mj.actuator] = 0.0
        data.xfrc_applied[mj.own_bodies] = 0.0
        data.qacc_warmstart[mj.qvel] = 0.0
        mj.hold(data, q[:3], q[3:7])
        mujoco.mj_forward(self.model, data)

    def _start(self, name: str) -> Vector:
        q = self._models[name].standing_configuration()
        place = self._places[name]
        if place != Place():
            turn = pin.AngleAxis(place.heading, np.array([0.0, 0.0, 1.0])).toRotationMatrix()
            q[:3] = turn @ q[:3] + [place.x, place.y, self.ground.height(place.x, place.y)]
            q[3:7] = (pin.Quaternion(turn) * pin.Quaternion(q[3:7])).coeffs()
        return q

    def touching(self, name: str) -> str:
        """Name of a robot in contact with the given one; empty without contact."""
        base = self.robots[name].base_body
        roots = self.model.body_rootid[self.model.geom_bodyid[self.data.contact.geom]]  # (ncon, 2)
        met = set(roots[(roots == base).any(axis=1)].ravel().tolist())
        return next((each for each, mj in self.robots.items() if each != name and mj.base_body in met), "")


class SeenWorld:
    """A copy of the world of a simulated robot, with its visual geoms, set to given states.

    ``obstacle`` is the centre of the terrain's box in W (3,) [m], None for its place at the start.
    """

    def __init__(self, robot: RobotModel, terrain: str | Terrain = FLAT) -> None:
        self.robot = robot
        self.obstacle: Vector | None = None
        self._has_obstacle = terrain_named(terrain).obstacle is not None
        self._mj = build_mujoco(robot, visuals=True, terrain=terrain)
        self._model, self._data = self._mj.model, mujoco.MjData(self._mj.model)
        self._still = np.zeros(robot.nv)

    def set(self, q: Vector) -> None:
        """Set the configuration of the robot (nq,) and the place of the box."""
        self._data.qpos[:], _ = pin_to_mujoco(self.robot, self._mj, q, self._still)
        if self._has_obstacle and self.obstacle is not None:
            self._data.mocap_pos[self._model.body(OBSTACLE).mocapid[0]] = self.obstacle
        mujoco.mj_kinematics(self._model, self._data)


def physics_step(period: float) -> float:
    """Length of the physics steps in a tick [s], for the length of the tick [s]."""
    return period / max(math.ceil(round(period / STEP_MAX, 6)), 1) if 0.0 < period < 1.0 else period


#: All inputs of ``mj_step``, including the warm start of the contact solver and pushes
STATE = mujoco.mjtState.mjSTATE_INTEGRATION


class BarePhysics:
    """Records start state and controls of up to ``ticks`` ticks of a run, and replays them in a separate ``data``.

    ``step_world`` executes ``mj_step`` in two halves. ``replay`` therefore reproduces the states if only the actuators
    have acted since the tick before ``begin``. Its duration is a lower bound of the time of these ticks.
    """

    def __init__(self, model: mujoco.MjModel, ticks: int) -> None:
        self._model, self.data = model, mujoco.MjData(model)
        self._start: Vector = np.zeros(mujoco.mj_stateSize(model, STATE))
        self._controls = np.zeros((ticks, model.nu))
        self._count = 0

    def begin(self, data: mujoco.MjData) -> None:
        """Record the start state."""
        mujoco.mj_getState(self._model, data, self._start, STATE)
        self._count = 0

    def note(self, data: mujoco.MjData) -> None:
        """Record the controls of a tick."""
        self._controls[self._count] = data.ctrl
        self._count += 1

    def rewind(self) -> None:
        """Return to the recorded start state."""
        mujoco.mj_setState(self._model, self.data, self._start, STATE)

    def replay(self) -> None:
        """Replay the recorded ticks; call ``rewind`` before."""
        model, data, step = self._model, self.data, mujoco.mj_step
        for controls in self._controls[: self._count]:
            data.ctrl[:] = controls
            step(model, data)
