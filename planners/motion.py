"""Motion planning: key poses in, a joint trajectory that the robot can execute on both feet out."""

import math
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from models.config import default_config
from models.errors import CommandError, UnreachableError
from models.robot_model import RobotModel
from models.spline import min_jerk
from models.types import JointTrajectory, Matrix, Vector
from planners.collision import SelfCollision
from planners.goals import TARGET_FRAMES, FrameGoal, PoseGoal, rotation, vector
from planners.key_pose import KeyPoseSolver
from planners.library import START, FrameTarget, KeyPose, Motion, load_library
from planners.motion_config import MotionConfig
from planners.path import blend_time, check_path, smooth_curve
from planners.stance import Stance, stand_on
from planners.whole_body_ik import Bounds, WholeBodyIk

#: Digits kept of planned positions [rad]: placo sums its tasks in the order of their addresses in memory, which changes
#: the last bits of a solution (5e-15 rad measured); rounded, the same request gives the same bits everywhere
_DECIMALS = 9


class MotionPlanner:
    """Plans motions on planted soles; deterministic, no clock, no I/O after construction.

    1. Each key pose is solved by whole-body inverse kinematics (``planners/whole_body_ik.py``), from the one before.
    2. Between key poses, base height and orientation, CoM and the joints outside the legs blend by minimum jerk; the
       same inverse kinematics finds the legs at every sample, so the soles stay planted.
    3. A cubic spline through the samples gives the velocities; the result is checked against every bound once more.

    Args:
        model: The robot.
        config: The packaged ``planners/config/motion.yaml`` when None.
        extra: Motion files beside the packaged ones.

    Raises:
        ConfigError: A configuration or motion file is refused; file and key are named.
        RobotModelError: The URDF's collision meshes cannot be loaded.
    """

    def __init__(
        self, model: RobotModel, config: MotionConfig | None = None, *, extra: Iterable[str | Path] = ()
    ) -> None:
        self._model = model
        self._config = config or default_config(MotionConfig, "planners", "motion")
        self._library = load_library(model, extra)
        self._data = model.data()
        self._collision = SelfCollision(model, self._config.collision)
        self._ik = WholeBodyIk(model, self._config, self._collision)
        self._keys = KeyPoseSolver(model, self._config, self._collision, self._ik)
        self._v_max = self._config.limits.velocity_fraction * model.v_max
        self._nominal = stand_on(model, self._data, model.posture("stand"))
        pin.framesForwardKinematics(model.pin, self._data, self._nominal.q)
        self._places = {name: self._data.oMf[model.frame_id(name)].copy() for name in TARGET_FRAMES}
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
        """One line about a motion; raises ``CommandError`` when there is none of that name."""
        return self._motion(name).description

    def plan(self, name: str, start_q: ArrayLike, *, targets: Mapping[str, ArrayLike] | None = None) -> JointTrajectory:
        """Plan a motion from the library.

        Args:
            name: One of ``names``.
            start_q: Joint positions to start from (nj,) [rad].
            targets: Positions in base_footprint (3,) [m] that replace those of frames the motion marks as settable.

        Returns:
            Trajectory of all joints with velocities, from ``start_q`` at rest to the last key pose at rest.

        Raises:
            CommandError: There is no such motion or settable frame, or a value is malformed; the message names it.
            UnreachableError: A key pose or the way to it violates a bound; the message names what stops it.
        """
        motion = self._motion(name)
        given = self._settable(motion, targets or {})
        stance, bounds = self._begin(start_q)
        goals = [self._goal(f"{name}, key pose '{pose.name}'", pose, stance, given) for pose in motion.key_poses]
        times = [(pose.duration, pose.hold) for pose in motion.key_poses]
        return self._trajectory(goals, times, stance, bounds)

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

        Args:
            frame: base_link, torso, gaze, l_wrist or r_wrist.
            position: Origin of the frame in base_footprint, the mid-point of the soles (3,) [m], or None when free.
            orientation: Quaternion xyzw of the frame in base_footprint (4,), or None when free.
            start_q: Joint positions to start from (nj,) [rad].
            duration: Time to get there [s], more when the joints need it; when None as short as the limits allow, not
                below ``pose.min_duration``.
        """
        if frame not in TARGET_FRAMES:
            raise CommandError(f"frame '{frame}' cannot be moved; these can: {', '.join(TARGET_FRAMES)}")
        if position is None and orientation is None:
            raise CommandError(f"{frame}: give a position, an orientation or both")
        longest = self._config.pose.max_duration
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
        joints = vector(start_q, self._model.nj, "start_q")
        stance = stand_on(self._model, self._data, self._keys.clipped(joints))
        bounds = self._keys.bounds(stance, self._nominal.q[7:])
        self._ik.stand(stance, bounds)
        return stance, bounds

    def _goal(self, name: str, pose: KeyPose, stance: Stance, given: Mapping[str, Vector]) -> PoseGoal:
        posture = np.array(stance.q[7:] if pose.posture == START else self._model.posture(pose.posture))
        for joint, value in pose.prefer.get(self._model.name, {}).items():
            posture[self._model.joint_index(joint)] = value
        targets = pose.joints.get(self._model.name, {})
        return PoseGoal(
            name=name,
            frames=tuple(self._frame_goal(frame, target, given) for frame, target in pose.frames.items()),
            posture=posture,
            com=self._nominal.com[:2],
            base=self._places["base_link"],
            torso=self._places["torso"].rotation,
            joints={self._model.joint_index(joint): value for joint, value in targets.items()},
        )

    def _frame_goal(self, frame: str, target: FrameTarget, given: Mapping[str, Vector]) -> FrameGoal:
        position: Vector | None = None
        rotation: Matrix | None = None
        if target.offset is not None:
            anchor = self._places[target.anchor or frame].translation
            position = anchor + self._units[target.unit] * np.array(target.offset)
        if target.settable and frame in given:
            position = given[frame]
        if target.rpy is not None:
            rotation = pin.rpy.rpyToMatrix(*target.rpy) @ self._places[frame].rotation
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
                f"{at / self._config.sample_rate:.2f} s after the start; the soles leave it no smooth way"
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
