"""Identifies the payload of a running robot that stands still, from joint states and IMU."""

from typing import Any

import numpy as np
from sensor_msgs.msg import Imu, JointState

from bridge.driver.foot_load import identify
from bridge.ros.client import Client
from models.errors import CommandError
from models.nodes import topics
from models.nodes.qos import SENSOR_QUEUE
from models.profile import Payload
from models.robot_model import RobotModel
from models.types import Mode, SensorData

SAMPLES_MIN = 100  #: Minimum number of messages of each topic for an identification
ARRIVAL = 10.0  #: Longest wait for the first messages [s]


def identify_payload(client: Client, model: RobotModel, seconds: float) -> Payload:
    """Identify the payload from means over a time [s]; see ``bridge.driver.foot_load.identify``.

    Raises:
        PoiseError: The robot does not stand, moves, or publishes too little.
    """
    joints: list[Any] = []
    imu: list[Any] = []
    listen = client.node.create_subscription
    listen(JointState, topics.JOINT_STATES, joints.append, SENSOR_QUEUE)
    listen(Imu, topics.IMU_RAW, imu.append, SENSOR_QUEUE)
    client.expect(lambda: bool(joints and imu), ARRIVAL, "messages on", f"{topics.JOINT_STATES} and {topics.IMU_RAW}")
    _require_standing(client)
    joints.clear()
    imu.clear()
    client.spin(seconds)
    _require_standing(client)
    if min(len(joints), len(imu)) < SAMPLES_MIN:
        raise CommandError(
            f"identify: {len(joints)} joint states and {len(imu)} IMU messages in {seconds:g} s; {SAMPLES_MIN} of each "
            f"are needed: give more --seconds"
        )
    q, v, tau = (
        model.reorder(joints[0].name, np.mean([getattr(each, field) for each in joints], axis=0))
        for field in ("position", "velocity", "effort")
    )
    gyro, accel = (
        np.mean([[part.x, part.y, part.z] for part in parts], axis=0)
        for parts in ([each.angular_velocity for each in imu], [each.linear_acceleration for each in imu])
    )
    return identify(model, SensorData(0.0, q, v, tau, gyro, accel, np.full((2, 6), np.nan)))


def _require_standing(client: Client) -> None:
    if (client.mode, client.driver_state) != (Mode.STAND, topics.ACTIVE):
        raise CommandError(
            f"identify: mode '{client.mode}', drivers '{client.driver_state}': the robot must stand by itself, without "
            f"a motion"
        )
