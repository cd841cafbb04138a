"""A simulated G1 behind the low-level protocol: vendor's controller, motors and remote controller; no ROS, no DDS.

The vendor's controller damps the joints until it is released. After that the drives execute the last LowCmd without a
timeout, as is assumed of the real ones, and have no torque before the first LowCmd.
"""

from typing import Any

import numpy as np

from bridge.plants.gantry import HangingRobot, StepLink
from bridge.plants.unitree.codec import joint_command
from bridge.plants.unitree.wire import LOW_CMD, LOW_STATE
from models.errors import MessageError
from models.types import JointCommand


class GantryRobot(HangingRobot):
    """The robot's side of the protocol.

    Args:
        robot: Profile of the simulated robot.
        released: Whether the vendor's controller is inactive at the start.
        options: Options of ``HangingRobot``.
    """

    def __init__(self, robot: str = "g1", *, released: bool = False, **options: Any) -> None:
        super().__init__(robot, **options)
        self.clock_offset = 0  #: Reported tick minus ``tick`` [ms]
        self.vendor = "" if released else "ai"
        self.mode_machine = 5
        self.switcher_version = "1.0.0.1"
        self.temperature, self.voltage = np.full(self.model.nj, 40), np.full(self.model.nj, 50.0)
        self.motor_error = np.zeros(self.model.nj, dtype=np.uint32)
        self.remote = bytearray(40)
        zero = np.zeros(self.model.nj)
        self._damping = JointCommand(zero, zero, zero, zero, 2.0 * self.model.kd)
        self._record = LOW_STATE.new()

    def press(self, *buttons: int) -> None:
        """Press exactly the buttons of the remote controller with these bits."""
        word = sum(1 << bit for bit in buttons)
        self.remote[2:4] = word.to_bytes(2, "little")

    def receive(self, data: bytes) -> None:
        """Handle a LowCmd; one with a wrong size, checksum or ``mode_machine`` is refused."""
        try:
            record = LOW_CMD.read(data)
        except MessageError:
            self.refused += 1
            return
        if record["mode_machine"] != self.mode_machine:
            self.refused += 1
            return
        self.accept(joint_command(record, self.model.nj))

    def drive(self) -> JointCommand:
        return self._damping if self.vendor else super().drive()

    def states(self) -> list[bytes]:
        return [self.state()]

    def state(self) -> bytes:
        """Serialised LowState of the present state."""
        sensors, record = self.read(), self._record
        motors = record["motor_state"][: self.model.nj]
        motors["mode"] = 1
        motors["q"], motors["dq"], motors["tau_est"] = sensors.q, sensors.v, sensors.tau
        motors["temperature"], motors["vol"] = self.temperature[:, None], self.voltage
        motors["motorstate"] = self.motor_error
        record["quaternion"] = self.imu_quaternion
        record["gyroscope"], record["accelerometer"] = sensors.gyro, sensors.accel
        record["tick"], record["mode_machine"] = (self.tick + self.clock_offset) % (1 << 32), self.mode_machine
        record["wireless_remote"] = np.frombuffer(bytes(self.remote), np.uint8)
        return LOW_STATE.write(record)


class DirectLink(StepLink):
    """``RobotLink`` to a robot in the same process."""

    robot: GantryRobot

    def vendor(self) -> str | None:
        """Name of the vendor's active controller; None when the robot does not answer."""
        return self.robot.vendor if self.connected else None

    def version(self) -> str:
        """Version of the motion switcher."""
        return self.robot.switcher_version if self.connected else ""

    def release(self) -> None:
        """End the vendor's controller."""
        if self.connected:
            self.robot.vendor = ""
