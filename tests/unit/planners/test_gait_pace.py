"""Pace of the steps over the friction of the ground."""

import math

import pytest

from models.config import default_config
from planners.gait.config import GaitConfig
from planners.gait.pace import longest_step, pace_at, share_within, velocity_within

CONFIG = default_config(GaitConfig, "planners", "gait")
HEIGHT, WIDTH = 0.65, CONFIG.reach.width


def test_steps_of_a_grip_as_usual_are_not_limited() -> None:
    fastest = (CONFIG.velocity.forward, 0.0, 0.0)
    for friction in (0.8, math.inf):
        longest = longest_step(friction, HEIGHT, WIDTH, CONFIG.pace)
        assert share_within((0.4, 0.0, 0.0), longest, CONFIG.pace) == 0.0
        assert velocity_within(fastest, longest, CONFIG.pace) == fastest


@pytest.mark.parametrize("friction", [0.18, 0.2, 0.25, 0.3])
def test_the_ground_bears_the_steps_of_every_velocity(friction: float) -> None:
    longest = longest_step(friction, HEIGHT, WIDTH, CONFIG.pace)
    for forward, left in ((0.1, 0.0), (0.4, 0.1), (-0.3, 0.0), (1.0, 0.0)):
        velocity = velocity_within((forward, left, 0.2), longest, CONFIG.pace)
        share = share_within(velocity, longest, CONFIG.pace)
        length = math.hypot(*velocity[:2]) * pace_at(share, CONFIG.pace).period
        assert math.hypot(length, WIDTH) / (2.0 * HEIGHT) <= CONFIG.pace.friction_share * friction + 1e-9


def test_without_grip_the_robot_steps_on_the_spot() -> None:
    assert longest_step(0.05, HEIGHT, WIDTH, CONFIG.pace) == 0.0
    assert velocity_within((0.4, 0.1, 0.2), 0.0, CONFIG.pace) == (0.0, 0.0, 0.0)
