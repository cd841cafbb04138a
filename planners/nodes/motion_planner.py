"""Node ``motion_planner``: names of motions, or poses, in; joint trajectories out."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from models.config import default_config
from models.errors import MessageError, PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.messages import JointStateCodec, trajectory_to_message
from models.nodes.parameters import declare_config, describe
from models.nodes.qos import EVENT, SENSOR
from models.nodes.spin import run
from models.trajectory import thin
from models.types import Vector
from planners.calibration_motions import calibration_motions, variant
from planners.library import motion_files
from planners.motion import MotionPlanner
from planners.motion_config import MotionConfig
from planners.nodes.motion_service import MotionService


class MotionPlannerNode(PoiseNode):
    """Runs ``MotionPlanner`` on request, from the reference posture that the controller publishes.

    Args:
        kwargs: Passed to rclpy.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("motion_planner", **kwargs)
        self._config = declare_config(self, default_config(MotionConfig, "planners", "motion"))
        text = "Points of a published trajectory, whose reader has a tick to keep; a longer one is thinned"
        points = self.declare_parameter("points_max", 600, describe(text, integer=(2, 100000)))
        self._points_max = int(points.value)
        text = "Folder of motion files (*.yaml) of the user's own, beside the packaged ones; empty: none"
        self._folder = str(self.declare_parameter("motions_folder", "", describe(text)).value)

    def configure(self) -> None:
        """Build the law and the topics."""
        own = motion_files(Path(self._folder)) if self._folder else ()
        self._law = MotionPlanner(self.model, self._config, extra=[*calibration_motions(), *own])
        self._codec = JointStateCodec(self.model)
        self._posture: Vector | None = None
        self._trajectory = self.announce(JointTrajectory, topics.MOTION_TRAJECTORY, EVENT)
        self._plan_state = self.announce(String, topics.MOTION_PLAN_STATE, EVENT)
        self.listen(String, topics.MOTION_REQUEST, self._on_request, EVENT)
        self.listen(JointState, topics.POSTURE, self._on_posture, SENSOR, raw=True)
        MotionService(self, self._law, self._start, self._trajectory.publish, self._points_max)

    def before_diagnostics(self) -> None:
        """Say what can be asked for."""
        if self.active:
            self.message = f"motions: {', '.join(self._law.names)}"

    def _on_posture(self, data: bytes) -> None:
        try:
            self._posture = self._codec.decode(data)[1]
        except PoiseError as error:
            self.refuse(topics.POSTURE, error)

    def _start(self) -> Vector:
        """Posture that plans start from (nj,) [rad]; raises ``MessageError`` before the first."""
        if self._posture is None:
            raise MessageError("no posture of the controller has arrived to start from")
        return self._posture

    def _on_request(self, message: String) -> None:
        """Plan; answers carry the request, so that who asks can tell an overtaken one."""
        if not self.active or message.data == topics.STOP_MOTION:
            return
        try:
            motion = variant(message.data.partition(" ")[0], self.model.name, self._law.names)
            trajectory = self._law.plan(motion, start_q=self._start())
        except PoiseError as error:
            self.refuse(topics.MOTION_REQUEST, error)
            self._plan_state.publish(String(data=f"{topics.MOTION_REFUSED}: {message.data}: {error}"))
            return
        self.values["last plan"] = message.data
        self.get_logger().info(f"planned {message.data}: {trajectory.times[-1]:.1f} s, {len(trajectory.times)} points")
        answer = trajectory_to_message(thin(trajectory, self._points_max))
        answer.header.frame_id = message.data
        self._trajectory.publish(answer)


def main(args: list[str] | None = None) -> None:
    """Run the node in a process of its own."""
    sys.exit(run([MotionPlannerNode], args))


if __name__ == "__main__":
    main()
