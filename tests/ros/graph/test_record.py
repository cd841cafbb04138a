"""``poise record``: what is in the file, that it is complete or absent, and that the graph's run is reproduced."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from mcap_ros2.reader import read_ros2_messages
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from typer.testing import CliRunner

from bridge.cli import app
from bridge.launch.graph import Graph
from bridge.record.mcap_log import DESCRIPTION, ROBOT, TYPES, McapLog
from bridge.record.run_file import read_run
from bridge.ros.environment import free_domain
from models.nodes import topics
from models.nodes.messages import JointCommandCodec, JointStateCodec
from models.nodes.qos import EVENT, LATCHED, SENSOR
from models.robot_model import RobotModel
from models.types import JointCommand
from tests.ros.parameters import set_parameter
from tests.ros.trajectories import point

pytestmark = pytest.mark.ros

MS = 1_000_000


@pytest.fixture
def record(tmp_path: Path) -> Iterator[Any]:
    """Starts ``poise record`` into ``tmp_path``."""
    started: list[subprocess.Popen[str]] = []

    def start(*arguments: str, domain_id: int | None = None) -> subprocess.Popen[str]:
        call = "from bridge.cli import app; app()"
        command = [sys.executable, "-c", call, "record", "--out", str(tmp_path / "run.mcap"), *arguments]
        environment = os.environ | ({} if domain_id is None else {"ROS_DOMAIN_ID": str(domain_id)})
        pipe = subprocess.PIPE
        started.append(subprocess.Popen(command, stdout=pipe, stderr=subprocess.STDOUT, text=True, env=environment))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait()


class Joints:
    """A robot that says its joints a hundred times a second, and its mode once, before anybody listens."""

    def __init__(self, bench: Any, g1: RobotModel) -> None:
        self._codec, self._tick = JointStateCodec(g1), 0
        self._nothing = np.zeros(g1.nj)
        self.mode = bench.world.create_publisher(String, topics.MODE, LATCHED)
        self.mode.publish(String(data="stand"))
        self.joints = bench.world.create_publisher(JointState, topics.JOINT_STATES, SENSOR)
        bench.world.create_timer(0.01, self._publish)

    def _publish(self) -> None:
        self._tick += 1
        if self._tick % 50 != 7:  # one in fifty gets lost on the way
            self.joints.publish(self._codec.encode(10 * MS * self._tick, self._nothing, self._nothing, self._nothing))


@pytest.mark.parametrize("ending", ["seconds", pytest.param("SIGINT", marks=pytest.mark.long)])
def test_the_file_is_complete_and_loss_is_reported(
    bench: Any, g1: RobotModel, record: Any, tmp_path: Path, ending: str
) -> None:
    robot = Joints(bench, g1)
    process = record(*(("--seconds", "1.5") if ending == "seconds" else ()))
    if ending == "SIGINT":
        bench.wait(lambda: robot.joints.get_subscription_count() == 1, 60.0)
        bench.spin(1.5)
        assert not (tmp_path / "run.mcap").exists()
        process.send_signal(signal.SIGINT)
    bench.wait(lambda: process.poll() is not None, 60.0)
    reported = process.stdout.read()
    assert process.returncode == 0, reported
    assert [each.name for each in tmp_path.glob("*run*")] == ["run.mcap"]
    messages = list(read_ros2_messages(str(tmp_path / "run.mcap")))
    joints = [each for each in messages if each.channel.topic == "/joint_states"]
    modes = [each for each in messages if each.channel.topic == "/mode"]
    steps = np.diff([each.log_time_ns for each in joints])
    lost = int((steps // (10 * MS) - 1).sum())
    assert lost >= 1 and f"{lost} joint samples lost" in reported and f"{len(messages)} messages" in reported
    stamp = joints[0].ros_msg.header.stamp
    assert joints[0].log_time_ns == stamp.sec * 10**9 + stamp.nanosec
    assert [each.ros_msg.data for each in modes] == ["stand"]
    (offered,) = yaml.safe_load(modes[0].channel.metadata["offered_qos_profiles"])  # for ros2 bag play
    assert (offered["durability"], offered["reliability"]) == ("transient_local", "reliable")
    assert "offered_qos_profiles" not in joints[0].channel.metadata
    assert modes[0].log_time_ns >= joints[0].log_time_ns  # what is latched is of the robot's time, not of 1970


@pytest.mark.long
def test_nothing_received_leaves_no_file(ros_domain_id: int, record: Any, tmp_path: Path) -> None:
    process = record()
    process.stdout.readline()  # it waits for the robot
    process.send_signal(signal.SIGINT)
    assert process.wait(30.0) == 1
    assert list(tmp_path.glob("*run*")) == []


@pytest.mark.long
def test_messages_without_a_robot_are_no_robot(bench: Any, record: Any) -> None:
    bench.world.create_publisher(String, f"/robot_2/{topics.SUPERVISOR_STATUS}", LATCHED)
    mode = bench.world.create_publisher(String, topics.MODE, LATCHED)
    mode.publish(String(data="stand"))
    process = record()
    waiting = process.stdout.readline()
    assert waiting == "waiting for the robot (robots are up in /robot_2: give --namespace); Ctrl-C ends\n"
    bench.wait(lambda: mode.get_subscription_count() == 1)
    process.send_signal(signal.SIGINT)
    assert process.wait(30.0) == 1
    assert "messages, no joint samples" in process.stdout.read()


@pytest.mark.slow
def test_a_run_of_the_graph_is_reproduced(record: Any, tmp_path: Path) -> None:
    domain = free_domain()
    process = record(domain_id=domain)
    process.stdout.readline()  # it waits for the robot: the start is in the recording
    os.environ["ROS_LOG_DIR"] = str(tmp_path / "log")
    with Graph("g1", domain_id=domain, lockstep=True, log=tmp_path / "graph.log", say=lambda text: None) as graph:
        graph.wait_standing(120.0)
        words = graph.node.create_publisher(String, topics.HUMANOID_COMMANDS, EVENT)
        graph.wait_for(lambda: words.get_subscription_count() == 2, 10.0, "received by supervisor and recorder")
        set_parameter(graph, "balance_controller", "whole_body.com.kp", 90.0)
        for word, mode in (("wave", "motion"), ("stop", "stand"), ("forward", "walk")):
            words.publish(String(data=word))
            graph.wait_for(lambda mode=mode: graph.mode == mode, 30.0, mode)
            graph.spin(2.0)
        words.publish(String(data="stop"))
        graph.wait_for(lambda: graph.mode == "stand", 60.0, "standing")
        process.send_signal(signal.SIGINT)
        reported = process.communicate(timeout=60.0)[0]
        assert process.returncode == 0 and "no joint sample lost" in reported, reported
    result = CliRunner().invoke(app, ["replay", str(tmp_path / "run.mcap")])
    assert result.exit_code == 0 and "identical" in result.output, result.output
    kinds = {each.channel.topic: each.schema.name for each in read_ros2_messages(str(tmp_path / "run.mcap"))}
    assert kinds["/tf"] == kinds["/tf_static"] == "tf2_msgs/msg/TFMessage"
    expected = {"/imu/data", "/odom", "/contacts", "/diagnostics", "/clock", "/robot_description", "/encoder_offsets"}
    assert expected | {"/motion/joint_trajectory", "/gait/footsteps", "/driver_state"} <= set(kinds)


@pytest.mark.parametrize("old", [True, False])
def test_a_recording_holds_setpoints_and_trajectories(g1: RobotModel, tmp_path: Path, old: bool) -> None:
    """Earlier versions recorded the setpoints under the name that is a user's trajectory now."""
    zero, log = np.zeros(g1.nj), McapLog(tmp_path / "run.mcap")
    setpoint = JointCommandCodec(g1).encode(1000, JointCommand(g1.posture("stand"), zero, zero))
    names = [topics.JOINT_TRAJECTORY] if old else [topics.JOINT_SETPOINTS, topics.JOINT_TRAJECTORY]
    for name in names:
        log.announce(f"/{name}", TYPES[name])
    log.add(f"/{names[0]}", setpoint, 1000)
    if not old:
        log.add(f"/{names[1]}", bytes(serialize_message(point(["left_elbow_joint"], [1.0], 0.5))), 1000)
    log.describe(DESCRIPTION, {ROBOT: "g1"})
    log.close()
    run = read_run(tmp_path / "run.mcap")
    assert list(run.commands) == [1000]
    assert len(run.motions) == (0 if old else 1)
