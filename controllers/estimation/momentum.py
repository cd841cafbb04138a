"""Generalised momentum of the robot: what the force observer integrates."""

from __future__ import annotations

import pinocchio as pin

from controllers.estimation.kernels_momentum import BODIES, SWEEP, generalised_momentum
from controllers.memory import Block
from controllers.posture_reference import PostureReference
from models.robot_model import RobotModel
from models.types import Vector


class MomentumModel:
    """Generalised momentum p = M v and C' v - g of the joints, momentum of the whole about its CoM, soles.

    Pinocchio's model is read once; one compiled sweep out and one back then give everything (a test holds it to
    Pinocchio's mass and Coriolis matrices).

    Args:
        model: The robot.
        gravity: [m/s^2].

    Attributes:
        sweep: Results, for kernels; ``kernels_momentum.SWEEP`` names the parts.
        bodies: Masses, inertias, axes and drives, for kernels.
        joint_momentum: p of the joints (nj,) [kg.m^2/s].
        joint_rate: Joint rows of C' v - g (nj,) [N.m].
        com: CoM relative to the base's origin, in W (3,) [m].
        com_velocity: In W (3,) [m/s].
        angular_momentum: About the CoM, in W (3,) [kg.m^2/s].
        sole_rotations: Rotation of each sole in W (2, 3, 3).
        sole_positions: Origin of each sole relative to the base's, in W (2, 3) [m].

    Raises:
        RobotModelError: A joint is not revolute; names it.
    """

    def __init__(self, model: RobotModel, gravity: float) -> None:
        nj, count = model.nj, model.nj + 1
        posture = PostureReference(model)
        shapes = ((count,), (count, 3, 3), (nj, 3), (nj,), (nj,), (nj,))
        self.bodies = bodies = Block(dict(zip(BODIES, shapes, strict=True)))
        for body in range(count):
            inertia = model.pin.inertias[body + 1]
            bodies["masses"][body], bodies["inertias"][body] = inertia.mass, inertia.inertia
        for n in range(nj):
            turn = posture.tree["rotations"][n].T @ posture.tree["swings"][n]  # [axis]x
            bodies["axes"][n] = pin.unSkew(turn)
        bodies["armature"][:], bodies["damping"][:] = model.armature, model.damping
        bodies["friction"][:] = model.frictionloss
        columns = ((count, 3, 3), *(((count, 3),) * 6), (count, 4), (nj,), (nj,), (3, 3), (2, 3, 3), (2, 3))
        self.sweep = sweep = Block(dict(zip(SWEEP, columns, strict=True)))
        self.joint_momentum, self.joint_rate = sweep["joint_momentum"], sweep["joint_rate"]
        self.com, self.com_velocity, self.angular_momentum = sweep["centroid"]
        self.sole_rotations, self.sole_positions = sweep["sole_rotations"], sweep["sole_positions"]
        self.arguments = (
            gravity, posture.tree.data, posture.tree.layout, posture.parents, posture.bodies,
            bodies.data, bodies.layout, sweep.data, sweep.layout,
        )  # fmt: skip

    def update(self, q: Vector, v: Vector) -> None:
        """Evaluate a configuration (nq,) and a velocity (nv,)."""
        generalised_momentum(q, v, *self.arguments)
