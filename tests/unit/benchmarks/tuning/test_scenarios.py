"""Scenarios of a search: what they draw, and the loss of a robot in them."""

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.core.harness import Case
from benchmarks.stability.push import PushMode
from benchmarks.stability.terrain import Condition, loop_under
from benchmarks.tuning import scenarios
from benchmarks.tuning.config import Kind, load_tune_config
from benchmarks.tuning.scenarios import draw, sector_name, trial
from bridge.plants.deviation import Deviation
from models.config import parse_config
from models.robot_model import RobotModel
from models.terrain import Terrain
from models.types import Mode
from tests.searches import SMALL

CONFIG = replace(
    SMALL,
    scenarios={
        "step": Kind(PushMode.STEP, (0.4, 1.2)),
        "late": Kind(PushMode.WALK, (0.2, 1.0), (0.2, 0.6), payload=(0.0, 0.1), delay=(0.001, 0.01), mass=(0.9, 1.1),
                     com=(0.0, 0.02), joint_friction=(1.0, 3.0), encoder_offset=(0.0, 0.02)),
        "tiles": Kind(tiles=(0.02, 0.05), count=3),
        "slope": Kind(slope=(0.05, 0.2), friction=(0.3, 0.6)),
    },
    generations=5,
    held_out={"downhill": Kind(PushMode.WALK, (0.2, 0.4), slope=(0.05, 0.1))},
)  # fmt: skip
PARAMETERS = {"gait.step_share": 0.85, "balance.dcm_gain": 4.5}


def of(cases: list[Case], kind: str) -> list[Case]:
    return [case for case in cases if case["kind"] == kind]


def condition(case: Case) -> Condition:
    """As a worker reads it."""
    return parse_config(Condition, json.loads(json.dumps(case))["condition"], "scenario")


def test_scenarios_are_those_of_their_generation_and_cover_every_sector() -> None:
    assert draw(CONFIG, 3) == draw(CONFIG, 3) != draw(CONFIG, 2)
    assert draw(replace(CONFIG, seed=501), 3) != draw(CONFIG, 3)
    judging, one = draw(CONFIG, CONFIG.generations), draw(CONFIG, 3)
    assert len(one) == CONFIG.total(CONFIG.scenarios) == 4 + 4 + 3 + 4 and len(judging) == 2 * (15 + 4)
    assert not of(one, "downhill") and len(of(judging, "downhill")) == 8
    for each in judging:
        kind = CONFIG.kinds[each["kind"]]
        if kind.push is None or kind.dv is None:
            assert each["push"] is None
            continue
        off = (each["push"]["angle"] - 0.5 * math.pi * each["sector"] + math.pi) % (2.0 * math.pi) - math.pi
        assert abs(off) <= 0.25 * math.pi and kind.dv[0] <= each["push"]["dv"] <= kind.dv[1]
    places = {(each["kind"], each["sector"]) for each in one}
    assert places == {(kind, k) for kind in ("step", "late", "slope") for k in range(4)} | {("tiles", 0)}


def test_what_judges_was_not_searched() -> None:
    """Neither seeds, directions, sizes of pushes nor ground."""
    searched = [each for k in range(CONFIG.generations) for each in draw(CONFIG, k)]
    judging = draw(CONFIG, CONFIG.generations)
    seeds = [each["seed"] for each in searched + judging]
    assert len(set(seeds)) == len(seeds)

    def drawn(cases: list[Case], what: str) -> set[float]:
        return {case["push"][what] for case in cases if case["push"]}

    for what in ("angle", "dv"):
        assert not drawn(searched, what) & drawn(judging, what)
    grounds = [{condition(case).terrain for case in cases if not case["push"]} for cases in (searched, judging)]
    assert len(grounds[1]) > 8 and not grounds[0] & grounds[1]


def test_ground_and_disturbances_are_in_their_ranges() -> None:
    cases = [each for k in range(20) for each in draw(CONFIG, k)]
    assert {condition(case) for case in of(cases, "step")} == {Condition(speed=0.4)}
    slopes = [condition(case) for case in of(cases, "slope")]
    for case, under in zip(of(cases, "slope"), slopes, strict=True):
        ground = under.terrain
        assert isinstance(ground, Terrain) and under.friction is not None and 0.3 <= under.friction <= 0.6
        along, across = ((1, 0), (0, 1), (-1, 0), (0, -1))[case["sector"]]
        assert 0.05 <= ground.pitch * along + ground.roll * across <= 0.2
        assert (ground.pitch == 0.0) == (along == 0) and (ground.roll == 0.0) == (across == 0)
    assert sector_name(CONFIG, CONFIG.kinds["slope"], 1) == "up to the left"
    for case in of(cases, "tiles"):
        ground = condition(case).terrain
        assert isinstance(ground, Terrain) and ground.kind == "tiles" and 0.02 <= ground.height <= 0.05
    late = [condition(case) for case in of(cases, "late")]
    assert len({under.payload for under in late}) == len(late)
    for under in late:
        assert under.deviation is not None and 0.9 <= under.deviation.mass <= 1.1
        assert math.hypot(*under.deviation.com) <= 0.02 and 1.0 <= under.deviation.friction <= 3.0
        assert under.payload <= 0.1 and 0.001 <= under.delay <= 0.01 and under.deviation.encoder_offset <= 0.02
    pushed = [condition(case).terrain for case in of(draw(CONFIG, CONFIG.generations), "downhill")]
    ways = {
        (math.copysign(1, each.pitch or each.roll), each.pitch == 0) for each in pushed if isinstance(each, Terrain)
    }
    assert len(ways) > 1  # any way that the slope rises


class Walker:
    """Falls after 4 s, or walks on at half its speed, or as it should."""

    fall_reason = "base tilted"


@pytest.mark.parametrize(
    ("walked", "loss", "reason"),
    [
        ((4.0, 1.0, False), 1.6, "base tilted"),
        ((0.0, 0.0, False), 2.0, "base tilted"),
        ((10.0, 1.5, False), 1.0, "base tilted"),
        ((10.0, 3.9, True), 0.0, ""),
    ],
)
def test_the_loss_of_a_walk_is_that_of_a_push(
    walked: tuple[float, float, bool], loss: float, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """0 for one that survives, else between 1 and 2 by how long it lasted."""
    monkeypatch.setattr(scenarios, "loop_under", lambda *_, **__: Walker())
    monkeypatch.setattr(scenarios, "walk_ahead", lambda *_: walked)
    found = trial("g1", PARAMETERS, **of(draw(CONFIG, 0), "tiles")[0])
    assert found["loss"] == pytest.approx(loss) and found["reason"] == reason and found["cpu"] >= 0.0


def test_parameters_that_the_schema_refuses_have_the_largest_loss() -> None:
    found = trial("g1", PARAMETERS | {"balance.dcm_gain": -1.0}, **draw(CONFIG, 0)[0])
    assert found["loss"] == 2.0 and "dcm_gain" in found["reason"]


def test_the_packaged_search_has_every_kind_of_ground() -> None:
    grounds = {getattr(condition(case).terrain, "kind", "flat") for case in draw(load_tune_config("recovery"), 0)}
    assert grounds == {"flat", "tiles", "slope"}


@pytest.mark.long
def test_a_condition_is_that_of_the_simulated_robot(g1: RobotModel) -> None:
    """Its mass, the encoders' offsets, and it stands."""
    deviation = Deviation(mass=1.1, encoder_offset=0.01)
    under = Condition(payload=0.05, deviation=deviation)
    loop = loop_under(under, g1, 3, record=False, sensor_noise=False)
    assert loop.model.body_mass.sum() == pytest.approx((1.1 * 1.05) * g1.mass, rel=1e-6)
    np.testing.assert_allclose(loop.plant.noise.bias[: g1.nj], deviation.encoder_offsets(g1, 3))
    assert loop.mode is Mode.STAND and not loop.fallen


@pytest.mark.slow
def test_a_trial_runs_the_robot_with_the_parameters() -> None:
    """A small push is taken, a large one is not; low tiles are walked over, walls are not."""
    push: dict[str, Any] = {"mode": "step", "phase": 0, "angle": 0.0, "dv": 0.3}
    step = {**of(draw(CONFIG, 0), "step")[0], "seed": 700, "push": push}
    assert trial("g1", PARAMETERS, **step)["loss"] == 0.0
    hard = trial("g1", PARAMETERS, **(step | {"push": push | {"dv": 3.0}}))
    assert 1.0 < hard["loss"] <= 2.0 and hard["reason"]
    tiles = of(draw(CONFIG, 0), "tiles")[0]
    for height, survives in ((0.005, True), (0.3, False)):
        tiles["condition"]["terrain"]["height"] = height
        found = trial("g1", PARAMETERS, **tiles)
        assert (found["loss"] == 0.0) == survives and (1.0 <= found["loss"] <= 2.0) != survives, found
