"""Builds the reduced whole-body QP from terms, tasks and limits. Pure: solving is elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from controllers.qp.kernels_assemble import assemble_cost, assemble_rows, recover
from controllers.qp.kernels_reduce import reduce_accelerations, reduce_wrenches
from controllers.qp.terms import Terms
from controllers.qp.wrench_cone import wrench_cone
from controllers.tasks.base import Task
from controllers.tasks.posture import PostureTask
from models.errors import ConfigError
from models.robot_model import RobotModel
from models.types import Matrix, Reference, Vector


@dataclass(slots=True)
class QP:
    """``minimise 1/2 z'Hz + f'z  subject to  lower <= [I_nb; A] z <= upper``.

    Attributes:
        hessian: H, positive definite (nz, nz).
        gradient: f (nz,).
        matrix: A (m, nz).
        lower: Bounds of the nb simple rows, then of A's rows (nb + m,).
        upper: Likewise.
        soft: Rows that a relaxed solve may violate, at a price (nb + m,) of bool.
    """

    hessian: Matrix
    gradient: Vector
    matrix: Matrix
    lower: Vector
    upper: Vector
    soft: np.ndarray


@dataclass(frozen=True, slots=True)
class QPLimits:
    """What the QP may use on this tick.

    Attributes:
        torque: Largest joint torque (nj,) [N.m].
        acceleration_lower: (nj,) [rad/s^2].
        acceleration_upper: (nj,) [rad/s^2].
    """

    torque: Vector
    acceleration_lower: Vector
    acceleration_upper: Vector


class _Reduction:
    """Preallocated arrays of one contact mode (0 none, 1 left, 2 right, 3 both)."""

    def __init__(self, mode: int, nv: int, n_upper: int, n_legs: int, cone_rows: int) -> None:
        feet = (0, 1, 1, 2)[mode]
        self.mode = mode
        self.na = nv - 6 if mode != 3 else nv - 12
        self.nz = self.na + (6 if mode == 3 else 0)
        rows = feet * cone_rows + (nv - 6) + n_legs
        self.basis = np.zeros((nv, self.na))
        self.start = np.zeros(nv)
        self.maps = np.zeros((2, 6, self.nz))
        self.offsets = np.zeros((2, 6))
        soft = np.zeros(n_upper + rows, dtype=bool)
        soft[:n_upper] = True
        soft[n_upper + feet * cone_rows + nv - 6 :] = True
        self.qp = QP(
            np.zeros((self.nz, self.nz)),
            np.zeros(self.nz),
            np.zeros((rows, self.nz)),
            np.zeros(n_upper + rows),
            np.zeros(n_upper + rows),
            soft,
        )


class QPBuilder:
    """Assembles the QP of each tick into arrays allocated once per contact mode.

    Args:
        model: The robot.
        tasks: Tasks of the stack, in any order; a ``PostureTask`` is treated apart.
        force_min: Least normal force of a sole in contact [N].
        force_max: Largest normal force of a sole in contact [N].
        friction: Coulomb coefficient used by the cone.
        sole_margin: Taken off every side of the contact rectangles [m].
        regularisation: Added to the Hessian's diagonal.

    Raises:
        ConfigError: Two tasks share a name, there is no posture task, or a leg has not six joints of its own.
    """

    def __init__(
        self,
        model: RobotModel,
        tasks: Sequence[Task],
        *,
        force_min: float,
        force_max: float,
        friction: float,
        sole_margin: float,
        regularisation: float,
    ) -> None:
        names = [task.name for task in tasks]
        for name in names:
            if names.count(name) > 1:
                raise ConfigError(f"task '{name}' is given twice")
        postures = [task for task in tasks if isinstance(task, PostureTask)]
        if len(postures) != 1:
            raise ConfigError(f"exactly one posture task is needed, found {len(postures)}")
        self.model = model
        self.posture = postures[0]
        self.tasks = [task for task in tasks if task is not self.posture]
        self._regularisation = regularisation
        self.leg_1, self.leg_2 = (np.array(foot.joint_ids_v, dtype=np.int64) for foot in model.feet)
        if len(set(self.leg_1) | set(self.leg_2)) != 12 or len(self.leg_1) != 6:
            raise ConfigError(f"{model.name}: each leg needs six joints of its own between base and sole")
        self.legs = np.concatenate([self.leg_1, self.leg_2])
        self.upper = np.array([i for i in range(6, model.nv) if i not in set(self.legs)], dtype=np.int64)
        weight_force = model.mass * 9.81
        self._wrench_scale = weight_force
        cones = []
        for foot in model.feet:
            x_min, x_max, y_min, y_max = foot.rectangle
            shrunk = (x_min + sole_margin, x_max - sole_margin, y_min + sole_margin, y_max - sole_margin)
            cones.append(wrench_cone(shrunk, min(friction, foot.friction), force_min, force_max))
        # Rows are divided by the robot's weight: solvers' absolute tolerances then mean the same for every robot.
        self._cone = np.array([matrix for matrix, _, _ in cones]) / weight_force
        self._cone_lower = np.array([lower for _, lower, _ in cones]) / weight_force
        self._cone_upper = np.array([upper for _, _, upper in cones]) / weight_force
        self._row_scale = np.array([1.0, 0.01])
        self._pivot_floor = 1e-6
        self._reductions = [
            _Reduction(mode, model.nv, len(self.upper), len(self.legs), self._cone.shape[1]) for mode in range(4)
        ]
        dimensions = [task.weight.shape[0] for task in self.tasks]
        total = sum(dimensions)
        self._jacobian = np.zeros((total, model.nv))
        self._target = np.zeros(total)
        self._weight = np.zeros(total)
        ends = np.cumsum(dimensions)
        self._slices = [slice(int(end - size), int(end)) for end, size in zip(ends, dimensions, strict=True)]
        self._wanted = np.zeros((2, 6))
        self._inverse = np.zeros((2, 6, 6))

    def build(
        self,
        terms: Terms,
        reference: Reference,
        limits: QPLimits,
        contact_acceleration: Matrix,
        wrench_target: Matrix,
        wrench_weight: Matrix,
    ) -> QP:
        """Fill the QP of this tick.

        Args:
            terms: Model terms of the measured state.
            reference: What to track; its ``contacts`` pick the contact mode.
            limits: Torque and acceleration limits.
            contact_acceleration: Acceleration of each sole in contact, in its frame (2, 6) [m/s^2, rad/s^2].
            wrench_target: Wrench each sole is drawn to, in its frame (2, 6) [N, N.m].
            wrench_weight: (2, 6).

        Returns:
            The QP, in arrays that the next call with the same contacts overwrites.
        """
        for task, span in zip(self.tasks, self._slices, strict=True):
            if not task.active:
                self._weight[span] = 0.0
                continue
            self._weight[span] = task.weight
            self._jacobian[span] = task.jacobian(terms)
            np.subtract(task.acceleration(terms, reference), task.drift(terms), out=self._target[span])
        for foot in range(2):
            np.subtract(contact_acceleration[foot], terms.soles[foot].drift, out=self._wanted[foot])
        mode = (1 if reference.contacts[0] else 0) + (2 if reference.contacts[1] else 0)
        reduction = self._reductions[mode]
        self._active = reduction
        left, right = terms.soles[0].jacobian, terms.soles[1].jacobian
        reduce_accelerations(
            mode,
            terms.mass_matrix,
            terms.bias,
            left,
            right,
            self._inverse[0],
            self._inverse[1],
            self._wanted[0],
            self._wanted[1],
            self.upper,
            self.leg_1,
            self.leg_2,
            self._pivot_floor,
            reduction.basis,
            reduction.start,
        )
        reduce_wrenches(
            mode,
            terms.mass_matrix,
            terms.bias,
            self._inverse[0],
            self._inverse[1],
            reduction.basis,
            reduction.start,
            self._wrench_scale,
            reduction.maps,
            reduction.offsets,
        )
        qp = reduction.qp
        assemble_cost(
            self._jacobian,
            self._target,
            self._weight,
            self.posture.acceleration(terms, reference),
            self.posture.weight,
            reduction.basis,
            reduction.start,
            reduction.maps,
            reduction.offsets,
            wrench_target,
            wrench_weight,
            self._regularisation,
            qp.hessian,
            qp.gradient,
        )
        assemble_rows(
            mode,
            terms.mass_matrix,
            terms.bias,
            left,
            right,
            self.upper,
            self.legs,
            reduction.basis,
            reduction.start,
            reduction.maps,
            reduction.offsets,
            self._cone,
            self._cone_lower,
            self._cone_upper,
            limits.torque,
            limits.acceleration_lower,
            limits.acceleration_upper,
            self._row_scale,
            qp.matrix,
            qp.lower,
            qp.upper,
        )
        return qp

    def recover(self, terms: Terms, z: Vector, acceleration: Vector, wrenches: Matrix, torque: Vector) -> None:
        """Accelerations (nv,), wrenches (2, 6) and torques (nj,) of a solution of the QP built last."""
        reduction = self._active
        recover(
            z,
            terms.mass_matrix,
            terms.bias,
            terms.soles[0].jacobian,
            terms.soles[1].jacobian,
            reduction.basis,
            reduction.start,
            reduction.maps,
            reduction.offsets,
            acceleration,
            wrenches,
            torque,
        )
