"""Calibration over the whole graph, in lockstep: injected errors are found, kept, in effect at the next start."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from bridge.launch.graph import Graph
from bridge.plants.mujoco import MujocoPlant
from bridge.plants.sensors import read_sensor_errors
from bridge.ros.environment import free_domain
from controllers.calibration.closed_chain import ChainTerms
from models.calibration_store import CalibrationStore
from models.nodes import topics
from models.nodes.calibration_text import text_to_reply
from models.nodes.messages import JointStateCodec
from models.nodes.qos import LATCHED
from models.robot_model import RobotModel
from models.types import CommandReply, Vector
from tests.ros.conftest import Eyes

pytestmark = [pytest.mark.ros, pytest.mark.graph]

SHARE = 0.05
"""What may be left of an injected error."""

GYRO, FORCE, ENCODER = 0.05, 15.0, 0.03
ERRORS = {"gyro_bias": [GYRO, -GYRO, GYRO], "force_offsets": FORCE}


class Calibrated:
    """A graph whose robot has sensor errors, and its answers."""

    def __init__(self, graph: Graph, robot: RobotModel, folder: Path, errors: str) -> None:
        self.graph, self.robot = graph, robot
        self.eyes = Eyes(graph)
        self.store = CalibrationStore(robot, folder)
        self.bias = MujocoPlant(robot, seed=0, sensor_errors=read_sensor_errors(errors)).noise.bias
        self.offsets: list[Vector] = []
        self._codec = JointStateCodec(robot)
        graph.node.create_subscription(JointState, topics.ENCODER_OFFSETS, self._on_offsets, LATCHED, raw=True)

    def _on_offsets(self, data: bytes) -> None:
        self.offsets.append(self._codec.decode(data)[1])

    def call(self, service: str) -> CommandReply:
        return text_to_reply(*self.graph.call(service, timeout=200.0))

    def hang(self, on: bool) -> CommandReply:
        answer = self.graph.ask(SetBool, "hang", SetBool.Request(data=on), 20.0)
        return CommandReply(answer.success, answer.message)

    def lift(self) -> None:
        """Into the air, from whatever it does."""
        assert self.call("mode/damp").accepted and self.call("mode/off").accepted
        self.graph.wait_for(lambda: self.graph.driver_state == "off", 10.0, "off")
        assert self.hang(True).accepted
        self.graph.wait_for(lambda: self.graph.driver_state == "hanging", 10.0, "hanging")

    def put_down(self) -> None:
        assert self.hang(False).accepted
        self.graph.wait_standing(90.0)

    def restart(self) -> None:
        assert self.call("reset").accepted
        self.graph.wait_for(lambda: self.graph.driver_state == "held", 10.0, "held")
        self.graph.wait_standing(90.0)

    def in_effect(self, words: str) -> None:
        """Wait until drivers and estimator say that they started with a calibration."""
        nodes = ("/robot_driver", "/state_estimator")
        reports = self.eyes.reports
        self.graph.wait_for(
            lambda: all(words in reports.get(node, {}).get("calibration", "") for node in nodes), 10.0, f"with {words}"
        )


def _run(robot: RobotModel, folder: Path, errors: dict[str, object]) -> Iterator[Calibrated]:
    text = json.dumps(errors)
    with Graph(
        robot.name,
        lockstep=True,
        domain_id=free_domain(),
        parameters={"robot_driver": {"sensor_errors": text}},
        calibration=folder,
        log=folder / "log",
        say=lambda text: None,
    ) as graph:
        run = Calibrated(graph, robot, folder, text)
        graph.wait_standing(90.0)
        yield run
    assert graph.exit_codes == dict.fromkeys(graph.pids, 0)


@pytest.fixture(scope="module")
def run(g1: RobotModel, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Calibrated]:
    """Standing, with a gyro that turns and feet that carry."""
    yield from _run(g1, tmp_path_factory.mktemp("calibrated"), ERRORS)


def test_gyro_and_feet_are_found_in_the_air_and_in_effect_after_the_restart(run: Calibrated) -> None:
    assert "the drivers are 'active'" in run.hang(True).reason
    assert "does not hang already" in run.hang(False).reason
    run.lift()
    assert "hangs in the air" in run.call("mode/stand").reason
    joints = run.call("calibrate/joints")
    assert not joints.accepted and "both soles" in joints.reason
    run.in_effect("none")
    imu = run.call("calibrate/imu")
    assert imu.accepted, imu.reason
    at, found = 3 * run.robot.nj, np.array([imu.details[f"gyro_bias_{axis}"] for axis in "xyz"])
    assert np.abs(found - run.bias[at : at + 3]).max() < SHARE * GYRO
    feet = run.call("calibrate/feet")
    assert feet.accepted, feet.reason
    forces = [feet.details[f"{foot}_{channel}"] for foot in ("left", "right") for channel in ("fx", "fy", "fz")]
    true = run.bias[-12:].reshape(2, 6)[:, :3].ravel()
    assert np.abs(forces - true).max() < SHARE * FORCE
    run.graph.spin(0.5)
    run.in_effect("none")  # never in a running loop
    run.put_down()
    run.in_effect(", ".join(f"{what} of {stamp}" for what, stamp in run.store.load()[0].stamps))
    shown = run.call("calibrate/show")
    assert shown.accepted and shown.details["gyro_bias_x [rad/s]"] == pytest.approx(found[0], rel=1e-6)


def test_a_calibration_is_refused_or_given_up_with_the_reason(run: Calibrated) -> None:
    graph = run.graph
    graph.send("squat")
    graph.wait_for(lambda: graph.mode == "motion", 30.0, "squatting")
    assert "while the robot is 'motion'" in run.call("calibrate/joints").reason
    graph.send("stop")
    graph.wait_for(lambda: graph.mode == "stand", 10.0, "standing")

    run.eyes.motion.clear()
    first = graph._clients["calibrate/joints"].call_async(Trigger.Request())
    graph.wait_for(lambda: "running" in run.eyes.motion, 60.0, "moving")
    assert "'joints' is being calibrated" in run.call("calibrate/imu").reason
    graph.send("stop")
    graph.wait_for(first.done, 30.0, "answering")
    assert not first.result().success and "'stop' was requested meanwhile" in first.result().message

    assert run.call("mode/damp").accepted
    graph.wait_for(lambda: graph.driver_state == "damped", 10.0, "damped")
    assert "while the robot is 'damped'" in run.call("calibrate/joints").reason
    run.lift()
    run.put_down()


@pytest.mark.slow
def test_a_corrupted_file_is_refused_by_name_and_rolled_back(run: Calibrated) -> None:
    run.lift()
    for _ in range(2):
        reply = run.call("calibrate/imu")
        assert reply.accepted, reply.reason
    before = run.store.read(run.store.files()[1])
    text = run.store.path.read_text()
    run.store.path.write_text(text[: len(text) // 2])
    run.put_down()
    for node in ("robot_driver", "state_estimator"):
        assert str(run.store.path) in run.eyes.reports[f"/{node}"]["calibration refused"]
    run.in_effect(f"imu of {dict(before.stamps)['imu']}")
    reply = run.call("calibrate/rollback")
    assert reply.accepted and reply.details["gyro_bias_y [rad/s]"] == pytest.approx(before.gyro_bias[1], rel=1e-6)
    assert run.store.load()[1] == ()
    run.lift()
    run.put_down()
    assert "calibration refused" not in run.eyes.reports["/state_estimator"]


@pytest.mark.slow
def test_the_closed_chain_finds_the_legs_over_the_graph(g1: RobotModel, tmp_path: Path) -> None:
    """Two passes, a restart between them; the drivers correct their encoders and tell by how much."""
    joints = ChainTerms(g1).joints
    signs = np.random.default_rng(1).choice([-1.0, 1.0], joints.size)
    errors = {g1.joint_names[i]: ENCODER * float(sign) for i, sign in zip(joints, signs, strict=True)}
    for run in _run(g1, tmp_path, {"encoder_offsets": errors}):
        worst = []
        for _ in range(2):
            reply = run.call("calibrate/joints")
            assert reply.accepted, reply.reason
            found = run.store.load()[0].encoder_offsets
            worst.append(float(np.abs(found - run.bias[: g1.nj])[joints].max()))
            run.restart()
            np.testing.assert_allclose(run.offsets[-1], found, atol=1e-12)
        print("worst offset after each pass [rad]", worst)
        assert worst[0] < 0.1 * ENCODER and worst[1] < SHARE * ENCODER, worst
