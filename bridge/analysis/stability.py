"""Balance of one state, and stability of a run: CoM, divergent component of motion, zero-moment point, margin."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull

from bridge.record.recording import Recording
from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import Matrix, Vector


def support_polygon(corners: Sequence[Matrix]) -> Matrix:
    """Convex hull of sole corners (k, 2 or more) in W, counter-clockwise (n, 2) [m]; ``ValueError`` below three."""
    points = np.vstack([np.asarray(sole)[:, :2] for sole in corners])
    if len(points) < 3:
        raise ValueError(f"a support polygon needs three corners, found {len(points)}")
    return np.asarray(points[ConvexHull(points).vertices])


def _outward(polygon: Matrix) -> tuple[Matrix, Vector]:
    """Half-planes ``n . p <= b`` of a counter-clockwise polygon: normals (n, 2) [-] and offsets (n,) [m]."""
    edges = np.roll(polygon, -1, axis=0) - polygon
    normals = np.column_stack([edges[:, 1], -edges[:, 0]]) / np.linalg.norm(edges, axis=1)[:, None]  # (n, 2)
    return normals, np.einsum("ij,ij->i", normals, polygon)


def margin(polygon: Matrix, point: Vector) -> float:
    """Distance from a point to the nearest edge line of a counter-clockwise polygon [m], negative outside."""
    normals, offsets = _outward(polygon)
    return float(np.min(offsets - normals @ point[:2]))


def distance_along(polygon: Matrix, point: Vector, direction: Vector) -> float:
    """Distance from a point inside a counter-clockwise polygon to its edge along a unit direction [m], at least 0."""
    normals, offsets = _outward(polygon)
    slack = offsets - normals @ point[:2]
    rate = normals @ direction[:2]
    ahead = rate > 1e-12  # edges that the ray approaches; below 1e-12 it is parallel within rounding
    return float(max(0.0, np.min(slack[ahead] / rate[ahead])))


LOADED_FRACTION = 0.02  #: Fraction of the weight on both feet below which the robot is in flight [-]
FLOOR_GAP = 0.005  #: Height above the lower sole up to which a sole is on the floor, loaded or not [m]

LEAST_HEIGHT = 0.1  #: Least CoM height of the pendulum [m]; below it the robot lies on the floor


@dataclass(frozen=True, slots=True)
class Balance:
    """Balance of one state; W is the world frame, the floor is at the height of the lower sole.

    The CoM c is at height z over the floor. The divergent component of motion is ``xi = c + cdot / w``, with
    ``w = sqrt(g / z)``. At the centre of pressure p the ground reaction F has no horizontal moment. With the moment M
    of F about the origin of W and the floor height h, ``p = (h F_x - M_y, h F_y + M_x) / F_z``.
    """

    com: Vector  #: CoM in W (3,) [m]
    com_velocity: Vector  #: CoM velocity in W (3,) [m/s]
    dcm: Vector  #: Divergent component of motion in W (2,) [m]
    cop: Vector  #: Centre of pressure of all contacts in W (2,) [m]; NaN in flight, see ``LOADED_FRACTION``
    soles: Matrix  #: Origin of each sole in W (2, 3) [m]
    corners: Matrix  #: Corners of each sole in W (2, 4, 3) [m]
    tilts: Vector  #: Angle of each sole to the horizontal (2,) [rad]

    @property
    def polygon(self) -> Matrix:
        """Support polygon of both soles, loaded or not, counter-clockwise (n, 2) [m]."""
        return support_polygon(tuple(self.corners))


def balance(model: RobotModel, data: pin.Data, q: Vector, v: Vector, wrenches: ArrayLike) -> Balance:
    """Balance of q (nq,), v (nv,) and wrenches in the sole frames (2, 6); ``data`` is updated to this state."""
    pin.centerOfMass(model.pin, data, q, v)
    pin.updateFramePlacements(model.pin, data)
    com, velocity = data.com[0].copy(), data.vcom[0].copy()
    total, soles, corners, tilts = np.zeros(6), np.empty((2, 3)), np.empty((2, 4, 3)), np.empty(2)
    for k, (foot, wrench) in enumerate(zip(model.feet, np.asarray(wrenches), strict=True)):
        placement = data.oMf[foot.frame_id]
        total += placement.act(pin.Force(wrench)).vector
        soles[k] = placement.translation
        corners[k] = (placement.rotation @ foot.corners.T).T + placement.translation
        tilts[k] = np.arccos(np.clip(placement.rotation[2, 2], -1.0, 1.0))
    floor = soles[:, 2].min()
    dcm = com[:2] + velocity[:2] / np.sqrt(GRAVITY / max(com[2] - floor, LEAST_HEIGHT))
    cop = np.full(2, np.nan)
    if total[2] > LOADED_FRACTION * model.mass * GRAVITY:
        cop = np.array([floor * total[0] - total[4], floor * total[1] + total[3]]) / total[2]
    return Balance(com, velocity, dcm, cop, soles, corners, tilts)


@dataclass(frozen=True, slots=True)
class Stability:
    """Time series of balance; see ``Balance`` for the quantities and frames."""

    t: Vector  #: Stamps (n,) [s]
    com: Matrix  #: CoM in W (n, 3) [m]
    com_velocity: Matrix  #: CoM velocity in W (n, 3) [m/s]
    dcm: Matrix  #: Divergent component of motion (n, 2) [m]
    zmp: Matrix  #: Measured zero-moment point, the centre of pressure (n, 2) [m]; NaN in flight
    soles: Matrix  #: Origin of each sole in W (n, 2, 3) [m]
    #: Distance from the DCM to the edge of the support polygon (n,) [m]; negative outside, NaN in flight
    margin: Vector


def analyse(model: RobotModel, recording: Recording) -> Stability:
    """Compute the balance of every sample of a recording, one row each."""
    data = model.data()
    rows = [
        balance(model, data, q, v, wrenches)
        for q, v, wrenches in zip(recording.q, recording.v, recording.wrenches, strict=True)
    ]
    names = ("com", "com_velocity", "dcm", "cop", "soles")
    series = {name: np.array([getattr(row, name) for row in rows]) for name in names}
    return Stability(recording.t, zmp=series.pop("cop"), margin=np.array([_margin(row) for row in rows]), **series)


def _margin(row: Balance) -> float:
    """Margin of the DCM in the support polygon of the soles on the floor [m]; NaN in flight."""
    if np.isnan(row.cop).any():
        return np.nan
    heights = row.soles[:, 2]
    return margin(support_polygon(tuple(row.corners[heights < heights.min() + FLOOR_GAP])), row.dcm)


def stability_figures(stability: Stability, rest_s: float = 1.0) -> dict[str, float]:
    """Figures of a run; ``rest_s`` is the averaging time at its start and at its end [s].

    Returns ``com_drift_m`` (horizontal distance between the mean CoM at the end and at the start),
    ``dcm_excursion_max_m`` (largest distance of the DCM from its mean at the start), ``capture_margin_min_m`` and
    ``sole_motion_max_m`` (largest distance of a sole from its initial position).
    """
    t = stability.t
    first, last = t <= t[0] + rest_s, t >= t[-1] - rest_s
    drift = stability.com[last, :2].mean(axis=0) - stability.com[first, :2].mean(axis=0)
    excursion = np.linalg.norm(stability.dcm - stability.dcm[first].mean(axis=0), axis=1)
    return {
        "com_drift_m": float(np.linalg.norm(drift)),
        "dcm_excursion_max_m": float(excursion.max()),
        "capture_margin_min_m": float(np.nanmin(stability.margin)) if np.isfinite(stability.margin).any() else np.nan,
        "sole_motion_max_m": float(np.linalg.norm(stability.soles - stability.soles[0], axis=2).max()),
    }
