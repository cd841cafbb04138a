"""Parameters of the controller that may be changed while the robot stands."""

from __future__ import annotations

from typing import Any

from rcl_interfaces.msg import FloatingPointRange

from controllers.balance import BalanceController
from controllers.tuning import FACTOR, TUNABLE, Tuning, configured
from controllers.whole_body_config import BalanceConfig, WholeBodyConfig
from models.applied import Applied
from models.nodes.base import PoiseNode


class GainParameters:
    """Hands changed gains over to ``Tuning``. rclpy refuses what is out of a parameter's range, naming both.

    Args:
        node: Node that has declared the gains, not read-only.
        balance: Configuration after parameter overrides: ranges are about its values.
        whole_body: Likewise.
        applied: Notes what changes, for a replay; None for nobody.
    """

    def __init__(
        self, node: PoiseNode, balance: BalanceConfig, whole_body: WholeBodyConfig, applied: Applied | None = None
    ) -> None:
        self._node, self._applied = node, applied
        self._tuning: Tuning | None = None
        for name in TUNABLE:
            value, descriptor = configured(name, balance, whole_body), node.describe_parameter(name)
            descriptor.floating_point_range = [FloatingPointRange(from_value=value / FACTOR, to_value=value * FACTOR)]
            node.set_descriptor(name, descriptor)
        node.add_post_set_parameters_callback(self._on_set)

    def start(self, law: BalanceController) -> None:
        """Tune another law, which does not run yet, to what the parameters say."""
        self._tuning = Tuning(law)
        for name in TUNABLE:
            self._tuning.set(name, float(self._node.get_parameter(name).value))
        self._tuning.finish()
        if self._applied is not None:
            self._applied.watch("tuning", self._tuning, (law,))

    def step(self, dt: float) -> None:
        """Advance by the time of a tick [s]."""
        if self._tuning is not None and self._tuning.moving:
            self._tuning.step(dt)

    def _on_set(self, parameters: list[Any]) -> None:
        for parameter in parameters:
            if self._tuning is not None and parameter.name in TUNABLE:
                low, high = self._tuning.ranges[parameter.name]
                value = min(max(float(parameter.value), low), high)  # rclpy is lenient by a millionth
                self._tuning.set(parameter.name, value)
                if self._applied is not None:
                    self._applied.note("gain", parameter.name, value)
                self._node.get_logger().info(f"{parameter.name}: {value:g}")
