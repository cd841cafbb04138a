"""Trajectories as users publish them, and the joint angles that follow from them."""

from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from models.nodes.messages import JointStateCodec, set_stamp
from models.robot_model import RobotModel
from tests.ros.conftest import Eyes


def point(names: list[str], positions: list[float], seconds: float, frame_id: str = "") -> JointTrajectory:
    """One point, due after a time [s]."""
    message = JointTrajectory(joint_names=names, points=[JointTrajectoryPoint(positions=positions)])
    set_stamp(message.points[0].time_from_start, round(1e9 * seconds))
    message.header.frame_id = frame_id
    return message


def arm(eyes: Eyes, g1: RobotModel, joint: str) -> float:
    """Reference angle of a joint [rad]."""
    return float(JointStateCodec(g1).decode(eyes.posture)[1][g1.joint_index(joint)])
