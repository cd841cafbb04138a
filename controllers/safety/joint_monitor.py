"""Detects motors that do not deliver the commanded torque, and stuck encoders."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic.dataclasses import dataclass

from models.config import STRICT, Fraction, NonNegative, Positive, Share, default_config
from models.numerics.compiled import njit
from models.numerics.unboxed import Unboxed, unbox
from models.robot_model import RobotModel
from models.types import JointCommand, RobotState

Array = NDArray[np.float64]
_STRIDE = 8  #: Number of ticks in which every delay is evaluated once
_BETTER = 0.9  #: A delay replaces the present one if the ratio of their misfits is below this [-]


@dataclass(frozen=True, slots=True, config=STRICT)
class JointMonitorConfig:
    """Thresholds of a joint fault."""

    window: Share  # averaging time of torques, and time of constant readings of a stuck encoder [s]
    error: Positive  # error of the mean torque at a fault, as a share of the largest torque [-]
    commanded: Positive  # least mean commanded torque of a motor without output, likewise [-]
    no_output: Positive  # mean torque below which a motor has no output, likewise [-]
    offset: Positive  # added to error and commanded, an eighth of it to no_output [N.m]
    margin: NonNegative  # distance from a joint limit within which torques are not checked [rad]
    grace: NonNegative  # time after a reset without checks [s]
    delay: Positive  # longest measurable delay of the commands [s]
    delay_window: Positive  # time constant of the delay measurement [s]
    lookahead: Fraction  # share of the delay used as look-ahead of the setpoints [-]


class _Memory(NamedTuple):
    """Constants and state of ``JointMonitor``."""

    #: kp, kd, largest torque, bound of the error of the mean torque; for a motor without output: least commanded and
    #: largest measured torque; lowest and highest position and largest velocity at which torques are checked;
    #: largest change of a torque per tick (10, nj)
    gains: Array
    #: Torques of the last commands without feedback, and with the feedback of the sample they were computed from
    #: (2, ticks, nj) [N.m]
    sent: Array
    share: float  # filter gain of the misfit of a delay [-]
    #: Mean torque error as a share of the limits, with feedback evaluated by the drives and at the sample, for delays
    #: of 1, 2, ... ticks (2, ticks) [-]
    misfit: Array
    fit: NDArray[np.int64]  # 1 if feedback is evaluated at the sample, else 0; measured delay [ticks] (2,)
    expected: Array  # expected torques (nj,) [N.m]
    torques: Array  # expected and measured in the last ticks (rows, 2, nj) [N.m]
    last: Array  # positions and velocities of the last tick (2, nj)
    still: NDArray[np.int64]  # number of ticks without a change of both (nj,)
    mean: Array  # of expected torque, measured torque and |measured torque| (3, nj) [N.m]


class JointMonitor:
    r"""Compares the measurements of the drivers with their commands.

    .. math::
        \tau_{cmd}(t) = u(t - T) - k_p q - k_d v, \quad u = \tau_{ff} + k_p q_{set} + k_d v_{set}, \quad
        \tau_{exp} \mathrel{+}= [\tau_{cmd} - \tau_{exp}]_{\pm \dot\tau_{max} \Delta t}, \quad
        |\overline{\tau} - \overline{\tau_{exp}}| > error\;\tau_{max} + offset

    The inequality detects a faulty motor; a motor without output at a command is detected sooner. The limits of torque
    and torque rate are those of the drivers. Nothing is checked near a limit of position or velocity, where the drivers
    fade torques. T is the delay from a sample to the first sample that its command affects. The measured T is the one
    with the least torque error over all joints. If q(t - T) and v(t - T) fit better, the feedback is evaluated at the
    sample and its torque is delayed as well. An encoder is faulty if position and velocity stay bit-identical for
    ``window``; this is checked only if the profile has velocity noise, which changes every sample.

    ``period`` is the tick [s]. ``fault`` names the joint and the values in one sentence and persists until ``reset``.
    """

    def __init__(self, model: RobotModel, period: float = 0.001) -> None:
        self.model, self._period = model, period
        self.config = given = default_config(JointMonitorConfig, "controllers", "joint_monitor")
        self._noisy = model.profile.sensors.encoders.velocity_noise > 0.0
        nj, largest, rows = model.nj, model.tau_max, max(round(given.window / period), 1)
        bounds = np.array([given.error, given.commanded, given.no_output])[:, None] * largest
        offsets = given.offset * np.array([[1.0], [1.0], [0.125]])
        inside = model.q_lower + given.margin, model.q_upper - given.margin, model.v_max
        gains = np.vstack([model.kp, model.kd, largest, bounds + offsets, *inside, period * model.tau_rate_max])
        delays, share = max(round(given.delay / period), 1), min(_STRIDE * period / given.delay_window, 1.0)
        sent, misfit, fit = np.zeros((2, delays, nj)), np.zeros((2, delays)), np.zeros(2, dtype=np.int64)
        expected, torques, last, mean = np.zeros(nj), np.zeros((rows, 2, nj)), np.zeros((2, nj)), np.zeros((3, nj))
        still, zero = np.zeros(nj, dtype=np.int64), np.zeros(nj)
        self._memory = _Memory(gains, sent, share, misfit, fit, expected, torques, last, still, mean)
        self._unboxed = unbox(self._memory)
        _watch_joints(np.zeros(nj + 7), np.zeros(nj + 6), zero, zero, zero, zero, 0, self._unboxed)  # compiles
        self.reset()

    @property
    def delay(self) -> float:
        """Measured delay of the commands [s]."""
        return self._period * int(self._memory.fit[1])

    @property
    def lookahead(self) -> float:
        """Look-ahead of the setpoints [s]: a share of the delay beyond one tick; 0 with feedback at the sample."""
        return 0.0 if self._memory.fit[0] else self.config.lookahead * (self.delay - self._period)

    def reset(self) -> None:
        """Clear the fault; checks resume after ``grace``."""
        self.fault, self._tick, self._grace = "", 0, round(self.config.grace / self._period)
        memory = self._memory
        for array in (memory.expected, memory.torques, memory.sent, memory.still):
            array[:] = 0
        memory.misfit[:], memory.fit[:], memory.last[:] = np.inf, (0, 1), np.nan

    def step(self, state: RobotState, command: JointCommand) -> None:
        """Advance one tick with the measured state and the command computed from it, which acts in a later tick."""
        if self.fault:
            return
        measured, tick = (state.q, state.v, state.tau), self._tick
        found = _watch_joints(*measured, command.q, command.v, command.tau, tick, self._unboxed)
        if (found > 0 or (found < 0 and self._noisy)) and tick > self._grace:
            self.fault = self._describe(found, state)
        self._tick = tick + 1

    def _describe(self, found: int, state: RobotState) -> str:
        joint = abs(found) - 1
        name = self.model.joint_names[joint]
        if found < 0:
            return f"encoder of '{name}' stuck at {state.q[7 + joint]:.4f} rad for {self.config.window:g} s"
        expected, given, _ = self._memory.mean[:, joint]
        figures = f"{given:.1f} N.m instead of {expected:.1f} N.m (means of {self.config.window:g} s)"
        return f"motor of '{name}' gives {figures}"


@njit(cache=True)
def _watch_joints(
    state_q: Array, state_v: Array, tau: Array, q_set: Array, v_set: Array, feed_forward: Array, tick: int,
    memory: Unboxed[_Memory],
) -> int:  # fmt: skip
    """One tick of all joints; returns 0 if sound, 1 + index of a faulty motor, or -1 - index of a stuck encoder.

    ``state_q`` (nq,), ``state_v`` (nv,) and ``tau`` (nj,) [N.m] are measured; ``q_set`` [rad], ``v_set`` [rad/s] and
    ``feed_forward`` [N.m], each (nj,), are the command computed from them; ``tick`` counts from the last reset.
    """
    gains, sent, share, misfit, fit, expected, torques, last, still, mean = memory.record
    q, v, rows, nj = state_q[7:], state_v[6:], torques.shape[0], torques.shape[2]
    row, found, delays = tick % rows, 0, sent.shape[1]
    follows, feedback = np.zeros(nj, dtype=np.bool_), np.zeros((2, nj))  # by the drives, at the sample
    if tick * share > 2 * _STRIDE:  # twice the window
        if misfit[1 - fit[0]].min() < _BETTER * misfit[fit[0]].min():
            fit[0] = 1 - fit[0]
        if misfit[fit[0]].min() < _BETTER * misfit[fit[0], fit[1] - 1]:
            fit[1] = 1 + misfit[fit[0]].argmin()
    for j in range(nj):
        feedback[0, j] = gains[0, j] * q[j] + gains[1, j] * v[j]
        commanded = sent[fit[0], (tick - fit[1]) % delays, j] - feedback[fit[0], j]
        commanded = min(max(commanded, -gains[2, j]), gains[2, j])
        known = tick > 0 and np.isfinite(commanded) and np.isfinite(tau[j])  # no check without a valid sample
        known = known and gains[6, j] < q[j] < gains[7, j] and abs(v[j]) < gains[8, j]
        follows[j] = known and abs(commanded - expected[j]) <= gains[9, j]
        if known:
            expected[j] += min(max(commanded - expected[j], -gains[9, j]), gains[9, j])
            torques[row, 0, j], torques[row, 1, j] = expected[j], tau[j]
        else:  # the torque of the drivers is unknown: restart from the measured torque
            expected[j] = tau[j] if np.isfinite(tau[j]) else 0.0
            torques[row, 0, j] = torques[row, 1, j] = 0.0
        still[j] = still[j] + 1 if q[j] == last[0, j] and v[j] == last[1, j] else 0
        last[0, j], last[1, j] = q[j], v[j]
        if still[j] >= rows:
            found = -1 - j
    for trial in range(1 + tick % _STRIDE, min(tick, delays) + 1, _STRIDE):
        for at in range(2):
            total, count = 0.0, 0
            for j in range(nj):
                torque = sent[at, (tick - trial) % delays, j] - feedback[at, j]
                if follows[j] and np.isfinite(torque):
                    total += abs(min(max(torque, -gains[2, j]), gains[2, j]) - tau[j]) / gains[2, j]
                    count += 1
            if count > 0:
                before = misfit[at, trial - 1] if misfit[at, trial - 1] < np.inf else total / count
                misfit[at, trial - 1] = before + share * (total / count - before)
    mean[:] = 0.0
    for i in range(rows):
        for j in range(nj):
            mean[0, j] += torques[i, 0, j]
            mean[1, j] += torques[i, 1, j]
            mean[2, j] += abs(torques[i, 1, j])
    for j in range(nj):
        for i in range(3):
            mean[i, j] /= rows
        wrong = abs(mean[1, j] - mean[0, j]) > gains[3, j]
        dead = abs(mean[0, j]) > gains[4, j] and mean[2, j] < gains[5, j]
        if (wrong or dead) and found == 0:
            found = 1 + j
        sent[0, tick % delays, j] = feed_forward[j] + gains[0, j] * q_set[j] + gains[1, j] * v_set[j]
        sent[1, tick % delays, j] = sent[0, tick % delays, j] - feedback[0, j]
    return found
