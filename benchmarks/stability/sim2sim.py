"""Control of a robot that differs from the model of the laws, through drivers, start and protocol of a real robot."""

from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib.axes import Axes
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import SurvivalBenchmark, settings
from benchmarks.core.harness import Case, Report
from benchmarks.stability.falls import draw_distances, last_moments
from bridge.hardware_loop import HardwareLoop
from bridge.plants.deviation import Deviation
from models.config import STRICT, Count, Positive, Share
from models.errors import ConfigError, PoiseError
from models.heading import heading, turned
from models.types import Mode, Vector

PERIOD = 0.1  #: Period of the checks of the robot [s]


@schema(frozen=True, slots=True, config=STRICT)
class Condition:
    """Differences of the simulated robot from the model of the laws."""

    deviation: Deviation | None = None
    delay: Count | None = None  #: Delay from a state to the effect of its command; the common value when None [ms]
    laws: str | None = None  #: Profile of the laws; the common profile when None


@schema(frozen=True, slots=True, config=STRICT)
class Sim2simConfig:
    """Settings of the test; the units are in ``benchmarks/config/sim2sim.yaml``."""

    first_seed: int
    laws: dict[str, str]
    rate: Positive
    stand_time: Positive
    motion: str
    motion_time: Positive
    speed: Positive
    distance: Positive
    distance_share: Share
    stop_time: Positive
    required_share: Share
    record_period: Positive
    shown: Positive
    delay: Count
    conditions: dict[str, Condition]


_config = partial(settings, Sim2simConfig, "sim2sim")


def conditions() -> dict[str, Condition]:
    """Return the conditions by name."""
    return _config().conditions


class Trial:
    """Phases of a run: start, stand, motion, walk, stop. ``outcome`` has the results so far."""

    def __init__(self, loop: HardwareLoop, config: Sim2simConfig) -> None:
        self.loop, self._config = loop, config
        self.outcome: Case = {"distance": 0.0, "drift": float("nan"), "odometry": float("nan"), "aside": float("nan")}

    def run(self) -> None:
        """Run the phases; ``PoiseError`` when the robot falls, is damped, or exceeds a time limit."""
        loop, config = self.loop, self._config
        self._enter("start")
        loop.start()
        loop.unhook()
        self._enter("stand")
        begin = self._place
        self._advance(config.stand_time)
        self.outcome["drift"] = float(np.linalg.norm(self._place - begin))
        self._enter("motion")
        loop.command(config.motion)
        self._stands_within(config.motion_time)
        self._enter("walk")
        self._walk()

    def _walk(self) -> None:
        loop, config = self.loop, self._config
        yaw = heading(*loop.side.plant.truth.q[3:7])
        begin, estimated, yaw_estimated = self._place, self._estimate, heading(*loop.stack.state.q[3:7])
        loop.command("walk")
        loop.stack.set_velocity(config.speed, 0.0, 0.0)
        limit, start = config.distance / (config.distance_share * config.speed), loop.t
        while self.outcome["distance"] < config.distance:
            if loop.t - start > limit:
                raise PoiseError(f"{self.outcome['distance']:.2f} m in {limit:.1f} s")
            self._advance(PERIOD)
            moved = turned(self._place - begin, -yaw)
            self.outcome |= {"distance": float(moved[0]), "aside": float(moved[1])}
        self._enter("stop")
        loop.command("stop")
        self._stands_within(config.stop_time)
        moved = turned(self._place - begin, -yaw)
        measured = turned(self._estimate - estimated, -yaw_estimated)
        self.outcome["odometry"] = float(np.linalg.norm(measured - moved) / np.linalg.norm(moved))

    @property
    def _place(self) -> Vector:
        return self.loop.side.base[:2]

    @property
    def _estimate(self) -> Vector:
        return self.loop.stack.state.q[:2].copy()

    def _enter(self, phase: str) -> None:
        self.outcome["phase"] = phase

    def _advance(self, time: float) -> None:
        for _ in range(max(round(time / PERIOD), 1)):
            self.loop.run(PERIOD)
            if self.loop.failure:
                raise PoiseError(self.loop.failure)

    def _stands_within(self, time: float) -> None:
        end = self.loop.t + time
        while self.loop.stack.mode is not Mode.STAND:
            if self.loop.t > end:
                raise PoiseError(f"mode '{self.loop.stack.mode.value}' after {time:g} s")
            self._advance(PERIOD)
        self._advance(1.0)


def measure(robot: str, seed: int, scenario: str) -> Case:
    """Start, stand, wave, walk and stop under one condition; a failed run has ``moments``."""
    config = _config()
    if robot not in config.laws:
        raise ConfigError(f"bench sim2sim: no laws for robot '{robot}'; known: {', '.join(config.laws)}")
    condition = config.conditions[scenario]
    with TemporaryDirectory() as folder:
        loop = HardwareLoop(
            Path(folder) / "marker",
            laws=condition.laws or config.laws[robot],
            rate=config.rate,
            seed=seed,
            delay=condition.delay or config.delay,
            record_period=config.record_period,
            robot=robot,
            deviation=condition.deviation,
        )
        trial, reason = Trial(loop, config), ""
        try:
            trial.run()
        except PoiseError as error:
            reason = str(error)
    outcome = {**trial.outcome, "survived": not reason, "reason": reason, "time": loop.t}
    return outcome if not reason or not len(loop.log) else {**outcome, "moments": last_moments(loop, config.shown)}


class Sim2sim(SurvivalBenchmark):
    """All conditions, or the selected ones, once per seed."""

    measure = staticmethod(measure)
    required_share, usual, first_seed = _config().required_share, _config().conditions, _config().first_seed

    def further(self, name: str, cases: list[Case]) -> dict[str, float]:
        """Return the mean ``distance_`` [m].

        For the runs that survived also the largest ``drift_`` of the standing robot [m] and the largest error of the
        ``odometry_`` over the distance [-].
        """
        figures = {f"distance_{name}_m": float(np.mean([case["distance"] for case in cases]))}
        for key, unit in (("drift", "_m"), ("odometry", "")):
            found = [case[key] for case in cases if case["survived"]]
            figures[f"{key}_{name}{unit}"] = max(found, default=float("nan"))
        return figures

    def notes(self, report: Report) -> list[str]:
        return [
            *super().notes(report),
            *(
                f"{case['scenario']}, seed {case['seed']}: {case['phase']}, {case['time']:.1f} s: {case['reason']}"
                for case in report.cases
                if not case["survived"]
            ),
        ]

    def plots(self, report: Report, folder: Path) -> list[Path]:
        def draw_limits(axes: Axes) -> None:
            axes.axhline(_config().distance, color="k", linewidth=0.8, linestyle="--", label="required")

        return draw_distances(report, folder, "distance walked [m]", draw_limits)
