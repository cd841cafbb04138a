"""The world in MuJoCo: ground, obstacle, and the robots that share it, each with its part of one state."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np
import pinocchio as pin

from bridge.obstacle import Obstacle
from models.errors import CommandError, ConfigError
from models.mujoco_model import MujocoModel, build_mujoco, build_mujoco_world, pin_to_mujoco
from models.robot_model import RobotModel
from models.terrain import FLAT, Ground, Terrain, terrain_named
from models.types import Vector

if TYPE_CHECKING:
    from bridge.mujoco_plant import MujocoPlant

SPACING = 1.5
"""Between two robots that nobody has placed, side by side along y [m]."""

ALONE = ""
"""Name of the robot of a world that it has for itself."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where a robot begins: the middle between its soles, on the ground.

    Attributes:
        x: In W [m].
        y: In W [m].
        heading: About the vertical [rad].

    Raises:
        ConfigError: A value is not finite.
    """

    x: float = 0.0
    y: float = 0.0
    heading: float = 0.0

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (self.x, self.y, self.heading))):
            raise ConfigError(f"place: ({self.x}, {self.y}) m, {self.heading} rad is none")


class MujocoWorld:
    """One MuJoCo model and state, stepped by the plants of its robots.

    A step moves the robots that it is called for. The others stand still as if no time passed: positions and velocities
    are put back after the physics. So each robot may be started, or put back to its start, by itself.

    Args:
        robots: The robots by name.
        places: Where each begins, by name; side by side along y, ``SPACING`` apart, for those left out.
        friction: Coulomb coefficient of sole on floor [-]; the smallest of the profiles' when None.
        payload_kg: Mass at the torso that no law knows of, by the robot's name [kg].
        terrain: The ground, or its name in ``models/config/terrain.yaml``.
        timestep: Physics step [s].
        visuals: Load meshes for pictures; no effect on the dynamics.

    Attributes:
        model: The compiled MuJoCo model.
        data: Its state.
        robots: Where to find each robot in them.
        ground: Height of the ground.
        obstacle: The box of a terrain that has one.

    Raises:
        ConfigError: An argument is out of range, a place is of no robot, or two robots touch at the start.
        RobotModelError: MuJoCo refuses a robot.
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
            robots, timestep=timestep, visuals=visuals, friction=friction, payload_kg=payload_kg, terrain=terrain
        )
        beside = {name: Place(y=SPACING * number) for number, name in enumerate(robots)}
        self._set_up(robots, built, beside | dict(places or {}), terrain)
        for number, mj in enumerate(built.values()):
            self.data.qpos[mj.qpos.start] = SPACING * 100.0 * number  # far from whoever is put to his place before
        for name in robots:
            try:
                self.put_back(name)
            except CommandError as error:
                raise ConfigError(f"{error}: place them farther apart") from error

    @classmethod
    def alone(
        cls,
        robot: RobotModel,
        *,
        friction: float | None = None,
        payload_kg: float = 0.0,
        terrain: str | Terrain = FLAT,
        timestep: float = 0.001,
        visuals: bool = False,
    ) -> MujocoWorld:
        """The world of one robot, named ``ALONE``, that begins at the origin; arguments and errors as above."""
        terrain = terrain_named(terrain)
        built = build_mujoco(
            robot, timestep=timestep, visuals=visuals, friction=friction, payload_kg=payload_kg, terrain=terrain
        )
        world = cls.__new__(cls)
        world._set_up({ALONE: robot}, {ALONE: built}, {ALONE: Place()}, terrain)
        return world

    def _set_up(
        self,
        models: Mapping[str, RobotModel],
        robots: Mapping[str, MujocoModel],
        places: Mapping[str, Place],
        terrain: Terrain,
    ) -> None:
        self._models, self.robots, self._places = models, robots, places
        self.model = next(iter(robots.values())).model
        self.data = mujoco.MjData(self.model)
        self.ground = Ground(terrain)
        self.obstacle = Obstacle(terrain, self.ground, self.model, self.data)

    @property
    def period(self) -> float:
        """Physics step [s]."""
        return float(self.model.opt.timestep)

    def robot(self, name: str) -> tuple[RobotModel, MujocoModel]:
        """A robot by name.

        Raises:
            ConfigError: There is none of that name.
        """
        if name not in self.robots:
            raise ConfigError(f"world: unknown robot '{name}'; known: {', '.join(self.robots)}")
        return self._models[name], self.robots[name]

    def put_back(self, name: str) -> None:
        """Put a robot to its place: standing posture, soles on the ground, base held, no torque; others stay.

        Alone, the whole world is as new, the obstacle included.

        Raises:
            CommandError: Another robot is in its place; nothing has changed then.
        """
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
                raise CommandError(f"world: {other} is in the place of {name}")
        data.ctrl[mj.actuator] = 0.0
        data.xfrc_applied[mj.own_bodies] = 0.0
        data.qacc_warmstart[mj.qvel] = 0.0
        mj.hold(data, q[:3], q[3:7])
        mujoco.mj_forward(self.model, data)

    def _start(self, name: str) -> Vector:
        """Configuration in which a robot begins (nq,)."""
        q = self._models[name].standing_configuration()
        place = self._places[name]
        if place != Place():
            turn = pin.AngleAxis(place.heading, np.array([0.0, 0.0, 1.0])).toRotationMatrix()
            q[:3] = turn @ q[:3] + [place.x, place.y, self.ground.height(place.x, place.y)]
            q[3:7] = (pin.Quaternion(turn) * pin.Quaternion(q[3:7])).coeffs()
        return q

    def touching(self, name: str) -> str:
        """Name of a robot that a robot touches now; empty while it touches none."""
        base = self.robots[name].base_body
        roots = self.model.body_rootid[self.model.geom_bodyid[self.data.contact.geom]]  # (ncon, 2)
        met = set(roots[(roots == base).any(axis=1)].ravel().tolist())
        return next((each for each, mj in self.robots.items() if each != name and mj.base_body in met), "")

    def step(self, plants: Sequence[MujocoPlant]) -> None:
        """Advance robots by one physics step; those not given stand still.

        Args:
            plants: The robots to advance.
        """
        data = self.data
        for plant in plants:
            plant.before_step()
        moving = [plant.mujoco for plant in plants]
        still = [mj for mj in self.robots.values() if not any(mj is each for each in moving)]
        kept = [(data.qpos[mj.qpos].copy(), data.qvel[mj.qvel].copy()) for mj in still]
        # Split in two, so that kinematics and contacts belong to the new configuration when this returns.
        mujoco.mj_step2(self.model, data)
        for mj, (qpos, qvel) in zip(still, kept, strict=True):
            data.qpos[mj.qpos], data.qvel[mj.qvel] = qpos, qvel
        for plant in plants:
            plant.clamp_again()
        mujoco.mj_step1(self.model, data)
        for plant in plants:
            plant.after_step()
