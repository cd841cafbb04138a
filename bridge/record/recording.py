"""Recording of a run as arrays, for report, plots and film strip."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from models.errors import PoiseError
from models.files import open_arrays
from models.robot_model import RobotModel
from models.types import Matrix, Vector

COLUMNS = ("t", "q", "v", "tau", "wrenches")  #: Arrays that every recording has


@dataclass(frozen=True, slots=True)
class Recording:
    """Samples of one run."""

    robot: str
    t: Vector  #: Stamps, increasing (n,) [s]
    q: Matrix  #: Configurations in Pinocchio's order (n, nq) [m, rad]
    v: Matrix  #: Velocities in Pinocchio's order (n, nv) [m/s, rad/s]
    tau: Matrix  #: Joint torques (n, nj) [N.m]
    wrenches: Matrix  #: Ground reaction on each foot in its sole frame (n, 2, 6) [N, N.m]
    events: tuple[tuple[float, str], ...] = ()  #: Stamp [s] and text
    estimate: Matrix | None = None  #: Estimated base pose in ``odom``: position, quaternion xyzw (n, 7) [m]; optional

    def split(self, word: str) -> tuple[Recording, Recording | None]:
        """Parts before and from the first event that begins with a word; the second is None without one."""
        starts = [time for time, text in self.events if text.split()[0] == word]
        if not starts or not (self.t >= starts[0]).any():
            return self, None
        return self.between(-np.inf, starts[0]), self.between(starts[0], np.inf)

    def between(self, start: float, end: float) -> Recording:
        """The part from a stamp [s] to just before another one [s], with its events."""
        rows = (self.t >= start) & (self.t < end)
        columns = {name: getattr(self, name)[rows] for name in COLUMNS}
        events = tuple(event for event in self.events if start <= event[0] < end)
        estimate = None if self.estimate is None else self.estimate[rows]
        return Recording(self.robot, events=events, estimate=estimate, **columns)

    def save(self, path: Path) -> None:
        """Write the recording as a compressed NumPy archive."""
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(
            path,
            robot=np.array(self.robot),
            **{name: getattr(self, name) for name in COLUMNS},
            event_times=np.array([time for time, _ in self.events]),
            event_texts=np.array([text for _, text in self.events], dtype=np.str_),
            estimate=np.empty((0, 7)) if self.estimate is None else self.estimate,
        )

    @classmethod
    def load(cls, path: Path) -> Recording:
        """Read a file written by ``save``; ``PoiseError`` for any other file."""
        try:
            with open_arrays(path) as data:
                events = zip(data["event_times"].tolist(), data["event_texts"].tolist(), strict=True)
                arrays = {name: data[name] for name in COLUMNS}
                base = data["estimate"] if len(data["estimate"]) else None
                return cls(str(data["robot"]), events=tuple(events), estimate=base, **arrays)
        except (OSError, KeyError, ValueError) as error:
            raise PoiseError(f"{path}: not a recording: {error}") from error


def sole_middle(model: RobotModel, data: pin.Data, q: Vector) -> tuple[float, float, float]:
    """X [m], y [m] and heading [rad] of the midpoint of the soles at a configuration (nq,)."""
    pin.framesForwardKinematics(model.pin, data, q)
    poses = [data.oMf[foot.frame_id] for foot in model.feet]
    middle = 0.5 * (poses[0].translation + poses[1].translation)
    ahead = poses[0].rotation[:, 0] + poses[1].rotation[:, 0]
    return float(middle[0]), float(middle[1]), float(np.arctan2(ahead[1], ahead[0]))
