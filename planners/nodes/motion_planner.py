"""Node ``motion_planner``: plans joint trajectories for motion names and poses."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory as JointTrajectoryMsg

from models.config import default_config
from models.errors import CommandError, MessageError, PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.messages import JointStateCodec, head_from_message, trajectory_to_message
from models.nodes.odometry import OdometryCodec
from models.nodes.parameters import declare, declare_config
from models.nodes.qos import EVENT, LATCHED, SENSOR
from models.nodes.services import Owed, offer_own, serve_later
from models.nodes.spin import program
from models.status import MotionState, MotionStatus
from models.trajectory import thin
from models.types import JointTrajectory, Mode, Vector
from planners.goals import frame_named, planted_target
from planners.library import calibration_motions, motion_files, variant
from planners.motion import MotionPlanner
from planners.motion_config import MotionConfig

#: Longest wait for the controller's status of a trajectory [s]; one refused during another one gets no status
BEGIN_TIMEOUT = 2.0
LOOK_PERIOD = 0.05  #: Period at which that wait is checked [s]
REST_TIMEOUT = 1.0  #: Longest wait of a requested motion for a posture at rest [s]
REST_SPEED = 1e-3  #: Largest joint speed of a posture at rest [rad/s]


class MotionService:
    """Service that plans with ``MotionPlanner.plan_pose`` for a robot in mode ``stand``.

    ``posture`` returns the reference posture of the controller (nj,) [rad]; ``MessageError`` before the first one.
    ``publish`` publishes on ``motion/joint_trajectory``. ``points_max`` limits the points of each trajectory.
    """

    def __init__(
        self,
        node: PoiseNode,
        law: MotionPlanner,
        posture: Callable[[], Vector],
        publish: Callable[[Any], None],
        points_max: int,
    ) -> None:
        self._node, self._law, self._posture, self._publish = node, law, posture, publish
        self._points_max, self._odometry = points_max, OdometryCodec()
        self._mode, self._odom = "", b""
        self._head: tuple[float, float] | None = None
        self._owed: tuple[Owed, Any] | None = None
        self._until = 0.0
        node.listen(String, topics.MODE, self._on_mode, LATCHED)
        node.listen_status(MotionStatus, topics.MOTION_STATUS, self._on_status)
        node.listen(Odometry, topics.ODOM, self._on_odom, SENSOR, raw=True)
        node.listen(JointState, topics.HEAD_STATE, self._on_head, SENSOR)
        node.own(node.destroy_timer, node.every(LOOK_PERIOD, self._look))
        offer_own(node, "PlanMotion", topics.PLAN_MOTION, self._on_call, serve_later)

    def _on_call(self, request: Any, response: Any) -> Any:
        try:
            trajectory = self._plan(request)
        except PoiseError as error:
            self._node.refuse(topics.PLAN_MOTION, error)
            response.success, response.message = False, str(error)
            return response
        response.trajectory = trajectory_to_message(thin(trajectory, self._points_max))
        response.success, response.message = True, f"{request.frame} reaches the target in {trajectory.times[-1]:.2f} s"
        if not request.execute:
            return response
        self._publish(response.trajectory)
        self._owed, self._until = (Owed(), response), time.monotonic() + BEGIN_TIMEOUT
        return self._owed[0]

    def _plan(self, request: Any) -> JointTrajectory:
        if not self._node.active:
            raise CommandError("the motion planner is not active")
        if self._mode != Mode.STAND.value:
            mode = self._mode or "unknown"
            raise CommandError(f"no plans in mode '{mode}', the robot must stand: first poise mode stand")
        if self._owed is not None:
            raise CommandError("another plan is about to be executed; try again")
        frame, pose, joints = frame_named(request.frame), request.target.pose, self._posture()
        turn = np.array([getattr(pose.orientation, axis) for axis in "xyzw"])
        if not request.use_orientation and not np.array_equal(turn, (0.0, 0.0, 0.0, 1.0)):
            raise CommandError("target: an orientation is given, but use_orientation is false")
        place = np.array([getattr(pose.position, axis) for axis in "xyz"])
        base = self._odometry.decode(self._odom)[1] if self._odom else None
        model = self._node.model
        target = planted_target(model, self._seen(joints), request.target.header.frame_id, place, turn, base)
        return self._law.plan_pose(
            frame,
            target.translation,
            pin.Quaternion(target.rotation).coeffs() if request.use_orientation else None,
            start_q=joints,
            duration=request.duration if request.duration != 0.0 else None,
        )

    def _seen(self, joints: Vector) -> Vector:
        """Posture with the measured head angles (nj,) [rad].

        The start of a plan excludes the offsets of ``head/pan_tilt``. A target in a frame of the head, such as a
        camera, needs them.
        """
        head = self._node.model.profile.head
        if head is None or self._head is None:
            return joints
        seen = joints.copy()
        seen[[self._node.model.joint_index(name) for name in (head.pan, head.tilt)]] = self._head
        return seen

    def _on_head(self, message: Any) -> None:
        self._head = head_from_message(message)

    def _on_mode(self, message: String) -> None:
        self._mode = message.data

    def _on_odom(self, data: bytes) -> None:
        self._odom = data

    def _on_status(self, status: MotionStatus) -> None:
        """Answer with the controller's result; its status has no request for a trajectory of this service."""
        if status.state is MotionState.RUNNING:
            self._answer("")
        elif status.state is MotionState.REFUSED and not status.request:
            self._answer(f"refused by the controller: {status.reason}")

    def _look(self) -> None:
        if self._owed is not None and time.monotonic() > self._until:
            self._answer("the controller did not confirm the trajectory")

    def _answer(self, problem: str) -> None:
        if self._owed is None:
            return
        (owed, response), self._owed = self._owed, None
        if problem:
            self._node.refuse(topics.PLAN_MOTION, problem)
            response.success, response.message = False, problem
        owed.answer(response)


class MotionPlannerNode(PoiseNode):
    """Runs ``MotionPlanner`` on request, starting from the reference posture that the controller publishes.

    If the posture still moves, for example after a stop, the motion is planned once the posture is at rest.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("motion_planner", **kwargs)
        self._config = declare_config(self, default_config(MotionConfig, "planners", "motion"))
        text = "Maximum number of points of a published trajectory; a longer one is thinned, to limit its decoding time"
        self._points_max = declare(self, "points_max", 600, text, integer=(2, 100000))
        text = "Folder of further motion files (*.yaml); empty: none"
        self._folder = declare(self, "motions_folder", "", text)

    def configure(self) -> None:
        own = motion_files(Path(self._folder)) if self._folder else ()
        self._law = MotionPlanner(self.model, self._config, extra=[*calibration_motions(), *own])
        self._codec = JointStateCodec(self.model)
        self._posture: Vector | None = None
        self._stamp, self._moving = 0, False  # of that posture [ns]
        self._request, self._until = "", 0  # motion that waits for a posture at rest, until a stamp [ns]
        self._trajectory = self.announce(JointTrajectoryMsg, topics.MOTION_TRAJECTORY, EVENT)
        self._plan_state = self.announce(String, topics.MOTION_PLAN_STATE, EVENT)
        self._publish_status = self.announce_status(topics.MOTION_STATUS)
        self.listen(String, topics.MOTION_REQUEST, self._on_request, EVENT, while_active=True)
        self.listen(JointState, topics.POSTURE, self._on_posture, SENSOR, raw=True)
        MotionService(self, self._law, self._start, self._trajectory.publish, self._points_max)

    def before_diagnostics(self) -> None:
        if self.active:
            self.message = f"motions: {', '.join(self._law.names)}"

    def _on_posture(self, data: bytes) -> None:
        self._stamp, self._posture, speed, _ = self._codec.decode(data)
        self._moving = bool(np.abs(speed).max() > REST_SPEED)
        self._plan_at_rest()

    def _start(self) -> Vector:
        """Start posture of a plan (nj,) [rad]; ``MessageError`` before the first one is received."""
        if self._posture is None:
            raise MessageError("no posture of the controller was received, which plans start from")
        return self._posture

    def _on_request(self, message: String) -> None:
        self._request = "" if message.data == topics.STOP_MOTION else message.data
        self._until = self._stamp + round(REST_TIMEOUT * 1e9)
        self._plan_at_rest()

    def _plan_at_rest(self) -> None:
        """Plan the pending motion once the posture is at rest or the wait is over."""
        if self._request and self.active and not (self._moving and self._stamp < self._until):
            self._plan(self._request)

    def _plan(self, request: str) -> None:
        """Plan; answers contain the request, so that the sender can discard the answer to an older one."""
        self._request = ""
        try:
            motion = variant(request.partition(" ")[0], self.model.name, self._law.names)
            planned = self._law.plan_sized(motion, start_q=self._start())
        except PoiseError as error:
            refusal = MotionStatus(MotionState.REFUSED, request, str(error))
            self._publish_status(refusal)
            self._plan_state.publish(String(data=str(refusal)))
            self.refuse(topics.MOTION_REQUEST, error)
            return
        self.values["last plan"] = request
        trajectory = planned.trajectory
        if planned.reduced:
            self._publish_status(MotionStatus(MotionState.REDUCED, request, planned.reduced))
        size = f"{trajectory.times[-1]:.1f} s, {len(trajectory.times)} points"
        self.get_logger().info(f"planned {request}: {', '.join(filter(None, (size, planned.reduced)))}")
        answer = trajectory_to_message(thin(trajectory, self._points_max))
        answer.header.frame_id = request
        self._trajectory.publish(answer)


main = program(MotionPlannerNode)


if __name__ == "__main__":
    main()
