"""The same robot in MuJoCo: free joint, floor, soles, torque motors, IMU and foot sensors, built from the same URDF.

This is the one place where MuJoCo's conventions meet the project's. MuJoCo writes quaternions wxyz and the velocity of
a free joint as linear in the world, angular in the body; Pinocchio writes xyzw and both in the body:

    qpos = [p_WB, wxyz, q]      qvel = [R_WB v_lin, v_ang, v]      M_pin = S^T M_mujoco S,   S = diag(R_WB, I, I)

with joints matched by name through the index arrays of ``MujocoModel``.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from models.config import default_config
from models.constants import GRAVITY
from models.errors import ConfigError, RobotModelError
from models.plant_config import PlantConfig
from models.robot_model import RobotModel
from models.types import Matrix, Vector
from models.urdf import for_mujoco

TERRAINS = ("flat",)
"""Floors that ``build_mujoco`` can lay."""

HOLD = "hold"
"""Name of the weld and of the mocap body that carry the robot until it is released."""

CAMERA = "track"
"""Name of the camera that follows the robot (only with visuals)."""

_VISUAL_GROUP = 1
_COLLISION_GROUP = 3
_CONDIM = 4  # normal, two tangential and drilling friction
_FLOOR = "floor"


@dataclass(frozen=True, slots=True)
class MujocoModel:
    """A compiled MuJoCo model and where to find the robot in it.

    Attributes:
        model: The compiled model.
        joint_qpos: Index into qpos of each joint, in the order of ``RobotModel.joint_names`` (nj,).
        joint_qvel: Index into qvel of each joint (nj,).
        actuator: Index into ctrl of each joint's torque motor (nj,); ctrl is in N.m and clamped to the torque limit.
        base_body: Body of the floating base.
        sole_sites: Sites of the left and right sole frame.
        imu_site: Site of the IMU frame.
        gyro: Where sensordata holds the angular velocity in the IMU frame [rad/s].
        accel: Where it holds the specific force in the IMU frame, +g along up at rest [m/s^2].
        sole_force: Where it holds the force that each foot puts on its sole, in the sole frame: minus the ground
            reaction [N]; read it through ``foot_wrenches``.
        sole_torque: The same for the torque at the sole origin [N.m].
        hold_equality: Weld between the base and mocap body 0; ``data.eq_active`` switches it, off by default.
        bodies: Body index by REP-120 frame name and by link name.
    """

    model: mujoco.MjModel
    joint_qpos: NDArray[np.int64]
    joint_qvel: NDArray[np.int64]
    actuator: NDArray[np.int64]
    base_body: int
    sole_sites: tuple[int, int]
    imu_site: int
    gyro: slice
    accel: slice
    sole_force: tuple[slice, slice]
    sole_torque: tuple[slice, slice]
    hold_equality: int
    bodies: dict[str, int]

    def foot_wrenches(self, data: mujoco.MjData) -> Matrix:
        """Ground reaction on each foot, in its sole frame at the sole origin; +z carries weight (2, 6) [N, N.m]."""
        wrenches = np.empty((2, 6))
        for i in range(2):
            wrenches[i, :3] = data.sensordata[self.sole_force[i]]
            wrenches[i, 3:] = data.sensordata[self.sole_torque[i]]
        return np.negative(wrenches, out=wrenches)

    def hold(self, data: mujoco.MjData, position: Vector, quaternion: Vector) -> None:
        """Hold the base at a pose of the world: position (3,) [m], quaternion xyzw (4,)."""
        data.mocap_pos[0] = position
        data.mocap_quat[0] = np.roll(quaternion, 1)
        data.eq_active[self.hold_equality] = 1

    def release(self, data: mujoco.MjData) -> None:
        """Let go of the base."""
        data.eq_active[self.hold_equality] = 0


def build_mujoco(
    model: RobotModel,
    *,
    timestep: float = 0.001,
    visuals: bool = False,
    friction: float | None = None,
    payload_kg: float = 0.0,
    terrain: str = "flat",
    config: PlantConfig | None = None,
) -> MujocoModel:
    """Build the simulated robot and its floor.

    Args:
        model: The robot.
        timestep: Physics step [s].
        visuals: Load meshes, floor texture, light and camera for pictures; no effect on the dynamics.
        friction: Coulomb coefficient of sole on floor [-]; the profile's when None.
        payload_kg: Mass of a ball at the torso's centre of mass that only the plant knows of [kg].
        terrain: One of ``TERRAINS``.
        config: Solver and contact settings; the packaged ones when None.

    Returns:
        The compiled model with its indices.

    Raises:
        ConfigError: An argument is out of range, or the terrain is unknown.
        RobotModelError: MuJoCo refuses the URDF; the file and MuJoCo's reason are named.
    """
    if not timestep > 0.0:
        raise ConfigError(f"timestep: {timestep} s is not positive")
    if friction is not None and not friction > 0.0:
        raise ConfigError(f"friction: {friction} is not positive")
    if not payload_kg >= 0.0:
        raise ConfigError(f"payload_kg: {payload_kg} kg is negative")
    config = config or default_config(PlantConfig, "models", "mujoco")
    try:
        spec = mujoco.MjSpec.from_string(ET.tostring(for_mujoco(model.urdf, visuals=visuals), encoding="unicode"))
    except ValueError as error:
        raise RobotModelError(f"{model.urdf}: MuJoCo refuses it: {error}") from error
    _set_options(spec, timestep, config)
    _add_floor(spec, terrain, friction or model.profile.feet.friction, config, visuals)
    _add_base(spec, model, config)
    _set_joints(spec, model, config)
    _add_frames(spec, model)
    _add_soles(spec, model, config)
    _add_hulls(spec, model)
    if payload_kg > 0.0:
        _add_payload(spec, model, payload_kg, config)
    if visuals:
        _add_scene(spec, model, config)
    try:
        return _index(spec.compile(), model)
    except ValueError as error:
        raise RobotModelError(f"{model.urdf}: MuJoCo refuses it: {error}") from error


def pin_to_mujoco(model: RobotModel, mj: MujocoModel, q: Vector, v: Vector) -> tuple[Vector, Vector]:
    """Convert a configuration (nq,) and velocity (nv,) of Pinocchio into new (qpos, qvel) of MuJoCo."""
    qpos, qvel = np.empty(model.nq), np.empty(model.nv)
    qpos[:3] = q[:3]
    qpos[3], qpos[4:7] = q[6], q[3:6]
    qpos[mj.joint_qpos] = q[7:]
    qvel[:3] = _rotation(q[3:7]) @ v[:3]
    qvel[3:6] = v[3:6]
    qvel[mj.joint_qvel] = v[6:]
    return qpos, qvel


def mujoco_to_pin(model: RobotModel, mj: MujocoModel, qpos: Vector, qvel: Vector) -> tuple[Vector, Vector]:
    """Convert (qpos, qvel) of MuJoCo into a new configuration (nq,) and velocity (nv,) of Pinocchio."""
    q, v = np.empty(model.nq), np.empty(model.nv)
    q[:3] = qpos[:3]
    q[3:6], q[6] = qpos[4:7], qpos[3]
    q[7:] = qpos[mj.joint_qpos]
    v[:3] = _rotation(q[3:7]).T @ qvel[:3]
    v[3:6] = qvel[3:6]
    v[6:] = qvel[mj.joint_qvel]
    return q, v


def _rotation(xyzw: Vector) -> Matrix:
    return np.asarray(pin.Quaternion(xyzw[3], xyzw[0], xyzw[1], xyzw[2]).toRotationMatrix())


def _wxyz(rotation: Matrix) -> Vector:
    return np.roll(pin.Quaternion(rotation).coeffs(), 1)


def _set_options(spec: Any, timestep: float, config: PlantConfig) -> None:
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    spec.option.timestep = timestep
    spec.option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{config.integrator.upper()}")
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = config.friction_hardness
    spec.option.gravity = [0.0, 0.0, -GRAVITY]
    # A diverged simulation must be seen, not silently set back to its start.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET


def _add_floor(spec: Any, terrain: str, friction: float, config: PlantConfig, visuals: bool) -> None:
    if terrain not in TERRAINS:
        raise ConfigError(f"terrain: unknown '{terrain}'; known: {', '.join(TERRAINS)}")
    contact = config.contact
    floor = spec.worldbody.add_geom(name=_FLOOR, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0])
    floor.contype, floor.conaffinity = 1, 0
    floor.priority = 1  # the floor's friction and stiffness count, whatever touches it
    floor.condim = _CONDIM
    floor.friction = [friction, contact.torsional_friction, contact.rolling_friction]
    floor.solref = [contact.time_constant, contact.damping_ratio]
    floor.solimp[:3] = contact.impedance
    if visuals:
        spec.add_texture(
            name=_FLOOR,
            type=mujoco.mjtTexture.mjTEXTURE_2D,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
            rgb1=[0.36, 0.40, 0.44],
            rgb2=[0.28, 0.31, 0.35],
            width=256,
            height=256,
        )
        material = spec.add_material(name=_FLOOR, texrepeat=[0.5 / config.scene.checker_size] * 2, texuniform=True)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = _FLOOR
        floor.material = _FLOOR


def _add_base(spec: Any, model: RobotModel, config: PlantConfig) -> None:
    base = spec.body(model.profile.base_link)
    base.add_freejoint(name="root_joint")
    spec.worldbody.add_body(name=HOLD, mocap=True)
    weld = spec.add_equality(name=HOLD, type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY)
    weld.name1, weld.name2, weld.active = base.name, HOLD, False
    weld.data[:11] = [0.0] * 3 + [0.0] * 3 + [1.0, 0.0, 0.0, 0.0] + [1.0]  # anchor, relative pose, torque scale
    weld.solref = [config.hold.time_constant, config.hold.damping_ratio]


def _set_joints(spec: Any, model: RobotModel, config: PlantConfig) -> None:
    for i, name in enumerate(model.joint_names):
        joint, limit = spec.joint(name), float(model.tau_max[i])
        joint.armature = model.armature[i]
        joint.damping[0] = model.damping[i]
        joint.frictionloss = model.frictionloss[i]
        joint.range = [model.q_lower[i], model.q_upper[i]]
        joint.solref_limit = [config.joint_limits.time_constant, config.joint_limits.damping_ratio]
        joint.actfrcrange = [-limit, limit]
        motor = spec.add_actuator(name=name, trntype=mujoco.mjtTrn.mjTRN_JOINT, target=name)
        motor.set_to_motor()
        motor.ctrllimited, motor.ctrlrange = True, [-limit, limit]


def _add_frames(spec: Any, model: RobotModel) -> None:
    for name in model.frame_names:
        if name in ("l_sole", "r_sole"):
            continue
        frame = model.pin.frames[model.frame_id(name)]
        link = model.pin.frames[frame.parentFrame]
        offset = link.placement.actInv(frame.placement)
        spec.body(link.name).add_site(name=name, pos=offset.translation, quat=_wxyz(offset.rotation))
    for sensor, kind in (("gyro", mujoco.mjtSensor.mjSENS_GYRO), ("accel", mujoco.mjtSensor.mjSENS_ACCELEROMETER)):
        spec.add_sensor(name=sensor, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="imu")


def _add_soles(spec: Any, model: RobotModel, config: PlantConfig) -> None:
    """A massless body for each sole carries its contact points: what it passes to the foot is the ground reaction."""
    radius = config.contact.corner_radius
    for foot in model.feet:
        name = model.pin.frames[foot.frame_id].name
        link = model.pin.frames[model.pin.frames[foot.frame_id].parentFrame]
        offset = link.placement.actInv(model.pin.frames[foot.frame_id].placement)
        sole = spec.body(foot.link).add_body(name=name, pos=offset.translation, quat=_wxyz(offset.rotation))
        sole.add_site(name=name)
        for i, corner in enumerate(foot.corners):
            ball = sole.add_geom(name=f"{name}_{i}", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0.0, 0.0])
            ball.pos = corner + np.array([0.0, 0.0, radius])
            ball.contype, ball.conaffinity, ball.group, ball.mass = 0, 1, _COLLISION_GROUP, 0.0
        for sensor, kind in (("force", mujoco.mjtSensor.mjSENS_FORCE), ("torque", mujoco.mjtSensor.mjSENS_TORQUE)):
            spec.add_sensor(name=f"{name}_{sensor}", type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=name)


def _add_hulls(spec: Any, model: RobotModel) -> None:
    """The profile's hulls touch the floor only, so that a fallen robot lies on it."""
    for name, hull in model.profile.hulls.items():
        geom = spec.body(hull.link).add_geom(name=f"hull_{name}")
        if hull.start == hull.end:
            geom.type, geom.pos = mujoco.mjtGeom.mjGEOM_SPHERE, hull.start
        else:
            geom.type, geom.fromto = mujoco.mjtGeom.mjGEOM_CAPSULE, [*hull.start, *hull.end]
        geom.size[0] = hull.radius
        geom.contype, geom.conaffinity, geom.group, geom.mass = 0, 1, _COLLISION_GROUP, 0.0


def _add_payload(spec: Any, model: RobotModel, mass: float, config: PlantConfig) -> None:
    torso = model.pin.frames[model.frame_id("torso")]
    link = model.pin.frames[torso.parentFrame]
    centre = link.placement.actInv(model.pin.inertias[torso.parentJoint].lever)
    ball = spec.body(link.name).add_body(name="payload", pos=centre)
    ball.explicitinertial, ball.mass, ball.ipos = True, mass, [0.0, 0.0, 0.0]  # ipos defaults to pos, not to zero
    ball.inertia = [0.4 * mass * config.payload_radius**2] * 3  # solid ball


def _add_scene(spec: Any, model: RobotModel, config: PlantConfig) -> None:
    for mesh in spec.meshes:
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # a mesh without volume is welcome in a picture
    scene = config.scene
    offset = np.array(scene.camera_offset)
    back = offset - np.array([0.0, 0.0, scene.camera_height_target])
    back /= np.linalg.norm(back)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    camera = spec.body(model.profile.base_link).add_camera(name=CAMERA, mode=mujoco.mjtCamLight.mjCAMLIGHT_TRACK)
    camera.pos, camera.quat = offset, _wxyz(np.column_stack([right, np.cross(back, right), back]))
    light = spec.body(model.profile.base_link).add_light(mode=mujoco.mjtCamLight.mjCAMLIGHT_TRACK)
    light.pos, light.dir = [0.0, 0.0, scene.light_height], [0.2, 0.3, -1.0]
    light.type, light.castshadow = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, True
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 1920, 1080
    spec.visual.map.shadowclip = scene.shadow_range
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.4] * 3, [0.4] * 3
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.75, 0.83, 0.92],
        rgb2=[0.95, 0.97, 1.0],
        width=256,
        height=1536,
    )


def _index(compiled: mujoco.MjModel, model: RobotModel) -> MujocoModel:
    def sensor(name: str) -> slice:
        start = int(compiled.sensor(name).adr[0])
        return slice(start, start + int(compiled.sensor(name).dim[0]))

    bodies = {compiled.body(i).name: i for i in range(compiled.nbody)}
    for name in model.frame_names:
        bodies.setdefault(name, int(compiled.site(name).bodyid[0]))
    sites = [int(compiled.site(name).id) for name in ("l_sole", "r_sole")]
    return MujocoModel(
        model=compiled,
        joint_qpos=np.array([int(compiled.joint(name).qposadr[0]) for name in model.joint_names]),
        joint_qvel=np.array([int(compiled.joint(name).dofadr[0]) for name in model.joint_names]),
        actuator=np.array([int(compiled.actuator(name).id) for name in model.joint_names]),
        base_body=int(compiled.body(model.profile.base_link).id),
        sole_sites=(sites[0], sites[1]),
        imu_site=int(compiled.site("imu").id),
        gyro=sensor("gyro"),
        accel=sensor("accel"),
        sole_force=(sensor("l_sole_force"), sensor("r_sole_force")),
        sole_torque=(sensor("l_sole_torque"), sensor("r_sole_torque")),
        hold_equality=int(compiled.equality(HOLD).id),
        bodies=bodies,
    )
