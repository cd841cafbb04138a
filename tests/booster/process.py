"""The robot's side as a process in real time: ``BoosterRobot`` behind Booster's own SDK, or behind rclpy.

    python -m tests.booster.process sdk|ros INTERFACE DOMAIN ROBOT OPTIONS [SPEED]

``sdk`` is the package ``far-booster-sdk``: Booster's C++ SDK with its own Fast DDS publishes LowState and receives
LowCmd. It offers no server of the service LocoApi and no remote controller, and its Fast DDS and that of rclpy do not
work in one process: ``tests/booster/service.py`` makes these, for both sides. OPTIONS are those of the plant. Lines on
the standard input are calls, as for ``benchmarks/graph/unitree_side.py``.
"""

import os
import select
import subprocess
import sys
import time
from collections import deque
from typing import Any

import numpy as np

from benchmarks.graph.unitree_side import Program, TimedSide
from bridge.launch.robot_network import interface_address
from bridge.plants.booster.codec import low_cmd, low_state, pack, unpack
from bridge.plants.config import read_options
from tests.booster.simulated import BoosterRobot


class RosSide(TimedSide):
    """The robot's side by rclpy."""

    def __init__(self, robot: BoosterRobot, where: str, domain: int) -> None:
        super().__init__(robot)
        words = [sys.executable, "-m", "tests.booster.service", str(domain)]
        self._service = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self._reported: tuple[object, ...] = ()
        self._open(where, domain)

    def _open(self, where: str, domain: int) -> None:
        """Create publisher and subscription of the low level."""
        from bridge.plants.booster.link import COMMAND, STATE
        from bridge.plants.participant import SENSOR, ignore, join
        from models.nodes.interfaces import interface

        _, node = join(domain, "robot")
        state, command = (interface("booster_interface", "msg", name) for name in ("LowState", "LowCmd"))
        self._states = node.create_publisher(state, STATE, SENSOR)
        self._commands = node.create_subscription(command, COMMAND, ignore, SENSOR, raw=True)

    def _publish(self, data: bytes) -> None:
        self._states.publish(data)

    def _received(self) -> list[bytes]:
        from bridge.plants.participant import take_all

        return take_all(self._commands)

    def exchange(self) -> None:
        state, robot = self._robot.state(), self._robot
        if self.connected:
            self._publish(state)
            self.published = time.monotonic()
        self._exchange_service(robot)

    def _exchange_service(self, robot: BoosterRobot) -> None:
        """Report mode and buttons to the service, and execute its requests: lines of numbers and names."""
        pipe_in, pipe_out = self._service.stdin, self._service.stdout
        assert pipe_in is not None and pipe_out is not None
        if (robot.mode, robot.pressed) != self._reported:
            self._reported = robot.mode, robot.pressed
            pipe_in.write(" ".join([str(robot.mode), *robot.pressed]).encode() + b"\n")
            pipe_in.flush()
        if select.select([pipe_out], [], [], 0.0)[0] and (lines := os.read(pipe_out.fileno(), 4096)):
            for mode in lines.split():
                robot.change_mode(int(mode))

    def take(self) -> None:
        for data in self._received():
            self.receive(data, self.published)


class SdkSide(RosSide):
    """States and commands by Booster's SDK."""

    def _open(self, where: str, domain: int) -> None:
        from booster_robotics_sdk import booster_robotics_sdk_python as sdk

        sdk.ChannelFactory.Instance().Init(domain, interface_address(where))
        nj = self._robot.model.nj
        arrived = self._arrived = deque[Any](maxlen=100)
        self._reader = sdk.B1LowCmdSubscriber(lambda message: arrived.append(sdk.LowCmd(message)))  # it uses it again
        self._writer = sdk.B1LowStatePublisher()
        for channel in (self._reader, self._writer):
            channel.InitChannel()
        self._layout, self._record = low_state(nj), np.zeros(1, low_cmd(nj))[0]
        self._state, self._imu, self._motors = sdk.LowState(), sdk.ImuState(), [sdk.MotorState() for _ in range(nj)]

    def _publish(self, data: bytes) -> None:
        record = unpack("low_state", data, self._layout)
        for motor, values in zip(self._motors, record["serial"], strict=True):
            motor.q, motor.dq, motor.tau_est = (float(values[name]) for name in ("q", "dq", "tau_est"))
            motor.temperature = int(values["temperature"])
        self._imu.rpy, self._imu.gyro, self._imu.acc = (record[name].tolist() for name in ("rpy", "gyro", "acc"))
        self._state.imu_state = self._imu
        self._state.motor_state_serial = self._state.motor_state_parallel = self._motors
        self._writer.Write(self._state)

    def _received(self) -> list[bytes]:
        found, record = [], self._record
        while self._arrived:
            message = self._arrived.popleft()
            motors = message.motor_cmd
            record["cmd_type"], record["size"] = message.cmd_type.value, len(motors)
            for name in ("q", "dq", "tau", "kp", "kd", "weight"):
                record["motors"][name] = [getattr(motor, name) for motor in motors]
            found.append(pack(record))
        return found


class BoosterProgram(Program):
    """With the calls of this robot."""

    def press(self, *buttons: str) -> bool:  # type: ignore[override]
        """Press buttons of the remote controller."""
        self.robot.pressed = buttons
        return True

    def mode(self) -> int:
        """Mode of the robot."""
        return int(self.robot.mode)


if __name__ == "__main__":
    kind, interface_name, in_domain, name, options, *speeds = sys.argv[1:]
    side = {"sdk": SdkSide, "ros": RosSide}[kind]
    BoosterProgram(
        BoosterRobot(name, settings=read_options(options)),
        lambda robot: side(robot, interface_name, int(in_domain)),
        *map(float, speeds),
    ).run()
