"""Finds motors that do not give the commanded torque, and encoders that are stuck."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from controllers.safety.kernels_joint_monitor import watch_joints
from models.config import STRICT, default_config
from models.robot_model import RobotModel
from models.types import JointCommand, RobotState

Positive = Annotated[float, Field(gt=0.0)]


@dataclass(frozen=True, slots=True, config=STRICT)
class JointMonitorConfig:
    """Thresholds of a joint fault."""

    window: Annotated[float, Field(gt=0.0, le=1.0)]  # of the mean torques, and of a stuck encoder [s]
    error: Positive  # of the mean torque at a fault, over the motor's largest one [-]
    told: Positive  # mean commanded torque of a motor without output, likewise [-]
    nothing: Positive  # mean torque that counts as none, likewise [-]
    offset: Positive  # added to the first two, and an eighth of it to the third [N.m]
    margin: Annotated[float, Field(ge=0.0)]  # distance from a joint's limit within which no torque is judged [rad]
    grace: Annotated[float, Field(ge=0.0)]  # time after a start without a judgement [s]


class JointMonitor:
    r"""Compares the measurements of the drivers with their commands.

    .. math::
        \tau_{told} = \tau_{ff} + k_p (q_{set} - q) + k_d (v_{set} - v), \quad
        \tau_{exp} \mathrel{+}= [\tau_{told} - \tau_{exp}]_{\pm \dot\tau_{max} \Delta t}, \quad
        |\overline{\tau} - \overline{\tau_{exp}}| > error\;\tau_{max} + offset

    is a motor at fault, and sooner one that gives no torque at a command. The limits of torque and of its rate are
    those of the drivers; near a limit of position or velocity, where they fade torques, nothing is judged. The first
    bound is wide because of the delay of a command to the drivers. An encoder is at fault when position and velocity
    have not changed in the last bit for ``window``: the noise of the velocities of the profile changes them at every
    sample.

    Args:
        model: The robot, with the gains of its drivers.
        period: Between two ticks [s].
        config: The packaged default when None.

    Attributes:
        fault: One sentence that names joint and figures, kept until ``reset``; empty without one.
    """

    def __init__(self, model: RobotModel, period: float = 0.001, config: JointMonitorConfig | None = None) -> None:
        self.model = model
        self.config = config or default_config(JointMonitorConfig, "controllers", "joint_monitor")
        nj, self._period = model.nj, period
        self._noisy = model.profile.sensors.encoders.velocity_noise > 0.0
        rows = max(round(self.config.window / period), 1)
        given, largest = self.config, model.tau_max
        bounds = given.error * largest, given.told * largest, given.nothing * largest
        offsets = given.offset * np.array([[1.0], [1.0], [0.125]])
        inside = model.q_lower + given.margin, model.q_upper - given.margin, model.v_max
        rate = period * model.tau_rate_max
        self._gains = np.vstack([model.kp, model.kd, largest, np.array(bounds) + offsets, *inside, rate])  # (10, nj)
        self._expected = np.zeros(nj)
        self._command, self._torques = np.zeros((3, nj)), np.zeros((rows, 2, nj))
        self._last = np.full((2, nj), np.nan)
        self._still, self._mean = np.zeros(nj, dtype=np.int64), np.zeros((3, nj))
        self.reset()
        self._watch(np.zeros(nj), np.zeros(nj), np.zeros(nj))  # compiles
        self.reset()

    def reset(self) -> None:
        """Clear the fault; judge again after ``grace``."""
        self.fault = ""
        self._tick = 0
        self._grace = round(self.config.grace / self._period)
        self._expected[:] = self._torques[:] = 0.0
        self._still[:] = 0
        self._last[:] = np.nan

    def step(self, state: RobotState, command: JointCommand) -> None:
        """One tick: the measured state, and the command that answers it, which the drivers have in the next tick."""
        if self._tick > 0 and not self.fault:
            found = self._watch(state.q[7:], state.v[6:], state.tau)
            if (found > 0 or (found < 0 and self._noisy)) and self._tick > self._grace:
                self.fault = self._describe(found, state)
        self._tick += 1
        self._command[0], self._command[1], self._command[2] = command.q, command.v, command.tau

    def _watch(self, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> int:
        found: int = watch_joints(
            q,
            v,
            tau,
            self._command,
            self._gains,
            self._tick,
            self._expected,
            self._torques,
            self._last,
            self._still,
            self._mean,
        )
        return found

    def _describe(self, found: int, state: RobotState) -> str:
        joint = abs(found) - 1
        name = self.model.joint_names[joint]
        if found < 0:
            return f"encoder of '{name}' stuck at {state.q[7 + joint]:.4f} rad for {self.config.window:g} s"
        told, given, _ = self._mean[:, joint]
        return f"motor of '{name}' gives {given:.1f} N.m instead of {told:.1f} N.m (means of {self.config.window:g} s)"
