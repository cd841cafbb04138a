"""Connection to a Booster robot: a separate participant in the robot's DDS domain, polled without an executor.

A service of Booster consists of two topics: a request and a response with the same uuid. ``LocoApi`` reports the mode
of the robot (``GET_MODE``) and changes it (``CHANGE_MODE``). The robot executes LowCmds only in mode ``CUSTOM``.
"""

import json
import uuid
from typing import Any, Protocol

from bridge.plants.booster.codec import CUSTOM, DAMPING, MODES, Stamped
from bridge.plants.low_level import LowLink
from bridge.plants.participant import SENSOR, ServiceLink, Topics, ignore, take_all, take_stamped
from models.errors import MessageError
from models.nodes.interfaces import interface

STATE, COMMAND, REMOTE_STATE, SERVICE = "low_state", "joint_ctrl", "remote_controller_state", "LocoApiTopic"
CHANGE_MODE, GET_MODE = 2000, 2017  #: Functions of the service


class BoosterLink(LowLink, Protocol):
    """Connection to one robot; its messages are ``Stamped``. ``vendor`` is its mode, empty for ``CUSTOM``."""

    @property
    def remote_served(self) -> bool:
        """Whether a program on the robot publishes the states of its remote controller."""

    def damp(self) -> None:
        """Request the robot's mode ``DAMPING``."""


TOPICS = Topics(
    package="booster_interface", state=STATE, command=COMMAND, service="booster_msgs",
    types=("RpcReqMsg", "RpcRespMsg"), requests=f"{SERVICE}Req", responses=f"{SERVICE}Resp",
)  # fmt: skip


class DdsBoosterLink(ServiceLink, BoosterLink):
    """``ServiceLink`` to ``LocoApi`` in a DDS domain; requests the mode every ``mode_period`` [s]."""

    def __init__(self, domain: int, mode_period: float) -> None:
        super().__init__(domain, "poise_booster", TOPICS, mode_period)
        remote = interface("booster_interface", "msg", "RemoteControllerState")
        self._remotes = self._node.create_subscription(remote, REMOTE_STATE, ignore, SENSOR, raw=True)
        self._pending = ""  # uuid of the last request for the mode

    def take(self) -> list[Stamped]:
        remotes = [Stamped(False, data) for data in take_all(self._remotes)]
        return [*remotes, *(Stamped(True, *each) for each in take_stamped(self._states))]

    @property
    def remote_served(self) -> bool:
        return bool(self._remotes.get_publisher_count())

    def release(self) -> None:
        self._change(CUSTOM)

    def damp(self) -> None:
        self._change(DAMPING)

    def _change(self, mode: int) -> None:
        if self._may_change():
            self._call(CHANGE_MODE, json.dumps({"mode": mode}))

    def _ask(self) -> None:
        self._pending = self._call(GET_MODE, "")

    def _name_in(self, response: Any) -> str | None:
        if response.uuid != self._pending:
            return None
        mode = mode_of(response.header, response.body)
        return "" if mode == CUSTOM else MODES.get(mode, f"mode {mode}")

    def _call(self, function: int, body: str) -> str:
        name = str(uuid.uuid4())
        header = json.dumps({"api_id": function, "expect_response": True, "call_mode": 0, "req_id": name})
        self._requests.publish(self._request(uuid=name, header=header, body=body))
        return name


def mode_of(header: str, body: str) -> int:
    """Mode in a response to ``GET_MODE``; ``MessageError`` for an error status or a response without a mode."""
    try:
        status: Any = json.loads(header)["status"]
        if status == 0:
            return int(json.loads(body)["mode"])
    except (ValueError, KeyError, TypeError) as error:
        raise MessageError(f"{SERVICE}: response {body[:80]!r} has no mode") from error
    raise MessageError(f"{SERVICE}: status {status}")
