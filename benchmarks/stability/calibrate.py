"""Injected sensor errors: residual errors after calibration, and quality of standing with and without calibration."""

import math
from functools import cache, partial
from typing import Annotated

import numpy as np
import pinocchio as pin
from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import Benchmark, Bound, at_most, settings
from benchmarks.core.harness import Case, Options, Report
from bridge.closed_loop import ClosedLoop
from bridge.plants.sensors import SensorErrors
from controllers.calibration.closed_chain import ChainTerms
from models.calibration import Calibration
from models.config import STRICT, Positive
from models.errors import PoiseError
from models.robot_model import RobotModel
from models.types import Mode, Vector


@schema(frozen=True, slots=True, config=STRICT)
class CalibrateConfig:
    """Injected errors and bounds; the units are in ``benchmarks/config/calibrate.yaml``."""

    gyro_bias: Positive
    encoder_offset: Positive
    force_offset: Positive
    share: Positive
    settle: Positive
    duration: Positive
    period: Positive
    factor: Annotated[float, Field(ge=1.0)]
    com_drift_slack: Positive
    com_speed_slack: Positive
    joint_speed_slack: Positive
    tilt_error_slack: Positive
    velocity_error_slack: Positive


#: Quality of standing: largest displacement of the CoM [m], RMS of its horizontal speed [m/s], mean joint speed
#: [rad/s], RMS errors of estimated tilt [rad] and base velocity [m/s]
QUANTITIES = ("com_drift", "com_speed", "joint_speed", "tilt_error", "velocity_error")
UNITS = {"com_drift": "m", "com_speed": "m_s", "joint_speed": "rad_s", "tilt_error": "rad", "velocity_error": "m_s"}

WAYS = ("jig", "floor")  # calibration of the encoders: all in a jig, or with the closed chain through both soles

_config = partial(settings, CalibrateConfig, "calibrate")

_robot = cache(RobotModel.load)


def _errors(robot: RobotModel, way: str, seed: int) -> SensorErrors:
    config, signs = _config(), np.random.default_rng(seed)
    encoders = config.encoder_offset * signs.choice([-1.0, 1.0], robot.nj)
    if way == "floor":
        encoders[np.setdiff1d(np.arange(robot.nj), ChainTerms(robot).joints)] = 0.0
    return SensorErrors(
        gyro_bias=config.gyro_bias * signs.choice([-1.0, 1.0], 3),
        encoder_offsets=encoders,
        force_offsets=config.force_offset * signs.choice([-1.0, 1.0], (2, 3)),
    )


def _tilt_error(estimated: Vector, true: Vector) -> float:
    """Return the angle between the verticals of two base orientations (4,), xyzw [rad]."""
    ups = [pin.Quaternion(q).toRotationMatrix()[2] for q in (estimated, true)]
    return float(np.linalg.norm(np.cross(*ups)))


def _stand(robot: RobotModel, seed: int, errors: SensorErrors | None, calibration: Calibration | None) -> Case:
    """Return the ``QUANTITIES`` of a standing robot; all NaN if it does not stand."""
    config = _config()
    nothing = dict.fromkeys(QUANTITIES, math.nan)
    try:
        loop = ClosedLoop(robot, seed=seed, sensor_errors=errors, calibration=calibration, record=False)
        loop.run(config.settle)
    except PoiseError:
        return nothing
    start, rows, before = loop.plant.com, [], loop.plant.com
    for _ in range(round(config.duration / config.period)):
        loop.run(config.period)
        truth, state, com = loop.truth, loop.state, loop.plant.com
        rows.append(
            (
                np.linalg.norm((com - start)[:2]),
                np.linalg.norm((com - before)[:2]) / config.period,
                np.abs(truth.v[6:]).mean(),
                _tilt_error(state.q[3:7], truth.q[3:7]),
                np.linalg.norm(state.v[:3] - truth.v[:3]),
            )
        )
        before = com
    if loop.fallen or loop.mode is not Mode.STAND:
        return nothing
    values = np.array(rows)
    rms = np.sqrt(np.mean(values**2, axis=0))
    figures = (values[:, 0].max(), rms[1], values[:, 2].mean(), rms[3], rms[4])
    return dict(zip(QUANTITIES, map(float, figures), strict=True))


def _left(loop: ClosedLoop, way: str) -> Case:
    """Return the residual errors of the loop's calibration, as shares of the injected errors."""
    config, robot, found, bias = _config(), loop.robot, loop.calibration, loop.plant.noise.bias
    if found is None:
        return dict.fromkeys(("gyro_left", "encoder_left", "force_left"), math.nan)
    nj, joints = robot.nj, np.arange(robot.nj) if way == "jig" else ChainTerms(robot).joints
    forces = (found.wrench_offsets - bias[-12:].reshape(2, 6))[:, :3]
    return {
        "gyro_left": float(np.abs(found.gyro_bias - bias[3 * nj : 3 * nj + 3]).max() / config.gyro_bias),
        "encoder_left": float(np.abs(found.encoder_offsets - bias[:nj])[joints].max() / config.encoder_offset),
        "force_left": float(np.abs(forces).max() / config.force_offset),
    }


def calibrate(robot: str, way: str, seed: int) -> Case:
    """Inject errors, calibrate by one of ``WAYS``, and stand without errors, uncalibrated and calibrated."""
    config, model = _config(), _robot(robot)
    errors = _errors(model, way, seed)
    loop = ClosedLoop(model, seed=seed, sensor_errors=errors, start="hang", record=False)
    steps = ("imu", "feet", "joints") if way == "jig" else ("imu", "feet", "start", "feet", "joints", "start", "joints")
    reasons = []
    try:
        for step in steps:
            if step == "start":
                loop.reset()
            elif not (reply := loop.calibrate(step)).accepted:
                raise PoiseError(reply.reason)
    except PoiseError as error:
        reasons.append(f"{step}: {error}")
    left = _left(loop, way)
    reasons += [f"{name} {value:.3f}" for name, value in left.items() if not value <= config.share]
    clean = _stand(model, seed, None, None)
    uncalibrated = _stand(model, seed, errors, None)
    mended = _stand(model, seed, errors, loop.calibration)
    for name in QUANTITIES:
        limit = config.factor * clean[name] + getattr(config, f"{name}_slack")
        if not mended[name] <= limit:
            reasons.append(f"{name} {mended[name]:.4g}, more than {limit:.4g}")
    stood = {"clean": clean, "uncalibrated": uncalibrated, "calibrated": mended}
    scores = {f"{name}_{how}": scores[name] for how, scores in stood.items() for name in QUANTITIES}
    return {**left, **scores, "reason": "; ".join(reasons), "ok": not reasons}


class Calibrate(Benchmark):
    """Calibrate in both ways for every seed."""

    measure = staticmethod(calibrate)

    def cases(self, options: Options) -> list[Case]:
        return [{"robot": options.robot, "way": way, "seed": seed} for way in WAYS for seed in options.each_seed()]

    def figures(self, cases: list[Case]) -> dict[str, float]:
        """Return the largest residual share of each error, worst of each quantity, and falls of uncalibrated robots."""
        figures: dict[str, float] = {}
        for way in WAYS:
            mine = [case for case in cases if case["way"] == way]
            for error in ("gyro", "encoder", "force"):
                figures[f"{way}_{error}_left_max"] = float(np.max([case[f"{error}_left"] for case in mine]))
        for name in QUANTITIES:
            for how in ("clean", "uncalibrated", "calibrated"):
                values = [case[f"{name}_{how}"] for case in cases]
                ignoring = how == "uncalibrated" and not np.isnan(values).all()
                figures[f"{name}_{how}_max_{UNITS[name]}"] = float((np.nanmax if ignoring else np.max)(values))
        figures["uncalibrated_falls"] = float(sum(math.isnan(case["com_drift_uncalibrated"]) for case in cases))
        figures["failed"], figures["total"] = float(sum(not case["ok"] for case in cases)), float(len(cases))
        return figures

    def bounds(self, report: Report) -> dict[str, Bound]:
        left = {name: _config().share for name in report.figures if name.endswith("_left_max")}
        return at_most({"failed": 0.0, **left})

    def notes(self, report: Report) -> list[str]:
        failed = [case for case in report.cases if not case["ok"]]
        return [f"seed {case['seed']}, {case['way']}: {case['reason']}" for case in failed[:10]]

    def survived(self, case: Case) -> tuple[str, bool]:
        return case["way"], bool(case["ok"])
