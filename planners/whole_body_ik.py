"""Whole-body inverse kinematics on planted soles, solved by placo as a sequence of quadratic programs.

Each step solves, for the displacement dq of base and joints,

    min  sum_i w_i || J_i dq - e_i ||^2 + w_d || dq ||^2
    s.t. J_sole dq = e_sole                  both soles stay where they are            (12 rows)
         q_lower + m <= q + dq <= q_upper - m  joint limits with a margin              (nj rows)
         | dq | <= step                      trust region of the linearisation         (nj rows)
         A (c + J_c dq) <= b - m_c           CoM above the shrunken support polygon    (one row an edge)
         d_k + n_k^T (J_kB - J_kA) dq >= m_d bodies of the robot that come close       (one row a pair)

and applies it until nothing moves. e_i is the error of task i and w_i its weight (``planners/config/motion.yaml``).

References:
    O. Kanoun, F. Lamiraux, P.-B. Wieber, "Kinematic control of redundant manipulators: generalizing the task-priority
    framework to inequality tasks", IEEE T-RO 2011.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import placo

from models.robot_model import SOLE_FRAMES, RobotModel
from models.types import Matrix, Vector
from planners.collision import SelfCollision, hull_geometry
from planners.goals import TARGET_FRAMES, PoseGoal
from planners.motion_config import MotionConfig
from planners.placo_robot import PREFIX, placo_robot
from planners.stance import Stance

_ALL_AXES = "xyz"


@dataclass(frozen=True, slots=True)
class Bounds:
    """What a solution has to respect on one stance.

    Attributes:
        lower, upper: Joint limits, margins included (nj,) [rad].
        com_margin: Distance of the CoM from the edge of the support polygon [m].
        gaps: Distance that each pair of bodies keeps (pairs,) [m].
    """

    lower: Vector
    upper: Vector
    com_margin: float
    gaps: Vector


def chain(model: RobotModel, frame: str) -> frozenset[int]:
    """Joints between the base and a frame, as indices of a joint vector."""
    joint = model.pin.frames[model.frame_id(frame)].parentJoint
    return frozenset(int(model.pin.joints[j].idx_v) - 6 for j in model.pin.supports[joint] if j > 1)


class WholeBodyIk:
    """Key poses and the configurations between them.

    Tasks are created once and switched by their weights: placo sums tasks in the order of their addresses, so that
    creating them anew for each problem would make results differ in their last bits.

    Args:
        model: The robot.
        config: Tolerances and weights.
        collision: Its self-collision pairs.
    """

    def __init__(self, model: RobotModel, config: MotionConfig, collision: SelfCollision) -> None:
        self._model = model
        self._config = config
        self._legs = frozenset(i - 6 for foot in model.feet for i in foot.joint_ids_v)
        self._chains = {name: chain(model, name) for name in TARGET_FRAMES}
        self._collision = collision
        self._robot = placo_robot(model)
        for body in hull_geometry(self._robot.model, str(model.urdf)).geometryObjects:
            self._robot.collision_model.addGeometryObject(body)
        solver = self._solver = self._robot.make_solver()
        self._soles = [self._frame_task(name, "hard") for name in SOLE_FRAMES]
        self._frames = {name: self._frame_task(name, "soft") for name in TARGET_FRAMES}
        self._com = solver.add_com_task(self._robot.com_world())
        self._com.mask.set_axises("xy", "task")
        self._joints = [solver.add_joints_task() for _ in model.joint_names]
        solver.add_regularization_task(config.weights.damping)
        self._polygon = solver.add_com_polygon_constraint([np.zeros(2)] * 3, 0.0)
        self._polygon.configure("CoM", "hard")
        self._avoid = solver.add_avoid_self_collisions_constraint()
        self._avoid.configure("self-collision", "hard")
        self._avoid.self_collisions_margin = config.collision.margin
        self._avoid.self_collisions_trigger = config.collision.trigger
        self._robot.set_velocity_limits(1.0)
        solver.dt = config.solver.step  # with unit velocity limits, dt is the largest step of a joint
        solver.enable_joint_limits(True)
        solver.enable_velocity_limits(True)

    def _frame_task(self, name: str, priority: str) -> placo.FrameTask:
        task = self._solver.add_frame_task(PREFIX + name, self._robot.get_T_world_frame(PREFIX + name))
        task.configure(name, priority, 1.0, 1.0)
        return task

    def stand(self, stance: Stance, bounds: Bounds) -> None:
        """Plant the soles and set the bounds of every problem to come."""
        for task, sole in zip(self._soles, stance.soles, strict=True):
            task.T_world_frame = sole.homogeneous
        self._polygon.polygon = list(stance.polygon[::-1].copy())  # placo wants it clockwise
        self._polygon.margin = bounds.com_margin
        for i, name in enumerate(self._model.joint_names):
            self._robot.set_joint_limits(name, float(bounds.lower[i]), float(bounds.upper[i]))

    def reach(self, goal: PoseGoal, seed: Vector, avoid: list[int], habits: float = 1.0) -> Vector | None:
        """Solve one key pose.

        Args:
            goal: The key pose.
            seed: Configuration to start from (nq,) [m, rad].
            avoid: Pairs of ``SelfCollision`` to keep apart.
            habits: Factor on the weights of what is not a target of the key pose: CoM, base, torso and posture.

        Returns:
            The configuration that comes closest (nq,) [m, rad]; None when placo's QP has no solution.
        """
        weights = self._config.weights
        named = {frame.frame: frame for frame in goal.frames}
        for name, task in self._frames.items():
            target = named.get(name)
            pose = goal.base.homogeneous.copy()
            axes, position, orientation = _ALL_AXES, 0.0, 0.0
            if name == "base_link":
                axes, position, orientation = "z", habits * weights.base_height, habits * weights.base_orientation
            elif name == "torso":
                pose[:3, :3] = goal.torso
                orientation = habits * weights.torso_orientation
            if target is not None and target.position is not None:
                pose[:3, 3] = target.position
                axes, position = target.axes, weights.target_position
            if target is not None and target.rotation is not None:
                pose[:3, :3] = target.rotation
                orientation = weights.target_orientation
            self._aim(task, name, pose, axes, position, orientation)
        self._com.target_world = np.array([*goal.com, 0.0])
        self._com.configure("CoM", "soft", habits * weights.com)
        busy = frozenset[int]().union(*(self._chains[name] for name in named))
        for i in range(self._model.nj):
            habit = weights.leg_posture if i in self._legs else weights.posture if i in busy else weights.idle_posture
            wanted = goal.joints.get(i)
            self._aim_joint(
                i,
                float(goal.posture[i]) if wanted is None else wanted,
                habits * habit if wanted is None else weights.target_joint,
            )
        self._set_pairs(avoid)
        self._robot.state.q = seed.copy()
        self._robot.update_kinematics()
        return self._iterate(self._config.solver.max_iterations)

    def follow(self, joints: Vector, base: pin.SE3, com: Vector, seed: Vector) -> Vector | None:
        """Configuration between two key poses: the legs are chosen, all the rest is given.

        Twelve rows of planted soles, three of the base's orientation, one of its height, two of the CoM and one for
        each joint outside the legs determine a robot with six-joint legs completely; more joints follow ``joints``.

        Args:
            joints: Joint positions; those of the legs are a hint only (nj,) [rad].
            base: Pose of base_link; of its position only the height counts.
            com: CoM in base_footprint (2,) [m].
            seed: A configuration near by (nq,) [m, rad].

        Returns:
            The configuration (nq,) [m, rad]; None when placo's QP has no solution.
        """
        for name, task in self._frames.items():
            weight = 1.0 if name == "base_link" else 0.0
            self._aim(task, name, base.homogeneous, "z" if weight else _ALL_AXES, weight, weight)
        self._com.target_world = np.array([*com, 0.0])
        self._com.configure("CoM", "soft", 1.0)
        for i in range(self._model.nj):
            self._aim_joint(i, float(joints[i]), self._config.weights.leg_posture if i in self._legs else 1.0)
        self._set_pairs([])
        self._robot.state.q = seed.copy()
        self._robot.update_kinematics()
        return self._iterate(self._config.solver.path_iterations)

    def _aim(
        self, task: placo.FrameTask, name: str, pose: Matrix, axes: str, position: float, orientation: float
    ) -> None:
        task.T_world_frame = pose
        task.position().mask.set_axises(axes, "task")
        task.configure(name, "soft", position, orientation)

    def _aim_joint(self, index: int, target: float, weight: float) -> None:
        name = self._model.joint_names[index]
        self._joints[index].set_joint(name, target)
        self._joints[index].configure(name, "soft", weight)

    def _set_pairs(self, pairs: list[int]) -> None:
        geometry = self._robot.collision_model
        geometry.removeAllCollisionPairs()
        for pair in pairs:
            geometry.addCollisionPair(pin.CollisionPair(*self._collision.bodies(pair)))

    def _iterate(self, most: int) -> Vector | None:
        for _ in range(most):
            try:
                step = self._solver.solve(True)
            except RuntimeError:  # placo's QPError; its bindings raise it as this
                return None
            self._robot.update_kinematics()
            if np.abs(step).max() < self._config.solver.settled:
                break
        return np.array(self._robot.state.q)
