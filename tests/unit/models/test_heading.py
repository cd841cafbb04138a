"""Heading of a rotation, and turning by it."""

import numpy as np
import pinocchio as pin
import pytest

from models.heading import heading, turned


@pytest.mark.parametrize("rpy", [(0.0, 0.0, 0.0), (0.3, -0.2, 2.5), (-0.5, 0.4, -3.1)])
def test_what_is_turned_by_minus_the_heading_is_seen_along_it(rpy: tuple[float, float, float]) -> None:
    yaw = heading(*pin.Quaternion(pin.rpy.rpyToMatrix(*rpy)).coeffs())
    assert yaw == pytest.approx(rpy[2])
    turn = pin.rpy.rpyToMatrix(0.0, 0.0, rpy[2])
    assert turned([2.0, 1.0], yaw) == pytest.approx((turn @ [2.0, 1.0, 0.0])[:2])
    assert turned(turn[:2, :2] @ [2.0, 1.0], -yaw) == pytest.approx([2.0, 1.0])


def test_many_vectors_are_turned_to_the_left() -> None:
    points = np.arange(12.0).reshape(2, 3, 2)
    assert turned(points, 0.5 * np.pi) == pytest.approx(np.stack([-points[..., 1], points[..., 0]], axis=-1))
