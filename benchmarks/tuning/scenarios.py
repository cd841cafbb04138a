"""Random scenarios of ``poise tune``, and their loss: 0 if the robot survives, else between 1 and 2."""

import math
import time
from dataclasses import asdict, replace
from functools import lru_cache
from typing import Any

import numpy as np

from benchmarks.core.harness import Case
from benchmarks.stability.push import PushMode, direction_name
from benchmarks.stability.push_map import Trial, map_config, prepare, survives
from benchmarks.stability.terrain import Condition, loop_under, walk_ahead
from benchmarks.tuning.config import SLOPES, Kind, Parameters, TuneConfig, laws
from bridge.closed_loop import ClosedLoop
from bridge.plants.deviation import Deviation
from models.config import merged, parse_config
from models.errors import PoiseError
from models.profile import load_profile
from models.robot_model import RobotModel
from models.terrain import FLAT, Terrain

LARGEST = 2.0  #: Loss of a robot that fails immediately [-]


def draw(config: TuneConfig, round_: int) -> list[Case]:
    """Draw the scenarios of a generation; number ``generations`` draws the judging ones, including held-out kinds.

    Seeds increase over the generations, so that no two scenarios share noise, tiles or encoder offsets.
    """
    judging, rng = round_ == config.generations, np.random.default_rng((config.seed, round_))
    first, kinds = config.seed + round_ * config.total(config.scenarios), config.kinds if judging else config.scenarios
    places = [
        (name, sector)
        for name, kind in kinds.items()
        for _ in range(kind.count * (config.judged if judging else 1))
        for sector in range(config.sectors(kind))
    ]
    return [
        {"kind": name, "sector": sector, "seed": first + k, **_drawn(config, kinds[name], sector, rng)}
        for k, (name, sector) in enumerate(places)
    ]


def _drawn(config: TuneConfig, kind: Kind, sector: int, rng: np.random.Generator) -> Case:
    """Draw condition and push of one scenario, as plain values."""
    terrain: str | Terrain = FLAT
    if kind.tiles is not None:
        terrain = Terrain("tiles", height=rng.uniform(*kind.tiles))
    elif kind.slope is not None:
        angle = rng.uniform(*kind.slope)
        way = sector if kind.push is None else int(rng.integers(len(SLOPES)))
        angle = angle if way < 2 else -angle
        terrain = Terrain("slope", pitch=angle) if way % 2 == 0 else Terrain("slope", roll=angle)
    shift, ahead = rng.uniform(*kind.com), rng.uniform(0.0, 2.0 * math.pi)
    deviation = Deviation(
        mass=rng.uniform(*kind.mass),
        com=(shift * math.cos(ahead), shift * math.sin(ahead), 0.0),
        friction=rng.uniform(*kind.joint_friction),
        encoder_offset=rng.uniform(*kind.encoder_offset),
    )
    condition = Condition(
        terrain=terrain,
        friction=None if kind.friction is None else rng.uniform(*kind.friction),
        payload=rng.uniform(*kind.payload),
        delay=rng.uniform(*kind.delay),
        deviation=None if deviation == Deviation() else deviation,
        speed=rng.uniform(*kind.speed),
    )
    push = None
    if kind.push is not None and kind.dv is not None:
        width = 2.0 * math.pi / config.directions
        push = {
            "mode": kind.push.value,
            "phase": int(rng.integers(map_config().phases[kind.push])),
            "angle": (width * (sector + rng.uniform(-0.5, 0.5))) % (2.0 * math.pi),
            "dv": rng.uniform(*kind.dv),
        }
    return {"condition": asdict(condition), "push": push, "duration": kind.duration}


def sector_name(config: TuneConfig, kind: Kind, sector: int) -> str:
    """Return the name of a sector."""
    if kind.push is not None:
        return direction_name(2.0 * math.pi * sector / config.directions)
    return "ahead" if kind.slope is None else SLOPES[sector]


@lru_cache(maxsize=2)
def _model(robot: str, parameters: tuple[tuple[str, float], ...]) -> RobotModel:
    profile = load_profile(robot)
    tuned: Any = merged(profile.laws, laws(dict(parameters)))
    return RobotModel(replace(profile, laws=tuned))


@lru_cache(maxsize=1)
def _loop(model: RobotModel, condition: Condition, seed: int) -> ClosedLoop:
    return loop_under(condition, model, seed, record=False)


def trial(
    robot: str, parameters: Parameters, kind: str, sector: int, seed: int, condition: Case, push: Case | None,
    duration: float,
) -> Case:  # fmt: skip
    """Run one scenario: ``loss`` [-], ``reason`` of a failure, processor time ``cpu`` [s].

    The loss is largest for parameters that the schema refuses, and if the robot fails before its push.
    """
    begin = time.process_time()
    under = parse_config(Condition, condition, f"scenario {kind}")
    try:
        model = _model(robot, tuple(parameters.items()))
        loss, reason = _walk(model, under, seed, duration) if push is None else _push(model, under, seed, push)
    except PoiseError as error:
        loss, reason = LARGEST, str(error)
    return {"loss": loss, "reason": reason, "cpu": round(time.process_time() - begin, 3)}


def _walk(model: RobotModel, condition: Condition, seed: int, duration: float) -> tuple[float, str]:
    loop = loop_under(condition, model, seed, record=False)
    lasted, distance, survived = walk_ahead(loop, condition.speed or 0.0, duration)
    if survived:
        return 0.0, ""
    return LARGEST - min(lasted / duration, 1.0), loop.fall_reason or f"{distance:.2f} m in {lasted:.1f} s"


def _push(model: RobotModel, condition: Condition, seed: int, push: Case) -> tuple[float, str]:
    config = map_config()
    pushed = Trial(PushMode(push["mode"]), seed, push["phase"], push["angle"], condition.speed)
    # On level ground, without deviation, the loop does not depend on the seed: ``prepare`` resets it
    world = replace(condition, speed=None)
    loop = _loop(model, world, 0 if condition.terrain == FLAT and condition.deviation is None else seed)
    prepare(loop, pushed)
    outcome = survives(loop, pushed, push["dv"])
    lasted = (loop.t - outcome.pushed) / (config.duration + config.recover_time)
    return (LARGEST - min(lasted, 1.0) if outcome.reason else 0.0), outcome.reason
