"""Applies faults to the sensors and drives of a simulated robot."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from msgspec import structs

from bridge.plants.fault_effects import JOINT_STATES, SCAN, STAMPS, Channels, Effect, channels_of, effect_of
from bridge.plants.fault_plan import RELEASE, START, Fault, FaultPlan, Faults, fault_plan
from controllers.estimation.assembler import MAX_AGE
from models.robot_model import RobotModel
from models.scan import Scan
from models.types import SensorData, Vector

STREAM = 0xFA017  #: Separates random faults from the noise of the same seed


@dataclass(slots=True)
class _Injected:
    fault: Fault
    channels: Channels
    first: int  #: Ticks from the injection to the begin
    last: float  #: Ticks from the injection to the end
    rng: np.random.Generator
    zero: int | None = None  #: Tick of the injection: the first tick that the fault can affect; None before
    effect: Effect | None = None  #: None before the begin

    @property
    def stage(self) -> str:
        """Stage at which the fault acts: 'sensors', 'messages', 'scan' or 'motors'."""
        if self.fault.is_motor or self.fault.target == SCAN:
            return "motors" if self.fault.is_motor else SCAN
        return "messages" if self.fault.target in (JOINT_STATES, STAMPS) else "sensors"


class FaultProxy:
    """Applies faults to the sensor values of the plant, and to the torques of its drives.

    Faults of one target act in the order of injection. Random values depend only on the seed and on that order. Without
    faults all values pass unchanged.

    A missing message is replaced by the last one while it is at most ``MAX_AGE`` old, then by NaN, as
    ``SampleAssembler`` does in the graph. A missing message of all joints is not replaced.

    ``plan`` is injected at every start or release; ``period`` is the tick [s]. Raises ``ConfigError`` when the plan
    does not fit the robot.
    """

    def __init__(self, model: RobotModel, *, period: float, seed: int, plan: Faults | None = None) -> None:
        self._model, self._period, self._seed = model, period, seed
        self._grace = round(MAX_AGE / period)
        self._plan = fault_plan(plan)
        self.note: Callable[[str], None] = lambda text: None  #: Called when a fault is injected, begins or ends
        self._injected: list[_Injected] = []
        self._count = 0
        self._clear()
        for fault in self._plan.faults:
            self._check(fault)

    def _clear(self) -> None:
        self._injected.clear()
        self.active = self._not_finite = self._unstamped = False  #: Whether any fault is injected, begun or not
        #: Messages missing in this tick: 'imu', 'foot:left', 'foot:right', 'joint_states'
        self.missing = self._missing_sensors = frozenset[str]()
        self._transmitted: tuple[int, SensorData | None] | None = None

    @property
    def corrupted(self) -> bool:
        """Whether a message of this tick is missing, is refused as not finite, or has a wrong stamp."""
        return self.active and (bool(self.missing) or self._not_finite or self._unstamped)

    @property
    def summary(self) -> str:
        """Faults that have not ended, as text."""
        return str(FaultPlan(self.injected))

    @property
    def injected(self) -> tuple[Fault, ...]:
        """Faults that have not ended."""
        return tuple(item.fault for item in self._injected)

    def inject(self, faults: Faults) -> str:
        """Inject faults from the next tick on; returns a description. ``ConfigError`` if one is invalid: no effect."""
        plan = fault_plan(faults)
        checked = [(fault, self._check(fault)) for fault in plan.faults]
        for fault, channels in checked:
            rng = np.random.default_rng([STREAM, self._seed, self._count])
            first = round(fault.start / self._period)
            last = max(float(np.rint(fault.end / self._period)), first + 1.0)  # a fault lasts at least one tick
            self._injected.append(_Injected(fault, channels, first, last, rng))
            self._count += 1
        self.active = bool(self._injected)
        text = f"injected: {plan}"
        if plan.faults:
            self.note(text)
        return text

    def clear(self) -> str:
        """End every fault; returns their description."""
        text, ended = f"cleared: {self.summary}", self.active
        self._clear()
        if ended:
            self.note(text)
        return text

    def reset(self, seed: int | None = None) -> None:
        """Reset to the faults of the plan; a seed replaces the present one."""
        self._seed = self._seed if seed is None else seed
        self._clear()
        self._count = 0
        if self._plan.since == START:
            self.inject(self._plan)

    def release(self) -> None:
        """Inject the plan if it is due at the release of the robot."""
        if self._plan.since == RELEASE:
            self.inject(self._plan)

    def sense(self, tick: int, values: Vector, before: Vector | None) -> None:
        """Apply faults in place to the channels of a tick; ``before`` are the resulting values of the last tick."""
        self._not_finite = self._unstamped = False
        self.missing, _ = self._apply("sensors", tick, values, before)
        self._missing_sensors = self.missing

    def drive(self, tick: int, tau: Vector, before: Vector) -> Vector:
        """Motor torques (nj,) [N.m] for desired (``tau``) and previous ones: ``tau`` without a fault, else clipped."""
        given = tau
        for item, k in self._at_work("motors", tick):
            index = item.channels.index
            if given is tau:
                given = tau.copy()
            values, _ = self._effect(item, before[index])(k, given[index])
            given[index] = np.clip(values, item.channels.low, item.channels.high)
        return given

    def transmit(self, tick: int, sensors: SensorData) -> SensorData | None:
        """The drivers' sample as the control laws receive it; None when the joint states are missing."""
        if not self.active:
            return sensors
        if self._transmitted is None or self._transmitted[0] != tick:
            self._transmitted = tick, self._transmit(tick, sensors)
        return self._transmitted[1]

    def _transmit(self, tick: int, sensors: SensorData) -> SensorData | None:
        values = np.concatenate([sensors.q, sensors.v, sensors.tau, [sensors.t]])
        missing, at_work = self._apply("messages", tick, values, None)
        if not at_work:
            return sensors
        if missing:
            self.missing = self._missing_sensors | {JOINT_STATES}
            return None
        self._unstamped = values[-1] != sensors.t
        q, v, tau = values[:-1].reshape(3, -1)
        return structs.replace(sensors, t=float(values[-1]), q=q, v=v, tau=tau)

    def transmit_scan(self, tick: int, scan: Scan) -> Scan | None:
        """A scan as the control laws receive it; None when it is missing."""
        for item, k in self._at_work(SCAN, tick):
            ranges, missing = self._effect(item, scan.ranges)(k, scan.ranges)
            scan = replace(scan, ranges=ranges)
            if missing:
                return None
        return scan

    def _apply(self, stage: str, tick: int, values: Vector, before: Vector | None) -> tuple[frozenset[str], bool]:
        """Apply the faults of a stage in place; returns the missing messages and whether any fault acts."""
        missing, at_work = set[str](), self._at_work(stage, tick)
        for item, k in at_work:
            index = item.channels.index
            effect = self._effect(item, values[index] if before is None else before[index])
            values[index], lost = effect(k, values[index])
            if lost:
                missing |= item.channels.sources
            self._not_finite |= not np.isfinite(values[index]).all()
        return frozenset(missing), bool(at_work)

    def _check(self, fault: Fault) -> Channels:
        channels = channels_of(fault, self._model)
        nothing = np.zeros(len(channels.index))
        effect_of(fault, channels, nothing, self._period, 0.0, np.random.default_rng(0))
        return channels

    def _at_work(self, stage: str, tick: int) -> list[tuple[_Injected, int]]:
        """Faults that act in this tick, each with the ticks since its begin; removes those that have ended."""
        working = []
        for item in [item for item in self._injected if item.stage == stage]:
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
        """The effect of a fault; ``before`` are the values of its channels before the fault."""
        if item.effect is None:
            grace = 0 if not item.channels.sources else self._grace
            item.effect = effect_of(item.fault, item.channels, before.copy(), self._period, grace, item.rng)
            if item.first:
                self.note(f"fault begins: {item.fault}")
        return item.effect
