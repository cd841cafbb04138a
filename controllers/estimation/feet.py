"""Foot sensors, contacts and slips: which feet bear load, and how much each measurement is trusted."""

import math
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.estimation.config import ContactConfig, FootNoise, FootSensorConfig, SlipConfig
from models.numerics.compiled import njit
from models.robot_model import RobotModel
from models.types import Matrix, Vector

Array = NDArray[np.float64]

UNKNOWN = -1.0  #: Expected contact of a foot without a gait schedule
NOT_FINITE, SATURATED = 1.0, 2.0  #: States of a foot sample in the buffer; 0 is sound


class FootSensorState(StrEnum):
    """State of one foot sensor."""

    SOUND = "sound"
    ABSENT = "absent"  # no finite sample for too long, or no sensor fitted
    CONTRADICTED = "contradicted"  # contradicts the leg torques for too long while those fit the motion

    def __repr__(self) -> str:
        """The value alone, for tuples in diagnostics."""
        return self.value


_STATES = (FootSensorState.SOUND, FootSensorState.ABSENT, FootSensorState.CONTRADICTED)


class SensorLimits(NamedTuple):
    """``FootSensorConfig`` with loads in N."""

    load_error: float
    contact_error: float
    sum_error: float
    swing_load: float
    stance_load: float
    fault_time: float
    scheduled_time: float
    recover_time: float
    settle_time: float


class SensorMemory(NamedTuple):
    """Limits and state of ``FootSensorMonitor``."""

    limits: SensorLimits
    fault: Array  # (2,)
    timers: Array  # of absence, contradiction and agreement, per foot (2, 3) [s]
    last: Array  # readings (2, 6)
    counts: Array  # (2,)
    used: Array  # (2, 6)
    doubt: Array  # remaining time in which a sensor is in doubt, for the low-passes to settle (1,) [s]


@njit(cache=True)
def judge_sensors(
    samples: Array, readings: Array, low_passed: Array, estimated: Array, total: float, torques_good: bool,
    expected: Array, dt: float, sensors: SensorMemory,
) -> bool:  # fmt: skip
    """One step of ``FootSensorMonitor``; returns whether a fault has begun or ended.

    ``samples`` is the state of each foot sample (2,), ``readings`` the last finite reading (2, 6). The previous step of
    the observer gives the ``low_passed`` readings, the wrenches ``estimated`` from the leg torques (2, 6) [N, N.m], and
    the ``total`` load from the motion [N]. ``torques_good`` is whether the joint torques of this sample are usable.
    ``expected`` is 1 for a stance foot of the gait schedule, 0 for a swing foot, or ``UNKNOWN`` (2,).
    """
    limits, fault, timers, last, counts, used, doubt = sensors
    wrong_torques = abs(total - estimated[0, 2] - estimated[1, 2])
    wrong_sensors = abs(total - low_passed[0, 2] - low_passed[1, 2])
    doubt[0] = max(doubt[0] - dt, 0.0)
    before = fault[0] + 3.0 * fault[1]
    credible = torques_good and wrong_torques <= max(limits.sum_error, wrong_sensors)
    for foot in range(2):
        if samples[foot] == 1.0:
            timers[foot, 0] += dt if fault[foot] != 1.0 else 0.0
            timers[foot, 2] = 0.0
            if timers[foot, 0] > limits.fault_time and fault[foot] != 1.0:
                counts[foot] += fault[foot] == 0.0
                fault[foot], timers[foot, 0] = 1.0, 0.0
        else:
            timers[foot, 0] = 0.0
            load = estimated[foot, 2]
            read = low_passed[foot, 2]
            # A wrong contact is worse than a wrong load: the bound is tighter if either shows the foot in the air.
            if abs(read - load) > (limits.contact_error if min(read, load) < limits.swing_load else limits.load_error):
                timers[foot, 2] = 0.0
                if credible and fault[foot] == 0.0:
                    timers[foot, 1] += dt
                    sides = (expected[foot] == 0.0 and load < limits.swing_load) or (
                        expected[foot] > 0.0 and load > limits.stance_load
                    )
                    if timers[foot, 1] > (limits.scheduled_time if sides else limits.fault_time):
                        fault[foot], timers[foot, 1] = 2.0, 0.0
                        counts[foot] += 1.0
            else:
                timers[foot, 1] = 0.0
                alive = False  # a dead sensor repeats bit-identical readings
                for i in range(6):
                    alive = alive or readings[foot, i] != last[foot, i]
                if fault[foot] > 0.0 and alive:
                    timers[foot, 2] += dt
                    if timers[foot, 2] > limits.recover_time:
                        fault[foot], timers[foot, 2] = 0.0, 0.0
        for i in range(6):
            last[foot, i] = readings[foot, i]
            used[foot, i] = readings[foot, i] if fault[foot] == 0.0 else estimated[foot, i]
    changed = bool(before != fault[0] + 3.0 * fault[1])
    if changed or timers[0, 1] + timers[1, 1] + timers[0, 0] + timers[1, 0] > 0.0:
        doubt[0] = limits.settle_time
    return changed


class FootSensorMonitor:
    """Replaces readings of faulty foot sensors by wrenches from the leg torques.

    The load on the feet is measured by the sensors, the leg torques, and the motion of the CoM, which gives the sum. A
    sensor is faulty if it contradicts the torques by more than ``load_error`` for ``fault_time`` while the sum of the
    torques fits the motion (within ``sum_error``, or better than the sum of the sensors). The bound is
    ``contact_error`` if either shows the foot in the air; the time is ``scheduled_time`` if the gait schedule agrees
    with the torques. A sensor without a finite reading for ``fault_time`` is faulty, too. A sensor is sound again after
    it has agreed with the torques for ``recover_time`` with changing readings.
    """

    def __init__(self, config: FootSensorConfig, weight: float, fitted: bool) -> None:
        self._limits = SensorLimits(
            load_error=config.load_error * weight,
            contact_error=config.contact_error * weight,
            sum_error=config.sum_error * weight,
            swing_load=config.swing_load * weight,
            stance_load=config.stance_load * weight,
            fault_time=config.fault_time,
            scheduled_time=config.scheduled_time,
            recover_time=config.recover_time,
            settle_time=config.settle_time,
        )
        self.fitted = fitted
        self.used = np.zeros((2, 6))  #: Wrench of each sole, measured or estimated, in its frame (2, 6) [N, N.m]
        self.fault = np.zeros(2)  #: 0 sound, 1 absent, 2 contradicted, of each foot (2,)
        self.counts = np.zeros(2)  #: Number of faults of each sensor (2,)
        self._doubt = np.zeros(1)
        self._timers, self._last = np.zeros((2, 3)), np.zeros((2, 6))
        arrays = self.fault, self._timers, self._last, self.counts, self.used, self._doubt
        self.memory = SensorMemory(self._limits, *arrays)

    @property
    def states(self) -> tuple[FootSensorState, FootSensorState]:
        """States of the left and the right sensor."""
        return _STATES[int(self.fault[0])], _STATES[int(self.fault[1])]

    def reset(self, samples: Array, readings: Matrix, estimated: Matrix) -> None:
        """Reset; a sensor whose first sample is not finite is absent."""
        self._timers[:], self.counts[:], self._doubt[:] = 0.0, 0.0, 0.0
        self.fault[:] = samples == NOT_FINITE
        self._last[:] = readings
        self.used[:] = np.where(self.fault[:, None] > 0.0, estimated, readings)


class ContactLimits(NamedTuple):
    """``ContactConfig`` with loads in N, thresholds for faulty foot sensors, and logarithms of the noises."""

    load_off: float
    load_on: float
    load_full: float
    on_delay: float
    edge_margin: float
    swing_load: float
    stance_load: float
    unscheduled: float
    flat_trust: float
    swing: float
    slip: float
    swing_rotation: float
    tipping: float
    flat: float


class ContactMemory(NamedTuple):
    """Limits and state of ``ContactDetector``."""

    limits: ContactLimits
    rectangles: Array  # of the soles (2, 4) [m]
    active: Array  # (2,)
    timers: Array  # time above ``load_on`` (2,) [s]
    confidence: Array  # (2, 2)
    cops: Array  # (2, 2)
    pivots: Array  # (2, 2)
    densities: Array  # (2, 2)


@njit(cache=True)
def assess_contacts(
    wrenches: Array, samples: Array, fault: Array, expected: Array, dt: float, contacts: ContactMemory
) -> None:
    """One step of ``ContactDetector``."""
    limits, rectangles, active, timers, confidence, cops, pivots, densities = contacts
    full, delay, edge_margin = limits.load_full, limits.on_delay, limits.edge_margin
    for foot in range(2):
        load = wrenches[foot, 2]
        off, on = limits.load_off, limits.load_on
        if fault[foot] > 0.0:
            off, on = limits.swing_load, limits.stance_load * (limits.unscheduled if expected[foot] == 0.0 else 1.0)
        if active[foot] > 0.0:
            if load < off:
                active[foot], timers[foot] = 0.0, 0.0
        elif load > on:
            timers[foot] += dt
            if timers[foot] > delay:
                active[foot] = 1.0
        else:
            timers[foot] = 0.0
        if active[foot] > 0.0:
            x_min, x_max, y_min, y_max = rectangles[foot]
            load = max(load, off)
            x = min(max(-wrenches[foot, 4] / load, x_min), x_max)
            y = min(max(wrenches[foot, 3] / load, y_min), y_max)
            cops[foot, 0], cops[foot, 1] = x, y
            confidence[foot, 0] = min(max((load - off) / (full - off), 0.0), 1.0)
            margin_x = 2.0 * min(x - x_min, x_max - x) / (x_max - x_min)
            margin_y = 2.0 * min(y - y_min, y_max - y) / (y_max - y_min)
            flat = min(min(margin_x, margin_y) / edge_margin, 1.0)
            confidence[foot, 1] = flat
            pivots[foot, 0], pivots[foot, 1] = (1.0 - flat) * x, (1.0 - flat) * y
            if fault[foot] > 0.0 or samples[foot] == 2.0:
                confidence[foot, 1] *= limits.flat_trust
        else:
            confidence[foot, 0], confidence[foot, 1] = 0.0, 0.0
        stands, flat = confidence[foot, 0], confidence[foot, 1]
        bearing = limits.tipping + flat * (limits.flat - limits.tipping)
        densities[foot, 0] = math.exp(limits.swing + stands * (limits.slip - limits.swing))
        densities[foot, 1] = math.exp(limits.swing_rotation + stands * (bearing - limits.swing_rotation))


class ContactDetector:
    """Detects which feet bear load, and sets their process noise.

    A foot makes contact after its normal force has been above ``load_on`` for ``on_delay``, and breaks contact when the
    force falls below ``load_off``. For a wrench from the leg torques (``FootSensorMonitor``), the bounds are
    ``stance_load``, raised for a scheduled swing foot, and ``swing_load``. The centre of pressure from leg torques or a
    saturated sensor has less weight.

    The confidence c in [0, 1] that a stance foot does not move rises with the load from ``load_off`` to ``load_full``.
    The confidence m that it stays flat rises with the distance of its centre of pressure from the nearest edge. Noises
    are interpolated geometrically::

        s_position    = swing^(1 - c) slip^c
        s_orientation = swing_rotation^(1 - c) (tipping^(1 - m) flat^m)^c

    A flat sole turns about its middle, a tipping sole about its centre of pressure; the pivot is (1 - m) times the
    latter.
    """

    def __init__(
        self, model: RobotModel, config: ContactConfig, sensors: FootSensorConfig, noise: FootNoise, gravity: float
    ) -> None:
        weight = model.mass * gravity
        self._limits = ContactLimits(
            load_off=config.load_off * weight,
            load_on=config.load_on * weight,
            load_full=config.load_full * weight,
            on_delay=config.on_delay,
            edge_margin=config.edge_margin,
            swing_load=sensors.swing_load * weight,
            stance_load=sensors.stance_load * weight,
            unscheduled=sensors.unscheduled,
            flat_trust=sensors.flat_trust,
            swing=math.log(noise.swing),
            slip=math.log(noise.slip),
            swing_rotation=math.log(noise.swing_rotation),
            tipping=math.log(noise.tipping),
            flat=math.log(noise.flat),
        )
        rectangles = np.array([foot.rectangle for foot in model.feet], dtype=np.float64)
        self.active = np.zeros(2)  #: 1 for a foot in contact, else 0 (2,)
        self._timers = np.zeros(2)
        self.confidence = np.zeros((2, 2))  #: c and m of each foot (2, 2) [-]
        self.cops = np.zeros((2, 2))  #: Centre of pressure in the sole frame, kept from the last contact (2, 2) [m]
        self.pivots = np.zeros((2, 2))  #: Point about which the sole turns, in the sole frame (2, 2) [m]
        self.densities = np.zeros((2, 2))  #: Random walk of position and orientation (2, 2) [m/sqrt(s), rad/sqrt(s)]
        arrays = rectangles, self.active, self._timers, self.confidence, self.cops, self.pivots, self.densities
        self.memory = ContactMemory(self._limits, *arrays)
        self.reset(np.zeros((2, 6)), np.zeros(2))

    def reset(self, wrenches: Matrix, fault: Vector) -> None:
        """Start from one sample (2, 6) [N, N.m], without the delay: a loaded foot is in contact at once."""
        self._timers[:] = 0.0
        self.active[:] = wrenches[:, 2] > np.where(fault > 0.0, self._limits.stance_load, self._limits.load_on)
        self.cops[:], self.pivots[:] = 0.0, 0.0
        self.update(wrenches, np.zeros(2), fault, np.full(2, UNKNOWN), 0.0)

    def update(self, wrenches: Matrix, samples: Vector, fault: Vector, expected: Vector, dt: float) -> None:
        """Advance by ``dt`` [s] with the ground reaction on each foot, in its sole frame (2, 6) [N, N.m].

        ``samples`` is the state of each foot sample, as in ``SensorBuffer`` (2,); ``fault`` is nonzero for a wrench
        from the leg torques (2,); ``expected`` is as in ``judge_sensors``.
        """
        assess_contacts(wrenches, samples, fault, expected, dt, self.memory)


class SlipMemory(NamedTuple):
    """Limits and state of ``SlipMonitor``."""

    gate: float
    time: float
    recover_time: float
    density: float
    timers: Array  # above and below the gate (2, 2) [s]
    slipping: Array  # (2,)
    counts: Array  # (2,)


@njit(cache=True)
def watch_slips(innovation: Array, stands: Array, dt: float, densities: Array, limits: SlipMemory) -> bool:
    """One step of ``SlipMonitor``; returns whether a slip began.

    ``innovation`` and confidence ``stands`` are per foot (2,); raises the ``densities`` of slipping feet (2, 2).
    """
    changed, timers, slipping, counts = False, limits.timers, limits.slipping, limits.counts
    for foot in range(2):
        if stands[foot] <= 0.0:  # in the air
            timers[foot, 0], timers[foot, 1], slipping[foot] = 0.0, 0.0, 0.0
            continue
        if innovation[foot] > limits.gate:
            timers[foot, 0] += dt
            timers[foot, 1] = 0.0
        else:
            timers[foot, 0] = 0.0
            timers[foot, 1] += dt
        if slipping[foot] > 0.0:
            if timers[foot, 1] > limits.recover_time:
                slipping[foot] = 0.0
        elif timers[foot, 0] > limits.time:
            slipping[foot] = 1.0
            counts[foot] += 1.0
            changed = True
        if slipping[foot] > 0.0:
            densities[foot, 0] = max(densities[foot, 0], limits.density)
    return changed


class SlipMonitor:
    """Detects slips of stance feet from the innovation of their kinematic measurement.

    A foot slips once its normalised innovation squared has been above the ``gate`` [-] for ``time``. Its position then
    has the random walk ``density`` until the innovation has stayed below the gate for ``recover_time``. ``slipping`` is
    1 for a slipping foot, else 0 (2,); ``counts`` is the number of slips of each foot (2,).
    """

    def __init__(self, config: SlipConfig, gate: float) -> None:
        timers, self.slipping, self.counts = np.zeros((2, 2)), np.zeros(2), np.zeros(2)
        limits = gate, config.time, config.recover_time, config.density
        self.memory = SlipMemory(*limits, timers, self.slipping, self.counts)

    def reset(self) -> None:
        """Clear all slips."""
        self.memory.timers[:], self.slipping[:], self.counts[:] = 0.0, 0.0, 0.0
