"""Motion planning: joint trajectories through key poses, on both feet."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from models.config import default_config
from models.errors import CommandError, UnreachableError
from models.robot_model import RobotModel
from models.spline import blend_time, min_jerk
from models.types import JointTrajectory, Matrix, Vector
from planners.collision import SelfCollision
from planners.goals import TARGET_FRAMES, FrameGoal, PoseGoal, Stance, plant, rotation, stand_on, tilt_of, vector
from planners.key_pose import KeyPoseSolver
from planners.library import SIDES, START, FrameTarget, KeyPose, Motion, load_library, mirrored
from planners.motion_config import MotionConfig
from planners.whole_body_ik import Bounds, WholeBodyIk, arms, chain

STAND = "stand"  #: Motion that may start with soles that are not on one plane
_PITCH = 0.5  #: Least lateral component of the axis of a waist joint that pitches the torso [-]
_ROUNDING = 1e-6  #: Tolerance of the joint limits and the base tilt [rad]
_SLACK = 1e-3  #: Tolerance of the CoM margin; the solver iterates to convergence at key poses only [m]


@dataclass(frozen=True, slots=True)
class JointCurve:
    """Sampled joint motion."""

    times: Vector  # (n,) [s]
    q: Matrix  # (n, nj) [rad]
    v: Matrix  # (n, nj) [rad/s]
    a: Matrix  # (n, nj) [rad/s^2]


def smooth_curve(q: Matrix, rate: float, v_max: Vector, a_max: float) -> tuple[JointCurve, float]:
    """C2 curve through points (n, nj) at a rate [Hz], slowed as a whole to keep the limits, and the slowdown factor."""
    times = np.arange(len(q)) / rate
    spline = CubicSpline(times, q, bc_type="clamped")
    v, a = spline(times, 1), spline(times, 2)
    v[0] = v[-1] = 0.0
    slower = max(1.0, float((np.abs(v) / v_max).max()), math.sqrt(float(np.abs(a).max()) / a_max))
    return JointCurve(times * slower, q, v / slower, a / slower**2), slower


def check_path(
    model: RobotModel,
    config: MotionConfig,
    collision: SelfCollision,
    stance: Stance,
    bounds: Bounds,
    curve: JointCurve,
) -> None:
    """Check a motion against all bounds; ``UnreachableError`` names the time and the violated bound."""
    names = model.joint_names
    outside = np.maximum(bounds.lower - curve.q, curve.q - bounds.upper)  # (n, nj)
    if outside.max() > _ROUNDING:
        i, k = divmod(int(outside.argmax()), len(names))
        raise UnreachableError(
            f"after {curve.times[i]:.2f} s joint '{names[k]}' would be at {curve.q[i, k]:.4g} rad, outside "
            f"[{bounds.lower[k]:.4g}, {bounds.upper[k]:.4g}]"
        )
    data = model.data()
    between = stance.soles[0].actInv(stance.soles[1])
    every = max(1, round(config.sample_rate / config.collision.check_rate))
    for i, (time, joints) in enumerate(zip(curve.times, curve.q, strict=True)):
        q, soles = plant(model, data, joints)
        change = between.actInv(soles[0].actInv(soles[1]))
        slip, turn = float(np.linalg.norm(change.translation)), float(np.linalg.norm(pin.log3(change.rotation)))
        if slip > config.balance.sole_drift or turn > config.balance.sole_turn:
            raise UnreachableError(
                f"after {time:.2f} s the relative motion of the soles would be {slip:.4f} m and {turn:.4f} rad: no "
                "leg posture within the joint limits keeps both planted"
            )
        if (tilt := tilt_of(q)) > bounds.base_tilt + _ROUNDING:
            raise UnreachableError(
                f"after {time:.2f} s the base would tilt by {tilt:.2f} rad, at most {bounds.base_tilt:.2f} rad"
            )
        margin = stance.margin(np.array(pin.centerOfMass(model.pin, data, q)))
        if margin < bounds.com_margin - _SLACK:
            raise UnreachableError(
                f"after {time:.2f} s the CoM would be {margin:.3f} m inside the support polygon, at least "
                f"{bounds.com_margin:.3f} m"
            )
        if i % every != 0 and i != len(curve.times) - 1:
            continue
        shares = np.abs(model.static_torques(q, data)) / model.tau_max
        if shares.max() > config.balance.torque_share:
            k = int(shares.argmax())
            raise UnreachableError(
                f"after {time:.2f} s joint '{names[k]}' would bear {shares[k] * model.tau_max[k]:.3g} N.m, at most "
                f"{config.balance.torque_share * model.tau_max[k]:.3g} of its {model.tau_max[k]:.3g} N.m"
            )
        check_distances(config, collision, bounds.gaps, time, q)


def check_distances(config: MotionConfig, collision: SelfCollision, gaps: Vector, time: float, q: Vector) -> None:
    """``UnreachableError`` if bodies are closer than ``gaps`` less ``path_slack`` [m] at ``q`` (nq,), ``time`` [s]."""
    if not collision.count:
        return
    distances = collision.distances(q, config.collision.margin)
    allowed = gaps - config.collision.path_slack
    pair = int((distances - allowed).argmin())
    if distances[pair] < allowed[pair]:
        raise UnreachableError(
            f"after {time:.2f} s '{' and '.join(collision.names(pair))}' would collide "
            f"({distances[pair]:.3f} m apart, at least {allowed[pair]:.3f} m)"
        )


#: Decimals of planned positions [rad]. placo sums its tasks in the order of their memory addresses, which changes the
#: last bits of a solution (5e-15 rad measured). After rounding, equal requests give equal bits.
_DECIMALS = 9


class SizedMotion(NamedTuple):
    """A planned motion."""

    trajectory: JointTrajectory
    size: float  #: Share of the motion's offsets and angles that is planned [-]

    @property
    def reduced(self) -> str:
        """Text that describes the reduction; empty for a motion of full size."""
        return "" if self.size == 1.0 else f"at {100.0 * self.size:.0f} % of its size, limited by reach and torques"


class MotionPlanner:
    """Plans motions on planted soles; deterministic, no clock, no I/O after construction.

    1. Whole-body inverse kinematics (``planners/whole_body_ik.py``) solves each key pose, starting from the last one.
    2. Between key poses, base height and orientation, CoM and the joints outside the legs follow a minimum-jerk
       profile. The same inverse kinematics solves for the legs at every sample, so the soles stay planted.
    3. A cubic spline through the samples gives the velocities. The result is checked against every bound.

    Motion files are written for the reach of human limbs. If the robot cannot reach that far, all offsets and angles
    of the motion are reduced by one factor (``size`` in ``motion.yaml``). A motion of the right hand is mirrored for a
    robot that has only a left arm, and vice versa. Targets of a caller are not changed.

    A start with soles that are not on one plane, for example after a trajectory of one leg, is refused. The motion
    ``stand`` is an exception: its path is straight in joint space, and only joint limits and distances bound it.

    ``config`` is the packaged one when None; ``extra`` are additional motion files. Raises ``ConfigError`` for an
    invalid file, ``RobotModelError`` if the URDF's collision meshes cannot be loaded.
    """

    def __init__(
        self, model: RobotModel, config: MotionConfig | None = None, *, extra: Iterable[str | Path] = ()
    ) -> None:
        self._model = model
        self._config = config or default_config(MotionConfig, "planners", "motion")
        self._arms = arms(model)
        self._library = {name: self._for_arms(motion) for name, motion in load_library(model, extra).items()}
        self._data = model.data()
        self._collision = SelfCollision(model, self._config.collision)
        self._ik = WholeBodyIk(model, self._config, self._collision)
        self._keys = KeyPoseSolver(model, self._config, self._collision, self._ik)
        least, step = self._config.size.least, self._config.size.step
        self._sizes = [round(1.0 - k * step, 6) for k in range(1 + int((1.0 - least) / step + _ROUNDING))]
        self._v_max = self._config.limits.velocity_fraction * model.v_max
        self._nominal = stand_on(model, self._data, model.posture("stand"))
        pin.framesForwardKinematics(model.pin, self._data, self._nominal.q)
        self._places = {name: self._data.oMf[model.frame_id(name)].copy() for name in TARGET_FRAMES}
        jacobian = pin.computeJointJacobians(model.pin, self._data, self._nominal.q)
        self._bends = any(abs(jacobian[4, 6 + i]) > _PITCH for i in chain(model, "torso"))
        self._units = {
            "m": 1.0,
            "leg": float(self._places["base_link"].translation[2]),
            "stature": float(self._places["gaze"].translation[2]),
        }

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the motions, sorted."""
        return tuple(self._library)

    def describe(self, name: str) -> str:
        """One-line description of a motion; ``CommandError`` for an unknown name."""
        return self._motion(name).description

    def plan(self, name: str, start_q: ArrayLike, *, targets: Mapping[str, ArrayLike] | None = None) -> JointTrajectory:
        """Plan a motion of the library, one of ``names``, from rest at joint positions ``start_q`` (nj,) [rad] to rest.

        ``targets`` are positions (3,) [m] in base_footprint, by frame that the motion marks as settable. Raises
        ``CommandError`` for an unknown motion or frame or a malformed value. Raises ``UnreachableError``, which names
        the cause, if a key pose or the path to it violates a bound, or if the robot has no arm for the motion.
        """
        return self.plan_sized(name, start_q, targets=targets).trajectory

    def plan_sized(
        self, name: str, start_q: ArrayLike, *, targets: Mapping[str, ArrayLike] | None = None
    ) -> SizedMotion:
        """Like ``plan``, and returns the size of the motion."""
        motion = self._motion(name)
        given = self._settable(motion, targets or {})
        self._refuse_without_arm(motion)
        if name == STAND and self._keys.unplanted(start := self._stance(start_q)):
            return SizedMotion(self._straighten(start, motion.key_poses[-1].duration), 1.0)
        stance, bounds = self._begin(start_q)
        times = [(pose.duration, pose.hold) for pose in motion.key_poses]
        refusals: list[UnreachableError] = []
        for size in (1.0,) if given else self._sizes:
            goals = [
                self._goal(f"{name}, key pose '{pose.name}'", pose, stance, given, size) for pose in motion.key_poses
            ]
            try:
                return SizedMotion(self._trajectory(goals, times, stance, bounds), size)
            except UnreachableError as error:
                refusals.append(error)
        raise refusals[0]

    def plan_pose(
        self,
        frame: str,
        position: ArrayLike | None,
        orientation: ArrayLike | None = None,
        *,
        start_q: ArrayLike,
        duration: float | None = None,
    ) -> JointTrajectory:
        """Plan a motion that brings one frame to a pose and stays there; result and errors as for ``plan``.

        ``frame`` is base_link, torso, gaze, l_wrist or r_wrist. ``position`` (3,) [m] and ``orientation`` (quaternion
        xyzw) are in base_footprint, midway between the soles; None leaves one free. The motion takes ``duration`` [s],
        or longer if the joints need it. None: as short as the limits allow, but at least ``pose.min_duration``.
        """
        if frame not in TARGET_FRAMES:
            raise CommandError(f"frame '{frame}' cannot be moved; these can: {', '.join(TARGET_FRAMES)}")
        if position is None and orientation is None:
            raise CommandError(f"{frame}: give a position, an orientation or both")
        longest = self._config.pose.duration_max
        if duration is not None and not 0.0 < duration <= longest:  # NaN fails too
            raise CommandError(f"duration: {duration} s is not a time of more than 0 and at most {longest:g} s")
        place = None if position is None else vector(position, 3, f"{frame}: position")
        turn = None if orientation is None else rotation(orientation, f"{frame}: orientation")
        stance, bounds = self._begin(start_q)
        pin.framesForwardKinematics(self._model.pin, self._data, stance.q)
        base, torso = (self._data.oMf[self._model.frame_id(name)].copy() for name in ("base_link", "torso"))
        goal = PoseGoal(
            name=f"pose of {frame}",
            frames=(FrameGoal(frame, place, "xyz", turn),),
            posture=stance.q[7:],
            com=stance.com[:2],
            base=base,
            torso=torso.rotation,
        )
        return self._trajectory([goal], [(duration or self._config.pose.min_duration, 0.0)], stance, bounds)

    def _for_arms(self, motion: Motion) -> Motion:
        """The motion, or its mirror image if the robot has the arms for the mirror image only."""
        hands = {frame for pose in motion.key_poses for frame in pose.frames} & set(SIDES)
        mirror = not hands <= self._arms and {SIDES[frame] for frame in hands} <= self._arms
        return mirrored(motion) if mirror else motion

    def _motion(self, name: str) -> Motion:
        if name not in self._library:
            raise CommandError(f"unknown motion '{name}'; known: {', '.join(self.names)}")
        return self._library[name]

    def _settable(self, motion: Motion, targets: Mapping[str, ArrayLike]) -> dict[str, Vector]:
        for frame in targets:
            if frame not in motion.settable_frames:
                known = ", ".join(motion.settable_frames) or "none"
                raise CommandError(f"{motion.name}: '{frame}' cannot be set; these can: {known}")
        return {frame: vector(value, 3, f"{motion.name}: {frame}") for frame, value in targets.items()}

    def _begin(self, start_q: ArrayLike) -> tuple[Stance, Bounds]:
        """Stance and bounds of a start posture; raises if no motion may start there."""
        stance = self._stance(start_q)
        bounds = self._keys.bounds(stance, self._nominal.q[7:])
        self._ik.stand(stance, bounds)
        return stance, bounds

    def _stance(self, start_q: ArrayLike) -> Stance:
        joints = vector(start_q, self._model.nj, "start_q")
        return stand_on(self._model, self._data, self._keys.clipped(joints))

    def _straighten(self, stance: Stance, duration: float) -> JointTrajectory:
        """Straight path in joint space to 'stand' in ``duration`` [s], or longer if the joints need it."""
        limits, rate, start = self._config.limits, self._config.sample_rate, stance.q[7:]
        gaps = self._keys.gaps(stance.q)
        change = self._nominal.q[7:] - start
        steps = math.ceil(max(duration, blend_time(change, self._v_max, limits.acceleration)) * rate)
        shares = np.array([min_jerk(k / steps)[0] for k in range(steps + 1)])
        curve, _ = smooth_curve(start + shares[:, None] * change, rate, self._v_max, limits.acceleration)
        for time, joints in zip(curve.times, curve.q, strict=True):
            check_distances(self._config, self._collision, gaps, time, plant(self._model, self._data, joints)[0])
        return JointTrajectory(self._model.joint_names, curve.times, curve.q, curve.v)

    def _refuse_without_arm(self, motion: Motion) -> None:
        for frame in sorted({frame for pose in motion.key_poses for frame in pose.frames} & set(SIDES)):
            if frame not in self._arms:
                raise UnreachableError(
                    f"{motion.name} moves {frame}, and {self._model.name} has no such arm: no joint moves it "
                    "relative to the torso"
                )

    def _goal(self, name: str, pose: KeyPose, stance: Stance, given: Mapping[str, Vector], size: float) -> PoseGoal:
        posture = np.array(stance.q[7:] if pose.posture == START else self._model.posture(pose.posture))
        for joint, value in pose.prefer.get(self._model.name, {}).items():
            posture[self._model.joint_index(joint)] = value
        targets = pose.joints.get(self._model.name, {})
        frames = dict(pose.frames)
        if not self._bends and {"base_link", "torso"} <= set(frames):  # no waist pitch: the base turns with the torso
            base = frames.pop("base_link")
            if base.offset is not None:
                frames["base_link"] = replace(base, rpy=None)
        return PoseGoal(
            name=name,
            frames=tuple(self._frame_goal(frame, target, given, size) for frame, target in frames.items()),
            posture=posture,
            com=self._nominal.com[:2],
            base=self._places["base_link"],
            torso=self._places["torso"].rotation,
            joints={self._model.joint_index(joint): value for joint, value in targets.items()},
        )

    def _frame_goal(self, frame: str, target: FrameTarget, given: Mapping[str, Vector], size: float) -> FrameGoal:
        position: Vector | None = None
        rotation: Matrix | None = None
        if target.offset is not None:
            anchor, place = self._places[target.anchor or frame].translation, self._places[frame].translation
            position = place + size * (anchor + self._units[target.unit] * np.array(target.offset) - place)
        if target.settable and frame in given:
            position = given[frame]
        if target.rpy is not None:
            rotation = pin.rpy.rpyToMatrix(*(size * np.array(target.rpy))) @ self._places[frame].rotation
        return FrameGoal(frame, position, target.axes, rotation)

    def _trajectory(
        self, goals: list[PoseGoal], times: list[tuple[float, float]], stance: Stance, bounds: Bounds
    ) -> JointTrajectory:
        rows: list[Vector] = [stance.q]
        for goal, (duration, hold) in zip(goals, times, strict=True):
            end = self._keys.solve(goal, rows[-1], stance, bounds)
            change = end[7:] - rows[-1][7:]
            shortest = blend_time(change, self._v_max, self._config.limits.acceleration)
            rows += self._blend(goal.name, rows[-1], end, max(duration, shortest))
            rows += [rows[-1]] * round(hold * self._config.sample_rate)
        joints = np.array(rows)[:, 7:]
        joints[1:] = joints[1:].round(_DECIMALS)
        limits = self._config.limits
        curve, slower = smooth_curve(joints, self._config.sample_rate, self._v_max, limits.acceleration)
        if slower > limits.slowdown:
            at, joint = divmod(int(np.abs(curve.a).argmax()), self._model.nj)
            raise UnreachableError(
                f"{goals[0].name}: joint '{self._model.joint_names[joint]}' would have to jump "
                f"{at / self._config.sample_rate:.2f} s after the start; no smooth path keeps the soles planted"
            )
        check_path(self._model, self._config, self._collision, stance, bounds, curve)
        return JointTrajectory(self._model.joint_names, curve.times, curve.q, curve.v)

    def _blend(self, name: str, start: Vector, end: Vector, duration: float) -> list[Vector]:
        """Configurations after ``start`` up to and including ``end``, one for each sample."""
        base, com = [], []
        for key in (start, end):
            base.append(pin.XYZQUATToSE3(key[:7]))
            com.append(np.array(pin.centerOfMass(self._model.pin, self._data, key)[:2]))
        turn = pin.log3(base[0].rotation.T @ base[1].rotation)
        steps = math.ceil(duration * self._config.sample_rate)
        rows: list[Vector] = []
        seed = start
        for k in range(1, steps + 1):
            s = min_jerk(k / steps)[0]
            joints = (1.0 - s) * start[7:] + s * end[7:]
            place = pin.SE3(base[0].rotation @ pin.exp3(s * turn), (1.0 - s) * start[:3] + s * end[:3])
            q = self._ik.follow(joints, place, (1.0 - s) * com[0] + s * com[1], seed)
            if q is None:
                raise UnreachableError(
                    f"{name}: on the way there, after {k / self._config.sample_rate:.2f} s, no leg posture keeps the "
                    "soles planted within the joint limits and the CoM above the support polygon"
                )
            rows.append(q)
            seed = q
        return rows
