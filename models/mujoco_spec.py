"""MuJoCo specification of robot and floor: the URDF, plus everything that a URDF cannot express."""

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import mujoco
import numpy as np
import pinocchio as pin
from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, NonNegative, Positive
from models.constants import GRAVITY
from models.foot import Foot
from models.robot_model import SOLE_FRAMES, RobotModel
from models.terrain import FLAT, Box, Ground, Terrain, blocks
from models.types import Matrix, Vector
from models.urdf import for_mujoco

Points = Annotated[int, Field(ge=2)]


@dataclass(frozen=True, slots=True, config=STRICT)
class ContactConfig:
    """Contact between robot and floor; units in the YAML file."""

    corner_radius: Positive
    sole_points: tuple[Points, Points]
    torsional_friction: NonNegative
    rolling_friction: NonNegative
    time_constant: Positive
    damping_ratio: Positive
    impedance: tuple[float, float, float]


@dataclass(frozen=True, slots=True, config=STRICT)
class SpringConfig:
    """Stiffness of a constraint (MuJoCo's solref); units in the YAML file."""

    time_constant: Positive
    damping_ratio: Positive


@dataclass(frozen=True, slots=True, config=STRICT)
class SceneConfig:
    """Camera, light and floor of rendered images; units in the YAML file."""

    camera_offset: tuple[float, float, float]
    camera_height_target: float
    light_height: Positive
    checker_size: Positive
    shadow_range: Positive


@dataclass(frozen=True, slots=True, config=STRICT)
class PlantConfig:
    """Settings of the simulated world; see ``models/config/mujoco.yaml``."""

    integrator: Literal["implicitfast", "Euler"]
    friction_hardness: Positive
    contact: ContactConfig
    joint_limits: SpringConfig
    hold: SpringConfig
    payload_radius: Positive
    scene: SceneConfig


HOLD = "hold"  #: Name of the weld and of the mocap body that hold the robot until its release
ROOT_JOINT = "root_joint"  #: Name of the free joint of the base
CAMERA = "track"  #: Name of the camera that follows the robot (only with visuals)
OBSTACLE = "obstacle"  #: Name of the mocap body and of the box of an obstacle
WORLD_GROUP = 0  #: Geom group of ground and obstacle; the robot uses other groups
#: Geom group of the robot's collision geometry: soles, hulls and, with several robots, capsules between the hulls
ROBOT_GROUP = 3
_CONDIM = 4  # normal, two tangential and torsional friction
_FLOOR = "floor"
_OBSTACLE_COLOUR = (0.9, 0.45, 0.05, 1.0)  # orange, unlike any floor or robot [-]
_BELOW = 1.0  # depth of the plane below the lowest block [m]


def build_spec(
    robots: Mapping[str, RobotModel],
    *,
    timestep: float,
    visuals: bool,
    friction: float,
    payload_kg: Mapping[str, float],
    terrain: Terrain,
    config: PlantConfig,
) -> mujoco.MjSpec:
    """Specification of robots, prefixed by their names, on one floor; ``ValueError`` when MuJoCo refuses a URDF."""
    alone = "" in robots
    world = _read(robots[""], visuals) if alone else mujoco.MjSpec()
    _set_options(world, timestep, config)
    _add_ground(world, terrain, friction, config, visuals)
    for number, (name, model) in enumerate(robots.items()):
        spec = world if alone else _read(model, visuals)
        _add_robot(spec, model, payload_kg.get(name, 0.0), terrain, config)
        if visuals:
            _add_camera(spec, model, config)
            if number == 0:
                _add_light(spec, model, config)
        if not alone:
            _set_options(spec, timestep, config)  # MuJoCo refuses to attach a spec with other options
            _fill_gaps(spec, model)
            _let_touch(spec, number)
            world.attach(spec, prefix=prefix(name), frame=world.worldbody.add_frame())
    if terrain.obstacle is not None:
        _add_obstacle(world, terrain, terrain.obstacle, friction, config, visuals)
    if visuals:
        _add_sky(world, config)
    return world


def prefix(name: str) -> str:
    """Prefix of a robot's names in a world of several robots; empty without a name."""
    return f"{name}/" if name else ""


def _read(model: RobotModel, visuals: bool) -> Any:
    return mujoco.MjSpec.from_string(ET.tostring(for_mujoco(model.urdf, visuals=visuals), encoding="unicode"))


def _add_robot(spec: Any, model: RobotModel, payload_kg: float, terrain: Terrain, config: PlantConfig) -> None:
    _add_base(spec, model, config)
    _set_joints(spec, model, config)
    _add_frames(spec, model)
    _add_soles(spec, model, config, uneven=terrain.kind != FLAT)
    _add_hulls(spec, model)
    if payload_kg > 0.0:
        _add_payload(spec, model, payload_kg, config)


def _fill_gaps(spec: Any, model: RobotModel) -> None:
    """Connect each hull to its predecessor by a capsule, so that no arm or ray of another robot passes between them.

    The predecessor is on the same link; for the first hull of a link it is the nearest hull of the next parent with
    hulls. The capsule is fixed to the link at the relative pose of the standing posture, with the smaller radius.
    """
    data, done = model.data(), dict[str, list[tuple[Vector, float]]]()
    pin.framesForwardKinematics(model.pin, data, model.standing_configuration())
    for name, hull in model.profile.hulls.items():
        placement = data.oMf[model.pin.getFrameId(hull.link, pin.FrameType.BODY)]
        middle = placement.act(0.5 * (np.array(hull.start) + np.array(hull.end)))
        above, before = spec.body(hull.link), done.setdefault(hull.link, [])
        found = before[-1:]
        while not found and above.name != spec.worldbody.name:
            above = above.parent
            found = done.get(above.name, [])
        before.append((middle, hull.radius))
        if found:
            other, radius = min(found, key=lambda each: float(np.linalg.norm(each[0] - middle)))
            ends = [*placement.actInv(middle), *placement.actInv(other)]
            geom = spec.body(hull.link).add_geom(name=f"gap_{name}", type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=ends)
            geom.size[0], geom.group, geom.mass = min(radius, hull.radius), ROBOT_GROUP, 0.0
            geom.contype = geom.conaffinity = 0


def _let_touch(spec: Any, number: int) -> None:
    """Enable collisions of a robot with other robots, but not with itself.

    Two geoms collide if the contype of one matches the conaffinity of the other. Bit 0 is the ground. Robot k has
    contype bit k + 1 and conaffinity to all previous robots; its conaffinity to the ground is unchanged.
    """
    for geom in spec.geoms:
        if geom.group == ROBOT_GROUP:
            geom.contype, geom.conaffinity = 2 << number, ((2 << number) - 2) | geom.conaffinity


def _wxyz(rotation: Matrix) -> Vector:
    return np.roll(pin.Quaternion(rotation).coeffs(), 1)


def _set_options(spec: Any, timestep: float, config: PlantConfig) -> None:
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    spec.option.timestep = timestep
    spec.option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{config.integrator.upper()}")
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = config.friction_hardness
    spec.option.gravity = [0.0, 0.0, -GRAVITY]
    # A diverged simulation must be visible, not reset silently.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET


def _add_ground(spec: Any, terrain: Terrain, friction: float, config: PlantConfig, visuals: bool) -> None:
    """Add a plane; or the blocks of a terrain, and below them a plane that catches what falls off the blocks."""
    if visuals:
        _add_material(spec, config)
    pieces = blocks(terrain)
    floor = spec.worldbody.add_geom(name=_FLOOR, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0])
    _set_surface(floor, terrain, friction, config, visuals)
    if not pieces:
        return
    floor.pos = [0.0, 0.0, Ground(terrain).lowest - _BELOW]
    for i, block in enumerate(pieces):
        geom = spec.worldbody.add_geom(name=f"ground_{i}", type=mujoco.mjtGeom.mjGEOM_BOX, size=block.half_sizes)
        geom.pos, geom.quat = block.centre, _wxyz(block.rotation)
        _set_surface(geom, terrain, friction, config, visuals)


def _set_surface(geom: Any, terrain: Terrain, friction: float, config: PlantConfig, visuals: bool) -> None:
    contact = config.contact
    geom.contype, geom.conaffinity, geom.group = 1, 0, WORLD_GROUP
    geom.priority = 1  # friction and stiffness of the ground apply to every contact with it
    geom.condim = _CONDIM
    geom.friction = [friction, contact.torsional_friction, contact.rolling_friction]
    geom.solref = [contact.time_constant if terrain.give is None else terrain.give, contact.damping_ratio]
    geom.solimp[:3] = contact.impedance
    if visuals:
        geom.material = _FLOOR


def _add_material(spec: Any, config: PlantConfig) -> None:
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


def _add_base(spec: Any, model: RobotModel, config: PlantConfig) -> None:
    base = spec.body(model.profile.base_link)
    base.add_freejoint(name=ROOT_JOINT)
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
        if name in SOLE_FRAMES:
            continue
        link, offset = model.frame_on_link(name)
        spec.body(link).add_site(name=name, pos=offset.translation, quat=_wxyz(offset.rotation))
    for sensor, kind in (("gyro", mujoco.mjtSensor.mjSENS_GYRO), ("accel", mujoco.mjtSensor.mjSENS_ACCELEROMETER)):
        spec.add_sensor(name=sensor, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="imu")


def _add_soles(spec: Any, model: RobotModel, config: PlantConfig, *, uneven: bool) -> None:
    """Add a massless body with contact points to each foot, four on level ground; its force is the ground reaction."""
    radius = config.contact.corner_radius
    for name, foot in zip(SOLE_FRAMES, model.feet, strict=True):
        _, offset = model.frame_on_link(name)
        sole = spec.body(foot.link).add_body(name=name, pos=offset.translation, quat=_wxyz(offset.rotation))
        sole.add_site(name=name)
        points = _sole_points(foot, config.contact.sole_points) if uneven else foot.corners
        for i, corner in enumerate(points):
            ball = sole.add_geom(name=f"{name}_{i}", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0.0, 0.0])
            ball.pos = corner + np.array([0.0, 0.0, radius])
            ball.contype, ball.conaffinity, ball.group, ball.mass = 0, 1, ROBOT_GROUP, 0.0
        for sensor, kind in (("force", mujoco.mjtSensor.mjSENS_FORCE), ("torque", mujoco.mjtSensor.mjSENS_TORQUE)):
            spec.add_sensor(name=f"{name}_{sensor}", type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=name)


def _sole_points(foot: Foot, count: tuple[int, int]) -> Matrix:
    """Points on the edge of a sole in the sole frame (k, 3) [m]; ``count`` points along its length and its width."""
    x_min, x_max, y_min, y_max = foot.rectangle
    xs, ys = np.linspace(x_min, x_max, count[0]), np.linspace(y_min, y_max, count[1])
    sides = [[x, y, 0.0] for x in xs for y in (y_min, y_max)]
    ends = [[x, y, 0.0] for x in (x_min, x_max) for y in ys[1:-1]]
    return np.array(sides + ends)


def _add_hulls(spec: Any, model: RobotModel) -> None:
    """Add the profile's hulls; they collide with the floor only, so that a fallen robot lies on it."""
    for name, hull in model.profile.hulls.items():
        geom = spec.body(hull.link).add_geom(name=f"hull_{name}")
        if hull.start == hull.end:
            geom.type, geom.pos = mujoco.mjtGeom.mjGEOM_SPHERE, hull.start
        else:
            geom.type, geom.fromto = mujoco.mjtGeom.mjGEOM_CAPSULE, [*hull.start, *hull.end]
        geom.size[0] = hull.radius
        geom.contype, geom.conaffinity, geom.group, geom.mass = 0, 1, ROBOT_GROUP, 0.0


def _add_obstacle(spec: Any, terrain: Terrain, box: Box, friction: float, config: PlantConfig, visuals: bool) -> None:
    """Add a box on a mocap body; call after ``_add_base``, whose mocap body is the first one."""
    body = spec.worldbody.add_body(name=OBSTACLE, mocap=True)
    body.pos = parked(box)
    if box.place is not None:
        body.pos = [*box.place, Ground(terrain).height(*box.place) + 0.5 * box.size[2]]
    geom = body.add_geom(name=OBSTACLE, type=mujoco.mjtGeom.mjGEOM_BOX, size=0.5 * np.array(box.size))
    _set_surface(geom, terrain, friction, config, visuals=False)
    if visuals:
        geom.rgba = _OBSTACLE_COLOUR


def parked(box: Box) -> tuple[float, float, float]:
    """Position of an unused obstacle in W: far below the ground [m]."""
    return 0.0, 0.0, -100.0 - box.size[2]


def _add_payload(spec: Any, model: RobotModel, mass: float, config: PlantConfig) -> None:
    torso = model.pin.frames[model.frame_id("torso")]
    link = model.pin.frames[torso.parentFrame]
    centre = link.placement.actInv(model.pin.inertias[torso.parentJoint].lever)
    ball = spec.body(link.name).add_body(name="payload", pos=centre)
    ball.explicitinertial, ball.mass, ball.ipos = True, mass, [0.0, 0.0, 0.0]  # ipos defaults to pos, not to zero
    ball.inertia = [0.4 * mass * config.payload_radius**2] * 3  # solid ball


def _add_camera(spec: Any, model: RobotModel, config: PlantConfig) -> None:
    for mesh in spec.meshes:
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # accept meshes without volume for rendering
    scene = config.scene
    offset = np.array(scene.camera_offset)
    back = offset - np.array([0.0, 0.0, scene.camera_height_target])
    back /= np.linalg.norm(back)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    camera = spec.body(model.profile.base_link).add_camera(name=CAMERA, mode=mujoco.mjtCamLight.mjCAMLIGHT_TRACK)
    camera.pos, camera.quat = offset, _wxyz(np.column_stack([right, np.cross(back, right), back]))


def _add_light(spec: Any, model: RobotModel, config: PlantConfig) -> None:
    scene = config.scene
    light = spec.body(model.profile.base_link).add_light(mode=mujoco.mjtCamLight.mjCAMLIGHT_TRACK)
    light.pos, light.dir = [0.0, 0.0, scene.light_height], [0.2, 0.3, -1.0]
    light.type, light.castshadow = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, True


def _add_sky(spec: Any, config: PlantConfig) -> None:
    scene = config.scene
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
