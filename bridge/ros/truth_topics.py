"""What is true of the simulated robot beside its base: joints and obstacle, for whoever draws or scores it."""

from __future__ import annotations

from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState

from bridge.mujoco_plant import MujocoPlant
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.messages import JointStateCodec, set_stamp
from models.nodes.qos import SENSOR
from models.types import RobotState


class TruthTopics:
    """Publishes ``ground_truth/joint_states`` and ``ground_truth/obstacle``, each while somebody listens.

    Args:
        node: Node that publishes.
        plant: The simulated robot.
        codec: Of joint states.
    """

    def __init__(self, node: PoiseNode, plant: MujocoPlant, codec: JointStateCodec) -> None:
        self._plant, self._codec = plant, codec
        self._joints = node.announce(JointState, topics.GROUND_TRUTH_JOINTS, SENSOR)
        self._obstacle = node.announce(PoseStamped, topics.GROUND_TRUTH_OBSTACLE, SENSOR)

    def publish(self, stamp: int, truth: RobotState) -> None:
        """Publish a true state and where the obstacle is, at a stamp [ns]; the obstacle first."""
        centre = self._plant.obstacle.centre
        if centre is not None and self._obstacle.get_subscription_count():
            message = PoseStamped()
            set_stamp(message.header.stamp, stamp)
            message.header.frame_id = topics.ODOM_FRAME
            place = message.pose.position
            place.x, place.y, place.z = centre.tolist()
            self._obstacle.publish(message)
        if self._joints.get_subscription_count():
            self._joints.publish(self._codec.encode(stamp, truth.q[7:], truth.v[6:], truth.tau))
