"""A payload of the profile changes mass and CoM of the model as it says."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from benchmarks.stability.sim2sim import conditions
from bridge.driver.foot_load import payload_profile
from models.errors import ConfigError, RobotModelError
from models.profile import Payload
from models.robot_model import RobotModel
from models.types import Vector
from planners.whole_body_ik import placo_robot


def load(folder: Path, mass: float, com: tuple[float, float]) -> RobotModel:
    file = folder / "robot.yaml"
    file.write_text(payload_profile("g1_hardware", "g1_hardware", Payload(mass, com)), encoding="utf-8")
    return RobotModel.load(file)


def com_of(model: RobotModel) -> Vector:
    """CoM in the frame of the base, which is upright, in the standing posture (3,) [m]."""
    q = pin.neutral(model.pin)
    q[7:] = model.posture("stand")
    return np.array(pin.centerOfMass(model.pin, model.data(), q))


@pytest.mark.parametrize(("mass", "com"), [(1.8, (0.0, 0.0)), (0.0, (0.02, -0.01)), (-0.5, (-0.01, 0.005))])
def test_mass_and_com(tmp_path: Path, g1: RobotModel, mass: float, com: tuple[float, float]) -> None:
    model = load(tmp_path, mass, com)
    assert model.mass == pytest.approx(g1.mass + mass)
    assert pin.computeTotalMass(model.pin) == pytest.approx(model.mass)
    np.testing.assert_allclose((com_of(model) - com_of(g1))[:2], com, atol=1e-9)
    legs = [name for name in model.joint_names if "knee" in name or "hip" in name]
    for name in legs:
        assert model.pin.inertias[model.pin.getJointId(name)].isApprox(g1.pin.inertias[g1.pin.getJointId(name)])


def test_a_profile_is_not_replaced_by_one_that_extends_it(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    assert "extends: g1" in payload_profile("g1", "g1", Payload(1.0), file)
    with pytest.raises(ConfigError, match=r"robot\.yaml: the result extends this profile; .* another name"):
        payload_profile(str(file), "g1", Payload(1.0), file)


def test_the_g1_of_mode_machine_2_is_as_unitree_models_it(g1: RobotModel) -> None:
    """Mass, limits and friction that ``sim2sim`` gives its robot as the condition ``unitree``."""
    deviation, model = conditions()["unitree"].deviation, RobotModel.load("g1_mode_2_hardware")
    assert deviation is not None and deviation.torque_limits and deviation.frictionloss
    assert model.mass == pytest.approx(g1.mass + deviation.torso_mass) == pytest.approx(35.1, abs=0.1)
    changed = {name: model.tau_max[model.joint_names.index(name)] for name in deviation.torque_limits}
    assert changed == deviation.torque_limits
    frictions = [motor.frictionloss for motor in model.profile.motors.values()]
    assert frictions == pytest.approx([np.mean(deviation.frictionloss)] * len(frictions))
    assert model.profile.hardware and model.profile.hardware.mode_machine == 2


def test_motions_are_planned_with_the_payload(tmp_path: Path, g1: RobotModel) -> None:
    """placo has the CoM of the laws: a robot with a payload refused every motion."""
    com = (0.02, 0.0)
    loaded, bare = placo_robot(load(tmp_path, 1.8, com)).com_world(), placo_robot(g1).com_world()
    np.testing.assert_allclose((loaded - bare)[:2], com, atol=1e-9)


def test_no_torso_is_left(tmp_path: Path) -> None:
    with pytest.raises(RobotModelError, match=r"payload.mass: with -40 kg the torso has no mass"):
        load(tmp_path, -40.0, (0.0, 0.0))
