"""CoM task."""

from __future__ import annotations

import numpy as np

from controllers.qp.kernels_stack import COM_TASK
from controllers.qp.terms import Terms
from controllers.tasks.base import Task
from models.types import Matrix, Reference, Vector


class CoMTask(Task):
    r"""Accelerate the centre of mass, in W.

    .. math:: \ddot c^* = \ddot c_{ref} + k_p (c_{ref} - c) + k_d (\dot c_{ref} - \dot c)

    The balance law may overwrite the horizontal part through ``override`` (its DCM feedback).

    Attributes:
        kp: Proportional gain (3,) [1/s^2].
        kd: Derivative gain (3,) [1/s].
        weight: (3,).
        override: When not None, the wanted acceleration itself (3,) [m/s^2].
    """

    name = "com"
    kind = COM_TASK

    def __init__(self, kp: Vector, kd: Vector, weight: Vector) -> None:
        self.kp, self.kd, self.weight = kp, kd, weight
        self.active = bool(weight.any())
        self.override: Vector | None = None

    def error(self, terms: Terms, reference: Reference) -> Vector:
        """CoM error in W (3,) [m]."""
        return np.subtract(reference.com, terms.com)

    def jacobian(self, terms: Terms) -> Matrix:
        """CoM Jacobian in W (3, nv)."""
        return terms.com_jacobian

    def drift(self, terms: Terms) -> Vector:
        """CoM acceleration at zero generalised acceleration, in W (3,) [m/s^2]."""
        return terms.com_drift

    def acceleration(self, terms: Terms, reference: Reference) -> Vector:
        """Wanted CoM acceleration in W (3,) [m/s^2]."""
        if self.override is not None:
            return self.override
        return (
            reference.com_acceleration
            + self.kp * self.error(terms, reference)
            + self.kd * (reference.com_velocity - terms.com_velocity)
        )
