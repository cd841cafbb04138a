"""Contact detection with hysteresis, and how far each foot may be trusted to stand still."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from controllers.estimation.config import ContactConfig, FootNoise, FootSensorConfig
from controllers.estimation.foot_sensors import UNKNOWN
from models.compiled import njit
from models.robot_model import RobotModel
from models.types import Matrix, Vector

Array = NDArray[np.float64]


@njit(cache=True)
def _assess(
    wrenches: Array, samples: Array, fault: Array, expected: Array, limits: Array, rectangles: Array,
    edge_margin: float, dt: float,
    logs: Array, active: Array, timers: Array, confidence: Array, cops: Array, pivots: Array, densities: Array,
) -> None:  # fmt: skip
    """One step of ``ContactDetector``; ``logs``: of the noises.

    ``limits``: off, on and full load [N], delay [s], off and on load by torques [N], factor on the latter where the
    schedule has the foot in the air, factor on the confidence in a poor centre of pressure.
    """
    full, delay = limits[2], limits[3]
    for foot in range(2):
        load = wrenches[foot, 2]
        off, on = limits[0], limits[1]
        if fault[foot] > 0.0:
            off, on = limits[4], limits[5] * (limits[6] if expected[foot] == 0.0 else 1.0)
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
                confidence[foot, 1] *= limits[7]
        else:
            confidence[foot, 0], confidence[foot, 1] = 0.0, 0.0
        stands, flat = confidence[foot, 0], confidence[foot, 1]
        densities[foot, 0] = math.exp(logs[0] + stands * (logs[1] - logs[0]))
        densities[foot, 1] = math.exp(logs[2] + stands * (logs[3] + flat * (logs[4] - logs[3]) - logs[2]))


class ContactDetector:
    """Which feet bear load, and the process noise that follows.

    A foot makes contact after its normal force stays above ``load_on`` for ``on_delay`` and breaks it as soon as the
    force falls below ``load_off``. Where the wrench comes from the leg torques (``foot_sensors.py``), the bounds are
    ``stance_load`` and ``swing_load``, the first one raised where the gait schedule has the foot in the air, and the
    centre of pressure counts for less, as it does with a saturated sensor.

    The confidence that a bearing foot stands still, c in [0, 1], rises with the load from ``load_off`` to
    ``load_full``; the confidence that it stays flat, with the distance m of its centre of pressure from the nearest
    edge. Noises are interpolated geometrically::

        s_position    = swing^(1 - c) slip^c
        s_orientation = swing_rotation^(1 - c) (tipping^(1 - m) flat^m)^c

    Attributes:
        active: 1 where the foot bears, else 0 (2,).
        confidence: c and m of each foot (2, 2) [-].
        cops: Centre of pressure in the sole frame, kept from the last contact (2, 2) [m].
        pivots: Point about which the sole turns, in the sole frame (2, 2) [m]: a sole that bears on its whole area
            gives way about its middle, one that tips about its centre of pressure, so (1 - m) times that.
        densities: Random walk of position and orientation of each foot (2, 2) [m/sqrt(s), rad/sqrt(s)].

    Args:
        model: The robot: its weight and soles.
        config: Thresholds.
        sensors: Thresholds where the foot sensor is out.
        noise: Random walks to interpolate.
        gravity: [m/s^2].
    """

    def __init__(
        self, model: RobotModel, config: ContactConfig, sensors: FootSensorConfig, noise: FootNoise, gravity: float
    ) -> None:
        weight = model.mass * gravity
        self._limits = np.array(
            [
                config.load_off * weight,
                config.load_on * weight,
                config.load_full * weight,
                config.on_delay,
                sensors.swing_load * weight,
                sensors.stance_load * weight,
                sensors.unscheduled,
                sensors.flat_trust,
            ]
        )
        self._rectangles = np.array([foot.rectangle for foot in model.feet], dtype=np.float64)
        self._edge_margin = config.edge_margin
        self._logs = np.log([noise.swing, noise.slip, noise.swing_rotation, noise.tipping, noise.flat])
        self.active = np.zeros(2)
        self._timers = np.zeros(2)
        self.confidence = np.zeros((2, 2))
        self.cops = np.zeros((2, 2))
        self.pivots = np.zeros((2, 2))
        self.densities = np.zeros((2, 2))
        self.reset(np.zeros((2, 6)), np.zeros(2))

    def reset(self, wrenches: Matrix, fault: Vector) -> None:
        """Start from one sample (2, 6) [N, N.m], without the delay: a loaded foot bears at once."""
        self._timers[:] = 0.0
        self.active[:] = wrenches[:, 2] > np.where(fault > 0.0, self._limits[5], self._limits[1])
        self.cops[:], self.pivots[:] = 0.0, 0.0
        self.update(wrenches, np.zeros(2), fault, np.full(2, UNKNOWN), 0.0)

    def update(self, wrenches: Matrix, samples: Vector, fault: Vector, expected: Vector, dt: float) -> None:
        """Advance by one step.

        Args:
            wrenches: Ground reaction on each foot, in its sole frame (2, 6) [N, N.m].
            samples: State of each foot's sample, as ``SensorBuffer`` has it (2,).
            fault: Not 0 where the wrench comes from the leg torques (2,).
            expected: What the gait schedule says of each foot: 1 stands, 0 swings, ``UNKNOWN`` (2,).
            dt: Step [s].
        """
        _assess(
            wrenches, samples, fault, expected, self._limits, self._rectangles, self._edge_margin, dt, self._logs,
            self.active, self._timers, self.confidence, self.cops, self.pivots, self.densities,
        )  # fmt: skip
