"""Services of a simulated robot: pause, reset, hang, push, obstacle, faults."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from std_srvs.srv import SetBool, Trigger

from bridge.driver.drivers import SimulatedDrivers
from models.errors import CommandError, PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.messages import wrench_vector
from models.nodes.parameters import describe
from models.nodes.qos import EVENT
from models.types import Vector

SCENARIO = "faults.scenario"


class SimulationServices:
    """Services on the simulated world.

    - ``pause``, ``hang``, ``obstacle`` (SetBool): ``hang`` lifts the robot off the floor or resets it to its start,
      while it is held or its drivers are off; ``obstacle`` places the box of the terrain at ``obstacle.place``.
    - ``reset``, ``push``, ``faults/inject``, ``faults/clear`` (Trigger): with the present parameters ``push.*`` and
      ``faults.scenario``.
    - Topic ``push`` (WrenchStamped): force in W on the body ``header.frame_id`` for ``push.duration``.

    ``restart`` resets the robot to its start, or (True) hangs it up; ``pause`` stops (True) or resumes simulated time.
    """

    def __init__(
        self,
        node: PoiseNode,
        drivers: SimulatedDrivers,
        restart: Callable[[bool], None],
        pause: Callable[[bool], None],
    ) -> None:
        self._node, self._drivers, self._plant = node, drivers, drivers.plant
        self._restart, self._pause = restart, pause
        duration = describe("Duration of a push [s]", read_only=False, low=0.001, high=10.0)
        for name, default, text in (
            ("push.force", [0.0, 60.0, 0.0], "Force of the service push, in the world [N]"),
            ("push.duration", 0.1, duration),
            ("push.body", "base_link", "Body that the service push pushes"),
            ("obstacle.place", [2.0, 0.0], "Middle of the box of the service obstacle, x and y in the world [m]"),
            (SCENARIO, "", "What faults/inject injects: YAML, a file, or the name of a packaged scenario"),
        ):
            if not node.has_parameter(name):
                node.declare_parameter(
                    name, default, describe(text, read_only=False) if isinstance(text, str) else text
                )
        self._plant.faults.note = node.get_logger().warning
        node.listen(WrenchStamped, topics.PUSH, self._on_push, EVENT)
        self._offer(SetBool, "pause", self._on_pause)
        self._offer(SetBool, "hang", self._on_hang)
        self._offer(SetBool, "obstacle", self._on_obstacle)
        self._offer(Trigger, "reset", lambda _: self._start_over(False))
        self._offer(Trigger, "push", self._on_push_service)
        self._offer(Trigger, topics.FAULTS_INJECT, self._on_inject)
        self._offer(Trigger, topics.FAULTS_CLEAR, lambda _: self._plant.faults.clear())

    def _offer(self, kind: Any, name: str, act: Callable[[Any], str]) -> None:
        """A service that answers with its effect, or with the reason of the refusal."""

        def on_call(request: Any, response: Any) -> Any:
            try:
                response.message = act(request)
                response.success = True
            except PoiseError as error:
                response.success, response.message = False, str(error)
            return response

        self._node.serve(kind, name, on_call)

    def _value(self, name: str) -> Any:
        return self._node.get_parameter(name).value

    def _push(self, force: Vector, body: str) -> str:
        duration = float(self._value("push.duration"))
        self._plant.push(force, duration, body)
        return self._log(f"push ({force[0]:g}, {force[1]:g}, {force[2]:g}) N for {duration:g} s on {body}")

    def _log(self, text: str) -> str:
        self._node.get_logger().info(text)
        return text

    def _on_push(self, message: WrenchStamped) -> None:
        try:
            self._push(wrench_vector(message.wrench)[:3], message.header.frame_id or "base_link")
        except PoiseError as error:
            self._node.refuse(topics.PUSH, error)

    def _on_push_service(self, request: Any) -> str:
        return self._push(np.asarray(self._value("push.force"), dtype=np.float64), str(self._value("push.body")))

    def _on_pause(self, request: Any) -> str:
        self._pause(request.data)
        return "paused" if request.data else "running"

    def _on_hang(self, request: Any) -> str:
        state = self._drivers.state
        if request.data == (state == topics.HANGING):
            return f"the robot {'hangs' if request.data else 'does not hang'} already"
        if not self._drivers.movable:
            raise CommandError(f"hang refused: the drivers are '{state}'; request mode damp, then off")
        return self._start_over(request.data)

    def _start_over(self, hanging: bool) -> str:
        self._restart(hanging)
        return "the robot hangs, feet in the air" if hanging else "the robot is back at its start, held"

    def _on_obstacle(self, request: Any) -> str:
        if not request.data:
            self._plant.remove_obstacle()
            return self._log("no obstacle")
        place = self._value("obstacle.place")
        if len(place) != 2:
            raise CommandError(f"obstacle.place: {len(place)} numbers instead of x and y")
        self._plant.place_obstacle(float(place[0]), float(place[1]))
        return self._log(f"obstacle at ({place[0]:g}, {place[1]:g}) m")

    def _on_inject(self, request: Any) -> str:
        try:
            scenario = str(self._value(SCENARIO))
            if not scenario.strip():
                raise CommandError(f"the parameter {SCENARIO} is empty: set it to YAML, a file or a scenario")
            return self._plant.faults.inject(scenario)
        except PoiseError as error:
            self._node.refuse(topics.FAULTS_INJECT, error)
            raise
