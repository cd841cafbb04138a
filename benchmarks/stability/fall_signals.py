"""What a robot did in the last moments of a trial: all that is needed to see why it failed, as plain numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.core.harness import Case
from bridge.closed_loop import ClosedLoop
from bridge.loop.log import LoopLog
from bridge.stability import balance
from models.constants import GRAVITY
from models.heading import heading, turned
from models.robot_model import RobotModel
from models.types import Matrix, Mode, Vector

ROWS = 300  # most rows that are kept
AFTER = 0.1  # kept after the robot was damped [s]

#: How many joints are kept of those nearest to the limit of their torque, and of their position
LEG_JOINTS, OTHER_JOINTS = 3, 2
SATURATED = 0.95  # share of its limit from which on a torque counts as at it [-]


def last_moments(loop: ClosedLoop, duration: float) -> Case:
    """Signals of the ``duration`` [s] before the robot was damped, or before the end of the log; ``moments_since``."""
    return moments_since(loop, _end(loop.log) - duration)


def _end(log: LoopLog) -> float:
    """When the robot was given up, or the last stamp [s]."""
    given_up = log.t[[mode is Mode.DAMP for mode in log.modes]]
    return float(given_up[0] if len(given_up) else log.t[-1])


def moments_since(loop: ClosedLoop, begin: float) -> Case:
    """The end of a robot's log, places relative to its CoM and along its heading at each moment.

    Estimates and commands of the laws are in their drifting frame: they are relative to the estimated CoM and heading.
    The first row is at ``begin`` [s] or when the robot was damped, if earlier; the last row is ``AFTER`` that.

    Returns:
        Lists of n rows: ``t`` [s]; forward and left of the CoM [m] ``dcm``, ``cop`` (null in flight), ``dcm_seen`` and
        ``cmp`` (as the law sees and commands them); of both feet ``soles_low`` and ``soles_high``, between which the
        corners of the sole lie, and ``aims``, the foothold of the foot that swings (null otherwise); ``loads`` and
        ``planned_loads`` over the weight [-], ``heights`` of the lowest corner in W [m], ``tilts`` of the soles [deg];
        ``base_tilt`` to the front and to the left [deg], ``base_height`` over the lower sole [m]; ``status`` of the QP,
        ``mode``. By name of the joints nearest to their limits: ``torques``, shares of the limit [-], and ``margins``
        [deg]. ``events``: stamp and text.
    """
    log, model = loop.log, loop.robot
    end = _end(log)
    recent = np.flatnonzero((log.t >= min(begin, end)) & (log.t <= end + AFTER))
    rows = recent[:: -max(-(-len(recent) // ROWS), 1)][::-1]
    true, weight = _true_signals(model, log.true_q[rows], log.true_v[rows], log.wrenches[rows]), model.mass * GRAVITY
    yaws = [heading(*q[3:7]) for q in log.estimate_q[rows]]
    aims = np.full((len(rows), 2, 2), np.nan)
    for foot in range(2):
        swings = log.swing[rows] == foot
        aims[swings, foot] = log.footholds[rows][swings, 2 * foot : 2 * foot + 2]
    com, statuses, modes = log.com[rows, :2], log.statuses, log.modes
    acting = np.array([modes[row] is not Mode.DAMP for row in rows])  # what happens later explains nothing
    acting |= not acting.any()  # ... unless there is nothing else
    names, joints = np.array(model.joint_names), log.true_q[rows, 7:]
    shares = np.abs(log.tau[rows]) / model.tau_max  # (n, nj)
    margins = np.degrees(np.minimum(joints - model.q_lower, model.q_upper - joints))  # (n, nj)
    strained = _first(model, -shares[acting].max(axis=0) - (shares[acting] > SATURATED).mean(axis=0))
    nearest = _first(model, margins[acting].min(axis=0))
    signals = {
        "t": log.t[rows],
        **true,
        "dcm_seen": _seen(log.dcm[rows], com, yaws),
        "cmp": _seen(log.zmp[rows], com, yaws),
        "aims": _seen(aims, com, yaws),
        "loads": log.wrenches[rows][:, [2, 8]] / weight,
        "planned_loads": log.planned_wrenches[rows][:, [2, 8]] / weight,
    }
    return {
        **{name: _rounded(values) for name, values in signals.items()},
        "status": [statuses[row].value for row in rows],
        "mode": [modes[row].value for row in rows],
        "torques": {names[i]: _rounded(shares[:, i]) for i in strained},
        "margins": {names[i]: _rounded(margins[:, i]) for i in nearest},
        "events": [[t, text] for t, text in loop.events if t >= log.t[rows[0]]],
    }


def _first(model: RobotModel, score: Vector) -> list[int]:
    """The joints of the smallest scores (nj,): some of the legs, then some of the rest, whose arms swing hardest."""
    order = np.argsort(score, kind="stable").tolist()
    legs = {index - 6 for foot in model.feet for index in foot.joint_ids_v}
    return [i for i in order if i in legs][:LEG_JOINTS] + [i for i in order if i not in legs][:OTHER_JOINTS]


def _rounded(values: Matrix) -> Any:
    return values.round(4).tolist()


def _seen(points: Matrix, com: Matrix, yaws: Sequence[float]) -> Matrix:
    """Points (n, ..., 2) from a CoM (n, 2), along a heading a row."""
    places = com.reshape(len(com), *[1] * (points.ndim - 2), 2)
    return np.array([turned(row, -yaw) for row, yaw in zip(points - places, yaws, strict=True)])


def _true_signals(model: RobotModel, q: Matrix, v: Matrix, wrenches: Matrix) -> dict[str, Matrix]:
    """Those of ``moments_since`` that take the true state (n, nq), (n, nv) and wrenches (n, 12)."""
    data, rows = model.data(), []
    for i in range(len(q)):
        now, yaw = balance(model, data, q[i], v[i], wrenches[i].reshape(2, 6)), heading(*q[i, 3:7])
        com, heights, up = now.com[:2], now.corners[:, :, 2].min(axis=1), data.oMi[1].rotation[:, 2]
        seen = turned(now.corners[:, :, :2] - com, -yaw)  # (2, 4, 2)
        rows.append(
            {
                "dcm": turned(now.dcm - com, -yaw),
                "cop": turned(now.cop - com, -yaw),
                "soles_low": seen.min(axis=1),
                "soles_high": seen.max(axis=1),
                "heights": heights,
                "tilts": np.degrees(now.tilts),
                "base_tilt": np.degrees(np.arctan2(turned(up[:2], -yaw), up[2])),
                "base_height": q[i, 2] - heights.min(),
            }
        )
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}
