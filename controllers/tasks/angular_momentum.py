"""Centroidal angular momentum task."""

from __future__ import annotations

import numpy as np

from controllers.qp.kernels_stack import MOMENTUM_TASK
from controllers.qp.terms import Terms
from controllers.tasks.base import Task
from models.types import Matrix, Reference, Vector


class AngularMomentumTask(Task):
    r"""Damp the angular momentum about the CoM, in W.

    .. math:: \dot L^* = -k_d L, \qquad \dot L = A_G a + \dot A_G v

    References:
        Orin, Goswami, Lee: Centroidal dynamics of a humanoid robot (2013), eq. 14.

    Attributes:
        kd: Damping (3,) [1/s].
        weight: (3,).
    """

    name = "angular_momentum"
    kind = MOMENTUM_TASK

    def __init__(self, kd: Vector, weight: Vector) -> None:
        self.kd, self.weight = kd, weight
        self.active = bool(weight.any())

    def error(self, terms: Terms, reference: Reference) -> Vector:
        """Zero minus the angular momentum, in W (3,) [kg.m^2/s]."""
        return np.negative(terms.momentum)

    def jacobian(self, terms: Terms) -> Matrix:
        """Angular rows of the centroidal map, in W (3, nv)."""
        return terms.momentum_matrix

    def drift(self, terms: Terms) -> Vector:
        """Momentum rate at zero generalised acceleration, in W (3,) [N.m]."""
        return terms.momentum_drift

    def acceleration(self, terms: Terms, reference: Reference) -> Vector:
        """Wanted rate of angular momentum in W (3,) [N.m]."""
        return self.kd * self.error(terms, reference)
