"""The search of parameters: common random numbers, robust losses, going on, and the profile that it writes."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.testing import CliRunner

from benchmarks.core.harness import Case, Options, Sweep
from benchmarks.core.results import ResultsFile
from benchmarks.stability.push import PushMode
from benchmarks.tuning import tune
from benchmarks.tuning.cli import app
from benchmarks.tuning.tune import Parameters, Pushes, TuneConfig, draw, load_tune_config, present, robust_loss
from controllers.whole_body.config import load_balance_config
from models.errors import ConfigError
from models.robot_model import RobotModel
from planners.gait.scaling import load_gait_config

pytest.importorskip("cmaes")

CONFIG = TuneConfig(
    parameters={"gait.step_share": (0.7, 1.0), "balance.dcm_gain": (3.0, 8.0)},
    scenarios={PushMode.STEP: Pushes((0.4, 1.2)), PushMode.WALK: Pushes((0.2, 1.0), (0.2, 0.6))},
    directions=4,
    generations=12,
    population=6,
    spread=0.3,
    tail=0.5,
    seed=500,
    judged=2,
)
BEST = {"gait.step_share": 0.8, "balance.dcm_gain": 6.5}


def distance(parameters: Parameters) -> float:
    """From the best ones, in parts of the ranges."""
    ranges = CONFIG.parameters
    return math.hypot(*((parameters[name] - BEST[name]) / (ranges[name][1] - ranges[name][0]) for name in BEST))


def test_the_search_finds_the_least_loss() -> None:
    start = {"gait.step_share": 0.9, "balance.dcm_gain": 5.0}
    seen: list[int] = []

    def losses(candidates: Sequence[Parameters], generation: int) -> list[float]:
        seen.append(generation)
        assert len(candidates) == CONFIG.population
        for each in candidates:
            assert all(low <= each[name] <= high for name, (low, high) in CONFIG.parameters.items())
        return [distance(each) for each in candidates]

    config = replace(CONFIG, generations=30)
    found = tune.search(config, start, losses)
    assert distance(found) < 0.05 < 0.3 < distance(start)
    assert seen == list(range(30))
    assert tune.search(config, start, lambda candidates, _: [distance(each) for each in candidates]) == found


def test_equal_losses_change_nothing() -> None:
    start = {"gait.step_share": 0.9, "balance.dcm_gain": 5.0}
    assert tune.search(CONFIG, start, lambda candidates, _: [0.0] * len(candidates)) == start


def test_scenarios_are_those_of_their_generation_and_cover_every_sector() -> None:
    assert draw(CONFIG, 3) == draw(CONFIG, 3)
    judging = draw(CONFIG, CONFIG.generations)
    assert len(draw(CONFIG, 3)) == 8 and len(judging) == 16
    seeds = [{each["seed"] for each in draw(CONFIG, k)} for k in range(CONFIG.generations + 1)]
    assert len(set().union(*seeds)) == sum(map(len, seeds))  # those that judge are new
    for each in judging:
        off = (each["angle"] - 0.5 * math.pi * each["sector"] + math.pi) % (2.0 * math.pi) - math.pi
        assert abs(off) <= 0.25 * math.pi
        low, high = CONFIG.scenarios[PushMode(each["mode"])].dv
        assert low <= each["dv"] <= high
    assert {(each["mode"], each["sector"]) for each in judging} == {(m, k) for m in ("step", "walk") for k in range(4)}


def result(mode: str, sector: int, loss: float) -> Case:
    return {"mode": mode, "sector": sector, "loss": loss, "reason": "fell" if loss else ""}


def test_the_weakest_directions_count() -> None:
    even = [result("step", k, 0.5) for k in range(4)]
    one_sided = [result("step", k, 2.0 * (k == 2)) for k in range(4)]
    assert robust_loss(even, 1.0) == robust_loss(one_sided, 1.0) == 0.5
    assert robust_loss(even, 0.25) == 0.5 and robust_loss(one_sided, 0.25) == 2.0
    assert robust_loss([*one_sided, result("step", 2, 0.0)], 0.25) == 1.0  # of a sector the mean


@pytest.fixture
def trials(monkeypatch: pytest.MonkeyPatch) -> list[Parameters]:
    """A trial whose loss is the distance from the best parameters, and the parameters tried."""
    tried: list[Parameters] = []

    def trial(parameters: Parameters, **scenario: Any) -> Case:
        tried.append(parameters)
        loss = distance(parameters)
        return {"loss": loss, "reason": "fell" if loss > 0.1 else ""}

    monkeypatch.setattr(tune, "trial", trial)
    return tried


def test_a_search_goes_on_where_it_ended(trials: list[Parameters], tmp_path: Path) -> None:
    found = []
    for generations in (3, 3, 5):
        with ResultsFile(tmp_path / "cases.jsonl") as file:
            config, options = replace(CONFIG, generations=generations), Options("g1", sweep=Sweep(None, file))
            found.append(tune.tune(config, options, lambda *_: None)[0])
            trials.append({})
    assert found[0] == found[1] != found[2]
    first, second, third = _split(trials)
    assert len(first) == 3 * 6 * 8 + 2 * 16 and second == []
    # two more generations; the scenarios that judge are others, since those of before belong to the search now
    assert len(third) == 2 * 6 * 8 + 2 * 16


def _split(trials: list[Parameters]) -> list[list[Parameters]]:
    parts: list[list[Parameters]] = [[]]
    for each in trials:
        parts[-1].append(each) if each else parts.append([])
    return parts[:-1]


def test_the_profile_written_has_the_parameters_found(trials: list[Parameters], tmp_path: Path) -> None:
    search = tmp_path / "search.yaml"
    scenarios = {"step": {"dv": [0.4, 1.2]}}
    described = {name: getattr(CONFIG, name) for name in ("directions", "generations", "population", "spread", "tail")}
    parameters = {name: list(limits) for name, limits in CONFIG.parameters.items()}
    text = {**described, "parameters": parameters, "scenarios": scenarios, "seed": 500, "judged": 2}
    search.write_text(yaml.safe_dump(text))
    out = tmp_path / "profiles" / "mine.yaml"
    result = CliRunner().invoke(app, [str(search), "--out", str(out)], env={"COLUMNS": "200"})
    assert result.exit_code == 0, result.output
    assert "generation 12 of 12: loss" in result.output and "step, forward" in result.output
    model = RobotModel.load(out)
    found = {"gait.step_share": load_gait_config(model).step_share}
    found["balance.dcm_gain"] = load_balance_config(model).dcm_gain
    assert model.name == "g1" and distance(found) < 0.1
    remarks = [line for line in out.read_text().splitlines() if line.startswith("#")]
    assert any(line.startswith("# step, all: 0/8 before, 8/8 after") for line in remarks)
    # what is tuned may be tuned again
    again = CliRunner().invoke(app, [str(search), "--robot", str(out), "--out", str(tmp_path / "again.yaml")])
    assert again.exit_code == 0, again.output
    assert RobotModel.load(tmp_path / "again.yaml").name == "g1"


@pytest.mark.parametrize(
    ("name", "limits", "message"),
    [
        ("gait.swing.frozen", (0.0, 1.0), "gait.swing.frozen: unknown 'frozen'; known: apex, "),
        ("walking.speed", (0.0, 1.0), "walking.speed: unknown 'walking'; known: gait, balance, whole_body"),
        ("gait.preview", (1.0, 8.0), "gait.preview: int found"),
        ("gait.swing", (0.0, 1.0), "gait.swing: SwingConfig found"),
        ("gait.step_share.more", (0.0, 1.0), "unknown 'more'; known: nothing"),
        ("gait.step_share", (0.1, 0.2), r"gait.step_share: 0.9 of g1 is outside \[0.1, 0.2\]"),
    ],
)
def test_parameters_that_cannot_be_searched_are_named(name: str, limits: tuple[float, float], message: str) -> None:
    config = replace(CONFIG, parameters={"balance.dcm_gain": (3.0, 8.0), name: limits})
    with pytest.raises(ConfigError, match=message):
        present(config, "g1")


@pytest.mark.parametrize("robot", ["g1", "talos"])
def test_the_packaged_search_fits_the_robots(robot: str) -> None:
    config = load_tune_config("recovery")
    assert set(present(config, robot)) == set(config.parameters)


@pytest.mark.slow
def test_a_trial_runs_the_robot_with_the_parameters() -> None:
    """A small push is taken; a law without feedback of the DCM to speak of falls."""
    scenario: dict[str, Any] = {
        "mode": "step",
        "sector": 0,
        "seed": 700,
        "phase": 0,
        "angle": 0.0,
        "dv": 0.3,
        "speed": 0.4,
    }
    good = tune.trial("g1", {"gait.step_share": 0.85, "balance.dcm_gain": 4.5}, **scenario)
    assert good == {"loss": 0.0, "reason": ""}
    hard = tune.trial("g1", {"gait.step_share": 0.85, "balance.dcm_gain": 4.5}, **(scenario | {"dv": 3.0}))
    assert 1.0 < hard["loss"] <= 2.0 and hard["reason"]
