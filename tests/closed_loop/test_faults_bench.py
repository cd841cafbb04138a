"""Rows of ``poise bench faults`` hold, and fail when the guard that they are about is taken away."""

from __future__ import annotations

from typing import Any
from unittest.mock import patch

import pytest

from benchmarks.fault_acts import ACTS
from benchmarks.fault_rows import config, with_knee
from benchmarks.faults import run, trial
from benchmarks.harness import Case, Options
from controllers.health import Health
from controllers.joint_monitor import JointMonitor
from controllers.joint_servo import JointServo
from models.errors import ConfigError


def test_every_act_is_of_a_row_and_every_row_has_its_act() -> None:
    named = {row.act for row in config().rows.values()} - {""}
    assert named == set(ACTS)


def test_the_knees_name_is_put_in_everywhere() -> None:
    assert with_knee([{"target": "joint:{knee}", "delay": 1.0}], "k") == [{"target": "joint:k", "delay": 1.0}]


def test_an_unknown_row_is_refused_with_those_there_are() -> None:
    with pytest.raises(ConfigError, match="unknown scenario 'meteor'; known: joints_out_10ms"):
        run(Options(scenarios=("meteor",)))


GUARDS: dict[str, tuple[type, str, Any]] = {
    "knee_dead": (JointMonitor, "step", lambda self, state, command: None),
    "imu_out_100ms": (Health, "_damping", lambda self, config, t: []),
    "joints_out_200ms": (JointServo, "overdue", lambda self, t: False),
}
"""Row, and the guard without which it fails: owner, method, and what is done instead."""

SLOW_GUARDS = {
    "encoder_stuck": GUARDS["knee_dead"],
    "encoder_stuck_walk": GUARDS["knee_dead"],
    "knee_dead_walk": GUARDS["knee_dead"],
    "imu_nan": GUARDS["imu_out_100ms"],
    "torque_nan": GUARDS["joints_out_200ms"],
}


def row(name: str) -> Case:
    return trial("g1", 0, name)


@pytest.mark.parametrize("name", [*GUARDS, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW_GUARDS)])
def test_a_row_holds_and_fails_without_its_guard(name: str) -> None:
    assert row(name)["ok"]
    owner, method, instead = {**GUARDS, **SLOW_GUARDS}[name]
    with patch.object(owner, method, instead):
        assert not row(name)["ok"]
