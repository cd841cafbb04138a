"""A simulated robot that differs from its profile: masses, drives, sensors."""

import numpy as np
import pytest

from bridge.plants.deviation import Deviation
from bridge.plants.mujoco import MujocoPlant
from models.errors import JointNameError
from models.robot_model import RobotModel


def test_masses_and_com_deviate(g1: RobotModel) -> None:
    before = MujocoPlant(g1)
    for deviation, mass, shift in (
        (Deviation(mass=1.1), 1.1 * g1.mass, (0.0, 0.0, 0.0)),
        (Deviation(com=(0.02, 0.0, -0.01)), g1.mass, (0.02, 0.0, -0.01)),
    ):
        plant = MujocoPlant(g1)
        deviation.apply(plant, 0)
        assert plant.model.body_mass.sum() == pytest.approx(mass)
        np.testing.assert_allclose(plant.com - before.com, shift, atol=1e-6)
    plant, torso = MujocoPlant(g1), before.mujoco.bodies["torso"]
    Deviation(torso_mass=1.8, torso_com=(0.0, 0.0, 0.017)).apply(plant, 0)
    assert plant.model.body_mass.sum() == pytest.approx(g1.mass + 1.8)
    np.testing.assert_allclose(plant.data.xipos[torso] - before.data.xipos[torso], (0.0, 0.0, 0.017), atol=1e-9)


def test_drives_and_sensors_deviate(g1: RobotModel) -> None:
    plant, knee = MujocoPlant(g1), g1.joint_index("left_knee_joint")
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
    offsets = Deviation(encoder_offset=0.02).encoder_offsets(g1, 3)
    assert 0.015 < np.abs(offsets).max() <= 0.02 and offsets.shape == (g1.nj,)
    assert (offsets != Deviation(encoder_offset=0.02).encoder_offsets(g1, 4)).all()
    with pytest.raises(JointNameError, match="unknown joint 'tail'"):
        Deviation(torque_limits={"tail": 1.0}).apply(plant, 0)
