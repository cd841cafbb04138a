"""Joint servos that stand, and their commands."""

import numpy as np
from numpy.typing import NDArray

from controllers.joints.joint_servo import JointServo, drive_torque
from models.robot_model import RobotModel
from models.types import JointCommand

DT = 0.001
Vector = NDArray[np.float64]


def hold(model: RobotModel, q: Vector | None = None, tau: Vector | None = None) -> JointCommand:
    zero = np.zeros(model.nj)
    return JointCommand(model.posture("stand") if q is None else q, zero, zero if tau is None else tau)


def armed(model: RobotModel, t: float = -1.0, *, keep_gains: bool = False) -> tuple[JointServo, float]:
    """A servo that has been armed, commanded to stand and is past its fade-in, and the time of its next step."""
    servo = JointServo(model, keep_gains=keep_gains)
    servo.arm()
    q, zero = model.posture("stand"), np.zeros(model.nj)
    for k in range(int(servo.config.arming_blend / DT) + 2):
        servo.command(hold(model), t + k * DT)
        servo.step(t + k * DT, q, zero, DT)
    return servo, t + (k + 1) * DT


def torque_of(servo: JointServo, t: float, q: Vector, v: Vector, dt: float) -> Vector:
    """Torques of one step; those that the drives give with its command."""
    command = servo.step(t, q, v, dt)
    np.testing.assert_array_equal(drive_torque(servo.model, command, q, v), servo.torque)
    return servo.torque
