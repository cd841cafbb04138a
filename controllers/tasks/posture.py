"""Posture task."""

from __future__ import annotations

import numpy as np

from controllers.qp.kernels_feedback import proportional_derivative
from controllers.qp.terms import Terms
from controllers.tasks.base import Task
from models.types import Matrix, Reference, Vector


class PostureTask(Task):
    r"""Draw every joint to its reference.

    .. math:: \ddot q^* = \ddot q_{ref} + k_p (q_{ref} - q) + k_d (\dot q_{ref} - \dot q)

    Its Jacobian is the identity on the joints, so the QP adds it through the joint rows of the reduction instead of
    stacking it.

    Attributes:
        kp: (nj,) [1/s^2].
        kd: (nj,) [1/s].
        weight: (nj,).
    """

    name = "posture"

    def __init__(self, kp: Vector, kd: Vector, weight: Vector) -> None:
        self.kp, self.kd, self.weight = kp, kd, weight
        self.active = True
        self._acceleration = np.zeros(len(weight))

    def error(self, terms: Terms, reference: Reference) -> Vector:
        """Joint error (nj,) [rad]."""
        return np.subtract(reference.posture, terms.q[7:])

    def jacobian(self, terms: Terms) -> Matrix:
        """Selection of the joints (nj, nv)."""
        nv = terms.v.shape[0]
        return np.eye(nv)[6:]

    def drift(self, terms: Terms) -> Vector:
        """Zero (nj,)."""
        return np.zeros(terms.v.shape[0] - 6)

    def acceleration(self, terms: Terms, reference: Reference) -> Vector:
        """Wanted joint accelerations (nj,) [rad/s^2]."""
        proportional_derivative(
            reference.posture_acceleration,
            self.kp,
            reference.posture,
            terms.q[7:],
            self.kd,
            reference.posture_velocity,
            terms.v[6:],
            self._acceleration,
        )
        return self._acceleration
