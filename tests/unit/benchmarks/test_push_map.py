"""The push test with steps: its bounds, its search over phases, legs that may not run through each other, verdicts."""

import math
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

import benchmarks.stability.push_map as push_map
from benchmarks.core.benchmark import catalogue
from benchmarks.core.harness import Case, Options, Report
from benchmarks.stability.push import PushMode, angles, direction_name
from benchmarks.stability.push_bounds import distance_with_steps, step_distance, step_length
from benchmarks.stability.push_map import Outcome, Trial, map_config, moments, prepare, survives
from models.errors import ConfigError
from models.robot_model import RobotModel
from planners.gait.scaling import load_gait_config

OMEGA = 3.9
AHEAD, LEFT = np.eye(2)
STAND_STILL = "benchmarks.stability.stand_still:StandStill"


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("direction", [AHEAD, LEFT, -LEFT, -AHEAD])
def test_steps_bring_the_dcm_to_rest_from_just_inside_their_bound(
    g1: RobotModel, direction: np.ndarray, first: int
) -> None:
    """Forward simulation: the DCM grows from the edge it is held by, and each step moves that edge on."""
    gait = load_gait_config(g1)
    growth = math.exp(OMEGA * gait.timing.single_urgent)
    for steps in (1, 2, 3):
        for share, caught in ((0.999, True), (1.001, False)):
            beyond = share * step_distance(gait, OMEGA, steps, direction, first)
            for k in range(steps):
                beyond = beyond * growth - step_length(gait, (first + k) % 2, direction)
            assert (beyond <= 0.0) == caught


def test_a_foot_reaches_its_own_side_or_a_little_across(g1: RobotModel) -> None:
    gait = load_gait_config(g1)
    reach = gait.reach
    for foot, side in ((0, LEFT), (1, -LEFT)):
        assert step_length(gait, foot, AHEAD) == reach.forward
        assert step_length(gait, foot, -AHEAD) == reach.backward
        assert step_length(gait, foot, side) == reach.width_urgent
        assert step_length(gait, foot, -side) == reach.cross
        across = np.array([math.sqrt(0.5), -math.sqrt(0.5) * side[1]])
        assert step_length(gait, foot, across) == pytest.approx(math.sqrt(0.5) * (reach.forward + reach.cross))
        straight = replace(gait, reach=replace(reach, cross=0.0))
        assert step_length(straight, foot, -side) == 0.0


def test_the_foot_that_steps_first_bears_nothing(g1: RobotModel) -> None:
    """Pushed to the left while it stands: with the left foot in the air only the right sole holds it back."""
    gait, half, width = load_gait_config(g1), 0.025, 0.2
    edges = 0.5 * width + half, -0.5 * width + half
    far, near = (edges[1 - first] + step_distance(gait, OMEGA, 3, LEFT, first) for first in (1, 0))
    assert distance_with_steps(gait, OMEGA, 3, LEFT, edges) == pytest.approx(max(far, near))
    assert distance_with_steps(gait, OMEGA, 3, -LEFT, edges[::-1]) == pytest.approx(max(far, near))
    for stance in range(2):  # on one foot, the other one steps
        single = (edges[0], -math.inf) if stance == 0 else (-math.inf, edges[1])
        expected = edges[stance] + step_distance(gait, OMEGA, 3, LEFT, 1 - stance)
        assert distance_with_steps(gait, OMEGA, 3, LEFT, single) == pytest.approx(expected)


def case(angle: float, dv: float, reason: str = "fell") -> Case:
    return {"angle": angle, "dv": dv, "impulse": 33.0 * dv, "ankle_dv": 0.4, "steps_dv": 1.2, "reason": reason}


def passed(results: list[Case]) -> bool:
    bench = catalogue()["push_step"].load()
    return bench.passed(Report("push_step", "g1", 1, bench.figures(results), results, True, {}))


def test_the_figure_of_a_direction_is_its_smallest_and_both_bounds_count() -> None:
    results = [
        case(0.0, 1.0),
        case(0.0, 0.7),
        case(1.0, 1.3),
        case(2.0, 1.2, "legs touch: left_knee_link and right_knee_link"),
    ]
    figures = push_map.summarise(results)
    assert (figures["dv_min"], figures["dv_median"], figures["legs_touched"]) == (0.7, 1.2, 1.0)
    assert passed(results)
    assert figures["ratio_to_ankle_bound_min"] == pytest.approx(0.7 / 0.4)
    assert figures["ratio_to_steps_bound_min"] == pytest.approx(0.7 / 1.2)
    assert figures["ratio_to_steps_bound_median"] == pytest.approx(1.0)
    beyond = [case(0.0, 0.8) | {"ankle_dv": 0.0}, case(1.0, 1.2)]  # the DCM was beyond the edge already
    assert push_map.summarise(beyond)["ratio_to_ankle_bound_min"] == pytest.approx(3.0)
    fell = [case(0.0, 0.0, "does not walk") | {"ankle_dv": 0.0, "steps_dv": 0.0}, case(1.0, 1.2)]  # before the push
    figures = push_map.summarise([*fell, *(case(2.0, 1.2, "legs touch: a and b") for _ in range(2))])
    assert figures["ratio_to_ankle_bound_min"] == figures["ratio_to_steps_bound_min"] == 0.0
    assert figures["ratio_to_steps_bound_median"] == pytest.approx(1.0) and figures["legs_touched"] == 1.0
    assert not passed([case(0.0, 0.5), case(1.0, 1.5)])  # the smallest alone
    assert not passed([case(0.0, 0.7), case(1.0, 0.8)])  # the median alone


def test_a_direction_holds_what_every_phase_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    limits = (1.3, 0.7, 1.0)

    class Loop:
        class robot:
            mass = 30.0

    def survives(loop: type[Loop], trial: Trial, dv: float) -> Outcome:
        return Outcome("" if dv <= limits[trial.phase] else "fell", 10.0 + trial.phase)

    monkeypatch.setattr(push_map, "survives", survives)
    monkeypatch.setattr(push_map, "loop_of", lambda robot, contender: Loop)
    monkeypatch.setattr(push_map, "prepare", lambda loop, trial: None)
    monkeypatch.setattr(push_map, "moments", lambda loop, outcome: {"t": [outcome.pushed]})
    monkeypatch.setattr(
        push_map, "bounds", lambda loop, trial: {"ankle_dv": 0.4 + trial.phase, "steps_dv": 2.0 - trial.phase}
    )
    found: dict[str, Any] = push_map.measure("g1", "walk", 0, 0.0)
    assert found["dv"] <= 0.7 < found["dv"] + map_config().resolution
    assert found["failed_phase"] == 1 and found["failed_dv"] > 0.7 and found["reason"] == "fell"
    assert found["moments"] == {"t": [11.0]}
    assert (found["ankle_dv"], found["steps_dv"]) == (0.4, 0.0)
    of_size = [push_map.measure("g1", "walk", 0, 0.0, size=size) | {"angle": size} for size in (0.6, 0.9)]
    assert [(case["dv"], case["taken"], case["pushes"]) for case in of_size] == [(0.6, 3, 3), (0.0, 2, 3)]
    assert of_size[1]["failed_phase"] == 1
    figures = push_map.summarise(of_size)
    assert (figures["taken"], figures["pushes"], figures["directions_taken"]) == (5.0, 6.0, 1.0)


def test_with_a_size_no_other_push_is_tried_and_every_direction_must_take_it() -> None:
    bench = catalogue()["push_step"].load()
    assert {each["size"] for each in bench.cases(Options("g1", size=0.9))} == {0.9}
    assert not any("size" in each for each in bench.cases(Options("g1")))
    sized = {"size": 0.9, "taken": 3, "pushes": 3}
    for dv, good in ((0.9, True), (0.0, False)):
        results = [case(0.0, 0.9) | sized, case(1.0, dv) | sized]
        assert passed(results) is good
    with pytest.raises(ConfigError, match="ankle bound"):
        catalogue()["push"].load().cases(Options("g1", size=0.9))


def test_a_push_is_explained_from_shortly_before_it_on_though_another_one_came_first(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Legs:
        find = staticmethod(lambda q: "")

    monkeypatch.setattr(push_map, "legs_of", lambda robot: Legs)
    trial, loop = Trial(PushMode.STEP, 0, 0, 0.5 * math.pi), push_map.loop_of("g1")
    prepare(loop, trial)
    loop.apply_push((0.0, 1.0, 0.0), 0.01)
    loop.run(0.2)
    pushed = loop.t
    outcome = survives(loop, trial, 15.0)
    assert outcome.reason == loop.fall_reason != ""
    assert outcome.pushed == pushed
    shown = moments(loop, outcome)
    assert shown["t"][0] == pytest.approx(pushed - map_config().lead, abs=map_config().record_period + 1e-9)
    assert shown["mode"][-1] == "damp"


@pytest.mark.parametrize("name", ["push", "push_walk"])
def test_only_the_directions_that_are_chosen_are_measured(name: str) -> None:
    bench = catalogue()[name].load()
    cases = bench.cases(Options(scenarios=("left", "forward")))
    assert [case["angle"] for case in cases] == pytest.approx([0.0, 0.5 * math.pi])
    with pytest.raises(ConfigError, match=r"unknown direction 'up'; known: forward, forward-left, .* or degrees"):
        bench.cases(Options(scenarios=("up",)))


@pytest.mark.parametrize(
    ("options", "degrees"),
    [
        (Options(directions="4"), [0.0, 90.0, 180.0, 270.0]),
        (Options(directions="4+22.5"), [22.5, 112.5, 202.5, 292.5]),
        (Options(directions="2+-90"), [90.0, 270.0]),
        (Options(scenarios=("112.5 deg", "-22.5", "left")), [90.0, 112.5, 337.5]),
    ],
)
def test_directions_are_a_grid_or_words_and_degrees(options: Options, degrees: list[float]) -> None:
    found = angles(8, options)
    assert [math.degrees(angle) for angle in found] == pytest.approx(degrees)
    assert angles(8, Options(scenarios=tuple(map(direction_name, found)))) == pytest.approx(found)


@pytest.mark.parametrize("grid", ["0", "2.5", "many", "8+", "8+north"])
def test_a_grid_that_is_none_is_refused(grid: str) -> None:
    if grid == "8+":
        assert len(angles(4, Options(directions=grid))) == 8
        return
    with pytest.raises(ConfigError, match="COUNT or COUNT"):
        angles(8, Options(directions=grid))


def test_seeds_start_where_they_are_asked_to() -> None:
    bench = catalogue()["push_catch"].load()
    assert {case["seed"] for case in bench.cases(Options(seeds=2))} == {100, 101}
    assert {case["seed"] for case in bench.cases(Options(seeds=2, first_seed=300))} == {300, 301}


def test_a_robot_that_does_not_get_to_the_push_takes_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """The baseline stands where it should walk."""
    found = push_map.measure("g1", "walk", 0, 0.0, STAND_STILL)
    assert (found["dv"], found["pushes"], found["moments"]) == (0.0, 0, {})
    assert "does not walk before" in found["reason"]


def test_a_contender_is_scored_by_the_true_state() -> None:
    trial, loop = Trial(PushMode.CATCH, 0, 0, 0.0), push_map.loop_of("g1", STAND_STILL)
    for dv, reason in ((0.05, ""), (0.9, "base")):
        prepare(loop, trial)
        outcome = survives(loop, trial, dv)
        assert outcome.reason[:4] == reason and outcome.pushed < loop.t
    assert moments(loop, outcome) == {}


@pytest.mark.parametrize("mode", [PushMode.STEP, PushMode.WALK])
def test_a_robot_recovers_where_it_stays_or_walks_on(mode: PushMode) -> None:
    """Steps in place do not count against it; a slow drift does."""
    t = np.arange(0.0, 5.0, map_config().check_period)
    sways = np.column_stack((0.02 * np.sin(8.0 * t), 0.03 * np.sin(4.0 * t)))
    ending = partial(push_map._ending, Trial(mode, 0, 0, 0.0))
    if mode is PushMode.STEP:
        assert ending(sways) == "" and "moves" in ending(sways + np.outer(t, (0.08, 0.0)))
    else:
        assert ending(sways) == "does not continue to walk" and ending(sways + np.outer(t, (0.3, 0.0))) == ""
