import io
import json
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from bridge.demo.report import Check, judge, judge_speed, print_report, write_report
from bridge.demo.stage import DemoConfig
from bridge.record.recording import Recording
from models.config import default_config
from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import Matrix, Vector

CONFIG = default_config(DemoConfig, "bridge", "demo")
EVENTS = ((3.0, "wave"), (6.0, "wave done"), (7.0, "squat"), (10.0, "squat done"), (11.0, "push 10 N.s"))


def _run(model: RobotModel, events: tuple[tuple[float, str], ...] = EVENTS) -> Recording:
    """A run in which the arm waves, the pelvis sinks and a push moves the base, by kinematics alone."""
    t = np.linspace(0.0, 16.0, 801)
    q = np.tile(model.standing_configuration(), (len(t), 1))
    v = np.zeros((len(t), model.nv))

    def bump(start: float, end: float) -> Vector:
        inside = np.clip((t - start) / (end - start), 0.0, 1.0)
        return np.asarray(np.sin(np.pi * inside) ** 2)

    shoulder = 7 + model.joint_index("right_shoulder_pitch_joint")
    q[:, shoulder] -= 1.5 * bump(3.5, 5.5)
    q[:, 2] -= 0.1 * bump(7.5, 9.5)
    v[:, 1] = 0.2 * bump(11.0, 12.0)
    return Recording(model.name, t, q, v, np.zeros((len(t), model.nj)), _weight(model, len(t)), events)


def _weight(model: RobotModel, rows: int) -> Matrix:
    wrenches = np.zeros((rows, 2, 6))
    wrenches[:, :, 2] = 0.5 * model.mass * GRAVITY
    return wrenches


def _verdicts(model: RobotModel, recording: Recording) -> dict[str, bool]:
    return {check.name: check.passed for check in judge(model, recording, CONFIG)[0]}


def test_everything_that_happened_is_seen(g1: RobotModel) -> None:
    # The squat of this run lifts the soles with the pelvis' own motion, so standing is judged apart.
    verdicts = _verdicts(g1, _run(g1))
    assert {name: verdicts[name] for name in ("wave", "squat", "push")} == dict.fromkeys(
        ("wave", "squat", "push"), True
    )


def test_what_did_not_happen_fails(g1: RobotModel) -> None:
    run = _run(g1)
    still = np.tile(run.q[0], (len(run.t), 1))
    recording = Recording("g1", run.t, still, 0.0 * run.v, run.tau, run.wrenches, EVENTS)
    assert _verdicts(g1, recording) == {"stand": True, "wave": False, "squat": False, "push": False}


def test_a_missing_event_fails(g1: RobotModel) -> None:
    assert not _verdicts(g1, _run(g1, EVENTS[:4]))["push"]


def test_a_robot_that_fell_or_stepped_does_not_stand(g1: RobotModel) -> None:
    run = _run(g1)
    for column, amount in ((0, 0.03), (2, -0.3)):
        q = np.tile(run.q[0], (len(run.t), 1))
        q[run.t > 12.0, column] += amount
        assert not _verdicts(g1, Recording("g1", run.t, q, run.v, run.tau, run.wrenches, EVENTS))["stand"]


def test_a_robot_on_its_knees_has_not_taken_the_push(g1: RobotModel) -> None:
    run = _run(g1)
    q = run.q.copy()
    q[run.t > 12.0, 2] -= 0.4
    assert not _verdicts(g1, Recording("g1", run.t, q, run.v, run.tau, run.wrenches, EVENTS))["push"]


def test_the_report_is_json_and_a_table(tmp_path: Path) -> None:
    checks = [Check("wave", True, "hand moved [59] cm"), Check("push", False, "fell")]
    stable, fast = {"com_drift_m": 0.0016}, {"latency_us_p50": 1380.0, "real_time_factor": float("nan")}
    write_report(tmp_path / "report.json", "g1", checks, stable, fast, False)
    data = json.loads((tmp_path / "report.json").read_text(), parse_constant=pytest.fail)
    assert data["passed"] is False and data["figures"]["real_time_factor"] is None
    assert [check["name"] for check in data["checks"]] == ["wave", "push"]
    console = Console(file=io.StringIO(), width=100)
    print_report(console, "g1", checks, stable, fast)
    text = console.file.getvalue()  # type: ignore[attr-defined]
    assert "hand moved [59] cm" in text and "1.6 mm" in text and "1.38 ms" in text and "failed" in text
    assert all(title in text for title in ("check", "result", "measured", "figure", "value"))


@pytest.mark.parametrize(("factor", "passed"), [(0.99, True), (0.5, True), (0.05, True), (float("nan"), False)])
def test_a_run_may_be_slower_than_real_time_but_must_end(factor: float, passed: bool) -> None:
    check = judge_speed({"real_time_factor": factor})
    assert check.passed is passed
    assert ("simulated time waited" in check.detail) is (factor < 0.9)
