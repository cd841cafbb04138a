"""Compiled part of the joint monitor."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.numerics.compiled import njit

Array = NDArray[np.float64]


@njit(cache=True)
def watch_joints(
    q: Array,
    v: Array,
    tau: Array,
    command: Array,
    gains: Array,
    tick: int,
    expected: Array,
    torques: Array,
    last: Array,
    still: NDArray[np.int64],
    mean: Array,
) -> int:
    """One tick of every joint.

    Args:
        q: Measured positions (nj,) [rad].
        v: Measured velocities (nj,) [rad/s].
        tau: Measured torques (nj,) [N.m].
        command: Set-points of position, velocity and torque that the drivers have (3, nj).
        gains: kp, kd, largest torque, allowed error of the mean torque; of a motor that gives nothing: least torque
            told, largest torque given; lowest and highest position and fastest velocity at which the drivers do as they
            are told; largest change of a torque in a tick (10, nj).
        tick: Number of the tick.
        expected: In and out: torques that the drivers give (nj,) [N.m].
        torques: In and out: torques expected and given in the last ticks (rows, 2, nj) [N.m].
        last: In and out: positions and velocities of the tick before (2, nj) [rad, rad/s].
        still: In and out: ticks for which both have been the same (nj,).
        mean: Out: means of the torques expected and given, and of the size of the latter (3, nj) [N.m].

    Returns:
        0 when all is well, 1 + the index of a motor at fault, or -1 - the index of an encoder.
    """
    rows, nj = torques.shape[0], torques.shape[2]
    row, found = tick % rows, 0
    for j in range(nj):
        told = command[2, j] + gains[0, j] * (command[0, j] - q[j]) + gains[1, j] * (command[1, j] - v[j])
        told = min(max(told, -gains[2, j]), gains[2, j])
        known = np.isfinite(told) and np.isfinite(tau[j])  # a sample that is missing tells nothing
        known = known and gains[6, j] < q[j] < gains[7, j] and abs(v[j]) < gains[8, j]
        if known:
            expected[j] += min(max(told - expected[j], -gains[9, j]), gains[9, j])
            torques[row, 0, j], torques[row, 1, j] = expected[j], tau[j]
        else:  # what they make of it there cannot be told: begin again from what they give
            expected[j] = tau[j] if np.isfinite(tau[j]) else 0.0
            torques[row, 0, j] = torques[row, 1, j] = 0.0
        still[j] = still[j] + 1 if q[j] == last[0, j] and v[j] == last[1, j] else 0
        last[0, j], last[1, j] = q[j], v[j]
        if still[j] >= rows:
            found = -1 - j
        mean[:, j] = 0.0
        for i in range(rows):
            mean[0, j] += torques[i, 0, j] / rows
            mean[1, j] += torques[i, 1, j] / rows
            mean[2, j] += abs(torques[i, 1, j]) / rows
        wrong = abs(mean[1, j] - mean[0, j]) > gains[3, j]
        dead = abs(mean[0, j]) > gains[4, j] and mean[2, j] < gains[5, j]
        if (wrong or dead) and found == 0:
            found = 1 + j
    return found
