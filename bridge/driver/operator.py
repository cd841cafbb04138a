"""Operator interface of the start of a real robot: services, status record and diagnostics."""

import time
from collections.abc import Callable
from math import isfinite
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from std_srvs.srv import Trigger

from bridge.driver.drivers import HardwareDrivers
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode, cause_of
from models.nodes.qos import LATCHED
from models.status import StartStatus

VALUES_PERIOD = 1.0  #: Time between two updates of the monitors' values in the status, and between two log lines [s]
STALE_MIN = 1.0  #: Silence of the robot after which the monitors' values are omitted [s]


class StartServices:
    """Services ``start/confirm_gantry``, ``start/prepare``, ``start/lower``, ``start/relax`` and ``start/damp``.

    A service responds with its effect or the reason of a refusal. ``on_change`` is called after a service that may have
    changed the state of the drivers. Topic ``start/status`` publishes the state.
    """

    def __init__(self, node: PoiseNode, drivers: HardwareDrivers, on_change: Callable[[], None]) -> None:
        self._node, self._drivers, self._on_change = node, drivers, on_change
        self._publish = node.announce_status(topics.START_STATUS, LATCHED)
        self._published: StartStatus | None = None
        self._logged, self._log_due = ("", ""), 0.0  # state and cause
        self._values: tuple[str, ...] = ()
        self._values_due = 0.0
        startup = drivers.startup
        acts = (
            startup.confirm_gantry,
            startup.prepare,
            startup.lower,
            drivers.relax,
            lambda: startup.damp("start/damp was called"),
        )
        for name, act in zip(topics.START_SERVICES, acts, strict=True):
            self._offer(name, act)

    def _offer(self, name: str, act: Callable[[], str]) -> None:
        def on_call(request: Any, response: Any) -> Any:
            try:
                response.message, response.success = act(), True
                self._node.get_logger().info(f"{name}: {response.message}")
            except PoiseError as error:
                self._node.refuse(name, error)
                response.message, response.success = str(error), False
            self._on_change()
            self.publish()
            return response

        self._node.serve(Trigger, name, on_call)

    def publish(self) -> None:
        """Publish the status if it has changed; log each change of the state and of the condition it waits for."""
        startup, plant = self._drivers.startup, self._drivers.plant
        stale = self._drivers.stale
        silent = (f"no state of the robot for {stale:.0f} s",) if stale > STALE_MIN else ()
        if (now := time.monotonic()) >= self._values_due:
            self._values_due = now + VALUES_PERIOD
            monitored = {} if silent else plant.monitored
            self._values = tuple(f"{name}: {value}" for name, value in monitored.items())
        remote = _last_signal(plant.remote_age)
        warnings = (*plant.warnings, *silent)
        status = StartStatus(str(startup.state), startup.waits_for, warnings, plant.holds, self._values, remote)
        change = status.state, cause_of(status.waits_for)
        if change != self._logged and (change[0] != self._logged[0] or now >= self._log_due):
            self._logged, self._log_due = change, now + VALUES_PERIOD
            self._node.get_logger().info(f"start: {status.state}; waits for {status.waits_for or 'nothing'}")
        if status == self._published:
            return
        self._published = status
        self._publish(status)

    @property
    def values(self) -> dict[str, str]:
        """Entries of the diagnostics."""
        startup = self._drivers.startup
        return {
            "start": str(startup.state),
            "start waits for": startup.waits_for,
            "load on the feet [%]": f"{100.0 * startup.load:.0f}",
            "tilt [rad]": f"{startup.tilt:.2f}",
            "remote controller": _last_signal(self._drivers.plant.remote_age) or "none",
            **self._drivers.plant.report,
        }

    def diagnose(self) -> tuple[Any, str]:
        """Level and message for the diagnostics."""
        startup, plant = self._drivers.startup, self._drivers.plant
        parts = [f"start '{startup.state}'", *plant.holds, *plant.warnings]
        if plant.stop:
            return DiagnosticStatus.ERROR, "; ".join([*parts, plant.stop])
        level = DiagnosticStatus.WARN if plant.holds or plant.warnings or startup.reason else DiagnosticStatus.OK
        return level, "; ".join([*parts, startup.reason] if startup.reason else parts)


def _last_signal(age: float | None) -> str:
    """Text for the age [s] of a remote controller's last signal, in seconds; empty without a remote controller."""
    if age is None:
        return ""
    return f"last signal {age:.0f} s ago" if isfinite(age) else "no signal yet"
