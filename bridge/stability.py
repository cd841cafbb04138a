"""How stable a run was: CoM, divergent component of motion, zero-moment point and capture margin of a recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from bridge.recording import Recording
from bridge.support_polygon import margin, support_polygon
from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import Matrix, Vector

LOADED_FRACTION = 0.02
"""Part of the weight that the feet bear together below which the robot counts as in flight [-]."""

FLOOR_GAP = 0.005
"""A sole that is not farther above the lower one stands on the floor, loaded or not: it can take load at once [m]."""


@dataclass(frozen=True, slots=True)
class Stability:
    """Time series of balance; W is the world frame, all horizontal quantities are x and y.

    With ``w = sqrt(g / z)``, the divergent component of motion is ``xi = c + cdot / w`` and the zero-moment point
    ``p = (-M_y / F_z, M_x / F_z)`` for the ground reaction ``F`` with moment ``M`` about the origin of the floor.

    Attributes:
        t: Stamps (n,) [s].
        com: CoM in W (n, 3) [m].
        com_velocity: CoM velocity in W (n, 3) [m/s].
        dcm: Divergent component of motion (n, 2) [m].
        zmp: Measured zero-moment point (n, 2) [m]; NaN in flight.
        soles: Origin of each sole in W (n, 2, 3) [m].
        margin: Distance from the DCM to the edge of the support polygon of the soles on the floor (n,) [m]; negative
            outside of it, NaN in flight.
    """

    t: Vector
    com: Matrix
    com_velocity: Matrix
    dcm: Matrix
    zmp: Matrix
    soles: Matrix
    margin: Vector


def analyse(model: RobotModel, recording: Recording) -> Stability:
    """Compute the balance of every sample of a recording.

    Args:
        model: The robot of the recording.
        recording: The run.

    Returns:
        One row per sample.
    """
    n = len(recording.t)
    data = model.data()
    com, velocity = np.empty((n, 3)), np.empty((n, 3))
    zmp, soles, margins = np.full((n, 2), np.nan), np.empty((n, 2, 3)), np.full(n, np.nan)
    weight = model.mass * GRAVITY
    for i in range(n):
        pin.centerOfMass(model.pin, data, recording.q[i], recording.v[i])
        pin.framesForwardKinematics(model.pin, data, recording.q[i])
        com[i], velocity[i] = data.com[0], data.vcom[0]
        total = np.zeros(6)
        outlines = []
        for k, foot in enumerate(model.feet):
            placement = data.oMf[foot.frame_id]
            soles[i, k] = placement.translation
            total += placement.act(pin.Force(recording.wrenches[i, k])).vector
            outlines.append((placement.rotation @ foot.corners.T).T + placement.translation)
        if total[2] > LOADED_FRACTION * weight:
            floor = soles[i, :, 2].min()
            standing = [outline for k, outline in enumerate(outlines) if soles[i, k, 2] < floor + FLOOR_GAP]
            omega = np.sqrt(GRAVITY / (com[i, 2] - floor))
            zmp[i] = -total[4] / total[2], total[3] / total[2]
            margins[i] = margin(support_polygon(standing), com[i, :2] + velocity[i, :2] / omega)
    height = com[:, 2] - soles[:, :, 2].min(axis=1)
    dcm = com[:, :2] + velocity[:, :2] / np.sqrt(GRAVITY / height)[:, None]
    return Stability(recording.t, com, velocity, dcm, zmp, soles, margins)


def stability_figures(stability: Stability, rest_s: float = 1.0) -> dict[str, float]:
    """Numbers that sum a run up.

    Args:
        stability: The run.
        rest_s: Length of the quiet time at its beginning and end that is averaged for the drift [s].

    Returns:
        ``com_drift_m`` (horizontal distance of the mean CoM at the end from that at the start),
        ``dcm_excursion_max_m`` (largest distance of the DCM from its mean at the start), ``capture_margin_min_m`` and
        ``sole_motion_max_m`` (largest distance of a sole from where it was at the start).
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
