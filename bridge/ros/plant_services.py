"""What one may do to the simulated world: pause it, reset it, push the robot, inject faults."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from std_srvs.srv import SetBool, Trigger

from bridge.ros.driven_robot import DrivenRobot
from bridge.ros.fault_services import FaultServices
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.messages import wrench_vector
from models.nodes.parameters import describe
from models.nodes.qos import EVENT
from models.types import Vector


class PlantServices:
    """Services ``pause``, ``hang`` (SetBool), ``reset``, ``push`` (Trigger), and the topic ``push`` (WrenchStamped).

    The service pushes as the parameters ``push.*`` say. The topic pushes the body named by ``header.frame_id`` with the
    message's force, given in the world, for ``push.duration``. ``hang`` has a crane lift the robot off the floor, or
    puts it back to its start, while it is held or its drivers are off. Those of faults are in ``FaultServices``.

    Args:
        node: Node that offers them.
        driven: Robot to push.
        restart: Puts the robot back to its start, or (True) into the air.
        pause: Stops (True) or resumes simulated time.
    """

    def __init__(
        self, node: PoiseNode, driven: DrivenRobot, restart: Callable[[bool], None], pause: Callable[[bool], None]
    ) -> None:
        self._node, self._driven, self._restart, self._pause = node, driven, restart, pause
        if not node.has_parameter("push.body"):
            text = describe("Force of the service push, in the world [N]", read_only=False)
            node.declare_parameter("push.force", [0.0, 60.0, 0.0], text)
            text = describe("Duration of a push [s]", read_only=False, low=0.001, high=10.0)
            node.declare_parameter("push.duration", 0.1, text)
            text = describe("Body that the service push pushes", read_only=False)
            node.declare_parameter("push.body", "base_link", text)
        node.listen(WrenchStamped, topics.PUSH, self._on_push, EVENT)
        node.serve(SetBool, "pause", self._on_pause)
        node.serve(SetBool, "hang", self._on_hang)
        node.serve(Trigger, "reset", self._on_reset)
        node.serve(Trigger, "push", self._on_push_service)
        FaultServices(node, driven.plant.faults)

    def _push(self, force: Vector, body: str) -> str:
        duration = float(self._node.get_parameter("push.duration").value)
        self._driven.plant.apply_push(force, duration, body)
        told = f"push ({force[0]:g}, {force[1]:g}, {force[2]:g}) N for {duration:g} s on {body}"
        self._node.get_logger().info(told)
        return told

    def _on_push(self, message: WrenchStamped) -> None:
        try:
            self._push(wrench_vector(message.wrench)[:3], message.header.frame_id or "base_link")
        except PoiseError as error:
            self._node.refuse(topics.PUSH, error)

    def _on_push_service(self, request: Any, response: Any) -> Any:
        force = np.asarray(self._node.get_parameter("push.force").value, dtype=np.float64)
        try:
            response.message = self._push(force, str(self._node.get_parameter("push.body").value))
            response.success = True
        except PoiseError as error:
            response.success, response.message = False, str(error)
        return response

    def _on_pause(self, request: Any, response: Any) -> Any:
        self._pause(request.data)
        response.success, response.message = True, "paused" if request.data else "running"
        return response

    def _on_hang(self, request: Any, response: Any) -> Any:
        hangs = self._driven.state == topics.HANGING
        if request.data == hangs:
            response.success, response.message = True, f"the robot {'hangs' if hangs else 'does not hang'} already"
            return response
        if not self._driven.movable:
            response.success = False
            response.message = f"hang refused: the drivers are '{self._driven.state}'; request mode damp, then off"
            return response
        return self._start_over(request.data, "the robot hangs, feet in the air", response)

    def _on_reset(self, request: Any, response: Any) -> Any:
        return self._start_over(False, "", response)

    def _start_over(self, hanging: bool, told: str, response: Any) -> Any:
        try:
            self._restart(hanging)
            response.success, response.message = True, told if hanging else "the robot is back at its start, held"
        except PoiseError as error:
            response.success, response.message = False, str(error)
        return response
