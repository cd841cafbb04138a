"""Motions of known truth: a robot that sways, is pushed and lifts a foot, and what its sensors say.

The motions are made with Pinocchio alone: a base trajectory, legs by inverse kinematics, and sensors from their
definitions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pinocchio as pin

from controllers.estimation.estimator import StateEstimator
from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import RobotState, SensorData

DT, FREE_FALL = 0.001, np.array([0.0, 0.0, -GRAVITY])
PUSH_AT, LIFT_AT, END = 1.0, 1.8, 3.2
LIFT_TIME, LIFT_HEIGHT, STRIDE = 0.6, 0.05, 0.03
PUSH_SPEED, PUSH_TIME, RETURN_TIME = 0.4, 0.1, 0.12


@dataclass(eq=False)
class Motion:
    """Truth and exact sensors, one row per tick."""

    q: np.ndarray
    v: np.ndarray
    gyro: np.ndarray
    accel: np.ndarray
    wrenches: np.ndarray

    def __len__(self) -> int:
        return len(self.q)

    def held(self, n: int) -> Motion:
        """The first tick, n times over."""
        columns = (self.q, self.v, self.gyro, self.accel, self.wrenches)
        return Motion(*(np.repeat(column[:1], n, axis=0) for column in columns))


def bump(t: np.ndarray, start: float, duration: float) -> np.ndarray:
    """0 before, (1 - cos) / 2 twice over in between, 0 after."""
    phase = np.clip((t - start) / duration, 0.0, 1.0)
    return 0.5 * (1.0 - np.cos(2.0 * np.pi * phase))


def base_motion(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Displacement (n, 3) and rotation vector (n, 3) of the base: sway, a push in x and y, then a shift to the left.

    The push takes the base to 0.4 m/s in 0.1 s, and a critically damped motion takes it back.
    """
    impulse = np.where(t >= PUSH_AT, (t - PUSH_AT) * np.exp(-np.maximum(t - PUSH_AT, 0.0) / RETURN_TIME), 0.0)
    window = round(PUSH_TIME / DT)
    push = PUSH_SPEED * np.convolve(impulse, np.full(window, 1.0 / window))[: t.size]
    sway = bump(t, 0.3, END - 0.3) * np.sin(2.0 * np.pi * 0.8 * t)
    shift = np.column_stack([0.8 * push, 0.6 * push, 0.01 * sway - 0.015 * bump(t, 0.3, END - 0.3)])
    turn = np.column_stack([0.04 * sway, 0.05 * sway + 0.8 * push, 0.03 * sway])
    return shift, turn


def solve_legs(robot: RobotModel, data: pin.Data, q: np.ndarray, soles: list[pin.SE3]) -> None:
    """Newton steps of both legs until the soles are where they should be; in place."""
    for _ in range(4):
        pin.computeJointJacobians(robot.pin, data, q)
        pin.updateFramePlacements(robot.pin, data)
        for foot, sole in zip(robot.feet, soles, strict=True):
            error = pin.log6(data.oMf[foot.frame_id].actInv(sole)).vector
            jacobian = pin.getFrameJacobian(robot.pin, data, foot.frame_id, pin.LOCAL)[:, foot.joint_ids_v]
            q[np.asarray(foot.joint_ids_v) + 1] += np.linalg.solve(jacobian, error)


@cache
def motion(robot: RobotModel) -> Motion:
    """The whole motion, on flat feet; the right one is lifted once and set down further ahead."""
    t = np.arange(0.0, END + 2 * DT, DT)
    n, data = t.size, robot.data()
    shift, turn = base_motion(t)
    lift = LIFT_HEIGHT * bump(t, LIFT_AT, LIFT_TIME)
    phase = np.clip((t - LIFT_AT) / LIFT_TIME, 0.0, 1.0)
    stride = STRIDE * (phase - np.sin(2.0 * np.pi * phase) / (2.0 * np.pi))
    start = robot.standing_configuration()
    pin.framesForwardKinematics(robot.pin, data, start)
    homes = [data.oMf[foot.frame_id].copy() for foot in robot.feet]
    q, v = np.zeros((n, robot.nq)), np.zeros((n, robot.nv))
    poses: list[pin.SE3] = []
    now = start.copy()
    arms = [j for j in range(robot.nj) if not any(j + 6 in foot.joint_ids_v for foot in robot.feet)]
    for k in range(n):
        now[:3] = start[:3] + shift[k]
        now[3:7] = pin.Quaternion(pin.exp3(turn[k])).coeffs()
        now[7 + np.array(arms)] = start[7 + np.array(arms)] + 0.1 * np.sin(3.0 * t[k]) * bump(t[k : k + 1], 0.3, END)
        right = homes[1].copy()
        right.translation = homes[1].translation + np.array([stride[k], 0.0, lift[k]])
        solve_legs(robot, data, now, [homes[0], right])
        q[k] = now
        pin.framesForwardKinematics(robot.pin, data, now)
        poses.append(data.oMf[robot.frame_id("imu")].copy())
    for k in range(1, n - 1):
        v[k] = pin.difference(robot.pin, q[k - 1], q[k + 1]) / (2.0 * DT)
    gyro, accel, velocity = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
    for k in range(1, n - 1):
        gyro[k] = pin.log3(poses[k - 1].rotation.T @ poses[k + 1].rotation) / (2.0 * DT)
        velocity[k] = (poses[k + 1].translation - poses[k - 1].translation) / (2.0 * DT)
    for k in range(1, n - 1):
        middle = poses[k - 1].rotation @ pin.exp3(0.5 * pin.log3(poses[k - 1].rotation.T @ poses[k].rotation))
        accel[k] = middle.T @ ((velocity[k] - velocity[k - 1]) / DT - FREE_FALL)
    share = 0.5 * (1.0 - np.clip(np.minimum(t - (LIFT_AT - 0.1), LIFT_AT + LIFT_TIME + 0.1 - t) / 0.1, 0.0, 1.0))
    wrenches = np.zeros((n, 2, 6))
    wrenches[:, 0, 2] = (1.0 - share) * robot.mass * GRAVITY
    wrenches[:, 1, 2] = share * robot.mass * GRAVITY
    return Motion(q[1:-1], v[1:-1], gyro[1:-1], accel[1:-1], wrenches[1:-1])


@cache
def torques_of(robot: RobotModel, truth: Motion) -> np.ndarray:
    """Joint torques of the motion under its foot wrenches (n, nj); whatever else holds the base takes the rest."""
    data, n = robot.data(), len(truth)
    acceleration = np.gradient(truth.v, DT, axis=0) if n > 1 else np.zeros_like(truth.v)
    torques = np.empty((n, robot.nv))
    for k in range(n):
        torques[k] = pin.rnea(robot.pin, data, truth.q[k], truth.v[k], acceleration[k])
        pin.computeJointJacobians(robot.pin, data, truth.q[k])
        for foot, wrench in zip(robot.feet, truth.wrenches[k], strict=True):
            torques[k] -= pin.getFrameJacobian(robot.pin, data, foot.frame_id, pin.LOCAL).T @ wrench
    return torques[:, 6:]


def sensors_of(robot: RobotModel, truth: Motion, seed: int | None) -> list[SensorData]:
    """What the robot's sensors say, with the profile's noise; exact when ``seed`` is None."""
    n, nj, profile = len(truth), robot.nj, robot.profile.sensors
    scale = 0.0 if seed is None else 1.0
    rng = np.random.default_rng(seed)
    resolution = profile.encoders.resolution
    q = truth.q[:, 7:] if seed is None else np.rint(truth.q[:, 7:] / resolution) * resolution
    v = truth.v[:, 6:] + scale * profile.encoders.velocity_noise * rng.normal(size=(n, nj))
    gyro = truth.gyro + scale * profile.imu.gyro_bias * rng.normal(size=3)
    gyro = gyro + scale * profile.imu.gyro_noise_density / np.sqrt(DT) * rng.normal(size=(n, 3))
    accel = truth.accel + scale * profile.imu.accel_bias * rng.normal(size=3)
    accel = accel + scale * profile.imu.accel_noise_density / np.sqrt(DT) * rng.normal(size=(n, 3))
    wrenches = truth.wrenches + scale * profile.feet.force_noise * rng.normal(size=(n, 2, 6))
    tau = torques_of(robot, truth).copy()
    return [SensorData(k * DT, q[k], v[k], tau[k], gyro[k], accel[k], wrenches[k]) for k in range(n)]


def run(estimator: StateEstimator, sensors: list[SensorData]) -> list[RobotState]:
    return [estimator.reset(sensors[0])] + [estimator.step(sample, DT) for sample in sensors[1:]]


def robot_of(estimator: StateEstimator) -> RobotModel:
    return estimator.robot  # type: ignore[attr-defined, no-any-return]


def between(start: float, end: float) -> slice:
    return slice(round(start / DT), round(end / DT))
