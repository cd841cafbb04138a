"""The control node's black box: written once for each fault, off the tick, and harmless where it cannot be."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec import structs
from std_msgs.msg import String
from typer.testing import CliRunner

from bridge.cli import app
from bridge.launch.graph import Graph
from bridge.replay.replay import replay_box
from bridge.ros.environment import free_domain
from controllers.nodes.balance_controller import BalanceControllerNode
from controllers.recording.black_box_file import BlackBoxRecord
from controllers.stack import ControlStack
from models.nodes import topics
from models.nodes.qos import LATCHED
from models.robot_model import RobotModel
from models.status import SupervisorStatus
from models.types import Mode, SensorData
from tests.ros.conftest import StatusTopic
from tests.ros.parameters import set_parameter
from tests.support import standing

pytestmark = pytest.mark.ros

SOON = {"diagnostics_period": 0.02, "black_box.after": 0.1}


class Ticking:
    """A controller that gets states and sensors as in the control process."""

    def __init__(self, bench: Any, g1: RobotModel, **parameters: object) -> None:
        self.bench, self.stamp = bench, 0
        world = bench.world
        self.mode = world.create_publisher(String, topics.MODE, LATCHED)
        self.drivers = world.create_publisher(String, topics.DRIVER_STATE, LATCHED)
        self.stack = ControlStack()
        make = lambda **kwargs: BalanceControllerNode(self.stack, **kwargs)  # noqa: E731
        self.node = bench.add(make, **{**SOON, **parameters})
        for publisher in (self.mode, self.drivers):
            bench.wait(lambda publisher=publisher: publisher.get_subscription_count() == 1)
        self.state, zero = standing(g1), np.zeros(g1.nj)
        self.sensors = SensorData(0.0, self.state.q[7:], zero, zero, np.full(3, 0.5), np.zeros(3), np.zeros((2, 6)))

    def tick(self, count: int = 20) -> None:
        for _ in range(count):
            self.stamp += 1_000_000
            state = structs.replace(self.state, t=1e-9 * self.stamp)
            self.stack.raw = self.sensors
            self.node.on_state(state, self.stamp)

    def set_mode(self, mode: str) -> None:
        self.mode.publish(String(data=mode))
        self.bench.wait(lambda: self.node._mode.value == mode)
        self.tick()

    def wait_outcome(self) -> str:
        self.node.values.pop("black box", None)
        self.bench.wait(lambda: "black box" in self.node.values)
        return str(self.node.values["black box"])


def test_a_fault_is_written_once(bench: Any, g1: RobotModel, tmp_path: Path) -> None:
    robot = Ticking(bench, g1, **{"black_box.folder": tmp_path / "boxes"})
    robot.set_mode("damp")  # nothing was active: no reason to write
    robot.set_mode("stand")
    robot.tick(50)
    robot.set_mode("damp")
    robot.drivers.publish(String(data=topics.ACTIVE))
    robot.drivers.publish(String(data=topics.DAMPED))  # follows from it
    file = Path(robot.wait_outcome())
    bench.spin(0.3)
    assert list((tmp_path / "boxes").iterdir()) == [file]
    record = BlackBoxRecord.load(file)
    assert record.reason == "mode damp"
    assert [text for _, text in record.events[:3]] == ["mode damp", "mode stand", "mode damp"]
    np.testing.assert_allclose(np.diff(record.t), 0.001, atol=1e-9)
    stands = np.array([mode is Mode.STAND for mode in record.modes])
    assert stands.sum() == 70 and np.isfinite(record.command_q[stands]).all()
    assert np.isnan(record.command_q[~stands]).all() and (record.gyro == 0.5).all()
    robot.set_mode("stand")  # it goes on
    robot.set_mode("damp")
    robot.wait_outcome()
    assert len(list((tmp_path / "boxes").iterdir())) == 2


def test_a_reset_is_no_fault(bench: Any, g1: RobotModel, tmp_path: Path) -> None:
    robot = Ticking(bench, g1, **{"black_box.folder": tmp_path / "boxes"})
    for state, mode in ((topics.HELD, "stand"), (topics.ACTIVE, "stand"), (topics.HELD, "off"), (topics.ACTIVE, "off")):
        robot.drivers.publish(String(data=state))
        robot.set_mode(mode)
    robot.drivers.publish(String(data=topics.DAMPED))  # nothing was active since
    bench.spin(0.3)
    robot.node.trigger_deactivate()  # writes what is due
    assert not (tmp_path / "boxes").exists()


def test_drivers_that_damp_by_themselves_are_enough(bench: Any, g1: RobotModel, tmp_path: Path) -> None:
    robot = Ticking(bench, g1, **{"black_box.folder": tmp_path / "boxes"})
    robot.set_mode("stand")
    robot.drivers.publish(String(data=topics.ACTIVE))
    bench.spin(0.1)
    robot.drivers.publish(String(data=topics.DAMPED))
    assert BlackBoxRecord.load(Path(robot.wait_outcome())).reason == "drivers damped"


def test_the_supervisor_says_why(bench: Any, g1: RobotModel, tmp_path: Path) -> None:
    robot = Ticking(bench, g1, **{"black_box.folder": tmp_path / "boxes", "black_box.after": 1.0})
    status = StatusTopic(bench.world, topics.SUPERVISOR_STATUS, LATCHED)
    record = SupervisorStatus("g1", Mode.DAMP, refused=0, refusal="", faults=())
    robot.set_mode("stand")
    assert status.get_subscription_count() == 0  # while it stands the status costs nothing
    robot.set_mode("damp")
    bench.wait(lambda: status.get_subscription_count() == 1)
    for faults in ((), ("fallen", "emergency stop"), ("later",)):
        status.publish(structs.replace(record, faults=faults))
        bench.spin(0.1)
    file = Path(robot.wait_outcome())
    bench.wait(lambda: status.get_subscription_count() == 0)
    box = BlackBoxRecord.load(file)
    assert box.reason == "mode damp; supervisor: fallen; emergency stop"
    assert [text for _, text in box.events].count("supervisor: fallen; emergency stop") == 1


def test_a_folder_that_refuses_is_counted_and_reported(bench: Any, g1: RobotModel, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    robot = Ticking(bench, g1, **{"black_box.folder": tmp_path / "file"})
    robot.set_mode("stand")
    robot.set_mode("damp")
    assert "black box not written" in robot.wait_outcome()
    assert robot.node.counters["black boxes not written"] == 1
    robot.set_mode("stand")
    assert robot.stack.scheduled == (True, True)  # it works on


def test_a_node_that_stops_writes_what_is_due(bench: Any, g1: RobotModel, tmp_path: Path) -> None:
    robot = Ticking(bench, g1, **{"black_box.folder": tmp_path / "boxes"})
    robot.set_mode("stand")
    robot.set_mode("damp")
    robot.node.trigger_deactivate()
    assert len(list((tmp_path / "boxes").iterdir())) == 1


@pytest.mark.slow
def test_a_fall_of_the_graph_is_run_again(tmp_path: Path) -> None:
    """It stands with another gain, walks, stands, and is stopped in an emergency while it walks again."""
    folder = tmp_path / "boxes"
    os.environ["ROS_LOG_DIR"] = str(tmp_path / "log")
    parameters: dict[str, dict[str, object]]
    parameters = {"balance_controller": {"black_box.folder": str(folder), "black_box.after": 0.3}}
    with Graph(
        "g1", domain_id=free_domain(), lockstep=True, log=tmp_path / "graph.log", say=lambda _: None,
        parameters=parameters,
    ) as graph:  # fmt: skip
        graph.wait_standing(120.0)
        set_parameter(graph, "balance_controller", "whole_body.com.kp", 90.0)
        graph.spin(1.0)
        stop, walk = ("stop", "stand"), ("forward", "walk")
        for word, mode in (("wave", "motion"), stop, walk, stop, walk):
            graph.send(word)
            graph.wait_for(lambda mode=mode: graph.mode == mode, 60.0, mode)
            graph.spin(2.0)
        assert graph.call("estop")[0]
        graph.wait_for(lambda: bool(list(folder.glob("*.npz"))), 60.0, "writing its black box")
    (file,) = folder.glob("*.npz")
    record = BlackBoxRecord.load(file)
    assert record.replay is not None and len(record.replay.record["inputs"]) > 2
    result = CliRunner().invoke(app, ["replay", str(file)])
    assert result.exit_code == 0 and "identical" in result.output, result.output
    report = replay_box(record)
    assert report.compared > 2000 and report.ticks > report.compared
    walks = {mode for mode, t in zip(record.modes, record.t, strict=True) if t > report.since}
    assert {Mode.WALK, Mode.DAMP} <= walks
