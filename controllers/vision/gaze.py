"""Head angles that point the camera at a target in its image."""

from collections import deque

import numpy as np
import pinocchio as pin

from models.errors import ConfigError
from models.profile import CAMERA_FRAME
from models.robot_model import RobotModel
from models.types import Vector

STEPS = 8  #: Largest number of iterations [1]; two to four are enough within half a turn of the head
STEP_MAX = 0.6  #: Largest step of a joint [rad], within which the linearisation holds
DONE = 1e-6  #: Step below which the iteration ends [rad]


class Gaze:
    r"""Computes pan and tilt that align the optical axis with a bearing.

    .. math::
        \min_q \| e_3 \times R(q)^T R(q_0)\, b \|, \quad q = (\mathrm{pan}, \mathrm{tilt})

    by Gauss-Newton steps on the robot's kinematics, for any order and mounting of the joints. Only directions are used.
    The camera is offset from the axes of the head, so a near target is centred only after several images. Raises
    ``ConfigError`` when the robot has no head, or when a head joint does not move the camera.
    """

    def __init__(self, model: RobotModel) -> None:
        head = model.profile.head
        if head is None:
            raise ConfigError(f"{model.name}: head: the profile names no joints of pan and tilt")
        self._model, self._data = model.pin, model.data()
        self._frame = model.frame_id(CAMERA_FRAME)
        joints = [model.joint_index(name) for name in (head.pan, head.tilt)]
        self._q: Vector = pin.neutral(model.pin)
        self._places = [7 + joint for joint in joints]
        self._columns = [6 + joint for joint in joints]
        carriers = set(model.pin.supports[model.pin.frames[self._frame].parentJoint])
        for name, joint in zip((head.pan, head.tilt), joints, strict=True):
            if joint + 2 not in carriers:
                raise ConfigError(f"{model.name}: frame '{CAMERA_FRAME}' is not moved by joint '{name}' of the head")
        self._low, self._high = model.q_lower[joints], model.q_upper[joints]

    def aim(self, pan: float, tilt: float, bearing: Vector) -> tuple[float, float]:
        """Angles [rad] that best point the camera along a bearing (3,), given in the optical frame at pan and tilt."""
        angles = np.array([pan, tilt])
        target = self._axes(angles) @ bearing
        for _ in range(STEPS):
            rotation = self._axes(angles)
            pin.computeJointJacobians(self._model, self._data, self._q)
            jacobian = pin.getFrameJacobian(self._model, self._data, self._frame, pin.LOCAL_WORLD_ALIGNED)
            axis = rotation[:, 2]
            turns = np.cross(jacobian[3:, self._columns].T, axis).T  # (3, 2), derivative of the axis by each joint
            step, *_ = np.linalg.lstsq(turns, target - axis * (axis @ target), rcond=None)
            before = angles
            angles = np.clip(angles + np.clip(step, -STEP_MAX, STEP_MAX), self._low, self._high)
            if np.abs(angles - before).max() < DONE:
                break
        return float(angles[0]), float(angles[1])

    def _axes(self, angles: Vector) -> Vector:
        """Axes of the camera (3, 3) at head angles (2,) [rad]."""
        self._q[self._places] = angles
        pin.framesForwardKinematics(self._model, self._data, self._q)
        rotation: Vector = self._data.oMf[self._frame].rotation.copy()
        return rotation


class AngleHistory:
    """Keeps the newest 100 stamped angles and interpolates between them."""

    def __init__(self) -> None:
        self._samples: deque[tuple[int, float, float]] = deque(maxlen=100)

    def add(self, stamp: int, pan: float, tilt: float) -> None:
        """Store pan and tilt [rad] at a stamp [ns]; a stamp older than the newest clears the history."""
        if self._samples and stamp <= self._samples[-1][0]:
            self._samples.clear()
        self._samples.append((stamp, pan, tilt))

    def at(self, stamp: int, tolerance: int) -> Vector | None:
        """Pan and tilt (2,) [rad] at a stamp [ns]; None when no sample is within a tolerance [ns] of the stamp."""
        if not self._samples:
            return None
        stamps = [sample[0] for sample in self._samples]
        if min(abs(stamp - each) for each in stamps) > tolerance:
            return None
        since = [float(each - stamps[0]) for each in stamps]
        angles = [np.interp(float(stamp - stamps[0]), since, column) for column in zip(*self._samples, strict=True)]
        return np.array(angles[1:])
