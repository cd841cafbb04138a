"""The guard process and the connection of a driver: the heartbeat says whether the guard has seen the driver."""

import os
import subprocess
import sys
import time
from collections.abc import Callable

import numpy as np
import pytest

pytest.importorskip("rclpy")

from bridge.plants.hardware import SESSION, session
from bridge.plants.ros2_control.commands import command_codec, driver_mark
from bridge.plants.ros2_control.config import JOINTS, read_config
from bridge.plants.ros2_control.link import RosLink
from bridge.ros.environment import free_domain, graph_environment
from models.robot_model import RobotModel
from models.types import JointCommand

pytestmark = pytest.mark.ros


@pytest.mark.long
def test_the_heartbeat_of_the_guard_process(monkeypatch: pytest.MonkeyPatch) -> None:
    domain, config, model = free_domain(), read_config({}), RobotModel.load("g1_hardware")
    environment = {**os.environ, **graph_environment(domain_id=domain, network=False), SESSION: f"{session():08x}"}
    codec = command_codec(model, config, driver_mark())
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    link = RosLink(domain, config, (JOINTS,), codec.kind)
    guard = subprocess.Popen(
        [sys.executable, "-m", "bridge.nodes.damping_guard", "ros2_control", "g1_hardware", str(domain), "{}"]
    )
    zero = np.zeros(model.nj)
    command = codec.encode(0, JointCommand(*np.zeros((5, model.nj))), zero, zero)

    def beats(condition: Callable[[list[bool]], bool], send: bool) -> bool:
        end = time.monotonic() + 60.0
        while time.monotonic() < end and guard.poll() is None:
            if send:
                link.send(command)
            if condition(link.beats()):
                return True
            time.sleep(0.005)
        return False

    try:
        assert beats(lambda found: found == [False], send=False)
        assert beats(lambda found: True in found, send=True)
    finally:
        guard.kill()
        guard.wait()
        link.close()
