"""Joint setpoints from a plain publisher, and hands that get where they were planned to, while the robot stands."""

import math
from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

from bridge.closed_loop import ClosedLoop
from models.types import JointTrajectory, Vector
from planners.goals import planted_target
from planners.motion import MotionPlanner

JOINT = "left_shoulder_pitch_joint"
PERIOD = 0.02
"""Of the publisher [s]."""

STEP_MAX = 0.08
"""Largest step of a torque in a millisecond, share of its limit [-]; the sensors' noise alone makes 0.045."""


class Stream:
    """A loop whose joint gets a setpoint 50 times a second.

    Args:
        setpoint: Position [rad] and velocity [rad/s] from the present position at a time [s].
        lead: Time in which each point is to be reached [s].
        velocities: Whether setpoints have them, too.
    """

    def __init__(self, setpoint: Callable[[float], tuple[float, float]], lead: float, *, velocities: bool) -> None:
        self.loop = loop = ClosedLoop("g1", seed=0, record=False)
        loop.run(0.5)
        self.index = loop.robot.joint_index(JOINT)
        self.middle = float(loop.controller.reference.posture[self.index])
        self._setpoint, self._lead, self._velocities = setpoint, lead, velocities
        self.torques: list[Vector] = []
        self.joint: list[float] = []

    def run(self, seconds: float, *, publish: bool = True) -> None:
        """Publish and look, tick by tick."""
        for tick in range(round(1e3 * seconds)):
            if publish and tick % round(1e3 * PERIOD) == 0:
                q, v = self._setpoint(1e-3 * tick + self._lead)
                point = np.array([[self.middle + q]])
                speed = np.array([[v]]) if self._velocities else None
                self.loop.controller.follow(JointTrajectory((JOINT,), np.array([self._lead]), point, speed))
            self.loop.run(0.001)
            self.torques.append(self.loop.data.qfrc_actuator[6:].copy())
            self.joint.append(float(self.loop.truth.q[7 + self.index]) - self.middle)

    @property
    def largest_step(self) -> float:
        """Largest step of a torque in a millisecond, share of its limit [-]."""
        return float((np.abs(np.diff(self.torques, axis=0)) / self.loop.robot.tau_max).max())


def test_stand_brings_back_a_leg_that_was_moved_alone() -> None:
    loop = ClosedLoop("g1", seed=0, record=False)
    loop.run(0.5)
    stand = loop.robot.posture("stand")
    bent = stand[[loop.robot.joint_index("left_knee")]] + 0.5
    loop.controller.follow(JointTrajectory(("left_knee_joint",), np.array([1.5]), bent[None]))
    loop.run(2.0)
    refusal = loop.command("wave")
    assert not refusal.accepted and "send 'stand' first" in refusal.reason
    assert loop.command("stand").accepted
    loop.run(3.0)
    assert loop.mode == "stand" and not loop.fallen
    assert loop.controller.reference.posture == pytest.approx(stand, abs=1e-6)


def swing(t: float) -> tuple[float, float]:
    """Half a radian to and fro in two seconds: position [rad] and velocity [rad/s] at a time [s]."""
    return 0.25 * (math.cos(math.pi * t) - 1.0), -0.25 * math.pi * math.sin(math.pi * t)


@pytest.mark.parametrize(("lead", "velocities"), [(0.0, False), (0.02, False), (0.1, False), (0.1, True)])
def test_a_stream_of_setpoints_moves_an_arm_smoothly(lead: float, velocities: bool) -> None:
    stream = Stream(swing, lead, velocities=velocities)
    stream.run(2.0)
    expected = np.array([swing(1e-3 * (tick + 1))[0] for tick in range(2000)])
    assert np.degrees(np.abs(expected - stream.joint).max()) < 8.0
    assert np.ptp(stream.joint) > 0.4
    assert stream.largest_step < STEP_MAX
    assert not stream.loop.fallen and not stream.loop.faults and stream.loop.foot_slip.max() < 0.001


def test_a_stream_that_breaks_off_slows_down() -> None:
    stream = Stream(lambda t: (-2.0 * t, -2.0), 0.04, velocities=True)
    stream.run(0.4)
    end = stream.loop.controller.reference
    assert end.posture_velocity[stream.index] == pytest.approx(-2.0, abs=0.1)
    stream.torques.clear()
    speeds = [float(end.posture_velocity[stream.index])]
    for _ in range(6):
        stream.run(0.1, publish=False)
        speeds.append(float(stream.loop.controller.reference.posture_velocity[stream.index]))
    assert -1.9 < speeds[2] < -0.1 and speeds[-1] == 0.0  # neither at once nor never
    assert stream.largest_step < STEP_MAX and not stream.loop.controller.motion_active
    assert not stream.loop.fallen


@pytest.mark.parametrize("robot", ["g1", "talos"])
def test_a_hand_gets_to_a_place_in_odom(robot: str) -> None:
    loop = ClosedLoop(robot, seed=0, record=False)
    loop.run(0.5)
    model, data = loop.robot, loop.robot.data()

    def hand() -> Vector:
        pin.framesForwardKinematics(model.pin, data, loop.truth.q)
        return np.array(data.oMf[model.frame_id("l_wrist")].translation)

    goal = hand() + np.array([0.1, 0.05, 0.15])
    posture = loop.controller.reference.posture
    target = planted_target(model, posture, "odom", goal, (0.0, 0.0, 0.0, 1.0), loop.truth.q[:7])
    trajectory = MotionPlanner(model).plan_pose("l_wrist", target.translation, start_q=posture)
    loop.controller.follow(trajectory)
    loop.run(float(trajectory.times[-1]) + 2.0)
    assert np.linalg.norm(hand() - goal) < 0.020  # friction holds light joints where they stop: 0.013 to 0.016
    assert not loop.fallen and loop.foot_slip.max() < 0.001
