"""What a person reads of the start of a real robot: status and log, and what is refused before anything starts."""

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

from bridge.driver import operator
from bridge.driver.operator import StartServices
from bridge.hardware_loop import HardwareLoop
from bridge.launch.hardware import check_plant
from models.errors import ConfigError
from models.status import StartStatus

pytestmark = pytest.mark.ros


class Node:
    """Keeps what is published and logged."""

    def __init__(self) -> None:
        self.published: list[StartStatus] = []
        self.log: list[str] = []

    def announce_status(self, *_: object) -> Any:
        return self.published.append

    def serve(self, *_: object) -> None:
        """No services."""

    def get_logger(self) -> Any:
        return self

    def info(self, text: str) -> None:
        self.log.append(text)


@pytest.mark.long
def test_a_silent_robot_has_no_values_and_every_change_is_logged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop, node = HardwareLoop(tmp_path / "marker"), Node()
    elapsed = [0.0]
    monkeypatch.setattr(operator.time, "monotonic", lambda: elapsed[0])
    start = StartServices(node, loop.drivers, lambda: None)  # type: ignore[arg-type]

    def run(time: float) -> StartStatus:
        for _ in range(round(time / 0.1)):
            loop.run(0.1)
            elapsed[0] += 0.1
            start.publish()
        return node.published[-1]

    loop.link.connected = False
    silent = run(2.0)
    assert "no state of the robot for 2 s" in silent.warnings and not silent.values
    assert "check cable" in node.log[-1]
    loop.link.connected = True
    assert run(1.1).values and "check cable" not in node.log[-1]
    assert run(2.0).state == "gantry" and node.log[-1].startswith("start: gantry")
    loop.link.connected = False
    silent = run(2.0)
    assert silent.state == "listen" and not silent.values and "no state of the robot for 2 s" in silent.warnings
    loop.link.connected = True
    logged = len(node.log)
    run(1.5)
    assert len(node.log) > logged and len(node.log) < 15


@pytest.mark.parametrize(
    ("plant", "robot", "options", "reason"),
    [
        ("unitree", "g1_hardware", "{remte: false}", "unknown options remte; known: .*remote, speed$"),
        ("unitree", "g1_hardware", "{rate: 250.0}", "500 or 1000 Hz"),
        ("unitree", "talos_hardware", "", "as g1_hardware has"),
        ("unitree", "g9.yaml", "", "g9.yaml: cannot be read"),
        ("ros2_control", "g1_hardware", "{comand: pvt}", "comand: .* did you mean 'command'"),
        ("booster", "g1_hardware", "", "unknown B, F1"),
    ],
)
def test_what_does_not_fit_is_refused_before_anything_starts(plant: str, robot: str, options: str, reason: str) -> None:
    with pytest.raises(ConfigError, match=reason):
        check_plant(plant, robot, options)
    check_plant("unitree", "g1_hardware", "{network_interface: lo, domain: 3, rate: 500.0}")
