"""The state estimator: sensors in, ``RobotState`` out."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from msgspec import structs

from controllers.estimation.config import EstimatorConfig
from controllers.estimation.feet import (
    NOT_FINITE,
    UNKNOWN,
    ContactDetector,
    ContactMemory,
    FootSensorMonitor,
    SensorMemory,
    SlipMemory,
    SlipMonitor,
    assess_contacts,
    judge_sensors,
    watch_slips,
)
from controllers.estimation.filter import Filter, InvariantFilter, propagate
from controllers.estimation.filter_kernels import correct_soles
from controllers.estimation.friction import FrictionEstimator, FrictionMemory, watch_friction
from controllers.estimation.kinematics import SoleChains, SoleKinematics, base_covariance, base_state, sole_poses
from controllers.estimation.observer import ForceObserver, Observer, observe
from controllers.estimation.samples import (
    BAD_FEET,
    BAD_IMU,
    BAD_JOINTS,
    BAD_TORQUES,
    SATURATED_FEET,
    SATURATED_IMU,
    STALE,
    EstimatorHealth,
    SampleMemory,
    SensorBuffer,
)
from models.config import default_config
from models.errors import MessageError
from models.numerics.compiled import njit
from models.numerics.unboxed import Unboxed, unbox
from models.robot_model import RobotModel
from models.types import CentroidalState, ContactState, Matrix, PushEstimate, RobotState, SensorData, Vector

UNKNOWN_FEET = UNKNOWN, UNKNOWN
NOMINAL_STEP = 0.001  #: Step of the compiling call, and of the gyro sample before the first step [s]


class _Stages(NamedTuple):
    """Memory of all stages, for compiled code."""

    buffer: SampleMemory
    feet: SensorMemory
    contacts: ContactMemory
    slips: SlipMemory
    friction: FrictionMemory
    filter: Filter
    chains: SoleChains
    observer: Observer
    expected: Vector  # planned contact of each foot, see ``judge_sensors`` (2,)
    rate: Vector  # mean rate over the step (3,) [rad/s]


class StateEstimator:
    """Contact-aided invariant Kalman filter over encoders, IMU and foot sensors.

    One step detects contacts from the wrenches, predicts, corrects with both sole poses, and computes the base from the
    IMU through the joints between them. The prediction uses the mean of the last two rates, and the newest specific
    force as the mean over the step (accelerometers integrate over their sampling time)::

        R_WB = R_WI R_BI',   p_B = p_I - R_WB r_BI,   w_B = R_BI w_I - J_w dq,   v_B = R_WB' v_I - w_B x r_BI - J_v dq

    Joint velocities enter only w_B and v_B, and only if joints lie between base and IMU; otherwise their noise does not
    affect the base. Accelerations affect the velocity within the step in which they are measured.

    Parts of a sample that are not finite, or not newer than the last one, are replaced: IMU values by the last good
    ones with more noise, joints and wrenches by the last good ones without a correction. ``health`` counts these
    samples; ``health.coasting`` is their duration.

    ``config`` defaults to the packaged ``estimator.yaml``; ``given`` stores it, and the attribute ``config`` adds the
    noise of the robot's IMU. Raises ``RobotModelError`` if a joint to a sole or the IMU is not revolute.

    Assumptions:
        The soles are flat, the ground does not move, and at ``reset`` the soles rest on a floor that is about level.
    """

    def __init__(self, model: RobotModel, config: EstimatorConfig | None = None) -> None:
        self.given = config = config or default_config(EstimatorConfig, "controllers", "estimator")
        self.config = replace(config, imu=config.imu.with_sensor(model.profile.sensors.imu, config.gravity))
        self._model = model
        kinematics = self.config.kinematics
        self._kinematics = SoleKinematics(
            model,
            encoder=kinematics.encoder_steps * model.profile.sensors.encoders.resolution,
            position=kinematics.position,
            orientation=kinematics.orientation,
        )
        config, sensors = self.config, model.profile.sensors
        self._contacts = ContactDetector(model, config.contact, config.foot_sensors, config.foot, config.gravity)
        self.observer = ForceObserver(model, config.observer, config.gravity)
        self._feet = FootSensorMonitor(config.foot_sensors, self.observer.weight, sensors.feet.fitted)
        self._slip = SlipMonitor(config.slip, config.gate)
        self.friction = FrictionEstimator(model, config.friction, config.gravity)
        self.filter = InvariantFilter(config)
        self.health = EstimatorHealth()
        self._buffer = SensorBuffer(model.nj, sensors, config.foot_sensors.saturation, config.stamp_gap)
        self._unobserved = 0.0
        self._ready = False
        self._level_due = True
        self._t = self._started = 0.0
        encoders = model.profile.sensors.encoders
        joint_variance = (kinematics.encoder_steps * encoders.resolution) ** 2 + encoders.offset**2
        self._variances = np.array([joint_variance, encoders.velocity_noise**2, 0.0])
        feet = self._feet.memory, self._contacts.memory, self._slip.memory, self.friction.memory
        body = self.filter.memory, self._kinematics.memory, self.observer.memory
        self._stages = unbox(_Stages(self._buffer.memory, *feet, *body, np.zeros(2), np.zeros(3)))
        self._warm_up()

    def _warm_up(self) -> None:
        """Compile every kernel, so that nothing compiles inside the loop."""
        nj = self._model.nj
        up = np.array([0.0, 0.0, self.config.gravity])
        hanging = SensorData(0.0, np.zeros(nj), np.zeros(nj), np.zeros(nj), np.zeros(3), up, np.zeros((2, 6)))
        self.reset(hanging)
        self.step(structs.replace(hanging, t=NOMINAL_STEP), NOMINAL_STEP)
        self.filter.measure_level()
        self.base_covariance()
        self._ready = False

    @property
    def gyro_bias(self) -> Vector:
        """Estimated bias of the angular rate, in the IMU's frame (3,) [rad/s]."""
        return np.array(self.filter.state.biases[0])

    @property
    def accel_bias(self) -> Vector:
        """Estimated bias of the specific force, in the IMU's frame (3,) [m/s^2]."""
        return np.array(self.filter.state.biases[1])

    def odometry_covariance(self) -> tuple[Matrix, Matrix]:
        """Covariances (6, 6) of the last pose in odom and twist in base_link, as in nav_msgs/Odometry."""
        joint = self.base_covariance()
        return joint[:6, :6].copy(), joint[6:, 6:].copy()

    def base_covariance(self) -> Matrix:
        """Joint covariance of pose and twist as in ``odometry_covariance`` (12, 12); a new array."""
        covariance, state = np.empty((12, 12)), self.filter.state
        base_covariance(
            state.rotation, state.vectors[1], state.covariance, self._kinematics.imu, self._variances, covariance
        )
        return covariance

    @property
    def push(self) -> PushEstimate:
        """The present push."""
        return self.observer.push

    @property
    def centroidal(self) -> CentroidalState:
        """CoM, DCM, ZMP and angular momentum of the last state."""
        return self.observer.centroidal

    def reset(self, sensors: SensorData) -> RobotState:
        """Start from one sample at rest: midpoint of the soles at the origin, yaw 0; ``MessageError`` if unusable."""
        self._buffer.reset(sensors)
        share = float(np.linalg.norm(self._buffer.imu[1])) / self.config.gravity
        if abs(share - 1.0) > self.config.rest.accel_at_reset:
            raise MessageError(f"sensors.accel: {share:.2f} times gravity, so the robot is not at rest")
        self._kinematics.update(self._buffer.joints[0])
        self.filter.initialise(self._kinematics.soles, self._kinematics.imu.rotation, self._buffer.imu[1])
        self.health = EstimatorHealth()
        self._t = self._started = sensors.t
        self._variances[2] = self.config.imu.gyro_noise**2 / NOMINAL_STEP
        self._ready = True
        self._level_due = True
        self._unobserved = 0.0
        state, absent = self._state(), 1.0 * (self._buffer.feet == NOT_FINITE)
        self.observer.reset(state.q, state.v, state.tau, self._buffer.wrenches, absent)
        self._feet.reset(self._buffer.feet, self._buffer.wrenches, self.observer.estimated)
        self._contacts.reset(self._feet.used, self._feet.fault)
        self._slip.reset()
        self.friction.reset()
        self.health.foot_sensors = self._feet.states
        return self._state()

    def step(self, sensors: SensorData, dt: float, expected: tuple[bool, bool] | None = None) -> RobotState:
        """Advance by one sample, ``dt`` [s] after the last; bad parts are replaced, a stale sample only propagates.

        ``expected`` is the scheduled contact of each foot; None without a gait schedule. Raises ``MessageError`` before
        ``reset``.
        """
        if not self._ready:
            raise MessageError("the estimator needs reset() with a first sample before step()")
        health, buffer = self.health, self._buffer
        health.steps += 1
        if not 0.0 < dt < math.inf:
            health.stale += 1
            return self._state()
        missing = buffer.accept(sensors)
        if not self._feet.fitted:
            missing &= ~(BAD_FEET | SATURATED_FEET)
        health.count(missing, dt)
        self._t = self._t + dt if missing & STALE else sensors.t
        coasting, imu = missing & (STALE | BAD_IMU), self.config.imu
        scale = imu.coast_factor if coasting or missing & SATURATED_IMU else 1.0
        self._variances[2] = (scale * imu.gyro_noise) ** 2 / dt
        left, right = UNKNOWN_FEET if expected is None else map(float, expected)
        changed, rejected, gated = _advance(self._stages, missing, dt, scale, left, right)
        health.rejected += rejected
        health.gated += gated
        if changed:
            feet, slips = self._feet, self._slip.counts
            health.foot_sensors, health.slips = feet.states, (int(slips[0]), int(slips[1]))
            health.sensor_faults = int(feet.counts[0]), int(feet.counts[1])
        if not missing & ~BAD_FEET and self._at_rest():
            rest = self.config.rest
            starts = self._t - self._started <= rest.time
            health.rejected += self.filter.measure_rest(rest.velocity**2 if starts else rest.moved**2 / dt)
        if self._level_due and self._contacts.confidence.min() >= 1.0:
            health.rejected += self.filter.measure_level()
            self._level_due = False
        health.friction = float(self.friction.coefficient[0])
        self._unobserved += dt
        if missing & (STALE | BAD_JOINTS):  # the observer takes one longer step afterwards
            return self._state()
        span, self._unobserved = self._unobserved, 0.0
        return self._state(span)

    def _at_rest(self) -> bool:
        """Whether no foot bears load and the IMU measures only gravity: the robot hangs, or the simulator holds it."""
        left, right = self._contacts.active.tolist()
        if left or right:
            return False
        rate, force = self._buffer.imu
        rest = self.config.rest
        quiet = float(rate @ rate) < rest.gyro**2
        return quiet and abs(math.sqrt(float(force @ force)) - self.config.gravity) < rest.accel

    def _state(self, span: float = -1.0) -> RobotState:
        """State from the filter; the force observer advances by ``span`` [s] unless negative."""
        q, v = np.empty(self._model.nq), np.empty(self._model.nv)
        _conclude(self._stages, span, q, v)
        wrenches = self._feet.used.copy()
        left, right = self._contacts.active.tolist()
        return RobotState(
            t=self._t,
            q=q,
            v=v,
            tau=self._buffer.joints[2].copy(),
            contacts=(ContactState(left > 0.0, wrenches[0]), ContactState(right > 0.0, wrenches[1])),
            friction=float(self.friction.coefficient[0]),
        )


@njit(cache=True)
def _advance(
    stages: Unboxed[_Stages], missing: int, dt: float, scale: float, left: float, right: float
) -> tuple[bool, int, int]:
    """Contacts, prediction and correction with the soles; ``scale`` multiplies the inertial noise.

    ``left`` and ``right`` are the scheduled contact of each foot. Returns whether the health of the feet has changed,
    the number of unusable sole measurements, and the number with less weight.
    """
    buffer, feet, contacts, slips, friction, memory, chains, observer, expected, rate = stages.record
    innovation, imu, changed = memory.state.innovation, buffer.imu, False
    if not missing & STALE:
        expected[0], expected[1] = left, right
        forces, torques_good = observer.state, not missing & BAD_TORQUES
        changed = judge_sensors(
            buffer.feet, buffer.wrenches, forces.measured, forces.estimated, forces.base[2], torques_good, expected, dt,
            feet,
        )  # fmt: skip
        assess_contacts(feet.used, buffer.feet, feet.fault, expected, dt, contacts)
        if watch_slips(innovation, contacts.confidence[:, 0], dt, contacts.densities, slips):
            changed = True
    previous = imu[0] if missing & (STALE | BAD_IMU) else buffer.previous_rate
    for i in range(3):
        rate[i] = 0.5 * (imu[0, i] + previous[i])
    propagate(rate, imu[1], dt, contacts.densities, contacts.pivots, scale, chains.soles.covariances, memory)
    if missing & (STALE | BAD_JOINTS):
        return changed, 0, 0
    sole_poses(buffer.joints[0], chains)
    rejected = correct_soles(memory.state, chains.soles, memory.gate, memory.error)
    if not missing & STALE:
        soles, rotations = memory.state.vectors[2:], memory.state.soles
        watch_friction(feet.used, contacts.confidence[:, 1], slips.slipping, soles, rotations, dt, friction)
    return changed, rejected, int(innovation[0] > memory.gate) + int(innovation[1] > memory.gate)


@njit(cache=True)
def _conclude(stages: Unboxed[_Stages], span: float, q: Vector, v: Vector) -> None:
    """Write the configuration (nq,) and velocity (nv,); the force observer advances by ``span`` [s] unless negative."""
    buffer, feet, _, _, _, memory, chains, observer, _, _ = stages.record
    state = memory.state
    base_state(state.rotation, state.vectors, state.biases, buffer.imu[0], buffer.joints, chains.imu, q, v)
    if span >= 0.0:
        observe(q, v, buffer.joints[2], buffer.wrenches, feet.fault, feet.doubt[0] > 0.0, span, observer)
