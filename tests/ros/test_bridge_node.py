"""The bridge's node without its loop: which commands and modes it takes, and what it notes about them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from std_msgs.msg import String

from bridge.nodes.mujoco_bridge import MujocoBridge
from models.nodes import topics
from models.nodes.messages import JointCommandCodec
from models.robot_model import RobotModel
from models.types import JointCommand

pytestmark = pytest.mark.ros

MS = 1_000_000


@pytest.fixture
def bridge(bench: Any, tmp_path: Path) -> MujocoBridge:
    """In mode stand, at tick 100 of which every one has been published."""
    node: MujocoBridge = bench.add(MujocoBridge, latency_file=tmp_path / "latency.npz")
    node._on_mode(String(data="stand"))
    for node.tick in range(1, 101):
        node.publish_tick(0.0)
    return node


def _send(bridge: MujocoBridge, g1: RobotModel, tick: int, q: float = 0.0) -> None:
    zero = np.zeros(g1.nj)
    bridge._on_command(JointCommandCodec(g1).encode(tick * MS, JointCommand(g1.posture("stand") + q, zero, zero)))


def test_commands_that_answer_old_sensors_are_refused(bridge: MujocoBridge, g1: RobotModel) -> None:
    _send(bridge, g1, 79)
    assert bridge.counters["commands too old"] == 1
    assert "79000000 ns is 21000000 ns old" in bridge.values["last refusal"]
    _send(bridge, g1, 80)  # 20 ms: just young enough
    assert bridge.counters[f"refused {topics.JOINT_COMMAND}"] == 1
    assert bridge._command_stamp == 80 * MS


def test_only_accepted_commands_count_as_answers(bridge: MujocoBridge, g1: RobotModel) -> None:
    """The latency of a command that is refused is no latency."""
    received = bridge._probe.received  # type: ignore[union-attr]
    _send(bridge, g1, 101)  # not yet due
    _send(bridge, g1, 70)  # too old
    _send(bridge, g1, 90, q=float("nan"))
    assert not received.any()
    _send(bridge, g1, 90)
    _send(bridge, g1, 85)  # overtaken
    assert np.flatnonzero(received).tolist() == [90]


def test_unknown_modes_are_refused_by_name(bridge: MujocoBridge) -> None:
    bridge._on_mode(String(data="fly"))
    assert bridge.counters[f"refused {topics.MODE}"] == 1
    assert "unknown mode 'fly'" in bridge.values["last refusal"]
    assert bridge._driven.awaits_command
