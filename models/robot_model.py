"""Robot model of the laws: one Pinocchio model with limits, drives, frames and feet from the profile."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from models.constants import FOOT_NAMES, GRAVITY, JOINTS_Q, JOINTS_V
from models.errors import ConfigError, JointNameError, RobotModelError, did_you_mean
from models.foot import Foot, ankle_joints, bearing_area, leg_freedoms
from models.profile import Frame, Payload, Profile, Sole, joint_key, load_profile
from models.types import Vector
from models.urdf import pinocchio_from_urdf, resolve_uri

SOLE_FRAMES = ("l_sole", "r_sole")  #: REP-120 names of the sole frames, in the order of ``FOOT_NAMES``


class RobotModel:
    """Kinematics, dynamics, limits and names of one robot."""

    def __init__(self, profile: Profile) -> None:
        """Build the model; raises as ``load``."""
        source = Path(profile.source) if profile.source else Path.cwd() / "profile.yaml"
        self.profile = profile  #: Profile of the robot
        self.name = profile.name  #: Short name of the robot
        self.urdf = resolve_uri(profile.urdf, source.parent)  #: Path of the URDF
        #: Pinocchio model, free flyer first, with armature: ``pin.crba`` includes rotor inertia
        self.pin = pinocchio_from_urdf(self.urdf)
        self.description = self.urdf.read_text(encoding="utf-8", errors="replace")  #: Content of the URDF
        self.nq: int = self.pin.nq  #: Size of a configuration: base position (3), base quaternion xyzw (4), joints (nj)
        self.nv: int = self.pin.nv  #: Size of a velocity: base twist in the base frame (6), joints (nj)
        self.nj: int = self.nv - JOINTS_V  #: Number of joints
        self.joint_names: tuple[str, ...] = tuple(self.pin.names)[2:]  #: In the order of all joint vectors
        self._index = {name: i for i, name in enumerate(self.joint_names)}
        _check_names(profile, self.joint_names, self.urdf)
        self._aliases = {
            joint_key(each): i
            for i, name in enumerate(self.joint_names)
            for each in (name, *profile.joints[name].aliases)
        }

        drives = [(profile.joints[name], profile.motors[profile.joints[name].motor]) for name in self.joint_names]
        self.q_lower = _frozen(self.pin.lowerPositionLimit[JOINTS_Q:])  #: (nj,) [rad]
        self.q_upper = _frozen(self.pin.upperPositionLimit[JOINTS_Q:])  #: (nj,) [rad]
        urdf_v, urdf_tau = self.pin.velocityLimit[JOINTS_V:], self.pin.effortLimit[JOINTS_V:]
        self.v_max = _frozen(_or_default(j.velocity_limit, urdf_v[i]) for i, (j, _) in enumerate(drives))
        self.tau_max = _frozen(_or_default(j.torque_limit, urdf_tau[i]) for i, (j, _) in enumerate(drives))
        self.tau_rate_max = _frozen(m.torque_rate for _, m in drives)  #: Torque rate limits of the drives (nj,) [N.m/s]
        self.armature = _frozen(m.armature for _, m in drives)  #: Rotor inertia reflected to the joints (nj,) [kg.m^2]
        self.damping = _frozen(m.damping for _, m in drives)  #: Viscous friction (nj,) [N.m.s/rad]
        self.frictionloss = _frozen(m.frictionloss for _, m in drives)  #: Dry friction (nj,) [N.m]
        self.kp = _frozen(_or_default(j.kp, m.kp) for j, m in drives)  #: Driver gains (nj,) [N.m/rad]
        self.kd = _frozen(_or_default(j.kd, m.kd) for j, m in drives)  #: Driver gains (nj,) [N.m.s/rad]
        self.pin.armature = np.concatenate([np.zeros(JOINTS_V), self.armature])
        self.pin.velocityLimit = np.concatenate([self.pin.velocityLimit[:JOINTS_V], self.v_max])
        self.pin.effortLimit = np.concatenate([self.pin.effortLimit[:JOINTS_V], self.tau_max])

        self._frames = self._add_frames()
        for hull_name, hull in profile.hulls.items():
            self.link_frame_id(hull.link, f"hull '{hull_name}'")
        soles = (profile.feet.left, profile.feet.right)
        self.feet = (self._foot(0, soles[0]), self._foot(1, soles[1]))  #: Left and right foot
        self._postures = {name: self._posture(name, values) for name, values in profile.postures.items()}
        self._postures["zero"] = _frozen(np.clip(np.zeros(self.nj), self.q_lower, self.q_upper))
        self._add_payload()
        self.mass = float(pin.computeTotalMass(self.pin))  #: Total mass including the profile's payload [kg]
        self.leg_length = 0.0  #: Height of the first leg joint, at the hip, above the soles in 'stand' [m]
        self._describe_legs()

    @classmethod
    def load(cls, name_or_path: str | Path) -> RobotModel:
        """Load a robot by packaged name or path of a profile; raises ``ConfigError`` or ``RobotModelError``."""
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
        """Pinocchio id of a REP-120 frame (base_link, l_sole, torso, ...); ``ConfigError`` lists the known frames."""
        if name not in self._frames:
            raise ConfigError(f"{self.name}: unknown frame '{name}'; known: {', '.join(self._frames)}")
        return self._frames[name]

    def frame_on_link(self, name: str) -> tuple[str, pin.SE3]:
        """Parent link of a frame in the URDF, and the pose of the frame in the link; raises as ``frame_id``."""
        frame = self.pin.frames[self.frame_id(name)]
        link = self.pin.frames[frame.parentFrame]
        return link.name, link.placement.actInv(frame.placement)

    def posture(self, name: str) -> Vector:
        """Joint positions of a named posture, read-only (nj,) [rad]; ``ConfigError`` lists the known postures."""
        if name not in self._postures:
            raise ConfigError(f"{self.name}: unknown posture '{name}'; known: {', '.join(self._postures)}")
        return self._postures[name]

    def joint_index(self, name: str) -> int:
        """Index in joint vectors of a joint given by name or alias; ``JointNameError`` names the nearest joint."""
        index = self._index.get(name)
        if index is None and (index := self._aliases.get(joint_key(name))) is None:
            near = did_you_mean(name, self.joint_names)
            raise JointNameError(f"{self.name}: unknown joint '{name[:64]}'{near or ':'} `poise joints` lists all")
        return index

    def named(self, names: Iterable[str]) -> tuple[str, ...]:
        """URDF names of joints given by name or alias; raises as ``joint_index``."""
        return tuple(self.joint_names[self.joint_index(name)] for name in names)

    def reorder(self, names: Sequence[str], values: ArrayLike) -> Vector:
        """New array (nj,) of named values in the order of ``joint_names``; ``JointNameError`` unless one per joint."""
        array = np.asarray(values, dtype=np.float64)
        if array.shape != (len(names),):
            raise JointNameError(f"{self.name}: {len(names)} joint names for values of shape {array.shape}")
        result = np.empty(self.nj)
        seen: set[int] = set()
        for name, value in zip(names, array, strict=True):
            index = self.joint_index(name)
            if index in seen:
                raise JointNameError(f"{self.name}: joint '{name}' is given twice")
            seen.add(index)
            result[index] = value
        if len(seen) != self.nj:
            missing = [name for i, name in enumerate(self.joint_names) if i not in seen]
            raise JointNameError(f"{self.name}: joint '{missing[0]}' is missing (of {len(missing)} missing)")
        return result

    def standing_configuration(self, posture: str = "stand") -> Vector:
        """Configuration (nq,) of a posture, midpoint of the soles at the origin, yaw 0; see ``planted``."""
        return self.planted(self.posture(posture), self.data())

    def planted(self, joints: Vector, data: pin.Data) -> Vector:
        """Configuration (nq,) of joint positions (nj,) [rad] with the mean of both sole poses at the origin.

        T_WB = (mean of T_BL and T_BR)^-1; the mean rotation is halfway on the geodesic from left to right.
        """
        q: Vector = pin.neutral(self.pin)
        q[JOINTS_Q:] = joints
        pin.framesForwardKinematics(self.pin, data, q)
        left, right = (data.oMf[foot.frame_id] for foot in self.feet)
        rotation = left.rotation @ pin.exp3(0.5 * pin.log3(left.rotation.T @ right.rotation))
        middle = pin.SE3(rotation, 0.5 * (left.translation + right.translation))
        q[:JOINTS_Q] = pin.SE3ToXYZQUAT(middle.inverse())
        return q

    def static_torques(self, q: Vector, data: pin.Data) -> Vector:
        """Joint torques (nj,) [N.m] that hold a configuration (nq,), with least-norm wrenches on both soles."""
        gravity = pin.computeGeneralizedGravity(self.pin, data, q)
        pin.computeJointJacobians(self.pin, data, q)
        pin.updateFramePlacements(self.pin, data)
        soles = [pin.getFrameJacobian(self.pin, data, foot.frame_id, pin.LOCAL) for foot in self.feet]
        contact = np.vstack(soles)  # (12, nv)
        wrenches = np.linalg.lstsq(contact[:, :JOINTS_V].T, gravity[:JOINTS_V], rcond=None)[0]
        torques: Vector = (gravity - contact.T @ wrenches)[JOINTS_V:]
        return torques

    def _add_frames(self) -> dict[str, int]:
        feet = self.profile.feet
        pair = zip(SOLE_FRAMES, (feet.left, feet.right), strict=True)
        soles = {name: Frame(link=sole.link, xyz=sole.xyz, rpy=sole.rpy) for name, sole in pair}
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
        """Pinocchio id of a URDF link; ``RobotModelError`` for an unknown link, with ``user`` in the message."""
        frame_id = int(self.pin.getFrameId(link, pin.FrameType.BODY))
        if frame_id >= self.pin.nframes:
            raise RobotModelError(f"{self.profile.source}: {user}: link '{link}' does not exist in {self.urdf}")
        return frame_id

    def _add_payload(self) -> None:
        """Change mass and CoM of the torso such that, in 'stand', the robot's CoM shifts by the payload's ``com``."""
        if self.profile.payload == Payload():
            return
        payload, joint = self.profile.payload, self.pin.frames[self.frame_id("torso")].parentJoint
        torso = self.pin.inertias[joint]
        mass = torso.mass + payload.mass
        if not mass > 0.0:
            raise RobotModelError(
                f"{self.profile.source}: payload.mass: with {payload.mass:g} kg the torso has no mass"
            )
        q: Vector = pin.neutral(self.pin)
        q[JOINTS_Q:] = self.posture("stand")
        data = self.data()
        pin.forwardKinematics(self.pin, data, q)
        com = pin.centerOfMass(self.pin, data, q)
        total = pin.computeTotalMass(self.pin) + payload.mass
        moment = total * np.array([*payload.com, 0.0])  # of the shift, minus the contribution of the added mass
        moment[:2] -= payload.mass * (data.oMi[joint].act(torso.lever) - com)[:2]
        lever = torso.lever + data.oMi[joint].rotation.T @ moment / mass
        self.pin.inertias[joint] = pin.Inertia(mass, lever, torso.inertia * mass / torso.mass)

    def _foot(self, index: int, sole: Sole) -> Foot:
        frame_id = self._frames[SOLE_FRAMES[index]]
        other = self.pin.frames[self._frames[SOLE_FRAMES[1 - index]]].parentJoint
        chain = [j for j in self.pin.supports[self.pin.frames[frame_id].parentJoint] if j > 1]
        shared = set(self.pin.supports[other])
        chain_ids = tuple(int(self.pin.joints[j].idx_v) for j in chain)
        ids = tuple(int(self.pin.joints[j].idx_v) for j in chain if j not in shared)
        friction = self.profile.feet.friction
        rest = (), (False, False, False), sole.rectangle  # placeholders until the posture 'stand' is known
        return Foot(FOOT_NAMES[index], sole.link, frame_id, sole.rectangle, friction, ids, chain_ids, *rest)

    def _describe_legs(self) -> None:
        """Set ankle, freedoms and bearing area of each foot in 'stand', with half the weight on each foot."""
        q, data, force = self.standing_configuration(), self.data(), 0.5 * self.mass * GRAVITY
        gravity = pin.computeGeneralizedGravity(self.pin, data, q)
        pin.computeJointJacobians(self.pin, data, q)
        pin.updateFramePlacements(self.pin, data)
        joints, feet = {int(v): j for j, v in enumerate(self.pin.idx_vs) if j > 1}, []
        for foot in self.feet:
            columns = pin.getFrameJacobian(self.pin, data, foot.frame_id, pin.LOCAL)
            leg, ids = columns[:, foot.joint_ids_v], foot.joint_ids_v
            heights = [float(data.oMi[joints[v]].translation[2]) for v in ids]
            self.leg_length = self.leg_length or heights[0]
            ankle = tuple(ankle_joints(leg, ids, heights, heights[0]))
            try:
                free = leg_freedoms(leg, heights[0])
            except RobotModelError as error:
                raise RobotModelError(f"{self.profile.source}: feet.{foot.name}: the leg has {error}") from error
            area = bearing_area(foot.rectangle, ankle, columns, gravity, self.pin.effortLimit, force, rolls=free[0])
            feet.append(replace(foot, ankle=ankle, free=free, bearing=area))
        self.feet = (feet[0], feet[1])

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


def _or_default(value: float | None, default: float) -> float:
    return float(default) if value is None else value


def _frozen(values: Iterable[float] | NDArray[np.float64]) -> Vector:
    array = np.array(list(values), dtype=np.float64)
    array.setflags(write=False)
    return array
