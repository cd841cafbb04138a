"""Builds the reduced whole-body QP from terms, tasks and limits. Pure: solving is elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from controllers.memory import Block
from controllers.qp.kernels_build import CORE, REDUCTION, ROBOT, fill_cost, fill_rows
from controllers.qp.kernels_cone import ROWS, fill_cone
from controllers.qp.kernels_feedback import LIMITS
from controllers.qp.kernels_recover import recover
from controllers.qp.kernels_stack import ACTIVE, COM_TASK, PLAN, PYTHON_TASK, STACK
from controllers.qp.terms import Terms
from controllers.tasks.base import Task
from controllers.tasks.posture import PostureTask
from models.constants import GRAVITY
from models.errors import ConfigError
from models.robot_model import RobotModel
from models.types import Matrix, Reference, Vector

ROW_SCALE = (1.0, 0.01)
"""Size of a torque row at its limit [-], and of an acceleration row per rad/s^2 [s^2/rad]: rows of similar size."""

PIVOT_FLOOR = 1e-6
"""Pivot of the legs' loop closure below which a row counts as dependent, as with both knees straight [-]."""


@dataclass(slots=True)
class QP:
    """``minimise 1/2 z'Hz + f'z  subject to  lower <= [I_nb; A] z <= upper``.

    Most ticks need no rows: the minimum of the cost keeps all limits. A QP that can tell so without them has ``keeps``,
    and its rows are of an earlier tick until ``complete`` is called.

    Attributes:
        hessian: H, positive definite (nz, nz).
        gradient: f (nz,).
        matrix: A (m, nz).
        lower: Bounds of the nb simple rows, then of A's rows (nb + m,).
        upper: Likewise.
        soft: Rows that a relaxed solve may violate, at a price (nb + m,) of bool.
        finite: Whether there is neither NaN nor infinity in it; None when nobody has looked.
        keeps: Whether a point (nz,) breaks no row, told without them; None when the rows are there.
        complete: Fills the rows and ``finite``; None when the rows are there.
    """

    hessian: Matrix
    gradient: Vector
    matrix: Matrix
    lower: Vector
    upper: Vector
    soft: np.ndarray
    finite: bool | None = None
    keeps: Callable[[Vector], bool] | None = None
    complete: Callable[[], None] | None = None


class QPLimits:
    """What the QP may use on this tick, and what it is drawn to besides its tasks.

    Args:
        nj: Number of joints.

    Attributes:
        block: All of the following, for kernels.
        torque: Largest joint torque (nj,) [N.m].
        acceleration_lower, acceleration_upper: (nj,) [rad/s^2].
        contact_acceleration: Acceleration of each sole in contact, in its frame (2, 6) [m/s^2, rad/s^2].
        wrench_target: Wrench each sole is drawn to, in its frame (2, 6) [N, N.m].
        wrench_weight: (2, 6).
    """

    def __init__(self, nj: int) -> None:
        shapes = ((nj,), (nj,), (nj,), (2, 6), (2, 6), (2, 6), (nj,), (nj,), (nj,), (7,), (nj,), (nj,))
        self.block = block = Block(dict(zip(LIMITS, shapes, strict=True)))
        self.torque = block["torque"]
        self.acceleration_lower, self.acceleration_upper = block["acceleration_lower"], block["acceleration_upper"]
        self.contact_acceleration = block["contact_acceleration"]
        self.wrench_target, self.wrench_weight = block["wrench_target"], block["wrench_weight"]


class _Reduction:
    """Preallocated arrays of one contact mode (0 none, 1 left, 2 right, 3 both)."""

    def __init__(self, mode: int, nv: int, n_upper: int, n_legs: int) -> None:
        feet = (0, 1, 1, 2)[mode]
        self.mode = mode
        self.na = nv - 6 if mode != 3 else nv - 12
        self.nz = self.na + (6 if mode == 3 else 0)
        rows = feet * ROWS + (nv - 6) + n_legs
        na, nz, bounds = self.na, self.nz, n_upper + rows
        shapes = ((nv, na), (nv,), (2, 6, 6), (2, 6, nz), (2, 6), (nz, nz), (nz,), (rows, nz), (bounds,), (bounds,))
        self.block = block = Block(dict(zip(REDUCTION, shapes, strict=True)))
        soft = np.zeros(n_upper + rows, dtype=bool)
        soft[:n_upper] = True
        soft[n_upper + feet * ROWS + nv - 6 :] = True
        self.qp = QP(block["hessian"], block["gradient"], block["matrix"], block["lower"], block["upper"], soft)


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
        lookahead: Time over which accelerations are integrated to the set-point [s].

    Attributes:
        tasks: Those that are stacked, in the order of their rows.
        posture: The posture task.
        robot: What hardly ever changes: wrench cones and scales.
        stacked: Gains and rows of all tasks on the last tick.

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
        lookahead: float,
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
        self._regularisation, self._ahead = regularisation, lookahead
        core = np.concatenate([np.arange(6), *(np.array(foot.joint_ids_v) for foot in model.feet)])
        if len(set(core)) != CORE or len(model.feet[0].joint_ids_v) != 6:
            raise ConfigError(f"{model.name}: each leg needs six joints of its own between base and sole")
        self._indices = np.concatenate([core, np.setdiff1d(np.arange(model.nv), core)]).astype(np.int64)
        upper = model.nv - CORE
        self._force_min, self._force_max = force_min, force_max
        self._wrench_scale = model.mass * GRAVITY
        self._friction, self._margin = friction, sole_margin
        self.robot = Block(dict(zip(ROBOT, ((2, ROWS, 6), (2, ROWS), (2, ROWS), (2,)), strict=True)))
        self._cones = self.robot["cone"], self.robot["cone_lower"], self.robot["cone_upper"]
        self._shrunk = np.empty(4)
        for foot in range(2):
            self.set_area(foot, model.feet[foot].rectangle)
        self.robot["row_scale"][:] = ROW_SCALE
        self._reductions = [_Reduction(mode, model.nv, upper, CORE - 6) for mode in range(4)]
        self._active = self._reductions[0]
        self._terms: Terms
        self._limits: QPLimits
        self._evaluated: Vector | None = None
        self._recovered: tuple[Matrix, Vector, Matrix]
        self.stacked = stack = self._make_stack()
        self._stack = stack.data, stack.layout
        self._com = next((task for task in self.tasks if task.kind == COM_TASK), None)
        self._no_com = np.zeros(3)

    def _make_stack(self) -> Block:
        """Memory of the stacked tasks, and the table of them; gains and weights of the tasks move into it."""
        dimensions = [task.weight.shape[0] for task in self.tasks]
        total, nj = sum(dimensions), self.model.nv - 6
        shapes = ((total, self.model.nv), (total,), (total,), (total,), (total,), (total,), (nj,), (nj,), (nj,), (nj,))
        stack = Block(dict(zip(STACK, shapes, strict=True)))
        self._plan = np.zeros((len(self.tasks), len(PLAN)), dtype=np.int64)
        self._acting = [False] * len(self.tasks)
        self._others: list[tuple[Task, Matrix, Vector]] = []
        first = 0
        for index, (task, size) in enumerate(zip(self.tasks, dimensions, strict=True)):
            span = slice(first, first + size)
            for name, part in (("kp", "kp"), ("kd", "kd"), ("weight", "full_weight")):
                _move(task, name, stack[part][span])
            self._plan[index] = task.kind, task.which, first, False
            if task.kind == PYTHON_TASK:
                self._others.append((task, stack["jacobian"][span], stack["target"][span]))
            first += size
        for name in ("kp", "kd", "weight"):
            _move(self.posture, name, stack[f"posture_{name}"])
        return stack

    def set_area(self, foot: int, rectangle: Sequence[float]) -> None:
        """Part of a sole that bears from now on: x_min, x_max, y_min, y_max in its frame [m]."""
        x_min, x_max, y_min, y_max = rectangle
        margin = min(self._margin, 0.25 * (x_max - x_min), 0.25 * (y_max - y_min))  # a strip keeps half its width
        self._shrunk[:] = x_min + margin, x_max - margin, y_min + margin, y_max - margin
        friction = min(self._friction, self.model.feet[foot].friction)
        # Rows are divided by the robot's weight: solvers' absolute tolerances then mean the same for every robot.
        forces = self._force_min, self._force_max, self._wrench_scale
        fill_cone(self._shrunk, friction, *forces, *(rows[foot] for rows in self._cones))

    def set_load(self, load: tuple[float, float]) -> None:
        """Share of its largest normal force that each sole may bear from now on (2,) [-]."""
        for foot in range(2):
            # The normal force is the cone's last row; twice the least force keeps a foot that is let go feasible.
            force = max(load[foot] * self._force_max, 2.0 * self._force_min)
            self._cones[2][foot, -1] = force / self._wrench_scale

    def build(self, terms: Terms, reference: Reference, limits: QPLimits) -> QP:
        """Fill the cost of this tick's QP; its rows follow where they are needed.

        Args:
            terms: Model terms of the measured state; they and ``limits`` stay as they are until the QP is solved.
            reference: What to track; its ``contacts`` pick the contact mode.
            limits: Limits, contact accelerations and wanted wrenches.

        Returns:
            The QP, in arrays that the next call with the same contacts overwrites.
        """
        for index, task in enumerate(self.tasks):
            if task.active != self._acting[index]:
                self._acting[index] = task.active
                self._plan[index, ACTIVE] = task.active
        for task, jacobian, target in self._others:
            if task.active:
                task.stack(terms, reference, jacobian, target)
        com = self._no_com if self._com is None else self._com.acceleration(terms, reference)
        mode = (1 if reference.contacts[0] else 0) + (2 if reference.contacts[1] else 0)
        self._active = reduction = self._reductions[mode]
        self._terms, self._limits, self._evaluated = terms, limits, None
        fill_cost(
            mode,
            terms.mass_matrix,
            terms.bias,
            terms.block.data,
            terms.block.layout,
            self._indices,
            self._plan,
            com,
            reference.base_orientation,
            reference.torso_orientation,
            reference.heading_rate,
            reference.sole_velocities,
            reference.sole_accelerations,
            reference.posture,
            reference.posture_velocity,
            reference.posture_acceleration,
            *self._stack,
            limits.block.data,
            limits.block.layout,
            reference.sole_rotations,
            reference.sole_positions,
            self._wrench_scale,
            PIVOT_FLOOR,
            self._regularisation,
            reduction.block.data,
            reduction.block.layout,
        )
        qp = reduction.qp
        qp.keeps, qp.complete = self._evaluate, self._fill_rows
        return qp

    def _fill_rows(self) -> None:
        """Fill the rows of the QP built last."""
        reduction, terms, limits = self._active, self._terms, self._limits
        qp = reduction.qp
        qp.keeps = qp.complete = None
        qp.finite = fill_rows(
            reduction.mode,
            terms.mass_matrix,
            terms.bias,
            terms.block.data,
            terms.block.layout,
            self._indices,
            self.robot.data,
            self.robot.layout,
            limits.block.data,
            limits.block.layout,
            reduction.block.data,
            reduction.block.layout,
        )

    def recover(self, z: Vector) -> tuple[Matrix, Vector, Matrix]:
        """What a solution of the QP built last means.

        Args:
            z: Solution (nz,).

        Returns:
            Joint positions, velocities and torques of the set-point (3, nj), acceleration (nv,), and wrenches in the
            sole frames (2, 6); arrays of their own.
        """
        if z is not self._evaluated:
            self._evaluate(z)
        return self._recovered

    def _evaluate(self, z: Vector) -> bool:
        """Keep what z means for ``recover``; returns whether it keeps every limit."""
        self._evaluated, model = z, self.model
        self._recovered = command, acceleration, wrenches = (
            np.empty((3, model.nj)),
            np.empty(model.nv),
            np.empty((2, 6)),
        )
        reduction, terms, limits = self._active, self._terms, self._limits
        return bool(
            recover(
                reduction.mode,
                z,
                terms.mass_matrix,
                terms.bias,
                terms.block.data,
                terms.block.layout,
                self.robot.data,
                self.robot.layout,
                reduction.block.data,
                reduction.block.layout,
                limits.block.data,
                limits.block.layout,
                self._ahead,
                acceleration,
                wrenches,
                command,
            )
        )


def _move(task: Task, name: str, memory: Vector) -> None:
    """Have an array of a task, where it has one, live in the memory of the stack: what is changed there counts."""
    values = getattr(task, name, None)
    if values is not None:
        memory[:] = values
        setattr(task, name, memory)
