"""Compiled momentum observer: external torques, sole wrenches from leg torques, and the push on the whole robot."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from controllers.estimation.kernels_momentum import (
    CENTROID,
    JOINT_AXES,
    JOINT_MOMENTUM,
    JOINT_RATE,
    MOMENTUM,
    ORIGINS,
    SOLE_POSITIONS,
    SOLE_ROTATIONS,
)
from controllers.estimation.so3 import rotate, rotate_transposed
from controllers.memory import part_1, part_2, part_3
from models.compiled import njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]

OBSERVER = (
    "base", "joints", "past", "past_joints", "feet", "estimated", "measured", "push", "offset", "impulse", "detection",
    "lagged",
)  # fmt: skip
"""Parts of the observer's block; ``ForceObserver`` has their meaning."""

GAINS = (
    "push_rate", "joint_rate", "damping", "moment_arm", "friction_speed", "weight", "dead_band", "on", "off", "on_time",
    "off_time", "offset_time",
)  # fmt: skip
"""Order of the gains handed to the kernels, in SI units (forces in N)."""

BASE, JOINTS, PAST, PAST_JOINTS, FEET, ESTIMATED, MEASURED, PUSH, OFFSET, IMPULSE, DETECTION, LAGGED = range(12)


@njit(cache=True)
def _leg_wrench(
    torques: Array, columns: Index, axes: Array, origins: Array, sole: Array, rotation: Array, damping: float,
    arm: float, out: Array,
) -> None:  # fmt: skip
    """Wrench in the sole frame whose torques in one leg come closest to those observed: damped least squares.

    With x = (f, m / arm) in W and the rows of J scaled alike, (J J' + damping^2 I) x = J torques, by Cholesky.
    """
    normal = np.zeros((6, 6))
    solution = np.zeros(6)
    row = np.empty(6)
    for k in range(columns.shape[0]):
        n = columns[k]
        if n < 0:
            break
        axis = axes[n + 1]
        dx, dy, dz = sole[0] - origins[n + 1, 0], sole[1] - origins[n + 1, 1], sole[2] - origins[n + 1, 2]
        row[0] = axis[1] * dz - axis[2] * dy
        row[1] = axis[2] * dx - axis[0] * dz
        row[2] = axis[0] * dy - axis[1] * dx
        for i in range(3):
            row[3 + i] = arm * axis[i]
        for i in range(6):
            solution[i] += row[i] * torques[n]
            for j in range(i + 1):
                normal[i, j] += row[i] * row[j]
    for i in range(6):
        normal[i, i] += damping * damping
    for j in range(6):
        for i in range(j, 6):
            total = normal[i, j]
            for k in range(j):
                total -= normal[i, k] * normal[j, k]
            normal[i, j] = math.sqrt(total) if i == j else total / normal[j, j]
    for i in range(6):
        for k in range(i):
            solution[i] -= normal[i, k] * solution[k]
        solution[i] /= normal[i, i]
    for i in range(5, -1, -1):
        for k in range(i + 1, 6):
            solution[i] -= normal[k, i] * solution[k]
        solution[i] /= normal[i, i]
    for i in range(3):
        solution[3 + i] *= arm
    rotate_transposed(rotation, solution[0:3], out[0:3])
    rotate_transposed(rotation, solution[3:6], out[3:6])


@njit(cache=True)
def observe(
    speeds: Array, tau: Array, measured: Array, fault: Array, dt: float, gains: Array,
    legs: Index, bodies: Array, bodies_layout: Index, sweep: Array, layout: Index, observer: Array, own: Index,
) -> None:  # fmt: skip
    """One step of ``ForceObserver``, after ``generalised_momentum``; a step of 0 s starts it in a steady state.

    Args:
        speeds: Joint velocities (nj,) [rad/s].
        tau: Joint torques (nj,) [N.m].
        measured: What the foot sensors say, in the sole frames (2, 6) [N, N.m].
        fault: Not 0 where the leg torques are to be believed instead (2,).
        dt: Step [s].
        gains: ``GAINS``.
        legs: Joints of each leg, filled up with -1 (2, k).
        bodies: Masses and drives.
        bodies_layout: Its layout.
        sweep: Momentum.
        layout: Its layout.
        observer: In and out.
        own: Its layout.
    """
    push_gain, joint_gain = min(gains[0] * dt, 1.0), min(gains[1] * dt, 1.0)
    damping, friction = part_1(bodies, bodies_layout, 4), part_1(bodies, bodies_layout, 5)
    momentum, rate = part_1(sweep, layout, JOINT_MOMENTUM), part_1(sweep, layout, JOINT_RATE)
    total, centroid = part_2(sweep, layout, MOMENTUM)[0], part_2(sweep, layout, CENTROID)
    soles, turns = part_2(sweep, layout, SOLE_POSITIONS), part_3(sweep, layout, SOLE_ROTATIONS)
    base, joints = part_1(observer, own, BASE), part_1(observer, own, JOINTS)
    past, past_joints = part_1(observer, own, PAST), part_1(observer, own, PAST_JOINTS)
    feet, estimated = part_1(observer, own, FEET), part_2(observer, own, ESTIMATED)
    low_passed, push = part_2(observer, own, MEASURED), part_1(observer, own, PUSH)
    lagged = part_1(observer, own, LAGGED)
    weight = gains[5]
    start = dt <= 0.0
    for n in range(joints.shape[0]):
        known = rate[n] + tau[n] - damping[n] * speeds[n] - friction[n] * math.tanh(speeds[n] / gains[4])
        if start:
            joints[n] = -known
        else:
            joints[n] += joint_gain * ((momentum[n] - past_joints[n]) / dt - known - joints[n])
        past_joints[n] = momentum[n]
    for i in range(3):
        force = -weight if i == 2 else 0.0
        if start:
            base[i], base[3 + i] = -force, 0.0
        else:
            base[i] += push_gain * ((total[i] - past[i]) / dt - force - base[i])
            base[3 + i] += push_gain * ((centroid[2, i] - past[3 + i]) / dt - base[3 + i])
        past[i], past[3 + i] = total[i], centroid[2, i]
    sums = np.zeros(6)
    force, torque = np.empty(3), np.empty(3)
    for foot in range(2):
        _leg_wrench(
            joints, legs[foot], part_2(sweep, layout, JOINT_AXES), part_2(sweep, layout, ORIGINS), soles[foot],
            turns[foot], gains[2], gains[3], estimated[foot],
        )  # fmt: skip
        for i in range(6):
            low_passed[foot, i] += (1.0 if start else joint_gain) * (measured[foot, i] - low_passed[foot, i])
        # Either kind of wrench has been through the joints' low-pass: the base's rows must be too.
        wrench = low_passed[foot] if fault[foot] == 0.0 else estimated[foot]
        rotate(turns[foot], wrench[0:3], force)
        rotate(turns[foot], wrench[3:6], torque)
        x, y, z = soles[foot, 0] - centroid[0, 0], soles[foot, 1] - centroid[0, 1], soles[foot, 2] - centroid[0, 2]
        sums[3] += torque[0] + y * force[2] - z * force[1]
        sums[4] += torque[1] + z * force[0] - x * force[2]
        sums[5] += torque[2] + x * force[1] - y * force[0]
        for i in range(3):
            sums[i] += force[i]
    for i in range(6):
        feet[i] += (1.0 if start else push_gain) * (sums[i] - feet[i])
        lagged[i] += (1.0 if start else joint_gain) * (base[i] - lagged[i])
        push[i] = lagged[i] - feet[i]


@njit(cache=True)
def detect_push(dt: float, doubtful: bool, gains: Array, observer: Array, own: Index) -> bool:
    """Offset, detection with hysteresis and impulse of the push; ``detection`` is (active, timer [s]).

    Offsets of the foot sensors and errors of the masses look like a push that never ends: what stays within the
    dead-band is learnt as an offset, itself no larger than the dead-band, and taken off. While a foot sensor is in
    doubt, its lie looks like a push: then none begins.
    """
    push, offset = part_1(observer, own, PUSH), part_1(observer, own, OFFSET)
    impulse, detection = part_1(observer, own, IMPULSE), part_1(observer, own, DETECTION)
    for i in range(6):
        push[i] -= offset[i]
    size = math.sqrt(push[0] * push[0] + push[1] * push[1] + push[2] * push[2])
    active = detection[0] > 0.0
    if doubtful and not active:
        detection[1] = 0.0
        impulse[:] = 0.0
        return False
    if size < gains[8] if active else size > gains[7]:
        detection[1] += dt
        if detection[1] > (gains[10] if active else gains[9]):
            detection[0], detection[1] = 0.0 if active else 1.0, 0.0
    else:
        detection[1] = 0.0
    if size > gains[6]:
        for i in range(3):
            impulse[i] += dt * push[i]
    elif not active:
        impulse[:] = 0.0
        learnt = 0.0
        for i in range(6):
            offset[i] += dt / gains[11] * push[i]
            learnt += offset[i] * offset[i] if i < 3 else 0.0
        if learnt > gains[6] * gains[6]:
            for i in range(6):
                offset[i] *= gains[6] / math.sqrt(learnt)
    return bool(detection[0] > 0.0)
