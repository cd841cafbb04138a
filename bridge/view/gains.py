"""Sliders for the parameters of a node that may be changed while it runs."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import ParameterType
from rclpy.parameter import Parameter

from bridge.ros.client import Client
from bridge.ros.operator import Operator

STEPS = 200  #: Positions of a slider [-]
REACH = 4.0  #: Upper end of a slider as a multiple of its first value, within the parameter's range [-]
USUAL = "whole_body."  #: Common prefix of names, omitted from the short labels


class Gains:
    """A slider for each float parameter of a node that is not read-only and has a range.

    Answers arrive in the client's callbacks. A refused value is reported with its reason, and the slider goes back.
    ``place`` is the tab of the sliders, entered as a context; ``client`` is inside its context; ``operator`` executes
    the requests, which are repeated after ``timeout`` [s] without an answer.
    """

    def __init__(
        self,
        gui: Any,
        place: Any,
        client: Client,
        operator: Operator,
        node: str,
        report: Callable[[str], object],
        timeout: float,
    ) -> None:
        self._gui, self._place, self._operator, self._node, self._report = gui, place, operator, node, report
        self._parameters, self._timeout = client.parameters_of(node), timeout
        self._asked_at: float | None = None
        self._asked: dict[str, int] = {}
        self._accepted: dict[str, float] = {}
        self.sliders: dict[str, Any] = {}

    def ask(self) -> None:
        """Request the parameters once the node exists, and again after the timeout."""
        now = time.monotonic()
        due = self._asked_at is None or (not self.sliders and now - self._asked_at > self._timeout)
        if due and self._parameters.services_are_ready():
            self._asked_at = now
            self._then(self._parameters.list_parameters(), self._on_list)

    def _on_list(self, answer: Any) -> None:
        names = list(answer.result.names)
        self._then(self._parameters.describe_parameters(names), self._on_descriptors)

    def _on_descriptors(self, answer: Any) -> None:
        free = [
            item
            for item in answer.descriptors
            if not item.read_only and item.type == ParameterType.PARAMETER_DOUBLE and item.floating_point_range
        ]
        if free:
            names = [item.name for item in free]
            self._then(self._parameters.get_parameters(names), lambda values: self._on_values(free, values))

    def _on_values(self, descriptors: list[Any], answer: Any) -> None:
        if self.sliders:  # a late answer to a repeated request
            return
        with self._place:
            for item, value in zip(descriptors, answer.values, strict=True):
                self._add(item, float(value.double_value))

    def _add(self, item: Any, value: float) -> None:
        given = item.floating_point_range[0]
        low = max(given.from_value, min(0.0, REACH * value))
        high = min(given.to_value, max(REACH * abs(value), low + 1.0))
        slider = self._gui.add_slider(
            item.name.removeprefix(USUAL),
            low,
            high,
            (high - low) / STEPS,
            min(max(value, low), high),
            hint=f"{item.name}: {item.description}",
        )
        self.sliders[item.name] = slider
        self._accepted[item.name] = value

        def on_update(event: Any) -> None:
            if event.client is not None:  # moved by the user
                value = float(slider.value)
                self._operator.post(lambda: self.move(item.name, value))

        slider.on_update(on_update)

    def move(self, name: str, value: float) -> None:
        """Set a value on the node; when it refuses the newest one, the slider goes back."""
        self._asked[name] = number = self._asked.get(name, 0) + 1

        def on_result(answer: Any) -> None:
            result = answer.results[0]
            if result.successful:
                self._accepted[name] = value
                self._report(f"{name} = {value:g}")
            else:
                self._report(f"{name} = {value:g} refused: {result.reason}")
                if number == self._asked[name]:
                    self.sliders[name].value = self._accepted[name]

        self._then(self._parameters.set_parameters([Parameter(name, value=value)]), on_result)

    def _then(self, future: Any, go_on: Callable[[Any], None]) -> None:
        """Continue with an answer, or report why there is none."""

        def done(future: Any) -> None:
            error = future.exception()
            if error is None:
                go_on(future.result())
            else:
                self._report(f"parameters of {self._node}: {error}")

        future.add_done_callback(done)
