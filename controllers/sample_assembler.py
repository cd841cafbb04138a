"""Puts samples that arrive one by one on several topics together into one ``SensorData`` per tick."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from controllers.leap import Leap
from models.errors import MessageError
from models.types import FOOT_NAMES, SensorData, Vector

JOINTS, IMU = 0, 1
"""Rows of the stamp table; the feet follow."""

MAX_AGE = 0.005
"""Age up to which a sample of another source is used by default [s]."""

SOURCES = ("joint_states", "imu", *(f"{name} foot" for name in FOOT_NAMES))
"""Names of the sources, in the order of the stamp table."""


class SampleAssembler:
    """One ``SensorData`` for each joint sample.

    A tick is complete when every source has given a sample of the joints' stamp. When the next joint sample comes
    before that, the newest samples of the other sources are used instead if they are young enough: a source may be
    slower than the joints, or lose a message. The values of one that is silent for longer are NaN, which the estimator
    bridges for a while; it is waited for again once it has given another sample.

    Args:
        max_age_ns: Oldest usable sample of another source [ns].
        max_gap_ns: Largest step of a source's stamp that is believed at once [ns]. A larger one is refused, unless the
            source goes on from there: then samples had been missing.
        strict: Never mix stamps: wait for the complete tick; the plant may repeat a sample it got no answer to, which
            is passed over (lockstep).
        feet: Whether the robot has foot sensors; without, their values are NaN and nobody waits for them.

    Attributes:
        incomplete: Ticks made of samples with different stamps.
        silent: Ticks with a source whose newest sample was too old.
        dropped: Ticks given up because a source had not given any sample yet.
        mixed: Sources whose sample in the newest tick has another stamp than the joints [ns]; None for no sample.
    """

    def __init__(self, max_age_ns: int, max_gap_ns: int, *, strict: bool = False, feet: bool = True) -> None:
        self._max_age, self._max_gap, self._strict = max_age_ns, max_gap_ns, strict
        self._absent = frozenset() if feet else frozenset(range(IMU + 1, len(SOURCES)))
        self.reset()

    def reset(self) -> None:
        """Forget every sample."""
        self._stamps: list[int | None] = [None] * len(SOURCES)
        self._leaps = [Leap(self._max_gap) for _ in SOURCES]
        self._silent = set(self._absent)
        self._emitted: int | None = None
        self._joints: tuple[Vector, Vector, Vector] | None = None
        self._imu: tuple[Vector, Vector] = (np.zeros(3), np.zeros(3))
        self._wrenches = [np.zeros(6) for _ in FOOT_NAMES]
        self.incomplete = self.silent = self.dropped = 0
        self.mixed: dict[str, int | None] = {}

    @property
    def stamp(self) -> int | None:
        """Stamp of the newest joint sample [ns]; None before the first."""
        return self._stamps[JOINTS]

    @property
    def whole(self) -> bool:
        """Whether the newest tick has values of every source there is."""
        return self._silent == self._absent

    def add_joints(self, stamp: int, q: Vector, v: Vector, tau: Vector) -> SensorData | None:
        """Take joint positions, velocities and torques (nj,) of a stamp [ns]; see ``add_imu``."""
        pending = self._stamps[JOINTS] != self._emitted
        self._accept(JOINTS, stamp)
        self._joints = (q, v, tau)
        return self._emit(mixed=pending and not self._strict)

    def add_imu(self, stamp: int, gyro: Vector, accel: Vector) -> SensorData | None:
        """Take an inertial sample of a stamp [ns].

        Returns:
            The tick's sensor data if this completes it.

        Raises:
            MessageError: The stamp is not newer than this source's last one, or leaps ahead.
        """
        self._accept(IMU, stamp)
        self._imu = (gyro, accel)
        return self._emit(mixed=False)

    def add_foot(self, foot: int, stamp: int, wrench: Vector) -> SensorData | None:
        """Take the wrench (6,) of a foot (0 left, 1 right) of a stamp [ns]; see ``add_imu``."""
        self._accept(IMU + 1 + foot, stamp)
        self._wrenches[foot] = wrench
        return self._emit(mixed=False)

    def _accept(self, source: int, stamp: int) -> None:
        last = self._stamps[source]
        if last is not None:
            if stamp == last and self._strict:
                return
            if stamp <= last:
                kind = "repeats" if stamp == last else "is before"
                raise MessageError(f"header.stamp of {SOURCES[source]}: {stamp} ns {kind} {last} ns")
            if not self._leaps[source].believes(last, stamp):
                raise MessageError(f"header.stamp of {SOURCES[source]}: {stamp} ns leaps ahead of {last} ns")
        self._stamps[source] = stamp
        self._silent.discard(source)

    def _emit(self, *, mixed: bool) -> SensorData | None:
        stamp = self._stamps[JOINTS]
        if self._joints is None or stamp is None or stamp == self._emitted:
            return None
        late = {source for source, other in enumerate(self._stamps) if other != stamp}
        if not mixed and not late <= self._silent:
            return None
        ages = {source: None if (given := self._stamps[source]) is None else stamp - given for source in late}
        if any(age is None and source not in self._absent for source, age in ages.items()):
            self.dropped += 1
            return None
        self._silent = {source for source, age in ages.items() if age is None or age > self._max_age}
        self.silent += not self.whole
        self.incomplete += late != self._silent
        self.mixed = {
            SOURCES[source]: None if source in self._silent else self._stamps[source] for source in late - self._absent
        }
        self._emitted = stamp
        wrenches = np.array(self._wrenches)
        for foot in range(len(FOOT_NAMES)):
            if IMU + 1 + foot in self._silent:
                wrenches[foot] = np.nan
        gyro, accel = (np.full(3, np.nan), np.full(3, np.nan)) if IMU in self._silent else self._imu
        return SensorData(stamp * 1e-9, *self._joints, gyro, accel, wrenches)


def mean_sample(samples: Sequence[SensorData]) -> SensorData:
    """Mean of every measurement, with the stamp of the last sample: a quieter start for an estimator at rest."""
    fields = ("q", "v", "tau", "gyro", "accel", "wrenches")
    return SensorData(samples[-1].t, *(np.mean([getattr(s, name) for s in samples], axis=0) for name in fields))
