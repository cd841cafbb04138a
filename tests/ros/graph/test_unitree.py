"""The graph drives a robot over Unitree's protocol, in real time: Unitree's SDK on the far end of a cable, and faults.

Times are the robot's, which waits while this machine is busy; no time of this machine is asserted.
"""

import json
import os
import signal
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from bridge.launch.ending import EndConfig, lower
from bridge.ros.environment import free_domain
from models.config import default_config, overlaid
from models.errors import MessageError
from models.nodes.interfaces import interface
from tests.ros.cable import staged
from tests.unitree.session import Session

pytestmark = [pytest.mark.ros, pytest.mark.graph]
slow = pytest.mark.slow

STAGE = '''
"""The driver and its graph here; the robot, which is Unitree's SDK around MuJoCo, on the other machine of a cable."""
import json, sys
from pathlib import Path

from tests.ros.cable import two_machines
from tests.unitree.session import Session

stand, walk, speed, impulse, sides = map(float, sys.argv[1:])
with two_machines() as there, Session(
    "sdk", Path.cwd(), graph_domain=7, interface="cable0", robot_interface="cable1", command=there, speed=speed
) as session:
    result = {}
    session.stand()
    session.robot("clear")
    before = session.robot("report")
    session.pass_time(stand)
    after = session.robot("report")
    result["drift"] = [a - b for a, b in zip(after["base"], before["base"])]
    result["stood"] = after["t"] - before["t"]
    session.wave()
    session.pass_time(1.0)
    result["pushes"] = []
    for x, y in ((0, 1), (0, -1), (1, 0), (-1, 0))[:int(sides)]:
        session.robot("push", x * impulse / 0.2, y * impulse / 0.2, 0.0, 0.2)
        session.pass_time(3.0)
        result["pushes"].append(session.graph.standing)
    before, odometry = session.robot("report"), session.odometry
    session.walk(0.4, walk)
    session.pass_time(1.0)
    after, reached = session.robot("report"), session.odometry
    result["walked"] = [a - b for a, b in zip(after["base"], before["base"])]
    result["odometry"] = [a - b for a, b in zip(reached, odometry)]
    result["state"] = [session.graph.mode, session.graph.driver_state]
    session.robot("stop", "set", "mode_machine", 4)  # damps at once, as a button: the SDK's robot has no remote
    session.graph.wait_for(lambda: session.start.state == "damped", 20.0, "damped")
    result["stopped"] = session.start.waits_for
    session.pass_time(0.5)
    result["robot"] = session.robot("report")
    result["sample to command [ms]"] = session.value("sample to command [ms]")
print(json.dumps(result))
'''


def needs_types() -> None:
    try:
        interface("unitree_hg", "msg", "LowState")
    except MessageError as error:
        pytest.skip(str(error))


@pytest.mark.parametrize(
    "given",
    [
        {"STAND": "2", "WALK": "4", "SPEED": "0.5", "IMPULSE": "8", "SIDES": "1"},
        pytest.param({"STAND": "60", "WALK": "28", "SPEED": "0.5", "IMPULSE": "12", "SIDES": "4"}, marks=slow),
    ],
    ids=["short", "full"],
)
def test_unitrees_sdk_behind_a_cable(tmp_path: Path, root: Path, given: dict[str, str]) -> None:
    """Stand, wave, pushes, walk and a stop, at half speed: two busy cores do not carry robot and graph in real time.

    ``POISE_UNITREE_STAND`` and the like change the times [s], the robot's speed, the impulse [N.s] and its directions.
    """
    needs_types()
    if find_spec("unitree_interface") is None:
        pytest.skip("pip install far-unitree-sdk")
    values = [os.environ.get(f"POISE_UNITREE_{name}", usual) for name, usual in given.items()]
    result = staged({"stage.py": STAGE}, values, tmp_path, root, timeout=580.0)
    print(json.dumps(result))
    assert np.abs(result["drift"]).max() < 0.01
    assert result["state"] == ["stand", "active"]
    walked, odometry = np.linalg.norm(result["walked"][:2]), np.linalg.norm(result["odometry"])
    assert walked > 0.25 * float(values[1])
    assert all(result["pushes"])
    assert "mode_machine changed to 4" in result["stopped"]
    assert result["robot"]["kp"] == 0.0 and result["robot"]["kd"] > 0.0 and result["robot"]["stop_ms"] is not None
    assert abs(odometry - walked) < 0.05 + 0.01 * walked


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    needs_types()
    with Session("ros", tmp_path, graph_domain=free_domain(), robot_domain=free_domain()) as standing:
        standing.stand()
        yield standing


def damped(session: Session) -> bool:
    report = session.robot("report")
    return bool(report["kp"] == 0.0 and report["kd"] > 0.0)


@slow
def test_a_killed_driver_is_replaced_by_the_guard_and_then_only_damps(session: Session) -> None:
    graph = session.graph
    received = session.robot("report")["received"]
    os.kill(graph.pids["bridge.nodes.robot_driver"], signal.SIGKILL)
    graph.wait_for(lambda: damped(session), 20.0, "damping")
    assert session.robot("report")["received"] > received
    graph.wait_for(lambda: session.start is not None and session.start.state == "damped", 60.0, "the next driver")
    assert "the driver ended without damping" in (session.start.waits_for if session.start else "")
    accepted, answer = graph.call("start/prepare")
    assert not accepted and "start it again" in answer
    assert damped(session)


@slow
def test_faults_of_the_network_and_the_processes(session: Session) -> None:
    graph = session.graph
    os.kill(graph.pids["bridge.nodes.damping_guard"], signal.SIGKILL)
    session.pass_time(2.0)
    assert graph.standing  # and the guard runs again
    os.kill(graph.pids["bridge.nodes.control"], signal.SIGKILL)
    graph.wait_for(lambda: damped(session), 20.0, "damping")
    graph.wait_for(lambda: graph.driver_state == "damped", 20.0, "damped")
    assert session.start is not None and "no command of the controller" in session.start.waits_for


@slow
def test_the_end_lowers_the_robot_if_asked(tmp_path: Path) -> None:
    needs_types()
    ending = overlaid(default_config(EndConfig, "bridge", "ending"), {"relax_limit": 20.0, "sink_time": 4.0}, "ending")
    domains = {"graph_domain": free_domain(), "robot_domain": free_domain()}
    with Session("ros", tmp_path, speed=0.5, **domains) as session:
        session.stand()
        height = session.robot("report")["base"][2]
        lower(session.graph, ending)
        assert session.start is not None and "the robot was lowered" in session.start.waits_for
        assert session.robot("report")["base"][2] < 0.3 * height and damped(session)


@slow
def test_the_remote_controller_and_the_end(session: Session) -> None:
    session.robot("press", 9)
    session.graph.wait_for(lambda: damped(session), 20.0, "damping")
    assert session.start is not None
    session.graph.wait_for(lambda: "button B" in (session.start.waits_for if session.start else ""), 10.0, "reported")
    session.graph.stop()
    assert damped(session)
    assert set(session.graph.exit_codes.values()) == {0}
