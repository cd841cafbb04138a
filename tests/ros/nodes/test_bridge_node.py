"""The bridge's node without its loop: which commands and modes it takes, and what it notes about them."""

import math
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, LaserScan
from std_msgs.msg import Float64, Header, String
from std_srvs.srv import SetBool
from trajectory_msgs.msg import JointTrajectory

from bridge.nodes.robot_driver import RobotDriver
from models.nodes import topics
from models.nodes.cdr import stamp_of
from models.nodes.messages import JointCommandCodec, clock_message, decode, doubles
from models.nodes.perception import scan_from_message
from models.nodes.progress import progress_message
from models.nodes.qos import COMMAND, LATCHED, SENSOR, STATE
from models.robot_model import RobotModel
from models.scan import Scan
from models.types import JointCommand

pytestmark = pytest.mark.ros

MS = 1_000_000


@pytest.fixture
def bridge(bench: Any, tmp_path: Path) -> RobotDriver:
    """In mode stand, at tick 100 of which every one has been published."""
    node: RobotDriver = bench.add(RobotDriver, latency_file=tmp_path / "latency.npz")
    node.commands.on_mode(String(data="stand"))
    for node.tick in range(1, 101):
        node.publish_tick(0.0)
    return node


def _send(bridge: RobotDriver, g1: RobotModel, tick: int, q: float = 0.0) -> bytes:
    zero = np.zeros(g1.nj)
    data = JointCommandCodec(g1).encode(tick * MS, JointCommand(g1.posture("stand") + q, zero, zero))
    bridge.commands.on_command(data)
    return data


def test_commands_that_answer_old_sensors_are_refused(bridge: RobotDriver, g1: RobotModel) -> None:
    _send(bridge, g1, 79)
    assert bridge.counters["commands too old"] == 1
    assert "79000000 ns is 21000000 ns old" in bridge.values["last refusal"]
    _send(bridge, g1, 80)  # 20 ms: just young enough
    assert bridge.counters[f"refused {topics.JOINT_SETPOINTS}"] == 1
    assert bridge.commands.stamp == 80 * MS


def test_only_accepted_commands_count_as_answers(bridge: RobotDriver, g1: RobotModel) -> None:
    """The latency of a command that is refused is no latency."""
    received = bridge._probe.rows()["received"]  # type: ignore[union-attr]
    _send(bridge, g1, 101)  # not yet due
    _send(bridge, g1, 70)  # too old
    _send(bridge, g1, 90, q=float("nan"))
    assert not received.any()
    _send(bridge, g1, 90)
    _send(bridge, g1, 85)  # overtaken
    assert np.flatnonzero(received).tolist() == [90]


def test_sensors_may_be_published_at_a_part_of_the_tick_rate(bench: Any, g1: RobotModel, tmp_path: Path) -> None:
    seen: list[int] = []
    node: RobotDriver = bench.add(RobotDriver, latency_file=tmp_path / "slow.npz", sensor_rate=500.0)
    bench.world.create_subscription(
        JointState, topics.JOINT_STATES, lambda data: seen.append(stamp_of(data)), SENSOR, raw=True
    )
    bench.wait(lambda: bench.world.count_publishers(topics.JOINT_STATES))
    bench.spin(0.5)
    for node.tick in range(1, 9):
        node.publish_tick(0.0)
        bench.spin(0.02)
        assert node.answered == (node.tick % 2 == 1)  # what was not published needs no answer
    assert seen == [tick * MS for tick in (2, 4, 6, 8)]
    probe = node._probe
    assert probe is not None and np.flatnonzero(probe.rows()["sent"]).tolist() == [2, 4, 6, 8]


def test_a_rate_that_the_tick_rate_is_no_multiple_of_is_refused(bench: Any) -> None:
    node = bench.add(RobotDriver, sensor_rate=300.0)
    assert not node.active and "1000 Hz is not a multiple of 300 Hz" in node.message


def _message(g1: RobotModel, how: str) -> JointTrajectory:
    """A command that answers tick 100, corrupted in one way."""
    values = np.array([g1.posture("stand") + 0.001, np.full(g1.nj, 0.01), np.full(g1.nj, 0.1)])
    message = decode(JointCommandCodec(g1).encode(100 * MS, JointCommand(*values)), JointTrajectory)
    names, point, knee = list(g1.joint_names), message.points[0], g1.joint_index("left_knee_joint")
    fields = ("positions", "velocities", "effort")
    if how == "missing":
        message.joint_names = names[:-1]
        for field in fields:
            setattr(point, field, getattr(point, field)[:-1])
    elif how == "reordered":
        message.joint_names = names[::-1]
        for field in fields:
            setattr(point, field, getattr(point, field)[::-1])
    elif how == "duplicate":
        message.joint_names = [*names[:-1], "left_knee_joint"]
    elif how == "unknown":
        message.joint_names = [*names[:-1], "tail_joint"]
    elif how == "nan":
        point.effort[knee] = math.nan
    elif how in ("jump", "limits"):
        point.velocities, point.effort = doubles(np.zeros(g1.nj)), []  # a trajectory then, judged as one
        point.time_from_start.nanosec = 1 if how == "jump" else 500 * MS
        point.positions[knee] += 0.5
        if how == "limits":
            point.positions[knee] = g1.q_upper[knee] + 0.1
    elif how == "stale":
        message.header.stamp.nanosec = 79 * MS
    elif how == "backward":
        message.header.stamp.nanosec = 98 * MS
    elif how == "repeated":
        message.header.stamp.nanosec = 99 * MS
    return message


@pytest.mark.parametrize(
    ("how", "culprit"),
    [
        ("good", ""),
        ("reordered", ""),
        ("missing", "is missing"),
        ("duplicate", "'left_knee_joint' is given twice"),
        ("unknown", "tail_joint"),
        ("nan", "effort of left_knee_joint is nan"),
        ("jump", "'left_knee_joint', point 0: start jump"),
        ("limits", "'left_knee_joint', point 0: position"),
        ("stale", "header.stamp: 79000000 ns is not after 99000000 ns"),
        ("backward", "header.stamp: 98000000 ns is not after 99000000 ns"),
        ("repeated", "header.stamp: 99000000 ns is not after 99000000 ns"),
    ],
)
def test_commands_over_the_graph(bench: Any, bridge: RobotDriver, g1: RobotModel, how: str, culprit: str) -> None:
    """With stamps that are due: each is taken, or refused by name without a trace in the drivers."""
    _send(bridge, g1, 99)
    before = bridge.drivers.servo.setpoint
    publisher = bench.world.create_publisher(JointTrajectory, topics.JOINT_SETPOINTS, COMMAND)
    bench.wait(lambda: publisher.get_subscription_count() == 1)
    publisher.publish(_message(g1, how))
    if not culprit:
        bench.wait(lambda: bridge.commands.stamp == 100 * MS)
        setpoint = bridge.drivers.servo.setpoint
        np.testing.assert_array_equal(setpoint.q, np.clip(g1.posture("stand") + 0.001, g1.q_lower, g1.q_upper))
        np.testing.assert_array_equal(setpoint.v, 0.01)
        np.testing.assert_array_equal(setpoint.tau, 0.1)
        return
    bench.wait(lambda: bridge.counters[f"refused {topics.JOINT_SETPOINTS}"] == 1)
    assert culprit in bridge.values["last refusal"]
    assert bridge.commands.stamp == 99 * MS
    np.testing.assert_array_equal(bridge.drivers.servo.setpoint.q, before.q)


def test_an_answer_that_comes_twice_is_not_refused(bench: Any, bridge: RobotDriver, g1: RobotModel) -> None:
    data = _send(bridge, g1, 99)
    bridge.commands.on_command(data)
    assert bridge.commands.stamp == 99 * MS
    assert bridge.counters[f"refused {topics.JOINT_SETPOINTS}"] == 0


def test_a_held_robot_that_is_put_back_is_said_to_be_held_again(bench: Any, bridge: RobotDriver) -> None:
    seen: list[str] = []
    bench.world.create_subscription(String, topics.DRIVER_STATE, lambda message: seen.append(message.data), LATCHED)
    bench.wait(lambda: seen == [topics.HELD])
    bridge.restart()
    bench.wait(lambda: seen == [topics.HELD, topics.HELD])


def test_time_goes_on_after_a_reset_and_a_restart(bridge: RobotDriver) -> None:
    for again in ([bridge.restart], [bridge.trigger_deactivate, bridge.trigger_activate]):
        bridge.paused = True
        assert not bridge.running
        for each in again:
            each()
        assert bridge.running


def test_a_pause_is_published_at_once(bench: Any, bridge: RobotDriver) -> None:
    seen: list[float] = []
    bench.world.create_subscription(Float64, topics.REAL_TIME_FACTOR, lambda m: seen.append(m.data), LATCHED)
    bench.wait(lambda: bench.world.count_publishers(topics.REAL_TIME_FACTOR))
    bridge._pause(True)
    bench.wait(lambda: seen[-1:] == [0.0])
    bridge.restart()
    bench.wait(lambda: math.isnan(seen[-1]))


def test_unknown_modes_are_refused_by_name(bridge: RobotDriver) -> None:
    bridge.commands.on_mode(String(data="fly"))
    assert bridge.counters[f"refused {topics.MODE}"] == 1
    assert "unknown mode 'fly'" in bridge.values["last refusal"]
    assert bridge.drivers.awaits_command


def test_the_ground_is_laid_or_refused(bench: Any) -> None:
    bridge = bench.add(RobotDriver, terrain="slope_up")
    assert bridge.drivers.plant.ground.height(5.0, 0.0) > 0.5
    bench.remove(bridge)
    bridge = bench.add(RobotDriver, active=False, terrain="lava")
    assert "terrain: unknown 'lava'; known: flat, tiles" in bridge.message


def _tick_until(bridge: RobotDriver, tick: int) -> None:
    while bridge.tick < tick:
        bridge.step()
        bridge.publish_tick(0.0)


def test_scans_come_at_their_rate_and_show_the_obstacle(bench: Any, g1: RobotModel) -> None:
    bridge: RobotDriver = bench.add(RobotDriver, terrain="box", sensor_noise=False)
    scans: list[Scan] = []
    bench.world.create_subscription(LaserScan, topics.SCAN, lambda m: scans.append(scan_from_message(m)), SENSOR)
    bench.wait(lambda: bridge._scan._publisher.get_subscription_count() == 1)

    def scan_at(tick: int) -> Scan:
        """One at a time: only the newest is kept."""
        _tick_until(bridge, tick)
        bench.wait(lambda: scans and scans[-1].t == pytest.approx(1e-3 * tick))
        return scans[-1]

    for tick in (100, 200, 300):
        assert np.isposinf(scan_at(tick).ranges).all()
    assert [round(scan.t * 1e9) for scan in scans] == [100 * MS, 200 * MS, 300 * MS]
    bridge.publish_tick(0.0)  # lockstep asks again: the scan is not repeated
    bench.spin(0.05)
    assert len(scans) == 3

    client = bench.world.create_client(SetBool, "obstacle")
    bench.wait(client.service_is_ready)

    def ask(there: bool) -> Any:
        answer = client.call_async(SetBool.Request(data=there))
        bench.wait(answer.done)
        return answer.result()

    reply = ask(True)
    assert reply.success and reply.message == "obstacle at (2, 0) m"
    start = g1.standing_configuration()[0] + g1.profile.frames["scan"].xyz[0]
    assert scan_at(400).points[:, 0].min() == pytest.approx(1.8 - start, abs=0.01)
    assert ask(False).message == "no obstacle"
    assert np.isposinf(scan_at(500).ranges).all()


def test_without_a_request_there_is_no_scan(bench: Any, bridge: RobotDriver) -> None:
    bridge._scan._scanner.scan = None  # type: ignore[method-assign,assignment]
    _tick_until(bridge, 200)


def test_an_obstacle_that_there_is_not_is_refused(bench: Any, bridge: RobotDriver) -> None:
    client = bench.world.create_client(SetBool, "obstacle")
    bench.wait(client.service_is_ready)
    answer = client.call_async(SetBool.Request(data=True))
    bench.wait(answer.done)
    assert not answer.result().success
    assert "start with the terrain 'box' or 'wall'" in answer.result().message


def _publish(node: RobotDriver, first: int, last: int) -> None:
    """Enter mode stand, and publish the sensors of ticks up to the last one."""
    node.commands.on_mode(String(data="stand"))
    for node.tick in range(first, last + 1):
        node.publish_tick(0.0)


def test_simulated_time_waits_for_late_commands_but_not_for_ever(
    bench: Any, g1: RobotModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    node: RobotDriver = bench.add(RobotDriver, real_time="yield", yield_lag=0.005, yield_max=1.0)
    _publish(node, 1, 4)
    assert not node.behind
    for node.tick in range(5, 101):
        node.publish_tick(0.0)
    now = [10.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    assert node.behind  # no command since the mode began
    _send(node, g1, 96)
    assert not node.behind
    node.tick = 103
    node.publish_tick(0.0)
    assert node.behind and node.counters["waits for commands"] == 2
    now[0] += 1.1
    assert not node.behind  # the controller is dead: time goes on, and the drivers damp
    _send(node, g1, 103)
    assert not node.behind
    node.tick = 120
    assert node.behind


def test_simulated_time_waits_for_a_supervisor_that_lags(
    bench: Any, g1: RobotModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    node: RobotDriver = bench.add(RobotDriver, yield_supervisor=0.06)
    _publish(node, 1, 100)
    _send(node, g1, 100)
    assert not node.behind  # it has not judged a state in this mode
    node.commands.judged = 30_000_000
    assert node.behind
    node.commands.judged = 90_000_000
    assert not node.behind
    now = [10.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    node.commands.judged = 30_000_000
    assert node.behind
    now[0] += 1.1 * node.config.yield_max
    assert not node.behind  # the supervisor is dead: time goes on
    for node.tick in range(101, 111):
        node.publish_tick(0.0)
    assert node.behind  # for the commands


def test_simulated_time_waits_for_the_supervisor_in_the_held_start_too(bench: Any) -> None:
    """So an estimator that lags loses no samples. States from before a restart do not count."""
    node: RobotDriver = bench.add(RobotDriver, yield_supervisor=0.06)
    publisher = bench.world.create_publisher(Clock, topics.SUPERVISOR_TIME, STATE)
    bench.wait(publisher.get_subscription_count)
    for node.tick in range(1, 101):
        node.publish_tick(0.0)
    assert node.drivers.state == topics.HELD and not node.behind
    publisher.publish(clock_message(30_000_000))
    bench.wait(lambda: node.behind)
    node.restart()
    assert not node.behind
    publisher.publish(clock_message(30_000_000))
    bench.spin(0.2)
    assert node.commands.judged == 0 and not node.behind
    for node.tick in range(101, 201):
        node.publish_tick(0.0)
    publisher.publish(clock_message(110_000_000))
    bench.wait(lambda: node.behind)


def test_simulated_time_waits_for_each_node_of_the_perception(
    bench: Any, g1: RobotModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A slow computer is no latency of the robot."""
    node: RobotDriver = bench.add(RobotDriver, yield_perception=0.03)
    _publish(node, 1, 100)
    _send(node, g1, 100)
    publisher = bench.world.create_publisher(Header, topics.PERCEPTION_TIME, STATE)
    bench.wait(publisher.get_subscription_count)
    assert not node.behind  # there are none

    def report(name: str, stamp: int) -> None:
        publisher.publish(progress_message(name, stamp * 1_000_000))

    for stamp, waits in ((60, True), (90, False), (60, True), (0, False), (60, True)):
        report("sensors", stamp)
        bench.wait(lambda waits=waits: node.behind is waits)
    report("sensors", 90)
    report("mapper", 60)
    bench.wait(lambda: node.behind and node.counters["waits for mapper"] == 1)
    report("sensors", 60)
    report("mapper", 0)
    bench.wait(lambda: "mapper" not in node._perception.reached)
    assert node.behind  # of the sensors
    now = [time.monotonic() + 1.1 * node.config.yield_max]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    assert not node.behind  # the node has ended
    node.commands.on_mode(String(data="damp"))
    assert not node.behind
    _publish(node, 101, 150)
    _send(node, g1, 150)
    assert not node.behind  # still without it


def test_time_does_not_wait_for_states_that_the_perception_has_not_received(bench: Any, g1: RobotModel) -> None:
    """At 25 Hz the newest sensors are of 80 ms, while the true state is of 90 ms."""
    node: RobotDriver = bench.add(RobotDriver, yield_perception=0.02, sensor_rate=25.0)
    _publish(node, 1, 99)
    _send(node, g1, 80)
    node._perception.reached["mapper"] = 40_000_000
    assert not node.behind


def test_slow_time_is_reported_with_what_it_waited_for(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    node: RobotDriver = bench.add(RobotDriver)
    said: list[str] = []
    logger = SimpleNamespace(warning=lambda text, **_: said.append(text))
    monkeypatch.setattr(node, "get_logger", lambda: logger)
    node._status.real_time_factor = 0.5
    node.before_diagnostics()
    node._waited.update({"commands": 0.3, "terrain_mapper": 0.5})
    node.before_diagnostics()
    assert said[0].startswith("simulated time runs at 0.50 of real time: ")
    assert "0.50 of real time and waited longest for terrain_mapper: " in said[1]


def test_time_does_not_wait_for_the_perception_before_it_has_a_state(bench: Any, g1: RobotModel) -> None:
    node: RobotDriver = bench.add(RobotDriver, yield_perception=0.02, slow_rate=20.0)
    _publish(node, 1, 99)
    _send(node, g1, 99)
    node._perception.reached["sensors"] = 50_000_000  # the newest published state
    assert not node.behind


def test_strict_time_waits_for_no_command(bench: Any, g1: RobotModel) -> None:
    node: RobotDriver = bench.add(RobotDriver, real_time="strict")
    _publish(node, 1, 100)
    _send(node, g1, 96)
    node.tick = 150
    assert not node.behind
