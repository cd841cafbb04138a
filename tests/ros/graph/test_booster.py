"""The graph drives a robot over Booster's protocol, in real time: Booster's SDK as the robot's side, and as a client.

Times are the robot's, which waits while this machine is busy; no time of this machine is asserted.
"""

import json
import os
import signal
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from benchmarks.graph.robot_process import RobotProcess
from benchmarks.graph.robot_session import HardwareSession
from bridge.driver.probes import ANSWER_VALUES
from bridge.plants.booster.codec import CUSTOM, DAMPING, PREPARE
from bridge.ros.environment import free_domain
from models.errors import MessageError
from models.nodes.interfaces import interface
from tests.booster.robot import write_profiles

pytestmark = [pytest.mark.ros, pytest.mark.graph, pytest.mark.slow]
OPTIONS = "{clock: count}"  # the robot's time is slower than that of this machine


def needs(module: str, package: str) -> None:
    try:
        interface("booster_interface", "msg", "LowState")
    except MessageError as error:
        pytest.skip(str(error))
    if find_spec(module) is None:
        pytest.skip(f"pip install {package}")


@pytest.mark.parametrize("side", ["sdk", "ros"])
def test_it_stands_and_walks_against_a_robot_in_another_process(tmp_path: Path, side: str) -> None:
    """By default at half speed. ``sdk`` ends with the graph, ``ros`` with a kill of the driver.

    ``POISE_BOOSTER_STAND`` and ``_WALK`` change the times [s], ``_SPEED`` the robot's speed.
    """
    needs("booster_robotics_sdk", "far-booster-sdk")
    given = {"STAND": "4", "WALK": "5", "SPEED": "0.5"}
    stand, walk, speed = (float(os.environ.get(f"POISE_BOOSTER_{name}", usual)) for name, usual in given.items())
    _, laws = write_profiles(tmp_path)
    with HardwareSession(
        side, tmp_path, laws, OPTIONS, speed, graph_domain=free_domain(), robot_domain=free_domain(), rate=None,
        plant="booster", robot=str(laws), plant_options=OPTIONS, module="tests.booster.process",
    ) as session:  # fmt: skip
        assert session.robot("mode") == PREPARE
        session.stand()
        session.robot("clear")
        drift = session.drift(stand)
        assert np.abs(drift).max() < 0.01 and session.robot("mode") == CUSTOM
        if side == "ros":
            os.kill(session.graph.pids["bridge.nodes.robot_driver"], signal.SIGKILL)
            session.graph.wait_for(lambda: session.robot("report")["kp"] == 0.0, 20.0, "damping by the guard")
            return
        walked, estimated = session.walk(0.3, walk, 1.0)
        print({"drift": drift, "walked": walked, "odometry": estimated, **session.robot("report")})
        print({key: session.value(key) for key in ANSWER_VALUES.values()})
        assert walked[0] > 0.2 * walk and np.abs(estimated - walked).max() < 0.05
        session.graph.stop()
        assert session.robot("mode") == DAMPING and set(session.graph.exit_codes.values()) == {0}


def test_boosters_client_understands_the_simulated_robot(tmp_path: Path) -> None:
    needs("booster_robotics_sdk_python", "booster-robotics-sdk-python")
    robot, _ = write_profiles(tmp_path)
    domain = free_domain()
    side = RobotProcess(
        "ros", "lo", tmp_path, str(robot), "{}", 0.5, domain=domain, module="tests.booster.process"
    )  # fmt: skip
    try:
        words = [sys.executable, "-m", "tests.booster.client", "127.0.0.1", str(domain)]
        done = subprocess.run(words, capture_output=True, text=True, timeout=120.0, check=True)
        found = json.loads(done.stdout.splitlines()[-1])
        print(found)
        assert (found["before"], found["after"]) == (PREPARE, CUSTOM)
        assert len(found["state"]["q"]) == 23 and np.linalg.norm(found["state"]["acc"]) == pytest.approx(9.81, rel=0.1)
        np.testing.assert_allclose(found["elbows"], 0.4, atol=0.1)
        assert side("mode") == CUSTOM and side("report")["received"] > 0 and side("report")["refused"] == 0
    finally:
        side.close()
