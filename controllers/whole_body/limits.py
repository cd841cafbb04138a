"""Limits of the whole-body QP, each a class with its compiled code."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.qp.contacts import Reduction, reduce_row
from controllers.qp.terms import Dynamics, Terms
from models.numerics.compiled import njit
from models.types import Matrix, Reference, Vector

Array = NDArray[np.float64]

UNBOUNDED = 1e30  #: Value of an infinite bound
CONE_ROWS = 17  #: Rows of a wrench cone


class Rows(NamedTuple):
    """Rows ``lower <= matrix z <= upper`` of the reduced QP, views of its arrays."""

    matrix: Array  #: (k, nz)
    lower: Array  #: (k,)
    upper: Array  #: (k,)


class Limit(ABC):
    """Rows that every solution of the QP satisfies; a relaxed solve may violate ``soft`` rows at a cost."""

    name: str
    soft = False

    @abstractmethod
    def size(self, contacts: int) -> int:
        """Number of rows for a number of active contacts."""

    def soft_rows(self, contacts: int) -> NDArray[np.bool_]:
        """Rows that a relaxed solve may violate, for a number of active contacts."""
        return np.full(self.size(contacts), self.soft)

    def reset(self) -> None:  # noqa: B027
        """Discard the state of earlier ticks."""


class RowLimit(Limit):
    """A limit in addition to ``BodyLimits``, with a method that writes its rows."""

    @abstractmethod
    def update(self, terms: Terms, reference: Reference, reduction: Reduction, rows: Rows) -> None:
        """Write the rows of this tick, with ``a = N z + a0`` and ``w_i = P_i z + p_i`` of the reduction."""


class AccelerationLimit(RowLimit):
    """``lower <= G a <= upper`` on the generalised acceleration a (nv,), with ``matrix`` G (rows, nv).

    The entries of G should be of order one. A subclass implements ``bound`` and has a unique ``name``. Pass an instance
    to ``WholeBodyController(extra_limits=...)``. A relaxed solve may violate a ``soft`` limit.
    """

    def __init__(self, name: str, rows: int, nv: int, soft: bool = True) -> None:
        self.name, self.soft = name, soft
        self.matrix: Matrix = np.zeros((rows, nv))
        self.lower, self.upper = np.full(rows, -UNBOUNDED), np.full(rows, UNBOUNDED)

    @abstractmethod
    def bound(self, terms: Terms, reference: Reference) -> None:
        """Write ``matrix``, ``lower`` and ``upper`` in place."""

    def size(self, contacts: int) -> int:
        return len(self.lower)

    def update(self, terms: Terms, reference: Reference, reduction: Reduction, rows: Rows) -> None:
        """Write ``G N`` and the bounds minus ``G a0``."""
        self.bound(terms, reference)
        self.write(reduction, rows)

    def write(self, reduction: Reduction, rows: Rows) -> None:
        """Write the bounds into the reduced QP."""
        _acceleration_rows(self.matrix, self.lower, self.upper, reduction, rows)


@njit(cache=True)
def _acceleration_rows(matrix: Array, lower: Array, upper: Array, reduction: Reduction, rows: Rows) -> None:
    rows.matrix[:, :] = 0.0
    for i in range(matrix.shape[0]):
        constant = reduce_row(matrix[i], 1.0, reduction, rows.matrix[i])
        rows.lower[i], rows.upper[i] = lower[i] - constant, upper[i] - constant


class CoMHeightLimit(AccelerationLimit):
    r"""Keep the CoM's height above the lowest sole in contact between bounds ``minimum`` and ``maximum`` [m].

    .. math:: k (\underline v - \dot z) \le \ddot z \le k (\overline v - \dot z), \qquad \overline v = g (z_{max} - z),
        \quad \underline v = g (z_{min} - z)

    g is ``position_gain``, the largest approach speed per distance to a bound [1/s]; k is ``velocity_gain`` [1/s].
    """

    def __init__(self, minimum: float, maximum: float, position_gain: float, velocity_gain: float, nv: int) -> None:
        super().__init__("com_height", 1, nv)
        self.minimum, self.maximum = minimum, maximum
        self._position_gain, self._velocity_gain = position_gain, velocity_gain

    def bound(self, terms: Terms, reference: Reference) -> None:
        """One row, the vertical one of the CoM Jacobian."""
        soles = [sole for sole, contact in zip(terms.soles, reference.contacts, strict=True) if contact]
        height = terms.com[2] - min(sole.pose[2, 3] for sole in soles or terms.soles)
        self.matrix[0] = terms.com_jacobian[2]
        for out, bound in ((self.lower, self.minimum), (self.upper, self.maximum)):
            speed = self._position_gain * (bound - height)
            out[0] = self._velocity_gain * (speed - terms.com_velocity[2]) - terms.com_drift[2]


class JointBounds(NamedTuple):
    """Bounds and gains of ``JointLimit``, all (nj,)."""

    q_low: Array  #: Lowest position [rad]
    q_high: Array  #: Highest position [rad]
    v_max: Array  #: Largest speed [rad/s]
    scale: Array  #: Factor of each row and its bounds [-]
    position_gain: Array  #: g, largest approach speed per distance to a bound [1/s]
    velocity_gain: Array  #: k [1/s]
    acceleration: Array  #: Largest acceleration [rad/s^2]


class JointLimit(Limit):
    r"""Position and velocity limits of the joints as acceleration bounds.

    .. math:: \ddot q \le \mathrm{clip}(k (\overline v - \dot q), \pm \ddot q_{max}), \qquad
        \overline v = \mathrm{clip}(g (\overline q - q), \pm v_{max})

    and likewise for the lower bounds. No further margins are added to ``bounds``; the arrays may change between ticks.
    """

    name, soft = "joints", True

    def __init__(self, bounds: JointBounds) -> None:
        self.bounds = bounds
        nj = len(bounds.q_low)
        self.lower, self.upper = np.zeros(nj), np.zeros(nj)  #: Bounds of the last tick (nj,) [rad/s^2]

    def size(self, contacts: int) -> int:
        return len(self.lower)


@njit(cache=True, forceinline=True)
def _joint_rows(
    terms: Dynamics, bounds: JointBounds, lower: Array, upper: Array, reduction: Reduction, rows: Rows
) -> None:
    basis, start = reduction.basis, reduction.start
    na = basis.shape[1]
    for j in range(lower.shape[0]):
        q, v, speed, gain = terms.q[7 + j], terms.v[6 + j], bounds.v_max[j], bounds.position_gain[j]
        fastest = min(max(gain * (bounds.q_high[j] - q), -speed), speed)
        slowest = min(max(gain * (bounds.q_low[j] - q), -speed), speed)
        largest, gain = bounds.acceleration[j], bounds.velocity_gain[j]
        upper[j] = min(max(gain * (fastest - v), -largest), largest)
        lower[j] = min(max(gain * (slowest - v), -largest), largest)
        scale = bounds.scale[j]
        for c in range(rows.matrix.shape[1]):
            rows.matrix[j, c] = scale * basis[6 + j, c] if c < na else 0.0
        rows.lower[j] = scale * (lower[j] - start[6 + j])
        rows.upper[j] = scale * (upper[j] - start[6 + j])


class TorqueLimit(Limit):
    r""":math:`|M_j a + h_j - \sum_i J_{ij}^T w_i| \le \tau_{max}` (nj,) [N.m], divided by the limit."""

    name = "torque"

    def __init__(self, largest: Vector) -> None:
        self.largest = largest

    def size(self, contacts: int) -> int:
        return len(self.largest)


@njit(cache=True, forceinline=True, fastmath={"contract"})
def _torque_rows(terms: Dynamics, reduction: Reduction, largest: Array, rows: Rows) -> None:
    basis, start, mass = reduction.basis, reduction.start, terms.mass_matrix
    matrix, upper = rows.matrix, reduction.upper
    nu, na, nz, nj = upper.shape[0], basis.shape[1], matrix.shape[1], largest.shape[0]
    # N' M and a0' M, joint columns only: M is symmetric, so these sums run along its contiguous rows.
    product, torque = np.zeros((na, nj)), np.empty(nj)
    for j in range(nj):
        torque[j] = terms.bias[6 + j]
    for c in range(nu):
        for j in range(nj):
            product[c, j] = mass[upper[c], 6 + j]
    first = nu if reduction.active.shape[0] > 0 else 0
    for k in reduction.core:
        for j in range(nj):
            torque[j] += start[k] * mass[k, 6 + j]
        for c in range(first, na):
            value = basis[k, c]
            if value == 0.0:
                continue
            for j in range(nj):
                product[c, j] += value * mass[k, 6 + j]
    for j in range(nj):
        for c in range(nz):
            matrix[j, c] = product[c, j] / largest[j] if c < na else 0.0
    for contact in reduction.active:
        for column in reduction.core[6:]:
            j = column - 6
            for k in range(6):
                value = terms.jacobians[contact, k, column]
                if value == 0.0:
                    continue
                torque[j] -= value * reduction.offsets[contact, k]
                value /= largest[j]
                for c in range(nz):
                    matrix[j, c] -= value * reduction.maps[contact, k, c]
    for j in range(nj):
        rows.lower[j], rows.upper[j] = -1.0 - torque[j] / largest[j], 1.0 - torque[j] / largest[j]


class WrenchConeLimit(Limit):
    """Wrenches that flat rectangular contacts can transmit without moving; ``frictions`` are Coulomb coefficients [-].

    Each side of the rectangles is reduced by ``margin`` [m]. The normal force of an active contact is between
    ``force_min`` and ``force_max`` [N], or within the range of ``set_load``. Rows and bounds are divided by the force
    ``scale`` [N], so that absolute tolerances of the solvers apply to every robot.
    """

    name = "wrench_cone"

    def __init__(self, frictions: list[float], margin: float, force_min: float, force_max: float, scale: float) -> None:
        count = len(frictions)
        self._frictions, self._margin = frictions, margin
        self._forces, self._scale = (force_min, force_max), scale
        self.matrix: NDArray[np.float64] = np.zeros((count, CONE_ROWS, 6))
        self.lower, self.upper = np.zeros((count, CONE_ROWS)), np.zeros((count, CONE_ROWS))

    def set_friction(self, friction: float) -> None:
        """Set the coefficient of all contacts [-]; it takes effect at the next ``set_area``."""
        self._frictions = [friction] * len(self._frictions)

    def set_area(self, contact: int, rectangle: Sequence[float]) -> None:
        """Set the support area of a contact: x_min, x_max, y_min, y_max in its frame (4,) [m]."""
        x_min, x_max, y_min, y_max = rectangle
        # The margins leave at least half the width of a narrow area.
        margin = min(self._margin, 0.25 * (x_max - x_min), 0.25 * (y_max - y_min))
        area = np.array([x_min + margin, x_max - margin, y_min + margin, y_max - margin])
        matrix, bounds = self.matrix[contact], (self.lower[contact], self.upper[contact])
        fill_cone(area, self._frictions[contact], *self._forces, self._scale, matrix, *bounds)

    def set_load(self, load: Sequence[float], least: float = 0.0) -> None:
        """Set the upper bound of each contact's normal force as a share of ``force_max`` (contacts,) [-].

        The lower bound is the share ``least`` of ``scale`` [-], but not less than ``force_min``.
        """
        force_min, force_max = max(self._forces[0], least * self._scale), self._forces[1]
        # The normal force is the cone's last row; twice the least force keeps an unloaded contact feasible.
        self.lower[:, -1] = force_min / self._scale
        self.upper[:, -1] = [max(share * force_max, 2.0 * force_min) / self._scale for share in load]

    def size(self, contacts: int) -> int:
        """``CONE_ROWS`` per active contact, stacked."""
        return CONE_ROWS * contacts

    def soft_rows(self, contacts: int) -> NDArray[np.bool_]:
        """The bounds of the normal force; the friction rows still prevent tensile forces."""
        rows = super().soft_rows(contacts)
        rows[CONE_ROWS - 1 :: CONE_ROWS] = True
        return rows


@njit(cache=True, forceinline=True, fastmath={"contract"})
def _cone_rows(cone: Array, cone_lower: Array, cone_upper: Array, reduction: Reduction, rows: Rows) -> None:
    matrix, nz = rows.matrix, rows.matrix.shape[1]
    used = 0
    for contact in reduction.active:
        for i in range(cone.shape[1]):
            constant = 0.0
            matrix[used] = 0.0
            for k in range(6):
                value = cone[contact, i, k]
                if value == 0.0:
                    continue
                constant += value * reduction.offsets[contact, k]
                for c in range(nz):
                    matrix[used, c] += value * reduction.maps[contact, k, c]
            rows.lower[used] = cone_lower[contact, i] - constant
            rows.upper[used] = cone_upper[contact, i] - constant
            used += 1


@njit(cache=True, fastmath={"contract"})
def fill_cone(
    rectangle: Array,
    friction: float,
    force_min: float,
    force_max: float,
    scale: float,
    matrix: Array,
    lower: Array,
    upper: Array,
) -> None:
    """Rows ``lower <= G w <= upper`` for a wrench that a flat rectangular contact can transmit without moving.

    For a rectangle centred at the contact's origin, the rows are Caron's closed form: friction (4 rows), CoP (4 rows),
    yaw moment (8 rows) and unilaterality (1 row). For other rectangles (4,) [m], the moment is transformed to the
    centre. The friction pyramid is inscribed, mu / sqrt(2) along each axis; ``scale`` [N] divides rows and bounds.

    Source: Caron, Pham, Nakamura: Stability of surface contacts for humanoid robots (ICRA 2015), eq. 19-28.
    """
    centre_x, centre_y = 0.5 * (rectangle[0] + rectangle[1]), 0.5 * (rectangle[2] + rectangle[3])
    half_x, half_y = 0.5 * (rectangle[1] - rectangle[0]), 0.5 * (rectangle[3] - rectangle[2])
    mu = friction / np.sqrt(2.0)
    matrix[:] = 0.0
    row = 8
    for i in range(2):
        sign = 1.0 - 2.0 * i
        matrix[i, 0] = matrix[2 + i, 1] = matrix[4 + i, 3] = matrix[6 + i, 4] = sign
        matrix[i, 2] = matrix[2 + i, 2] = -mu
        matrix[4 + i, 2], matrix[6 + i, 2] = -half_y, -half_x
        for sign_y in (1.0, -1.0):
            for sign_z in (1.0, -1.0):
                # sign tau_z + |Y f_x + sign mu tau_x| + |X f_y + sign mu tau_y| <= mu (X + Y) f_z
                matrix[row, 0], matrix[row, 1], matrix[row, 2] = sign * half_y, sign_y * half_x, -mu * (half_x + half_y)
                matrix[row, 3], matrix[row, 4], matrix[row, 5] = sign_z * sign * mu, sign_z * sign_y * mu, sign_z
                row += 1
    for row in range(16):  # transform rows for the wrench at the centre to the wrench at the contact's origin
        moment_x, moment_y, moment_z = matrix[row, 3], matrix[row, 4], matrix[row, 5]
        matrix[row, 0] += moment_z * centre_y
        matrix[row, 1] -= moment_z * centre_x
        matrix[row, 2] = (matrix[row, 2] - moment_x * centre_y) + moment_y * centre_x
    matrix[16, 2] = 1.0
    matrix /= scale
    lower[:16], lower[16] = -UNBOUNDED / scale, force_min / scale
    upper[:16], upper[16] = 0.0, force_max / scale


class LimitArrays(NamedTuple):
    """Arrays of ``BodyLimits`` for compiled code."""

    bounds: JointBounds
    lower: Array
    upper: Array
    cone: Array
    cone_lower: Array
    cone_upper: Array
    largest_torque: Array


class LimitRows(NamedTuple):
    """Rows of ``BodyLimits``."""

    joints: Rows
    cones: Rows
    torque: Rows


class BodyLimits(NamedTuple):
    """Limits of every robot; one compiled call writes all of their rows."""

    joints: JointLimit
    cones: WrenchConeLimit
    torque: TorqueLimit

    @property
    def arrays(self) -> LimitArrays:
        """Record for compiled code."""
        joints, cones = self.joints, self.cones
        cone = cones.matrix, cones.lower, cones.upper
        return LimitArrays(joints.bounds, joints.lower, joints.upper, *cone, self.torque.largest)


@njit(cache=True, forceinline=True)
def limit_rows(limits: LimitArrays, terms: Dynamics, reduction: Reduction, rows: LimitRows) -> None:
    """Write the rows of joints, wrench cones and torques, with ``a = N z + a0`` and ``w_i = P_i z + p_i``."""
    _joint_rows(terms, limits.bounds, limits.lower, limits.upper, reduction, rows.joints)
    _cone_rows(limits.cone, limits.cone_lower, limits.cone_upper, reduction, rows.cones)
    _torque_rows(terms, reduction, limits.largest_torque, rows.torque)
