"""A gait planner notes what it was told and did not refuse."""

from __future__ import annotations

import math

import pytest

from models.applied import Applied, TickNote
from models.errors import CommandError
from models.robot_model import RobotModel
from planners.gait.footsteps import Foothold
from planners.gait.noted import NotedGait
from tests.support import standing


def test_every_order_is_noted_and_no_refusal(g1: RobotModel) -> None:
    applied = Applied()
    gait = NotedGait(g1, None, applied)
    gait.reset(standing(g1))
    gait.set_velocity(0.1, 0.0, 0.2)
    gait.set_velocity(0.1, 0.0, 0.2)
    with pytest.raises(CommandError):
        gait.set_velocity(math.nan, 0.0, 0.0)
    gait.stop()
    gait.walk_to(Foothold(0.5, 0.1, 0.2))
    words = TickNote.read(applied.take(1)).before
    assert words == (
        *2 * (("velocity", 0.1, 0.0, 0.2),),
        ("stop",),
        ("walk_to", 0.5, 0.1, 0.2, 0.0),
    )


def test_a_velocity_that_is_told_at_every_tick_is_noted_once(g1: RobotModel) -> None:
    applied = Applied()
    gait = NotedGait(g1, None, applied, held=True)
    for velocity in ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.1, 0.0, 0.0)):
        gait.set_velocity(*velocity)
    assert TickNote.read(applied.take(1)).before == (("hold_velocity", 0.0, 0.0, 0.0), ("hold_velocity", 0.1, 0.0, 0.0))
