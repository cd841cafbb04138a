"""Load on the feet of a robot at rest, from its joint torques and the direction of gravity."""

import numpy as np
import pinocchio as pin

from controllers.safety.health import tilt
from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import SensorData, Vector


class FootLoad:
    """Vertical force on each foot: J' f = g(q) - tau over the joints of its leg, for a leg of six joints at rest.

    Roll and pitch of the base follow from the accelerometer. Dry friction of the joints is an error of a few newtons.
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

    def update(self, sensors: SensorData) -> None:
        """Compute ``load`` and ``tilt``; NaN where a measurement is missing."""
        up = self._imu_rotation @ sensors.accel  # in B
        length = float(np.linalg.norm(up))
        if not (np.isfinite(sensors.q).all() and np.isfinite(sensors.tau).all() and length > 0.0):
            self.load = self.tilt = float("nan")
            return
        model = self._model
        upright = pin.Quaternion.FromTwoVectors(up / length, np.array([0.0, 0.0, 1.0]))
        self._q[3:7], self._q[7:] = upright.coeffs(), sensors.q
        self.tilt = tilt(self._q[3:7])
        gravity = pin.computeGeneralizedGravity(model.pin, self._data, self._q)  # (nv,)
        pin.computeJointJacobians(model.pin, self._data, self._q)
        pin.updateFramePlacements(model.pin, self._data)
        self.load = sum(self._force(foot.frame_id, list(foot.joint_ids_v), gravity, sensors) for foot in model.feet)
        self.load /= self._weight

    def _force(self, frame: int, leg: list[int], gravity: Vector, sensors: SensorData) -> float:
        world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        jacobian = pin.getFrameJacobian(self._model.pin, self._data, frame, world)[:, leg]  # (6, 6)
        residual = gravity[leg] - sensors.tau[np.array(leg) - 6]
        wrench, *_ = np.linalg.lstsq(jacobian.T, residual, rcond=1e-3)
        return float(wrench[2])
