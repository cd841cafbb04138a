"""Plans one after the other: from standing and on the way, what is too late or too short, arrival and its reasons."""

from collections.abc import Sequence
from itertools import pairwise

import pytest
from msgspec import structs

from models.config import default_config
from models.errors import CommandError
from models.robot_model import RobotModel
from planners.gait.footsteps import LEFT, RIGHT, Foothold, side_of
from planners.gait.planner import GaitPlanner
from planners.gait.route import Footstep
from planners.gait.tread import Tread
from planners.terrain.ground_config import GroundConfig
from planners.terrain.ground_route import Answer, GroundRoute, Request
from tests.support import standing

G1 = RobotModel.load("g1")
ROUTE = default_config(GroundConfig, "planners", "ground").route
DT, LOOK = 0.01, ROUTE.look_time
LINE = Foothold(0.0, 0.0, 0.0)


class Walked:
    """A gait whose feet stand where they are, and the route that commands it."""

    def __init__(self, distance: float = 3.0) -> None:
        self.gait, self.t = GaitPlanner(G1), 0.0
        self.gait.reset(standing(G1))
        self.route = GroundRoute(self.gait, self.gait)
        self.route.begin(LINE, distance)

    def wait(self, limit: float = 3.0) -> Request:
        """Tick until the next request."""
        end = self.t + limit
        while self.t < end:
            self.t += DT
            self.gait.step(standing(G1, self.t), DT)
            if (request := self.route.request(self.t)) is not None:
                return request
        raise AssertionError("no request")

    def land(self, error: float = 0.0) -> None:
        """Touchdown of the next footstep; the soles are higher than planned [m]."""
        gait = self.gait
        gait.state.steps += 1
        gait.state.stance = gait.route.steps[0].foot
        gait.state.command = gait._commands.landed(gait.state.command, gait.footholds)
        soles = gait.state.soles
        left, right = (structs.replace(hold, z=hold.z + error) for hold in soles.holds)
        gait.state.soles = structs.replace(soles, holds=(left, right))

    def requested(self) -> Request:
        """The request that is due now."""
        request = self.route.request(self.t)
        assert request is not None
        return request


def ahead(count: int, first: int = LEFT, x: float = 0.1) -> tuple[Footstep, ...]:
    """Steps on known ground, each 0.1 m farther, the last two side by side."""
    feet = [first if i % 2 == 0 else 1 - first for i in range(count)]
    ways = [x + 0.1 * i for i in range(count - 1)]
    return tuple(
        Footstep(foot, Foothold(way, side_of(foot) * 0.1, 0.0), Tread())
        for foot, way in zip(feet, [*ways, ways[-1]], strict=True)
    )


def test_the_first_plan_is_made_after_a_look_from_the_soles_of_a_standing_robot() -> None:
    walked = Walked()
    request = walked.wait()
    assert walked.t >= LOOK and request.after is None and request.query.foot is None
    assert request.query.feet == walked.gait.footholds and request.query.distance == pytest.approx(2.0, abs=0.1)
    assert walked.route.request(walked.t) is None  # once
    walked.route.answer(Answer(request.number + 1, ahead(4)))
    assert not walked.gait.route.left  # of another request
    walked.route.answer(Answer(request.number, ahead(4), "the ground ahead is not known"))
    assert walked.gait.route.left == 4 and walked.route.active


def test_a_robot_that_stepped_looks_again() -> None:
    walked = Walked()
    with pytest.raises(AssertionError, match="no request"):
        walked.wait(0.8 * LOOK)
    walked.gait.set_velocity(0.3, 0.0, 0.0)
    walked.gait.step(standing(G1, walked.t), DT)
    assert not walked.gait.settled and walked.route.request(walked.t) is None
    walked.gait.reset(standing(G1))
    stopped = walked.t
    walked.wait()
    assert walked.t - stopped >= LOOK


def test_a_walk_that_is_ended_without_a_reason_is_not_active() -> None:
    walked = Walked()
    walked.route.end("")
    assert not walked.route.active and walked.route.request(LOOK + 1.0) is None


def started(steps: Sequence[Footstep] = ahead(5), error: float = 0.0) -> tuple[Walked, Request]:
    """On the way: its route stands at a request that follows a touchdown, higher than planned [m]."""
    walked = Walked()
    walked.route.answer(Answer(walked.wait().number, tuple(steps), "the ground ahead is not known"))
    assert walked.route.request(walked.t) is None  # before a touchdown
    walked.land(error)
    return walked, walked.requested()


@pytest.mark.parametrize("height", [0.0, 0.1])
@pytest.mark.parametrize("error", [0.0, -0.03])
def test_the_map_is_compared_with_the_heights_that_it_had(height: float, error: float) -> None:
    steps = tuple(step.raised(height) for step in ahead(5))
    walked, request = started(steps, error)
    assert request.query.planned == steps[3:]
    more = ahead(4, first=steps[3].foot, x=0.4)
    walked.route.answer(Answer(request.number, more, "the ground ahead is not known"))
    walked.land()
    assert walked.requested().query.planned == more[1:]


def test_after_a_touchdown_the_plan_begins_two_footsteps_later_and_replaces_what_follows() -> None:
    walked, request = started()
    steps = ahead(5)
    assert request.after == 3 and request.query.foot == steps[3].foot
    for foot in (LEFT, RIGHT):
        last = [step for step in steps[:3] if step.foot == foot][-1].hold
        assert (request.query.feet[foot].x, request.query.feet[foot].y) == (last.x, last.y)
    more = ahead(4, first=steps[3].foot, x=0.4)
    walked.route.answer(Answer(request.number, more, "the ground ahead is not known"))
    left = walked.gait.route.steps
    assert len(left) == 6 and all(a.foot != b.foot for a, b in pairwise(left))
    assert [step.hold.x for step in left] == pytest.approx([0.2, 0.3, 0.4, 0.5, 0.6, 0.6])


@pytest.mark.parametrize("moved", [0.04, 0.15])
def test_after_one_more_touchdown_a_plan_may_correct_its_first_foothold_but_not_change_it(moved: float) -> None:
    walked, request = started()
    walked.land()
    before = walked.gait.route.steps
    walked.route.answer(Answer(request.number, ahead(4, first=before[1].foot, x=0.4 + moved), "a wall"))
    assert (walked.gait.route.steps != before) is (moved < 0.06)
    assert walked.route.request(walked.t) is not None  # for the touchdown meanwhile


@pytest.mark.parametrize("case", ["late", "over", "short", "none"])
def test_a_plan_on_the_way_that_does_not_help_is_left_out(case: str) -> None:
    walked, request = started()
    before = walked.gait.route.steps
    if case == "late":
        walked.gait.state.steps = 3  # it begins with the foot in the air
    if case == "over":
        walked.gait.stop()
        before = walked.gait.route.steps
    x = 0.1 if case == "short" else 0.5
    walked.route.answer(Answer(request.number, () if case == "none" else ahead(3, first=RIGHT, x=x), "a wall"))
    assert walked.gait.route.steps == before and walked.route.active


def test_where_the_ground_has_changed_a_shorter_plan_is_used_and_without_one_the_robot_stops_and_looks() -> None:
    walked, request = started()
    shorter = ahead(2, first=walked.gait.route.steps[2].foot, x=0.3)
    walked.route.answer(Answer(request.number, shorter, "a wall", blocked=True))
    assert walked.gait.route.left == 4 and walked.route.active
    walked, request = started()
    assert request.query.planned == ahead(5)[3:]
    walked.route.answer(Answer(request.number, (), "a wall", blocked=True))
    assert walked.gait.route.outcome == "stopped" and walked.route.active
    again = walked.wait(10.0)  # it stands and looks
    assert again.after is None
    walked.route.answer(Answer(again.number, (), "a wall"))
    assert walked.route.outcome == "a wall"


def looked_again(walked: Walked, request: Request) -> Request:
    """The request from standing after a plan has become void, and there was no other one."""
    walked.route.answer(Answer(request.number, (), "a wall", blocked=True))
    return walked.wait(10.0)


@pytest.mark.parametrize("void", [False, True])
def test_a_stop_that_the_route_did_not_make_ends_the_walk(void: bool) -> None:
    walked, request = started()
    if void:
        request = looked_again(walked, request)
    walked.route.answer(Answer(request.number, ahead(5) if void else (), "a wall"))
    walked.gait.stop()
    with pytest.raises(AssertionError, match="no request"):
        walked.wait(10.0)
    assert walked.route.outcome == "stopped"


def test_a_map_that_changes_again_and_again_ends_the_walk() -> None:
    walked, request = started()
    for _ in range(3):
        request = looked_again(walked, request)
        walked.route.answer(Answer(request.number, ahead(5)))
        walked.land()
        request = walked.requested()
        assert request.after is not None and walked.route.active
    walked.route.answer(Answer(request.number, (), "a wall", blocked=True))
    assert walked.route.outcome == "a wall" and walked.gait.route.outcome == "stopped"


def test_footsteps_go_on_from_a_touchdown_of_a_route_only() -> None:
    walked, _ = started()
    gait = walked.gait
    for after in (1, 6):
        with pytest.raises(CommandError, match=f"begin after touchdown {after}, the route has touchdowns 2 to 5"):
            gait.take_steps(ahead(2), after)
    with pytest.raises(CommandError, match="the foot that steps just before"):
        gait.take_steps(ahead(2, first=RIGHT, x=0.5), 4)


def test_the_walk_ends_with_the_reason_of_the_last_plan_and_where_no_plan_comes() -> None:
    walked = Walked()
    walked.route.answer(Answer(walked.wait().number, (), "the ground ahead is 0.30 m higher"))
    assert not walked.route.active and walked.route.outcome == "the ground ahead is 0.30 m higher"
    walked.route.begin(LINE, 0.04)  # it is there
    with pytest.raises(AssertionError):
        walked.wait(0.5)
    assert walked.route.outcome == "done"
    walked.route.begin(LINE, 3.0)
    walked.wait()
    with pytest.raises(AssertionError):
        walked.wait(6.0)
    assert walked.route.outcome.startswith("no plan was received for 5 s")
