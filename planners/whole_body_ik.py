"""Whole-body inverse kinematics on planted soles, solved by placo as a sequence of quadratic programs.

Each step solves, for the displacement dq of base and joints,

    min  sum_i w_i || J_i dq - e_i ||^2 + w_d || dq ||^2
    s.t. J_sole dq = e_sole                  both soles stay planted                   (12 rows)
         q_lower + m <= q + dq <= q_upper - m  joint limits with a margin              (nj rows)
         | dq | <= step                      trust region of the linearisation         (nj rows)
         A (c + J_c dq) <= b - m_c           CoM above the shrunken support polygon    (one row per edge)
         d_k + n_k^T (J_kB - J_kA) dq >= m_d distance of bodies that come close        (one row per pair)

and applies it until convergence. e_i is the error of task i and w_i its weight (``planners/config/motion.yaml``).

References:
    O. Kanoun, F. Lamiraux, P.-B. Wieber, "Kinematic control of redundant manipulators: generalizing the task-priority
    framework to inequality tasks", IEEE T-RO 2011.
"""

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import placo

from models.errors import RobotModelError
from models.robot_model import SOLE_FRAMES, RobotModel
from models.types import Matrix, Vector
from models.urdf import read_urdf
from planners.collision import SelfCollision, hull_geometry
from planners.goals import TARGET_FRAMES, PoseGoal, Stance
from planners.motion_config import MotionConfig

_ALL_AXES = "xyz"

PREFIX = "motion/"  #: Prefix of REP-120 names in placo's model; a link of the URDF may already have such a name
_AGREEMENT = 1e-9  #: Largest difference of frames and CoM between both models, for rounding of printed numbers [m]


@dataclass(frozen=True, slots=True)
class Bounds:
    """Bounds of a solution on one stance."""

    lower: Vector  # joint limits, margins included (nj,) [rad]
    upper: Vector
    com_margin: float  # distance of the CoM from the edge of the support polygon [m]
    base_tilt: float  # largest tilt of the base from upright [rad]
    gaps: Vector  # least distance of each pair of bodies (pairs,) [m]


def chain(model: RobotModel, frame: str) -> frozenset[int]:
    """Joints between the base and a frame, as indices of a joint vector."""
    joint = model.pin.frames[model.frame_id(frame)].parentJoint
    return frozenset(int(model.pin.joints[j].idx_v) - 6 for j in model.pin.supports[joint] if j > 1)


def arms(model: RobotModel) -> frozenset[str]:
    """Hands that a joint moves relative to the torso: ``l_wrist``, ``r_wrist``, both or none."""
    return frozenset(hand for hand in ("l_wrist", "r_wrist") if chain(model, hand) - chain(model, "torso"))


class WholeBodyIk:
    """Solves for key poses and for the configurations between them.

    Tasks are created once and switched by their weights. placo sums tasks in the order of their addresses, so new
    tasks for each problem would change the last bits of the results.
    """

    def __init__(self, model: RobotModel, config: MotionConfig, collision: SelfCollision) -> None:
        self._model = model
        self._config = config
        self._legs = frozenset(i - 6 for foot in model.feet for i in foot.joint_ids_v)
        self._chains = {name: chain(model, name) for name in TARGET_FRAMES}
        self._collision = collision
        self._robot = placo_robot(model)
        for body in hull_geometry(self._robot.model, model.urdf).geometryObjects:
            self._robot.collision_model.addGeometryObject(body)
        solver = self._solver = self._robot.make_solver()
        self._soles = [self._frame_task(name, "hard") for name in SOLE_FRAMES]
        self._turns: dict[int, placo.OrientationTask] = {}
        for i, (foot, sole) in enumerate(zip(model.feet, self._soles, strict=True)):
            if any(foot.free):  # the other rows determine these rotations: more hard rows would conflict
                axes = dict(zip("xyz", foot.free, strict=True))
                sole.orientation().mask.set_axises("".join(axis for axis in axes if not axes[axis]), "local")
                self._turns[i] = task = solver.add_orientation_task(PREFIX + SOLE_FRAMES[i], np.eye(3))
                task.mask.set_axises("".join(axis for axis in axes if axes[axis]), "local")
                task.configure(f"turn of {foot.name} sole", "soft", config.weights.target_orientation)
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
        """Plant the soles and set the bounds of all following problems."""
        for task, sole in zip(self._soles, stance.soles, strict=True):
            task.T_world_frame = sole.homogeneous
        for i, turn in self._turns.items():
            turn.R_world_frame = stance.soles[i].rotation
        self._polygon.polygon = list(stance.polygon[::-1].copy())  # clockwise in placo
        self._polygon.margin = bounds.com_margin
        for i, name in enumerate(self._model.joint_names):
            self._robot.set_joint_limits(name, float(bounds.lower[i]), float(bounds.upper[i]))

    def reach(self, goal: PoseGoal, seed: Vector, avoid: list[int], habits: float = 1.0) -> Vector | None:
        """Configuration (nq,) closest to a key pose; None if placo's QP has no solution.

        Args:
            goal: The key pose.
            seed: Configuration to start from (nq,) [m, rad].
            avoid: Pairs of ``SelfCollision`` to keep apart.
            habits: Factor on the weights other than those of the targets: CoM, base, torso and posture.
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
            target_joint = goal.joints.get(i)
            self._aim_joint(
                i,
                float(goal.posture[i]) if target_joint is None else target_joint,
                habits * habit if target_joint is None else weights.target_joint,
            )
        return self._iterate(seed, avoid, self._config.solver.iterations_max)

    def follow(self, joints: Vector, base: pin.SE3, com: Vector, seed: Vector) -> Vector | None:
        """Configuration (nq,) between two key poses, solved for the legs only; None if the QP has no solution.

        Twelve rows of planted soles, three of the base orientation, one of the base height, two of the CoM and one for
        each joint outside the legs determine a robot with six-joint legs. More leg joints follow ``joints``.

        Args:
            joints: Joint positions; those of the legs have a low weight (nj,) [rad].
            base: Pose of base_link; only the height of its position is used.
            com: CoM in base_footprint (2,) [m].
            seed: Configuration to start from, close to the solution (nq,) [m, rad].
        """
        for name, task in self._frames.items():
            weight = 1.0 if name == "base_link" else 0.0
            self._aim(task, name, base.homogeneous, "z" if weight else _ALL_AXES, weight, weight)
        self._com.target_world = np.array([*com, 0.0])
        self._com.configure("CoM", "soft", 1.0)
        for i in range(self._model.nj):
            self._aim_joint(i, float(joints[i]), self._config.weights.leg_posture if i in self._legs else 1.0)
        return self._iterate(seed, [], self._config.solver.path_iterations)

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

    def _iterate(self, seed: Vector, avoid: list[int], most: int) -> Vector | None:
        """Configuration (nq,) after at most ``most`` iterations that keep the pairs ``avoid`` apart, or None."""
        self._set_pairs(avoid)
        self._robot.state.q = seed.copy()
        self._robot.update_kinematics()
        for _ in range(most):
            try:
                step = self._solver.solve(True)
            except RuntimeError:  # how placo's bindings raise its QPError
                return None
            self._robot.update_kinematics()
            if np.abs(step).max() < self._config.solver.settled:
                break
        return np.array(self._robot.state.q)


def placo_robot(model: RobotModel) -> placo.RobotWrapper:
    """Robot of placo without collision bodies, in the posture 'stand'; REP-120 frames are named ``PREFIX`` + name.

    Raises:
        RobotModelError: placo and Pinocchio disagree on the URDF.
    """
    robot = bare_robot(model, {PREFIX + name: model.frame_on_link(name) for name in (*SOLE_FRAMES, *TARGET_FRAMES)})
    torso = model.pin.frames[model.frame_id("torso")].parentJoint
    robot.model.inertias[torso] = model.pin.inertias[torso]  # with the payload of the profile
    robot.state.q = model.standing_configuration()
    robot.update_kinematics()
    data = model.data()
    pin.framesForwardKinematics(model.pin, data, robot.state.q)
    gaps = {
        name: np.abs(robot.get_T_world_frame(PREFIX + name) - data.oMf[model.frame_id(name)].homogeneous).max()
        for name in (*SOLE_FRAMES, *TARGET_FRAMES)
    }
    gaps["CoM"] = np.abs(robot.com_world() - pin.centerOfMass(model.pin, data, robot.state.q)).max()
    for name, gap in gaps.items():
        if gap > _AGREEMENT:
            raise RobotModelError(f"{model.urdf}: placo and Pinocchio disagree on {name} by {gap:.3g}")
    return robot


def bare_robot(model: RobotModel, frames: Mapping[str, tuple[str, pin.SE3]]) -> placo.RobotWrapper:
    """Robot of placo without shapes, with a link for each of ``frames``: name to parent link and pose in it.

    Raises ``RobotModelError`` if placo orders the joints differently from Pinocchio.
    """
    root = read_urdf(model.urdf)
    for link in root.findall("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            link.remove(shape)
    for name, (parent, placement) in frames.items():
        ET.SubElement(root, "link", name=name)
        joint = ET.SubElement(root, "joint", name=f"{name}_joint", type="fixed")
        ET.SubElement(joint, "parent", link=parent)
        ET.SubElement(joint, "child", link=name)
        xyz, rpy = placement.translation, pin.rpy.matrixToRpy(placement.rotation)
        ET.SubElement(joint, "origin", xyz=_printed(xyz), rpy=_printed(rpy))
    robot = placo.RobotWrapper("", placo.Flags.ignore_collisions, ET.tostring(root, encoding="unicode"))
    if tuple(robot.joint_names()) != model.joint_names:
        raise RobotModelError(f"{model.urdf}: placo orders the joints differently from Pinocchio")
    return robot


def _printed(values: Vector) -> str:
    """Numbers as text of a URDF, exact to the last bit."""
    return " ".join(f"{value:.17g}" for value in values)
