"""The supervisor's node beside a world of a few topics: what it publishes, and when it holds its tongue."""

import time
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist
from msgspec.structs import replace
from rcl_interfaces.msg import Log
from std_msgs.msg import Empty, String

from controllers.nodes.supervisor import SupervisorNode
from models.nodes import topics
from models.nodes.qos import EVENT, LATCHED
from models.robot_model import RobotModel
from models.status import ControlStatus, EstimatorStatus, GaitStatus, StartStatus
from models.types import SolveStatus
from tests.ros.conftest import StatusTopic
from tests.ros.supervisor_world import World

pytestmark = pytest.mark.ros


@pytest.fixture
def world(bench: Any) -> World:
    return World(bench)


def test_no_mode_before_the_drivers_have_published_their_state(bench: Any, world: World) -> None:
    bench.add(SupervisorNode)
    bench.spin(0.8)
    assert world.modes == []
    world.drivers(topics.ACTIVE)
    bench.wait(lambda: world.modes)
    assert world.modes[0] == "stand"  # never off: the drivers would drop a robot that stands


def test_a_robot_that_has_fallen_is_not_armed(bench: Any, world: World, g1: RobotModel) -> None:
    world.robot(g1)
    world.drivers(topics.DAMPED)
    bench.add(SupervisorNode, lockstep=True, preflight_time=0.6)
    bench.wait(lambda: world.modes)
    assert world.call("reset_faults")[0]
    bench.wait(lambda: world.call("mode/stand")[0])
    bench.spin(0.05)  # the drivers still say 'damped': they are being armed
    assert world.modes[-1] == "stand"
    world.drivers(topics.ACTIVE)
    bench.spin(0.2)
    assert world.call("mode/damp")[0]
    world.drivers(topics.DAMPED)
    assert "have not been repeated" in world.call("mode/stand")[1]
    bench.wait(lambda: world.call("mode/stand")[0])  # upright, it may
    world.drivers(topics.ACTIVE)
    bench.wait(lambda: world.modes[-1] == "stand")
    world.roll = 1.5
    bench.wait(lambda: world.modes[-1] == "damp")
    world.drivers(topics.DAMPED)
    assert world.call("reset_faults")[0]

    def refused() -> bool:
        accepted, reason = world.call("mode/stand")
        assert not accepted
        return "base tilted by 1.50 rad" in reason

    bench.wait(refused)


def test_a_real_robot_that_hangs_or_is_damped_is_refused_with_what_its_start_waits_for(
    bench: Any, world: World, g1: RobotModel
) -> None:
    world.robot(g1)
    bench.add(SupervisorNode, lockstep=True)
    start = StatusTopic(bench.world, topics.START_STATUS, LATCHED)
    bench.wait(lambda: start.get_subscription_count() == 1)
    for state, drivers, waits in (
        ("hanging", topics.HANGING, "the operator: poise start lower"),
        ("damped", topics.DAMPED, "the operator: hang the robot up, then poise start prepare"),
    ):
        start.publish(StartStatus(state, waits))
        world.drivers(drivers)
        answer = f"start '{state}' waits for {waits}"
        bench.wait(lambda answer=answer: answer in world.call("mode/stand")[1])
        assert not world.call("mode/stand")[0] and world.modes[-1] == "off"
    assert "the drives of a real robot follow its start" in world.call("mode/off")[1]


def test_damping_is_published_in_every_state_of_a_real_robots_start_and_an_emergency_stop_outlives_it(
    bench: Any, world: World, g1: RobotModel
) -> None:
    start = StatusTopic(bench.world, topics.START_STATUS, LATCHED)
    world.robot(g1)
    world.drivers(topics.HANGING)
    bench.add(SupervisorNode)
    start.publish(StartStatus("held", "the weight on the feet"))
    bench.wait(lambda: world.modes == ["off"])
    for service in ("mode/damp", "mode/damp", "estop", "estop"):  # the start may have gone on since the last one
        before = len(world.modes)
        accepted, answer = world.call(service)
        assert accepted and answer.endswith("joints are damped")
        bench.wait(lambda before=before: world.modes[before:] == ["damp"])
    start.publish(StartStatus("gantry", "the operator"))
    bench.wait(lambda: "nothing is sent yet" in world.call("mode/damp")[1])
    start.publish(StartStatus("loaded", "the supervisor"))
    bench.spin(0.2)
    for state in (topics.DAMPED, topics.HANGING, topics.HELD):  # hung up, prepared and lowered again
        world.drivers(state)
        bench.spin(0.2)
    accepted, reason = world.call("mode/stand")
    assert not accepted and "emergency stop; call reset_faults first" in reason
    assert "stand clear" in world.call("reset_faults")[1]
    assert "emergency stop" not in world.call("mode/stand")[1]


def test_only_a_request_damps_a_robot_that_relaxes(bench: Any, world: World, g1: RobotModel) -> None:
    node = world.adopted(g1)
    world.drivers(topics.RELAXING)
    bench.wait(lambda: node._driver_state == topics.RELAXING)
    world.roll = 1.5
    bench.spin(0.3)
    assert world.modes[-1] == "stand"
    assert world.call("estop")[0]
    bench.wait(lambda: world.modes[-1] == "damp")


def test_preflight_findings_are_logged_from_the_second_check_on(bench: Any) -> None:
    """The first check finds nodes that have not started yet; a result that passes is logged at once."""
    logged: list[str] = []
    bench.world.create_subscription(Log, "/rosout", lambda m: logged.append(m.msg), EVENT)
    node = bench.add(SupervisorNode, lockstep=True, preflight_time=0.6)
    bench.wait(lambda: bench.world.count_publishers("/rosout") > 1 and node._law.preflight)
    bench.spin(0.1)  # less than the next check takes
    assert not [line for line in logged if line.startswith("preflight")]
    bench.wait(lambda: [line for line in logged if line.startswith("preflight: robot_description was not received")])
    bench.spin(1.5)
    assert len([line for line in logged if line.startswith("preflight")]) == 1


def test_a_robot_that_falls_after_the_checks_is_not_armed(bench: Any, world: World, g1: RobotModel) -> None:
    world.robot(g1)
    world.drivers(topics.OFF)
    bench.add(SupervisorNode, lockstep=True, preflight_time=0.1)
    passed: list[str] = []
    bench.world.create_subscription(
        DiagnosticArray,
        "/diagnostics",
        lambda array: passed.extend(v.value for s in array.status for v in s.values if v.key == "preflight"),
        EVENT,
    )
    bench.wait(lambda: passed and passed[-1] == "passed")
    world.roll = 1.5
    bench.spin(0.05)  # less than a check takes
    accepted, reason = world.call("mode/stand")
    assert not accepted
    assert "base tilted by 1.50 rad" in reason


@pytest.mark.parametrize(
    ("status", "overruns", "culprit"),
    [
        ("optimal", 20, "overran its time budget in 20 ticks in a row"),
        ("damped", 0, "no usable torques"),
        ("splendid", 0, "no usable torques"),
    ],
)
def test_what_the_controller_reports_damps(
    bench: Any, world: World, g1: RobotModel, status: str, overruns: int, culprit: str
) -> None:
    world.robot(g1)
    world.drivers(topics.ACTIVE)
    node = bench.add(SupervisorNode, lockstep=True)
    reports = StatusTopic(bench.world, topics.CONTROL_STATUS)
    fine = ControlStatus(active=True, solve=SolveStatus.OPTIMAL, overruns=0, joint_fault="")
    bench.wait(lambda: world.modes and reports.get_subscription_count() == 1)
    reports.publish(replace(fine, overruns=19))
    bench.spin(0.3)
    reports.publish(replace(fine, active=False, solve=SolveStatus.DAMPED))  # of an idle controller
    bench.spin(0.3)
    assert world.modes == ["stand"]
    reports.publish(replace(fine, overruns=overruns), solve=status)
    bench.wait(lambda: world.modes[-1] == "damp")
    assert culprit in world.call("mode/stand")[1]
    assert node.counters[f"refused {topics.CONTROL_STATUS}"] == (status == "splendid")


def test_a_drop_out_that_goes_on_damps_and_one_that_ends_does_not(bench: Any, world: World, g1: RobotModel) -> None:
    world.robot(g1)
    world.drivers(topics.ACTIVE)
    node = bench.add(SupervisorNode, lockstep=True)
    reports = StatusTopic(bench.world, topics.ESTIMATOR_STATUS)
    bench.wait(lambda: world.modes and reports.get_subscription_count() == 1)
    # it begins in a second: not yet a drop-out
    reports.publish(EstimatorStatus(round(10_000_000 * world.tick) + 10**9))
    bench.spin(0.2)
    reports.publish(EstimatorStatus(None))
    bench.spin(0.3)
    assert world.modes == ["stand"]
    reports.publish(EstimatorStatus(round(10_000_000 * world.tick)))
    bench.wait(lambda: world.modes[-1] == "damp")
    assert "no usable samples of the IMU" in world.call("mode/stand")[1]
    assert node.counters[f"refused {topics.ESTIMATOR_STATUS}"] == 0
    reports.publish(EstimatorStatus(None), coasting_since="a while ago")
    bench.wait(lambda: node.counters[f"refused {topics.ESTIMATOR_STATUS}"] == 1)


@pytest.mark.parametrize("received", [True, False])
def test_a_standing_robot_is_adopted_however_late_its_topics_are_found(
    bench: Any, world: World, g1: RobotModel, received: bool
) -> None:
    world.robot(g1)
    world.silent, world.tick = True, 6500  # it has stood for a minute
    world.drivers(topics.ACTIVE)
    node = bench.add(SupervisorNode, lockstep=True, adoption_time=1.0)
    bench.wait(lambda: world.modes)
    bench.spin(0.5)
    assert world.modes == ["stand"]
    world.silent = not received
    if received:
        bench.spin(1.0)
        assert world.modes == ["stand"]
    else:
        bench.wait(lambda: world.modes[-1] == "damp")
        assert "state estimate older than" in world.call("mode/stand")[1]
    assert node.active


SECOND = 10**9
"""[ns]."""


@pytest.mark.parametrize(
    ("lag", "silent", "mode"),
    [
        pytest.param(SECOND, False, "stand", id="as if this process lagged behind by a second"),
        pytest.param(SECOND, True, "damp", id="nothing goes on"),
        pytest.param(3600 * SECOND, False, "damp", id="stamps of another clock"),
    ],
)
def test_stamps_that_arrive_late_but_go_on_are_of_somebody_alive(
    bench: Any, world: World, g1: RobotModel, lag: int, silent: bool, mode: str
) -> None:
    world.adopted(g1, lockstep=True)
    world.tick += max(200, lag // 10_000_000)
    world.lag, world.silent = lag, silent
    bench.spin(0.5)
    assert world.modes[-1] == mode


def test_stamps_that_go_back_do_not_invert_the_mean_velocity(bench: Any, world: World, g1: RobotModel) -> None:
    node = world.adopted(g1, lockstep=True)
    bench.spin(0.6)
    world.lag, world.twist[0] = SECOND // 2, 0.3
    bench.wait(lambda: node._reports.walking_velocity[0] != 0.0)
    assert node._reports.walking_velocity[0] > 0.0


def test_a_clock_that_is_read_before_the_rest_after_a_stall_damps_nothing(
    bench: Any, world: World, g1: RobotModel
) -> None:
    world.adopted(g1, lockstep=True)
    world.tick, world.silent = world.tick + 15, True  # more than the 0.1 s that damp
    bench.spin(0.03)
    world.silent = False
    bench.spin(0.3)
    assert world.modes == ["stand"]


def test_a_stall_of_the_supervisor_is_no_silent_clock(bench: Any, world: World, g1: RobotModel) -> None:
    node = world.adopted(g1, clock_timeout=0.1)
    for _ in range(2):
        time.sleep(0.2)
        node._update()  # before the messages that arrived meanwhile
        bench.spin(0.1)
    assert world.modes == ["stand"]
    world._timer.cancel()
    bench.wait(lambda: world.modes[-1] == "damp")
    assert "no /clock for 0.1 s" in world.call("mode/stand")[1]


def test_a_request_right_after_the_drivers_damped_is_refused(bench: Any, world: World, g1: RobotModel) -> None:
    node = world.adopted(g1, lockstep=True)
    node._on_driver_state(String(data=topics.DAMPED))
    reply = node._set_mode("stand")  # before the next check
    assert not reply.accepted
    assert "fell back to damping" in reply.reason


def test_damped_drivers_are_adopted_with_a_latched_fault(bench: Any, world: World) -> None:
    world.drivers(topics.DAMPED)
    bench.add(SupervisorNode)
    bench.wait(lambda: world.modes)
    assert world.modes == ["damp"]
    accepted, reason = world.call("mode/stand")
    assert not accepted
    assert "the drivers were damped when the supervisor started" in reason
    assert world.call("reset_faults")[0]


def test_it_walks_only_with_a_gait_planner_and_stands_once_that_says_so(
    bench: Any, world: World, g1: RobotModel
) -> None:
    world.robot(g1)
    world.drivers(topics.ACTIVE)
    bench.add(SupervisorNode, lockstep=True, look_ahead=False)
    gait = StatusTopic(bench.world, topics.GAIT_STATUS, LATCHED)
    text = bench.world.create_publisher(String, topics.HUMANOID_COMMANDS, EVENT)
    asked: list[tuple[float, float, float]] = []

    def hear(message: Twist) -> None:
        asked.append((message.linear.x, message.linear.y, message.angular.z))

    bench.world.create_subscription(Twist, topics.GAIT_VELOCITY, hear, EVENT)
    bench.wait(lambda: world.modes and gait.get_subscription_count() == 1 and text.get_subscription_count() == 1)
    bench.spin(0.2)
    accepted, reason = world.call("mode/walk")
    assert not accepted
    assert "no gait planner" in reason
    gait.publish(GaitStatus(ready=True, settled=True))
    bench.spin(0.1)
    text.publish(String(data="left"))
    bench.wait(lambda: len(asked) > 5)  # it is repeated
    assert world.modes[-1] == "walk"
    assert set(asked) == {(0.0, 0.15, 0.0)}
    halted: list[Empty] = []
    bench.world.create_subscription(Empty, topics.GAIT_STOP, halted.append, EVENT)
    bench.spin(0.2)
    accepted, _ = world.call("mode/stand")  # before the planner has said anything about this walk
    assert accepted
    bench.wait(lambda: halted)
    asked.clear()
    bench.wait(lambda: asked)
    assert set(asked) == {(0.0, 0.0, 0.0)}
    gait.publish(GaitStatus(ready=True, settled=False))
    bench.spin(0.1)
    assert world.modes[-1] == "walk"
    gait.publish(GaitStatus(ready=True, settled=True))
    bench.wait(lambda: world.modes[-1] == "stand")
    asked.clear()
    gait.publish(GaitStatus(ready=False, settled=True))
    bench.spin(0.1)
    assert "no gait planner" in world.call("mode/walk")[1]
    assert asked == []  # nothing to say to a gait that stands
