"""Joint servo: the law inside the motor drivers, between a set-point and the torque of each joint."""

from __future__ import annotations

from enum import Enum
from math import inf
from typing import Annotated

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from controllers.torque_limiter import TorqueLimiter
from models.compiled import njit
from models.config import STRICT, default_config
from models.errors import PoiseError
from models.robot_model import RobotModel
from models.trajectory import TrajectorySampler, validate_trajectory
from models.types import JointCommand, JointTrajectory, Matrix, Vector


@dataclass(frozen=True, slots=True, config=STRICT)
class JointServoConfig:
    """Schema of ``controllers/config/joint_servo.yaml``."""

    command_timeout: Annotated[float, Field(gt=0, description="age of a set-point at which the driver damps [s]")]
    arming_blend: Annotated[float, Field(ge=0, description="fade-in of the first set-points after arming [s]")]
    damped_ramp: Annotated[float, Field(ge=0, description="fade of the last torque into damping [s]")]
    damping_scale: Annotated[float, Field(ge=0, description="damping of the fallback in multiples of kd [1]")]
    position_margin: Annotated[float, Field(gt=0, description="from a joint limit, where torque fades [rad]")]
    velocity_margin: Annotated[float, Field(gt=0, description="share beyond the speed limit, to no torque [1]")]


class ServoState(Enum):
    """What the drivers do."""

    OFF = "off"
    """No torque; commands are ignored."""
    ACTIVE = "active"
    """Tracks set-points; before the first one, holds the posture measured on arming."""
    DAMPED = "damped"
    """Damping only, after a fault; commands are ignored until ``arm``."""


class JointServo:
    """Joint PD with feed-forward and every protection of a motor driver.

    tau = kp (q_d - q) + kd (v_d - v) + tau_d, where (q_d, v_d, tau_d) (3, nj) is the last accepted set-point, held
    until the next, or the sample of the trajectory being executed. tau (nj,) [N.m] then passes the limits of
    ``controllers/torque_limiter.py``.

    After ``arm`` the set-points are faded in from the measured posture with s = 3 u^2 - 2 u^3, after ``blend`` from the
    set-point in force, so nothing jumps. A set-point that is not finite or of the wrong size is refused, counted, and
    the previous one kept. When no set-point was accepted for ``command_timeout`` (after the end of a trajectory), the
    driver damps: tau fades from its last value to -damping_scale kd v. That state holds until ``arm``.

    Args:
        model: Robot; gives kp, kd and the limits, all (nj,).
        config: Timing and margins; the packaged ones when None.

    Attributes:
        state: What the drivers do.
        refused: Set-points refused because they were not finite or of the wrong size.
        timeouts: Times that the driver damped because no set-point came.
        silence: From the last set-point to the newest of these times [s].

    Assumptions:
        ``step`` is called at the rate of the drivers with times that do not decrease.
    """

    def __init__(self, model: RobotModel, config: JointServoConfig | None = None) -> None:
        self.config = config or default_config(JointServoConfig, "controllers", "joint_servo")
        self.state = ServoState.OFF
        self.refused = 0
        self.timeouts = 0
        self.silence = 0.0
        self._model = model
        nj = model.nj
        self._gains = np.array([model.kp, model.kd])  # (2, nj)
        self._damping = -self.config.damping_scale * model.kd
        self._high = np.array([model.q_upper, model.v_max, model.tau_max])  # (3, nj)
        self._low = np.array([model.q_lower, -model.v_max, -model.tau_max])  # (3, nj)
        self._limiter = TorqueLimiter(model, self.config.position_margin, self.config.velocity_margin)
        self._setpoint = np.zeros((3, nj))
        self._incoming = np.zeros((3, nj))
        self._faded = np.zeros((3, nj))
        self._target, self._measured = np.zeros(nj), np.zeros((2, nj))
        self._tau_at_fault = np.zeros(nj)
        self._sampler: TrajectorySampler | None = None
        self._sampler_start = 0.0
        self._measured_once = self._fading = False
        self._fade_start = np.zeros((3, nj))
        self._first_command: float | None = None
        self._last_command = 0.0
        self._deadline = inf
        self._fault_time: float | None = None

    @property
    def sensor_faults(self) -> int:
        """Steps with a measurement that was not finite."""
        return self._limiter.sensor_faults

    @property
    def setpoint(self) -> JointCommand:
        """A copy of the set-point in force, before any fade."""
        return JointCommand(*self._setpoint.copy())

    def arm(self) -> None:
        """Accept commands from now on; clears a latched fault. The first set-points are faded in."""
        self.state = ServoState.ACTIVE
        self._measured_once = self._fading = False
        self._first_command = self._sampler = self._fault_time = None
        self._deadline = inf

    def blend(self) -> None:
        """Another source of set-points takes over: fade its first ones in from the set-point in force.

        Like ``arm`` when the driver is not active or has not measured the joints yet.
        """
        if self.state is not ServoState.ACTIVE or not self._measured_once:
            self.arm()
            return
        self._fade_start[:] = self._faded if self._fading else self._setpoint
        self._first_command = self._sampler = None
        self._deadline = inf

    def damp(self) -> None:
        """Go to damping and stay there until ``arm``."""
        if self.state is not ServoState.DAMPED:
            self.state = ServoState.DAMPED
            self._tau_at_fault[:] = self._limiter.tau
            self._fault_time = None

    def off(self) -> None:
        """Take the torque away (at the torque-rate limit) and ignore commands until ``arm``."""
        self.state = ServoState.OFF

    def command(self, cmd: JointCommand, t: float) -> bool:
        """Take a set-point that holds until the next one; values beyond the joint's limits are brought back to them.

        Args:
            cmd: Set-point of every joint.
            t: Time of arrival on the clock of ``step`` [s].

        Returns:
            Whether it is in force: False when the driver is not active or the set-point was refused.
        """
        if self.state is not ServoState.ACTIVE:
            return False
        shape = self._target.shape
        new = self._incoming
        if cmd.q.shape != shape or cmd.v.shape != shape or cmd.tau.shape != shape:
            self.refused += 1
            return False
        new[0], new[1], new[2] = cmd.q, cmd.v, cmd.tau
        if not _take(new, self._low, self._high, self._setpoint):
            self.refused += 1
            return False
        self._sampler = None
        self._accept(t, t)
        return True

    def command_trajectory(self, traj: JointTrajectory, t: float) -> bool:
        """Execute a trajectory from now on, from the set-point in force; joints that it does not name hold theirs.

        Args:
            traj: Trajectory, its times counted from ``t``.
            t: Time of arrival on the clock of ``step`` [s].

        Returns:
            Whether it is being executed: False when the driver is not active or has not measured the joints yet.

        Raises:
            JointNameError: A joint is unknown or named twice; the previous set-point stays in force.
            TrajectoryError: As ``validate_trajectory`` raises it; the previous set-point stays in force.
        """
        if self.state is not ServoState.ACTIVE or not self._measured_once:
            return False
        commanded = self._first_command is not None
        start_q = self._setpoint[0].copy() if commanded else self._fade_start[0].copy()
        start_v = self._setpoint[1].copy() if commanded else None
        elapsed = t - self._last_command if commanded else 0.0
        try:
            validate_trajectory(traj, self._model, start_q=start_q, start_v=start_v, elapsed=max(elapsed, 0.0))
        except PoiseError:
            self.refused += 1
            raise
        self._sampler = TrajectorySampler(traj, self._model, start_q, start_v)
        self._sampler_start = t
        self._accept(t, t + self._sampler.duration)
        return True

    def overdue(self, t: float) -> bool:
        """Whether ``step`` at this time [s] would damp because no set-point came."""
        return self.state is ServoState.ACTIVE and t > self._deadline

    def _accept(self, t: float, valid_until: float) -> None:
        """Note the arrival of a set-point that is good until a time [s]."""
        if self._first_command is None:
            self._first_command = t
        self._last_command = t
        self._deadline = valid_until + self.config.command_timeout

    def step(self, t: float, q: Vector, v: Vector, dt: float) -> Vector:
        """Compute the torques of one driver period.

        Args:
            t: Time [s].
            q: Measured joint positions (nj,) [rad].
            v: Measured joint velocities (nj,) [rad/s].
            dt: Time since the last step [s].

        Returns:
            Torques (nj,) [N.m]; the array is overwritten by the next call.
        """
        if self.overdue(t):
            self.timeouts += 1
            self.silence = t - self._last_command
            self.damp()
        target = self._target
        if self.state is ServoState.ACTIVE:
            self._track(t, q, v, target)
        elif self.state is ServoState.DAMPED:
            self._damp(t, v, target)
        else:
            target.fill(0.0)
        return self._limiter.limit(q, v, dt, target)

    def _track(self, t: float, q: Vector, v: Vector, target: Vector) -> None:
        """PD and feed-forward about the set-point in force."""
        if not self._measured_once:
            if not np.isfinite(q).all():
                target.fill(0.0)
                return
            self._measured_once = True
            self._fade_start[0] = q
            self._fade_start[1:] = 0.0
            if self._first_command is None:
                self._setpoint[:] = self._fade_start
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
            np.multiply(self._setpoint, share, out=self._faded)
            self._faded += (1.0 - share) * self._fade_start
            setpoint = self._faded
        measured = self._measured
        measured[0], measured[1] = q, v
        _follow(setpoint, measured, self._gains, target)

    def _damp(self, t: float, v: Vector, target: Vector) -> None:
        """Fade from the torque at the fault to viscous damping."""
        if self._fault_time is None:
            self._fault_time = t
        np.multiply(self._damping, v, out=target)
        ramp = self.config.damped_ramp
        if t < self._fault_time + ramp:
            s = (t - self._fault_time) / ramp
            target *= s
            target += (1.0 - s) * self._tau_at_fault


@njit("boolean(float64[:, ::1], float64[:, ::1], float64[:, ::1], float64[:, ::1])", cache=True)
def _take(new: Matrix, low: Matrix, high: Matrix, setpoint: Matrix) -> bool:
    """Bring a new set-point into its limits and put it in force, unless a value is not finite; all (3, nj)."""
    if not np.isfinite(new).all():
        return False
    for i in range(new.shape[0]):
        for j in range(new.shape[1]):
            setpoint[i, j] = max(min(new[i, j], high[i, j]), low[i, j])
    return True


@njit("void(float64[:, ::1], float64[:, ::1], float64[:, ::1], float64[::1])", cache=True)
def _follow(setpoint: Matrix, measured: Matrix, gains: Matrix, tau: Vector) -> None:
    """Torques (nj,) of PD and feed-forward about a set-point (3, nj), from measured q and v (2, nj)."""
    for j in range(tau.shape[0]):
        stiff = (setpoint[0, j] - measured[0, j]) * gains[0, j]
        tau[j] = stiff + (setpoint[1, j] - measured[1, j]) * gains[1, j] + setpoint[2, j]
