"""Robots from their files only: results of ``poise check-robot`` for all available humanoids, and longer runs.

The humanoids are files of installed packages and the generated robots of ``benchmarks/stability/humanoids.py``. Files
of other robots are refused and counted; no generated robot may be refused.
"""

import math
import site
import tempfile
import time
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import numpy as np
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import Benchmark, settings
from benchmarks.core.harness import Case, Options, Report, chosen
from benchmarks.core.loops import advance, demand, start_walk
from benchmarks.stability.humanoids import KINDS
from benchmarks.stability.robots_page import TRIALS, rows, write_page
from bridge.check_robot import check_robot, propose_profile
from bridge.closed_loop import ClosedLoop
from models.config import STRICT, Fraction, Positive
from models.errors import ConfigError, PoiseError
from models.heading import heading, turned
from models.profile import robot_names
from models.robot_model import RobotModel
from models.types import Mode, Velocity
from planners.gait.strength import STANDSTILL
from planners.whole_body_ik import arms

GENERATED = "generated: "  #: Prefix of the name of a generated robot
_PARTS = 3  #: Number of trailing path components in a name: package, folder, file


@schema(frozen=True, slots=True, config=STRICT)
class RobotsConfig:
    """Settings of the runs; the units are in ``benchmarks/config/robots.yaml``."""

    usual: tuple[str, ...]
    stand_time: Positive
    stand_drift: Positive
    push: Positive
    push_time: Positive
    pause: Positive
    motions: tuple[str, ...]
    walk_time: Positive
    speeds: dict[str, tuple[float, float, float]]
    step_speed: Positive
    progress: Fraction


_config = partial(settings, RobotsConfig, "robots")


@cache
def robot_files() -> dict[str, Path]:
    """Return URDF and MJCF files of the installed packages by the trailing components of their paths, sorted."""
    found = {}
    for root in map(Path, site.getsitepackages()):
        for path in (*root.rglob("*.urdf"), *(each for each in root.rglob("*.xml") if _is_mjcf(each))):
            found["/".join(path.parts[-_PARTS:])] = path
    return dict(sorted(found.items()))


def _is_mjcf(path: Path) -> bool:
    return b"<mujoco" in path.read_bytes()[:4096]


def write_robot(name: str, folder: Path) -> Path:
    """Return the file of a robot by its name in the cases; a generated robot is written to the folder."""
    if name.startswith(GENERATED):
        return KINDS[name.removeprefix(GENERATED)].write(folder)
    return robot_files()[name]


def check(robot: str, seed: int) -> Case:
    """Check one robot: ``trials`` and ``limits`` as text, or why it was ``refused``."""
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        try:
            verdict = check_robot(write_robot(robot, Path(folder)), Path(folder) / "profile.yaml", seed=seed)
        except PoiseError as error:
            return {"refused": str(error).rpartition(f"{Path(robot).name}: ")[2]}
        model = RobotModel.load(verdict.files[0])
    failures = [f"{trial.name}: {trial.detail}" for trial in verdict.trials if not trial.passed]
    return {
        "mass": model.mass,
        "legs": len(model.feet[0].joint_ids_v),
        "arms": len(arms(model)),
        "trials": {trial.name: [trial.passed, trial.detail] for trial in verdict.trials},
        "limits": [*failures, *verdict.notes],
        "time": time.perf_counter() - began,
    }


def run_trial(robot: str, trial: str, seed: int) -> Case:
    """Run one long trial: whether it ``passed``, and its ``reason`` or result as text."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            return {"passed": True, "reason": _RUNS[trial](walking_loop(robot, Path(folder), seed), seed)}
        except PoiseError as error:
            return {"passed": False, "reason": str(error)}


def walking_loop(robot: str, folder: Path, seed: int = 0) -> ClosedLoop:
    """Return the loop of a packaged robot, or of a robot file with its proposed profile."""
    if robot in robot_names():
        return ClosedLoop(robot, seed=seed, record=False)
    _, files = propose_profile(write_robot(robot, folder), folder / "profile.yaml", ())
    return ClosedLoop(files[0], seed=seed, record=False)


def _stand(loop: ClosedLoop, seed: int) -> str:
    config, start = _config(), loop.plant.com.copy()
    advance(loop, config.stand_time)
    drift = float(np.linalg.norm((loop.plant.com - start)[:2]))
    if drift > config.stand_drift:
        raise PoiseError(f"the CoM moved by {1e3 * drift:.1f} mm")
    angle = np.random.default_rng([seed, 30]).uniform(0.0, 2.0 * math.pi)
    force = loop.robot.mass * config.push / config.push_time
    loop.apply_push((force * math.cos(angle), force * math.sin(angle), 0.0), config.push_time)
    _rest(loop)
    return f"CoM {1e3 * drift:.1f} mm, push towards {math.degrees(angle):.0f} deg"


def _move(loop: ClosedLoop, seed: int) -> str:
    hands, names = arms(loop.robot), _config().motions
    for name in names if hands else [name for name in names if name != "wave"]:
        demand(loop, name)
        loop.wait_motion()
        _rest(loop)
    return ""


def _walk(loop: ClosedLoop, seed: int, *, share: tuple[float, float, float]) -> str:
    config, gait = _config(), loop.gait.config
    pace, most = gait.pace, gait.velocity
    velocity: Velocity = (
        min(share[0] * pace.forward, most.forward),
        min(share[1] * pace.lateral, most.lateral),
        min(share[2] * pace.turn, most.turn),
    )
    way, yaw, start, ahead = velocity, 0.0, loop.truth, heading(*loop.truth.q[3:7])
    if max(velocity) <= STANDSTILL:
        velocity, way = (config.step_speed, 0.0, 0.0), (0.0, 0.0, 0.0)
    start_walk(loop, *velocity)
    before = heading(*loop.truth.q[3:7])
    for _ in range(round(config.walk_time)):
        advance(loop, 1.0)
        now = heading(*loop.truth.q[3:7])
        yaw, before = yaw + math.remainder(now - before, 2.0 * math.pi), now
    demand(loop, "stop")
    _rest(loop)
    x, y = turned(loop.truth.q[:2] - start.q[:2], -ahead).tolist()
    return check_progress((x, y, yaw), way)


def check_progress(gone: Velocity, velocity: Velocity) -> str:
    """Return the displacement x, y [m] and yaw [rad] as text; ``PoiseError`` if less than required by the command."""
    config = _config()
    asked = config.walk_time * np.array(velocity)
    for part in (slice(2), slice(2, 3)):  # component of the displacement along the command, and the turn
        if np.dot(gone[part], asked[part]) < config.progress * np.dot(asked[part], asked[part]):
            x, y, yaw = asked
            raise PoiseError(
                f"displacement {gone[0]:.2f}, {gone[1]:.2f} of {x:.2f}, {y:.2f} m, turn {gone[2]:.2f} of {yaw:.2f} rad"
            )
    return f"{gone[0]:.2f}, {gone[1]:.2f} m, {gone[2]:.2f} rad"


def _rest(loop: ClosedLoop) -> None:
    """Run for a pause; ``PoiseError`` if the robot does not stand afterwards."""
    advance(loop, _config().pause)
    if loop.mode is not Mode.STAND:
        raise PoiseError(f"mode '{loop.mode.value}' {_config().pause:g} s later; {'; '.join(loop.faults)}")


_RUNS: dict[str, Callable[[ClosedLoop, int], str]] = {
    "stand": _stand,
    "motions": _move,
    **{name: partial(_walk, share=share) for name, share in _config().speeds.items()},
}


def measure(robot: str, seed: int, trial: str = "") -> Case:
    """Run a long trial, or check the robot without one."""
    return run_trial(robot, trial, seed) if trial else check(robot, seed)


class Robots(Benchmark):
    """All robots once per seed, or all long runs of the selected robots."""

    measure = staticmethod(measure)

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._long = name == "robots_trials"

    def cases(self, options: Options) -> list[Case]:
        """Return the cases; ``ConfigError`` for an unknown scenario, or with ``robot``: scenarios select robots."""
        if options.robot != Options().robot:
            raise ConfigError(f"bench robots has no --robot; use --scenario '{options.robot}'")
        found = [*robot_files(), *(GENERATED + kind for kind in KINDS)]
        known = [*robot_names(), *found] if self._long else found
        names = chosen(self.name, options.scenarios, known, _config().usual if self._long else None)
        seeds, runs = options.each_seed(), [{"trial": run} for run in _RUNS] if self._long else [{}]
        return [{"robot": name, **run, "seed": seed} for name in names for run in runs for seed in seeds]

    def figures(self, cases: list[Case]) -> dict[str, float]:
        """Return the number of robots by passed trial, or the number of passed runs."""
        if self._long:
            shares: dict[str, list[bool]] = {}
            for case in cases:
                shares.setdefault(case["robot"], []).append(case["passed"])
            figures = {"robots": len(shares), "runs": len(cases), "passed": sum(case["passed"] for case in cases)}
            return figures | {"passed_share_min": min(float(np.mean(each)) for each in shares.values())}
        tried = [case for case in cases if "trials" in case]
        done = {name: sum(case["trials"].get(name, [False])[0] for case in tried) for name in TRIALS}
        share, slowest = done["walk"] / max(len(tried), 1), max((case["time"] for case in tried), default=0.0)
        kinds = sum("refused" in case for case in cases if case["robot"].startswith(GENERATED))
        counts = {"files": len(cases), "robots": len(tried), "kinds_refused": kinds}
        return {**counts, **done, "walk_share": share, "time_max_s": slowest}

    def notes(self, report: Report) -> list[str]:
        """Return the failed runs, or the table."""
        failed = [
            f"{case['robot']}, {case['trial']}, seed {case['seed']}: {case['reason']}"
            for case in report.cases
            if not case.get("passed", True)
        ]
        return [*super().notes(report), *failed] if self._long else rows(report.cases)

    def plots(self, report: Report, folder: Path) -> list[Path]:
        """Write the Markdown table of the robots with a picture of those that walk, or the table of the runs."""
        return write_page(report.cases, folder, long=self._long)

    def survived(self, case: Case) -> tuple[str, bool] | None:
        """Return the outcome by robot, for the long runs."""
        return (case["robot"], case["passed"]) if self._long else None
