"""Reference of the whole-body controller, computed from the state of a gait."""

import math

import numpy as np
import pinocchio as pin

from models.constants import GRAVITY
from models.numerics.compiled import njit, register_jitable
from models.robot_model import RobotModel
from models.spline import min_jerk, quintic_step
from models.types import Matrix, Reference, RobotState, Vector
from planners.gait.config import GaitConfig
from planners.gait.contact import AirborneState
from planners.gait.footsteps import Point, mean_heading, middle, replaced, wrap
from planners.gait.measurement import Measurement
from planners.gait.state import BodyState, GaitPhase, GaitState
from planners.gait.tread import leg_height

Place = tuple[float, float, float, float]  #: x, y, z [m] and heading [rad] in W

SETTLING = 0.02  #: Time constant with which the height of the CoM comes to rest [s]


class ReferenceBuilder:
    r"""Reference of one tick: base and torso upright at the mean heading of the feet, CoM at a height over the ground.

    The ground is the plane of the expected slope through the stance sole. The height h of the CoM changes slowly.

    Once in every step, the CoM also rises over the stance foot by a ``share`` of its rise on a leg of fixed length
    :math:`l`, for feet :math:`d` apart along the heading:

    .. math:: z = h - a \cos\frac{2 \pi (t - t_{low})}{T}, \quad
        a = \min\left(\mathrm{share}\,\frac{d^2}{16 l}, \frac{T^2}{4 \pi^2} \ddot z_{max}\right)

    The knee then bends and stretches less under load. At every tick, the rise follows a quintic to the next crest or
    trough, so that it stays smooth when the time or length of a step changes.

    ``under`` is the position of each sole relative to the CoM in the 'stand' posture (2, 2) [m].
    """

    def __init__(self, model: RobotModel, config: GaitConfig) -> None:
        self._config = config
        self._posture = np.array(model.posture("stand"))  # kernels are compiled for writable arrays
        self._zero, self._still = np.zeros(model.nj), np.zeros((2, 6))
        data = model.data()
        pin.centerOfMass(model.pin, data, model.standing_configuration())
        torso = pin.updateFramePlacement(model.pin, data, model.frame_id("torso"))
        self.standing_height = float(data.com[0][2])
        soles = [pin.updateFramePlacement(model.pin, data, foot.frame_id).translation[:2] for foot in model.feet]
        self.under = np.array([sole - data.com[0][:2] for sole in soles])
        self._upright = np.array([data.oMi[1].rotation, torso.rotation])  # of base and torso (2, 3, 3)

    def advance_body(self, state: GaitState, relief: float, omega: float, dt: float) -> BodyState:
        """Height of the body and of the ground under it after one tick.

        ``relief`` is the present vertical DCM on known ground [m], ``omega`` the frequency of the pendulum [1/s].
        """
        config, (left, right) = self._config, state.soles.holds
        levels, swinging = state.soles.levels, -1
        if state.phase is GaitPhase.SINGLE:
            swinging = 1 - state.stance
            levels = replaced(levels, swinging, state.soles.landing_level(swinging))
        if state.phase is GaitPhase.STAND and state.rest is not None:
            height = state.rest.height
        else:
            crouch = max(state.pace.crouch, state.command.route.crouch if state.command.route.steps else 0.0)
            height = self.standing_height - (0.0 if state.phase.resting else crouch)
            com, leg, yaw = state.measured.com, config.leg, mean_heading(left.yaw, right.yaw)
            lean, places = config.lean_urgent if state.step.urgent else 0.5, ((left.x, left.y), (right.x, right.y))
            over = levels[0] - state.body.relief[0], levels[1] - state.body.relief[0]
            reach = height_in_reach(places, over, self.under, swinging, com, lean, yaw, leg, self.standing_height)
            height = min(height, reach)
        step = config.height_rate * dt
        drop, most = config.drop_rate, config.height_acceleration
        if state.step.urgent:
            drop, most = config.drop_rate_urgent, config.height_acceleration_urgent
        before, rates = state.body, (-drop, config.height_rate)
        height, rate = approach(before.height, before.rate, height, rates, most, dt)
        under = middle((left, right)) if swinging < 0 else state.soles.holds[state.stance]
        level = 0.5 * (levels[0] + levels[1]) if swinging < 0 else levels[state.stance]
        com, (rise_x, rise_y) = state.measured.com, state.soles.slope.tolist()
        ground = under.z - level + rise_x * float(com[0] - under.x) + rise_y * float(com[1] - under.y)
        climb = float(state.soles.slope @ state.measured.com_velocity[:2])
        last = ground if before.ground is None else before.ground + climb * dt
        ground = last + min(max(ground - last, -step), step)
        rise, acceleration = self._advance_rise(state, dt), (rate - before.rate) / dt
        known = _advance_relief(before.relief, relief, omega, config.height_acceleration, dt)
        return BodyState(height, ground, rate, acceleration, climb, rise, known)

    def _advance_rise(self, state: GaitState, dt: float) -> tuple[float, float, float]:
        """Rise over the stance leg, its rate and acceleration [m, m/s, m/s^2] after one tick."""
        config, timing, phase, step = self._config.rise, self._config.timing, state.phase, state.step
        double, single, (left, right) = step.double, step.time, state.soles.holds
        end, ahead, soonest = (0.0, 0.0, 0.0), timing.finish - state.elapsed, self._config.swing.freeze
        if phase is GaitPhase.SINGLE or phase is GaitPhase.DOUBLE:
            yaw, period = mean_heading(left.yaw, right.yaw), double + single
            along = (left.x - right.x) * math.cos(yaw) + (left.y - right.y) * math.sin(yaw)
            most = config.acceleration * (0.5 * period / math.pi) ** 2
            size = min(config.share * along * along / (16.0 * self._config.leg), most)
            since = state.elapsed + (double if phase is GaitPhase.SINGLE else 0.0)  # the touchdown
            crest = double + config.crest * single - since
            trough = crest - 0.5 * period
            ahead, sign = (crest, 1.0) if trough < soonest <= crest else (trough, -1.0)
            ahead += period if crest < soonest else 0.0
            end = (sign * size, 0.0, -sign * size * (2.0 * math.pi / period) ** 2)
        return advance_rise(state.body.rise, end, max(ahead + dt, soonest), dt)

    def build(self, state: GaitState, load: tuple[float, float], cmp_offset: Vector | None) -> Reference:
        """Reference of one tick; ``load`` is the load share of each foot, ``cmp_offset`` CMP minus CoP (2,) [m]."""
        left, right = state.soles.holds
        levels, relief = state.soles.levels, state.body.relief
        bears = 0.5 * (levels[0] + levels[1])  # zero of the controller's heights
        pressed = bears if sum(load) == 0.0 else (load[0] * levels[0] + load[1] * levels[1]) / sum(load)
        if state.phase is GaitPhase.SINGLE:
            bears = pressed = levels[state.stance]
        single, foot, body = state.phase is GaitPhase.SINGLE, 1 - state.stance, state.body
        rotations, bodies = np.empty((2, 2, 3, 3))
        positions, motions = np.empty((2, 3)), np.zeros((2, 2, 6))
        places = (left.x, left.y, left.z, left.yaw), (right.x, right.y, right.z, right.yaw)
        swing, out = state.swing, (rotations, positions, motions, bodies)
        swings = foot if single else -1
        _place_bodies(places, state.soles.tilts, swings, swing.motion, swing.tilt, self._upright, *out)
        dcm = state.dcm.dcm
        return Reference(
            com=np.array([dcm[0], dcm[1], (body.ground or 0.0) + body.height + body.rise[0] + relief[0]]),
            com_velocity=np.array([0.0, 0.0, body.rate + body.climb + body.rise[1] + relief[1]]),
            com_acceleration=np.array([0.0, 0.0, body.acceleration + body.rise[2] + relief[2]]),
            base_orientation=bodies[0],
            torso_orientation=bodies[1],
            posture=self._posture,
            posture_velocity=self._zero,
            posture_acceleration=self._zero,
            sole_rotations=rotations,
            sole_positions=positions,
            sole_velocities=motions[0],
            sole_accelerations=motions[1],
            contacts=(foot != 0, foot != 1) if single else (True, True),
            load=load,
            load_alone=1.0 - self._config.height_acceleration_urgent / GRAVITY if state.step.urgent else 0.0,
            dcm=dcm,
            dcm_velocity=state.dcm.rate,
            heading_rate=0.5 * float(state.swing.velocity[3]) if single else 0.0,
            cmp_offset=cmp_offset,
            sole_areas=state.footing.areas,
            momentum=float(state.step.urgent),
            stiffness=state.pace.share,
            urgent=state.step.urgent,
            levels=(relief[0] - bears, pressed - bears),
        )

    def build_airborne(self, airborne: AirborneState, state: RobotState, measured: Measurement) -> Reference:
        """Reference of a robot in the air without contacts: holds the posture, or moves to the standing posture."""
        posture, rate = airborne.posture, self._zero
        if airborne.confirmed:
            duration, way = self._config.lift.level_time, self._posture - posture
            share, growth, _ = min_jerk(min(airborne.since / duration, 1.0))
            posture, rate = posture + share * way, growth / duration * way
        upright = pin.Quaternion(state.q[3:7]).toRotationMatrix()
        rotations = np.empty((2, 3, 3))
        for sole, rotation in zip(measured.soles, rotations, strict=True):
            sole_rotation(sole.yaw, 0.0, 0.0, rotation)
        return Reference(
            com=measured.com,
            com_velocity=self._zero[:3],
            com_acceleration=self._zero[:3],
            base_orientation=upright,
            torso_orientation=upright,
            posture=posture,
            posture_velocity=rate,
            posture_acceleration=self._zero,
            sole_rotations=rotations,
            sole_positions=np.array([(sole.x, sole.y, sole.z) for sole in measured.soles]),
            sole_velocities=self._still,
            sole_accelerations=self._still,
            contacts=(False, False),
            dcm=measured.com[:2],
            dcm_velocity=self._zero[:2],
        )


@register_jitable
def sole_rotation(yaw: float, rise_x: float, rise_y: float, rotation: Matrix) -> None:
    """Fill the ``rotation`` (3, 3) of a sole at heading ``yaw`` on a slope with these rises along x and y of W."""
    size = math.sqrt(rise_x * rise_x + rise_y * rise_y + 1.0)
    nx, ny, nz = -rise_x / size, -rise_y / size, 1.0 / size
    c, s = math.cos(yaw), math.sin(yaw)
    part = c * nx + s * ny
    ax, ay, az = c - part * nx, s - part * ny, -part * nz
    length = math.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / length, ay / length, az / length
    rotation[0, 0], rotation[1, 0], rotation[2, 0] = ax, ay, az
    rotation[0, 1], rotation[1, 1], rotation[2, 1] = ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax
    rotation[0, 2], rotation[1, 2], rotation[2, 2] = nx, ny, nz


@njit(cache=True)
def _place_bodies(
    places: tuple[Place, Place], tilts: Matrix, foot: int, motion: Matrix, tilt: Vector,
    upright: Matrix, rotations: Matrix, positions: Matrix, motions: Matrix, bodies: Matrix,
) -> None:  # fmt: skip
    """Fill the poses and motions of the soles, and the rotations of base and torso at the mean heading.

    Outputs are ``rotations`` (2, 3, 3), ``positions`` (2, 3) [m], velocities and accelerations ``motions`` (2, 2, 6)
    and ``bodies`` (2, 3, 3). ``places`` are planted soles with slopes ``tilts`` (2, 2). ``foot`` swings (-1: none) with
    position, velocity, acceleration of x, y, z, yaw ``motion`` (3, 4) and slope ``tilt`` (2,). ``upright`` are the
    rotations of base and torso at heading 0 (2, 3, 3).
    """
    first, second = places[0][3], places[1][3]
    for i in range(2):
        x, y, z, yaw = places[i]
        rise_x, rise_y = tilts[i, 0], tilts[i, 1]
        if i == foot:
            x, y, z, yaw = motion[0, 0], motion[0, 1], motion[0, 2], motion[0, 3]
            rise_x, rise_y = tilt[0], tilt[1]
            for k in range(2):
                for axis in range(3):
                    motions[k, i, axis] = motion[1 + k, axis]
                motions[k, i, 5] = motion[1 + k, 3]
            if i == 0:
                first = yaw
            else:
                second = yaw
        positions[i, 0], positions[i, 1], positions[i, 2] = x, y, z
        sole_rotation(yaw, rise_x, rise_y, rotations[i])
    turn = first + 0.5 * wrap(second - first)
    c, s = math.cos(turn), math.sin(turn)
    for body in range(2):
        for k in range(3):
            x, y = upright[body, 0, k], upright[body, 1, k]
            bodies[body, 0, k], bodies[body, 1, k], bodies[body, 2, k] = (
                c * x - s * y,
                s * x + c * y,
                upright[body, 2, k],
            )


@njit(cache=True)
def advance_rise(
    rise: tuple[float, float, float], end: tuple[float, float, float], left: float, dt: float
) -> tuple[float, float, float]:
    """Height, rate and acceleration after ``dt`` [s] on a quintic that reaches ``end`` after ``left`` [s]."""
    return quintic_step(rise[0], rise[1], rise[2], end, left, dt)


@njit(cache=True)
def approach(
    height: float, rate: float, target: float, rates: tuple[float, float], acceleration: float, dt: float
) -> tuple[float, float]:
    """Height [m] and rate [m/s] after ``dt`` [s] of motion to a target, within ``rates`` [m/s] and an acceleration.

    The motion brakes to rest at the target, finally with the time constant ``SETTLING``.
    """
    missing = target - height - rate * dt  # after this tick
    way = abs(missing)
    wish = math.copysign(min(math.sqrt(2.0 * acceleration * way), way / SETTLING), missing)
    wish = min(max(wish, rates[0]), rates[1])
    rate = min(max(wish, rate - acceleration * dt), rate + acceleration * dt)
    return height + rate * dt, rate


@njit(cache=True)
def height_in_reach(
    places: tuple[Point, Point],
    over: Point,
    under: Matrix,
    swinging: int,
    com: Vector,
    lean: float,
    yaw: float,
    leg: float,
    standing: float,
) -> float:
    """CoM height at which no leg is longer than ``leg``, its length in standing [m].

    It uses the measured horizontal distance of planted feet from their hips, and the share ``lean`` of the distance of
    both feet at touchdown. ``places`` are the footholds in W [m], ``over`` their known heights above the ground from
    which the CoM height counts [m]. ``under`` are the soles relative to the CoM of the robot standing at heading 0
    (2, 2) [m], ``standing`` is its CoM height [m]. ``swinging`` is the swing foot, -1 without one.
    """
    c, s = math.cos(yaw), math.sin(yaw)
    left_x, left_y = (
        places[0][0] - (c * under[0, 0] - s * under[0, 1]),
        places[0][1] - (s * under[0, 0] + c * under[0, 1]),
    )
    right_x, right_y = (
        places[1][0] - (c * under[1, 0] - s * under[1, 1]),
        places[1][1] - (s * under[1, 0] + c * under[1, 1]),
    )
    x, y = left_x - right_x, left_y - right_y
    height = leg_height(lean * lean * (x * x + y * y), leg) - 0.5 * abs(over[0] - over[1])
    if swinging != 0:
        x, y = left_x - com[0], left_y - com[1]
        height = min(height, leg_height(x * x + y * y, leg) + over[0])
    if swinging != 1:
        x, y = right_x - com[0], right_y - com[1]
        height = min(height, leg_height(x * x + y * y, leg) + over[1])
    return standing - leg + height


@njit(cache=True)
def _advance_relief(
    relief: tuple[float, float, float], dcm: float, omega: float, acceleration: float, dt: float
) -> tuple[float, float, float]:
    """Height that converges to a vertical DCM, its rate and acceleration after ``dt`` [s] [m, m/s, m/s^2]."""
    height, before, _ = relief
    rate = min(max(omega * (dcm - height), before - acceleration * dt), before + acceleration * dt)
    return height + rate * dt, rate, (rate - before) / dt
