"""Assembles samples that arrive on several topics into one ``SensorData``."""

from collections.abc import Sequence

import numpy as np

from controllers.estimation.stamps import StampFilter
from models.constants import FOOT_NAMES, NANOSECONDS
from models.types import SensorData, Vector

JOINTS, IMU = 0, 1  #: Rows of the stamp table; the feet follow
MAX_AGE = 0.005  #: Default maximum age of a sample of another source than the joints [s]
#: Names of the sources, in the order of the stamp table
SOURCES = ("joint_states", "imu", *(f"{name} foot" for name in FOOT_NAMES))


class SampleAssembler:
    """Assembles one ``SensorData`` per joint sample.

    A tick is complete when every source has a sample with the stamp of the joints. If the next joint sample arrives
    first, the newest samples of the other sources are used, up to their maximum age: a source may be slower than the
    joints, or lose a message. Values of a source that is silent for longer are NaN; the estimator bridges them for a
    while. After its next sample, the assembler waits for this source again.

    ``age_max_ns`` is the maximum age of a sample of another source [ns]. A stamp that jumps by more than ``gap_max_ns``
    [ns] is refused unless the next stamp continues from it. ``strict`` waits for the complete tick and never mixes
    stamps (lockstep). With ``repeats`` the plant may repeat a sample. Without ``feet`` the wrenches are NaN.
    """

    def __init__(
        self, age_max_ns: int, gap_max_ns: int, *, strict: bool = False, repeats: bool = False, feet: bool = True
    ) -> None:
        self._age_max, self._gap_max, self._strict, self._repeats = age_max_ns, gap_max_ns, strict, repeats
        self._absent = frozenset() if feet else frozenset(range(IMU + 1, len(SOURCES)))
        self.reset()

    def reset(self) -> None:
        """Discard every sample."""
        self._filters = [StampFilter(self._gap_max, f"header.stamp of {source}") for source in SOURCES]
        self._silent = set(self._absent)
        self._emitted: int | None = None
        self._joints: tuple[Vector, Vector, Vector] | None = None
        self._imu: tuple[Vector, Vector] = (np.zeros(3), np.zeros(3))
        self._wrenches = [np.zeros(6) for _ in FOOT_NAMES]
        self.incomplete = 0  #: Ticks with samples of different stamps
        self.silent = 0  #: Ticks with a source whose newest sample was too old
        self.dropped = 0  #: Ticks dropped because a source had no sample yet
        #: Stamps in the newest tick that differ from the joints' stamp, by source [ns]; None for a silent source
        self.mixed: dict[str, int | None] = {}

    @property
    def stamp(self) -> int | None:
        """Stamp of the newest joint sample [ns]; None before the first."""
        return self._filters[JOINTS].last

    @property
    def whole(self) -> bool:
        """Whether the newest tick has values of every fitted source."""
        return self._silent == self._absent

    def add_joints(self, stamp: int, q: Vector, v: Vector, tau: Vector) -> SensorData | None:
        """Add joint positions, velocities and torques (nj,) with a stamp [ns]; see ``add_imu``."""
        pending = self.stamp != self._emitted
        self._accept(JOINTS, stamp)
        self._joints = (q, v, tau)
        return self._emit(mixed=pending and not self._strict)

    def add_imu(self, stamp: int, gyro: Vector, accel: Vector) -> SensorData | None:
        """Add a sample with a stamp [ns]; returns the tick's data if complete. ``MessageError`` for a bad stamp."""
        self._accept(IMU, stamp)
        self._imu = (gyro, accel)
        return self._emit(mixed=False)

    def add_foot(self, foot: int, stamp: int, wrench: Vector) -> SensorData | None:
        """Add the wrench (6,) of a foot (0 left, 1 right) with a stamp [ns]; see ``add_imu``."""
        self._accept(IMU + 1 + foot, stamp)
        self._wrenches[foot] = wrench
        return self._emit(mixed=False)

    def _accept(self, source: int, stamp: int) -> None:
        if self._repeats and stamp == self._filters[source].last:
            return
        self._filters[source].step(stamp)
        self._silent.discard(source)

    def _emit(self, *, mixed: bool) -> SensorData | None:
        stamp, stamps = self.stamp, [each.last for each in self._filters]
        if self._joints is None or stamp is None or stamp == self._emitted:
            return None
        late = {source for source, other in enumerate(stamps) if other != stamp}
        if not mixed and not late <= self._silent:
            return None
        ages = {source: None if (given := stamps[source]) is None else stamp - given for source in late}
        if any(age is None and source not in self._absent for source, age in ages.items()):
            self.dropped += 1
            return None
        self._silent = {source for source, age in ages.items() if age is None or age > self._age_max}
        self.silent += not self.whole
        self.incomplete += late != self._silent
        self.mixed = {
            SOURCES[source]: None if source in self._silent else stamps[source] for source in late - self._absent
        }
        self._emitted = stamp
        wrenches = np.array(self._wrenches)
        for foot in range(len(FOOT_NAMES)):
            if IMU + 1 + foot in self._silent:
                wrenches[foot] = np.nan
        gyro, accel = (np.full(3, np.nan), np.full(3, np.nan)) if IMU in self._silent else self._imu
        return SensorData(stamp * 1e-9, *self._joints, gyro, accel, wrenches)


def mean_sample(samples: Sequence[SensorData]) -> SensorData:
    """Mean of every measurement, with the stamp of the last sample; reduces noise at the start of the estimator."""
    fields = ("q", "v", "tau", "gyro", "accel", "wrenches")
    return SensorData(samples[-1].t, *(np.mean([getattr(s, name) for s in samples], axis=0) for name in fields))


class FootPairs:
    """Pairs the newest samples of both feet; a foot older than the other by ``age_max`` [ns] is silent and left out."""

    def __init__(self, age_max: int, gap_max: int) -> None:
        self.wrenches = np.zeros((len(FOOT_NAMES), 6))  #: Newest sample of each foot, in its sole frame [N, N.m]
        self.silent = [True] * len(FOOT_NAMES)  #: Whether each foot's newest sample is too old
        self.stamp = 0  #: Stamp of the last pair [ns]
        self._age_max = age_max
        self._guards = [StampFilter(gap_max) for _ in FOOT_NAMES]
        self._begun: int | None = None

    def add(self, foot: int, stamp: int, wrench: Vector) -> float | None:
        """Add a wrench (6,) with a stamp [ns]; returns the time since the last pair [s], 0 for the first, or None.

        Raises ``MessageError`` if the stamp is not newer than the last of this foot, or is a single jump ahead.
        """
        self._guards[foot].step(stamp)
        self.wrenches[foot] = wrench
        other = self._guards[1 - foot].last
        begun = stamp if self._begun is None else self._begun
        self._begun = begun
        late = stamp - (begun if other is None else other) > self._age_max
        if not late and (other is None or other <= self.stamp):
            return None
        self.silent[foot], self.silent[1 - foot] = False, late
        newest = stamp if other is None else max(stamp, other)
        dt = 0.0 if self.stamp == 0 else (newest - self.stamp) / NANOSECONDS
        self.stamp = newest
        return dt
