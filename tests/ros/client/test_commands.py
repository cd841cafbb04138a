"""The command line's client."""

import math
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from msgspec.structs import replace
from rclpy.context import Context
from rclpy.node import Node
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger

from bridge.launch.graph import Graph
from bridge.ros import client as client_module
from bridge.ros.client import Client, next_step, overview
from bridge.ros.processes import ProcessSpec
from controllers.commands.command_signature import Signer, Verifier
from models.nodes import topics
from models.nodes.qos import LATCHED
from models.status import GaitStatus, RouteState, RouteStatus, StartStatus, SupervisorStatus
from models.types import Mode
from tests.ros.client.fake_supervisor import FakeSupervisor
from tests.ros.conftest import StatusTopic

pytestmark = pytest.mark.ros


def test_commands_are_answered(supervisor: FakeSupervisor) -> None:
    with Client() as client:
        assert client.command("wave").accepted
        reply = client.command("fly")
        assert not reply.accepted and reply.reason == "unknown command 'fly'"
        assert client.mode == "stand"
        assert client.command("forward").reason == "done: ['forward']"  # without a wait for a motion
        assert client.command("forward 9").reason == "done: ['forward 9']; forward 9 limited to 1.2"
        assert client.command("stop").reason == "done: ['stop']"
        reply = client.trigger("mode/damp")
        assert not reply.accepted and reply.reason == "the robot would drop"
    with Client() as client:  # it opens again
        assert client.command("wave").accepted


def test_the_overview_names_the_next_step(supervisor: FakeSupervisor) -> None:
    with Client() as client:
        found = overview(client)
    assert found["robot"].startswith("g1, mode 'stand'") and found["faults"] == "held"
    record = SupervisorStatus("g1", Mode.STAND, 0, "", ())
    for changes, word in (
        ({}, "poise walk"),
        ({"mode": Mode.WALK}, "poise send stop"),
        ({"faults": ("why",)}, "reset_faults"),
        ({"mode": Mode.DAMP, "fallen": True, "faults": ("fallen",)}, "poise reset"),
        ({"mode": Mode.DAMP, "faults": ("why",)}, "reset_faults; poise mode stand"),
        ({"mode": Mode.OFF, "preflight": ("no joint states",)}, "no joint states"),
        ({"mode": Mode.OFF}, "poise mode stand"),
        ({"locks": ("pause",)}, "'pause': publish false on locks/pause"),
    ):
        assert word in next_step(replace(record, **changes))
    assert "no motion or walk while this lasts: 91 degC" in next_step(record, StartStatus("stand", holds=("91 degC",)))


def test_the_overview_waits_for_the_limit_of_a_walk(supervisor: FakeSupervisor) -> None:
    supervisor.mode.publish(String(data="walk"))
    supervisor.commander.publish(String(data="none"))
    supervisor.factor.publish(Float64(data=1.0))
    StatusTopic(supervisor, topics.START_STATUS, LATCHED).publish(StartStatus("standing"))
    late = threading.Timer(0.5, lambda: supervisor.gait.publish(GaitStatus(True, False, blocked="stopped: a kerb")))
    late.start()
    StatusTopic(supervisor, topics.ROUTE_STATUS, LATCHED).publish(RouteStatus(RouteState.RUNNING, 17))
    with Client() as client:
        client.wait(lambda: bool(client.commander and not math.isnan(client.factor)), 10.0)
        client.driver_state = "active"
        found = overview(client)
    assert found["walk"] == "stopped: a kerb" and found["goal"] == "running: 17 footsteps"
    assert found["in command"] == "none, the robot follows its goal"
    late.join()


def test_a_client_with_a_key_signs(supervisor: FakeSupervisor) -> None:
    key = bytes(range(32))
    began = [time.time_ns() - 100_000_000_000]
    verifier = Verifier(key, 30.0, lambda: began.pop() if began else time.time_ns())
    with Client(signer=Signer(key, "teleop")) as client:
        client.command("wave")
    command = verifier.verify(supervisor.texts[-1])
    assert (command.source, command.text) == ("teleop", "wave")


@pytest.mark.long
def test_every_subscriber_receives_a_command(supervisor: FakeSupervisor, monkeypatch: pytest.MonkeyPatch) -> None:
    """A node of the user subscribes beside the supervisor, and may be discovered later."""
    monkeypatch.setattr(client_module, "DISCOVERY", 3.0)  # on a busy machine
    code = (
        "import rclpy; from std_msgs.msg import String; rclpy.init(); node = rclpy.create_node('student');"
        "node.create_subscription(String, 'humanoid_commands', lambda m: print(m.data, flush=True), 10);"
        "rclpy.spin(node)"
    )
    student = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    try:
        end = time.monotonic() + 20.0
        while supervisor.count_subscribers(topics.HUMANOID_COMMANDS) < 2:
            assert time.monotonic() < end
            time.sleep(0.05)
        for k in range(3):
            with Client() as client:
                client.send(f"word {k}")
                client.spin(0.5)
    finally:
        student.kill()
        words, _ = student.communicate()
    assert words.split("\n") == ["word 0", "word 1", "word 2", ""]


NAME = """
from bridge.ros.client import Client
with Client() as client:
    print(client.node.get_name())
"""


def test_commands_at_the_same_time_have_nodes_of_different_names(context: Context) -> None:
    with Client() as client:
        other = subprocess.run([sys.executable, "-c", NAME], capture_output=True, text=True, timeout=60, check=True)
        assert other.stdout.startswith("poise_client_") and other.stdout.strip() != client.node.get_name()


def test_a_request_at_once_is_answered(supervisor: FakeSupervisor) -> None:
    with Client() as client:
        assert client.trigger("mode/damp", at_once=True).reason == "the robot would drop"


def test_enter_takes_a_step_in_a_client_that_has_joined_before(supervisor: FakeSupervisor) -> None:
    supervisor.create_service(Trigger, "start/damp", supervisor.on_damp)
    program = [sys.executable, "-c", "from bridge.cli import app; app()", "start", "damp", "--on-enter"]
    process = subprocess.Popen(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdin is not None and process.stdout is not None
    try:
        assert process.stdout.readline().startswith("g1, Enter: damp")
        for _ in range(2):
            process.stdin.write("\n")
            process.stdin.flush()
            began = time.monotonic()
            assert process.stdout.readline() == "the robot would drop\n"
            print(f"answered after {1e3 * (time.monotonic() - began):.0f} ms")
        process.stdin.close()
        assert process.wait(20.0) == 0
    finally:
        process.kill()
        process.wait()


def test_the_launcher_reports_why_a_command_was_refused(supervisor: FakeSupervisor, tmp_path: Path) -> None:
    specs = [ProcessSpec("this", (), True)]
    graph = Graph("g1", specs=specs, activation=["none"], log=tmp_path / "log", say=lambda text: None)
    graph.open()
    try:
        graph.wait_for(lambda: graph.mode == "stand", 10.0, "standing")
        graph.spin(0.5)  # until each has discovered the other
        for text, reason in (("fly", "unknown command 'fly'"), ("wave", "")):
            graph.send(text)
            graph.wait_for(lambda text=text: supervisor.texts[-1:] == [text], 10.0, "received")  # type: ignore[misc]
            graph.spin(0.5)
            assert graph.refusal == reason
    finally:
        graph.close()


def test_enter_needs_no_supervisor(context: Context) -> None:
    node = Node("robot_driver", context=context)
    node.create_service(Trigger, "start/damp", lambda request, response: response)
    program = [sys.executable, "-c", "from bridge.cli import app; app()", "start", "damp", "--on-enter"]
    done = subprocess.run(program, input="", capture_output=True, text=True, timeout=60.0)
    assert done.stdout.startswith("robot without supervisor, Enter: damp"), done.stderr
    node.destroy_node()
