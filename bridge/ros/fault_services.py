"""Services that inject faults into the simulated robot and end them."""

from __future__ import annotations

from typing import Any

from std_srvs.srv import Trigger

from bridge.fault_proxy import FaultProxy
from models.errors import CommandError, PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.parameters import describe

SCENARIO = "faults.scenario"


class FaultServices:
    """Services ``faults/inject`` and ``faults/clear`` (Trigger).

    The first injects what the parameter ``faults.scenario`` says at that moment, as often as it is called. What begins
    and ends is logged.

    Args:
        node: Node that offers them.
        faults: Where they go.
    """

    def __init__(self, node: PoiseNode, faults: FaultProxy) -> None:
        self._node, self._faults = node, faults
        if not node.has_parameter(SCENARIO):
            text = "What faults/inject injects: YAML, a file, or the name of a packaged scenario"
            node.declare_parameter(SCENARIO, "", describe(text, read_only=False))
        faults.note = node.get_logger().warning
        node.serve(Trigger, topics.FAULTS_INJECT, self._on_inject)
        node.serve(Trigger, topics.FAULTS_CLEAR, self._on_clear)

    def _on_inject(self, request: Any, response: Any) -> Any:
        try:
            scenario = str(self._node.get_parameter(SCENARIO).value)
            if not scenario.strip():
                raise CommandError(f"the parameter {SCENARIO} is empty: set it to YAML, a file or a scenario")
            response.success, response.message = True, self._faults.inject(scenario)
        except PoiseError as error:
            self._node.refuse(topics.FAULTS_INJECT, error)
            response.success, response.message = False, str(error)
        return response

    def _on_clear(self, request: Any, response: Any) -> Any:
        response.success, response.message = True, self._faults.clear()
        return response
