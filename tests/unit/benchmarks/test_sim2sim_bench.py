"""The benchmark of a robot that differs from its model: cases, verdicts, the deviations, and one tiny run."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.core.benchmark import catalogue
from benchmarks.core.harness import Options, Report
from benchmarks.stability import sim2sim
from bridge.plants.deviation import Deviation
from bridge.plants.mujoco import MujocoPlant
from models.errors import ConfigError, JointNameError
from models.robot_model import RobotModel

CONFIG = sim2sim._config()
BENCH = catalogue()["sim2sim"].load()


def report_of(results: list[dict[str, Any]]) -> Report:
    """Their report, judged by the bounds."""
    return Report("sim2sim", "g1", 1, BENCH.figures(results), results, True, {})


def good(seeds: int) -> list[dict[str, Any]]:
    """Results of runs that all survived."""
    outcome = {"distance": 5.0, "drift": 0.001, "odometry": 0.01, "aside": 0.1, "phase": "stop", "survived": True}
    return [{**case, **outcome, "reason": "", "time": 38.0} for case in BENCH.cases(Options("g1", seeds))]


def test_the_cases_are_the_conditions_or_those_chosen() -> None:
    cases = BENCH.cases(Options("g1", 2))
    assert {case["scenario"] for case in cases} == set(CONFIG.conditions)
    assert {case["seed"] for case in cases} == {CONFIG.first_seed, CONFIG.first_seed + 1}
    with pytest.raises(ConfigError, match="unknown scenario 'lava'; known: nominal"):
        BENCH.cases(Options("g1", scenarios=("lava",)))
    with pytest.raises(ConfigError, match="no laws for robot 'talos'; known: g1"):
        sim2sim.measure("talos", 0, "nominal")


@pytest.mark.parametrize(("failures", "passes"), [(1, True), (2, False)])
@pytest.mark.parametrize("name", list(CONFIG.conditions))
def test_nineteen_of_twenty_decide(name: str, failures: int, passes: bool) -> None:
    results = good(20)
    for case in [case for case in results if case["scenario"] == name][:failures]:
        case.update(survived=False, reason="base tilted", phase="walk", drift=float("nan"))
    report = report_of(results)
    assert BENCH.passed(report) is passes
    assert report.figures[f"drift_{name}_m"] == 0.001
    assert sum("walk, 38.0 s: base tilted" in note for note in BENCH.notes(report)) == failures


@pytest.fixture(scope="module")
def model() -> RobotModel:
    return RobotModel.load("g1")


def test_masses_and_com_deviate(model: RobotModel) -> None:
    before = MujocoPlant(model)
    for deviation, mass, shift in (
        (Deviation(mass=1.1), 1.1 * model.mass, (0.0, 0.0, 0.0)),
        (Deviation(com=(0.02, 0.0, -0.01)), model.mass, (0.02, 0.0, -0.01)),
    ):
        plant = MujocoPlant(model)
        deviation.apply(plant, 0)
        assert plant.model.body_mass.sum() == pytest.approx(mass)
        np.testing.assert_allclose(plant.com - before.com, shift, atol=1e-6)
    plant, torso = MujocoPlant(model), before.mujoco.bodies["torso"]
    Deviation(torso_mass=1.8, torso_com=(0.0, 0.0, 0.017)).apply(plant, 0)
    assert plant.model.body_mass.sum() == pytest.approx(model.mass + 1.8)
    np.testing.assert_allclose(plant.data.xipos[torso] - before.data.xipos[torso], (0.0, 0.0, 0.017), atol=1e-9)


def test_drives_and_sensors_deviate(model: RobotModel) -> None:
    plant, knee = MujocoPlant(model), model.joint_index("left_knee_joint")
    dof = plant.mujoco.joint_qvel
    limits = {"left_knee_joint": 50.0}
    Deviation(armature=0.01, frictionloss=(0.1, 0.2), friction=3.0, torque_limits=limits, imu=(0.1, 0.0, 0.0)).apply(
        plant, 3
    )
    assert (plant.model.dof_armature[dof] == 0.01).all()
    friction = plant.model.dof_frictionloss[dof]
    assert friction.min() >= 0.3 and friction.max() <= 0.6 and np.ptp(friction) > 0.1
    np.testing.assert_allclose(plant.model.actuator_ctrlrange[plant.mujoco.actuator[knee]], (-50.0, 50.0))
    np.testing.assert_allclose(plant.model.site_pos[plant.mujoco.imu_site], (0.1, 0.0, 0.0))
    offsets = Deviation(encoder_offset=0.02).encoder_offsets(model, 3)
    assert 0.015 < np.abs(offsets).max() <= 0.02 and offsets.shape == (model.nj,)
    assert (offsets != Deviation(encoder_offset=0.02).encoder_offsets(model, 4)).all()
    with pytest.raises(JointNameError, match="unknown joint 'tail'"):
        Deviation(torque_limits={"tail": 1.0}).apply(plant, 0)


def test_a_run_that_is_too_slow_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """Through the whole start; half a second of walking cannot cover the distance."""
    short = replace(CONFIG, stand_time=0.5, motion_time=0.1, distance=0.1)
    monkeypatch.setattr(sim2sim, "_config", lambda: short)
    case = sim2sim.measure("g1", 100, "unitree")
    assert not case["survived"] and case["phase"] == "motion" and "mode 'motion' after 0.1 s" in case["reason"]
    assert case["drift"] < 0.01 and case["moments"]["mode"][-1] == "motion"
