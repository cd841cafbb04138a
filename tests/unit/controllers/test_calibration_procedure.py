"""What a calibration over the graph waits for, and what makes it give up."""

from collections.abc import Callable

import numpy as np
import pytest

from controllers.calibration.session import CalibrationProcedure
from models.calibration import Calibration
from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.status import MotionState, MotionStatus
from models.types import SensorData


class Run:
    """A procedure that is fed a robot at rest."""

    def __init__(self, robot: RobotModel) -> None:
        self.robot, self.t = robot, 0.0
        self.procedure = CalibrationProcedure(robot)
        self.asked: list[str] = []

    def feed(self, time: float) -> None:
        nj = self.robot.nj
        for _ in range(round(time / 0.005)):
            self.t += 0.005
            gyro, accel = np.zeros(3), np.array([0.0, 0.0, GRAVITY])
            zero = np.zeros(nj)
            self.procedure.add(SensorData(self.t, zero, zero, zero, gyro, accel, np.zeros((2, 6))))
            self.asked += filter(None, [self.procedure.take_motion()])

    def asks(self, what: str) -> None:
        """Up to the moment at which the motion is asked for."""
        assert self.procedure.begin(what, "stand").accepted
        self.feed(0.6)
        assert self.asked == [f"calibrate_{what}"]

    def moves(self, what: str) -> None:
        """Up to the middle of the motion, as the graph reports it."""
        self.asks(what)
        self.procedure.on_situation("motion")
        self.procedure.on_request(f"calibrate_{what} 7")
        self.feed(1.0)
        self.procedure.on_motion(MotionStatus(MotionState.RUNNING))
        self.feed(1.0)


@pytest.fixture
def run(g1: RobotModel) -> Run:
    return Run(g1)


@pytest.mark.parametrize(("what", "time"), [("imu", 2.0), ("feet", 1.0)])
def test_a_hanging_robot_is_measured_at_rest_after_it_has_settled(run: Run, what: str, time: float) -> None:
    procedure = run.procedure
    assert procedure.begin(what, "hanging").accepted
    run.feed(0.5 + time - 0.05)
    assert not procedure.ready
    run.feed(0.1)
    assert procedure.ready and not run.asked
    windows = procedure.job(Calibration.none(run.robot)).windows
    assert windows[0].t > 0.5 and len(windows) == pytest.approx(time / 0.05, abs=2)
    assert not procedure.ready and procedure.begin(what, "hanging").accepted


@pytest.mark.parametrize("what", ["feet", "joints"])
@pytest.mark.parametrize("done_first", [True, False])
def test_a_standing_robot_is_measured_in_its_motion_only(run: Run, what: str, done_first: bool) -> None:
    """Whatever the order in which the word and the mode arrive; standing still while it is planned does not count."""
    run.moves(what)
    begun = run.t - 1.0
    reports: list[Callable[[], None]] = [
        lambda: run.procedure.on_motion(MotionStatus(MotionState.DONE)),
        lambda: run.procedure.on_situation("stand"),
    ]
    for report in reports if done_first else reports[::-1]:
        assert not run.procedure.ready
        report()
    assert run.procedure.ready and not run.procedure.problem
    windows = run.procedure.job(Calibration.none(run.robot)).windows
    assert windows[0].t > begun and len(windows) >= 15


@pytest.mark.parametrize("situation", ["damped", "off", "held", "walk", "motion", "damp", ""])
def test_nothing_is_calibrated_in_any_other_situation(run: Run, situation: str) -> None:
    reply = run.procedure.begin("imu", situation)
    assert not reply.accepted and f"'{situation}'" in reply.reason
    run.feed(3.0)
    assert not run.procedure.ready


def test_joints_are_refused_in_the_air_and_a_second_request_while_one_runs(run: Run) -> None:
    assert "both soles" in run.procedure.begin("joints", "hanging").reason
    assert "known: imu" in run.procedure.begin("nose", "hanging").reason
    assert run.procedure.begin("imu", "hanging").accepted
    reply = run.procedure.begin("feet", "hanging")
    assert not reply.accepted and "'imu' is being calibrated" in reply.reason


@pytest.mark.parametrize("situation", ["damped", "walk", "motion"])
def test_a_change_of_the_situation_gives_up(run: Run, situation: str) -> None:
    assert run.procedure.begin("imu", "stand").accepted
    run.procedure.on_situation("stand")
    assert not run.procedure.problem
    run.feed(1.0)
    run.procedure.on_situation(situation)
    assert f"calibration of 'imu' aborted: the robot is '{situation}'" in run.procedure.problem
    run.feed(3.0)
    assert not run.procedure.ready
    run.procedure.end()
    assert not run.procedure.problem and run.procedure.begin("imu", "stand").accepted


def test_a_motion_that_is_refused_stopped_or_overtaken_gives_up(run: Run) -> None:
    procedure = run.procedure

    def again() -> str:
        problem = procedure.problem
        procedure.end()
        run.asked.clear()
        return problem

    run.asks("joints")
    refused = MotionState.REFUSED
    procedure.on_motion(MotionStatus(refused, "squat 6", "'squat 6' arrived too late"))  # of an earlier request
    assert not procedure.problem
    procedure.on_motion(MotionStatus(refused, "calibrate_joints 7", "key pose 'low' is out of reach"))
    assert "was refused: key pose 'low'" in again()
    run.asks("joints")
    procedure.on_request("wave 3")
    assert "'wave' was requested meanwhile" in again()
    run.asks("joints")
    procedure.on_situation("motion")
    procedure.on_request("calibrate_joints 4")
    procedure.on_situation("stand")
    assert "did not begin" in again()
    run.moves("joints")
    procedure.on_request("stop")
    procedure.on_motion(MotionStatus(MotionState.ENDED, reason="stopped"))
    assert "'stop' was requested meanwhile" in again()
    run.moves("joints")
    procedure.on_motion(MotionStatus(MotionState.ENDED, reason="the controller was deactivated"))
    assert "the motion 'calibrate_joints' ended: the controller was deactivated" in again()
    run.moves("joints")
    procedure.on_situation("damped")
    assert "'damped'" in again()
    run.moves("joints")
    procedure.on_situation("stand")
    procedure.on_request("stop")  # the mode was faster
    assert "'stop' was requested meanwhile" in again()


def test_silence_and_motions_that_never_begin_or_end_give_up(run: Run) -> None:
    procedure, limits = run.procedure, run.procedure.config.procedure

    def wait(time: float, *, samples: bool) -> str:
        for _ in range(round(time / 0.1)):
            procedure.wait(0.1)
            if samples:
                run.feed(0.005)
        problem = procedure.problem
        if problem:
            procedure.end()
            run.asked.clear()
        return problem

    assert procedure.begin("imu", "stand").accepted
    assert not wait(limits.silence - 0.2, samples=False)
    run.feed(0.01)
    assert not wait(limits.silence - 0.2, samples=False)
    assert "no complete sample" in wait(0.4, samples=False)
    run.asks("feet")
    assert not wait(limits.plan - 1.0, samples=True)
    assert "waiting for the motion 'calibrate_feet' took more than" in wait(2.0, samples=True)
    run.moves("feet")
    assert "collecting in motion 'calibrate_feet'" in wait(limits.motion + 1.0, samples=True)
    run.moves("feet")
    procedure.on_situation("stand")
    assert "waiting for the end" in wait(limits.completion + 0.5, samples=True)
