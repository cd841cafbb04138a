"""Finds motors that do not give the commanded torque, and encoders that are stuck."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic.dataclasses import dataclass

from models.config import STRICT, NonNegative, Positive, Share, default_config
from models.numerics.compiled import njit
from models.numerics.unboxed import Unboxed, unbox
from models.robot_model import RobotModel
from models.types import JointCommand, RobotState

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, config=STRICT)
class JointMonitorConfig:
    """Thresholds of a joint fault."""

    window: Share  # of the mean torques, and of a stuck encoder [s]
    error: Positive  # of the mean torque at a fault, over the motor's largest one [-]
    commanded: Positive  # mean commanded torque of a motor without output, likewise [-]
    no_output: Positive  # mean torque that counts as none, likewise [-]
    offset: Positive  # added to the first two, and an eighth of it to the third [N.m]
    margin: NonNegative  # distance from a joint's limit within which no torque is judged [rad]
    grace: NonNegative  # time after a start without a judgement [s]


class _Memory(NamedTuple):
    """Constants and state of ``JointMonitor``."""

    #: kp, kd, largest torque, allowed error of the mean torque; of a motor without output: least commanded torque,
    #: largest torque given; lowest and highest position and fastest velocity at which the drivers follow commands;
    #: largest change of a torque in a tick (10, nj)
    gains: Array
    command: Array  # setpoints of position, velocity and torque that the drivers have (3, nj)
    expected: Array  # torques (nj,) [N.m]
    torques: Array  # expected and given in the last ticks (rows, 2, nj) [N.m]
    last: Array  # positions and velocities (2, nj)
    still: NDArray[np.int64]  # ticks for which both have been the same (nj,)
    mean: Array  # of the torques expected and given, and of the size of the latter (3, nj) [N.m]


class JointMonitor:
    r"""Compares the measurements of the drivers with their commands.

    .. math::
        \tau_{cmd} = \tau_{ff} + k_p (q_{set} - q) + k_d (v_{set} - v), \quad
        \tau_{exp} \mathrel{+}= [\tau_{cmd} - \tau_{exp}]_{\pm \dot\tau_{max} \Delta t}, \quad
        |\overline{\tau} - \overline{\tau_{exp}}| > error\;\tau_{max} + offset

    is a motor at fault, and sooner one that gives no torque at a command. The limits of torque and of its rate are
    those of the drivers; near a limit of position or velocity, where they fade torques, nothing is judged. The first
    bound is wide because of the delay of a command to the drivers. An encoder is at fault when position and velocity
    have not changed in the last bit for ``window``: the noise of the velocities of the profile changes them at every
    sample.

    ``period`` is that of the tick [s]; ``fault``, kept until ``reset``, names joint and figures in one sentence.
    """

    def __init__(self, model: RobotModel, period: float = 0.001, config: JointMonitorConfig | None = None) -> None:
        self.model = model
        self.config = config or default_config(JointMonitorConfig, "controllers", "joint_monitor")
        nj, self._period = model.nj, period
        self._noisy = model.profile.sensors.encoders.velocity_noise > 0.0
        rows = max(round(self.config.window / period), 1)
        given, largest = self.config, model.tau_max
        bounds = given.error * largest, given.commanded * largest, given.no_output * largest
        offsets = given.offset * np.array([[1.0], [1.0], [0.125]])
        inside = model.q_lower + given.margin, model.q_upper - given.margin, model.v_max
        rate = period * model.tau_rate_max
        gains = np.vstack([model.kp, model.kd, largest, np.array(bounds) + offsets, *inside, rate])
        command, torques, last, mean = (np.zeros(shape) for shape in ((3, nj), (rows, 2, nj), (2, nj), (3, nj)))
        self._memory = _Memory(gains, command, np.zeros(nj), torques, last, np.zeros(nj, dtype=np.int64), mean)
        self._unboxed, self._command = unbox(self._memory), tuple(command)
        self.reset()
        _watch_joints(np.zeros(nj + 7), np.zeros(nj + 6), np.zeros(nj), 0, self._unboxed)  # compiles
        self.reset()

    def reset(self) -> None:
        """Clear the fault; judge again after ``grace``."""
        self.fault = ""
        self._tick = 0
        self._grace = round(self.config.grace / self._period)
        memory = self._memory
        memory.expected[:] = memory.torques[:] = 0.0
        memory.still[:] = 0
        memory.last[:] = np.nan

    def step(self, state: RobotState, command: JointCommand) -> None:
        """One tick: the measured state, and the command that answers it, which the drivers have in the next tick."""
        if self._tick > 0 and not self.fault:
            found = _watch_joints(state.q, state.v, state.tau, self._tick, self._unboxed)
            if (found > 0 or (found < 0 and self._noisy)) and self._tick > self._grace:
                self.fault = self._describe(found, state)
        self._tick += 1
        q, v, tau = self._command
        q[:], v[:], tau[:] = command.q, command.v, command.tau

    def _describe(self, found: int, state: RobotState) -> str:
        joint = abs(found) - 1
        name = self.model.joint_names[joint]
        if found < 0:
            return f"encoder of '{name}' stuck at {state.q[7 + joint]:.4f} rad for {self.config.window:g} s"
        expected, given, _ = self._memory.mean[:, joint]
        figures = f"{given:.1f} N.m instead of {expected:.1f} N.m (means of {self.config.window:g} s)"
        return f"motor of '{name}' gives {figures}"


@njit(cache=True)
def _watch_joints(state_q: Array, state_v: Array, tau: Array, tick: int, memory: Unboxed[_Memory]) -> int:
    """One tick of every joint: 0 when all is well, 1 + the index of a motor at fault, or -1 - that of an encoder.

    ``state_q`` (nq,), ``state_v`` (nv,) and ``tau`` [N.m] (nj,) are measured.
    """
    gains, command, expected, torques, last, still, mean = memory.record
    q, v = state_q[7:], state_v[6:]
    rows, nj = torques.shape[0], torques.shape[2]
    row, found = tick % rows, 0
    for j in range(nj):
        commanded = command[2, j] + gains[0, j] * (command[0, j] - q[j]) + gains[1, j] * (command[1, j] - v[j])
        commanded = min(max(commanded, -gains[2, j]), gains[2, j])
        known = np.isfinite(commanded) and np.isfinite(tau[j])  # a missing sample is no evidence
        known = known and gains[6, j] < q[j] < gains[7, j] and abs(v[j]) < gains[8, j]
        if known:
            expected[j] += min(max(commanded - expected[j], -gains[9, j]), gains[9, j])
            torques[row, 0, j], torques[row, 1, j] = expected[j], tau[j]
        else:  # the drivers' torque is unknown there: begin again from the measured one
            expected[j] = tau[j] if np.isfinite(tau[j]) else 0.0
            torques[row, 0, j] = torques[row, 1, j] = 0.0
        still[j] = still[j] + 1 if q[j] == last[0, j] and v[j] == last[1, j] else 0
        last[0, j], last[1, j] = q[j], v[j]
        if still[j] >= rows:
            found = -1 - j
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
    return found
