"""Connection to a Unitree robot: a separate participant in the robot's DDS domain, polled, without an executor.

Unitree's services are two topics each: a request and a response with the same id. ``motion_switcher`` names the active
controller of the robot (``CHECK``), ends it (``RELEASE``), and names the version of its functions (``VERSION``).
"""

import json
import time
from math import inf
from typing import Any, Protocol

from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.utilities import try_shutdown

from bridge.plants.hardware import real_robot
from bridge.plants.low_level import LowLink
from bridge.plants.participant import QUEUE, SENSOR, ignore, join, reachable, take, take_all
from models.errors import MessageError
from models.nodes.interfaces import interface

VERSION, CHECK, RELEASE = 1, 1001, 1003  #: Functions of the motion switcher
COMMAND = "lowcmd"  #: Topic of the commands
SWITCHER = "api/motion_switcher"  #: Its topics are ``request`` and ``response`` below this name


class RobotLink(LowLink, Protocol):
    """Messages of one robot: serialised LowStates."""

    def version(self) -> str:
        """Version of the motion switcher, empty while unknown; it is received by ``vendor``."""


class DdsLink(RobotLink):
    """The robot over rclpy, in the robot's domain; its transports are those of this process.

    Raises ``MessageError`` when the types of ``unitree_hg`` and ``unitree_api`` are not built.
    """

    def __init__(self, domain: int) -> None:
        state, command = (interface("unitree_hg", "msg", name) for name in ("LowState", "LowCmd"))
        self._request_type, response = (interface("unitree_api", "msg", name) for name in ("Request", "Response"))
        self._context, self._node = join(domain, "poise_unitree")
        node, reliable = self._node, QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
        self._states = node.create_subscription(state, "lowstate", ignore, SENSOR, raw=True)
        self._echo = node.create_subscription(command, COMMAND, ignore, SENSOR, raw=True)
        self._responses = node.create_subscription(response, f"{SWITCHER}/response", ignore, QoSProfile(depth=QUEUE))
        self._commands = node.create_publisher(command, COMMAND, reliable)
        self._requests = node.create_publisher(self._request_type, f"{SWITCHER}/request", reliable)
        self._id = time.monotonic_ns()
        self._pending = self._asked_version = 0  # id of the last Check, and of the last request for the version
        self._config = real_robot()
        self._asked = self._looked = self._released = -inf
        self._vendor: str | None = None
        self._version = ""

    def take(self) -> list[bytes]:
        return take_all(self._states)

    def send(self, data: bytes) -> None:
        self._commands.publish(data)

    def commands(self) -> list[bytes]:
        return take_all(self._echo)

    def vendor(self) -> str | None:
        now = time.monotonic()
        if now - self._looked < self._config.look_period:
            return self._vendor
        self._looked = now
        while (response := take(self._responses)) is not None:
            if response.header.identity.id == self._pending:
                self._vendor = _name_of(response)
            elif response.header.identity.id == self._asked_version and not response.header.status.code:
                self._version = str(response.data)
        if now - self._asked >= self._config.ask_period and self._reachable:
            self._asked = now
            self._pending = self._call(CHECK)
            if not self._version:
                self._asked_version = self._call(VERSION)
        return self._vendor

    def version(self) -> str:
        return self._version

    def release(self) -> None:
        now = time.monotonic()
        if now - self._released >= self._config.ask_period and self._reachable:
            self._released = now
            self._call(RELEASE)

    @property
    def _reachable(self) -> bool:
        return reachable(self._node, self._requests, f"{SWITCHER}/response")

    def _call(self, function: int) -> int:
        self._id += 1
        request = self._request_type()
        request.header.identity.id, request.header.identity.api_id = self._id, function
        request.parameter = "{}"
        self._requests.publish(request)
        return self._id

    def close(self) -> None:
        self._node.destroy_node()
        try_shutdown(context=self._context)


def _name_of(response: Any) -> str:
    """Name in a response to Check; ``MessageError`` for one that has none."""
    if response.header.status.code:
        raise MessageError(f"{SWITCHER}: error {response.header.status.code}")
    try:
        return str(json.loads(response.data).get("name", ""))
    except (ValueError, AttributeError) as error:
        raise MessageError(f"{SWITCHER}: response {response.data[:80]!r} is not an object of JSON") from error
