"""The real graph over DDS: it stands, refuses what is malformed naming the culprit, ends cleanly."""

import math
import os
import signal

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu, JointState
from trajectory_msgs.msg import JointTrajectory

from bridge.ros.client import Client
from bridge.ros.walk import reset
from models.nodes import topics
from models.nodes.interfaces import missing_types
from models.nodes.messages import (
    ImuCodec,
    JointCommandCodec,
    JointStateCodec,
    WrenchCodec,
    decode,
    doubles,
    trajectory_to_message,
)
from models.nodes.qos import EVENT, INCOMPATIBLE_QOS
from models.robot_model import SOLE_FRAMES, RobotModel
from models.types import JointCommand
from models.types import JointTrajectory as Trajectory
from tests.ros.conftest import Eyes

TFMessage = pytest.importorskip("tf2_msgs.msg", reason="tf2_msgs is not built").TFMessage

pytestmark = [pytest.mark.ros, pytest.mark.graph]

TOPICS = (
    *("joint_states", "imu/data_raw", "foot/left/wrench", "foot/right/wrench", "clock", "ground_truth/odom", "odom"),
    *("imu/data", "external_wrench", "ground/friction", "tf", "tf_static"),
    *("contacts", "encoder_offsets", "mode", "diagnostics", "robot_description", "humanoid_commands"),
    *("cmd_vel", "cmd_vel_stamped", "gait/velocity_request", "gait/stop", "gait/phase", "gait/capture_margin"),
    *("gait/footsteps", "gait/footsteps_taken", "goal_pose", "gait/footsteps_command", "gait/route"),
    *("joint_setpoints", "joint_trajectory_controller/joint_trajectory"),
)
SERVICES = (
    *("pause", "reset", "push", "mode/off", "mode/damp", "mode/stand", "mode/walk", "estop", "reset_faults"),
    *("calibrate/imu", "calibrate/joints", "calibrate/feet", "calibrate/show", "calibrate/rollback", "hang"),
    "plan_footsteps",
    *(() if missing_types() else ("plan_motion", "gait/plan_footsteps", "calibrate")),
)


def test_the_graph_offers_what_the_architecture_names(eyes: Eyes) -> None:
    node = eyes.graph.node
    offered = {name for name, _ in node.get_topic_names_and_types()}
    assert offered >= {f"/{topic}" for topic in TOPICS}
    services = {name for name, _ in node.get_service_names_and_types()}
    assert services >= {f"/{service}" for service in SERVICES}


def test_every_two_ends_of_the_graph_agree_on_their_qos(eyes: Eyes) -> None:
    said = {f"{node}: {key}: {value}" for node, report in eyes.reports.items() for key, value in report.items()}
    assert not [words for words in said if INCOMPATIBLE_QOS in words]


def test_services_answer_with_the_reason(eyes: Eyes, undisturbed: None) -> None:
    accepted, reason = eyes.ask("mode/off")
    assert not accepted
    assert "request 'damp' first" in reason
    accepted, reason = eyes.ask("calibrate/rollback")
    assert not accepted
    assert "no previous calibration" in reason


@pytest.mark.parametrize(("text", "culprit"), [("dance", "unknown command 'dance'"), ("x" * 300, "300 characters")])
def test_text_that_is_not_carried_out(eyes: Eyes, undisturbed: None, text: str, culprit: str) -> None:
    eyes.refusal("supervisor", topics.HUMANOID_COMMANDS, lambda: eyes.graph.send(text), culprit)


def _joint_state(g1: RobotModel, how: str) -> JointState:
    """A second publisher's message, far from the truth, so that taking it would show."""
    data = JointStateCodec(g1).encode(10**15, g1.posture("stand") + 0.3, np.zeros(g1.nj), np.zeros(g1.nj))
    message = decode(data, JointState)
    names = list(message.name)
    if how == "unknown":
        message.name = ["tail_joint", *names[1:]]
    elif how == "missing":
        message.name = names[1:]
        for field in ("position", "velocity", "effort"):
            setattr(message, field, getattr(message, field)[1:])
    elif how == "duplicate":
        message.name = [names[1], *names[1:]]
    elif how == "nan":
        message.position[0] = float("nan")
    elif how == "backward":
        message.header.stamp.sec = 0
    return message


@pytest.mark.parametrize(
    ("how", "culprit"),
    [
        ("unknown", "tail_joint"),
        ("missing", "left_hip_pitch_joint"),
        ("duplicate", "given twice"),
        ("nan", "position of left_hip_pitch_joint is nan"),
        ("backward", "header.stamp"),
        ("leap", "jumps ahead"),
    ],
)
def test_malformed_joint_states(eyes: Eyes, undisturbed: None, g1: RobotModel, how: str, culprit: str) -> None:
    message = _joint_state(g1, how)
    with eyes.beside_the_robot(JointState, topics.JOINT_STATES) as publisher:
        eyes.refusal("state_estimator", topics.JOINT_STATES, lambda: publisher.publish(message), culprit)


@pytest.mark.parametrize("topic", [topics.IMU_RAW, *topics.FOOT_WRENCHES])
def test_inertial_and_foot_samples_that_are_no_numbers(eyes: Eyes, undisturbed: None, topic: str) -> None:
    bad = np.array([0.0, math.nan, 0.0])
    if topic == topics.IMU_RAW:
        kind, data = Imu, ImuCodec(topics.IMU_FRAME).encode(10**15, bad, np.zeros(3))
    else:
        frame = SOLE_FRAMES[topics.FOOT_WRENCHES.index(topic)]
        kind, data = WrenchStamped, WrenchCodec(frame).encode(10**15, np.tile(bad, 2))
    with eyes.beside_the_robot(kind, topic) as publisher:
        eyes.refusal("state_estimator", topic, lambda: publisher.publish(data), "element 1 is nan")


def _command(g1: RobotModel, how: str) -> JointTrajectory:
    zero = np.zeros(g1.nj)
    data = JointCommandCodec(g1).encode(1, JointCommand(g1.posture("zero"), zero, zero))
    message = decode(data, JointTrajectory)
    if how == "unknown":
        message.joint_names = ["tail_joint", *list(message.joint_names)[1:]]
    elif how == "nan":
        message.points[0].effort[0] = float("nan")
    elif how == "future":
        message.header.stamp.sec = 10**6
    elif how == "duplicate":
        message.joint_names = [message.joint_names[1], *list(message.joint_names)[1:]]
    elif how == "empty":
        message = JointTrajectory()
    return message


@pytest.mark.parametrize(
    ("how", "culprit"),
    [
        ("empty", "joint_names: empty"),
        ("unknown", "tail_joint"),
        ("duplicate", "given twice"),
        ("nan", "effort of left_hip_pitch_joint is nan"),
        ("stale", "header.stamp"),
        ("future", "header.stamp"),
    ],
)
def test_malformed_joint_commands(eyes: Eyes, undisturbed: None, g1: RobotModel, how: str, culprit: str) -> None:
    message = _command(g1, how)
    eyes.refusal("robot_driver", topics.JOINT_SETPOINTS, lambda: eyes.commands.publish(message), culprit)


def _trajectory(g1: RobotModel, start: np.ndarray, how: str) -> JointTrajectory:
    """From the present posture to itself, corrupted in one way at the knee."""
    knee = g1.joint_index("left_knee_joint")
    positions, times = np.array([start, start]), np.array([0.0, 1.0])
    if how == "limit":
        positions[1, knee] = g1.q_upper[knee] + 0.5
    elif how == "jump":
        positions[:, knee] += 0.3
    elif how == "nan":
        positions[1, knee] = np.nan
    elif how == "times":
        times[1] = 0.0
    message = trajectory_to_message(Trajectory(g1.joint_names, times, positions, np.zeros_like(positions)))
    if how == "unknown":
        message.joint_names = ["tail_joint", *g1.joint_names[1:]]
    elif how == "ragged":
        message.points[1].positions = doubles(start[:-1])
    elif how == "empty":
        message.points = []
    elif how == "nothing":
        message = JointTrajectory()
    return message


@pytest.mark.parametrize(
    ("how", "culprit"),
    [
        ("limit", "left_knee_joint"),
        ("jump", "start jump"),
        ("nan", "left_knee_joint"),
        ("times", "times"),
        ("unknown", "tail_joint"),
        ("ragged", "positions: point 1"),
        ("empty", "no points"),
        ("nothing", "joint_names: empty"),
    ],
)
def test_malformed_motions(eyes: Eyes, undisturbed: None, g1: RobotModel, how: str, culprit: str) -> None:
    start = JointStateCodec(g1).decode(eyes.posture)[1]
    message = _trajectory(g1, start, how)
    eyes.motion.clear()
    eyes.motions.publish(message)
    eyes.graph.wait_for(lambda: bool(eyes.motion), 5.0, "answered")
    assert eyes.motion[0].startswith("refused: ")
    assert culprit in eyes.motion[0]


def test_a_motion_is_planned_and_followed_without_the_truth_and_ends_in_stand(eyes: Eyes) -> None:
    eyes.motion.clear()
    eyes.check_truth()
    eyes.graph.wait_for(lambda: "done" in eyes.motion, 10.0, "done")
    assert "running" in eyes.motion


def test_a_motion_stopped_while_it_is_planned_does_not_start(eyes: Eyes, undisturbed: None, g1: RobotModel) -> None:
    before = JointStateCodec(g1).decode(eyes.posture)[1]
    eyes.motion.clear()
    planner = eyes.graph.pids["planners.nodes.motion_planner"]
    os.kill(planner, signal.SIGSTOP)
    try:
        for word, mode in (("wave", "motion"), ("stop", "stand")):
            eyes.graph.send(word)
            eyes.graph.wait_for(lambda mode=mode: eyes.graph.mode == mode, 20.0, mode)
    finally:
        os.kill(planner, signal.SIGCONT)
    eyes.graph.wait_for(lambda: any("arrived too late" in word for word in eyes.motion), 20.0, "dropped")
    eyes.graph.spin(0.5)
    assert "running" not in eyes.motion
    np.testing.assert_array_equal(JointStateCodec(g1).decode(eyes.posture)[1], before)


def test_the_transforms_of_a_standing_robot_go_on(eyes: Eyes) -> None:
    received: list[bytes] = []
    listener = eyes.graph.node.create_subscription(TFMessage, topics.TF, received.append, EVENT, raw=True)
    eyes.graph.wait_for(lambda: len(received) >= 10, 10.0, "transforming")
    first, last = (deserialize_message(data, TFMessage).transforms for data in (received[0], received[-1]))
    assert [each.child_frame_id for each in last] == ["base_link", "base_footprint"]
    stamps = [each[0].header.stamp.sec + 1e-9 * each[0].header.stamp.nanosec for each in (first, last)]
    assert stamps[1] - stamps[0] > 0.1
    assert last[0].transform.translation.z == pytest.approx(eyes.truth[-1][2], abs=0.01)
    eyes.graph.node.destroy_subscription(listener)


def test_every_parameter_is_described(eyes: Eyes) -> None:
    from rcl_interfaces.srv import DescribeParameters, ListParameters

    ask = eyes.graph.ask
    for node in (
        "balance_controller",
        "state_estimator",
        "robot_driver",
        "supervisor",
        "motion_planner",
        "gait_planner",
    ):
        names = [
            name
            for name in ask(ListParameters, f"{node}/list_parameters", ListParameters.Request()).result.names
            if not name.startswith(("qos_overrides", "use_sim_time", "start_type_description"))
        ]
        assert len(names) > 3
        answer = ask(DescribeParameters, f"{node}/describe_parameters", DescribeParameters.Request(names=names))
        assert [d.name for d in answer.descriptors if not d.description] == []


def test_a_fallen_robot_is_put_back_on_its_feet(eyes: Eyes) -> None:
    assert eyes.ask("mode/damp")[0]
    eyes.graph.wait_for(lambda: eyes.truth[-1][2] < 0.4, 10.0, "low")
    answers = [eyes.ask("mode/stand")]  # refused by preflight until the supervisor has detected the fall

    def fallen() -> bool:
        answers.append(eyes.ask("mode/stand"))
        return "the robot has fallen" in answers[-1][1]

    eyes.graph.wait_for(fallen, 10.0, "fallen")
    assert not any(accepted for accepted, _ in answers)
    assert "'poise reset'" in answers[-1][1] and "gantry" in answers[-1][1]
    with Client() as client:
        assert reset(client).accepted
    eyes.graph.wait_standing(10.0)
