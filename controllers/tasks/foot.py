"""SE(3) task of a swing foot."""

from __future__ import annotations

import numpy as np

from controllers.qp.kernels_feedback import pose_error
from controllers.qp.terms import Terms
from controllers.tasks.base import Task
from models.compiled import njit
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
        weight: (6,); all zero while in contact.
        active: Whether the foot swings.
    """

    def __init__(self, foot: int, kp: Vector, kd: Vector, weight: Vector) -> None:
        self.name = ("left_foot", "right_foot")[foot]
        self.foot = foot
        self.kp, self.kd = kp, kd
        self._weight = weight
        self.weight = weight
        self.active = True
        self._silent = np.zeros(6)
        self._error, self._wanted = np.zeros(6), np.zeros(6)

    def set_active(self, active: bool) -> None:
        """Switch the task on (swing) or off (contact)."""
        self.active = active
        self.weight = self._weight if active else self._silent

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
        if not self.active:
            return self._silent
        sole, error = terms.soles[self.foot], self.error(terms, reference)
        velocity, acceleration = reference.sole_velocities[self.foot], reference.sole_accelerations[self.foot]
        _feed_back(sole.pose, velocity, acceleration, error, sole.twist, self.kp, self.kd, self._wanted)
        return self._wanted


@njit(cache=True)
def _feed_back(
    pose: Matrix,
    velocity: Vector,
    acceleration: Vector,
    error: Vector,
    twist: Vector,
    kp: Vector,
    kd: Vector,
    out: Vector,
) -> None:
    """Wanted acceleration in the sole frame (6,), from the wanted motion in W and error and twist in the sole frame."""
    for part in range(0, 6, 3):
        for i in range(3):
            v, a = 0.0, 0.0
            for k in range(3):
                v += pose[k, i] * velocity[part + k]
                a += pose[k, i] * acceleration[part + k]
            row = part + i
            out[row] = a + kp[row] * error[row] + kd[row] * (v - twist[row])
