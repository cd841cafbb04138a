"""What the page receives and sends, against a graph of a few fake topics."""

import html
import socket
import threading
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Twist, WrenchStamped
from nav_msgs.msg import Odometry, Path
from rcl_interfaces.msg import SetParametersResult
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger

from bridge.ros.client import Client
from bridge.ros.operator import SOURCE, Operator
from bridge.view.controls import Controls
from bridge.view.listener import START, Listener, ViewConfig
from models.config import default_config
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.messages import JointStateCodec, WrenchCodec
from models.nodes.odometry import OdometryCodec
from models.nodes.parameters import describe
from models.nodes.qos import COMMAND, EVENT, LATCHED, LATCHED_EVENT, SENSOR
from models.robot_model import SOLE_FRAMES, RobotModel
from models.status import GET_UP, ControlStatus, StartStatus, SupervisorStatus
from models.types import Mode, SolveStatus
from planners.gait.footsteps import LEFT, Foothold
from planners.gait.route import Footstep
from planners.gait.scaling import load_gait_config
from planners.nodes.footstep_messages import path_from_steps
from tests.ros.conftest import STAMP, Bench, StatusTopic
from tests.support import standing

viser = pytest.importorskip("viser")
pytestmark = pytest.mark.ros
CONFIG = default_config(ViewConfig, "bridge", "view")


@pytest.fixture
def client(bench: Bench) -> Iterator[Client]:
    with Client() as made:
        yield made


def until(client: Client, bench: Bench, condition: Any, publish: Any = lambda: None) -> None:
    """Publish and serve both sides until a condition holds."""

    def holds() -> bool:
        publish()
        bench.spin(0.01)
        return bool(condition())

    assert client.wait(holds, 10.0)


def test_a_moment_is_what_the_topics_tell(client: Client, bench: Bench, g1: RobotModel) -> None:
    listener = Listener(g1, client, CONFIG)
    state, wrench = standing(g1), np.array([1.0, 2.0, 300.0, 0.1, 0.2, 0.3])
    world = bench.world
    joints = world.create_publisher(JointState, topics.JOINT_STATES, SENSOR)
    odom = world.create_publisher(Odometry, topics.ODOM, SENSOR)
    feet = [world.create_publisher(WrenchStamped, topic, SENSOR) for topic in topics.foot_wrenches(g1)]
    mode = world.create_publisher(String, topics.MODE, LATCHED)
    steps = world.create_publisher(Path, topics.FOOTSTEPS, EVENT)
    diagnostics = world.create_publisher(DiagnosticArray, "/diagnostics", EVENT)
    status = DiagnosticStatus(name="/balance_controller", level=DiagnosticStatus.WARN, message="late")
    control = StatusTopic(world, topics.CONTROL_STATUS)
    ticks = ControlStatus(True, SolveStatus.OPTIMAL, 0, "", tick_median_us=98.0, tick_tail_us=150.0)

    def publish() -> None:
        joints.publish(JointStateCodec(g1).encode(STAMP, state.q[7:], state.v[6:], np.full(g1.nj, 2.0)))
        odom.publish(OdometryCodec().encode(STAMP, state))
        for publisher, frame in zip(feet, SOLE_FRAMES, strict=True):
            publisher.publish(WrenchCodec(frame).encode(STAMP, wrench))
        mode.publish(String(data="walk"))
        steps.publish(path_from_steps(STAMP, [Footstep(LEFT, Foothold(0.3, 0.1, 0.2))]))
        diagnostics.publish(DiagnosticArray(status=[status]))
        control.publish(ticks)

    def received() -> bool:
        moment, words = listener.poll(), listener.words()
        return (
            moment is not None
            and bool(moment.footsteps)
            and moment.wrenches[1, 2] == 300.0
            and bool(words.faults)
            and words.tick_tail > 0.0
            and words.mode == "walk"
        )

    until(client, bench, received, publish)
    moment, words = listener.poll(), listener.words()
    assert moment is not None
    np.testing.assert_allclose(moment.q, state.q)
    np.testing.assert_array_equal(moment.tau, np.full(g1.nj, 2.0))
    np.testing.assert_array_equal(moment.wrenches, [wrench, wrench])
    ((foot, hold),) = moment.footsteps
    assert foot == LEFT and (hold.x, hold.y, hold.yaw) == pytest.approx((0.3, 0.1, 0.2))
    assert not words.waiting and words.faults == (("/balance_controller", "late"),)
    assert (words.tick_median, words.tick_tail) == (98.0, 150.0)
    listener.close()


def test_a_malformed_message_is_counted_and_left_out(client: Client, bench: Bench, g1: RobotModel) -> None:
    listener = Listener(g1, client, CONFIG)
    joints = bench.world.create_publisher(JointState, topics.JOINT_STATES, SENSOR)
    until(
        client,
        bench,
        lambda: listener.poll() is None and listener.words().faults[-1][0] == "/joint_states",
        lambda: joints.publish(JointState(name=["tail"])),
    )
    assert "0 values for 1 names" in listener.words().faults[-1][1]
    listener.close()


def test_before_and_after_the_data_it_is_named_what_is_waited_for(client: Client, bench: Bench, g1: RobotModel) -> None:
    listener = Listener(g1, client, replace(CONFIG, silence=0.5))
    words = listener.words()
    assert listener.poll() is None and words.next == START
    assert words.waiting == "waiting for data on /joint_states, /odom, /foot/left/wrench, /foot/right/wrench"
    assert words.faults[0] == ("/joint_states", "no data for 0 s")
    state, zero = standing(g1), np.zeros(g1.nj)
    joints = bench.world.create_publisher(JointState, topics.JOINT_STATES, SENSOR)
    odom = bench.world.create_publisher(Odometry, topics.ODOM, SENSOR)

    def publish() -> None:
        joints.publish(JointStateCodec(g1).encode(STAMP, state.q[7:], state.v[6:], zero))
        odom.publish(OdometryCodec().encode(STAMP, state))

    feet = "waiting for data on /foot/left/wrench, /foot/right/wrench"
    until(client, bench, lambda: listener.poll() is not None and listener.words().waiting == feet, publish)
    until(client, bench, lambda: listener.poll() is not None and "/joint_states" in listener.words().waiting)
    listener.close()


def test_the_start_and_the_monitors_of_a_real_robot(client: Client, bench: Bench, g1: RobotModel) -> None:
    listener, world = Listener(g1, client, CONFIG), bench.world
    assert listener.words().start == ()
    start = StatusTopic(world, topics.START_STATUS, LATCHED)
    supervisor = StatusTopic(world, topics.SUPERVISOR_STATUS, LATCHED)
    diagnostics = world.create_publisher(DiagnosticArray, "/diagnostics", EVENT)
    world.create_publisher(Float64, topics.REAL_TIME_FACTOR, LATCHED).publish(Float64(data=0.0))  # no samples yet
    until(client, bench, lambda: client.factor == 0.0)
    values = ("hottest motor [degC]: 91 (left_knee_joint)", "lowest voltage [V]: 44.0")
    status = StartStatus("hanging", "the operator: call start/lower", ("44 V",), ("91 degC",), values)

    def publish() -> None:
        start.publish(status)
        supervisor.publish(SupervisorStatus("g1", Mode.OFF, 0, "", ()))
        diagnostics.publish(DiagnosticArray(status=[DiagnosticStatus(name="/robot_driver")]))

    until(client, bench, lambda: listener.words().next == "the operator: call start/lower", publish)
    shown = (("start", "hanging"), ("monitors", "91 degC; 44 V"), ("values", "; ".join(values)))
    assert listener.words().start == shown and "real-time factor" not in dict(listener.words().faults)
    listener.close()


def test_whatever_is_red_has_its_reason_and_the_remedy(
    client: Client, bench: Bench, g1: RobotModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = bench.world
    refusals = world.create_publisher(DiagnosticStatus, topics.REFUSALS, LATCHED_EVENT)
    refusals.publish(DiagnosticStatus(name="/gait_planner", message="refused before the page was opened"))
    listener = Listener(g1, client, CONFIG)
    until(client, bench, lambda: refusals.get_subscription_count() > 0)
    client.spin(0.3)
    assert "/gait_planner" not in dict(listener.words().faults)
    diagnostics = world.create_publisher(DiagnosticArray, "/diagnostics", EVENT)
    factor = world.create_publisher(Float64, topics.REAL_TIME_FACTOR, LATCHED)
    mode = world.create_publisher(String, topics.MODE, LATCHED)
    supervisor = StatusTopic(world, topics.SUPERVISOR_STATUS, LATCHED)
    status = DiagnosticStatus(name="/supervisor", level=DiagnosticStatus.ERROR, message="the robot has fallen")
    fallen = SupervisorStatus("g1", Mode.DAMP, 0, "", ("the robot has fallen",), fallen=True)

    def publish() -> None:
        diagnostics.publish(DiagnosticArray(status=[status]))
        factor.publish(Float64(data=0.25))
        refusals.publish(DiagnosticStatus(name="/supervisor", message="commands/teleop refused: unknown command 'jmp'"))
        mode.publish(String(data="damp"))
        supervisor.publish(fallen)

    until(client, bench, lambda: len(listener.words().faults) == 8 and listener.words().next == GET_UP, publish)
    assert listener.words().faults[4:] == (
        ("/supervisor", "the robot has fallen"),
        ("/supervisor", "commands/teleop refused: unknown command 'jmp'"),
        ("real-time factor", "0.25: other programs use the processor, or a lower speed was requested"),
        ("mode", "damp: no controller supports the robot"),
    )
    server = viser.ViserServer(host="127.0.0.1", port=free_port(), verbose=False)
    try:
        shown = SimpleNamespace(content="")
        monkeypatch.setattr(server.gui, "add_html", lambda _: shown)
        controls = Controls(server.gui, Operator(client, print), CONFIG, ["wave"], load_gait_config(g1).velocity)
        words = listener.words()
        controls.show(None, words)
        for name, reason in (*words.faults, ("next", GET_UP), ("gait", "none")):
            assert f"<b>{name}</b>: {html.escape(reason)}" in shown.content
        assert words.waiting in shown.content
        factor.publish(Float64(data=0.0))
        until(client, bench, lambda: "ends a pause" in listener.words().next)
        assert "real-time factor" not in dict(listener.words().faults)
    finally:
        server.stop()
        listener.close()


def test_a_rate_is_kept_by_late_and_by_seldom_calls() -> None:
    from bridge.view.page import Every

    for step, calls in ((0.001, 101), (1 / 30, 101), (0.0334, 101), (0.08, 101), (0.25, 41)):
        every = Every(10.0, 0.0)
        assert abs(sum(every.due(step * i) for i in range(round(10.0 / step) + 1)) - calls) <= 1
    assert not every.due(every.next - 0.01)


def test_words_velocities_and_pushes_reach_the_robot(client: Client, bench: Bench) -> None:
    reported: list[str] = []
    operator = Operator(client, reported.append)
    word, velocity = topics.source_topics(SOURCE)
    words: list[str] = []
    twists: list[float] = []
    pushes: list[tuple[str, float]] = []
    listen = bench.world.create_subscription
    listen(String, word, lambda message: words.append(message.data), EVENT)
    listen(Twist, velocity, lambda message: twists.append(message.linear.x), COMMAND)
    listen(
        WrenchStamped,
        topics.PUSH,
        lambda message: pushes.append((message.header.frame_id, message.wrench.force.y)),
        EVENT,
    )
    until(client, bench, lambda: bool(twists), lambda: operator.drive((0.2, 0.0, 0.0)))
    thread = threading.Thread(target=lambda: operator.post(lambda: operator.say("wave")))  # as the web server does
    thread.start()
    thread.join()
    assert not words
    operator.do_posted()
    operator.push(np.array([0.0, 50.0, 0.0]))
    until(client, bench, lambda: words == ["wave"] and pushes == [("base_link", 50.0)])
    operator.drive(None)
    until(client, bench, lambda: twists[-1] == 0.0)
    count = len(twists)
    operator.drive(None)  # silent now: others are in command again
    bench.spin(0.2)
    assert len(twists) == count and reported == ["sent wave", "pushed with 50 N"]


def test_the_answer_of_a_service_is_reported(client: Client, bench: Bench) -> None:
    reported: list[str] = []
    operator = Operator(client, reported.append)
    operator.call("stand")
    assert reported == ["mode/stand: the service is not available: is the robot up? (poise up)"]

    def refuse(request: Any, response: Any) -> Any:
        response.success, response.message = False, said[0]
        return response

    said = ["fallen: call reset_faults first"]

    bench.world.create_service(Trigger, "mode/stand", refuse)

    def ask() -> None:
        if len(reported) == 1 or reported[-1].endswith("(poise up)"):
            operator.call("stand")

    until(client, bench, lambda: reported[-1].startswith("stand: "), ask)
    assert reported[-1] == "stand: fallen: call reset_faults first"
    said[0] = "stand: standing"  # it names the mode itself: not twice
    operator.call("stand")
    until(client, bench, lambda: reported[-1].endswith("standing"))
    assert reported[-1] == "stand: standing"


def test_sliders_are_those_parameters_that_may_change(client: Client, bench: Bench) -> None:
    from bridge.view.page import Gains

    world, reported = bench.world, list[str]()
    world.declare_parameter("com.kp", 40.0, describe("CoM stiffness [1/s^2]", read_only=False, low=0.0, high=500.0))
    world.declare_parameter("fixed", 1.0, describe("Fixed", low=0.0, high=2.0))

    def judge(parameters: list[Any]) -> SetParametersResult:
        bad = [p.name for p in parameters if p.value > 100.0]
        return SetParametersResult(successful=not bad, reason=f"{bad} too stiff" if bad else "")

    world.add_on_set_parameters_callback(judge)
    operator = Operator(client, reported.append)
    server = viser.ViserServer(host="127.0.0.1", port=free_port(), verbose=False)
    try:
        gains = Gains(server.gui, server.gui.add_folder("gains"), client, operator, "world", reported.append, 1.0)
        until(client, bench, lambda: bool(gains.sliders), gains.ask)
        assert list(gains.sliders) == ["com.kp"]
        slider = gains.sliders["com.kp"]
        assert (slider.min, slider.max, slider.value) == (0.0, 160.0, 40.0)
        gains.move("com.kp", 60.0)
        until(client, bench, lambda: reported == ["com.kp = 60"])
        assert world.get_parameter("com.kp").value == 60.0
        gains.move("com.kp", 120.0)
        until(client, bench, lambda: len(reported) == 2)
        assert "too stiff" in reported[-1] and slider.value == 60.0
        assert world.get_parameter("com.kp").value == 60.0
    finally:
        server.stop()


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def test_a_port_that_is_taken_is_named(client: Client, g1: RobotModel) -> None:
    from bridge.view.page import Page

    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(PoiseError, match=f"127.0.0.1:{port} cannot be opened: .*choose another --port"):
            Page(g1, client, host="127.0.0.1", port=port)
