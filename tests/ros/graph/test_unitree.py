"""The graph drives a robot over Unitree's protocol, in real time: Unitree's SDK on the far end of a cable, and faults.

Times are the robot's, which waits while this machine is busy; no time of this machine is asserted.
"""

import json
import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks.core.machine import Unavailable
from benchmarks.graph.robot_session import HardwareSession
from benchmarks.stability import sim2sim_sdk
from bridge.launch.ending import EndConfig, lower
from bridge.ros.environment import free_domain
from models.config import default_config, overlaid
from models.errors import MessageError
from models.nodes.interfaces import interface

pytestmark = [pytest.mark.ros, pytest.mark.graph]
slow = pytest.mark.slow
STALLED = re.compile("no (command of the controller|new state of the robot) for")


def unavailable(error: Exception) -> None:
    """Skip a test for what this machine does not have; fail where ``POISE_REQUIRE_SDK`` says that it must."""
    (pytest.fail if os.environ.get("POISE_REQUIRE_SDK") else pytest.skip)(str(error))


def needs_types() -> None:
    try:
        interface("unitree_hg", "msg", "LowState")
    except MessageError as error:
        unavailable(error)


def test_unitrees_sdk_behind_a_cable(tmp_path: Path) -> None:
    """The whole script of ``poise bench sim2sim --mode sdk``: stand, wave, pushes, walk and stop.

    At 0.3 of real time, where the robot's time waits for late commands and limits of real time are longer: a host that
    holds a core for 40 ms stops the graph at full speed, which is for the benchmark. ``POISE_UNITREE_STAND`` and
    ``_WALK`` change the times [s], ``_SPEED`` the robot's speed. Here, a process that does not run for 0.13 s damps the
    robot, as it must; the script is then repeated once.
    """
    needs_types()
    run = sim2sim_sdk.run_of("g1", 0, "sdk")
    script = run["script"]
    stand, walk, run["speed"] = (
        float(os.environ.get(f"POISE_UNITREE_{name}", value))
        for name, value in (("STAND", script["stand_time"]), ("WALK", script["walk_time"]), ("SPEED", 0.3))
    )
    run["script"] = script | {"stand_time": stand, "walk_time": walk}
    for folder in (tmp_path / "first", tmp_path / "second"):
        folder.mkdir()
        try:
            result = sim2sim_sdk.run_script(run, folder, sim2sim_sdk.config().limit)
        except Unavailable as error:
            unavailable(error)
        print(json.dumps(result))
        if not STALLED.search(result["failure"]):
            break
    case, given = sim2sim_sdk.judged(result), sim2sim_sdk.config()
    assert case["survived"], case["reason"]
    assert case["drift"] < given.drift_max and result["stood"] >= stand
    assert case["pushes"] == 4 and case["walked"] > given.distance * walk / script["walk_time"]
    assert case["odometry"] * case["walked"] < given.odometry_max * given.distance  # also of a shorter walk
    assert "mode_machine changed to 4" in result["stopped"]
    assert result["kp"] == 0.0 and result["kd"] > 0.0 and case["stop"] <= given.stop_max  # the robot's time
    assert 0.0 < case["answer_ms"]["p50"] <= case["answer_ms"]["p99"] <= case["answer_ms"]["max"]


@pytest.fixture
def session(tmp_path: Path) -> Iterator[HardwareSession]:
    needs_types()
    with HardwareSession("ros", tmp_path, graph_domain=free_domain(), robot_domain=free_domain()) as standing:
        standing.stand()
        yield standing


def damped(session: HardwareSession) -> bool:
    report = session.robot("report")
    return bool(report["kp"] == 0.0 and report["kd"] > 0.0)


@slow
def test_a_killed_driver_is_replaced_by_the_guard_and_then_only_damps(session: HardwareSession) -> None:
    graph = session.graph
    received = session.robot("report")["received"]
    os.kill(graph.pids["bridge.nodes.robot_driver"], signal.SIGKILL)
    graph.wait_for(lambda: damped(session), 20.0, "damping")
    assert session.robot("report")["received"] > received
    graph.wait_for(lambda: session.start.state == "damped", 60.0, "the next driver")
    assert "the driver ended without damping" in session.waits_for
    accepted, answer = graph.call("start/prepare")
    assert not accepted and "start it again" in answer
    assert damped(session)


@slow
def test_faults_of_the_network_and_the_processes(session: HardwareSession) -> None:
    graph = session.graph

    def held() -> bool:
        return "guard process silent for more than 1 s" in session.start.holds

    for number in (signal.SIGKILL, signal.SIGSTOP):
        first = graph.pids["bridge.nodes.damping_guard"]
        os.kill(first, number)
        session.wait_for(held, "held")
        session.wait_for(
            lambda first=first: graph.pids["bridge.nodes.damping_guard"] != first and not held(), "replaced"
        )
        assert graph.standing
    os.kill(graph.pids["bridge.nodes.control"], signal.SIGKILL)
    graph.wait_for(lambda: damped(session), 20.0, "damping")
    graph.wait_for(lambda: graph.driver_state == "damped", 20.0, "damped")
    assert "no command of the controller" in session.waits_for


@slow
def test_the_end_lowers_the_robot_if_asked(tmp_path: Path) -> None:
    needs_types()
    ending = overlaid(default_config(EndConfig, "bridge", "ending"), {"relax_limit": 20.0, "sink_time": 4.0}, "ending")
    domains = {"graph_domain": free_domain(), "robot_domain": free_domain()}
    options = "{speed: 0.5}"
    with HardwareSession("ros", tmp_path, "g1", 500, 0.5, plant_options=options, **domains) as session:
        session.stand()
        height = session.robot("report")["base"][2]
        lower(session.graph, ending)
        assert "the robot was lowered" in session.waits_for
        assert session.robot("report")["base"][2] < 0.3 * height and damped(session)


@slow
def test_the_remote_controller_and_the_end(session: HardwareSession) -> None:
    session.robot("stop", "press", 9)
    session.graph.wait_for(lambda: damped(session), 20.0, "damping")
    assert session.robot("report")["stop_ms"] <= 10  # of the robot's time
    session.wait_for(lambda: "button B" in session.waits_for, "reported")
    session.graph.stop()
    assert damped(session)
    assert set(session.graph.exit_codes.values()) == {0}
