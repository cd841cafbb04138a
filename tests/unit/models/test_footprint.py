"""Frame base_footprint against its definition in REP-120."""

import numpy as np
import pinocchio as pin
import pytest

from models.heading import base_footprint


@pytest.mark.parametrize("rpy", [(0.0, 0.0, 0.0), (0.3, -0.2, 2.5), (-0.5, 0.4, -3.1)])
def test_level_between_the_soles_with_the_yaw_of_the_base(rpy: tuple[float, float, float]) -> None:
    base = pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array([3.0, -2.0, 0.8]))
    soles = np.array([[3.1, -1.9, 0.05], [2.9, -2.2, 0.01]])
    pose = base_footprint(np.array(pin.SE3ToXYZQUAT(base)), soles)
    footprint = base * pin.XYZQUATToSE3(pose)
    np.testing.assert_allclose(footprint.translation, [3.0, -2.05, 0.01], atol=1e-12)
    np.testing.assert_allclose(footprint.rotation, pin.rpy.rpyToMatrix(0.0, 0.0, rpy[2]), atol=1e-12)
    assert np.linalg.norm(pose[3:]) == pytest.approx(1.0)
    np.testing.assert_array_equal(soles[:, 2], [0.05, 0.01])  # the caller's array is left alone
