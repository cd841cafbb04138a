"""SE(3) task of a swing foot."""

from __future__ import annotations

import numpy as np

from controllers.qp.kernels_feedback import pose_error
from controllers.qp.kernels_stack import FOOT_TASK, foot_feedback
from controllers.qp.terms import Terms
from controllers.tasks.base import Task
from models.types import Matrix, Reference, Vector


class FootTask(Task):
    r"""Carry a foot that is not in contact along its reference; everything in the sole frame.

    .. math::
        a^* = R^T a_{ref} + k_p \begin{bmatrix} R^T (p_{ref} - p) \\ \log(R^T R_{ref}) \end{bmatrix}
        + k_d (R^T v_{ref} - v)

    While the foot is planned to bear load the task is silent: the contact rows hold it.

    Attributes:
        kp: (6,) [1/s^2].
        kd: (6,) [1/s].
        weight: (6,).
        active: Whether the foot swings.
    """

    kind = FOOT_TASK

    def __init__(self, foot: int, kp: Vector, kd: Vector, weight: Vector) -> None:
        self.name = ("left_foot", "right_foot")[foot]
        self.foot = self.which = foot
        self.kp, self.kd, self.weight = kp, kd, weight
        self.active = True
        self._error, self._wanted = np.zeros(6), np.zeros(6)

    def error(self, terms: Terms, reference: Reference) -> Vector:
        """Position and rotation error in the sole frame (6,) [m, rad]."""
        foot = self.foot
        pose_error(terms.soles[foot].pose, reference.sole_rotations[foot], reference.sole_positions[foot], self._error)
        return self._error

    def jacobian(self, terms: Terms) -> Matrix:
        """Sole Jacobian in the sole frame (6, nv)."""
        return terms.soles[self.foot].jacobian

    def drift(self, terms: Terms) -> Vector:
        """Classical acceleration at zero generalised acceleration, in the sole frame (6,)."""
        return terms.soles[self.foot].drift

    def acceleration(self, terms: Terms, reference: Reference) -> Vector:
        """Wanted classical acceleration in the sole frame (6,) [m/s^2, rad/s^2]."""
        sole, error = terms.soles[self.foot], self.error(terms, reference)
        velocity, acceleration = reference.sole_velocities[self.foot], reference.sole_accelerations[self.foot]
        foot_feedback(sole.pose, velocity, acceleration, error, sole.twist, self.kp, self.kd, self._wanted)
        return self._wanted
