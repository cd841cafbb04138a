"""The robot for the laws: one Pinocchio model with limits, drives, frames and feet from the profile."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from models.errors import ConfigError, JointNameError, RobotModelError
from models.profile import Frame, Profile, Sole, load_profile
from models.types import FOOT_NAMES, Matrix, Vector
from models.urdf import pinocchio_from_urdf, resolve_uri

SOLE_FRAMES = ("l_sole", "r_sole")  #: REP-120 names of the sole frames, in the order of ``FOOT_NAMES``
_BASE_NV, _BASE_NQ = 6, 7  #: Sizes of the base in a velocity and in a configuration


@dataclass(frozen=True, slots=True)
class Foot:
    """One foot."""

    name: str  #: 'left' or 'right'
    link: str  #: Link of the URDF with the sole
    frame_id: int  #: Pinocchio frame of the sole: origin in the sole plane, x forward, z up
    rectangle: tuple[float, float, float, float]  #: Contact rectangle x_min, x_max, y_min, y_max in the sole frame [m]
    friction: float  #: Nominal Coulomb coefficient of sole on floor [-]; a controller applies its margin
    joint_ids_v: tuple[int, ...]  #: Indices into v of the leg's joints, from base to foot

    @property
    def corners(self) -> Matrix:
        """Corners of the contact rectangle in the sole frame, counter-clockwise from front left (4, 3) [m]."""
        return corners_of(self.rectangle)


def corners_of(rectangle: Sequence[float]) -> Matrix:
    """Corners of x_min, x_max, y_min, y_max [m] in a sole frame, counter-clockwise from front left (4, 3) [m]."""
    x_min, x_max, y_min, y_max = rectangle
    return np.array([[x_max, y_max, 0.0], [x_min, y_max, 0.0], [x_min, y_min, 0.0], [x_max, y_min, 0.0]])


class RobotModel:
    """Kinematics, dynamics, limits and names of one robot.

    Attributes:
        name: Short name of the robot.
        profile: Profile of the robot.
        urdf: Path of the URDF.
        pin: Pinocchio model, free flyer first; its armature is set, so ``pin.crba`` includes rotor inertia.
        nq: Size of a configuration: base position (3), base quaternion xyzw (4), joints (nj).
        nv: Size of a velocity: base twist in the base frame (6), joints (nj).
        nj: Number of joints.
        joint_names: Names in the order of every joint vector (that of the URDF tree in Pinocchio).
        mass: Total mass [kg].
        q_lower, q_upper: Position limits (nj,) [rad].
        v_max: Velocity limits (nj,) [rad/s].
        tau_max: Torque limits (nj,) [N.m].
        tau_rate_max: Torque rate limits of the drives (nj,) [N.m/s].
        armature: Rotor inertia reflected to the joints (nj,) [kg.m^2].
        damping: Viscous friction (nj,) [N.m.s/rad].
        frictionloss: Dry friction (nj,) [N.m].
        kp, kd: Driver gains (nj,) [N.m/rad], [N.m.s/rad].
        feet: Left and right foot.
    """

    def __init__(self, profile: Profile) -> None:
        """Build the model; see ``load`` for refusals."""
        source = Path(profile.source) if profile.source else Path.cwd() / "profile.yaml"
        self.profile = profile
        self.name = profile.name
        self.urdf = resolve_uri(profile.urdf, source.parent)
        self.pin = pinocchio_from_urdf(self.urdf)
        self.nq: int = self.pin.nq
        self.nv: int = self.pin.nv
        self.nj: int = self.nv - _BASE_NV
        self.joint_names: tuple[str, ...] = tuple(self.pin.names)[2:]
        self.mass = float(pin.computeTotalMass(self.pin))
        self._index = {name: i for i, name in enumerate(self.joint_names)}
        _check_names(profile, self.joint_names, self.urdf)

        drives = [(profile.joints[name], profile.motors[profile.joints[name].motor]) for name in self.joint_names]
        self.q_lower = _frozen(self.pin.lowerPositionLimit[_BASE_NQ:])
        self.q_upper = _frozen(self.pin.upperPositionLimit[_BASE_NQ:])
        urdf_v, urdf_tau = self.pin.velocityLimit[_BASE_NV:], self.pin.effortLimit[_BASE_NV:]
        self.v_max = _frozen(_or_default(j.velocity_limit, urdf_v[i]) for i, (j, _) in enumerate(drives))
        self.tau_max = _frozen(_or_default(j.torque_limit, urdf_tau[i]) for i, (j, _) in enumerate(drives))
        self.tau_rate_max = _frozen(m.torque_rate for _, m in drives)
        self.armature = _frozen(m.armature for _, m in drives)
        self.damping = _frozen(m.damping for _, m in drives)
        self.frictionloss = _frozen(m.frictionloss for _, m in drives)
        self.kp = _frozen(_or_default(j.kp, m.kp) for j, m in drives)
        self.kd = _frozen(_or_default(j.kd, m.kd) for j, m in drives)
        self.pin.armature = np.concatenate([np.zeros(_BASE_NV), self.armature])
        self.pin.velocityLimit = np.concatenate([self.pin.velocityLimit[:_BASE_NV], self.v_max])
        self.pin.effortLimit = np.concatenate([self.pin.effortLimit[:_BASE_NV], self.tau_max])

        self._frames = self._add_frames()
        for hull_name, hull in profile.hulls.items():
            self.link_frame_id(hull.link, f"hull '{hull_name}'")
        soles = (profile.feet.left, profile.feet.right)
        self.feet = (self._foot(0, soles[0]), self._foot(1, soles[1]))
        self._postures = {name: self._posture(name, values) for name, values in profile.postures.items()}
        self._postures["zero"] = _frozen(np.clip(np.zeros(self.nj), self.q_lower, self.q_upper))

    @classmethod
    def load(cls, name_or_path: str | Path) -> RobotModel:
        """Load a robot by the name of a packaged profile or the path of a profile.

        Raises:
            ConfigError: The profile is refused; see ``load_profile``.
            RobotModelError: The URDF is refused, or does not fit the profile; file, joint or link, and cause are named.
        """
        return cls(load_profile(name_or_path))

    @property
    def frame_names(self) -> tuple[str, ...]:
        """Names accepted by ``frame_id``."""
        return tuple(self._frames)

    @property
    def posture_names(self) -> tuple[str, ...]:
        """Names accepted by ``posture``."""
        return tuple(self._postures)

    def data(self) -> pin.Data:
        """New Pinocchio workspace."""
        return self.pin.createData()

    def frame_id(self, name: str) -> int:
        """Pinocchio id of a REP-120 frame (base_link, l_sole, r_sole, torso, gaze, l_wrist, r_wrist, imu, ...).

        Raises:
            ConfigError: The profile has no such frame; the known ones are listed.
        """
        if name not in self._frames:
            raise ConfigError(f"{self.name}: unknown frame '{name}'; known: {', '.join(self._frames)}")
        return self._frames[name]

    def posture(self, name: str) -> Vector:
        """Joint positions of a named posture, read-only (nj,) [rad].

        Raises:
            ConfigError: The profile has no such posture; the known ones are listed.
        """
        if name not in self._postures:
            raise ConfigError(f"{self.name}: unknown posture '{name}'; known: {', '.join(self._postures)}")
        return self._postures[name]

    def joint_index(self, name: str) -> int:
        """Position of a joint in every joint vector; ``JointNameError`` when there is no such joint."""
        if name not in self._index:
            raise JointNameError(f"{self.name}: unknown joint '{name}'")
        return self._index[name]

    def reorder(self, names: Sequence[str], values: ArrayLike) -> Vector:
        """Values given by name, in any order, in the order of ``joint_names`` (nj,); a new array.

        Raises:
            JointNameError: A name is missing, unknown or given twice, or there are not as many values as names.
        """
        array = np.asarray(values, dtype=np.float64)
        if array.shape != (len(names),):
            raise JointNameError(f"{self.name}: {len(names)} joint names for values of shape {array.shape}")
        result = np.empty(self.nj)
        seen: set[str] = set()
        for name, value in zip(names, array, strict=True):
            if name in seen:
                raise JointNameError(f"{self.name}: joint '{name}' is given twice")
            seen.add(name)
            result[self.joint_index(name)] = value
        if len(seen) != self.nj:
            missing = [name for name in self.joint_names if name not in seen]
            raise JointNameError(f"{self.name}: joint '{missing[0]}' is missing (of {len(missing)} missing)")
        return result

    def standing_configuration(self, posture: str = "stand") -> Vector:
        """Configuration with the mid-point of the soles at x = y = z = 0, yaw 0 (nq,) [m, rad]; see ``planted``.

        Soles that are parallel and level in the posture lie flat on z = 0.
        """
        return self.planted(self.posture(posture), self.data())

    def planted(self, joints: Vector, data: pin.Data) -> Vector:
        """Configuration (nq,) of joints (nj,) [rad] with the mean of both sole poses at the origin.

        T_WB = (mean of T_BL and T_BR)^-1, with the mean rotation half-way on the geodesic from left to right.
        """
        q: Vector = pin.neutral(self.pin)
        q[_BASE_NQ:] = joints
        pin.framesForwardKinematics(self.pin, data, q)
        left, right = (data.oMf[foot.frame_id] for foot in self.feet)
        rotation = left.rotation @ pin.exp3(0.5 * pin.log3(left.rotation.T @ right.rotation))
        middle = pin.SE3(rotation, 0.5 * (left.translation + right.translation))
        q[:_BASE_NQ] = pin.SE3ToXYZQUAT(middle.inverse())
        return q

    def _add_frames(self) -> dict[str, int]:
        feet = self.profile.feet
        soles = {"l_sole": _sole_frame(feet.left), "r_sole": _sole_frame(feet.right)}
        base = {"base_link": Frame(link=self.profile.base_link)}
        ids: dict[str, int] = {}
        for name, frame in (base | soles | self.profile.frames).items():
            link_id = self.link_frame_id(frame.link, f"frame '{name}'")
            link = self.pin.frames[link_id]
            placement = link.placement * pin.SE3(pin.rpy.rpyToMatrix(*frame.rpy), np.array(frame.xyz))
            ids[name] = self.pin.addFrame(
                pin.Frame(name, link.parentJoint, link_id, placement, pin.FrameType.OP_FRAME), False
            )
        if self.pin.frames[ids["base_link"]].parentJoint != 1:
            raise RobotModelError(f"{self.profile.source}: base_link: '{self.profile.base_link}' is not the root link")
        return ids

    def link_frame_id(self, link: str, user: str) -> int:
        """Pinocchio id of a link of the URDF; ``user`` names the reference to it in the error message.

        Raises:
            RobotModelError: The URDF has no such link.
        """
        frame_id = int(self.pin.getFrameId(link, pin.FrameType.BODY))
        if frame_id >= self.pin.nframes:
            raise RobotModelError(f"{self.profile.source}: {user}: link '{link}' does not exist in {self.urdf}")
        return frame_id

    def _foot(self, index: int, sole: Sole) -> Foot:
        frame_id = self._frames[SOLE_FRAMES[index]]
        chain = [j for j in self.pin.supports[self.pin.frames[frame_id].parentJoint] if j > 1]
        ids = tuple(int(self.pin.joints[j].idx_v) for j in chain)
        return Foot(FOOT_NAMES[index], sole.link, frame_id, sole.rectangle, self.profile.feet.friction, ids)

    def _posture(self, name: str, values: dict[str, float]) -> Vector:
        q = np.array([values.get(joint, 0.0) for joint in self.joint_names])
        outside = np.flatnonzero((q < self.q_lower) | (q > self.q_upper))
        if outside.size:
            i = int(outside[0])
            raise RobotModelError(
                f"{self.profile.source}: posture '{name}': joint '{self.joint_names[i]}' at {q[i]:.4g} rad is outside "
                f"[{self.q_lower[i]:.4g}, {self.q_upper[i]:.4g}]"
            )
        return _frozen(q)


def _check_names(profile: Profile, joint_names: tuple[str, ...], urdf: Path) -> None:
    for name in joint_names:
        if name not in profile.joints:
            raise RobotModelError(f"{profile.source}: joints: '{name}' of {urdf} is missing")
    for name in profile.joints:
        if name not in joint_names:
            raise RobotModelError(f"{profile.source}: joints: '{name}' is not a moving joint of {urdf}")


def _sole_frame(sole: Sole) -> Frame:
    return Frame(link=sole.link, xyz=sole.xyz, rpy=sole.rpy)


def _or_default(value: float | None, default: float) -> float:
    return float(default) if value is None else value


def _frozen(values: Iterable[float] | NDArray[np.float64]) -> Vector:
    array = np.array(list(values), dtype=np.float64)
    array.setflags(write=False)
    return array
