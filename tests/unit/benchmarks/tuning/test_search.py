"""The search of parameters: what it finds, going on, its verdict, and the profile that it writes."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from benchmarks.core import executors
from benchmarks.core.executors import Done, InProcess
from benchmarks.core.harness import Case, Options, Sweep
from benchmarks.core.results import ResultsFile
from benchmarks.tuning import tune
from benchmarks.tuning.cli import app
from benchmarks.tuning.config import Parameters, load_tune_config, present
from benchmarks.tuning.race import Raced, race
from benchmarks.tuning.report import verdict
from benchmarks.tuning.tune import Tuned
from controllers.whole_body.config import load_balance_config
from models.errors import ConfigError
from models.robot_model import RobotModel
from planners.gait.scaling import load_gait_config
from tests.searches import SMALL as CONFIG

pytest.importorskip("cmaes")

START = {"gait.step_share": 0.9, "balance.dcm_gain": 5.0}
BEST = {"gait.step_share": 0.8, "balance.dcm_gain": 6.5}
JUDGING = 2 * (2 * 8 + 2)  # scenarios, before and after


def distance(parameters: Parameters) -> float:
    """From the best ones, in parts of the ranges."""
    ranges = CONFIG.parameters
    return math.hypot(*((parameters[name] - BEST[name]) / (ranges[name][1] - ranges[name][0]) for name in BEST))


def all_measured(loss: Callable[[Parameters], float]) -> tune.Losses:
    return lambda candidates, _: Raced([loss(each) for each in candidates], np.zeros((len(candidates), 1)))


def test_the_search_finds_the_least_loss() -> None:
    seen: list[int] = []

    def losses(candidates: Sequence[Parameters], generation: int) -> Raced:
        seen.append(generation)
        assert len(candidates) == CONFIG.population
        for each in candidates:
            assert all(low <= each[name] <= high for name, (low, high) in CONFIG.parameters.items())
        return all_measured(distance)(candidates, generation)

    config = replace(CONFIG, generations=30)
    history = tune.search(config, START, losses)
    assert distance(history[-1].parameters) < 0.05 < 0.3 < distance(START)
    assert history[-1].losses == sorted(history[-1].losses) and len(history[-1].losses) == 3
    assert seen == list(range(30))
    assert tune.search(config, START, all_measured(distance)) == history


def test_equal_losses_change_nothing() -> None:
    assert tune.search(CONFIG, START, all_measured(lambda _: 0.0))[-1].parameters == START


def test_what_the_race_leaves_out_moves_the_mean_nowhere_else() -> None:
    """One generation with all scenarios measured, and one with a race, end in the same mean."""
    rng, cases = np.random.default_rng(3), [{"kind": "step", "sector": k} for k in range(8)]
    for _ in range(20):
        table = np.where(rng.random((6, 8)) < rng.random((6, 1)), 1.5, 0.0)

        def ended(block: int, table: Any = table) -> tuple[Parameters, int]:
            def losses(candidates: Sequence[Parameters], _: int) -> Raced:
                return race(cases, 6, 3, 0.5, block, lambda pairs: [float(table[pair]) for pair in pairs])

            last = tune.search(replace(CONFIG, generations=1), START, losses)[-1]
            return last.parameters, last.measured

        assert ended(1)[0] == ended(8)[0] and ended(1)[1] <= ended(8)[1]


@pytest.fixture(autouse=True)
def uncollected(monkeypatch: pytest.MonkeyPatch) -> None:
    """No garbage collection before each of the thousands of cases, which takes half a second after other tests."""
    monkeypatch.setattr(executors, "gc", SimpleNamespace(collect=lambda: None))


class Shuffled(InProcess):
    """Ends the cases in another order, as several workers do."""

    def run(self, measure: Callable[..., Case], cases: Sequence[Case]) -> Iterator[tuple[int, Done]]:
        yield from reversed(list(super().run(measure, cases)))


@pytest.fixture
def trials(monkeypatch: pytest.MonkeyPatch) -> list[Parameters]:
    """A trial that fails from a distance on that the scenario decides, and the parameters tried."""
    tried: list[Parameters] = []

    def trial(parameters: Parameters, seed: int, **scenario: Any) -> Case:
        tried.append(parameters)
        far = distance(parameters) - 0.1 - 0.02 * (seed % 5)
        return {"loss": 1.0 + min(far, 1.0) if far > 0.0 else 0.0, "reason": "fell" if far > 0.0 else "", "cpu": 36.0}

    monkeypatch.setattr(tune, "trial", trial)
    return tried


def test_the_order_in_which_scenarios_end_changes_nothing(trials: list[Parameters]) -> None:
    one, other = (tune.tune(CONFIG, Options("g1", sweep=Sweep(each))) for each in (InProcess(), Shuffled()))
    assert one == other
    assert distance(one.found) < 0.15 < distance(one.start)
    assert sum(each.measured for each in one.history) < 0.8 * sum(each.total for each in one.history)


def test_what_failed_in_earlier_generations_comes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[tuple[str, int, int]] = []

    def trial(kind: str, sector: int, seed: int, **scenario: Any) -> Case:
        tried.append((kind, sector, seed))
        fell = (kind, sector) == ("slope", 2)
        return {"loss": 1.5 * fell, "reason": "fell" * fell, "cpu": 0.0}

    monkeypatch.setattr(tune, "trial", trial)
    tune.tune(replace(CONFIG, generations=2), Options("g1"))
    first, second = ([each[:2] for each in tried if 0 <= each[2] - 500 - 8 * k < 8] for k in (0, 1))
    assert first[0] == ("step", 0) and second[0] == ("slope", 2)


def test_a_search_goes_on_where_it_ended(trials: list[Parameters], tmp_path: Path) -> None:
    found: list[Tuned] = []
    counts, advanced = [], list[int]()
    for generations in (3, 3, 5):
        with ResultsFile(tmp_path / "cases.jsonl") as file:
            config, options = replace(CONFIG, generations=generations), Options("g1", sweep=Sweep(None, file))
            found.append(tune.tune(config, options, advance=advanced.append))
            counts.append(len(trials))
            trials.clear()
    assert found[0] == found[1] and found[2].history[:3] == found[0].history
    assert found[0].found != found[2].found
    assert sum(advanced) == (3 + 3 + 5) * 6 * 8 + 3 * JUDGING
    measured = [each.measured for each in found[2].history]
    # two more generations; the scenarios that judge are others, since those of before belong to the search now
    assert counts == [sum(measured[:3]) + JUDGING, 0, sum(measured[3:]) + JUDGING]
    assert found[0].cpu == 36.0 * counts[0] == found[1].cpu  # also of what was there already
    assert found[0].cost.startswith(f"{counts[0] / 100:.2f} core-hours, {sum(measured[:3])} of 144 scenarios")


def test_parameters_that_stay_are_judged_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tune, "trial", lambda **_: {"loss": 0.0, "reason": "", "cpu": 1.0})
    tuned = tune.tune(CONFIG, Options("g1"))
    assert tuned.found == tuned.start and tuned.before == tuned.after and len(tuned.before) == JUDGING // 2
    assert tuned.cpu == 12 * 6 * 8 + JUDGING // 2
    assert tuned.cost.endswith(f"576 of 576 scenarios of the search, {JUDGING // 2} for judging")


def judged(before: Sequence[int], after: Sequence[int]) -> Tuned:
    """Of each kind so many of 10 scenarios that are survived."""

    def results(counts: Sequence[int]) -> list[Case]:
        return [
            {"kind": kind, "sector": 0, "loss": 1.5 * (k >= count), "reason": "fell" * (k >= count)}
            for kind, count in zip(("step", "slope", "tiles"), counts, strict=True)
            for k in range(10)
        ]

    return Tuned(START, BEST, [], results(before), results(after), 0.0)


@pytest.mark.parametrize(
    ("before", "after", "passed", "text"),
    [
        (
            (5, 5, 5),
            (9, 5, 5),
            True,
            "passed, nothing worse by more than 2 %; scenarios gained 4, lost 0 (sign",
        ),
        (
            (5, 5, 5),
            (9, 4, 5),
            False,
            ": slope 5 before, 4 after; loss 0.750 before, 0.825 after; scenarios",
        ),
        ((5, 5, 5), (9, 5, 4), False, "not passed, worse by more than 2 %: tiles 5 "),  # held out
        ((5, 5, 5), (5, 5, 5), True, "scenarios gained 0, lost 0 (sign test: p = 1)"),
        ((5, 5, 5), (9, 5, 5), True, "(sign test: p = 0.12)"),
    ],
)
def test_nothing_may_be_worse(before: list[int], after: list[int], passed: bool, text: str) -> None:
    found, words = verdict(CONFIG, judged(before, after))
    assert found == passed and text in words


def test_a_loss_may_not_be_worse() -> None:
    """As many failures, sooner."""
    tuned = judged((5, 5, 5), (5, 5, 5))
    sooner = [each | {"loss": 1.2 * each["loss"]} for each in tuned.after]
    assert verdict(CONFIG, replace(tuned, after=sooner))[1].startswith("not passed, worse by more than 2 %: loss 0.750")


def search_file(folder: Path, **changes: Any) -> Path:
    """A search as a file."""
    names = ("directions", "generations", "population", "block", "spread", "tail", "seed", "judged", "tolerance")
    text = {name: getattr(CONFIG, name) for name in names}
    text["parameters"] = {name: list(limits) for name, limits in CONFIG.parameters.items()}
    text["scenarios"] = {"step": {"push": "step", "dv": [0.4, 1.2]}}
    text["held_out"] = {"slope": {"slope": [0.05, 0.2]}}
    file = folder / "search.yaml"
    file.write_text(yaml.safe_dump({**text, **changes}))
    return file


@pytest.mark.long
def test_the_profile_written_has_the_parameters_found(trials: list[Parameters], tmp_path: Path) -> None:
    search, out = search_file(tmp_path), tmp_path / "profiles" / "mine.yaml"
    arguments = [str(search), "--out", str(out), "--plot", str(tmp_path / "plots")]
    result = CliRunner().invoke(app, arguments, env={"COLUMNS": "200"})
    assert result.exit_code == 0, result.output
    assert "generation 12 of 12: loss" in result.output and "step, forward" in result.output
    assert (tmp_path / "plots" / "tune-g1.png").stat().st_size > 10_000
    model = RobotModel.load(out)
    found = {"gait.step_share": load_gait_config(model).step_share}
    found["balance.dcm_gain"] = load_balance_config(model).dcm_gain
    assert model.name == "g1" and distance(found) < 0.15
    remarks = [line.removeprefix("# ") for line in out.read_text().splitlines() if line.startswith("#")]
    assert any(line.startswith("step, all: 0/8 before, ") for line in remarks)
    assert any(line.startswith("slope, up to the left: 0/2 before, ") for line in remarks)
    assert any(line.startswith("passed, nothing worse by more than 2 %") for line in remarks)
    assert any(" core-hours, " in line for line in remarks)
    # what is tuned may be tuned again
    again = CliRunner().invoke(app, [str(search), "--robot", str(out), "--out", str(tmp_path / "again.yaml")])
    assert again.exit_code in (0, 1), again.output
    assert RobotModel.load(tmp_path / "again.yaml").name == "g1"


@pytest.mark.parametrize("option", ["--out", "--plot", "--results"])
def test_an_output_that_cannot_be_written_is_named_before_the_search(
    trials: list[Parameters], option: str, tmp_path: Path
) -> None:
    search, file = search_file(tmp_path), tmp_path / "file"
    file.touch()
    given = ["--out", str(tmp_path / "mine.yaml"), option, str(file / "new")]
    result = CliRunner().invoke(app, [str(search), *given])
    assert result.exit_code == 2 and "cannot be written" in " ".join(result.output.split()) and not trials


@pytest.mark.parametrize("out", ["mine.yaml", "base.yaml", "link.yaml"])
def test_a_profile_is_not_tuned_into_what_it_extends(trials: list[Parameters], out: str, tmp_path: Path) -> None:
    (tmp_path / "base.yaml").write_text("extends: g1")
    (tmp_path / "mine.yaml").write_text("extends: base.yaml")
    (tmp_path / "link.yaml").symlink_to("mine.yaml")
    given = ["--robot", str(tmp_path / "mine.yaml"), "--out", str(tmp_path / out)]
    result = CliRunner().invoke(app, [str(search_file(tmp_path)), *given])
    assert result.exit_code == 2 and "--out" in result.output and not trials
    assert (tmp_path / "mine.yaml").read_text() == "extends: base.yaml"


def test_a_search_that_makes_it_worse_fails(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """What the search rewards, and what judges, contradict each other."""

    def trial(parameters: Parameters, kind: str, **scenario: Any) -> Case:
        far = distance(parameters)
        lost = far > 0.3 if kind == "step" else far < 0.3
        return {"loss": 1.0 + far if lost else 0.0, "reason": "fell" if lost else "", "cpu": 0.0}

    monkeypatch.setattr(tune, "trial", trial)
    out = tmp_path / "mine.yaml"
    result = CliRunner().invoke(app, [str(search_file(tmp_path)), "--out", str(out)], env={"COLUMNS": "200"})
    assert result.exit_code == 1, result.output
    assert "not passed, worse by more than 2 %: slope 8 before, 0 after" in out.read_text()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scenarios": {}}, "scenarios: .* at least 1 item"),
        (
            {"scenarios": {"step": {"push": "stand", "dv": [0.1, 0.2]}}},
            "scenarios.step: .*catch, step or walk",
        ),
        ({"scenarios": {"step": {"push": "step"}}}, "push needs dv"),
        ({"scenarios": {"tiles": {"tiles": [0.1, 0.0]}}}, r"tiles: \[0.1, 0\]: lower and upper end are swapped"),
        ({"scenarios": {"both": {"tiles": [0.0, 0.1], "slope": [0.0, 0.1]}}}, "tiles and slope: give one of them only"),
        ({"held_out": {"step": {"tiles": [0.0, 0.1]}}}, "held_out: step is among the scenarios"),
        ({"parameters": {"gait.step_share": [0.7, 1.0]}}, "parameters: CMA-ES needs two or more"),
    ],
)
def test_wrong_files_are_refused(changes: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=message):
        load_tune_config(str(search_file(tmp_path, **changes)))


def test_an_unknown_search_is_answered_with_the_known_ones() -> None:
    with pytest.raises(ConfigError, match="unknown search 'recover'; known: recovery"):
        load_tune_config("recover")


@pytest.mark.parametrize(
    ("name", "limits", "message"),
    [
        ("gait.swing.frozen", (0.0, 1.0), "gait.swing.frozen: unknown 'frozen'; known: apex, "),
        ("walking.speed", (0.0, 1.0), "walking.speed: unknown 'walking'; known: gait, balance, whole_body"),
        ("gait.preview", (1.0, 8.0), "gait.preview: expected a floating-point parameter, found int"),
        ("gait.swing", (0.0, 1.0), "gait.swing: expected a floating-point parameter, found SwingConfig"),
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
