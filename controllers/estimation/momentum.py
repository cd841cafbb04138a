"""Generalised momentum of the robot for the force observer, in two sweeps over the tree."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.numerics.compiled import njit
from models.numerics.so3 import quaternion_matrix, rotate, rotate_transposed
from models.robot_model import RobotModel
from models.tree import KinematicTree, TreeFrames, place_bodies, place_frame, read_frames, read_tree

Array = NDArray[np.float64]


class Momentum(NamedTuple):
    """Momentum of one state in world-aligned axes; positions are relative to the origin of the base."""

    origins: Array  # of each body (nj + 1, 3) [m]
    axes: Array  # of each joint, by body; the row of the base is unused (nj + 1, 3)
    linear: Array  # of the whole robot (3,) [N.s]
    joint_momentum: Array  # p = M v of the joints (nj,) [N.m.s]
    joint_rate: Array  # joint rows of C' v - g (nj,) [N.m]
    com: Array  # (3,) [m]
    com_velocity: Array  # (3,) [m/s]
    angular_momentum: Array  # about the CoM (3,) [N.m.s]
    sole_rotations: Array  # (2, 3, 3)
    sole_positions: Array  # (2, 3) [m]


class Dynamics(NamedTuple):
    """Constants of the robot for the momentum observer."""

    tree: KinematicTree
    soles: TreeFrames  # left, right
    armature: Array  # rotor inertia of each joint (nj,) [kg.m^2]
    damping: Array  # viscous friction of each joint (nj,) [N.m.s/rad]
    friction: Array  # dry friction of each joint (nj,) [N.m]
    gravity: float  # [m/s^2]


def read_dynamics(model: RobotModel, gravity: float) -> Dynamics:
    """Parameters of a robot for ``generalised_momentum``; ``RobotModelError`` names a joint that is not revolute."""
    soles = read_frames(model.pin, [foot.frame_id for foot in model.feet])
    armature, damping, friction = (np.array(values) for values in (model.armature, model.damping, model.frictionloss))
    return Dynamics(read_tree(model.pin), soles, armature, damping, friction, gravity)


@njit(cache=True)
def _cross(a: Array, b: Array, out: Array) -> None:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@njit(cache=True)
def generalised_momentum(q: Array, v: Array, robot: Dynamics) -> Momentum:
    """Generalised momentum p = M v, and the part of p' without joint torques, from the momentum of every subtree.

    S_n is the motion subspace of joint n and V_n the spatial velocity of its body. h_n is the momentum and G_n the
    weight of the subtree that the joint moves::

        p_n = S_n . h_n + I_n dq_n,      p_n' = S_n . (transmitted force) + (V_n x S_n) . h_n + S_n . G_n

    Hence ``joint_rate`` = (V_n x S_n) . h_n + S_n . G_n is row n of C' v - g, without the Coriolis matrix. q is (nq,),
    v is (nv,) with the base twist in B first.
    """
    tree, gravity = robot.tree, robot.gravity
    count = tree.shape[0] - 1
    rotations, origins, axes = np.empty((count + 1, 3, 3)), np.zeros((count + 1, 3)), np.zeros((count + 1, 3))
    linear, angular = np.empty((count + 1, 3)), np.empty((count + 1, 3))
    momentum, moment = np.empty((count + 1, 3)), np.empty((count + 1, 3))
    masses, firsts = np.empty(count + 1), np.empty((count + 1, 3))
    joint_momentum, joint_rate = np.empty(count), np.empty(count)
    com, com_velocity, spin = np.empty(3), np.empty(3), np.empty(3)
    sole_rotations, sole_positions = np.empty((2, 3, 3)), np.empty((2, 3))
    work, lever, local = np.empty(3), np.empty(3), np.empty(3)
    quaternion_matrix(q[3:7], rotations[0])
    place_bodies(tree, q[7:], rotations, origins)
    rotate(rotations[0], v[0:3], linear[0])
    rotate(rotations[0], v[3:6], angular[0])
    for body in range(count + 1):
        if body > 0:
            n, parent = body - 1, tree[body].parent
            rotate(rotations[body], tree[body].axis, axes[body])
            _cross(origins[body], axes[body], work)
            for i in range(3):
                linear[body, i] = linear[parent, i] + v[6 + n] * work[i]
                angular[body, i] = angular[parent, i] + v[6 + n] * axes[body, i]
        rotate(rotations[body], tree[body].lever, lever)
        for i in range(3):
            lever[i] += origins[body, i]
        _cross(angular[body], lever, work)
        mass = masses[body] = tree[body].mass
        for i in range(3):
            momentum[body, i] = mass * (linear[body, i] + work[i])
            firsts[body, i] = mass * lever[i]
        _cross(lever, momentum[body], moment[body])
        rotate_transposed(rotations[body], angular[body], work)
        rotate(tree[body].inertia, work, local)
        rotate(rotations[body], local, work)
        for i in range(3):
            moment[body, i] += work[i]
    for body in range(count, 0, -1):
        parent = tree[body].parent
        masses[parent] += masses[body]
        for i in range(3):
            momentum[parent, i] += momentum[body, i]
            moment[parent, i] += moment[body, i]
            firsts[parent, i] += firsts[body, i]
        axis = axes[body]
        _cross(origins[body], axis, lever)  # linear part of S
        _cross(angular[body], lever, work)
        _cross(linear[body], axis, local)
        total, rate = 0.0, 0.0
        for i in range(3):
            total += lever[i] * momentum[body, i] + axis[i] * moment[body, i]
            rate += (work[i] + local[i]) * momentum[body, i]
        _cross(angular[body], axis, work)
        for i in range(3):
            rate += work[i] * moment[body, i]
        # Weight (0, 0, -m g) at the subtree's CoM c: its moment is m g (-c_y, c_x, 0).
        rate += gravity * (axis[1] * firsts[body, 0] - axis[0] * firsts[body, 1] - lever[2] * masses[body])
        joint_momentum[body - 1] = total + robot.armature[body - 1] * v[5 + body]
        joint_rate[body - 1] = rate
    for i in range(3):
        com[i] = firsts[0, i] / masses[0]
        com_velocity[i] = momentum[0, i] / masses[0]
    _cross(com, momentum[0], work)
    for i in range(3):
        spin[i] = moment[0, i] - work[i]
    for foot in range(2):
        place_frame(robot.soles, foot, rotations, origins, sole_rotations[foot], sole_positions[foot])
    return Momentum(
        origins, axes, momentum[0], joint_momentum, joint_rate, com, com_velocity, spin, sole_rotations, sole_positions
    )
