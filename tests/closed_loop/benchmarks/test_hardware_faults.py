"""Rows of ``poise bench hardware_faults`` hold, and fail without what they are about."""

from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.core.benchmark import catalogue
from benchmarks.core.harness import Options
from benchmarks.faults import hardware_faults
from benchmarks.faults.hardware_acts import ACTS
from benchmarks.faults.hardware_faults import Row, Trial, config, measure
from bridge.hardware_loop import HardwareLoop
from controllers.joints.joint_servo import damping_command
from models.errors import ConfigError
from models.robot_model import RobotModel
from models.types import JointCommand

ROWS = config().rows
QUICK = ("driver_killed_walk", "foreign", "battery_swap")  #: Of the rows that damp, in every run of the tests
#: On one robot, one after the other: it stands after each
IN_SEQUENCE = (
    "crc_state_once", "crc_command_once", "nan_state_once", "states_repeated_10ms", "cable_10ms", "driver_late_30ms",
    "guard_killed", "hot_91",
)  # fmt: skip


def test_rows_and_acts_belong_together() -> None:
    assert {row.act for row in ROWS.values()} == set(ACTS)
    assert len(ROWS) >= 20
    assert all(row.reason or row.act == "driver_killed" for row in ROWS.values() if row.expect != "goes on")
    assert all(row.within for row in ROWS.values() if row.expect in ("damps", "holds"))
    with pytest.raises(ConfigError, match="unknown scenario 'flood'; known: crc_state_once"):
        catalogue()["hardware_faults"].load().run(Options(scenarios=("flood",)))


def test_a_standing_robot_takes_one_after_the_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hardware_faults, "config", lambda: replace(config(), settle=0.1, duration=0.4))
    loop = HardwareLoop(tmp_path / "marker")
    loop.start()
    loop.unhook()
    for name in IN_SEQUENCE:
        case = Trial(loop, ROWS[name]).run()
        assert case["ok"] and case["torque_step"] < 1.0, (name, case)
    hot = ROWS["hot_91"]
    for changes in ({"within": 0.001}, {"reason": "meteor"}, {"expect": "goes on", "within": None}):
        row: Row = replace(hot, **changes)  # type: ignore[arg-type]
        assert not Trial(loop, row).run()["ok"], changes


@pytest.mark.parametrize("name", [pytest.param(name, marks=[] if name in QUICK else pytest.mark.slow) for name in ROWS])
def test_a_row_holds(name: str) -> None:
    case = measure("g1", 0, name)
    assert case["ok"], case


def test_a_guard_that_does_not_fade_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    def at_once(model: RobotModel, last: JointCommand, elapsed: float) -> JointCommand:
        return damping_command(model)

    monkeypatch.setattr("bridge.plants.guard.fade_to_damping", at_once)
    case = measure("g1", 3, "driver_killed_walk")
    assert case["torque_step_nm"] > 30.0  # 0.7 N.m with the fade
