"""Crossing steps: the regions of the footholds, the choice between them, and the way round the stance foot."""

import math

import numpy as np
import pytest

from planners.gait.adjustment import PlannedStep, StepPlanner, Walk
from planners.gait.commands import CommandState
from planners.gait.foot_motion import FootLimits
from planners.gait.footsteps import Foothold, side_of
from planners.gait.pace import pace_at
from planners.gait.regions import (
    URGENT_REGIONS,
    Passage,
    Region,
    corner_between,
    divided,
    missed,
    region_boxes,
    region_limits,
)
from planners.gait.scaling import QUINTIC_PEAK
from planners.gait.swing import SwingState
from tests.gaits import Planned

OMEGA, DT = 3.8, 0.002
STANCE = Foothold(0.4, -0.3, 1.1)
CROSSING = (Region.FRONT, Region.BEHIND)


@pytest.fixture(scope="module", params=["g1", "talos"])
def planned(request: pytest.FixtureRequest) -> Planned:
    return Planned(request.param)


@pytest.fixture(scope="module")
def boxes(planned: Planned) -> np.ndarray:
    return region_boxes(region_limits(planned.config.reach))


def corner_of(planned: Planned) -> tuple[float, float]:
    """Of the area around the stance foot that a swing foot keeps out of."""
    return planned.config.reach.cross_ahead, planned.config.reach.width_min


def inside(points: np.ndarray, foot: int, corner: tuple[float, float], margin: float = 1e-3) -> np.ndarray:
    """Which points (n, 2) of the stance frame are in that area."""
    ahead, across = corner[0] - margin, corner[1] - margin
    return (np.abs(points[:, 0]) < ahead) & (side_of(foot) * points[:, 1] < across)


def straight(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    return start + np.linspace(0.0, 1.0, 101)[:, None] * (end - start)


def test_regions_of_both_feet_are_mirror_images(boxes: np.ndarray) -> None:
    mirrored = boxes[:, 1].copy()
    mirrored[..., 1] = -boxes[:, 1, ::-1, 1]
    np.testing.assert_array_equal(mirrored, boxes[:, 0])
    assert (boxes[:, :, 0] < boxes[:, :, 1]).all()


@pytest.mark.parametrize("foot", [0, 1])
def test_a_crossed_sole_never_overlaps_the_stance_sole(planned: Planned, boxes: np.ndarray, foot: int) -> None:
    """At any heading that a step may have: there is a line, sideways, that has each sole on one side."""
    x_min, x_max, y_min, y_max = planned.model.feet[foot].rectangle
    stance, reach = planned.model.feet[1 - foot].rectangle, planned.config.reach
    corners = np.array([(x, y) for x in (x_min, x_max) for y in (y_min, y_max)])
    for turn in np.linspace(-reach.turn_in, reach.turn_out, 16):
        c, s = math.cos(turn), side_of(foot) * math.sin(turn)
        ahead = corners @ (c, -s)  # of the sole's frame
        assert boxes[Region.FRONT, foot, 0, 0] + ahead.min() > stance[1]
        assert boxes[Region.BEHIND, foot, 1, 0] + ahead.max() < stance[0]


@pytest.mark.parametrize("foot", [0, 1])
def test_the_way_round_keeps_out_of_the_area_of_the_stance_foot(planned: Planned, boxes: np.ndarray, foot: int) -> None:
    """Between any two places in reach which the stance foot does not divide, straight or round the corner."""
    rng, corner, rounded = np.random.default_rng(foot), corner_of(planned), 0
    for _ in range(2000):
        first, last = rng.choice(URGENT_REGIONS, 2)
        place, target = (rng.uniform(*boxes[region, foot]) for region in (first, last))
        if divided(foot, (place[0], place[1]), Region(last), corner):
            assert first in CROSSING and last in CROSSING and first != last
            continue
        via = corner_between(foot, (place[0], place[1]), (target[0], target[1]), corner)
        ways = [(place, target)] if math.isnan(via[0]) else [(place, np.array(via)), (np.array(via), target)]
        rounded += len(ways) - 1
        for way in ways:
            assert not inside(straight(*way), foot, corner).any(), (place, target)
    assert rounded > 200


def test_corners_are_mirrored_and_taken_in_both_directions(planned: Planned, boxes: np.ndarray) -> None:
    rng, corner = np.random.default_rng(7), corner_of(planned)
    for _ in range(200):
        place, target = (tuple(rng.uniform(*boxes[region, 0])) for region in (Region.URGENT, Region.FRONT))
        there = corner_between(0, place, target, corner)
        assert corner_between(0, target, place, corner) == pytest.approx(there, nan_ok=True)
        mirrored = corner_between(1, (place[0], -place[1]), (target[0], -target[1]), corner)
        assert mirrored == pytest.approx((there[0], -there[1]), nan_ok=True)


def test_how_far_the_next_step_misses(planned: Planned, boxes: np.ndarray) -> None:
    """Nothing of a DCM over the sole or in reach; of one beyond, its distance less what the foot covers."""
    half, quickest = planned.soles.half[0], planned.config.timing.single_urgent
    swing = planned.config.swing
    passage = Passage(corner_of(planned), boxes, FootLimits(swing.speed_max, swing.acceleration_max), quickest)
    place = (0.0, 0.2)  # of the left foot, which steps next

    def miss(x: float, y: float, foot: int = 0) -> float:
        return missed((x, y), (place[0], side_of(foot) * place[1]), foot, half, OMEGA, passage)

    assert miss(0.0, 0.0) == miss(half[0], -half[1]) == miss(0.05, 0.1) == 0.0
    away = np.array([miss(0.0, -half[1] - d) for d in np.linspace(0.0, 0.2, 21)])
    np.testing.assert_allclose(away, np.linspace(0.0, 0.2, 21) * math.exp(OMEGA * quickest), atol=1e-12)
    for x, y in ((0.4, 0.0), (-0.4, 0.1), (0.1, 0.5), (0.3, -0.2)):
        assert miss(x, -y, foot=1) == pytest.approx(miss(x, y))
    slow = passage._replace(foot_limits=FootLimits(0.1, swing.acceleration_max))
    assert missed((0.3, 0.1), place, 0, half, OMEGA, slow) > missed((0.3, 0.1), place, 0, half, OMEGA, passage)


class Pushed:
    """A robot that steps on the spot, urgently, with the DCM where a push left it."""

    def __init__(self, planned: Planned, foot: int, plan: StepPlanner | None = None) -> None:
        self.planned, self.plan, self.foot, side = planned, plan or planned.plan, foot, side_of(foot)
        self.pace, self.width = pace_at(1.0, planned.config.pace), planned.config.reach.width
        self.liftoff = Foothold(*STANCE.moved(0.0, side * self.width), STANCE.yaw)
        command = CommandState(steps_left=2)
        self.walk = Walk(STANCE, foot, self.liftoff, command, self.pace, OMEGA, urgent=True)
        pose = np.array([self.liftoff.x, self.liftoff.y, 0.0, STANCE.yaw])
        self.swing = planned.swing.lift(pose, self.pace.clearance, self.pace.single, np.zeros(2))
        nominal, offset = self.plan.nominal(self.walk)
        self.nominal = PlannedStep(nominal, self.pace.single, planned.soles.point_of(foot, nominal) + offset)

    def step(
        self,
        x: float,
        out: float,
        last: PlannedStep | None = None,
        elapsed: float = 0.0,
        swing: SwingState | None = None,
    ) -> PlannedStep:
        """The plan for a DCM ``x`` ahead of the stance foot and ``out`` to the swing foot's side of it [m]."""
        dcm = np.array(STANCE.moved(x, side_of(self.foot) * out))
        return self.plan.adjust(
            self.walk, self.planned.with_dcm(dcm), elapsed, last or self.nominal, swing or self.swing
        )

    def relative(self, point: tuple[float, float]) -> tuple[float, float]:
        """A point of W ahead of the stance foot and to the swing foot's side of it [m]."""
        x, y = STANCE.relative(*point)
        return x, side_of(self.foot) * y


#: DCM [m] of pushes, and where the foot lands
PUSHES = [
    ((0.05, 0.12), Region.URGENT),
    ((0.25, 0.08), Region.URGENT),
    ((-0.12, 0.08), Region.URGENT),
    ((0.12, -0.06), Region.FRONT),
    ((-0.15, -0.06), Region.BEHIND),
]


@pytest.mark.parametrize(("dcm", "region"), PUSHES)
def test_the_region_is_that_from_which_the_robot_recovers(
    planned: Planned, boxes: np.ndarray, dcm: tuple[float, float], region: Region
) -> None:
    """A fall over the stance foot is caught across it; the foot of the other side does the mirrored step."""
    here, mirrored = (Pushed(planned, foot).step(*dcm) for foot in (0, 1))
    assert here.solved and here.region is mirrored.region is region
    (x, out), other = (Pushed(planned, foot).relative((p.hold.x, p.hold.y)) for foot, p in enumerate((here, mirrored)))
    assert other == pytest.approx((x, out), abs=1e-6)
    assert mirrored.time == pytest.approx(here.time, abs=1e-6) and mirrored.cost == pytest.approx(here.cost, rel=1e-6)
    low, high = boxes[region, 0]
    assert (np.array([x, out]) >= low - 1e-6).all() and (np.array([x, out]) <= high + 1e-6).all()


@pytest.mark.parametrize("x", [0.12, -0.15])
def test_a_step_under_way_turns_to_another_region_only_for_a_clear_advantage(planned: Planned, x: float) -> None:
    """The DCM at which a foot leaves the last region is farther inside the other one than the way back."""
    pushed, crossing = Pushed(planned, 0), Region.FRONT if x > 0.0 else Region.BEHIND

    def border(last: PlannedStep) -> float:
        inner, outer = -0.08, 0.2
        for _ in range(20):
            middle = 0.5 * (inner + outer)
            if pushed.step(x, middle, last).region is crossing:
                inner = middle
            else:
                outer = middle
        return inner

    crossed = pushed.step(x, -0.06)
    there, back = border(pushed.nominal), border(crossed)
    assert crossed.region is crossing
    assert -0.07 < there < back - 1e-3 < 0.19


@pytest.mark.parametrize("foot", [0, 1])
@pytest.mark.parametrize("dcm", [dcm for dcm, region in PUSHES if region in CROSSING])
def test_a_crossing_foot_rounds_the_stance_foot_and_comes_to_rest_at_its_target(
    planned: Planned, foot: int, dcm: tuple[float, float]
) -> None:
    """Planned anew every two ticks while the DCM runs away from the edge of the sole."""
    pushed, config, stance = Pushed(planned, foot), planned.config, 1 - foot
    step, swing, elapsed, path = pushed.step(*dcm), pushed.swing, 0.0, []
    centre, half = planned.soles.centres[stance], planned.soles.half[stance]
    x, out = dcm
    assert step.via is not None
    while elapsed < step.time - config.swing.urgent_lead - 1e-9:
        place = np.array([x, side_of(foot) * out])
        run = DT * OMEGA * (place - np.clip(place, centre - half, centre + half))
        x, out, elapsed = x + run[0], out + side_of(foot) * run[1], elapsed + DT
        if step.time - elapsed > config.swing.freeze and round(elapsed / DT) % 2 == 0:
            step = pushed.step(x, out, step, elapsed, swing)
            assert step.region.crossing
        target, duration = np.array([step.hold.x, step.hold.y, 0.0, STANCE.yaw]), step.time - config.swing.urgent_lead
        swing = planned.swing.step(swing, target, np.zeros(2), elapsed, duration, DT, step.via)
        path.append(STANCE.relative(*swing.position[:2]))
    places = np.array(path)
    assert not inside(places, foot, corner_of(planned), margin=2e-3).any()
    out, ahead = places[:, 1] * side_of(foot), places[:, 0] * math.copysign(1.0, dcm[0])
    assert out.max() < pushed.width + 0.03 and ahead.min() > -0.02  # no run-up
    assert places[-1, 1] * side_of(foot) < config.reach.width_min - 0.1
    assert STANCE.relative(step.hold.x, step.hold.y) == pytest.approx(places[-1], abs=1e-2)
    assert np.abs(swing.velocity[:2]).max() < 0.2
    assert np.abs(np.diff(places, axis=0)).max() / DT < QUINTIC_PEAK * config.swing.speed_max
