"""Foot sensors held against the leg torques: a sensor that lies is replaced by what the torques say."""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from controllers.estimation.config import FootSensorConfig
from controllers.estimation.observer import ForceObserver
from models.compiled import njit
from models.types import Matrix

Array = NDArray[np.float64]

UNKNOWN = -1.0
"""Of the expected contact of a foot: there is no gait schedule."""

NOT_FINITE, SATURATED = 1.0, 2.0
"""State of a foot's sample, in the buffer; 0 is sound."""


class FootSensorState(StrEnum):
    """What is thought of one foot's sensor."""

    SOUND = "sound"
    ABSENT = "absent"
    """Nothing finite came for too long, or none is fitted."""
    CONTRADICTED = "contradicted"
    """It and the leg torques spoke of different loads for too long, and the torques fit the motion."""

    def __repr__(self) -> str:
        """The value alone: diagnostics print tuples of these."""
        return self.value


_STATES = (FootSensorState.SOUND, FootSensorState.ABSENT, FootSensorState.CONTRADICTED)


@njit(cache=True)
def _judge(
    samples: Array, readings: Array, low_passed: Array, estimated: Array, total: float, torques_good: bool,
    expected: Array, limits: Array, dt: float, fault: Array, timers: Array, last: Array, counts: Array, used: Array,
    doubt: Array,
) -> bool:  # fmt: skip
    """One step of ``FootSensorMonitor``; ``timers``: of absence, contradiction and agreement, per foot [s].

    ``limits``: load error [N], sum error [N], fault time, time where the schedule sides with the torques, recovery
    time [s], estimated load below and above which a foot swings or stands for certain [N], load error of a foot that
    one witness has in the air [N], time that the low-passes take to forget a fault [s].
    """
    wrong_torques = abs(total - estimated[0, 2] - estimated[1, 2])
    wrong_sensors = abs(total - low_passed[0, 2] - low_passed[1, 2])
    doubt[0] = max(doubt[0] - dt, 0.0)
    before = fault[0] + 3.0 * fault[1]
    credible = torques_good and wrong_torques <= max(limits[1], wrong_sensors)
    for foot in range(2):
        if samples[foot] == 1.0:
            timers[foot, 0] += dt if fault[foot] != 1.0 else 0.0
            timers[foot, 2] = 0.0
            if timers[foot, 0] > limits[2] and fault[foot] != 1.0:
                counts[foot] += fault[foot] == 0.0
                fault[foot], timers[foot, 0] = 1.0, 0.0
        else:
            timers[foot, 0] = 0.0
            load = estimated[foot, 2]
            read = low_passed[foot, 2]
            # Whether a foot bears at all is the graver question: smaller differences count where one says no.
            if abs(read - load) > (limits[7] if min(read, load) < limits[5] else limits[0]):
                timers[foot, 2] = 0.0
                if credible and fault[foot] == 0.0:
                    timers[foot, 1] += dt
                    sides = (expected[foot] == 0.0 and load < limits[5]) or (expected[foot] > 0.0 and load > limits[6])
                    if timers[foot, 1] > (limits[3] if sides else limits[2]):
                        fault[foot], timers[foot, 1] = 2.0, 0.0
                        counts[foot] += 1.0
            else:
                timers[foot, 1] = 0.0
                alive = False  # a dead sensor repeats itself to the last bit
                for i in range(6):
                    alive = alive or readings[foot, i] != last[foot, i]
                if fault[foot] > 0.0 and alive:
                    timers[foot, 2] += dt
                    if timers[foot, 2] > limits[4]:
                        fault[foot], timers[foot, 2] = 0.0, 0.0
        for i in range(6):
            last[foot, i] = readings[foot, i]
            used[foot, i] = readings[foot, i] if fault[foot] == 0.0 else estimated[foot, i]
    changed = bool(before != fault[0] + 3.0 * fault[1])
    if changed or timers[0, 1] + timers[1, 1] + timers[0, 0] + timers[1, 0] > 0.0:
        doubt[0] = limits[8]
    return changed


class FootSensorMonitor:
    """Which foot sensors can be believed, and the wrenches to go by.

    Three witnesses speak of the load on the feet: the sensors, the leg torques, and the motion of the CoM, which gives
    the sum of both. A sensor that contradicts the torques by more than ``load_error`` for ``fault_time`` is out (by
    more than ``contact_error`` where one of them has the foot in the air), if the torques' sum fits the motion (within
    ``sum_error``, or better than the sensors' sum does); after ``scheduled_time`` already, if the gait schedule sides
    with the torques. So is one that says nothing for ``fault_time``. It comes back after it has agreed with the torques
    for ``recover_time`` in readings that are not always the same.

    Attributes:
        used: Wrench of each sole to go by, in its frame (2, 6) [N, N.m].
        fault: 0 sound, 1 absent, 2 contradicted, of each foot (2,).
        counts: How often each sensor has failed (2,).
        changed: Whether the last step has changed ``fault``.

    Args:
        config: Limits.
        weight: Of the robot [N].
        fitted: Whether the robot has foot sensors at all.
    """

    def __init__(self, config: FootSensorConfig, weight: float, fitted: bool) -> None:
        self._limits = np.array(
            [
                config.load_error * weight,
                config.sum_error * weight,
                config.fault_time,
                config.scheduled_time,
                config.recover_time,
                config.swing_load * weight,
                config.stance_load * weight,
                config.contact_error * weight,
                config.settle_time,
            ]
        )
        self.fitted = fitted
        self.used = np.zeros((2, 6))
        self.fault, self.counts = np.zeros(2), np.zeros(2)
        self.changed = False
        self._doubt = np.zeros(1)
        self._timers, self._last = np.zeros((2, 3)), np.zeros((2, 6))

    @property
    def doubtful(self) -> bool:
        """Whether a sensor is in doubt now, or the low-passes still remember that one was."""
        return bool(self._doubt[0] > 0.0)

    @property
    def states(self) -> tuple[FootSensorState, FootSensorState]:
        """What is thought of the left and the right foot's sensor."""
        return _STATES[int(self.fault[0])], _STATES[int(self.fault[1])]

    def reset(self, samples: Array, readings: Matrix, estimated: Matrix) -> None:
        """Start over; a foot whose first sample is not finite has no sensor until it speaks."""
        self._timers[:], self.counts[:], self._doubt[:] = 0.0, 0.0, 0.0
        self.fault[:] = samples == NOT_FINITE
        self._last[:] = readings
        self.used[:] = np.where(self.fault[:, None] > 0.0, estimated, readings)

    def update(
        self, samples: Array, readings: Matrix, observer: ForceObserver, torques_good: bool, expected: Array, dt: float
    ) -> None:
        """Judge one sample.

        Args:
            samples: Whether each foot's sample is sound, not finite or saturated (2,).
            readings: The last finite reading of each (2, 6) [N, N.m].
            observer: After the step before: torques, motion, and the low-passed readings.
            torques_good: Whether the joint torques of this sample are usable.
            expected: What the gait schedule says of each foot: 1 stands, 0 swings, ``UNKNOWN`` (2,).
            dt: Step [s].
        """
        self.changed = _judge(
            samples, readings, observer.measured, observer.estimated, observer.base[2], torques_good, expected,
            self._limits, dt, self.fault, self._timers, self._last, self.counts, self.used,
            self._doubt,
        )  # fmt: skip
