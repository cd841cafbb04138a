"""Connection to a Booster robot: a separate participant in the robot's DDS domain, polled, without an executor.

Booster's services are two topics each: a request and a response with the same uuid. ``LocoApi`` names the mode of the
robot (``GET_MODE``) and changes it (``CHANGE_MODE``). LowCmds are executed in mode ``CUSTOM`` alone.
"""

import json
import time
import uuid
from math import inf
from typing import Any, Protocol

from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.utilities import try_shutdown

from bridge.plants.booster.codec import CUSTOM, DAMPING, MODES, Stamped
from bridge.plants.hardware import real_robot
from bridge.plants.low_level import LowLink
from bridge.plants.participant import SENSOR, ignore, join, reachable, take, take_all, take_stamped
from models.errors import MessageError
from models.nodes.interfaces import interface

STATE, COMMAND, REMOTE_STATE, SERVICE = "low_state", "joint_ctrl", "remote_controller_state", "LocoApiTopic"
CHANGE_MODE, GET_MODE = 2000, 2017  #: Functions of the service


class BoosterLink(LowLink, Protocol):
    """Messages of one robot: ``Stamped``. ``vendor`` names its mode, empty for ``CUSTOM``."""

    def damp(self) -> None:
        """Request the robot's own damping."""


class DdsBoosterLink(BoosterLink):
    """The robot over rclpy, in the robot's domain; its transports are those of this process.

    Its mode is asked for every ``mode_period`` [s]. Raises ``MessageError`` when the types of ``booster_interface`` and
    ``booster_msgs`` are not built.
    """

    def __init__(self, domain: int, mode_period: float) -> None:
        state, command, remote = (
            interface("booster_interface", "msg", name) for name in ("LowState", "LowCmd", "RemoteControllerState")
        )
        self._request, response = (interface("booster_msgs", "msg", name) for name in ("RpcReqMsg", "RpcRespMsg"))
        self._context, self._node = join(domain, "poise_booster")
        node, reliable = self._node, QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
        self._states = node.create_subscription(state, STATE, ignore, SENSOR, raw=True)
        self._remotes = node.create_subscription(remote, REMOTE_STATE, ignore, SENSOR, raw=True)
        self._echo = node.create_subscription(command, COMMAND, ignore, SENSOR, raw=True)
        self._commands = node.create_publisher(command, COMMAND, reliable)
        self._responses = node.create_subscription(response, f"{SERVICE}Resp", ignore, SENSOR)
        self._requests = node.create_publisher(self._request, f"{SERVICE}Req", reliable)
        self._config, self._mode_period = real_robot(), mode_period
        self._asked = self._changed = self._looked = self._answered = -inf
        self._pending = ""  # uuid of the last request for the mode
        self._mode = CUSTOM

    def take(self) -> list[Stamped]:
        remotes = [Stamped(False, data) for data in take_all(self._remotes)]
        return [*remotes, *(Stamped(True, *each) for each in take_stamped(self._states))]

    def send(self, data: bytes) -> None:
        self._commands.publish(data)

    def commands(self) -> list[bytes]:
        return take_all(self._echo)

    def vendor(self) -> str | None:
        now = time.monotonic()
        if now - self._looked >= self._config.look_period:
            self._looked = now
            self._exchange(now)
        if now - self._answered > self._config.answer_age_max:
            return None
        return "" if self._mode == CUSTOM else MODES.get(self._mode, f"mode {self._mode}")

    def _exchange(self, now: float) -> None:
        """Take the answers of the service, and ask again when it is time."""
        while (response := take(self._responses)) is not None:
            if response.uuid == self._pending:
                self._mode, self._answered = mode_of(response.header, response.body), now
        if now - self._asked >= self._mode_period and self._reachable:
            self._asked, self._pending = now, self._call(GET_MODE, "")

    def release(self) -> None:
        self._change(CUSTOM)

    def damp(self) -> None:
        self._change(DAMPING)

    @property
    def _reachable(self) -> bool:
        return reachable(self._node, self._requests, f"{SERVICE}Resp")

    def _change(self, mode: int) -> None:
        now = time.monotonic()
        if now - self._changed >= self._config.ask_period and self._reachable:
            self._changed = now
            self._call(CHANGE_MODE, json.dumps({"mode": mode}))

    def _call(self, function: int, body: str) -> str:
        name = str(uuid.uuid4())
        header = json.dumps({"api_id": function, "expect_response": True, "call_mode": 0, "req_id": name})
        self._requests.publish(self._request(uuid=name, header=header, body=body))
        return name

    def close(self) -> None:
        self._node.destroy_node()
        try_shutdown(context=self._context)


def mode_of(header: str, body: str) -> int:
    """Mode in a response to ``GET_MODE``; ``MessageError`` for one that has none."""
    try:
        status: Any = json.loads(header)["status"]
        if status == 0:
            return int(json.loads(body)["mode"])
    except (ValueError, KeyError, TypeError) as error:
        raise MessageError(f"{SERVICE}: response {body[:80]!r} has no mode") from error
    raise MessageError(f"{SERVICE}: status {status}")
