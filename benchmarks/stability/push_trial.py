"""One push on a robot that may step: prepared, pushed, judged by the true state."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, partial
from typing import Annotated

import coal
import numpy as np
import pinocchio as pin
from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import Positive, settings
from benchmarks.core.harness import Case
from benchmarks.core.loops import demand
from benchmarks.stability.fall_signals import moments_since
from benchmarks.stability.push import stance
from benchmarks.stability.push_plot import PushMode
from bridge.closed_loop import ClosedLoop
from models.config import STRICT, default_config
from models.errors import PoiseError
from models.heading import heading
from models.robot_model import RobotModel
from models.types import Mode, Vector
from planners.collision import SelfCollision
from planners.motion_config import MotionConfig


class LegClearance:
    """Least distance between the left and the right leg.

    Legs are the convex hulls of the URDF's collision bodies, and a box of ``thickness`` [m] on each contact rectangle:
    some URDFs have only four points for a foot.
    """

    def __init__(self, robot: RobotModel, thickness: float) -> None:
        self._robot = robot
        self._hulls = SelfCollision(robot, default_config(MotionConfig, "planners", "motion").collision)
        legs = [
            set(robot.pin.supports[robot.pin.frames[foot.frame_id].parentJoint].tolist()[2:]) for foot in robot.feet
        ]
        joints = [body.parentJoint for body in self._hulls.geometry.geometryObjects]
        between = []
        for k in range(self._hulls.count):
            first, second = (joints[i] for i in self._hulls.bodies(k))
            between.append((first in legs[0] and second in legs[1]) or (first in legs[1] and second in legs[0]))
        self._between = np.array(between)
        self._data = robot.data()
        self._boxes, self._places = [], []
        for foot in robot.feet:
            back, front, right, left = foot.rectangle
            self._boxes.append(coal.Box(front - back, left - right, thickness))
            middle = np.array([0.5 * (back + front), 0.5 * (left + right), 0.5 * thickness])
            self._places.append(pin.SE3(np.eye(3), middle))

    def distance(self, q: Vector) -> float:
        """Least distance at a configuration (nq,) [m]: negative when legs overlap, infinite when far apart."""
        hulls = self._hulls.distances(q, 0.0)[self._between]
        pin.framesForwardKinematics(self._robot.pin, self._data, q)
        poses = [
            self._data.oMf[foot.frame_id] * place for foot, place in zip(self._robot.feet, self._places, strict=True)
        ]
        transforms = [coal.Transform3s(pose.rotation, pose.translation) for pose in poses]
        result = coal.DistanceResult()
        soles = coal.distance(
            self._boxes[0], transforms[0], self._boxes[1], transforms[1], coal.DistanceRequest(), result
        )
        return min(float(soles), float(hulls.min(initial=np.inf)))


@schema(frozen=True, slots=True, config=STRICT)
class Required:
    """Impulse over mass that passes, or is the goal, of all directions [m/s]."""

    smallest: Positive
    median: Positive


@schema(frozen=True, slots=True, config=STRICT)
class PushMapConfig:
    """The push test with steps; the unit of every value stands in ``benchmarks/config/push_map.yaml``."""

    body: str
    directions: dict[PushMode, Annotated[int, Field(ge=1)]]
    phases: dict[PushMode, Annotated[int, Field(ge=1)]]
    first_seed: dict[PushMode, Annotated[int, Field(ge=0)]]
    duration: Positive
    stand_time: Positive
    walk_time: Positive
    walk_speed: Positive
    recover_time: Positive
    check_period: Positive
    first: Positive
    largest: Positive
    stride: Positive
    resolution: Positive
    speed_tolerance: Positive
    overlap_tolerance: Annotated[float, Field(ge=0.0)]
    sole_thickness: Positive
    walk_window: Positive
    walk_share: Annotated[float, Field(gt=0.0, lt=1.0)]
    bound_steps: Annotated[int, Field(ge=1)]
    record_period: Positive
    lead: Positive
    required: dict[PushMode, Required]
    goals: dict[PushMode, Required]


@dataclass(frozen=True, slots=True)
class Trial:
    """One push without its size: phase of the stride (standing: added to the seed), heading from the robot [rad]."""

    robot: str
    mode: PushMode
    seed: int
    phase: int
    angle: float


@dataclass(frozen=True, slots=True)
class Outcome:
    """Why a push was not taken (empty when it was), and the simulated time of the push [s]."""

    reason: str
    pushed: float


map_config = partial(settings, PushMapConfig, "push_map")


@cache
def loop_of(robot: str) -> ClosedLoop:
    """One closed loop for every push of this process; ``reset`` starts it over as a new one would."""
    return ClosedLoop(robot=robot, record_period_s=map_config().record_period)


@cache
def legs_of(robot: str) -> LegClearance:
    """The clearance of a robot's legs, for every push of this process."""
    return LegClearance(loop_of(robot).robot, map_config().sole_thickness)


def prepare(trial: Trial) -> ClosedLoop:
    """Bring a robot to the moment of its push; ``PoiseError`` when it falls, or does not walk, without one."""
    config, loop = map_config(), loop_of(trial.robot)
    standing = trial.mode is not PushMode.WALK
    loop.reset(trial.seed + (trial.phase if standing else 0))
    if trial.mode is not PushMode.CATCH:
        demand(loop, "walk")
    if standing:
        loop.run(config.stand_time)
        return loop
    loop.set_velocity(config.walk_speed, 0.0, 0.0)
    loop.run(config.walk_time)
    stride = 2.0 * loop.gait.config.period
    end, was = loop.t + 2.0 * stride, True
    while True:  # until the left foot lifts
        lift_off = loop.gait.view.swinging and loop.gait.stance == 1
        if lift_off and not was:
            break
        was = lift_off
        if loop.t > end or loop.fallen:
            raise PoiseError(f"{trial.robot} does not walk at {config.walk_speed} m/s before it is pushed")
        loop.step()
    loop.run(stride * trial.phase / config.phases[trial.mode])
    return loop


def survives(loop: ClosedLoop, trial: Trial, dv: float) -> Outcome:
    """Push once, by an impulse over mass ``dv`` [m/s], a robot from ``prepare``."""
    config, legs, pushed = map_config(), legs_of(trial.robot), loop.t
    angle = heading(*loop.truth.q[3:7]) + trial.angle
    force = loop.robot.mass * dv / config.duration
    loop.apply_push((force * math.cos(angle), force * math.sin(angle), 0.0), config.duration, config.body)
    end, places = pushed + config.duration + config.recover_time, [loop.truth.q[:2].copy()]
    while loop.t < end - 1e-9:  # 1e-9: rounding of the simulated time
        loop.run(config.check_period)
        if loop.fallen:
            return Outcome(loop.fall_reason, pushed)
        if legs.distance(loop.truth.q) < -config.overlap_tolerance:
            return Outcome("the legs run through each other", pushed)
        places.append(loop.truth.q[:2].copy())
    return Outcome(_ending(trial, loop, places), pushed)


def moments(loop: ClosedLoop, outcome: Outcome) -> Case:
    """What explains how a push ended, from shortly before it on; see ``moments_since``."""
    return moments_since(loop, outcome.pushed - map_config().lead)


def _ending(trial: Trial, loop: ClosedLoop, places: list[Vector]) -> str:
    """Why the end of a trial is not what it has to be; empty when it is."""
    config = map_config()
    if trial.mode is PushMode.WALK:
        window = min(round(config.walk_window / config.check_period), len(places) - 1)
        moved = float(np.linalg.norm(places[-1] - places[-1 - window]))
        return "" if moved > config.walk_share * config.walk_speed * config.walk_window else "does not walk on"
    speed = float(np.linalg.norm(stance(loop.robot, loop.truth).com_velocity))
    if loop.gait.walking:
        return "still steps"
    if trial.mode is PushMode.CATCH and loop.mode is not Mode.STAND:
        return f"ends in mode '{loop.mode.value}'"
    return "" if speed < config.speed_tolerance else f"CoM still moves at {speed:.2f} m/s"
