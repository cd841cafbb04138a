"""The state estimator: sensors in, ``RobotState`` out."""

import math
from dataclasses import replace

import numpy as np
from msgspec import structs

from controllers.estimation.config import EstimatorConfig
from controllers.estimation.feet import NOT_FINITE, UNKNOWN, ContactDetector, FootSensorMonitor, SlipMonitor
from controllers.estimation.filter import Filter, InvariantFilter
from controllers.estimation.kinematics import SoleChains, SoleKinematics, base_covariance, base_state
from controllers.estimation.observer import ForceObserver
from controllers.estimation.samples import (
    BAD_FEET,
    BAD_IMU,
    BAD_JOINTS,
    BAD_TORQUES,
    SATURATED_FEET,
    SATURATED_IMU,
    STALE,
    EstimatorHealth,
    SensorBuffer,
)
from models.config import default_config
from models.errors import MessageError
from models.numerics.compiled import njit
from models.numerics.unboxed import Unboxed
from models.robot_model import RobotModel
from models.types import CentroidalState, ContactState, Matrix, PushEstimate, RobotState, SensorData, Vector

NOMINAL_STEP = 0.001  #: Step of the call that compiles, and of the rate sample of a state that no step has led to [s]


class StateEstimator:
    """Contact-aided invariant Kalman filter over encoders, IMU and foot sensors.

    One step is: contacts from the wrenches, prediction, correction with both sole poses, and the base from the
    IMU through the joints between. The prediction takes the mean of the last two rates, and the newest
    specific force as the mean over the step (accelerometers integrate over their sampling time)::

        R_WB = R_WI R_BI',   p_B = p_I - R_WB r_BI,   w_B = R_BI w_I - J_w dq,   v_B = R_WB' v_I - w_B x r_BI - J_v dq

    Joint velocities enter only the last line, and only where the IMU does not sit on the base, so their
    noise does not shake the base; accelerations reach the velocity within the step they are measured in.

    A sample that is not finite, or not newer than the last one, is replaced part by part: the IMU's by its
    last good values with more noise, joints and wrenches by their last good values without a correction. ``health``
    counts them; ``health.coasting`` is their duration.

    ``config`` is the packaged ``estimator.yaml`` when None; ``given`` keeps it, and the attribute ``config`` adds the
    figures of the robot's IMU. Raises ``RobotModelError`` when the chains to soles or IMU are not of revolute joints.

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
        self.filter = InvariantFilter(config)
        self.health = EstimatorHealth()
        self._buffer = SensorBuffer(model.nj, sensors, config.foot_sensors.saturation, config.stamp_gap)
        self._expected = np.full(2, UNKNOWN)
        self._unobserved = 0.0
        self._ready = False
        self._level_due = True
        self._t = 0.0
        self._rate = np.zeros(3)
        encoders = model.profile.sensors.encoders
        joint_variance = (kinematics.encoder_steps * encoders.resolution) ** 2 + encoders.offset**2
        self._variances = np.array([joint_variance, encoders.velocity_noise**2, 0.0])
        self._warm_up()

    def _warm_up(self) -> None:
        """Compile every kernel now, so that nothing compiles inside the loop."""
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
        """Of both together (12, 12): pose as in ``odometry_covariance``, then the twist; a new array."""
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
        """Start from one sample at rest: soles' middle at x = y = z = 0, yaw 0; ``MessageError`` if unusable."""
        self._buffer.reset(sensors)
        share = float(np.linalg.norm(self._buffer.imu[1])) / self.config.gravity
        if abs(share - 1.0) > self.config.rest.accel_at_reset:
            raise MessageError(f"sensors.accel: {share:.2f} times gravity, so the robot is not at rest")
        self._kinematics.update(self._buffer.joints[0])
        self.filter.initialise(self._kinematics.soles, self._kinematics.imu.rotation, self._buffer.imu[1])
        self.health = EstimatorHealth()
        self._t = sensors.t
        self._variances[2] = self.config.imu.gyro_noise**2 / NOMINAL_STEP
        self._ready = True
        self._level_due = True
        self._unobserved = 0.0
        q, v = self._configuration()
        absent = 1.0 * (self._buffer.feet == NOT_FINITE)
        self.observer.reset(q, v, self._buffer.joints[2], self._buffer.wrenches, absent)
        self._feet.reset(self._buffer.feet, self._buffer.wrenches, self.observer.estimated)
        self._contacts.reset(self._feet.used, self._feet.fault)
        self._slip.reset()
        self.health.foot_sensors = self._feet.states
        return self._state_of(q, v)

    def step(self, sensors: SensorData, dt: float, expected: tuple[bool, bool] | None = None) -> RobotState:
        """Advance by one sample, which may be unusable, ``dt`` [s] after the last; propagates if it is stale.

        ``expected`` is the planned contact of each foot by the gait; None without a schedule. Raises ``MessageError``
        before ``reset``.
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
        if not missing & STALE:
            self._update_feet(dt, not missing & BAD_TORQUES, expected)
        self._predict(dt, missing)
        if not missing & (STALE | BAD_JOINTS):
            self._kinematics.update(buffer.joints[0])
            health.rejected += self.filter.measure_soles(self._kinematics.soles)
            left, right = self.filter.state.innovation.tolist()
            health.gated += (left > self.config.gate) + (right > self.config.gate)
        if not missing & ~BAD_FEET and self._at_rest():
            health.rejected += self.filter.measure_rest()
        if self._level_due and self._contacts.confidence.min() >= 1.0:
            health.rejected += self.filter.measure_level()
            self._level_due = False
        q, v = self._configuration()
        self._observe(q, v, dt, missing)
        return self._state_of(q, v)

    def _update_feet(self, dt: float, torques_good: bool, expected: tuple[bool, bool] | None) -> None:
        feet, contacts, health = self._feet, self._contacts, self.health
        if expected is None:
            self._expected[:] = UNKNOWN
        else:
            self._expected[:] = expected
        feet.update(self._buffer.feet, self._buffer.wrenches, self.observer, torques_good, self._expected, dt)
        contacts.update(feet.used, self._buffer.feet, feet.fault, self._expected, dt)
        self._slip.update(self.filter.state.innovation, contacts.confidence[:, 0], dt, contacts.densities)
        if feet.changed:
            health.foot_sensors = feet.states
            health.sensor_faults = int(feet.counts[0]), int(feet.counts[1])
        if self._slip.changed:
            health.slips = int(self._slip.counts[0]), int(self._slip.counts[1])

    def _predict(self, dt: float, missing: int) -> None:
        imu = self._buffer.imu
        coasting = missing & (STALE | BAD_IMU)
        scale = self.config.imu.coast_factor if coasting or missing & SATURATED_IMU else 1.0
        self._variances[2] = (scale * self.config.imu.gyro_noise) ** 2 / dt
        np.add(imu[0], imu[0] if coasting else self._buffer.previous_rate, out=self._rate)
        self._rate *= 0.5
        self.filter.predict(
            self._rate, imu[1], dt, self._contacts.densities, self._contacts.pivots, scale,
            self._kinematics.soles.covariances,
        )  # fmt: skip

    def _observe(self, q: Vector, v: Vector, dt: float, missing: int) -> None:
        """Advance the force observer; over missing samples it takes one longer step afterwards."""
        if missing & (STALE | BAD_JOINTS):
            self._unobserved += dt
            return
        feet = self._feet
        self.observer.update(
            q, v, self._buffer.joints[2], self._buffer.wrenches, feet.fault, dt + self._unobserved, feet.doubtful
        )
        self._unobserved = 0.0

    def _at_rest(self) -> bool:
        """No foot bears and the IMU measures gravity alone: the robot hangs, or the simulator holds it."""
        left, right = self._contacts.active.tolist()
        if left or right:
            return False
        rate, force = self._buffer.imu
        rest = self.config.rest
        quiet = float(rate @ rate) < rest.gyro**2
        return quiet and abs(math.sqrt(float(force @ force)) - self.config.gravity) < rest.accel

    def _configuration(self) -> tuple[Vector, Vector]:
        """Configuration (nq,) and velocity (nv,) of the filter's estimate, in new arrays."""
        q, v = np.empty(self._model.nq), np.empty(self._model.nv)
        _configure(self._buffer.imu, self._buffer.joints, self.filter.unboxed, self._kinematics.unboxed, q, v)
        return q, v

    def _state(self) -> RobotState:
        return self._state_of(*self._configuration())

    def _state_of(self, q: Vector, v: Vector) -> RobotState:
        wrenches = self._feet.used.copy()
        active = self._contacts.active
        return RobotState(
            t=self._t,
            q=q,
            v=v,
            tau=self._buffer.joints[2].copy(),
            contacts=(
                ContactState(bool(active[0]), wrenches[0]),
                ContactState(bool(active[1]), wrenches[1]),
            ),
        )


@njit(cache=True)
def _configure(
    imu: Matrix, joints: Matrix, memory: Unboxed[Filter], chains: Unboxed[SoleChains], q: Vector, v: Vector
) -> None:
    """``base_state`` of the filter's state; ``imu`` starts with the measured rate (2, 3)."""
    state = memory.record.state
    base_state(state.rotation, state.vectors, state.biases, imu[0], joints, chains.record.imu, q, v)
