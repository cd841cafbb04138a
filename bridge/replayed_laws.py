"""The laws of a recording, told again what they were told then."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from controllers.balance import BalanceController
from controllers.checkpoints import ReplayStart
from controllers.estimation.config import EstimatorConfig
from controllers.estimation.estimator import StateEstimator
from controllers.head import Head, HeadConfig
from controllers.law_switch import LawSwitch
from controllers.tuning import Tuning
from controllers.walker import Walker
from controllers.walking import WalkingConfig, WalkingController
from controllers.whole_body_config import BalanceConfig, WholeBodyConfig
from models.applied import Entry, TickNote
from models.calibration import Calibration, apply_calibration
from models.config import parse_config
from models.errors import PoiseError
from models.law_state import LawState
from models.law_state_file import restore
from models.robot_model import RobotModel
from models.types import ContactState, JointCommand, JointTrajectory, Mode, Reference, RobotState, SensorData
from planners.gait.config import GaitConfig
from planners.gait.footstep_plan import Footstep
from planners.gait.footsteps import Foothold
from planners.gait.gait import GaitPlanner

T = TypeVar("T")


class _HeldGait:
    """A gait planner that is told a velocity again at every tick, as the node does; once there is one.

    Args:
        planner: The gait.
    """

    def __init__(self, planner: GaitPlanner) -> None:
        self.planner = planner
        self.velocity: tuple[float, float, float] | None = None

    @property
    def settled(self) -> bool:
        """Whether the robot has come to a standstill."""
        return self.planner.settled

    def reset(self, state: RobotState) -> None:
        """Start over."""
        self.planner.reset(state)

    def step(self, state: RobotState, dt: float) -> Reference:
        """One tick."""
        if self.velocity is not None:
            self.planner.set_velocity(*self.velocity)
        return self.planner.step(state, dt)


class ReplayedLaws:
    """Estimator, balance controller and walker as they were set, driven by samples and notes.

    Args:
        model: The robot.
        settings: Of every law, as ``Applied`` notes them.
        motions: Trajectories by the number in their note: the CRC-32 of their message.
        corrected: Whether the samples have been corrected by the calibration.

    Attributes:
        begun: Whether the laws have started over since: from then on their commands are those of the recording.

    Raises:
        ConfigError: The settings are not those of this version.
    """

    def __init__(
        self,
        model: RobotModel,
        settings: Mapping[str, dict[str, Any]],
        motions: Mapping[int, JointTrajectory],
        *,
        corrected: bool = False,
    ) -> None:
        def given(schema: type[T], law: str) -> T:
            if law not in settings:
                raise PoiseError(f"the recording does not hold the settings of '{law}'")
            return parse_config(schema, settings[law], f"settings of '{law}' in the recording")

        self._motions, self._corrected = motions, corrected
        self._estimator = StateEstimator(model, given(EstimatorConfig, "estimator"))
        # Recordings of before there were heads are without its settings; nobody turned one.
        head = Head.of(model, given(HeadConfig, "head") if "head" in settings else None)
        balance = BalanceController(
            model, given(BalanceConfig, "balance"), given(WholeBodyConfig, "whole_body"), head=head
        )
        tracker = WalkingController(
            model, given(WalkingConfig, "walking"), given(WholeBodyConfig, "whole_body_walking")
        )
        self._gait = _HeldGait(GaitPlanner(model, given(GaitConfig, "gait")))
        walker = Walker(self._gait, tracker, head=head)
        self._laws = LawSwitch(balance, lambda: walker, head=head)
        self._tuning = Tuning(balance)
        self._states = {
            "estimator": LawState(self._estimator),
            "balance": LawState(balance),
            "tuning": LawState(self._tuning, (balance,)),
            "walker": LawState(walker, (self._gait,)),
            "gait": LawState(self._gait.planner),
        }
        self._state: RobotState | None = None
        self._scheduled: tuple[bool, bool] | None = None
        self._calibration: Calibration | None = None
        self._dt = self._law_dt = 0.0
        self._running = self._steps = False
        self.begun = False

    def restore(self, start: ReplayStart) -> None:
        """Go on from a checkpoint of a black box.

        Raises:
            PoiseError: It is of another version.
        """
        told = start.told
        for law, state in told["laws"].items():
            begin = state["begin"]
            restore(self._states[law], start.memory[begin : begin + state["size"]], state)
        numbers = {name: np.array(told["state"][name], dtype=float) for name in ("q", "v", "tau")}
        left, right = (ContactState(active, np.array(wrench)) for active, wrench in told["state"]["contacts"])
        self._state = RobotState(told["state"]["t"], contacts=(left, right), **numbers)
        self._scheduled = None if told["scheduled"] is None else (told["scheduled"][0], told["scheduled"][1])
        self._laws.walking = told["walking"]
        self.begun = self._steps = True
        self._tell(tuple((word, *values) for word, values in told["in_force"].items()))

    def tick(self, sensors: SensorData, note: TickNote | None, dt: float | None = None) -> JointCommand | None:
        """One tick.

        Args:
            sensors: The sample, as it was measured.
            note: What the laws were told; None for nothing new.
            dt: Time since the last sample where it is not the noted one, because samples are missing [s].

        Returns:
            The command; None where no law moved the joints, or where it is not known from which state they began.

        Raises:
            PoiseError: A note cannot be followed.
        """
        self._steps = True
        if note is not None:
            self._tell(note.before)
        if self._state is None:
            return None
        if self._calibration is not None:
            sensors = apply_calibration(sensors, self._calibration)
        if self._steps:
            self._state = self._estimator.step(sensors, dt or self._dt, self._scheduled)
        command = self._answer(note, dt)
        self._scheduled = None if command is None else self._laws.reference.contacts
        return command

    def again(self, note: TickNote) -> JointCommand | None:
        """Answer the last state once more, as the laws did when the plant asked again; see ``tick``."""
        self._tell(note.before)
        return self._answer(note, None)

    def _answer(self, note: TickNote | None, dt: float | None) -> JointCommand | None:
        if note is not None:
            self._tell(note.after)
        if not (self._running and self.begun) or self._state is None:
            return None
        step = dt or self._law_dt
        self._tuning.step(step)
        return self._laws.step(self._state, step).command

    def _tell(self, entries: tuple[Entry, ...]) -> None:
        for word, *values in entries:
            tell = getattr(self, f"_on_{word}", None)
            if tell is None:
                raise PoiseError(f"the recording is of another version: '{word}' is not known")
            tell(*values)

    def _on_start(self, start: dict[str, Any]) -> None:
        sample = {name: np.array(value, dtype=float) for name, value in start["sample"].items() if name != "t"}
        self._state = self._estimator.reset(SensorData(t=start["sample"]["t"], **sample))
        self._scheduled = None
        self._steps = bool(start["steps"])
        self._calibration = None if self._corrected else _calibration(start["calibration"])

    def _on_sample(self, _: object) -> None:
        """Has been heeded when the sample was put together."""

    def _on_dt(self, dt: float) -> None:
        self._dt = dt

    def _on_law_dt(self, dt: float) -> None:
        self._law_dt = dt

    def _on_run(self, on: bool) -> None:
        self._running = on

    def _on_reset(self) -> None:
        self._laws.reset(self._started)
        self.begun = True

    def _on_walk(self, _: bool, mode: str) -> None:
        self._laws.enter(Mode(mode), self._started)

    @property
    def _started(self) -> RobotState:
        if self._state is None:
            raise PoiseError("the recording tells the laws something before the estimator has started")
        return self._state

    def _on_follow(self, crc: int, times: list[float] | None = None) -> None:
        if not self.begun:
            return
        if crc not in self._motions:
            raise PoiseError("the recording lacks the trajectory of a motion")
        motion = self._motions[crc]
        self._laws.follow(motion if times is None else replace(motion, times=np.array(times)))

    def _on_stop_motion(self) -> None:
        if self.begun:
            self._laws.stop_motion()

    def _on_head(self, pan: float, tilt: float) -> None:
        self._laws.look(pan, tilt)

    def _on_gain(self, name: str, value: float) -> None:
        self._tuning.set(name, value)

    def _on_velocity(self, forward: float, left: float, turn: float) -> None:
        self._gait.planner.set_velocity(forward, left, turn)

    def _on_hold_velocity(self, forward: float, left: float, turn: float) -> None:
        self._gait.velocity = forward, left, turn

    def _on_stop(self) -> None:
        self._gait.planner.stop()

    def _on_walk_to(self, x: float, y: float, yaw: float, z: float) -> None:
        self._gait.planner.walk_to(Foothold(x, y, yaw, z))

    def _on_take_steps(self, steps: list[list[float]]) -> None:
        self._gait.planner.take_steps([Footstep(int(foot), Foothold(*hold)) for foot, *hold in steps])


def _calibration(given: dict[str, Any] | None) -> Calibration | None:
    """What corrected the sensors."""
    if given is None:
        return None

    def numbers(name: str) -> Any:
        return np.array(given[name], dtype=float)

    return Calibration(
        robot=given["robot"],
        gyro_bias=numbers("gyro_bias"),
        accel_bias=numbers("accel_bias"),
        encoder_offsets=numbers("encoder_offsets"),
        wrench_offsets=numbers("wrench_offsets"),
        force_gains=numbers("force_gains"),
    )
