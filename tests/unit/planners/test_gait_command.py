"""Commanded velocities that hold or fall silent; the coming steps; the capturability margin."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from msgspec import structs

from models.robot_model import RobotModel
from models.types import STILL
from planners.gait import adjustment
from planners.gait.commands import VelocityCommand
from planners.gait.footsteps import Foothold
from planners.gait.planner import GaitPlanner
from planners.gait.state import GaitPhase, GaitView, capture_margin, coming_steps
from planners.gait.step_problem import UNSOLVED
from tests.support import standing

AHEAD = (0.3, 0.0, 0.1)


def test_a_repeated_command_falls_silent_once() -> None:
    command = VelocityCommand(timeout=0.5)
    assert not command.lapsed(100.0)  # no command yet
    command.repeat(AHEAD, 1.0)
    assert not command.lapsed(1.5)
    command.repeat(AHEAD, 1.4)
    assert not command.lapsed(1.9)
    assert command.velocity == AHEAD
    assert command.lapsed(1.91)
    assert command.velocity == STILL
    assert not command.lapsed(1.92)
    command.repeat(AHEAD, 2.0)
    assert command.velocity == AHEAD


def test_a_velocity_that_something_else_has_replaced_counts_once_it_has_changed() -> None:
    command = VelocityCommand(timeout=0.5)
    command.repeat(AHEAD, 0.0)
    command.supersede()
    command.repeat(AHEAD, 0.1)
    assert command.velocity == STILL
    command.repeat(STILL, 0.2)
    command.repeat(AHEAD, 0.3)
    assert command.velocity == AHEAD
    assert not command.lapsed(0.8)


@pytest.fixture
def planner(g1: RobotModel) -> GaitPlanner:
    planner = GaitPlanner(g1)
    planner.reset(standing(g1))
    return planner


@pytest.fixture
def view(planner: GaitPlanner) -> GaitView:
    """The robot stands, its DCM in the middle of its feet."""
    view = planner.view
    return replace(view, dcm=view.soles.middle(view.state.soles.holds))


def commanded(view: GaitView, **command: Any) -> GaitView:
    """The same with another velocity or number of steps left."""
    return replace(view, state=replace(view.state, command=structs.replace(view.state.command, **command)))


def swinging(view: GaitView, elapsed: float = 0.1) -> GaitView:
    """On the right foot, the DCM where a walk on the spot has it in the middle of the step."""
    left, stance = (view.soles.point_of(foot, view.state.soles.holds[foot]) for foot in range(2))
    dcm = stance + 0.35 * (left - stance)
    return replace(view, state=replace(view.state, phase=GaitPhase.SINGLE, stance=1, elapsed=elapsed), dcm=dcm)


def test_at_rest_no_steps_are_coming(planner: GaitPlanner, view: GaitView) -> None:
    assert coming_steps(view, planner.config) == []


def test_coming_steps_alternate_and_begin_with_the_foot_in_the_air(planner: GaitPlanner, view: GaitView) -> None:
    config = planner.config
    walk = swinging(commanded(view, velocity=(0.3, 0.0, 0.0)))
    target, soles = Foothold(0.2, 0.1, 0.0), walk.state.soles
    walk = replace(walk, state=replace(walk.state, soles=structs.replace(soles, holds=(target, soles.holds[1]))))
    steps = coming_steps(walk, config)
    assert len(steps) == config.preview
    assert steps[0] == target
    assert [step.y > 0.0 for step in steps[:4]] == [True, False, True, False]
    assert [step.x for step in steps] == sorted(step.x for step in steps)
    start = coming_steps(replace(walk, state=replace(walk.state, phase=GaitPhase.START)), config)
    assert len(start) == config.preview
    assert start[0].y > 0.0  # the left foot swings first


def test_the_last_steps_end_the_plan(planner: GaitPlanner, view: GaitView) -> None:
    walk = swinging(view)
    assert len(coming_steps(commanded(walk, steps_left=1), planner.config)) == 1
    assert len(coming_steps(commanded(walk, steps_left=2), planner.config)) == 2
    landed = replace(walk, state=replace(walk.state, phase=GaitPhase.DOUBLE))
    assert len(coming_steps(commanded(landed, steps_left=1), planner.config)) == 1


def test_a_robot_at_rest_has_margin_and_one_that_falls_has_not(planner: GaitPlanner, view: GaitView) -> None:
    config = planner.config
    half = float(view.soles.half[0].min())
    assert capture_margin(view, config) > half
    for direction in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)):
        margins = [
            capture_margin(replace(view, dcm=view.dcm + d * np.array(direction)), config) for d in (0.1, 0.3, 0.6)
        ]
        assert margins == sorted(margins, reverse=True)
        assert margins[-1] < 0.0


def test_one_step_catches_just_what_the_pendulum_says(planner: GaitPlanner, view: GaitView) -> None:
    """From the edge of the region, with the CoP at its best, the DCM reaches the far edge of the farthest foothold."""
    config, walk = planner.config, swinging(view)
    walk = replace(walk, dcm=view.soles.middle(view.state.soles.holds) + np.array([0.37, 0.0]))
    edge = walk.dcm[0] + capture_margin(walk, config)
    stance, half = walk.state.soles.holds[1].moved(*walk.soles.centres[1].tolist())[0], float(walk.soles.half[1, 0])
    cop = stance + half
    landed = cop + (edge - cop) * math.exp(walk.state.omega * (config.timing.single_min - walk.state.elapsed))
    assert landed == pytest.approx(stance + config.reach.forward + half, abs=1e-9)


def test_a_dcm_too_near_the_stance_foot_is_caught_by_a_later_step(planner: GaitPlanner, view: GaitView) -> None:
    config, walk = planner.config, swinging(view)
    walk = replace(walk, dcm=walk.soles.point_of(1, walk.state.soles.holds[1]) + np.array([0.0, 0.02]))
    least = config.timing.single_min
    slow, fast = (replace(stride, single=least) for stride in (config.pace.slow, config.pace.fast))
    hurried = replace(
        config,
        pace=replace(config.pace, slow=slow, fast=fast),
        timing=replace(config.timing, single_max=least),
    )
    assert capture_margin(walk, hurried) < 0.0 < capture_margin(walk, config)


def test_the_margin_is_mirror_symmetric(planner: GaitPlanner, view: GaitView) -> None:
    config, right = planner.config, swinging(view)
    y = view.soles.middle(view.state.soles.holds)[1]
    for offset in (-0.05, 0.0, 0.05, 0.2):
        here = replace(right, dcm=right.dcm + np.array([0.0, offset]))
        mirrored = replace(
            here, state=replace(here.state, stance=0), dcm=np.array([here.dcm[0], 2.0 * y - here.dcm[1]])
        )
        assert capture_margin(mirrored, config) == pytest.approx(capture_margin(here, config), abs=1e-4)


def test_unsolved_adjustments_are_counted(planner: GaitPlanner, monkeypatch: pytest.MonkeyPatch) -> None:
    planner.set_velocity(0.2, 0.0, 0.0)
    solve = adjustment._best_of_region
    monkeypatch.setattr(adjustment, "_best_of_region", lambda *args: max(solve(*args), UNSOLVED))
    while planner.phase is not GaitPhase.SINGLE:
        planner.step(standing(planner.model), 0.01)
    assert planner.state.step.unsolved == 1
