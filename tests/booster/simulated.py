"""A simulated robot behind Booster's low-level protocol: its modes, motors and remote controller; no ROS, no DDS.

In mode ``prepare`` its own controller holds the standing posture, in ``damping`` it damps. In ``custom`` the drives
execute the last LowCmd for ever, as the real ones are assumed to do, and have no torque before the first.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin

from bridge.plants.booster.codec import (
    BUTTONS,
    CUSTOM,
    DAMPING,
    MODES,
    PREPARE,
    REMOTE,
    BoosterCodec,
    Stamped,
    low_state,
    pack,
    read_config,
)
from bridge.plants.gantry import STEP, HangingRobot, StepLink
from bridge.plants.hardware import RobotClock, real_robot
from models.constants import NANOSECONDS
from models.errors import MessageError
from models.types import JointCommand

EPOCH_S = 1_700_000_000  #: Stamp of tick 0 [s]
STIFFNESS, DAMPING_FACTOR = 2.0, 2.0  #: Of the robot's own controller, as factors on the profile's gains [-]


class BoosterRobot(HangingRobot):
    """The robot's side.

    Args:
        robot: Profile of the simulated robot.
        settings: Options of the plant.
        options: Of ``HangingRobot``.
    """

    def __init__(self, robot: str, *, settings: Mapping[str, Any] | None = None, **options: Any) -> None:
        config = read_config(settings or {})
        super().__init__(robot, rate=config.rate, **options)
        self.mode = PREPARE
        self.refused_mode: int | None = None  #: Mode that it does not change to
        self.clock_offset = 0  #: Of the stamps from ``tick`` [ms]
        self.temperature = np.full(self.model.nj, 40)
        self.motor_error = np.zeros(self.model.nj, dtype=np.uint32)
        self.pressed: tuple[str, ...] = ()  #: Buttons of the remote controller
        self.remote_event = 0  #: Of its messages
        self.accel_scale = 1.0  #: Of the accelerometer's unit [-]
        self._count = 0  # LowStates so far
        self._codec = BoosterCodec(self.model, config, RobotClock(1.0 / config.rate, real_robot().gap_max))
        self._motors = np.array([config.joints.index(name) for name in self.model.joint_names])
        self._record = np.zeros(1, low_state(self.model.nj))[0]
        self._record["parallel_size"] = self._record["serial_size"] = self.model.nj
        zero, model = np.zeros(self.model.nj), self.model
        self._damping = JointCommand(zero, zero, zero, zero, DAMPING_FACTOR * model.kd)
        stand = model.posture("stand")
        self._stand = JointCommand(stand, zero, zero, STIFFNESS * model.kp, DAMPING_FACTOR * model.kd)

    def receive(self, data: bytes) -> None:
        """A LowCmd from the network, which the drives execute in mode ``custom``."""
        try:
            self.accept(self._codec.decode_command(data))
        except MessageError:
            self.refused += 1

    def drive(self) -> JointCommand:
        if self.mode == CUSTOM:
            return super().drive()
        return self._damping if self.mode == DAMPING else self._stand

    def change_mode(self, mode: int) -> None:
        """A request of a client."""
        if mode != self.refused_mode:
            self.mode = mode

    def states(self) -> list[Stamped]:
        time = EPOCH_S * NANOSECONDS + round((self.tick + self.clock_offset) * STEP * NANOSECONDS)
        self._count += 1
        return [Stamped(False, self.remote()), Stamped(True, self.state(), time, self._count)]

    def state(self) -> bytes:
        """The present LowState, serialised."""
        sensors, record = self.read(), self._record
        motors = record["serial"]
        for name, values in (("q", sensors.q), ("dq", sensors.v), ("tau_est", sensors.tau)):
            motors[name][self._motors] = values
        motors["temperature"][self._motors] = self.temperature
        motors["reserve"][self._motors, 0] = self.motor_error
        record["parallel"] = motors
        quaternion = pin.Quaternion(np.roll(self.imu_quaternion, -1))
        record["rpy"] = pin.rpy.matrixToRpy(quaternion.matrix())
        record["gyro"], record["acc"] = sensors.gyro, self.accel_scale * sensors.accel
        return pack(record)

    def remote(self) -> bytes:
        """The present RemoteControllerState, serialised."""
        record = np.zeros(1, REMOTE)[0]
        record["event"] = self.remote_event
        record["buttons"] = [name in self.pressed for name in BUTTONS]
        return pack(record)


class DirectBoosterLink(StepLink):
    """A robot in the same process, as ``BoosterLink`` of the plant."""

    robot: BoosterRobot
    remote_served = True  #: Whether a program of the robot publishes the states of its remote controller

    def vendor(self) -> str | None:
        """Name of the robot's mode, empty for ``custom``; None when the robot does not answer."""
        if not self.connected:
            return None
        return "" if self.robot.mode == CUSTOM else MODES[self.robot.mode]

    def release(self) -> None:
        """Request mode ``custom``."""
        self._change(CUSTOM)

    def damp(self) -> None:
        """Request the robot's own damping."""
        self._change(DAMPING)

    def _change(self, mode: int) -> None:
        if self.connected:
            self.robot.change_mode(mode)
