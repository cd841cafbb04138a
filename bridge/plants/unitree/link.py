"""Connection to a Unitree robot: a separate participant in the robot's DDS domain, polled without an executor.

A service of Unitree consists of two topics: a request and a response with the same id. ``motion_switcher`` reports the
active controller of the robot (``CHECK``), ends it (``RELEASE``), and reports the version of its API (``VERSION``).
"""

import json
import time
from typing import Any, Protocol

from bridge.plants.low_level import LowLink
from bridge.plants.participant import ServiceLink, Topics
from models.errors import MessageError

VERSION, CHECK, RELEASE = 1, 1001, 1003  #: Functions of the motion switcher
COMMAND = "lowcmd"  #: Topic of the commands
SWITCHER = "api/motion_switcher"  #: Prefix of its topics ``request`` and ``response``


class RobotLink(LowLink, Protocol):
    """Connection to one robot; its messages are serialised LowStates."""

    def version(self) -> str:
        """Version of the motion switcher; empty while unknown. Calls of ``vendor`` receive it."""


TOPICS = Topics(
    package="unitree_hg", state="lowstate", command=COMMAND, service="unitree_api", types=("Request", "Response"),
    requests=f"{SWITCHER}/request", responses=f"{SWITCHER}/response",
)  # fmt: skip


class DdsLink(ServiceLink, RobotLink):
    """``ServiceLink`` to the motion switcher in a DDS domain."""

    def __init__(self, domain: int) -> None:
        super().__init__(domain, "poise_unitree", TOPICS)
        self._id = time.monotonic_ns()
        self._check = self._ask_version = 0  # ids of the last requests Check and Version
        self._version = ""

    def version(self) -> str:
        return self._version

    def release(self) -> None:
        if self._may_change():
            self._call(RELEASE)

    def _ask(self) -> None:
        self._check = self._call(CHECK)
        if not self._version:
            self._ask_version = self._call(VERSION)

    def _name_in(self, response: Any) -> str | None:
        header = response.header
        if header.identity.id == self._ask_version and not header.status.code:
            self._version = str(response.data)
        return _name_of(response) if header.identity.id == self._check else None

    def _call(self, function: int) -> int:
        self._id += 1
        request = self._request()
        request.header.identity.id, request.header.identity.api_id = self._id, function
        request.parameter = "{}"
        self._requests.publish(request)
        return self._id


def _name_of(response: Any) -> str:
    """Name of the controller in a response to Check; ``MessageError`` for an error status or invalid JSON."""
    if response.header.status.code:
        raise MessageError(f"{SWITCHER}: error {response.header.status.code}")
    try:
        return str(json.loads(response.data).get("name", ""))
    except (ValueError, AttributeError) as error:
        raise MessageError(f"{SWITCHER}: response {response.data[:80]!r} is not an object of JSON") from error
