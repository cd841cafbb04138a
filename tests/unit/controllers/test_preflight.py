"""Preflight: each check refuses what it is there for, and names it."""

from dataclasses import replace

import numpy as np
import pytest

from controllers.safety.preflight import Evidence, described_mass, preflight
from controllers.safety.supervisor import Supervisor
from models.errors import RobotModelError
from models.robot_model import RobotModel

RATES = {"joint_states": 1000.0}


@pytest.fixture
def good(robot: RobotModel) -> Evidence:
    return Evidence(
        description=robot.urdf.read_text(encoding="utf-8"),
        joints=robot.posture("stand"),
        base_quaternion=np.array([0.0, 0.0, 0.0, 1.0]),
        rates={"joint_states": 1003.0},
    )


def _findings(robot: RobotModel, evidence: Evidence) -> tuple[str, ...]:
    return preflight(robot, Supervisor(robot).config, evidence, RATES)


def test_the_right_robot_passes(robot: RobotModel, good: Evidence) -> None:
    assert _findings(robot, good) == ()


def test_nothing_arrived(g1: RobotModel) -> None:
    findings = " | ".join(_findings(g1, Evidence()))
    for culprit in ("robot_description", "joint states", "state estimate", "joint_states arrives at 0 Hz"):
        assert culprit in findings


def test_each_finding_names_its_culprit(g1: RobotModel) -> None:
    good = Evidence(
        g1.urdf.read_text(encoding="utf-8"), g1.posture("stand"), {}, np.array([0.0, 0.0, 0.0, 1.0]), dict(RATES)
    )
    outside, unknown = g1.posture("stand").copy(), g1.posture("stand").copy()
    knee = g1.joint_index("left_knee_joint")
    outside[knee], unknown[knee] = g1.q_upper[knee] + 0.2, np.nan
    heavier, unweighed = (
        (good.description or "").replace('<mass value="', f'<mass value="{start}') for start in ("1", 'nan" was="')
    )
    cases = {
        "left_knee_joint": replace(good, joints=outside),
        "left_knee_joint' measures nan": replace(good, joints=unknown),
        "kg": replace(good, description=heavier),
        "nan kg": replace(good, description=unweighed),
        "base tilted by": replace(good, base_quaternion=np.array([1.0, 0.0, 0.0, 0.0])),  # wxyz read as xyzw
        "500 Hz instead of 1000 Hz": replace(good, rates={"joint_states": 500.0}),
        "nan Hz instead of 1000 Hz": replace(good, rates={"joint_states": np.nan}),
        "'odom' has incompatible QoS: publisher: DEADLINE": replace(good, incompatible={"odom": "publisher: DEADLINE"}),
        "joint 'x' is missing": replace(good, refusals={"joint_states": "joint 'x' is missing"}),
    }
    for culprit, evidence in cases.items():
        findings = _findings(g1, evidence)
        assert len(findings) == 1
        assert culprit in findings[0]


def test_described_mass(robot: RobotModel) -> None:
    assert described_mass(robot.urdf.read_text(encoding="utf-8")) == pytest.approx(robot.mass, rel=1e-6)
    with pytest.raises(RobotModelError, match="robot_description"):
        described_mass("<robot")
