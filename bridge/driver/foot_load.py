"""Load on the feet of a robot at rest from joint torques and gravity; identification of mass and CoM from that load."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import yaml

from controllers.safety.health import tilt
from models.constants import GRAVITY
from models.errors import ConfigError, MessageError
from models.profile import Payload
from models.robot_model import RobotModel
from models.types import SensorData, Vector

AT_REST = 0.05  #: Bound of the fastest joint's mean speed for a robot that stands still [rad/s]
TORQUE_ERROR = 0.5  #: Torque error of a joint at rest: dry friction and sensor offset [N.m]
PLAUSIBLE = 0.3  #: Largest relative deviation of the load from the model's weight that may be a payload [-]


class FootLoad:
    """Force on each foot: J' f = g(q) - tau over the joints of its leg, for legs of six joints at rest.

    Roll and pitch of the base are computed from the accelerometer. Forward and left are directions of the base. A
    nearly straight leg bears a force along the leg almost without torques, so that a small torque error causes a large
    error of the load; ``error`` estimates it.
    """

    def __init__(self, model: RobotModel) -> None:
        self._model, self._data = model, model.data()
        self._weight = GRAVITY * model.mass
        self._q = np.zeros(model.nq)
        imu = model.pin.frames[model.frame_id("imu")]
        self._imu_rotation = imu.placement.rotation.copy()  # of the IMU in the base, if it is on the base
        if imu.parentJoint != 1:
            self._imu_rotation = np.eye(3)
        self.load = 0.0  #: Vertical force on both feet relative to the weight [-]
        self.error = 0.0  #: Error of ``load`` for independent errors ``TORQUE_ERROR`` of all leg joints [-]
        self.tilt = 0.0  #: Tilt of the base from upright [rad]
        #: Offset from the model's CoM to the CoP of the robot at rest, forward and left [m]
        self.com_offset = np.zeros(2)

    def update(self, sensors: SensorData) -> None:
        """Compute ``load``, its ``error`` and ``tilt``; NaN where a measurement is missing."""
        up = self._imu_rotation @ sensors.accel  # in B
        length = float(np.linalg.norm(up))
        if not (np.isfinite(sensors.q).all() and np.isfinite(sensors.tau).all() and length > 0.0):
            self.load = self.error = self.tilt = float("nan")
            self.com_offset = np.full(2, np.nan)
            return
        model = self._model
        upright = pin.Quaternion.FromTwoVectors(up / length, np.array([0.0, 0.0, 1.0]))
        self._q[3:7], self._q[7:] = upright.coeffs(), sensors.q
        self.tilt = tilt(self._q[3:7])
        gravity = pin.computeGeneralizedGravity(model.pin, self._data, self._q)  # (nv,)
        pin.computeJointJacobians(model.pin, self._data, self._q)
        pin.updateFramePlacements(model.pin, self._data)
        force, variance, moment = 0.0, 0.0, np.zeros(2)
        for foot in model.feet:
            wrench, lift = self._wrench(foot.frame_id, list(foot.joint_ids_v), gravity, sensors)
            variance += (TORQUE_ERROR * lift) ** 2
            place = self._data.oMf[foot.frame_id].translation
            force += float(wrench[2])
            moment += wrench[2] * place[:2] + (-wrench[4], wrench[3])
        self.load, self.error = force / self._weight, float(np.sqrt(variance)) / self._weight
        com = pin.centerOfMass(model.pin, self._data, self._q)
        self.com_offset = np.full(2, np.nan)
        if force > 0.0:
            self.com_offset = moment / force - com[:2]

    def _wrench(self, frame: int, leg: list[int], gravity: Vector, sensors: SensorData) -> tuple[Vector, float]:
        """Ground reaction wrench on a foot at the sole's origin, in world axes (6,) [N, N.m].

        Also returns the largest vertical force caused by joint torques of norm 1 N.m [N].
        """
        world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        jacobian = pin.getFrameJacobian(self._model.pin, self._data, frame, world)[:, leg]  # (6, 6)
        residual = gravity[leg] - sensors.tau[np.array(leg) - 6]
        inverse = np.linalg.pinv(jacobian.T, rcond=1e-3)
        return inverse @ residual, float(np.linalg.norm(inverse[2]))


def identify(model: RobotModel, mean: SensorData) -> Payload:
    """Identify the payload of a robot that stands still on both feet, from the mean of its samples over some seconds.

    ``FootLoad`` computes load and CoP from the joint torques; the load equals the weight, and the CoP is below the CoM.
    The result includes the payload of the model's profile and replaces it. On a simulated G1 with a load at the torso
    the errors are 0.25 kg and 2 mm; with encoder offsets of up to 20 mrad they are 0.7 kg and 6 mm. A bias of the
    accelerometer has the effect of a tilt: 0.05 m/s^2 cause 3 to 5 mm. The legs must have the masses of the model: if
    all masses are 10 % larger, 0.9 of 3.3 kg are not identified.

    Raises:
        MessageError: The robot moves, does not stand on its feet, or measures no torques or no acceleration.
    """
    if not np.abs(mean.v).max() < AT_REST:
        raise MessageError(f"identify: a joint turns at {np.abs(mean.v).max():.2f} rad/s: the robot must stand still")
    load, known = FootLoad(model), model.profile.payload
    load.update(mean)
    if not abs(load.load - 1.0) < PLAUSIBLE:
        raise MessageError(
            f"identify: {100.0 * load.load:.0f} % of the weight on the feet: the robot must stand, without a rope, and "
            f"measure joint torques and acceleration"
        )
    forward, left = load.com_offset
    return Payload(
        mass=known.mass + model.mass * (load.load - 1.0),
        com=(known.com[0] + float(forward), known.com[1] + float(left)),
    )


def payload_profile(extends: str, name: str, payload: Payload, file: Path | None = None) -> str:
    """Text of a profile ``name`` with a payload, which extends another profile (name or path).

    Raises:
        ConfigError: ``file``, the target of the text, is the extended profile.
    """
    if file is not None and file.resolve() == Path(extends).resolve():
        raise ConfigError(f"{file}: the result extends this profile; give the new profile another name")
    found = {"mass": round(payload.mass, 3), "com": [round(each, 4) for each in payload.com]}
    data = {"extends": extends, "name": name, "payload": found}
    about = "# Written by poise identify: mass [kg], shift of the whole robot's CoM forward and left [m]\n"
    return about + yaml.safe_dump(data, sort_keys=False)
