"""Friction coefficient of the ground, from sliding and holding soles."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.estimation.config import FrictionConfig
from models.numerics.compiled import njit
from models.robot_model import RobotModel

Array = NDArray[np.float64]


class FrictionLimits(NamedTuple):
    """``FrictionConfig`` for compiled code, and the initial coefficient."""

    load: float  # [N]
    flat: float
    speed: float
    opposed: float
    turn_time: float
    filter_time: float
    slide_time: float
    held: float
    raise_time: float
    least: float
    largest: float
    start: float


class FrictionMemory(NamedTuple):
    """Limits and state of ``FrictionEstimator``."""

    limits: FrictionLimits
    rectangles: Array  # of the soles (2, 4) [m]
    demands: Array  # low-passed (2,) [-]
    places: Array  # positions of the soles in the last tick; NaN before the first tick (2, 2) [m]
    velocities: Array  # of the soles, low-passed (2, 2) [m/s]
    normals: Array  # x and y of the sole normals in the last tick; NaN before the first tick (2, 2) [-]
    rates: Array  # of the normals, low-passed (2, 2) [rad/s]
    turning: Array  # peak turning rate of each sole, decaying with ``turn_time`` (2,) [rad/s]
    coefficient: Array  # (1,)


@njit(cache=True)
def friction_demand(wrench: Array, rectangle: Array) -> float:
    """Least coefficient at which a sole holds a wrench (6,) with a positive normal force [N, N.m]."""
    x_min, x_max, y_min, y_max = rectangle
    normal = wrench[2]
    x = min(max(-wrench[4] / normal, x_min), x_max)
    y = min(max(wrench[3] / normal, y_min), y_max)
    ahead, left = (x - x_min) / (x_max - x_min), (y - y_min) / (y_max - y_min)
    near = (1.0 - left) * math.hypot(x - x_min, y - y_min) + left * math.hypot(x - x_min, y - y_max)
    far = (1.0 - left) * math.hypot(x - x_max, y - y_min) + left * math.hypot(x - x_max, y - y_max)
    lever = max((1.0 - ahead) * near + ahead * far, 0.25 * (y_max - y_min))
    moment = wrench[5] - x * wrench[1] + y * wrench[0]
    return float(math.sqrt(wrench[0] ** 2 + wrench[1] ** 2 + (moment / lever) ** 2) / normal)


@njit(cache=True)
def watch_friction(
    wrenches: Array,
    confidence: Array,
    slipping: Array,
    soles: Array,
    rotations: Array,
    dt: float,
    memory: FrictionMemory,
) -> None:
    """One step of ``FrictionEstimator``.

    ``wrenches`` are the ground reactions in the sole frames (2, 6) [N, N.m], ``confidence`` that each sole lies flat
    (2,) [-], ``slipping`` is 1 for a slipping foot (2,), ``soles`` are the estimated sole positions in W (2, 3) [m],
    ``rotations`` the rotations from the sole frames to W (2, 3, 3).
    """
    limits, rectangles, demands, places, velocities, normals, rates, turning, coefficient = memory
    share = min(dt / limits.filter_time, 1.0)
    for foot in range(2):
        square = rate = 0.0
        for i in range(2):
            place, normal = soles[foot, i], rotations[foot, i, 2]
            way = place - places[foot, i] if math.isfinite(places[foot, i]) else 0.0
            turn = normal - normals[foot, i] if math.isfinite(normals[foot, i]) else 0.0
            places[foot, i], normals[foot, i] = place, normal
            velocities[foot, i] += share * (way / dt - velocities[foot, i])
            rates[foot, i] += share * (turn / dt - rates[foot, i])
            square += velocities[foot, i] ** 2
            rate += rates[foot, i] ** 2
        turning[foot] = max(math.sqrt(rate), turning[foot] * (1.0 - min(dt / limits.turn_time, 1.0)))
        if wrenches[foot, 2] < limits.load or confidence[foot] < limits.flat:
            demands[foot] = -1.0
            continue
        demand = friction_demand(wrenches[foot], rectangles[foot])
        demands[foot] += (share if demands[foot] >= 0.0 else 1.0) * (demand - demands[foot])
        least = max(limits.speed, 0.5 * (rectangles[foot, 1] - rectangles[foot, 0]) * turning[foot])
        demand, slides = demands[foot], slipping[foot] > 0.0 and square > least**2
        if slides:
            pull, power = 0.0, 0.0
            for i in range(2):
                force = np.dot(rotations[foot, i], wrenches[foot, :3])
                pull += force**2
                power += force * velocities[foot, i]
            slides = power < -limits.opposed * math.sqrt(pull * square)
        if slides:
            coefficient[0] += min(dt / limits.slide_time, 1.0) * (demand - coefficient[0])
        elif slipping[foot] == 0.0 and demand > limits.held * coefficient[0]:
            coefficient[0] += min(dt / limits.raise_time, 1.0) * (demand / limits.held - coefficient[0])
    coefficient[0] = min(max(coefficient[0], limits.least), limits.largest)


class FrictionEstimator:
    r"""Coulomb coefficient of the ground under the soles.

    .. math::
        d = \frac{1}{f_z} \sqrt{f_x^2 + f_y^2 + (m_z / l)^2}, \quad
        \dot\mu = (d - \mu) / T_{slide} \;\text{(slides)}, \quad
        \dot\mu = \max(d / s - \mu, 0) / T_{raise} \;\text{(holds)}

    The demand d is the least coefficient at which the sole holds its wrench: ``m_z`` is the moment about the centre of
    pressure, ``l`` the mean distance of the corners from there, weighted by their load. A sole slides when
    ``SlipMonitor`` detects a slip, its speed exceeds ``speed``, and the ground force opposes its velocity. The last
    condition excludes late joint states: with a delay T, a holding sole seems to move along the force, by T times the
    acceleration of the base. A sole that turns about a horizontal axis, for example over the edge of a tile, moves by
    up to half its length times the rate; the filter assumes a flat sole and follows with a delay. A sliding sole must
    therefore also be faster than this; the rate decays with ``turn_time``. For a sliding sole, d is the coefficient. A
    holding sole shows that the coefficient is at least d: the estimate rises slowly to ``d / s`` until the sole slides
    again. Only loaded soles with a centre of pressure away from the edges count, because tipping and landing soles
    move, too.

    ``coefficient`` (1,) starts at the expected value of the configuration, or of the robot's profile.

    Reference:
        Howe, Cutkosky: Practical force-motion models for sliding manipulation, IJRR 1996 (ellipsoidal limit surface).
    """

    def __init__(self, model: RobotModel, config: FrictionConfig, gravity: float) -> None:
        nominal = min(foot.friction for foot in model.feet)
        start = config.expected or nominal
        limits = FrictionLimits(
            load=config.load * model.mass * gravity,
            flat=config.flat,
            speed=config.speed,
            opposed=config.opposed,
            turn_time=config.turn_time,
            filter_time=config.filter_time,
            slide_time=config.slide_time,
            held=config.held,
            raise_time=config.raise_time,
            least=config.least,
            largest=max(nominal, start),
            start=start,
        )
        rectangles = np.array([foot.rectangle for foot in model.feet], dtype=np.float64)
        self.coefficient = np.array([start])
        places, velocities, normals, rates = np.zeros((4, 2, 2))
        motion = places, velocities, normals, rates, np.zeros(2)
        self.memory = FrictionMemory(limits, rectangles, np.zeros(2), *motion, self.coefficient)
        self.reset()

    def reset(self) -> None:
        """Reset to the initial coefficient."""
        memory = self.memory
        memory.demands[:], memory.places[:], memory.normals[:] = -1.0, np.nan, np.nan
        memory.velocities[:], memory.rates[:], memory.turning[:] = 0.0, 0.0, 0.0
        self.coefficient[0] = memory.limits.start
