"""Where the soles are planned, or planted: support of the gait."""

from __future__ import annotations

import math

import numpy as np

from models.robot_model import RobotModel
from models.types import Vector
from planners.gait.config import GaitConfig
from planners.gait.footsteps import Foothold, middle
from planners.gait.kernels_steps import wrap
from planners.gait.measurement import GaitMeasurement


def moved(hold: Foothold, way: Vector) -> Foothold:
    """The foothold moved in W by (2,) [m]."""
    x, y = way.tolist()
    return Foothold(hold.x + x, hold.y + y, hold.yaw, hold.z)


class Soles:
    """Footholds of both feet and what follows from them.

    Args:
        model: The robot: its soles.
        config: The gait.

    Attributes:
        holds: Planned pose of each sole, or the target of the one that swings.
        tilts: Slope of the ground under each planted sole: its rise along x and along y of W (2, 2) [-].
        slope: Slope expected at the next landing (2,) [-].
        centres: Middle of each sole in its own frame (2, 2) [m].
    """

    def __init__(self, model: RobotModel, config: GaitConfig) -> None:
        self._config = config
        rectangles = [foot.rectangle for foot in model.feet]
        self._centres = [(0.5 * (r[0] + r[1]), 0.5 * (r[2] + r[3])) for r in rectangles]
        self.centres = np.array(self._centres)
        self._half = [np.array([0.5 * (r[1] - r[0]), 0.5 * (r[3] - r[2])]) for r in rectangles]
        self.holds = [Foothold(0.0, 0.0, 0.0), Foothold(0.0, 0.0, 0.0)]
        self._rise = [0.0, 0.0]
        self.tilts, self.slope = np.zeros((2, 2)), np.zeros(2)
        self._seen = self.holds
        self._felt: list[Vector] = []

    def reset(self, measured: GaitMeasurement) -> None:
        """Both feet planted where and as they are measured."""
        self.holds = list(measured.soles)
        self._seen = list(measured.soles)
        self._rise = [0.0, 0.0]
        self.tilts[:] = measured.tilts
        self._felt = [measured.tilts.mean(axis=0)] * self._config.ground.slope_steps
        self.slope[:] = self._felt[0]

    def landing_height(self, foot: int, measured: GaitMeasurement) -> float:
        """Height at which a foot is expected to land on its foothold [m].

        In the plane through the stance sole that has the expected slope, and as far above or below it as the foot
        landed before: an error of the estimated inclination and encoder offsets make feet land early or late, the same
        way at every step.
        """
        return self._plane(foot, self.holds[foot], measured) + self._rise[foot]

    def land(self, foot: int, measured: GaitMeasurement) -> None:
        """A foot has touched down where it is measured.

        The expected height follows by a bounded step: what repeats adds up, single bumps hardly count. The expected
        slope is the median of the last soles that bore alone: one that stood on an edge does not count.
        """
        config, sole = self._config.swing, measured.soles[foot]
        surprise = sole.z - self._plane(foot, sole, measured) - self._rise[foot]
        followed = self._rise[foot] + min(max(surprise, -config.rise_step), config.rise_step)
        self._rise[foot] = min(max(followed, -config.rise_max), config.rise_max)
        self.holds[foot] = sole
        self.tilts[foot] = measured.tilts[foot]
        self._felt = [*self._felt[1:], measured.tilts[1 - foot].copy()]
        steepest = self._config.ground.slope_max
        self.slope[:] = np.clip(np.median(self._felt, axis=0), -steepest, steepest)

    def _plane(self, foot: int, hold: Foothold, measured: GaitMeasurement) -> float:
        """Height of the plane through the other sole at a foothold [m]."""
        stance = measured.soles[1 - foot]
        return stance.z + float(self.slope[0]) * (hold.x - stance.x) + float(self.slope[1]) * (hold.y - stance.y)

    def half_sole(self, foot: int) -> Vector:
        """Half length and half width of a sole (2,) [m]."""
        return self._half[foot]

    def centre(self, foot: int) -> tuple[float, float]:
        """Middle of a sole in its own frame [m]."""
        return self._centres[foot]

    def point_of(self, foot: int, hold: Foothold) -> Vector:
        """ZMP point of a foot on a foothold: the middle of the sole, in W (2,) [m]."""
        return np.array(hold.moved(*self._centres[foot]))

    def point(self, foot: int) -> Vector:
        """ZMP point of a foot where it is planned (2,) [m]."""
        return self.point_of(foot, self.holds[foot])

    def nearest(self, dcm: Vector) -> int:
        """The foot whose point is nearer to a DCM (2,) [m]."""
        left, right = (float(np.linalg.norm(dcm - self.point(foot))) for foot in range(2))
        return 0 if left < right else 1

    def middle(self) -> Vector:
        """Half-way between both points (2,) [m]."""
        middle: Vector = 0.5 * (self.point(0) + self.point(1))
        return middle

    def ground(self) -> float:
        """Mean height [m]."""
        return 0.5 * (self.holds[0].z + self.holds[1].z)

    def beyond_standing(self, dcm: Vector) -> bool:
        """Whether a DCM (2,) nears the edge of the box around both soles, so that standing cannot bring it back."""
        place, half = self.standing_box(dcm)
        return bool((np.abs(place) > self._config.step_share * half).any())

    def astride(self, allowed: float) -> bool:
        """Whether one sole is farther from where it stands in the nominal stance than this [m]."""
        left, right = self.holds
        forward, side = Foothold(right.x, right.y, middle(self.holds).yaw).relative(left.x, left.y)
        return math.hypot(forward, side - self._config.reach.width) > allowed

    def standing_box(self, dcm: Vector) -> tuple[Vector, Vector]:
        """The box around both soles, along their mean heading.

        Args:
            dcm: In W (2,) [m].

        Returns:
            The DCM seen from the middle of the box (2,) [m], and half the box's size (2,) [m].
        """
        x, y = (float(value) for value in self.middle())
        frame = Foothold(x, y, middle(self.holds).yaw)
        apart = np.abs(frame.relative(*self.point(0)))
        return np.array(frame.relative(*dcm)), self._half[0] + apart

    def shares(self, zmp: Vector) -> tuple[float, float]:
        """Share of the weight that each foot is to bear, from where a ZMP (2,) lies between their points."""
        left, right = self.point(0), self.point(1)
        way = right - left
        share = float(np.clip((zmp - left) @ way / (way @ way), 0.0, 1.0))
        return 1.0 - share, share

    def drift(self, measured: GaitMeasurement, swinging: int | None) -> Vector:
        """How far the soles that bear have moved since the last tick, by their loads (2,) [m].

        A planted sole stays where it is: what moves is the estimate, and everything measured with it.

        Args:
            measured: Soles and loads.
            swinging: The foot in the air; None for none.
        """
        before, self._seen = self._seen, list(measured.soles)
        x, y, total = 0.0, 0.0, 0.0
        for foot, (old, new) in enumerate(zip(before, self._seen, strict=True)):
            load = measured.loads[foot]
            if foot != swinging and load >= self._config.anchor_load:
                x, y, total = x + load * (new.x - old.x), y + load * (new.y - old.y), total + load
        return np.array([x / total, y / total]) if total > 0.0 else np.zeros(2)

    def carry(self, way: Vector) -> None:
        """Move both footholds (2,) [m]."""
        self.holds = [moved(hold, way) for hold in self.holds]

    def follow(self, measured: GaitMeasurement, swinging: int | None, landed: int | None, dt: float) -> None:
        """Planted footholds creep after the soles that bear: what the estimator cannot observe moves both alike.

        Args:
            measured: Soles and loads.
            swinging: The foot in the air; None for none.
            landed: The foot that has just landed and lies down on the ground; None for none.
            dt: [s].
        """
        self._feel(measured, swinging, landed, dt)
        share = min(dt / self._config.anchor_time, 1.0)
        for foot in range(2):
            if foot == swinging or measured.loads[foot] < self._config.anchor_load:
                continue
            hold, sole = self.holds[foot], measured.soles[foot]
            self.holds[foot] = Foothold(
                hold.x + share * (sole.x - hold.x),
                hold.y + share * (sole.y - hold.y),
                hold.yaw + share * wrap(sole.yaw - hold.yaw),
                hold.z + share * (sole.z - hold.z),
            )

    def _feel(self, measured: GaitMeasurement, swinging: int | None, landed: int | None, dt: float) -> None:
        """Slope under the soles that bear."""
        ground = self._config.ground
        for foot in range(2):
            if foot == swinging or measured.loads[foot] < self._config.anchor_load:
                continue
            time = ground.settle_time if foot == landed else ground.anchor_time
            share = min(dt / time, 1.0)
            for axis in range(2):
                self.tilts[foot, axis] += share * (measured.tilts[foot, axis] - self.tilts[foot, axis])
