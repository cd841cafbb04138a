"""What a gait looks like from outside: the coming steps, and how far the robot is from where one step catches it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.types import Vector
from planners.gait.config import GaitConfig
from planners.gait.footsteps import LEFT, Foothold, Velocity, preview_footholds
from planners.gait.route import Route
from planners.gait.soles import Soles

TIMES = 5
"""Touchdown times that the capturability margin tries."""


@dataclass(frozen=True, slots=True)
class GaitView:
    """Where a gait is.

    Attributes:
        phase: Name of the phase.
        swinging: Whether a foot is in the air.
        stance: The foot that bears, or that will (0 left, 1 right).
        steps: Touchdowns so far.
        elapsed: Time in this phase [s].
        step_time: Planned single support of the step under way [s].
        steps_left: Touchdowns until the walk ends; None to walk on.
        velocity: What the walk is to do, within the limits.
        dcm: Measured DCM in W (2,) [m].
        omega: Of the pendulum [1/s].
        soles: Where they are planned.
        unsolved: Step adjustments that found no solution so far.
        route: Footholds that go before those of the velocity.
    """

    phase: str
    swinging: bool
    stance: int
    steps: int
    elapsed: float
    step_time: float
    steps_left: int | None
    velocity: Velocity
    dcm: Vector
    omega: float
    soles: Soles
    unsolved: int
    route: Route


def coming_steps(view: GaitView, config: GaitConfig) -> list[Foothold]:
    """The next footholds, alternating feet; the first is the adjusted one of the foot in the air. Empty at rest."""
    if view.phase in ("stand", "finish"):
        return []
    first, foot = view.soles.holds[view.stance], 1 - view.stance
    taken, left = [], view.steps_left
    if view.swinging:
        taken = [view.soles.holds[foot]]
        first, foot = taken[0], view.stance
        left = None if left is None else left - 1
    if left is not None and left <= 0:
        return taken
    if view.route.left:
        return [*taken, *view.route.ahead(view.soles.holds[view.stance], config.preview)[len(taken) :]]
    count = config.preview - len(taken)
    return taken + preview_footholds(first, foot, view.velocity, config.period, config.reach, max(count, 1), left)


def capture_margin(view: GaitView, config: GaitConfig) -> float:
    r"""Distance of the DCM inside the region from which one step brings the robot to rest; negative outside [m].

    With the CoP anywhere in the stance sole (half size h) until a touchdown after t, the DCM ends within
    ``exp(omega t) xi -+ (exp(omega t) - 1) h``; one step suffices if that meets the footholds in reach, grown by half
    the landing sole (half size h'). Along each axis of the stance sole:

    .. math:: e^{\omega t} \xi \in [r_{min} - h', r_{max} + h'] \pm (e^{\omega t} - 1) h

    The margin is that of the best time among ``TIMES`` from the soonest to the latest one. On both feet the box around
    the soles counts too, where no step is needed.

    Args:
        view: Where the gait is.
        config: Limits of footholds and times.

    References:
        Koolen et al.: Capturability-based analysis and control of legged locomotion, part 1, IJRR 2012, section 5.
    """
    if view.swinging:
        return _one_step(view, config, view.stance, view.elapsed)
    place, half = view.soles.standing_box(view.dcm)
    stances = (0, 1) if view.phase in ("stand", "finish") else (view.stance,)
    steps = [_one_step(view, config, stance, 0.0) for stance in stances]
    return max(float((half - np.abs(place)).min()), *steps)


def _one_step(view: GaitView, config: GaitConfig, stance: int, elapsed: float) -> float:
    """Margin on one foot, so long after the other one has left the floor [s]."""
    timing, soles, reach, foot = config.timing, view.soles, config.reach, 1 - stance
    soonest = max(timing.single_min, elapsed + config.swing.freeze)
    times = np.linspace(soonest, max(timing.single_max, soonest), TIMES) - elapsed
    growth = np.exp(view.omega * times)[:, None]  # (TIMES, 1)
    width = (reach.width_min, reach.width_max) if foot == LEFT else (-reach.width_max, -reach.width_min)
    shift = np.subtract(soles.centre(foot), soles.centre(stance))
    more = soles.half_sole(foot) + (growth - 1.0) * soles.half_sole(stance)  # (TIMES, 2)
    lower = (np.array([-reach.backward, width[0]]) + shift - more) / growth
    upper = (np.array([reach.forward, width[1]]) + shift + more) / growth
    place = np.subtract(soles.holds[stance].relative(*view.dcm), soles.centre(stance))
    return float(np.minimum(place - lower, upper - place).min(axis=1).max())
