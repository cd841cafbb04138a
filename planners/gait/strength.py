r"""Crouch and speed of the walk within the torque and speed limits of a robot's legs.

In the nominal step of a pace, the base is upright at the mean heading of the feet. The CoM moves as the pendulum with a
fixed ZMP ``p``,

.. math:: c(t) - p = \frac{b + a}{2} \frac{\cosh \omega t}{\cosh \omega T/2}
    + \frac{b - a}{2} \frac{\sinh \omega t}{\sinh \omega T/2}, \quad -T/2 \le t \le T/2

from a to b, the points midway to the other foot before and after the step, at the height of the gait with its rise. The
swing foot moves from 2 a to 2 b. Inverse dynamics with all ground forces on the stance foot gives the torques. The load
share of a joint is the root mean square of its torque over its limit. It includes the full load of the weight, but
little of the ends of a swing, which arms and a slower foot compensate. The arms also balance the moment of the swing
leg, so the CoP is at the ZMP, farther back than without arms. The load of the stance knee, which is then higher, is
computed with that CoP. Ankles are excluded: their torque sets the CoP, which is kept where they can hold it
(``Foot.bearing``), and a lifted foot may tip.

A second share is the root mean square of a joint's speed over its limit. If a joint is too slow, the foot lags behind
its reference in heading or position, and so does the base.

The farther ahead the ZMP is, the less load the knees bear. The ZMP is moved from ``zmp`` towards the middle of the sole
as far as the crouch requires. Crouch and velocity limits are then reduced until no joint exceeds ``torque_share`` and
``swing.speed_share``, or its share in a step on the spot without a crouch. If that exceeds a torque limit, the robot
does not walk.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from models.constants import GRAVITY, JOINTS_V
from models.errors import RobotModelError
from models.foot import NORMAL
from models.robot_model import RobotModel
from models.types import STILL, Vector, Velocity
from planners.gait.config import GaitConfig
from planners.gait.pace import Pace, pace_at, share_of
from planners.gait.reaction import pose_foot

_SAMPLES = 13  #: Samples of a step; twice as many change the shares of the packaged robots by less than 0.01
_BISECTIONS = 8  #: Bisections in the search for a limit
_SLACK = 0.02  #: Additional share of a limit for steps with a velocity, relative to a step on the spot [-]
_CROUCH = 0.9  #: Part of the allowed shares that a crouch may use, which leaves a margin for velocities [-]
_BEYOND = 1.03  #: The legs limit a velocity if this multiple of it exceeds the allowed shares [-]
_DEEPER = 0.003  #: The legs limit a crouch if one deeper by this height exceeds the allowed shares [m]
STANDSTILL = 1e-4  #: Velocity limit of a robot that cannot walk or turn [m/s], [rad/s]
#: Velocities at the limits, as multiples of the limits
_WAYS: dict[str, Velocity] = {
    "forward": (1.0, 0.0, 0.0),
    "backward": (-1.0, 0.0, 0.0),
    "lateral": (0.0, 1.0, 0.0),
    "turn": (0.0, 0.0, 1.0),
}


class Step(NamedTuple):
    """Nominal step with the left foot on the ground; lengths in [m], times in [s]."""

    ends: tuple[tuple[float, float], tuple[float, float]]  #: CoM relative to the ZMP at start and end
    turn: float  #: Turn of the base in the step [rad]
    drop: float  #: Height of the CoM in standing less its height in the step
    rise: float  #: Amplitude of the rise of the CoM over the stance leg
    pace: Pace


class StepLoads:
    """Loads of the steps of one robot; ``part`` is the allowed part of the configured shares."""

    def __init__(self, model: RobotModel, config: GaitConfig, part: float = 1.0) -> None:
        self._model, self._config, self._data = model, config, model.data()
        self._stand = model.standing_configuration()
        self._com = np.array(pin.centerOfMass(model.pin, self._data, self._stand))
        pin.framesForwardKinematics(model.pin, self._data, self._stand)
        self._upright = self._data.oMi[1].rotation.copy()
        self._soles = [self._data.oMf[foot.frame_id].copy() for foot in model.feet]
        ankles = {joint.index_v for foot in model.feet for joint in foot.ankle}
        joints = {v for foot in model.feet for v in foot.chain_ids_v} - ankles
        self._joints = np.array(sorted(joints)) - JOINTS_V
        self._knee = max(set(model.feet[0].chain_ids_v) - ankles) - JOINTS_V  # of the stance leg
        x_min, x_max, y_min, y_max = model.feet[0].bearing
        self._zmp = 0.5 * config.zmp * np.array([x_min + x_max, y_min + y_max])  # on the sole (2,) [m]

        count = len(self._joints)
        #: Allowed shares of the torque limits of the joints, then of their speed limits (2 n,) [-]
        self.allowed = part * np.repeat([config.torque_share, config.swing.speed_share], count)
        on_the_spot = self.shares(STILL, pace_at(0.0, config.pace)._replace(crouch=0.0))
        self.weak = bool(on_the_spot[:count].max() > 1.0)  #: Whether the robot is too weak to step
        np.maximum(self.allowed, on_the_spot + _SLACK, out=self.allowed)

    def excess(self, velocity: Velocity, pace: Pace | None = None) -> tuple[float, str]:
        """Largest ratio of a share to the allowed one, and the joint with its limit; arguments as for ``shares``."""
        ratios = self.shares(velocity, pace) / self.allowed
        worst, model = int(ratios.argmax()), self._model
        fast, joint = worst >= len(self._joints), self._joints[worst % len(self._joints)]
        limit = f"{model.v_max[joint]:.3g} rad/s" if fast else f"{model.tau_max[joint]:.3g} N.m"
        return float(ratios[worst]), f"joint '{model.joint_names[joint]}' of {limit}"

    def shares(self, velocity: Velocity, pace: Pace | None = None) -> Vector:
        """Shares of torques, then speeds, in the step at a velocity (2 n,) [-]; ``pace`` None: pace of the velocity."""
        return self._shares(
            self._step(velocity, pace or pace_at(share_of(velocity, self._config.pace), self._config.pace))
        )

    def _step(self, velocity: Velocity, pace: Pace) -> Step:
        """Nominal step of a velocity; the larger one of two lateral steps."""
        config, length, wide = self._config, velocity[0] * pace.period, abs(velocity[1]) * pace.period
        half = 0.5 * float(self._soles[0].translation[1] - self._soles[1].translation[1])
        leg = config.leg
        reach = leg - math.sqrt(max(leg**2 - 0.25 * length**2 - wide**2, 0.25 * leg**2))
        most = config.rise.acceleration * (0.5 * pace.period / math.pi) ** 2
        rise = min(config.rise.share * length**2 / (16.0 * leg), most)
        ends = (-0.5 * length, -half - wide), (0.5 * length, -half)
        return Step(ends, velocity[2] * pace.period, max(pace.crouch, reach), rise, pace)

    def _shares(self, step: Step) -> Vector:
        """Shares of a step; infinite if a leg cannot reach."""
        times = np.linspace(-0.5, 0.5, _SAMPLES) * step.pace.single
        try:
            postures = self._postures(step, times)
        except RobotModelError:
            return np.full(2 * len(self._joints), math.inf)
        model, data, sole = self._model.pin, self._data, self._model.feet[0].frame_id
        dt, squares = float(times[1] - times[0]), np.zeros(len(self._joints))
        rates = [pin.difference(model, *pair) / dt for pair in pairwise(postures)]
        for q, before, after in zip(postures[1:-1], rates[:-1], rates[1:], strict=True):
            force = pin.rnea(model, data, q, 0.5 * (before + after), (after - before) / dt)
            pin.computeJointJacobians(model, data, q)
            pin.updateFramePlacements(model, data)
            jacobian = pin.getFrameJacobian(model, data, sole, pin.LOCAL)
            wrench = np.linalg.solve(jacobian[:, :JOINTS_V].T, force[:JOINTS_V])
            torques = (force - jacobian.T @ wrench)[JOINTS_V:]
            wrench[3:5] = wrench[2] * np.array([self._zmp[1], -self._zmp[0]])
            torques[self._knee] = force[JOINTS_V + self._knee] - jacobian[:, JOINTS_V + self._knee] @ wrench
            squares += (torques / self._model.tau_max)[self._joints] ** 2 / len(rates[1:])
        speeds = np.array(rates)[:, JOINTS_V:][:, self._joints] / self._model.v_max[self._joints]
        shares: Vector = np.sqrt(np.concatenate([squares, np.mean(speeds**2, axis=0)]))
        return shares

    def _postures(self, step: Step, times: Vector) -> list[Vector]:
        """Configurations at times relative to the middle of a step."""
        model, pace, foot = self._model, step.pace, self._model.feet[0]
        zmp = self._soles[0].translation[:2] + self._zmp
        omega, (first, last) = math.sqrt(GRAVITY / (self._com[2] - step.drop)), np.array(step.ends)
        end, postures = 0.5 * omega * pace.single, [self._stand]
        for t in times.tolist():
            mean, way = 0.5 * (last + first), 0.5 * (last - first)
            place = zmp + mean * math.cosh(omega * t) / math.cosh(end) + way * math.sinh(omega * t) / math.sinh(end)
            height = self._com[2] - step.drop + step.rise * math.cos(2.0 * math.pi * t / pace.period)
            swing, share = self._swing(step, t / pace.single + 0.5)
            q, yaw = postures[-1].copy(), pin.exp3(np.array([0.0, 0.0, step.turn * (share - 0.5)]))
            q[3:7] = pin.Quaternion(yaw @ self._upright).coeffs()
            q[:3] = np.array([*place, height]) + yaw @ (self._stand[:3] - self._com)
            q = pose_foot(model, self._data, q, foot, self._soles[0])
            postures.append(pose_foot(model, self._data, q, model.feet[1], swing))
        return postures[1:]

    def _swing(self, step: Step, s: float) -> tuple[pin.SE3, float]:
        """Pose of the swing foot at a share ``s`` of its time, and share of its path."""
        (first, last), effort = np.array(step.ends), step.pace.least_effort
        way = effort * s**2 * (3.0 - 2.0 * s) + (1.0 - effort) * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        place = self._soles[0].translation[:2] + 2.0 * (first + way * (last - first))
        lift = step.pace.clearance * math.sin(math.pi * s) ** 2
        yaw = pin.exp3(np.array([0.0, 0.0, step.turn * (2.0 * way - 1.0)]))
        place = np.array([*place, self._soles[1].translation[2] + lift])
        return pin.SE3(yaw @ self._soles[1].rotation, place), way


def _ahead(model: RobotModel, config: GaitConfig) -> GaitConfig:
    """Gait with the ZMP as far ahead as the crouch requires, at most in the middle of the sole."""

    def at(back: float) -> GaitConfig:
        return replace(config, zmp=back * config.zmp + (1.0 - back))

    slow = pace_at(0.0, config.pace)
    return at(_largest(lambda back: StepLoads(model, at(back), _CROUCH).excess(STILL, slow)[0], 1.0, 0.0))


def within_legs(model: RobotModel, config: GaitConfig) -> GaitConfig:
    """Gait with ZMP, crouch and velocity limits within the limits of the robot's legs."""
    config = _ahead(model, config)
    loads = StepLoads(model, config, _CROUCH)

    def crouch(pace: Pace) -> float:
        return _largest(lambda depth: loads.excess(STILL, pace._replace(crouch=depth))[0], pace.crouch, 0.0)

    slow, fast = (crouch(pace_at(share, config.pace)) for share in (0.0, 1.0))
    strides = replace(config.pace.slow, crouch=slow), replace(config.pace.fast, crouch=fast)
    config = replace(config, pace=replace(config.pace, slow=strides[0], fast=strides[1]))
    loads, limits = StepLoads(model, config), {}
    for name, (forward, left, turn) in _WAYS.items():

        def excess(speed: float, forward: float = forward, left: float = left, turn: float = turn) -> float:
            return loads.excess((speed * forward, speed * left, speed * turn))[0]

        most = float(getattr(config.velocity, name))
        limits[name] = STANDSTILL if loads.weak else _largest(excess, most, STANDSTILL)
    if loads.weak or any(foot.free[NORMAL] for foot in model.feet):
        limits["turn"] = STANDSTILL
    velocity = replace(config.velocity, **limits)
    route = {name: min(getattr(config.route, name), getattr(velocity, name)) for name in ("forward", "lateral", "turn")}
    return replace(config, velocity=velocity, route=replace(config.route, **route))


def _largest(excess: Callable[[float], float], most: float, least: float) -> float:
    """Largest value up to ``most`` whose ``excess`` is at most one; ``least`` if there is none."""
    if excess(most) <= 1.0:
        return most
    low, high = least, most
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(middle) <= 1.0 else (low, middle)
    return low


def leg_limits(model: RobotModel, config: GaitConfig) -> dict[str, str]:
    """Texts about the joints or legs that limit crouch and velocities of a gait, by name of the limit."""
    loads, slow = StepLoads(model, config), pace_at(0.0, config.pace)
    deeper = slow._replace(crouch=slow.crouch + _DEEPER)
    tried = {"crouch": StepLoads(model, config, _CROUCH).excess(STILL, deeper)}
    for name, (forward, left, turn) in _WAYS.items():
        speed = _BEYOND * float(getattr(config.velocity, name))
        tried[name] = loads.excess((speed * forward, speed * left, speed * turn))
    found = {name: limit for name, (excess, limit) in tried.items() if excess > 1.0}
    if any(foot.free[NORMAL] for foot in model.feet):
        found["turn"] = "the legs, which do not turn their soles about the vertical"
    return found
