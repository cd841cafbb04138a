"""Footsteps with heights and tilts as messages."""

import numpy as np
import pytest

from models.errors import MessageError
from planners.gait.footsteps import LEFT, RIGHT, Foothold
from planners.gait.route import Footstep
from planners.gait.tread import Tread
from planners.nodes.footstep_messages import path_from_steps, steps_from_path

SOLES = Foothold(0.0, 0.1, 0.0), Foothold(0.0, -0.1, 0.0)


def test_heights_and_tilts_survive_as_messages() -> None:
    steps = [
        Footstep(LEFT, Foothold(0.3, 0.1, 0.0, 0.15), Tread((0.1, 0.0))),
        Footstep(RIGHT, Foothold(0.3, -0.1, 0.4, 0.15), Tread((-0.05, 0.12))),
    ]
    found = steps_from_path(path_from_steps(1, steps), SOLES)
    for step, expected in zip(found, steps, strict=True):
        assert step.foot == expected.foot and step.tread is not None and expected.tread is not None
        hold, same = step.hold, expected.hold
        assert (hold.x, hold.y, hold.z) == pytest.approx((same.x, same.y, same.z))
        assert hold.yaw == pytest.approx(same.yaw, abs=0.01)  # a tilt across turns the yaw of roll, pitch and yaw
        assert step.tread.slope == pytest.approx(expected.tread.slope)


@pytest.mark.parametrize("turn", [1.6, np.pi])
def test_a_sole_that_does_not_face_upwards_is_refused(turn: float) -> None:
    message = path_from_steps(1, [Footstep(LEFT, Foothold(0.3, 0.1, 0.0))])
    orientation = message.poses[0].pose.orientation
    orientation.x, orientation.w = float(np.sin(0.5 * turn)), float(np.cos(0.5 * turn))
    with pytest.raises(MessageError, match=r"footstep 1: orientation: the sole is tilted by \d\.\d\d rad"):
        steps_from_path(message, SOLES)
