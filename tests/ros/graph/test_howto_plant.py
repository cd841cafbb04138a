"""The code of docs/howto_plant.md does what the page says, and other plants are refused by name."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from bridge.launch.graph import Graph
from bridge.launch.hardware import other_network
from bridge.launch.layout import BRIDGE, process_specs
from bridge.nodes.robot_driver import RobotDriver
from models.nodes import topics
from models.nodes.qos import SENSOR
from tests.ros.conftest import free_domain

pytestmark = [pytest.mark.ros, pytest.mark.graph]


@pytest.fixture(scope="module")
def folder(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of the page, the sensor data recorded."""
    where = tmp_path_factory.mktemp("howto")
    blocks = re.findall(r"```python\n(.*?)```", (root / "docs/howto_plant.md").read_text(), re.DOTALL)
    for name, code in zip(("record", "replay", "drive", "guarded"), blocks, strict=True):
        (where / f"{name}.py").write_text(code)
    run(where, root, "record.py")
    return where


def run(folder: Path, root: Path, script: str) -> str:
    code = f"import sys, runpy; sys.path[:0] = ['.', {str(root)!r}]; runpy.run_path({script!r}, run_name='__main__')"
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, timeout=300, check=False
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_the_drivers_run_the_plant_without_ros(folder: Path, root: Path) -> None:
    assert re.search(r"active kp \d+ N.m/rad, tau -?\d+\.\d N.m", run(folder, root, "drive.py"))


def test_the_graph_runs_the_plant(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(folder), prepend=":")
    parameters = {"robot_driver": {"plant": "replay:ReplayPlant", "plant_options": f"{{file: {folder}/standing.npz}}"}}
    stamps: list[int] = []
    with Graph(
        "g1", domain_id=free_domain(), parameters=parameters, log=folder / "log", say=lambda text: None
    ) as graph:
        graph.node.create_subscription(JointState, topics.JOINT_STATES, lambda m: stamps.append(m.header.stamp), SENSOR)
        graph.wait_for(lambda: graph.mode == "off" and graph.driver_state == "off", 20.0, "off")
        graph.wait_for(lambda: len(stamps) > 100, 20.0, "publishing")
        names = {name for name, _ in graph.node.get_service_names_and_types()}
        assert not names & {"/reset", "/push", "/faults/inject"}
        graph.wait_for(lambda: graph.call("mode/stand")[0], 20.0, "armed")
        graph.wait_standing(20.0)
        graph.spin(1.0)
        assert graph.standing


def test_the_guard_damps_the_robot_when_the_driver_is_killed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(folder), prepend=":")
    monkeypatch.syspath_prepend(str(folder))
    robot = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    robot.bind(("127.0.0.1", 0))
    robot.settimeout(20.0)
    options = f"{{file: {folder}/standing.npz, port: {robot.getsockname()[1]}}}"
    network = other_network("guarded:GuardedPlant", options)
    assert network is not None and other_network("replay:ReplayPlant", options) is None
    specs = network.processes(process_specs("shared"), "g1")
    parameters = {"robot_driver": {"plant": network.plant, "plant_options": options}}

    def damping() -> bool:
        _, _, tau, kp, kd = np.frombuffer(robot.recv(1 << 16)).reshape(5, -1)
        return kd.min() > 0.0 and not kp.any() and not tau.any()

    with (
        robot,
        Graph(
            "g1", domain_id=free_domain(), parameters=parameters, specs=specs, log=folder / "log_2", say=lambda _: None
        ) as graph,
    ):
        graph.wait_for(lambda: graph.call("mode/stand")[0], 20.0, "armed")
        graph.wait_standing(20.0)
        os.kill(graph.pids[BRIDGE.module], signal.SIGKILL)
        assert any(damping() for _ in range(100_000))


@pytest.mark.parametrize(
    ("parameters", "culprit"),
    [
        ({"plant": "robot"}, "plant: unknown 'robot'; known: booster, mujoco"),
        ({"plant": "replay:"}, "plant: unknown 'replay:'; known: booster, mujoco"),
        ({"plant": ":ReplayPlant"}, "plant: unknown ':ReplayPlant'; known: booster, mujoco"),
        ({"plant": "no_such_module:Plant"}, "plant: 'no_such_module:Plant' cannot be imported"),
        ({"plant": "replay:ReplayPlant", "plant_options": "{path: standing.npz}"}, "path"),
        ({"plant": "replay:ReplayPlant", "plant_options": "{file: FOLDER/empty.npz}"}, "no array 'q'"),
        ({"plant": "replay:ReplayPlant", "plant_options": "{file: FOLDER/none.npz}"}, "none.npz"),
        ({"plant": "replay:ReplayPlant", "plant_options": "{file: FOLDER/standing.npz}", "lockstep": True}, "lockstep"),
    ],
)
def test_a_plant_that_cannot_be_had_is_refused_by_name(
    bench: Any, folder: Path, monkeypatch: pytest.MonkeyPatch, parameters: dict[str, Any], culprit: str
) -> None:
    np.savez(folder / "empty.npz")
    monkeypatch.syspath_prepend(str(folder))
    given = {
        k: json.dumps(v.replace("FOLDER", str(folder)) if isinstance(v, str) else v) for k, v in parameters.items()
    }
    node = bench.add(RobotDriver, active=False, **given)
    assert culprit in node.message


def test_a_plant_that_falls_silent_is_damped(bench: Any, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(folder))
    node = bench.add(
        RobotDriver, plant="replay:ReplayPlant", plant_options=json.dumps(f"{{file: {folder}/standing.npz}}")
    )
    node.commands.on_mode(String(data="stand"))
    for _ in range(20):
        node.publish_tick(0.0)
        node.step()
    stamp = node.stamp
    assert node.drivers.state == topics.ACTIVE and stamp == 20_000_000
    sample = node.drivers.plant.read()
    monkeypatch.setattr(node.drivers.plant, "read", lambda: sample)
    for _ in range(45):
        node.publish_tick(0.0)
        node.step()
    assert node.drivers.state == topics.DAMPED
    assert node.counters["ticks without a new sample"] == 44
