"""Rows of ``poise bench hardware_faults`` hold, and fail without what they are about."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from benchmarks.core.benchmark import catalogue
from benchmarks.core.harness import Options
from benchmarks.faults import hardware_faults
from benchmarks.faults.hardware_acts import ACTS
from benchmarks.faults.hardware_faults import Row, Trial, config, measure
from bridge.driver.startup import Startup
from bridge.hardware_loop import HardwareLoop
from bridge.plants.guard import SilenceGuard
from bridge.plants.hardware import ForeignCommands, GuardWatch, RobotClock
from bridge.plants.ros2_control.commands import EffortCodec
from bridge.plants.ros2_control.plant import Ros2ControlPlant
from controllers.joints.joint_servo import JointServo, damping_command
from models.errors import ConfigError
from models.robot_model import RobotModel
from models.types import JointCommand
from tests.gantry import started

ROWS = config().rows
QUICK = ("driver_killed_walk", "foreign", "battery_swap")  #: Of the rows that damp, in every run of the tests
#: On one robot, one after the other: it stands after each
IN_SEQUENCE = (
    "crc_state_once", "crc_command_once", "nan_state_once", "states_repeated_10ms", "cable_10ms", "driver_late_30ms",
    "guard_stopped", "hot_91",
)  # fmt: skip

SLOW = pytest.mark.slow
#: Guards of rows behind ros2_control, and what they do when they are removed
REMOVED: list[Any] = [
    ("other_driver", ForeignCommands, "step", lambda self, count, dt: None),
    pytest.param("effort_driver_killed", SilenceGuard, "step", lambda self, now: None, marks=SLOW),
    pytest.param("imu_silent", Ros2ControlPlant, "_ages", lambda self: {}, marks=SLOW),
    pytest.param("controller_inactive", Ros2ControlPlant, "_inactive", lambda self: [], marks=SLOW),
    pytest.param("stamps_forward", RobotClock, "step", lambda self, count: count * self._tick, marks=SLOW),
    pytest.param("guard_stopped", GuardWatch, "holds", (), marks=SLOW),
    pytest.param("guard_missing", GuardWatch, "step", lambda self, beats: setattr(self, "silence", 0.0), marks=SLOW),
    pytest.param("crashed_and_rebooted", Startup, "_recover", lambda self, inputs, dt: self.damp(""), marks=SLOW),
    pytest.param("crashed_no_answer", Startup, "_recover", lambda self, inputs, dt: self.damp(""), marks=SLOW),
    pytest.param("effort_control_killed_walk", JointServo, "overdue", lambda self, t: False, marks=SLOW),
]


def test_rows_and_acts_belong_together() -> None:
    assert {row.act for row in ROWS.values()} == set(ACTS)
    assert len(ROWS) >= 20
    assert all(row.reason or row.act == "driver_killed" for row in ROWS.values() if row.expect != "goes on")
    assert all(row.within for row in ROWS.values() if row.expect in ("damps", "holds"))
    with pytest.raises(ConfigError, match="unknown scenario 'flood'; known: crc_state_once"):
        catalogue()["hardware_faults"].load().run(Options(scenarios=("flood",)))


@pytest.mark.long
def test_a_standing_robot_takes_one_after_the_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hardware_faults, "config", lambda: replace(config(), settle=0.1, duration=0.4))
    loop = started(HardwareLoop(tmp_path / "marker"))
    for name in IN_SEQUENCE:
        case = Trial(loop, ROWS[name]).run()
        assert case["ok"] and case["torque_step"] < 1.0, (name, case)
    hot = ROWS["hot_91"]
    for changes in ({"within": 0.001}, {"reason": "meteor"}, {"expect": "goes on", "within": None}):
        row: Row = replace(hot, **changes)  # type: ignore[arg-type]
        assert not Trial(loop, row).run()["ok"], changes


@pytest.mark.long
@pytest.mark.parametrize("name", [pytest.param(name, marks=[] if name in QUICK else pytest.mark.slow) for name in ROWS])
def test_a_row_holds(name: str) -> None:
    case = measure("g1", 0, name)
    assert case["ok"], case


@pytest.mark.long
@pytest.mark.parametrize(("name", "owner", "method", "removed"), REMOVED)
def test_a_row_fails_without_its_guard(
    name: str, owner: type, method: str, removed: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(owner, method, removed)
    case = measure("g1", 0, name)
    assert not case["ok"], case


@pytest.mark.long
def test_torques_without_a_rate_limit_follow_shaken_joints(monkeypatch: pytest.MonkeyPatch) -> None:
    encode = EffortCodec.encode
    monkeypatch.setattr(EffortCodec, "encode", lambda self, *command: encode(self, *command[:4]))
    case = measure("g1", 0, "other_driver")
    assert case["torque_step"] > 2.0  # 1.0 with the limit


@pytest.mark.long
def test_a_guard_that_does_not_fade_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    def at_once(model: RobotModel, last: JointCommand, elapsed: float) -> JointCommand:
        return damping_command(model)

    monkeypatch.setattr("bridge.plants.guard.fade_to_damping", at_once)
    case = measure("g1", 3, "driver_killed_walk")
    assert case["torque_step_nm"] > 30.0  # 0.7 N.m with the fade
