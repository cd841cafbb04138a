"""Load on the feet of a robot at rest, from its joint torques and gravity; its mass and CoM from that load."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from controllers.safety.health import tilt
from models.constants import GRAVITY
from models.errors import MessageError
from models.robot_model import RobotModel
from models.types import SensorData, Vector


class FootLoad:
    """Force on each foot: J' f = g(q) - tau over the joints of its leg, for a leg of six joints at rest.

    Roll and pitch of the base follow from the accelerometer. Dry friction of the joints is an error of a few newtons.
    Forward and left are those of the base.
    """

    def __init__(self, model: RobotModel) -> None:
        self._model, self._data = model, model.data()
        self._weight = GRAVITY * model.mass
        self._q = np.zeros(model.nq)
        imu = model.pin.frames[model.frame_id("imu")]
        self._imu_rotation = imu.placement.rotation.copy()  # of the IMU in the base, where it sits on the base
        if imu.parentJoint != 1:
            self._imu_rotation = np.eye(3)
        self.load = 0.0  #: Sum over both feet as a share of the weight [-]
        self.tilt = 0.0  #: Of the base from upright [rad]
        #: Of the robot at rest, from the CoM of the model to the CoP, forward and left [m]
        self.com_offset = np.zeros(2)

    def update(self, sensors: SensorData) -> None:
        """Compute ``load`` and ``tilt``; NaN where a measurement is missing."""
        up = self._imu_rotation @ sensors.accel  # in B
        length = float(np.linalg.norm(up))
        if not (np.isfinite(sensors.q).all() and np.isfinite(sensors.tau).all() and length > 0.0):
            self.load = self.tilt = float("nan")
            self.com_offset = np.full(2, np.nan)
            return
        model = self._model
        upright = pin.Quaternion.FromTwoVectors(up / length, np.array([0.0, 0.0, 1.0]))
        self._q[3:7], self._q[7:] = upright.coeffs(), sensors.q
        self.tilt = tilt(self._q[3:7])
        gravity = pin.computeGeneralizedGravity(model.pin, self._data, self._q)  # (nv,)
        pin.computeJointJacobians(model.pin, self._data, self._q)
        pin.updateFramePlacements(model.pin, self._data)
        force, moment = 0.0, np.zeros(2)
        for foot in model.feet:
            wrench = self._wrench(foot.frame_id, list(foot.joint_ids_v), gravity, sensors)
            place = self._data.oMf[foot.frame_id].translation
            force += float(wrench[2])
            moment += wrench[2] * place[:2] + (-wrench[4], wrench[3])
        self.load = force / self._weight
        com = pin.centerOfMass(model.pin, self._data, self._q)
        self.com_offset = np.full(2, np.nan)
        if force > 0.0:
            self.com_offset = moment / force - com[:2]

    def _wrench(self, frame: int, leg: list[int], gravity: Vector, sensors: SensorData) -> Vector:
        """Wrench of the ground on a foot at the sole's origin, in axes of the world (6,) [N, N.m]."""
        world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        jacobian = pin.getFrameJacobian(self._model.pin, self._data, frame, world)[:, leg]  # (6, 6)
        residual = gravity[leg] - sensors.tau[np.array(leg) - 6]
        wrench: Vector = np.linalg.lstsq(jacobian.T, residual, rcond=1e-3)[0]
        return wrench


class Identified(NamedTuple):
    """What a robot at rest weighs, and where."""

    mass: float  #: True minus model [kg]
    com: Vector  #: True minus model CoM, forward and left of the base (2,) [m]


def identify(model: RobotModel, samples: Sequence[SensorData]) -> Identified:
    """Differences of mass and horizontal CoM from the model, of a robot that stands still on both feet.

    The load is the weight and the CoP is below the CoM, both from the joint torques as ``FootLoad`` computes them;
    means of the samples. On a simulated G1 with a load at the torso the errors are 0.25 kg and 2 mm, and with encoder
    offsets of up to 20 mrad 0.7 kg and 6 mm. The legs must have the masses of the model: with all masses 10 % larger,
    0.9 of 3.3 kg are not found.
    ``MessageError`` without samples, or when one of them is not finite.
    """
    load, found = FootLoad(model), np.zeros((len(samples), 3))
    for row, sample in zip(found, samples, strict=True):
        load.update(sample)
        row[0], row[1:] = load.load, load.com_offset
    if not len(samples) or not np.isfinite(found).all():
        raise MessageError("identify: needs samples of a robot that stands on its feet, with torques and accelerometer")
    share, forward, left = found.mean(axis=0)
    return Identified(model.mass * (float(share) - 1.0), np.array([forward, left]))
