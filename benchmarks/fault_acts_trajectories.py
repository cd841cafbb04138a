"""Joint trajectories that no robot must execute: the controller and the drivers, each by itself, must refuse them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from benchmarks.fault_doing import Act, Doing, asked
from bridge.closed_loop import ClosedLoop
from models.robot_model import RobotModel
from models.types import CommandReply, JointTrajectory

Spoil = Callable[[JointTrajectory, RobotModel], JointTrajectory]
"""Makes of a trajectory that holds the posture one that must be refused."""


def _given(spoil: Spoil) -> Act:
    def act(loop: ClosedLoop) -> Doing:
        posture = loop.controller.reference.posture
        held = JointTrajectory(loop.robot.joint_names, np.array([0.5, 1.0]), np.array([posture, posture]))
        wrong = spoil(held, loop.robot)
        for door in (loop.controller.follow, lambda given: loop.drivers.command_trajectory(given, loop.t)):
            reply = asked(lambda: door(wrong))  # noqa: B023  # called at once
            if reply.accepted:
                yield CommandReply(False, "executed")
                return
        yield reply

    return act


def _unknown_joint(held: JointTrajectory, robot: RobotModel) -> JointTrajectory:
    return replace(held, joint_names=("tail_joint", *held.joint_names[1:]))


def _joint_twice(held: JointTrajectory, robot: RobotModel) -> JointTrajectory:
    return replace(held, joint_names=(held.joint_names[1], *held.joint_names[1:]))


def _nan(held: JointTrajectory, robot: RobotModel) -> JointTrajectory:
    held.positions[1, 0] = np.nan
    return held


def _outside(held: JointTrajectory, robot: RobotModel) -> JointTrajectory:
    held.positions[:, 0] = robot.q_upper[0] + 0.1  # [rad]
    return held


def _too_fast(held: JointTrajectory, robot: RobotModel) -> JointTrajectory:
    velocities = np.zeros_like(held.positions)
    velocities[0, 0] = 2.0 * robot.v_max[0]
    return replace(held, velocities=velocities)


def _jump(held: JointTrajectory, robot: RobotModel) -> JointTrajectory:
    return replace(held, times=np.array([0.0, 1.0]), positions=0.5 * (held.positions + robot.q_upper))


def _points(count: int) -> Spoil:
    def spoil(held: JointTrajectory, robot: RobotModel) -> JointTrajectory:
        return replace(
            held, times=1.0 + np.arange(count, dtype=np.float64), positions=np.tile(held.positions[:1], (count, 1))
        )

    return spoil


def _times(*times: float) -> Spoil:
    return lambda held, robot: replace(held, times=np.array(times))


TRAJECTORIES: Mapping[str, Act] = {
    "trajectory_unknown_joint": _given(_unknown_joint),
    "trajectory_joint_twice": _given(_joint_twice),
    "trajectory_nan": _given(_nan),
    "trajectory_equal_times": _given(_times(0.5, 0.5)),
    "trajectory_times_back": _given(_times(1.0, 0.5)),
    "trajectory_past": _given(_times(-2.0, -1.0)),
    "trajectory_begun": _given(_times(-0.5, 0.5)),
    "trajectory_outside": _given(_outside),
    "trajectory_too_fast": _given(_too_fast),
    "trajectory_jump": _given(_jump),
    "trajectory_empty": _given(_points(0)),
    "trajectory_of_100000": _given(_points(100_000)),
}
"""By the name that a row gives them."""
