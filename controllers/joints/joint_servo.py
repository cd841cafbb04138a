"""Joint servo: the law of the joint drivers, which computes the command of each drive from a setpoint."""

from enum import Enum
from math import inf
from typing import NamedTuple

import numpy as np
from pydantic.dataclasses import dataclass

from controllers.joints.torque_limiter import TorqueLimits, limit_torques, torque_limits
from models.config import STRICT, NonNegative, Positive, default_config
from models.errors import PoiseError
from models.numerics.compiled import njit
from models.numerics.unboxed import Unboxed, unbox
from models.robot_model import RobotModel
from models.trajectory import TrajectorySampler, validate_trajectory
from models.types import JointCommand, JointTrajectory, Matrix, Vector


@dataclass(frozen=True, slots=True, config=STRICT)
class JointServoConfig:
    """Schema of ``controllers/config/joint_servo.yaml``."""

    command_timeout: Positive  #: age of a setpoint above which the driver damps [s]
    arming_blend: NonNegative  #: duration of the fade-in of the first setpoints after arming [s]
    damped_ramp: NonNegative  #: duration of the fade from the last torque to damping [s]
    damping_scale: NonNegative  #: damping of the fallback as a multiple of kd [1]
    position_margin: Positive  #: distance from a joint limit within which torque towards it fades [rad]
    velocity_margin: Positive  #: range beyond the velocity limit in which torque fades to zero, share of the limit [1]


class ServoState(Enum):
    """State of the drivers."""

    OFF = "off"  # no torque; commands are ignored
    ACTIVE = "active"  # tracks setpoints; before the first one, holds the posture measured on arming
    DAMPED = "damped"  # damping only, after a fault; commands are ignored until ``arm``


class JointServo:
    """Joint PD law with feed-forward and the protections of a motor driver.

    tau = kp (q_d - q) + kd (v_d - v) + tau_d, where (q_d, v_d, tau_d, kp, kd) (5, nj) is the last accepted setpoint or
    the current sample of a trajectory. A setpoint without gains uses the gains of the profile. tau (nj,) [N.m] is then
    limited as in ``controllers/joints/torque_limiter.py``.

    ``step`` returns the command of the drives: the setpoint with its gains, which the drives evaluate at their rate.
    A joint whose torque is limited gets the limited torque alone, with zero gains. With ``keep_gains``, gains and
    feed-forward are reduced by the same factor instead, unless the torque-rate limit keeps the torque beyond the
    desired one or at the opposite sign. A drive without further commands then still tracks its setpoint, with damping.

    After ``arm``, setpoints are faded in from the measured posture with s = 3 u^2 - 2 u^3; after ``blend``, from the
    setpoint in force. Gains take effect at once. A setpoint that is not finite, has the wrong size or a negative gain
    is refused and counted, and the previous one is kept. If no setpoint is accepted for ``command_timeout``, counted
    from the end of a trajectory, the driver damps: tau fades from its last value to -damping_scale kd v. It damps until
    ``arm``.

    Assumptions:
        ``step`` is called at the rate of the drivers with times that do not decrease.
    """

    def __init__(self, model: RobotModel, config: JointServoConfig | None = None, *, keep_gains: bool = False) -> None:
        self.config = config or default_config(JointServoConfig, "controllers", "joint_servo")
        self.state = ServoState.OFF  #: State of the drivers
        self.refused = 0  #: Number of refused setpoints and trajectories
        self.timeouts = 0  #: Number of times that the driver damped because no setpoint arrived
        self.silence = 0.0  #: Time from the last setpoint to the newest timeout [s]
        self.model = model
        self._keep_gains = keep_gains
        nj = model.nj
        self._gains = np.array([model.kp, model.kd])  # (2, nj)
        self._damping = self.config.damping_scale * model.kd
        self._high = np.array([model.q_upper, model.v_max, model.tau_max])  # (3, nj)
        self._low = np.array([model.q_lower, -model.v_max, -model.tau_max])  # (3, nj)
        self._limits = torque_limits(model, self.config.position_margin, self.config.velocity_margin)
        self.sensor_faults = 0  #: Number of steps with a measurement or torque that was not finite
        # Rows of a setpoint: q, v, tau, kp, kd
        self._setpoint, self._faded = np.zeros((2, 5, nj))
        self._setpoint[3:] = self._gains
        self._damped, self._drive = np.zeros((2, 5, nj))
        self._command = JointCommand(*self._drive)
        self._memory = unbox(_Memory(self._limits, np.zeros(nj), self._drive))
        self._tau_at_fault = np.zeros(nj)
        self._sampler: TrajectorySampler | None = None
        self._sampler_start = 0.0
        self._measured_once = self._fading = False
        self._fade_start = np.zeros((3, nj))
        self._first_command: float | None = None
        self._last_command = 0.0
        self._deadline = inf
        self._fault_time: float | None = None
        # Compile the kernels now, so that no tick waits for the compiler.
        q, v, tau, kp, kd = self._drive
        _accept(q, v, tau, kp, kd, self._low, self._high, self._faded)
        drive_torque(model, self._command, q, v)
        _limit(self._damped, q, v, 0.0, keep_gains, self._memory)

    @property
    def torque(self) -> Vector:
        """Torques of the last command at the state measured in that step (nj,) [N.m]."""
        return self._limits.tau

    @property
    def setpoint(self) -> JointCommand:
        """A copy of the setpoint in force, before any fade."""
        return JointCommand(*self._setpoint.copy())

    @property
    def commanded(self) -> bool:
        """Whether a setpoint has been accepted since ``arm`` or ``blend``."""
        return self._first_command is not None

    def arm(self) -> None:
        """Accept commands, clear a latched fault and fade in the first setpoints."""
        self.state = ServoState.ACTIVE
        self._setpoint[3:] = self._gains
        self._measured_once = self._fading = False
        self._first_command = self._sampler = self._fault_time = None
        self._deadline = inf

    def blend(self) -> None:
        """Fade in the first setpoints of another source; equals ``arm`` when inactive or without measurements."""
        if self.state is not ServoState.ACTIVE or not self._measured_once:
            self.arm()
            return
        self._fade_start[:] = (self._faded if self._fading else self._setpoint)[:3]
        self._first_command = self._sampler = None
        self._deadline = inf

    def damp(self) -> None:
        """Damp until ``arm``."""
        if self.state is not ServoState.DAMPED:
            self.state = ServoState.DAMPED
            self._tau_at_fault[:] = self._limits.tau
            self._fault_time = None

    def off(self) -> None:
        """Reduce the torque to zero at the torque-rate limit, and ignore commands until ``arm``."""
        self.state = ServoState.OFF

    def command(self, cmd: JointCommand | JointTrajectory, t: float) -> bool:
        """Accept a trajectory, or a setpoint, clipped to the limits, at ``t`` [s]; returns whether it is in force."""
        if isinstance(cmd, JointTrajectory):
            return self.command_trajectory(cmd, t)
        if self.state is not ServoState.ACTIVE:
            return False
        gains = self._gains
        kp, kd = gains[0] if cmd.kp is None else cmd.kp, gains[1] if cmd.kd is None else cmd.kd
        shape = kp.shape
        if not cmd.q.shape == cmd.v.shape == cmd.tau.shape == kd.shape == shape == gains[0].shape:
            self.refused += 1
            return False
        if not _accept(cmd.q, cmd.v, cmd.tau, kp, kd, self._low, self._high, self._setpoint):
            self.refused += 1
            return False
        self._sampler = None
        self._restart_timeout(t, t)
        return True

    def command_trajectory(self, traj: JointTrajectory, t: float) -> bool:
        """Execute a trajectory from ``t`` [s], from the setpoint in force; False if inactive or without measurements.

        Other joints hold their setpoints. Raises ``JointNameError`` or ``TrajectoryError`` as
        ``validate_trajectory`` does; the previous setpoint then stays in force.
        """
        if self.state is not ServoState.ACTIVE or not self._measured_once:
            return False
        commanded = self._first_command is not None
        start_q = self._setpoint[0].copy() if commanded else self._fade_start[0].copy()
        start_v = self._setpoint[1].copy() if commanded else None
        elapsed = t - self._last_command if commanded else 0.0
        try:
            validate_trajectory(traj, self.model, start_q=start_q, start_v=start_v, elapsed=max(elapsed, 0.0))
        except PoiseError:
            self.refused += 1
            raise
        self._sampler = TrajectorySampler(traj, self.model, start_q, start_v)
        self._setpoint[3:] = self._gains
        self._sampler_start = t
        self._restart_timeout(t, t + self._sampler.duration)
        return True

    def overdue(self, t: float) -> bool:
        """Whether ``step`` at ``t`` [s] would damp because no setpoint arrived."""
        return self.state is ServoState.ACTIVE and t > self._deadline

    def _restart_timeout(self, t: float, valid_until: float) -> None:
        """Restart the timeout when a setpoint arrives at ``t`` [s] that is valid until a time [s]."""
        if self._first_command is None:
            self._first_command = t
        self._last_command = t
        self._deadline = valid_until + self.config.command_timeout

    def step(self, t: float, q: Vector, v: Vector, dt: float) -> JointCommand:
        """Command of the drives at ``t``, ``dt`` [s] after the last; the next step overwrites it.

        ``q`` [rad] and ``v`` [rad/s] are measured (nj,).
        """
        if self.overdue(t):
            self.timeouts += 1
            self.silence = t - self._last_command
            self.damp()
        if self.state is ServoState.ACTIVE:
            desired = self._track(t, q)
        else:
            desired = self._damped
            self._damp(t, desired)
        if not _limit(desired, q, v, dt, self._keep_gains, self._memory):
            self.sensor_faults += 1
        return self._command

    def _track(self, t: float, q: Vector) -> Matrix:
        """The setpoint in force, faded in (5, nj)."""
        if not self._measured_once:
            if not np.isfinite(q).all():
                self._damped[1:] = 0.0
                return self._damped
            self._measured_once = True
            self._fade_start[0] = q
            self._fade_start[1:] = 0.0
            if self._first_command is None:
                self._setpoint[:3] = self._fade_start
        if self._sampler is not None:
            at = t - self._sampler_start
            self._setpoint[0], self._setpoint[1], _ = self._sampler.sample(at)
            self._setpoint[2] = self._sampler.effort(at)
        setpoint = self._setpoint
        start = self._first_command
        self._fading = start is None or t < start + self.config.arming_blend
        if self._fading:
            u = 0.0 if start is None else max(t - start, 0.0) / self.config.arming_blend
            share = u * u * (3.0 - 2.0 * u)
            np.multiply(setpoint[:3], share, out=self._faded[:3])
            self._faded[:3] += (1.0 - share) * self._fade_start
            self._faded[3:] = setpoint[3:]
            setpoint = self._faded
        return setpoint

    def _damp(self, t: float, desired: Matrix) -> None:
        """Fade from the torque at the fault to viscous damping; no torque at all when off (5, nj)."""
        desired[1:] = 0.0
        if self.state is ServoState.OFF:
            return
        if self._fault_time is None:
            self._fault_time = t
        ramp = self.config.damped_ramp
        share = (t - self._fault_time) / ramp if t < self._fault_time + ramp else 1.0
        np.multiply(self._damping, share, out=desired[4])
        if share < 1.0:
            np.multiply(self._tau_at_fault, 1.0 - share, out=desired[2])


def damping_command(model: RobotModel) -> JointCommand:
    """Damping alone, tau = -damping_scale kd v: the command after a fault."""
    zero = np.zeros(model.nj)
    config = default_config(JointServoConfig, "controllers", "joint_servo")
    return JointCommand(zero, zero, zero, zero, config.damping_scale * model.kd)


def mean_command(model: RobotModel, first: JointCommand, second: JointCommand, share: float) -> JointCommand:
    """Command with the torque ``(1 - share) tau_1 + share tau_2`` of two commands at every state.

    Its gains are the weighted means of the gains. Its position and velocity are those of the second command, and its
    feed-forward is the remainder.
    """
    (q, v, tau, kp, kd), (to_q, to_v, to_tau, to_kp, to_kd) = _rows(model, first), _rows(model, second)
    rest = tau + kp * (q - to_q) + kd * (v - to_v)
    left = 1.0 - share
    return JointCommand(to_q, to_v, left * rest + share * to_tau, left * kp + share * to_kp, left * kd + share * to_kd)


def fade_to_damping(model: RobotModel, last: JointCommand, elapsed: float) -> JointCommand:
    """Command at a time [s] after a fault: the torque of the ``last`` command fades to damping over ``damped_ramp``."""
    ramp = default_config(JointServoConfig, "controllers", "joint_servo").damped_ramp
    return mean_command(model, last, damping_command(model), elapsed / ramp if elapsed < ramp else 1.0)


def _rows(model: RobotModel, command: JointCommand) -> tuple[Vector, Vector, Vector, Vector, Vector]:
    """q, v, tau, kp and kd of a command (nj,), with the gains of the profile by default."""
    kp = model.kp if command.kp is None else command.kp
    return command.q, command.v, command.tau, kp, model.kd if command.kd is None else command.kd


def drive_torque(model: RobotModel, command: JointCommand, q: Vector, v: Vector) -> Vector:
    """Torques of the drives (nj,) [N.m]; zero where they are not finite, as for a measurement that is not finite."""
    tau = np.empty(len(q))
    _finite_pd(*_rows(model, command), q, v, tau)
    return tau


def bounded_command(model: RobotModel, command: JointCommand, q: Vector, v: Vector, share: float) -> JointCommand:
    """Reduce gains and feed-forward of the joints whose torque exceeds a ``share`` of the limits."""
    torque, bound = np.abs(drive_torque(model, command, q, v)), share * model.tau_max
    if not (torque > bound).any():
        return command
    to_q, to_v, *rows = _rows(model, command)
    left = bound / np.maximum(torque, bound)
    return JointCommand(to_q, to_v, *(left * row for row in rows))


@njit(cache=True)
def _accept(
    q: Vector, v: Vector, tau: Vector, kp: Vector, kd: Vector, low: Matrix, high: Matrix, setpoint: Matrix
) -> bool:
    """Write a new setpoint (5, nj), with q, v and tau clipped to ``low``, ``high`` (3, nj); False when invalid."""
    for j in range(q.shape[0]):
        if not (np.isfinite(q[j]) and np.isfinite(v[j]) and np.isfinite(tau[j])):
            return False
        if not (0.0 <= kp[j] < np.inf and 0.0 <= kd[j] < np.inf):
            return False
    for j in range(q.shape[0]):
        setpoint[0, j] = max(min(q[j], high[0, j]), low[0, j])
        setpoint[1, j] = max(min(v[j], high[1, j]), low[1, j])
        setpoint[2, j] = max(min(tau[j], high[2, j]), low[2, j])
        setpoint[3, j], setpoint[4, j] = kp[j], kd[j]
    return True


@njit(cache=True)
def _pd(
    desired_q: Vector, desired_v: Vector, feedforward: Vector, kp: Vector, kd: Vector, q: Vector, v: Vector, tau: Vector
) -> None:
    """Torques of PD and feed-forward at a setpoint; all (nj,)."""
    for j in range(tau.shape[0]):
        tau[j] = feedforward[j]
        if kp[j] != 0.0 or kd[j] != 0.0:
            tau[j] = (desired_q[j] - q[j]) * kp[j] + (desired_v[j] - v[j]) * kd[j] + feedforward[j]


@njit(cache=True)
def _finite_pd(
    desired_q: Vector, desired_v: Vector, feedforward: Vector, kp: Vector, kd: Vector, q: Vector, v: Vector, tau: Vector
) -> None:
    """Torques as by ``_pd``; zero where not finite."""
    _pd(desired_q, desired_v, feedforward, kp, kd, q, v, tau)
    for j in range(tau.shape[0]):
        if not np.isfinite(tau[j]):
            tau[j] = 0.0


class _Memory(NamedTuple):
    """Arrays of ``JointServo``."""

    limits: TorqueLimits
    desired: Vector  # torques before limits (nj,) [N.m]
    drive: Matrix  # command of the drives (5, nj)


@njit(cache=True)
def _limit(setpoint: Matrix, q: Vector, v: Vector, dt: float, keep_gains: bool, servo: Unboxed[_Memory]) -> bool:
    """Command of the drives for a setpoint (5, nj), limited as in ``JointServo``; returns whether all was finite."""
    limits, desired, drive = servo.record
    _pd(setpoint[0], setpoint[1], setpoint[2], setpoint[3], setpoint[4], q, v, desired)
    finite = limit_torques(desired, q, v, dt, limits)
    drive[:] = setpoint
    for j in range(desired.shape[0]):
        tau = limits.tau[j]
        if tau == desired[j]:
            continue
        if keep_gains and tau * desired[j] > 0.0 and abs(tau) < abs(desired[j]):
            drive[2:, j] *= tau / desired[j]
        else:
            drive[2, j] = tau
            drive[3, j] = drive[4, j] = 0.0
    return finite
