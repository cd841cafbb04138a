"""Finds motors that do not give the torque they are told, and encoders that are stuck."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from controllers.kernels_joint_monitor import watch_joints
from models.config import STRICT, default_config
from models.robot_model import RobotModel
from models.types import JointCommand, RobotState

Positive = Annotated[float, Field(gt=0.0)]


@dataclass(frozen=True, slots=True, config=STRICT)
class JointMonitorConfig:
    """When a joint is at fault.

    Attributes:
        window: Time over which torques are averaged, and for which a stuck encoder says the same [s].
        error: Error of the mean torque that is a fault, in shares of the motor's largest one [-].
        told: Mean torque told to a motor that gives nothing, likewise [-].
        nothing: Mean size of a torque that counts as nothing, likewise [-].
        offset: Added to the first two, and an eighth of it to the third [N.m].
        margin: Distance from a joint's limit below which its torques tell nothing [rad].
        grace: Time after a start in which nothing is judged [s].
    """

    window: Annotated[float, Field(gt=0.0, le=1.0)]
    error: Positive
    told: Positive
    nothing: Positive
    offset: Positive
    margin: Annotated[float, Field(ge=0.0)]
    grace: Annotated[float, Field(ge=0.0)]


class JointMonitor:
    r"""Compares what the drivers measure with what they were told.

    .. math::
        \tau_{told} = \tau_{ff} + k_p (q_{set} - q) + k_d (v_{set} - v), \quad
        \tau_{exp} \mathrel{+}= [\tau_{told} - \tau_{exp}]_{\pm \dot\tau_{max} \Delta t}, \quad
        |\overline{\tau} - \overline{\tau_{exp}}| > error\;\tau_{max} + offset

    is a motor at fault, and sooner one that gives nothing though it is told to. The limits of torque and of its rate
    are those of the drivers; near a limit of position or velocity, where they fade torques, nothing is judged. What is
    left is the way of a command to the drivers, which is why the first bound is wide. An encoder
    is at fault when position and velocity have not changed in the last bit for ``window``: those of a robot whose
    profile gives its velocities noise always do.

    Args:
        model: The robot, with the gains of its drivers.
        period: Between two ticks [s].
        config: When a joint is at fault; the packaged default when None.

    Attributes:
        fault: One sentence that names joint and figures; empty while all is well, kept until ``reset``.
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
        """Forget what was found; judge again after ``grace``."""
        self.fault = ""
        self._tick = 0
        self._grace = round(self.config.grace / self._period)
        self._expected[:] = self._torques[:] = 0.0
        self._still[:] = 0
        self._last[:] = np.nan

    def step(self, state: RobotState, command: JointCommand) -> None:
        """One tick.

        Args:
            state: Measured joint positions, velocities and torques.
            command: Answer to them, which the drivers have in the next tick.
        """
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
