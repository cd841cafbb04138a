"""Drive commands during the start of a real robot (``startup.py``): stiff hold, damping, and blends between them."""

from collections.abc import Callable
from copy import deepcopy
from enum import StrEnum

import numpy as np
from pydantic.dataclasses import dataclass

from bridge.plants.base import standing_torques
from controllers.joints.joint_servo import bounded_command, damping_command, drive_torque, fade_to_damping, mean_command
from models.config import STRICT, Fraction, NonNegative, Positive
from models.robot_model import RobotModel
from models.types import JointCommand, SensorData, Vector


@dataclass(frozen=True, slots=True, config=STRICT)
class StartupConfig:
    """Schema of ``bridge/config/startup.yaml``, which has units and meanings."""

    listen_time: Positive
    answer_timeout: Positive
    release_timeout: Positive
    quiet_time: Positive
    hand_over_time: Positive
    settle_time: NonNegative
    rest_speed: Positive
    ramp_speed: Positive
    ramp_time: Positive
    ramp_error: Positive
    air_torque: Fraction
    stiffness: Positive
    damping: Positive
    load_window: Positive
    load_tolerance: Fraction
    load_time: NonNegative
    tilt_max: Positive
    hang_load_max: Fraction
    topple_tilt: Positive
    topple_time: NonNegative
    fade: Positive
    relax_height: Fraction
    relax_time: Positive


class StartState(StrEnum):
    """State of the start."""

    LISTEN = "listen"  # the robot's messages are checked; no commands
    GANTRY = "gantry"  # the operator confirms that the robot hangs; no commands
    RELEASE = "release"  # the vendor's controller is released; no commands
    DAMP = "damp"  # damping until the joints are at rest
    PREPARE = "prepare"  # slow ramp to the standing posture, in the air
    HANGING = "hanging"  # stiff hold, in the air
    HELD = "held"  # stiff hold, while lowered to the ground
    LOADED = "loaded"  # stiff hold, on its feet
    STAND = "stand"  # commands of the joint drivers
    RELAX = "relax"  # the drivers' last command fades slowly into damping
    DAMPED = "damped"  # after a stop or a fault


def stiff_hold_acts(state: StartState, elapsed: float, config: StartupConfig) -> bool:
    """Whether the stiff hold of a robot on its feet is still effective, ``elapsed`` [s] after the state began."""
    return state is StartState.LOADED or (state is StartState.STAND and elapsed < config.fade)


class StartCommands:
    """Commands of each state, ``elapsed`` [s] after it began.

    ``executed`` maps a command to the command that the robot executes; after a fault its torque fades.
    """

    def __init__(
        self, model: RobotModel, config: StartupConfig, executed: Callable[[JointCommand], JointCommand]
    ) -> None:
        self._model, self._config, self._executed = model, config, executed
        self._target = model.posture("stand").copy()
        self._kp, self._kd = config.stiffness * model.kp, config.damping * model.kd
        self._damping = damping_command(model)
        self._data = model.data()
        self._standing = np.zeros(model.nj)  # torques of the load on the feet (nj,) [N.m]
        self._from = self._target  # joint positions at the start of the ramp (nj,) [rad]
        self.ramp = config.ramp_time  #: Duration of the ramp to the standing posture [s]
        self._at_fault = self._last = JointCommand.torque(np.zeros(model.nj))

    def begin_ramp(self, q: Vector) -> None:
        """Begin the ramp at joint positions (nj,) [rad]."""
        self._from = q.copy()
        self.ramp = max(float(np.abs(self._target - q).max()) / self._config.ramp_speed, self._config.ramp_time)

    def fade_from(self, torque: Vector) -> None:
        """Set the joint torques (nj,) [N.m] from which a stop fades."""
        self._at_fault = JointCommand.torque(torque)

    def keep_last(self) -> None:
        """Copy the drivers' last command, which they overwrite in every tick."""
        self._last = deepcopy(self._last)

    def reference(self, state: StartState, elapsed: float) -> Vector:
        """Reference position of the stiff hold (nj,) [rad]."""
        if state is not StartState.PREPARE:
            return self._target
        u = min(elapsed / self.ramp, 1.0)
        return self._from + u * u * (3.0 - 2.0 * u) * (self._target - self._from)

    def command(
        self, state: StartState, elapsed: float, load: float, sensors: SensorData, driver: JointCommand
    ) -> JointCommand:
        """Command of a state that has commands.

        ``load`` is the load on the feet relative to the weight [-], ``driver`` the command of the joint drivers.
        """
        model, fading = self._model, stiff_hold_acts(state, elapsed, self._config)
        self._standing[:] = 0.0
        if state in (StartState.HELD, StartState.LOADED) or fading:
            self._standing += min(max(load, 0.0), 1.0) * standing_torques(model, sensors.q, self._data)
        if state is StartState.STAND:
            given = self._last = self._faded(elapsed, driver) if fading else driver
        elif state is StartState.RELAX:
            given = mean_command(model, self._last, self._damping, min(elapsed / self._config.relax_time, 1.0))
        elif state is StartState.DAMP:
            given = self._damping
        elif state is StartState.DAMPED:
            return fade_to_damping(model, self._at_fault, elapsed)
        else:
            share = self._config.air_torque if state in (StartState.PREPARE, StartState.HANGING) else 1.0
            executed = self._executed(self._held(state, elapsed))  # its gains keep the torque within the bound
            given = bounded_command(model, executed, sensors.q, sensors.v, share)
        self.fade_from(drive_torque(model, self._executed(given), sensors.q, sensors.v))
        return given

    def _held(self, state: StartState, elapsed: float) -> JointCommand:
        """Stiff hold; in the first third of the ramp it is blended in from damping."""
        held = JointCommand(
            self.reference(state, elapsed), np.zeros(self._model.nj), self._standing, self._kp, self._kd
        )
        if state is not StartState.PREPARE:
            return held
        return mean_command(self._model, self._damping, held, min(3.0 * elapsed / self.ramp, 1.0))

    def _faded(self, elapsed: float, driver: JointCommand) -> JointCommand:
        """Blend from the stiff hold to the drivers' command."""
        u = elapsed / self._config.fade
        return mean_command(self._model, self._held(StartState.STAND, elapsed), driver, u * u * (3.0 - 2.0 * u))
