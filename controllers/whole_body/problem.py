"""Assembles the reduced whole-body QP from terms, tasks, contacts and limits."""

from collections.abc import Iterable, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.qp.active_set import QP
from controllers.qp.contacts import ContactGains, Edges, Reduction, eliminate, make_reduction, reduce_row
from controllers.qp.terms import ModelTerms, Terms
from controllers.whole_body.limits import BodyLimits, LimitArrays, LimitRows, RowLimit, Rows, limit_rows
from controllers.whole_body.tasks import BodyArrays, BodyTasks, Desired, Task, body_rows
from models.errors import ConfigError
from models.foot import NORMAL
from models.numerics.compiled import njit
from models.numerics.unboxed import Unboxed, unbox
from models.robot_model import RobotModel
from models.types import Matrix, Reference, Vector

Array = NDArray[np.float64]


class Stack(NamedTuple):
    """All tasks of one tick: ``sum weight (jacobian a - target)^2 / 2``; the posture has separate arrays."""

    jacobian: Array  #: (m, nv)
    target: Array  #: (m,)
    weight: Array  #: Weights in force, zero for rows of inactive tasks (m,)
    posture_target: Array  #: (nj,)
    posture_weight: Array  #: (nj,)
    wrench_target: Array  #: Targets of the contact wrenches in the contact frames (contacts, 6)
    wrench_weight: Array  #: Weights of the contact wrenches in the contact frames (contacts, 6)


class Setpoint(NamedTuple):
    """Bounds of the drivers' setpoint, joint limits (nj,) [rad], and its look-ahead (1,) [s]."""

    q_min: Array
    q_max: Array
    ahead: Array


class _Setup(NamedTuple):
    """Inputs shared by the QPs of all sets of active contacts."""

    tasks: BodyArrays
    limits: LimitArrays
    stack: Stack
    contacts: ContactGains
    edges: Edges
    contact_acceleration: Array
    regularisation: float
    setpoint: Setpoint


class _ModeArrays(NamedTuple):
    """Outputs of compiled code for one set of active contacts."""

    reduction: Reduction
    hessian: Array
    gradient: Array
    rows: LimitRows


class _Mode(NamedTuple):
    """QP of one set of active contacts, and its rows for the limits beyond ``BodyLimits``."""

    arrays: _ModeArrays
    unboxed: Unboxed[_ModeArrays]
    qp: QP
    extra: list[tuple[RowLimit, Rows]]


class QPBuilder:
    """Assembles the QP of each tick into arrays allocated once per set of active contacts.

    One compiled call per tick writes everything except the rows of extra tasks and limits.

    Only ``Reference``, with the poses of two soles, restricts the class to robots with two feet. A contact is rigid and
    six-dimensional; the closed loops of several contacts must be independent.

    The rows of ``limits`` precede those of ``extra_limits``. ``wrench_weight`` is the weight of each wrench component
    (6,); ``regularisation`` is added to the Hessian's diagonal. The attribute ``lookahead`` is the integration time
    from accelerations to the setpoint (1,) [s]; it may be changed. ``contact_acceleration`` is the desired acceleration
    of each contact in its frame (contacts, 6). The caller sets ``stack.wrench_target``, and ``edges`` by ``set_edges``.
    Raises ``ConfigError`` when two tasks or limits share a name.
    """

    def __init__(
        self,
        model: RobotModel,
        tasks: BodyTasks,
        limits: BodyLimits,
        *,
        extra_tasks: Sequence[Task],
        extra_limits: Sequence[RowLimit],
        contacts: ContactGains,
        wrench_weight: Vector,
        regularisation: float,
        lookahead: float,
    ) -> None:
        _refuse_duplicates("task", (task.name for task in (*tasks, *extra_tasks)))
        _refuse_duplicates("limit", (limit.name for limit in (*limits, *extra_limits)))
        self._tasks, self._extra_tasks, self.contacts = tasks, extra_tasks, contacts
        count, nv, nj = len(model.feet), model.nv, model.nj
        stacked = [task for task in (*tasks, *extra_tasks) if task is not tasks.posture]
        rows = sum(len(task.weight) for task in stacked)
        self.stack = stack = Stack(
            np.zeros((rows, nv)),
            np.zeros(rows),
            np.zeros(rows),
            np.zeros(nj),
            np.zeros(nj),
            np.zeros((count, 6)),
            np.tile(wrench_weight, (count, 1)),
        )
        first = 0
        for task in stacked:
            span = slice(first, first + len(task.weight))
            task.write_into(stack.jacobian[span], stack.target[span], stack.weight[span])
            first = span.stop
        tasks.posture.write_into(tasks.posture.jacobian, stack.posture_target, stack.posture_weight)
        self.contact_acceleration = np.zeros((count, 6))
        self.lookahead = np.array([lookahead])
        setpoint = Setpoint(np.array(model.q_lower), np.array(model.q_upper), self.lookahead)
        self.edges = Edges(np.zeros((count, 2), dtype=bool), np.zeros((count, 2)))
        self._turns = (0,) * count
        shared = stack, contacts, self.edges, self.contact_acceleration, regularisation, setpoint
        self._setup = unbox(_Setup(tasks.arrays, limits.arrays, *shared))
        chains = [foot.chain_ids_v for foot in model.feet]
        closing = range(5 if all(foot.free[NORMAL] for foot in model.feet) else 6)
        self._modes: dict[tuple[tuple[bool, ...], tuple[int, ...]], _Mode] = {}
        for active, turns in product(product((False, True), repeat=count), product(range(3), repeat=count)):
            used = tuple(turn if bears else 0 for turn, bears in zip(turns, active, strict=True))
            if (active, used) not in self._modes:
                reduction = make_reduction(active, chains, nv, sum(used), closing)
                self._modes[active, used] = _make_mode(reduction, limits, extra_limits)
            self._modes[active, turns] = self._modes[active, used]
        self._active: _Mode
        self._terms: Unboxed[ModelTerms]
        self._shape = (3, nj)

    @property
    def problems(self) -> list[QP]:
        """QPs of all sets of active contacts."""
        return [mode.qp for mode in {id(mode): mode for mode in self._modes.values()}.values()]

    def set_edges(self, areas: Matrix) -> None:
        """Free the rotation of each contact about the line to which its support area (contacts, 4) [m] degenerates."""
        free, pivots = self.edges
        np.equal(areas[:, 2::-2], areas[:, 3::-2], out=free)
        np.multiply(areas[:, ::2], free[:, ::-1], out=pivots)
        self._turns = tuple(free.sum(axis=1).tolist())

    def build(self, terms: Terms, reference: Reference) -> QP:
        """Fill the QP of this tick; the next call with the same contacts overwrites its arrays."""
        for task in self._extra_tasks:
            if task.active:
                task.update(terms, reference)
                task.weight_in_force[:] = task.weight
            else:
                task.weight_in_force[:] = 0.0
        self._active = mode = self._modes[reference.contacts, self._turns]
        self._terms, tasks = terms.unboxed, self._tasks
        _build(
            terms.unboxed,
            self._setup,
            mode.unboxed,
            reference.com,
            tasks.com.desired(terms, reference),
            tasks.base.desired(reference),
            tasks.torso.desired(reference),
            reference.heading_rate,
            reference.sole_rotations,
            reference.sole_positions,
            reference.sole_velocities,
            reference.sole_accelerations,
            reference.posture,
            reference.posture_velocity,
            reference.posture_acceleration,
        )
        for limit, rows in mode.extra:
            limit.update(terms, reference, mode.arrays.reduction, rows)
        return mode.qp

    def recover(self, z: Vector) -> tuple[Matrix, Vector, Matrix]:
        """Setpoint (3, nj), acceleration (nv,) and contact wrenches (contacts, 6) of a solution (nz,)."""
        command, acceleration = np.empty(self._shape), np.empty(self._shape[1] + 6)
        wrenches: Matrix = np.empty(self.contact_acceleration.shape)
        _recover(self._terms, self._setup, self._active.unboxed, z, acceleration, wrenches, command)
        return command, acceleration, wrenches


def _refuse_duplicates(kind: str, names: Iterable[str]) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise ConfigError(f"{kind} '{name}' is given twice")
        seen.add(name)


def _make_mode(reduction: Reduction, limits: BodyLimits, extra: Sequence[RowLimit]) -> _Mode:
    """Allocate the QP, with the rows of all limits stacked."""
    nz, all_limits = reduction.maps.shape[2], [*limits, *extra]
    sizes = [limit.size(len(reduction.active)) for limit in all_limits]
    total = sum(sizes)
    soft = np.concatenate([limit.soft_rows(len(reduction.active)) for limit in all_limits])
    qp = QP(np.zeros((nz, nz)), np.zeros(nz), np.zeros((total, nz)), np.zeros(total), np.zeros(total), soft)
    spans = [slice(end - size, end) for size, end in zip(sizes, np.cumsum(sizes), strict=True)]
    joints, cones, torque, *others = (Rows(qp.matrix[span], qp.lower[span], qp.upper[span]) for span in spans)
    arrays = _ModeArrays(reduction, qp.hessian, qp.gradient, LimitRows(joints, cones, torque))
    return _Mode(arrays, unbox(arrays), qp, list(zip(extra, others, strict=True)))


@njit(cache=True)
def _build(model: Unboxed[ModelTerms], setup: Unboxed[_Setup], mode: Unboxed[_ModeArrays], *desired: Any) -> None:
    """Compute task rows, reduction, cost and limit rows; ``desired`` are the fields of ``Desired`` in order."""
    terms, shared, arrays, references = model.record, setup.record, mode.record, Desired(*desired)
    dynamics, reduction, held = terms.dynamics, arrays.reduction, shared.contact_acceleration
    body_rows(shared.tasks, terms, references)
    soles = references.sole_rotations, references.sole_positions
    eliminate(dynamics, *soles, shared.contacts, shared.edges, held, reduction)
    _assemble_cost(shared.stack, reduction, shared.regularisation, arrays.hessian, arrays.gradient)
    limit_rows(shared.limits, dynamics, reduction, arrays.rows)


@njit(cache=True, forceinline=True, fastmath={"contract"})
def _assemble_cost(stack: Stack, reduction: Reduction, regularisation: float, hessian: Array, gradient: Array) -> None:
    """Cost ``1/2 z'Hz + f'z`` of tasks, posture and wrenches, with ``a = N z + a0`` and ``w_i = P_i z + p_i``."""
    m, nz = stack.jacobian.shape[0], hessian.shape[0]
    basis, start, nu = reduction.basis, reduction.start, reduction.upper.shape[0]
    na = basis.shape[1]
    most = m + 6 * reduction.active.shape[0]
    rows, errors = np.zeros((most + 3, nz)), np.zeros(most + 3)  # padding by 3, since the sums use blocks of four rows
    used = 0
    for i in range(m):
        if stack.weight[i] == 0.0:
            continue
        root = np.sqrt(stack.weight[i])
        errors[used] = reduce_row(stack.jacobian[i], root, reduction, rows[used]) - root * stack.target[i]
        used += 1
    for contact in reduction.active:
        for i in range(6):
            root = np.sqrt(stack.wrench_weight[contact, i])
            errors[used] = root * (reduction.offsets[contact, i] - stack.wrench_target[contact, i])
            for c in range(nz):
                rows[used, c] = root * reduction.maps[contact, i, c]
            used += 1
    hessian[:, :] = 0.0
    gradient[:] = 0.0
    for i in range(0, used, 4):
        for r in range(nz):
            v0, v1, v2, v3 = rows[i, r], rows[i + 1, r], rows[i + 2, r], rows[i + 3, r]
            gradient[r] += v0 * errors[i] + v1 * errors[i + 1] + v2 * errors[i + 2] + v3 * errors[i + 3]
            for c in range(r, nz):
                hessian[r, c] += (v0 * rows[i, c] + v1 * rows[i + 1, c]) + (v2 * rows[i + 2, c] + v3 * rows[i + 3, c])
    weight, target = stack.posture_weight, stack.posture_target
    for c in range(nu):
        joint = reduction.upper[c] - 6
        hessian[c, c] += weight[joint]
        gradient[c] -= weight[joint] * target[joint]
    for k in reduction.core[6:]:
        error = start[k] - target[k - 6]
        for r in range(nu, na):
            value = weight[k - 6] * basis[k, r]
            if value == 0.0:
                continue
            gradient[r] += value * error
            for c in range(r, na):
                hessian[r, c] += value * basis[k, c]
    for r in range(nz):
        hessian[r, r] += regularisation
        for c in range(r):
            hessian[r, c] = hessian[c, r]


@njit(cache=True, fastmath={"reassoc", "contract"})
def _recover(
    model: Unboxed[ModelTerms],
    setup: Unboxed[_Setup],
    mode: Unboxed[_ModeArrays],
    z: Array,
    acceleration: Array,
    wrenches: Array,
    command: Array,
) -> None:
    """Accelerations (nv,), wrenches (contacts, 6) and setpoint (3, nj), with ``tau = M_j a + h_j - sum J_ij' w_i``."""
    terms, reduction, setpoint = model.record.dynamics, mode.record.reduction, setup.record.setpoint
    basis, torque = reduction.basis, command[2]
    nv, na = basis.shape
    for i in range(nv):
        total = reduction.start[i]
        for c in range(na):
            total += basis[i, c] * z[c]
        acceleration[i] = total
    for j in range(nv - 6):
        torque[j] = terms.bias[6 + j]
    for k in range(nv):
        for j in range(nv - 6):
            torque[j] += acceleration[k] * terms.mass_matrix[k, 6 + j]
    for contact in range(wrenches.shape[0]):
        for i in range(6):
            total = reduction.offsets[contact, i]
            for c in range(z.shape[0]):
                total += reduction.maps[contact, i, c] * z[c]
            wrenches[contact, i] = total
            for j in range(nv - 6):
                torque[j] -= total * terms.jacobians[contact, i, 6 + j]
    for j in range(nv - 6):
        step = setpoint.ahead[0] * acceleration[6 + j]
        v = terms.v[6 + j]
        q = terms.q[7 + j] + setpoint.ahead[0] * (v + 0.5 * step)
        command[0, j] = min(max(q, setpoint.q_min[j]), setpoint.q_max[j])
        command[1, j] = v + step
