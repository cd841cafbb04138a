"""Parameters of the controller that may be changed while the robot stands."""

from __future__ import annotations

from typing import Any

from rcl_interfaces.msg import FloatingPointRange

from controllers.balance.tuning import FACTOR, TUNABLE, configured
from controllers.stack import ControlStack
from controllers.whole_body.config import BalanceConfig, WholeBodyConfig
from models.nodes.base import PoiseNode


class GainParameters:
    """Passes changed gains on to the standing law of ``stack``. rclpy refuses values out of range, naming both.

    ``node`` has declared the gains as writable; ``balance`` and ``whole_body`` are the configurations after overrides.
    """

    def __init__(
        self, node: PoiseNode, balance: BalanceConfig, whole_body: WholeBodyConfig, stack: ControlStack
    ) -> None:
        self._node, self._stack = node, stack
        for name in TUNABLE:
            value, descriptor = configured(name, balance, whole_body), node.describe_parameter(name)
            descriptor.floating_point_range = [FloatingPointRange(from_value=value / FACTOR, to_value=value * FACTOR)]
            node.set_descriptor(name, descriptor)
        node.add_post_set_parameters_callback(self._on_set)

    def start(self) -> None:
        """Set the gains of a new law, which does not run yet, to the parameters."""
        tuning = self._stack.tuning
        if tuning is not None:
            for name in TUNABLE:
                tuning.set(name, float(self._node.get_parameter(name).value))
            tuning.finish()

    def _on_set(self, parameters: list[Any]) -> None:
        tuning = self._stack.tuning
        for parameter in parameters:
            if tuning is not None and parameter.name in TUNABLE:
                low, high = tuning.ranges[parameter.name]
                value = min(max(float(parameter.value), low), high)  # rclpy is lenient by a millionth
                self._stack.set_gain(parameter.name, value)
                self._node.get_logger().info(f"{parameter.name}: {value:g}")
