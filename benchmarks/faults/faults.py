"""Lockstep faults of sensors, motors, solver, users and environment: required and observed reaction."""

import math
import tempfile
import xml.etree.ElementTree as ET
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml
from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import Bound, at_least, settings
from benchmarks.core.fault_rows import AnyRow, FaultBenchmark
from benchmarks.core.harness import Case, Options, Report, chosen
from benchmarks.core.loops import Search, TorqueSteps, largest, start_walk
from benchmarks.faults.fault_acts import ACTS, Steps
from bridge.closed_loop import ClosedLoop
from bridge.plants.fault_plan import Fault
from bridge.plants.sensors import SensorErrors
from models.config import STRICT, NonNegative, Positive, merged, read_yaml
from models.errors import PoiseError
from models.profile import load_profile
from models.robot_model import RobotModel
from models.types import Mode
from models.urdf import resolve_uri

KNEE = "{knee}"  # placeholder for the name of the left knee joint


@schema(frozen=True, slots=True, config=STRICT)
class LoopChanges:
    """Options that differ from a plain closed loop; see ``ClosedLoop``."""

    friction: float | None = None  #: Coulomb coefficient [-]
    payload_kg: float = 0.0  #: Payload at the torso [kg]
    terrain: str = "flat"  #: Name of the ground
    misalignment: list[float] | None = None  #: Misalignment of the IMU (3,) [rad]
    obstacle_stop: bool = False  #: Whether the scanner stops the walk before obstacles
    profile: dict[str, Any] = Field(default_factory=dict)  #: Changed entries of the robot's profile, nested alike
    #: Mass of the first body in the URDF, relative to the mass in the model of the control laws [-]
    described_mass: Positive = 1.0


@schema(frozen=True, slots=True, kw_only=True, config=STRICT)
class Row(AnyRow):
    """Lockstep fault; acts are in ``benchmarks/faults/fault_acts.py``, '{knee}' in a reason is the knee joint's name.

    ``expect`` is the required reaction, ``faults`` are those of ``bridge.plants.fault_plan``, ``box`` requires a black
    box. A pushed robot steps first. If no step can stop it, times count from the end of the push, ``push`` [s] after
    the injection.
    """

    expect: Literal["rides", "damps", "stands", "refuses"]
    faults: list[dict[str, Any]] = Field(default_factory=list)
    loop: LoopChanges = Field(default_factory=LoopChanges)
    box: bool = False
    push: NonNegative = 0.0


@schema(frozen=True, slots=True, config=STRICT)
class Margin:
    """Search for the largest tolerated delay of all joint states, which must be at least ``required`` [s]."""

    group: str
    required: Positive
    walk: bool = False


@schema(frozen=True, slots=True, config=STRICT)
class FaultsConfig:
    """All rows; the units are in ``benchmarks/config/faults.yaml``."""

    settle: Positive
    duration: Positive
    torque_step_limit: Positive
    forward: Positive
    delays: Search
    margins: dict[str, Margin]
    rows: dict[str, Row]


config = partial(settings, FaultsConfig, "faults")


def with_knee(value: Any, knee: str) -> Any:
    """Replace the placeholder by the name of the knee joint in a value of a row."""
    if isinstance(value, str):
        return value.replace(KNEE, knee)
    if isinstance(value, dict):
        return {key: with_knee(item, knee) for key, item in value.items()}
    return [with_knee(item, knee) for item in value] if isinstance(value, list) else value


def robot_of(name: str, changes: LoopChanges, folder: Path) -> RobotModel:
    """Load a robot with the changes of a row, using files in ``folder``; ``PoiseError`` if that fails."""
    if not changes.profile and changes.described_mass == 1.0:
        return RobotModel.load(name)
    source = Path(load_profile(name).source)
    profile = merged(read_yaml(source), changes.profile)
    file, urdf = folder / "profile.yaml", folder / "robot.urdf"
    description = ET.parse(resolve_uri(str(profile["urdf"]), source.parent))
    description.write(urdf)
    file.write_text(yaml.safe_dump({**profile, "urdf": str(urdf)}), encoding="utf-8")
    robot = RobotModel.load(file)
    for mass in description.getroot().findall("link/inertial/mass")[:1]:
        mass.set("value", str(changes.described_mass * float(mass.attrib["value"])))
    description.write(urdf)
    return robot


BOX_TIME = 1.0  # additional observation time for a black box, which is written some time after the fault [s]


class _Trial:
    def __init__(self, robot: str, seed: int, row: Row, folder: Path) -> None:
        self._model, self._row = robot_of(robot, row.loop, folder), row
        model = self._model
        self.knee = model.joint_names[model.feet[0].joint_ids_v[3] - 6]
        errors = None if row.loop.misalignment is None else SensorErrors(misalignment=row.loop.misalignment)
        self._loop = ClosedLoop(
            model,
            seed=seed,
            friction=row.loop.friction,
            payload_kg=row.loop.payload_kg,
            terrain=row.loop.terrain,
            sensor_errors=errors,
            obstacle_stop=row.loop.obstacle_stop,
            record=False,
            black_box=folder if row.box else None,
        )
        self._steps, self._answer = TorqueSteps(self._loop), ""
        self._modes: list[tuple[float, Mode]] = []

    def run(self) -> Case:
        """Settle, inject the fault, observe the reaction."""
        given, loop, row = config(), self._loop, self._row
        if row.walk:
            start_walk(loop, given.forward)
        loop.run(given.settle)
        before = loop.mode
        act: Steps = iter(())
        start = loop.t + row.push
        with self._steps.watch():
            if row.faults:
                loop.inject([Fault(**item) for item in with_knee(row.faults, self.knee)])
            if row.act:
                act = ACTS[row.act](loop)
            for _ in range(round((row.duration or given.duration) / loop.plant.period)):
                with suppress(StopIteration):
                    reply = next(act)
                    if reply is not None and not reply.accepted:
                        self._answer = reply.reason
                loop.step()
                if not self._modes or loop.mode is not self._modes[-1][1]:
                    self._modes.append((loop.t - start, loop.mode))
        if row.box:
            loop.run(BOX_TIME)
        return self._outcome(before)

    def _outcome(self, before: Mode) -> Case:
        loop, row = self._loop, self._row
        reason = "; ".join((*loop.faults, *filter(None, [self._answer])))
        expected = Mode(row.mode) if row.mode else {"damps": Mode.DAMP, "stands": Mode.STAND}.get(row.expect, before)
        time = next((t for t, mode in self._modes if mode is expected), float("nan"))
        fits = loop.mode is expected and any(word in reason for word in with_knee(row.reason, self.knee).split("|"))
        if row.expect == "damps":
            ok = fits and bool(loop.faults) and time <= (row.within or np.inf)
        elif row.expect == "stands":
            ok = fits and not reason and not loop.fallen and time <= (row.within or np.inf)
        else:
            ok = fits and not loop.faults and not loop.fallen and bool(self._answer) == (row.expect == "refuses")
        left = not row.box or bool(loop.black_box and loop.black_box.files)
        fine = self._steps.within(config().torque_step_limit)
        return {
            "seen": ("fell, " if loop.fallen and row.expect == "rides" else "") + f"mode '{loop.mode.value}'",
            "reason": reason[:160],
            "time": time if row.expect in ("damps", "stands") else None,
            "torque_step": self._steps.largest,
            "ok": bool(ok and left and fine),
        }


def trial(robot: str, seed: int, given: Row) -> Case:
    """Run one row: ``seen``, ``reason``, ``time`` to the expected mode [s], ``torque_step`` over limit [-], ``ok``."""
    with tempfile.TemporaryDirectory(prefix="poise_faults_") as folder:
        try:
            outcome = _Trial(robot, seed, given, Path(folder)).run()
        except PoiseError as error:
            refused = given.expect == "refuses" and given.reason in str(error)
            outcome = {"seen": "refused", "reason": str(error)[:160], "time": None, "torque_step": 0.0, "ok": refused}
    return {"group": given.group, "expected": given.expect, "within": given.within, **outcome}


def margin(robot: str, seed: int, row: str) -> Case:
    """Bisect the largest delay that the robot tolerates, ``margin`` [s]; returns a row of the table."""
    given = config()
    asked, reason, steps = given.margins[row], "", [0.0]

    def holds(delay: float) -> bool:
        nonlocal reason
        fault = {"target": "joint_states", "kind": "delayed", "delay": delay}
        case = trial(robot, seed, Row(group=asked.group, walk=asked.walk, expect="rides", faults=[fault]))
        if case["ok"]:
            steps.append(case["torque_step"])
        else:
            reason = f"then {case['seen']}, {case['reason']}"
        return bool(case["ok"])

    found, _ = largest(holds, given.delays)
    return {
        "group": asked.group,
        "expected": f"rides at {asked.required:.4f} s",
        "within": None,
        "seen": f"rides up to {found:.4f} s",
        "reason": reason,
        "time": None,
        "torque_step": max(steps),
        "margin": found,
        "ok": found >= asked.required,
    }


def measure(robot: str, seed: int, row: str) -> Case:
    """Run one row (``trial``) or search one margin (``margin``)."""
    given = config()
    return margin(robot, seed, row) if row in given.margins else trial(robot, seed, given.rows[row])


class Faults(FaultBenchmark):
    """All rows and margins, or the selected ones, for every seed."""

    measure = staticmethod(measure)

    def cases(self, options: Options) -> list[Case]:
        rows = chosen("faults", options.scenarios, [*config().rows, *config().margins])
        return [{"robot": options.robot, "seed": seed, "row": row} for row in rows for seed in options.each_seed()]

    def figures(self, cases: list[Case]) -> dict[str, float]:
        found: dict[str, float] = {}
        for case in (case for case in cases if case["row"] in config().margins):
            name = f"{case['row']}_s"
            found[name] = min(case["margin"], found.get(name, math.inf))
        return super().figures(cases) | found

    def bounds(self, report: Report) -> dict[str, Bound]:
        margins = {f"{name}_s": margin.required for name, margin in config().margins.items()}
        return super().bounds(report) | at_least(margins)
