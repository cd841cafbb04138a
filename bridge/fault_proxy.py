"""Stands between the simulated robot and everything that reads its sensors or drives its motors, and injects faults."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from msgspec import structs

from bridge.fault_channels import JOINT_STATES, SCAN, STAMPS, Channels, channels_of
from bridge.fault_effects import Effect, effect_of
from bridge.fault_plan import RELEASE, START, Fault, FaultPlan, Faults, fault_plan
from controllers.sample_assembler import MAX_AGE
from models.robot_model import RobotModel
from models.scan import Scan
from models.types import SensorData, Vector

STREAM = 0xFA017
"""Keeps what is drawn here apart from the noise of the same seed."""


@dataclass(slots=True)
class _Injected:
    """A fault that was injected.

    Attributes:
        fault: It.
        channels: What it is about.
        first, last: Ticks from the injection to its beginning and to its end.
        rng: For what is random.
        zero: Tick of the injection: the first one that could show the fault; None before that.
        effect: What it does; None before it begins.
    """

    fault: Fault
    channels: Channels
    first: int
    last: float
    rng: np.random.Generator
    zero: int | None = None
    effect: Effect | None = None

    @property
    def way(self) -> str:
        """Where it acts: on 'sensors', on 'messages', on the 'scan' or on 'motors'."""
        if self.fault.is_motor or self.fault.target == SCAN:
            return "motors" if self.fault.is_motor else SCAN
        return "messages" if self.fault.target in (JOINT_STATES, STAMPS) else "sensors"


class FaultProxy:
    """Applies faults to the sensors on their way out of the plant, and to the torques on their way in.

    Faults of one target act one after the other, in the order of injection. What is drawn depends on the seed and on
    the order of injection only. Without faults nothing is looked at and everything passes as it is.

    A message that does not come is replaced by the last one while that is at most ``MAX_AGE`` old and by nan then, as
    ``SampleAssembler`` does it in the graph; that of all joints is replaced by nothing.

    Args:
        model: Robot; gives joints and full scales.
        period: Length of a tick [s].
        seed: Of the plant's noise.
        plan: Faults injected at every start or release.

    Attributes:
        active: Whether there is any fault, begun or not.
        silent: Messages that did not come in this tick: 'imu', 'foot:left', 'foot:right', 'joint_states'.
        note: Takes a sentence about what was injected, begins or ends; to be set by who wants to know.

    Raises:
        ConfigError: The plan does not fit the robot.
    """

    def __init__(self, model: RobotModel, *, period: float, seed: int, plan: Faults | None = None) -> None:
        self._model, self._period, self._seed = model, period, seed
        self._grace = round(MAX_AGE / period)
        self._plan = fault_plan(plan)
        self.note: Callable[[str], None] = lambda text: None
        self._injected: list[_Injected] = []
        self._count = 0
        self.active = False
        self.silent: frozenset[str] = frozenset()
        self._missing: frozenset[str] = frozenset()
        self._not_finite = self._unstamped = False
        self._heard: tuple[int, SensorData | None] | None = None
        for fault in self._plan.faults:
            self._check(fault)

    @property
    def spoilt(self) -> bool:
        """Whether a message of this tick does not come, is refused because it is not finite, or has a wrong stamp."""
        return self.active and (bool(self.silent) or self._not_finite or self._unstamped)

    @property
    def summary(self) -> str:
        """Faults that have not ended, in words."""
        return str(FaultPlan(self.injected))

    @property
    def injected(self) -> tuple[Fault, ...]:
        """Faults that have not ended."""
        return tuple(item.fault for item in self._injected)

    def inject(self, faults: Faults) -> str:
        """Inject faults, all of them or none; their times count from the next tick.

        Args:
            faults: As ``fault_plan`` takes them.

        Returns:
            What was injected, in words.

        Raises:
            ConfigError: They cannot be read, or do not fit the robot; names what is wrong.
        """
        plan = fault_plan(faults)
        checked = [(fault, self._check(fault)) for fault in plan.faults]
        for fault, channels in checked:
            rng = np.random.default_rng([STREAM, self._seed, self._count])
            first = round(fault.start / self._period)
            last = max(float(np.rint(fault.end / self._period)), first + 1.0)  # no fault is too short to be seen
            self._injected.append(_Injected(fault, channels, first, last, rng))
            self._count += 1
        self.active = bool(self._injected)
        told = f"injected: {plan}"
        if plan.faults:
            self.note(told)
        return told

    def clear(self) -> str:
        """End every fault; returns which, in words."""
        ended = self.injected
        told = f"cleared: {FaultPlan(ended)}"
        self._forget()
        if ended:
            self.note(told)
        return told

    def reset(self, seed: int | None = None) -> None:
        """Start over, with no fault but those of the plan."""
        self._seed = self._seed if seed is None else seed
        self._forget()
        self._count = 0
        if self._plan.since == START:
            self.inject(self._plan)

    def release(self) -> None:
        """The robot has been let go."""
        if self._plan.since == RELEASE:
            self.inject(self._plan)

    def sense(self, tick: int, values: Vector, before: Vector | None) -> None:
        """Put faults into a sample.

        Args:
            tick: Of the plant.
            values: Channels of ``SensorNoise``; changed in place.
            before: Those of the tick before, as they were passed on; None for the first.
        """
        missing, self._not_finite, self._unstamped = set[str](), False, False
        for item, k in self._at_work("sensors", tick):
            index = item.channels.index
            effect = self._effect(item, values[index] if before is None else before[index])
            values[index] = effect(k, values[index])
            self._not_finite |= not np.isfinite(values[index]).all()
            if effect.missing:
                missing |= item.channels.sources
        self._missing = frozenset(missing)
        self.silent = self._missing

    def drive(self, tick: int, tau: Vector, before: Vector) -> Vector:
        """Torques that the motors give.

        Args:
            tick: Of the plant.
            tau: What they are to give (nj,) [N.m].
            before: What they gave in the tick before (nj,) [N.m].

        Returns:
            A new array (nj,) [N.m] within the motors' limits, or ``tau`` where no motor is at fault.
        """
        given = tau
        for item, k in self._at_work("motors", tick):
            index = item.channels.index
            if given is tau:
                given = tau.copy()
            effect = self._effect(item, before[index])
            given[index] = np.clip(effect(k, given[index]), item.channels.low, item.channels.high)
        return given

    def heard(self, tick: int, sensors: SensorData) -> SensorData | None:
        """What the laws get of a sample; the same however often it is asked for in a tick.

        Args:
            tick: Of the plant.
            sensors: The sample as the drivers have it.

        Returns:
            ``sensors`` itself when nothing is wrong with 'joint_states' and 'stamps'; None when the joints do not come.
        """
        if not self.active:
            return sensors
        if self._heard is None or self._heard[0] != tick:
            self._heard = tick, self._hear(tick, sensors)
        return self._heard[1]

    def _hear(self, tick: int, sensors: SensorData) -> SensorData | None:
        items = self._at_work("messages", tick)
        if not items:
            return sensors
        values, missing = np.concatenate([sensors.q, sensors.v, sensors.tau, [sensors.t]]), False
        for item, k in items:
            index = item.channels.index
            effect = self._effect(item, values[index])
            values[index] = effect(k, values[index])
            missing |= effect.missing
        if missing:
            self.silent = self._missing | {JOINT_STATES}
            return None
        self._not_finite |= not np.isfinite(values).all()
        self._unstamped = values[-1] != sensors.t
        q, v, tau = values[:-1].reshape(3, -1)
        return structs.replace(sensors, t=float(values[-1]), q=q, v=v, tau=tau)

    def seen(self, tick: int, scan: Scan) -> Scan | None:
        """What the laws get of a scan of a tick: itself when nothing is wrong with it, None when it does not come."""
        for item, k in self._at_work(SCAN, tick):
            effect = self._effect(item, scan.ranges)
            scan = replace(scan, ranges=effect(k, scan.ranges))
            if effect.missing:
                return None
        return scan

    def _check(self, fault: Fault) -> Channels:
        """The channels of a fault that fits the robot."""
        channels = channels_of(fault, self._model)
        nothing = np.zeros(len(channels.index))
        effect_of(fault, channels, nothing, self._period, 0.0, np.random.default_rng(0))
        return channels

    def _at_work(self, way: str, tick: int) -> list[tuple[_Injected, int]]:
        """Faults that act in this tick, and since how many ticks; ends those whose time is over."""
        working = []
        for item in [item for item in self._injected if item.way == way]:
            if item.zero is None:
                item.zero = tick
            if tick - item.zero >= item.last:
                self._injected.remove(item)
                self.note(f"fault ends: {item.fault}")
            elif tick - item.zero >= item.first:
                working.append((item, tick - item.zero - item.first))
        self.active = bool(self._injected)
        return working

    def _effect(self, item: _Injected, before: Vector) -> Effect:
        """What a fault does; ``before`` are the values of its channels before it."""
        if item.effect is None:
            grace = 0 if not item.channels.sources else self._grace
            item.effect = effect_of(item.fault, item.channels, before.copy(), self._period, grace, item.rng)
            if item.first:
                self.note(f"fault begins: {item.fault}")
        return item.effect

    def _forget(self) -> None:
        self._injected.clear()
        self.active = False
        self.silent = self._missing = frozenset()
        self._heard = None
