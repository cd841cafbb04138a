"""Runs the control stack of a recording on the recorded samples and inputs."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from controllers.balance.head import HeadConfig
from controllers.estimation.config import EstimatorConfig
from controllers.input_log import Entry, InputLog, TickInputs
from controllers.recording.black_box_file import ReplayStart
from controllers.stack import ControlStack, StackConfig, StackSnapshot
from controllers.whole_body.config import BalanceConfig, WholeBodyConfig
from models.calibration import Calibration
from models.config import parse_config
from models.errors import PoiseError
from models.law_state import restore
from models.robot_model import RobotModel
from models.types import ContactState, JointCommand, JointTrajectory, Mode, RobotState, SensorData
from planners.gait.config import GaitConfig
from planners.gait.footsteps import Foothold
from planners.gait.route import footstep_of

T = TypeVar("T")


def stack_config(settings: Mapping[str, dict[str, Any]]) -> StackConfig:
    """Configuration from a log; ``PoiseError`` for missing settings, ``ConfigError`` for settings of other versions."""

    def given(schema: type[T], stage: str) -> T:
        if stage not in settings:
            raise PoiseError(f"the recording does not hold the settings of '{stage}'")
        return parse_config(schema, settings[stage], f"settings of '{stage}' in the recording")

    return StackConfig(
        estimator=given(EstimatorConfig, "estimator"),
        gait=given(GaitConfig, "gait"),
        balance=given(BalanceConfig, "balance"),
        whole_body=given(WholeBodyConfig, "whole_body"),
        head=given(HeadConfig, "head") if "head" in settings else None,  # absent for a robot without a head
    )


class ReplayedStack:
    """Stack with the recorded ``settings``, driven by samples and inputs; ``motions`` are indexed by number.

    Once the laws have been reset (``begun``), their commands reproduce the recording.
    """

    def __init__(
        self, model: RobotModel, settings: Mapping[str, dict[str, Any]], motions: Mapping[int, JointTrajectory]
    ) -> None:
        self._log = InputLog()
        self._stack = stack = ControlStack(model, stack_config(settings), log=self._log, supervised=False)
        self._motions = motions
        self._estimating = self._steps = False
        self._dt = self._law_dt = 0.0
        self.begun = False
        self._inputs: dict[str, Callable[..., None]] = {
            "start": self._start,
            "sample": lambda _: None,  # decoded by the caller
            "dt": partial(setattr, self, "_dt"),
            "law_dt": partial(setattr, self, "_law_dt"),
            "reset": self._reset,
            "mode": lambda name: stack.enter(Mode(name)),
            "follow": self._follow,
            "stop_motion": lambda: stack.stop_motion() if self.begun else None,
            "head": stack.look,
            "gain": stack.set_gain,
            "velocity": stack.set_velocity,
            "hold_velocity": stack.hold_velocity,
            "stop": stack.stop,
            "walk_to": lambda *hold: stack.walk_to(Foothold(*hold)),
            "take_steps": lambda steps, after=None: stack.take_steps([footstep_of(*each) for each in steps], after),
        }

    def restore(self, start: ReplayStart) -> None:
        """Continue from a checkpoint of a black box; ``PoiseError`` for another version."""
        record = start.record
        if "memory" not in record or set(record["stages"]) != set(self._log.stages):
            raise PoiseError("the recorded state of the stack is of another version of poise")
        for name, stage in record["stages"].items():
            begin = stage["begin"]
            restore(self._log.stages[name], start.data[begin : begin + stage["size"]], stage)
        self._stack.restore(_snapshot(record["memory"]))
        for word in ("dt", "law_dt"):
            self._apply((word, *record["in_force"].get(word, (0.0,))))
        self.begun = self._estimating = self._steps = True

    def tick(self, sensors: SensorData, inputs: TickInputs | None, dt: float | None = None) -> JointCommand | None:
        """Run one tick; returns the command, or None if no law moved the joints or their initial state is unknown.

        ``dt`` is the time since the last sample [s]; it replaces the recorded time if samples are missing. Raises
        ``PoiseError`` when an input cannot be repeated.
        """
        self._steps = True
        self._apply(*(() if inputs is None else inputs.before))
        if not self._estimating:
            return None
        if self._steps:
            self._stack.estimate(sensors, dt or self._dt)
        return self._answer(inputs, dt)

    def again(self, inputs: TickInputs) -> JointCommand | None:
        """Compute the answer to the last state again, as for a repeated request of the plant; see ``tick``."""
        self._apply(*inputs.before)
        return self._answer(inputs, None)

    def _answer(self, inputs: TickInputs | None, dt: float | None) -> JointCommand | None:
        self._apply(*(() if inputs is None else inputs.after))
        self._log.clear()
        result = self._stack.control(dt or self._law_dt) if self.begun and self._estimating else None
        return None if result is None else result.command

    def _apply(self, *entries: Entry) -> None:
        for word, *values in entries:
            if word not in self._inputs:
                raise PoiseError(f"the recording is of another version: unknown input '{word}'")
            if not self._estimating and word in ("reset", "mode", "stop_motion"):
                raise PoiseError("the recording holds an input before the estimator has started")
            self._inputs[word](*values)

    def _start(self, start: dict[str, Any]) -> None:
        sample = {name: np.array(value, dtype=float) for name, value in start["sample"].items() if name != "t"}
        self._stack.calibration = _calibration(start["calibration"])
        self._stack.reset_estimator(SensorData(t=start["sample"]["t"], **sample))
        self._estimating, self._steps = True, bool(start["steps"])

    def _reset(self) -> None:
        self._stack.reset_law(self._stack.state)
        self.begun = True

    def _follow(self, number: int, times: list[float]) -> None:
        if not self.begun:
            return
        if number not in self._motions:
            raise PoiseError("the recording lacks the trajectory of a motion")
        self._stack.follow(replace(self._motions[number], times=np.array(times)))


def _snapshot(record: dict[str, Any]) -> StackSnapshot:
    state = {name: np.array(record["state"][name], dtype=float) for name in ("q", "v", "tau")}
    left, right = (ContactState(active, np.array(wrench)) for active, wrench in record["state"]["contacts"])
    return StackSnapshot(
        RobotState(record["state"]["t"], contacts=(left, right), friction=record["state"]["friction"], **state),
        None if record["scheduled"] is None else (record["scheduled"][0], record["scheduled"][1]),
        Mode(record["mode"]),
        None if record["held"] is None else (record["held"][0], record["held"][1], record["held"][2]),
        _calibration(record["correction"]),
    )


def _calibration(given: dict[str, Any] | None) -> Calibration | None:
    if given is None:
        return None
    names = ("gyro_bias", "accel_bias", "encoder_offsets", "wrench_offsets", "force_gains")
    arrays: list[Any] = [np.array(given[name], dtype=float) for name in names]
    return Calibration(given["robot"], *arrays)
