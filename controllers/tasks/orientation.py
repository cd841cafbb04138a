"""Orientation task of the base or the torso."""

from __future__ import annotations

from typing import Literal

import numpy as np

from controllers.qp.kernels_feedback import orientation_feedback
from controllers.qp.kernels_stack import BASE, ORIENTATION_TASK, TORSO
from controllers.qp.kernels_terms import rotation_error
from controllers.qp.terms import Terms
from controllers.tasks.base import Task
from models.types import Matrix, Reference, Vector


class OrientationTask(Task):
    r"""Turn the base or the torso to a wanted orientation; everything in the moving frame.

    .. math:: \dot\omega^* = k_p \log(R^T R_{ref}) + k_d (R^T \omega_{ref} - \omega)

    with the wanted angular velocity about the vertical only (the heading rate of a walk).

    Attributes:
        kp: (3,) [1/s^2].
        kd: (3,) [1/s].
        weight: (3,).
    """

    kind = ORIENTATION_TASK

    def __init__(self, body: Literal["base", "torso"], kp: Vector, kd: Vector, weight: Vector) -> None:
        self.name = f"{body}_orientation"
        self.which = BASE if body == "base" else TORSO
        self._is_base = body == "base"
        self.kp, self.kd, self.weight = kp, kd, weight
        self.active = bool(weight.any())
        self._error = np.zeros(3)
        self._acceleration = np.zeros(3)
        self._base_jacobian: Matrix | None = None
        self._no_drift = np.zeros(3)

    def error(self, terms: Terms, reference: Reference) -> Vector:
        """Rotation vector to the wanted orientation, in the moving frame (3,) [rad]."""
        if self._is_base:
            rotation_error(terms.base_rotation, reference.base_orientation, self._error)
        else:
            rotation_error(terms.torso.pose, reference.torso_orientation, self._error)
        return self._error

    def jacobian(self, terms: Terms) -> Matrix:
        """Angular Jacobian in the moving frame (3, nv)."""
        if not self._is_base:
            return terms.torso.jacobian[3:]
        if self._base_jacobian is None:
            self._base_jacobian = np.zeros((3, terms.v.shape[0]))
            self._base_jacobian[:, 3:6] = np.eye(3)
        return self._base_jacobian

    def drift(self, terms: Terms) -> Vector:
        """Angular acceleration at zero generalised acceleration, in the moving frame (3,) [rad/s^2]."""
        return self._no_drift if self._is_base else terms.torso.drift[3:]

    def acceleration(self, terms: Terms, reference: Reference) -> Vector:
        """Wanted angular acceleration in the moving frame (3,) [rad/s^2]."""
        if self._is_base:
            rotation, wanted, rate = terms.base_rotation, reference.base_orientation, terms.v[3:6]
        else:
            rotation, wanted, rate = terms.torso.pose, reference.torso_orientation, terms.torso.twist[3:]
        if reference.heading_rate != 0.0:
            rate = rate - reference.heading_rate * rotation[2, :3]
        orientation_feedback(rotation, wanted, rate, self.kp, self.kd, self._error, self._acceleration)
        return self._acceleration
