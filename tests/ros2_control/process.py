"""The robot's side of ros2_control as a process in real time: ``ControlledRobot`` behind rclpy.

    python -m tests.ros2_control.process rclpy INTERFACE DOMAIN ROBOT OPTIONS [SPEED]

OPTIONS are those of the plant. Lines on the standard input are calls, as for ``benchmarks/graph/unitree_side.py``.
"""

import sys
import time
from typing import Any

from rclpy.qos import QoSProfile

from benchmarks.graph.unitree_side import Program, TimedSide
from bridge.launch.hardware import PROFILES
from bridge.plants.config import read_options
from bridge.plants.participant import ignore, join, take_all
from bridge.plants.ros2_control.commands import command_codec
from bridge.plants.ros2_control.config import COMMAND, STATE
from bridge.plants.ros2_control.link import TYPES
from bridge.plants.ros2_control.simulated import ControlledRobot
from models.nodes.interfaces import interface


class ControlSide(TimedSide):
    """Controller manager, broadcasters and command controller by rclpy, with the QoS of ros2_controllers."""

    def __init__(self, robot: ControlledRobot, domain: int) -> None:
        super().__init__(robot)
        config, topics = robot.settings, robot.settings.topic_of
        kind = command_codec(robot.model, config, "").kind
        self._listing = interface("controller_manager_msgs", "srv", "ListControllers")
        self._state = interface("controller_manager_msgs", "msg", "ControllerState")
        _, node = join(domain, "controller_manager")
        depth = QoSProfile(depth=1)
        self._publishers = {
            source: node.create_publisher(TYPES[source], topics[source], depth) for source in robot.sources
        }
        self._commands = node.create_subscription(kind, topics[COMMAND], ignore, depth, raw=True)
        self._service = node.create_service(self._listing, f"{config.manager}/list_controllers", ignore)
        self._sensor: Any = None
        if config.command == "feedback":
            sensor = interface("linear_feedback_controller_msgs", "msg", "Sensor")
            self._sensor = node.create_publisher(sensor, topics[STATE], depth)
            self._message = sensor()
            self._message.joint_state.name = list(robot.moving_joints)

    def exchange(self) -> None:
        for source, data in self._robot.states():
            if self.connected:
                self._publishers[source].publish(data)
        self.published = time.monotonic()
        if self._sensor is not None and self._robot.tick % 100 == 0:
            self._sensor.publish(self._message)
        with self._service.handle:
            request, header = self._service.handle.service_take_request(self._listing.Request)
        if header is not None and request is not None:
            response = self._listing.Response()
            response.controller = [
                self._state(name=name, state=state) for name, state in self._robot.controllers.items()
            ]
            self._service.send_response(response, header)

    def take(self) -> None:
        for data in take_all(self._commands):
            self.receive(data, self.published)


class ControlProgram(Program):
    """With the calls of this robot."""

    def torque(self) -> list[float]:
        """Torques that the drives have now [N.m]."""
        command = self.robot.drive()
        return [round(float(value), 3) for value in command.tau]

    def controller(self, name: str, state: str) -> bool:
        """Set the state of a controller."""
        self.robot.controllers[name] = state
        return True


if __name__ == "__main__":
    _, _, in_domain, name, options, *speeds = sys.argv[1:]
    laws = PROFILES.get(name, name)
    ControlProgram(
        ControlledRobot(name, laws=laws, settings=read_options(options)),
        lambda robot: ControlSide(robot, int(in_domain)),
        *map(float, speeds),
    ).run()
