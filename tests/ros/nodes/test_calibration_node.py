"""The estimator's calibration services without a robot: what they correct, keep, and refuse."""

import errno
from typing import Any

import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger

from controllers.calibration.session import CalibrationJob, CalibrationProcedure, solve
from controllers.nodes.calibration_services import CalibrationSolver
from controllers.nodes.state_estimator import StateEstimatorNode
from models.calibration import Calibration, apply_calibration
from models.constants import GRAVITY
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.interfaces import interface
from models.nodes.messages import JointStateCodec
from models.nodes.qos import LATCHED
from models.robot_model import RobotModel
from models.types import SensorData
from tests.ros.delivery import deliver

pytestmark = pytest.mark.ros


def sample(robot: RobotModel, t: float) -> SensorData:
    """A robot that hangs still in its stand posture."""
    zero = np.zeros(robot.nj)
    accel = np.array([0.0, 0.0, GRAVITY])
    return SensorData(t, robot.posture("stand"), zero, zero, np.array([0.05, 0.0, 0.0]), accel, np.full((2, 6), 1.0))


def measured(robot: RobotModel) -> CalibrationJob:
    procedure = CalibrationProcedure(robot)
    assert procedure.begin("imu", "hanging").accepted
    for tick in range(1, 600):
        procedure.add(sample(robot, 0.005 * tick))
    assert procedure.ready
    return procedure.job(Calibration.none(robot))


class Services:
    """The node and a world that plays drivers, supervisor and client."""

    def __init__(self, bench: Any, robot: RobotModel, **parameters: object) -> None:
        self.bench, self.robot, self.tick = bench, robot, 0
        world = bench.world
        self.offsets = world.create_publisher(JointState, topics.ENCODER_OFFSETS, LATCHED)
        self.state = world.create_publisher(String, topics.DRIVER_STATE, LATCHED)
        self.node = bench.add(StateEstimatorNode, **parameters)
        self.calibration = self.node._calibration
        self.clients: dict[str, Any] = {}

    def tell(self, offsets: np.ndarray) -> None:
        zero = np.zeros(self.robot.nj)
        self.offsets.publish(JointStateCodec(self.robot).encode(1, offsets, zero, zero))
        self.bench.wait(lambda: np.array_equal(self.calibration._encoder_offsets, offsets))

    def hang(self) -> None:
        self.state.publish(String(data=topics.HANGING))
        self.bench.wait(lambda: self.calibration._situation == topics.HANGING)

    def correct(self, sensors: SensorData) -> SensorData:
        """One tick of the node: the running calibration gets the sample as measured, the estimator a corrected one."""
        self.calibration.collect(sensors)
        applied = self.calibration.applied
        return sensors if applied is None else apply_calibration(sensors, applied)

    def ask(self, what: str) -> Any:
        if what not in self.clients:
            self.clients[what] = self.bench.world.create_client(Trigger, f"calibrate/{what}")
            self.bench.wait(self.clients[what].service_is_ready)
            self.bench.spin(0.2)
        return self.clients[what].call_async(Trigger.Request())

    def answer(self, future: Any) -> tuple[bool, str]:
        """Wait for an answer while samples arrive, faster than in real time."""

        def done() -> bool:
            for _ in range(20):
                self.tick += 1
                self.correct(sample(self.robot, 0.001 * self.tick))
            return bool(future.done())

        self.bench.wait(done, 60.0)
        return future.result().success, future.result().message


@pytest.mark.long
def test_a_calibration_is_answered_kept_and_in_effect_at_the_next_start(
    bench: Any, g1: RobotModel, tmp_path: Any
) -> None:
    services = Services(bench, g1, calibration_dir=tmp_path)
    services.tell(np.zeros(g1.nj))
    services.hang()
    first = services.ask("imu")
    bench.wait(lambda: services.calibration._what == "imu")
    accepted, reason = services.answer(services.ask("feet"))
    assert not accepted and "'imu' is being calibrated" in reason
    accepted, reason = services.answer(first)
    assert accepted and "gyro_bias_x = 0.05" in reason and str(tmp_path / "g1.yaml") in reason
    raw = sample(g1, 100.0)
    np.testing.assert_array_equal(services.correct(raw).gyro, raw.gyro)  # not in a running loop
    services.calibration.start()
    np.testing.assert_allclose(services.correct(raw).gyro, 0.0, atol=1e-9)
    assert "imu of" in services.node.values["calibration"]
    accepted, reason = services.answer(services.ask("feet"))  # the estimator is gone, not the file
    assert accepted, reason
    services.calibration.start()
    np.testing.assert_allclose(services.correct(raw).gyro, 0.0, atol=1e-9)
    np.testing.assert_allclose(services.correct(raw).wrenches, 0.0, atol=1e-9)


def test_refusals_name_their_reason(bench: Any, g1: RobotModel, tmp_path: Any) -> None:
    services = Services(bench, g1, calibration_dir=tmp_path)
    assert "'': the robot must stand or hang" in services.answer(services.ask("imu"))[1]
    services.hang()
    silent = services.answer(services.ask("imu"))[1]  # what the drivers subtract is unknown
    assert "no complete sample" in silent
    services.tell(np.zeros(g1.nj))
    assert "both soles" in services.answer(services.ask("joints"))[1]
    services.node.trigger_deactivate()
    assert "not active" in services.answer(services.ask("imu"))[1]
    assert not list(tmp_path.glob("*.yaml*"))
    assert "no previous calibration" in services.answer(services.ask("rollback"))[1]


def test_a_calibration_is_given_up_when_the_node_is_deactivated(bench: Any, g1: RobotModel) -> None:
    services = Services(bench, g1)
    services.tell(np.zeros(g1.nj))
    services.hang()
    future = services.ask("imu")
    bench.wait(lambda: services.calibration._what == "imu")
    services.node.trigger_deactivate()
    bench.wait(future.done)
    assert "not active" in future.result().message


def test_a_calibration_is_given_up_when_its_solver_does_not_start(
    bench: Any, g1: RobotModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_room(self: CalibrationSolver, job: CalibrationJob) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(CalibrationSolver, "start", no_room)
    services = Services(bench, g1)
    services.tell(np.zeros(g1.nj))
    services.hang()
    accepted, text = services.answer(services.ask("imu"))
    assert not accepted
    assert "cannot be started: No space left on device" in text
    assert services.calibration._what == ""


def test_without_a_folder_nothing_is_calibrated(bench: Any, g1: RobotModel) -> None:
    services = Services(bench, g1, calibration_dir="none")
    services.hang()
    for what in ("imu", "show", "rollback"):
        assert "calibration_dir is 'none'" in services.answer(services.ask(what))[1]


def test_a_half_written_file_is_refused_by_name(bench: Any, g1: RobotModel, tmp_path: Any) -> None:
    (tmp_path / "g1.yaml").write_text("schema_version: 1\nrobot: g1\n")
    services = Services(bench, g1, calibration_dir=tmp_path)
    services.node.before_diagnostics()
    assert str(tmp_path / "g1.yaml") in services.node.values["calibration refused"]
    assert services.node.counters["refused calibration file"] == 1
    raw = sample(g1, 1.0)
    np.testing.assert_array_equal(services.correct(raw).gyro, raw.gyro)


def test_the_calibration_sees_the_encoders_as_they_are(
    bench: Any, g1: RobotModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    services = Services(bench, g1)
    offsets = np.linspace(-0.03, 0.03, g1.nj)
    services.tell(offsets)
    seen: list[SensorData] = []
    monkeypatch.setattr(services.calibration._procedure, "add", seen.append)
    monkeypatch.setattr(services.calibration, "_what", "joints")
    corrected = sample(g1, 1.0)
    estimated = services.correct(corrected)
    np.testing.assert_allclose(seen[0].q, corrected.q + offsets)
    np.testing.assert_array_equal(estimated.q, corrected.q)  # the drivers' part is not done twice


def test_new_encoder_offsets_have_the_estimator_start_over(
    bench: Any, g1: RobotModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    services, starts = Services(bench, g1), []
    monkeypatch.setattr(services.calibration, "_start_over", lambda: starts.append(True))
    zero = np.zeros(g1.nj)
    services.tell(zero)
    services.tell(zero)
    assert not starts  # the first word is no news
    services.tell(zero + 0.01)
    assert starts == [True]
    deliver(services.node, topics.ENCODER_OFFSETS, b"nonsense")
    assert services.node.counters[f"refused {topics.ENCODER_OFFSETS}"] == 1
    np.testing.assert_array_equal(services.calibration._encoder_offsets, zero + 0.01)


def test_another_process_works_out_the_same_numbers(bench: Any, g1: RobotModel) -> None:
    job, solver = measured(g1), CalibrationSolver("g1")
    here, there = solve(job, g1), []
    assert here.reply.accepted and solver.poll() is None
    solver.start(job)

    def solved() -> bool:
        there.extend(filter(None, [solver.poll()]))
        return bool(there)

    bench.wait(solved, 60.0)
    assert there[0].reply == here.reply
    np.testing.assert_array_equal(there[0].calibration.gyro_bias, here.calibration.gyro_bias)
    assert solver.poll() is None
    solver.start(job)
    solver._process.kill()
    there.clear()
    bench.wait(solved, 60.0)
    assert not there[0].reply.accepted and "ended with code -9" in there[0].reply.reason


def test_one_service_calibrates_by_name_and_saves_when_requested(
    bench: Any, g1: RobotModel, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    try:
        kind = interface("poise_interfaces", "srv", "Calibrate")
    except PoiseError as error:
        pytest.skip(str(error))
    outcomes: list[Any] = []  # solved in this process
    monkeypatch.setattr(CalibrationSolver, "start", lambda self, job: outcomes.append(solve(job, g1)))
    monkeypatch.setattr(CalibrationSolver, "poll", lambda self: outcomes.pop() if outcomes else None)
    services = Services(bench, g1, calibration_dir=tmp_path)
    services.tell(np.zeros(g1.nj))
    services.hang()
    client = bench.world.create_client(kind, topics.CALIBRATE)
    bench.wait(client.service_is_ready)
    bench.spin(0.2)

    def ask(what: str, *, save: bool = True) -> Any:
        future = client.call_async(kind.Request(what=what, save=save))
        services.answer(future)
        return future.result()

    answer = ask("imu", save=False)
    values = {value.name: (value.value, value.unit) for value in answer.values}
    assert answer.success and answer.message.endswith("not stored, as requested") and not list(tmp_path.glob("*.yaml*"))
    assert values["gyro_bias_x"] == (pytest.approx(0.05), "rad/s") and values["samples_unusable"][1] == ""
    answer = ask("imu")
    assert answer.success and str(tmp_path / "g1.yaml") in answer.message
    shown = {value.name: value for value in ask("show").values}
    assert shown["gyro_bias_x"].value == pytest.approx(0.05) and shown["left_fz"].unit == "N"
    assert "no previous calibration" in ask("rollback").message
    answer = ask("soul")
    assert not answer.success and "known: imu, joints, feet" in answer.message
    accepted, reason = services.answer(services.ask("imu"))  # the older service answers as before
    assert accepted and "gyro_bias_x = 0.05" in reason
