"""The verdicts on a square and on stairs that were walked, on recordings made by kinematics alone."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from bridge.analysis.plots import footsteps, plot_walk
from bridge.demo.report import judge_walk
from bridge.demo.stage import DemoConfig
from bridge.demo.stairs import Landing, StairsScene, judge_stairs
from bridge.record.recording import Recording
from models.config import default_config
from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.terrain import terrain_named

CONFIG = default_config(DemoConfig, "bridge", "demo")
EVENTS = (
    *((0.0, "walk a square of 1 m"), (0.1, "side 1"), (1.0, "walking wave"), (5.0, "walking wave done")),
    *((8.0, "side 2"), (16.0, "side 3"), (18.0, "walking push 10 N.s"), (24.0, "side 4"), (32.0, "stop")),
)


@pytest.fixture(scope="module")
def square(g1: RobotModel) -> Recording:
    """Four sides in 8 s each, turning at their ends, feet loaded in turn; the estimate ends 4 cm off."""
    t = np.arange(0.0, 36.0, 0.02)
    n, stand = len(t), g1.standing_configuration()
    q, v = np.tile(stand, (n, 1)), np.zeros((n, g1.nv))
    side, within = np.divmod(np.minimum(t, 31.999), 8.0)
    along = np.clip(within / 5.0, 0.0, 1.0)
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0]])
    index = side.astype(int)
    q[:, :2] += corners[index] + along[:, None] * (corners[index + 1] - corners[index])
    yaw = 0.5 * np.pi * (side + np.clip((within - 5.0) / 2.9, 0.0, 1.0))
    q[:, 3:7] = [pin.Quaternion(pin.rpy.rpyToMatrix(0.0, 0.0, angle)).coeffs() for angle in yaw]
    shoulder = 7 + g1.joint_index("right_shoulder_pitch_joint")
    q[:, shoulder] -= 1.5 * np.sin(np.pi * np.clip((t - 1.0) / 4.0, 0.0, 1.0)) ** 2
    v[:, 0] = 0.2 + 0.25 * ((t > 18.0) & (t < 18.3))
    wrenches = np.zeros((n, 2, 6))
    left = (t % 0.8) < 0.4
    wrenches[left, 0, 2] = wrenches[~left, 1, 2] = g1.mass * GRAVITY
    estimate = q[:, :7].copy()
    estimate[:, 0] += 0.04 * t / t[-1]
    return Recording("g1", t, q, v, np.zeros((n, g1.nj)), wrenches, EVENTS, estimate)


def verdicts(model: RobotModel, recording: Recording) -> dict[str, bool]:
    return {check.name: check.passed for check in judge_walk(model, recording, CONFIG)[0]}


def test_what_was_walked_is_seen_and_measured(g1: RobotModel, square: Recording) -> None:
    checks, figures = judge_walk(g1, square, CONFIG)
    assert {check.name: check.passed for check in checks} == dict.fromkeys(
        ("walk", "walking wave", "walking push", "stop", "drift"), True
    )
    assert figures["walked_m"] == pytest.approx(4.0, rel=0.05)
    assert figures["drift_m"] == pytest.approx(0.04, abs=1e-3)
    assert figures["drift_percent"] == pytest.approx(100.0 * 0.04 / figures["walked_m"], rel=0.03)
    assert figures["closure_m"] < 1e-3


@pytest.mark.parametrize(
    ("missing", "names"),
    [
        ("walking wave", {"walking wave"}),
        ("walking push 10 N.s", {"walking push"}),
        ("stop", {"stop"}),
    ],
)
def test_what_did_not_happen_fails(g1: RobotModel, square: Recording, missing: str, names: set[str]) -> None:
    events = tuple(event for event in EVENTS if not event[1].startswith(missing))
    failed = {name for name, passed in verdicts(g1, replace(square, events=events)).items() if not passed}
    assert failed == names


def test_standing_still_is_no_walk(g1: RobotModel, square: Recording) -> None:
    n = len(square.t)
    still = replace(square, q=np.tile(square.q[0], (n, 1)), v=0.0 * square.v, wrenches=0.0 * square.wrenches + 1.0)
    failed = {name for name, passed in verdicts(g1, still).items() if not passed}
    assert failed >= {"walk", "walking wave", "walking push", "drift"}


def test_an_open_square_a_fall_and_a_drift_fail(g1: RobotModel, square: Recording) -> None:
    for change, name in (
        (np.where(square.t > 30.0, 0.3, 0.0)[:, None] * np.eye(g1.nq)[0], "walk"),
        (np.where(square.t > 30.0, -0.5, 0.0)[:, None] * np.eye(g1.nq)[2], "walk"),
        (np.where(square.t > 35.5, 0.02, 0.0)[:, None] * np.eye(g1.nq)[1], "stop"),
    ):
        assert not verdicts(g1, replace(square, q=square.q + change))[name]
    assert square.estimate is not None
    far = square.estimate + 0.2 * (square.t / square.t[-1])[:, None] * np.eye(7)[1]
    assert not verdicts(g1, replace(square, estimate=far))["drift"]
    assert not verdicts(g1, replace(square, estimate=None))["drift"]  # unknown


def test_parts_and_footsteps(g1: RobotModel, square: Recording, tmp_path: Path) -> None:
    before, after = replace(square, events=((1.0, "wave"), (4.0, "walk there"))).split("walk")
    assert after is not None and before.t[-1] < 4.0 <= after.t[0]
    assert [text for _, text in before.events] == ["wave"] and [text for _, text in after.events] == ["walk there"]
    assert after.estimate is not None and len(after.estimate) == len(after.t)
    assert square.split("swim") == (square, None)
    part = square.between(0.0, 2.0)
    assert [foot for foot, _ in footsteps(g1, part)].count(0) == 3
    assert plot_walk(g1, part, tmp_path).stat().st_size > 10000
    square.save(tmp_path / "run.npz")
    again = Recording.load(tmp_path / "run.npz")
    assert again.estimate is not None and np.array_equal(again.estimate, square.estimate)


@pytest.mark.parametrize(
    ("changed", "culprit"),
    [
        ({}, []),
        ({"delays": [0.08, 0.2]}, ["latency"]),
        ({"delays": []}, ["latency"]),
        ({"lies": False}, ["soles"]),
        ({"errors": np.full(9, 0.04)}, ["map"]),
        ({"error": (0.2, 0.0)}, ["footholds"]),
        ({"sole": np.zeros(3)}, ["flight"]),
    ],
)
def test_a_walk_over_stairs_fails_for_what_is_wrong_with_it(
    g1: RobotModel, changed: dict[str, Any], culprit: list[str]
) -> None:
    scene, terrain = default_config(StairsScene, "bridge", "demo_stairs"), replace(terrain_named("flight"), count=1)
    q, zeros = np.tile(g1.standing_configuration(), (50, 1)), np.zeros((50, g1.nv))
    recording = Recording(g1.name, np.arange(50) / 10.0, q, zeros, zeros[:, 6:], np.zeros((50, 2, 6)))
    even = Landing(1.0, 0, (0.01, 0.02), True, np.zeros(3), 0.0, np.full(9, 0.002))
    top = even._replace(sole=np.array([1.2, 0.1, 0.15]))
    changed = dict(changed)
    delays = changed.pop("delays", [0.08, 0.14])
    checks, figures = judge_stairs(recording, [even, top._replace(**changed), even], delays, scene, terrain)
    assert figures["steps"] == 3.0 and figures["map_known"] == 1.0
    assert [check.name for check in checks if not check.passed] == culprit
