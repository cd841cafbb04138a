"""MuJoCo model of the robot from the same URDF: free joint, floor, soles, torque motors, IMU and foot sensors.

MuJoCo uses quaternions wxyz; the velocity of a free joint is linear in the world frame and angular in the body frame.
Pinocchio uses xyzw and both velocities in the body frame:

    qpos = [p_WB, wxyz, q]      qvel = [R_WB v_lin, v_ang, v]      M_pin = S^T M_mujoco S,   S = diag(R_WB, I, I)

The index arrays of ``MujocoModel`` match joints by name. In a world of several robots each robot has a part of
MuJoCo's arrays.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypedDict, Unpack

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from models.config import default_config
from models.errors import ConfigError, RobotModelError
from models.mujoco_spec import HOLD, ROOT_JOINT, PlantConfig, build_spec, prefix
from models.robot_model import SOLE_FRAMES, RobotModel
from models.terrain import FLAT, Terrain, terrain_named
from models.types import Matrix, Vector

ROBOTS_MAX = 30  #: Maximum robots in one world: 32 bits of contact types, minus the ground's bit and the sign


@dataclass(frozen=True, slots=True)
class MujocoModel:
    """A compiled MuJoCo model and the indices of one robot in it."""

    model: mujoco.MjModel
    prefix: str  # prefix of the robot's names; empty in a world of one robot
    qpos: slice  # the robot's part of qpos
    qvel: slice  # the robot's part of qvel
    joint_qpos: NDArray[np.int64]  # index of each joint in qpos, in the order of ``RobotModel.joint_names`` (nj,)
    joint_qvel: NDArray[np.int64]  # index of each joint in qvel (nj,)
    actuator: NDArray[np.int64]  # index of each torque motor in ctrl (nj,); ctrl is in N.m, clamped to the limit
    base_body: int  # body of the floating base
    sole_sites: tuple[int, int]  # left and right sole frame
    imu_site: int  # IMU frame
    gyro: slice  # slice of sensordata: angular velocity in the IMU frame [rad/s]
    accel: slice  # slice of sensordata: specific force in the IMU frame, +g along up at rest [m/s^2]
    sole_force: tuple[slice, slice]  # negative ground reaction in the sole frame [N]; read by ``foot_wrenches``
    sole_torque: tuple[slice, slice]  # moment of the same at the sole origin [N.m]
    hold_equality: int  # weld of the base to ``hold_mocap``; enabled by ``data.eq_active``, off by default
    hold_mocap: int  # index of the holding body among the mocap bodies
    bodies: dict[str, int]  # body index by REP-120 frame name and by link name
    own_bodies: slice  # all bodies of the robot, consecutive from its base

    def foot_wrenches(self, data: mujoco.MjData) -> Matrix:
        """Ground reaction (2, 6) [N, N.m] on each foot, in the sole frame at the sole origin; +z bears weight."""
        wrenches = np.empty((2, 6))
        for i in range(2):
            wrenches[i, :3] = data.sensordata[self.sole_force[i]]
            wrenches[i, 3:] = data.sensordata[self.sole_torque[i]]
        return np.negative(wrenches, out=wrenches)

    def hold(self, data: mujoco.MjData, position: Vector, quaternion: Vector) -> None:
        """Hold the base at a pose in the world: position (3,) [m], quaternion xyzw (4,)."""
        data.mocap_pos[self.hold_mocap] = position
        data.mocap_quat[self.hold_mocap] = np.roll(quaternion, 1)
        data.eq_active[self.hold_equality] = 1

    def release(self, data: mujoco.MjData) -> None:
        """Release the base."""
        data.eq_active[self.hold_equality] = 0


class WorldOptions(TypedDict, total=False):
    """Keyword arguments of ``build_mujoco`` and ``build_mujoco_world``; documented in the latter."""

    timestep: float
    visuals: bool
    friction: float | None
    terrain: str | Terrain
    config: PlantConfig | None


def build_mujoco(model: RobotModel, *, payload_kg: float = 0.0, **options: Unpack[WorldOptions]) -> MujocoModel:
    """Build one simulated robot and its floor; see ``build_mujoco_world`` for the options."""
    return build_mujoco_world({"": model}, payload_kg={"": payload_kg}, **options)[""]


def build_mujoco_world(
    robots: Mapping[str, RobotModel],
    *,
    timestep: float = 0.001,
    visuals: bool = False,
    friction: float | None = None,
    payload_kg: Mapping[str, float] | None = None,
    terrain: str | Terrain = FLAT,
    config: PlantConfig | None = None,
) -> dict[str, MujocoModel]:
    """Build simulated robots by name on one floor; they collide with each other at soles and hulls.

    All robots start at the origin of W; the caller places them apart. ``friction`` is the Coulomb coefficient of sole
    on floor [-], the smallest of the profiles when None. ``payload_kg`` is the mass of a ball at the torso's centre of
    mass, in the plant only [kg]. ``terrain`` is the ground, or its name in ``models/config/terrain.yaml``. ``visuals``
    loads visual geometry, without effect on the dynamics. Raises ``ConfigError`` for an argument out of range, and
    ``RobotModelError`` with MuJoCo's reason when it refuses a robot.
    """
    payloads = payload_kg or {}
    if not timestep > 0.0:
        raise ConfigError(f"timestep: {timestep} s is not positive")
    if friction is not None and not friction > 0.0:
        raise ConfigError(f"friction: {friction} is not positive")
    for payload in payloads.values():
        if not payload >= 0.0:
            raise ConfigError(f"payload_kg: {payload} kg is negative")
    if not 0 < len(robots) <= ROBOTS_MAX:
        raise ConfigError(f"robots: {len(robots)}; from 1 to {ROBOTS_MAX} are possible")
    try:
        compiled = build_spec(
            robots,
            timestep=timestep,
            visuals=visuals,
            friction=friction or min(model.profile.feet.friction for model in robots.values()),
            payload_kg=payloads,
            terrain=terrain_named(terrain),
            config=config or default_config(PlantConfig, "models", "mujoco"),
        ).compile()
        return {name: _index(compiled, model, prefix(name)) for name, model in robots.items()}
    except ValueError as error:
        refused = ", ".join(dict.fromkeys(str(model.urdf) for model in robots.values()))
        raise RobotModelError(f"{refused}: MuJoCo refuses it: {error}") from error


def pin_to_mujoco(model: RobotModel, mj: MujocoModel, q: Vector, v: Vector) -> tuple[Vector, Vector]:
    """Convert Pinocchio's configuration (nq,) and velocity (nv,) to new arrays: the robot's part of (qpos, qvel)."""
    qpos, qvel = np.empty(model.nq), np.empty(model.nv)
    qpos[:3] = q[:3]
    qpos[3], qpos[4:7] = q[6], q[3:6]
    qpos[mj.joint_qpos - mj.qpos.start] = q[7:]
    qvel[:3] = _rotation(q[3:7]) @ v[:3]
    qvel[3:6] = v[3:6]
    qvel[mj.joint_qvel - mj.qvel.start] = v[6:]
    return qpos, qvel


def mujoco_to_pin(model: RobotModel, mj: MujocoModel, qpos: Vector, qvel: Vector) -> tuple[Vector, Vector]:
    """Convert the robot's part of (qpos, qvel) to a new configuration (nq,) and velocity (nv,) of Pinocchio."""
    q, v = np.empty(model.nq), np.empty(model.nv)
    q[:3] = qpos[:3]
    q[3:6], q[6] = qpos[4:7], qpos[3]
    q[7:] = qpos[mj.joint_qpos - mj.qpos.start]
    v[:3] = _rotation(q[3:7]).T @ qvel[:3]
    v[3:6] = qvel[3:6]
    v[6:] = qvel[mj.joint_qvel - mj.qvel.start]
    return q, v


def _rotation(xyzw: Vector) -> Matrix:
    return np.asarray(pin.Quaternion(xyzw[3], xyzw[0], xyzw[1], xyzw[2]).toRotationMatrix())


def _index(compiled: mujoco.MjModel, model: RobotModel, prefix: str) -> MujocoModel:
    def sensor(name: str) -> slice:
        start = int(compiled.sensor(prefix + name).adr[0])
        return slice(start, start + int(compiled.sensor(prefix + name).dim[0]))

    names = {i: compiled.body(i).name for i in range(compiled.nbody)}
    bodies = {name.removeprefix(prefix): i for i, name in names.items() if name.startswith(prefix)}
    for name in model.frame_names:
        bodies.setdefault(name, int(compiled.site(prefix + name).bodyid[0]))
    sites = [int(compiled.site(prefix + name).id) for name in SOLE_FRAMES]
    base = int(compiled.body(prefix + model.profile.base_link).id)
    root, joints = compiled.joint(f"{prefix}{ROOT_JOINT}"), [compiled.joint(prefix + n) for n in model.joint_names]
    qpos, qvel = int(root.qposadr[0]), int(root.dofadr[0])
    return MujocoModel(
        model=compiled,
        prefix=prefix,
        qpos=slice(qpos, qpos + model.nq),
        qvel=slice(qvel, qvel + model.nv),
        joint_qpos=np.array([int(joint.qposadr[0]) for joint in joints]),
        joint_qvel=np.array([int(joint.dofadr[0]) for joint in joints]),
        actuator=np.array([int(compiled.actuator(prefix + name).id) for name in model.joint_names]),
        base_body=base,
        sole_sites=(sites[0], sites[1]),
        imu_site=int(compiled.site(f"{prefix}imu").id),
        gyro=sensor("gyro"),
        accel=sensor("accel"),
        sole_force=(sensor("l_sole_force"), sensor("r_sole_force")),
        sole_torque=(sensor("l_sole_torque"), sensor("r_sole_torque")),
        hold_equality=int(compiled.equality(prefix + HOLD).id),
        hold_mocap=int(compiled.body(prefix + HOLD).mocapid[0]),
        bodies=bodies,
        own_bodies=slice(base, base + int(np.count_nonzero(compiled.body_rootid == base))),
    )
