"""Walks a running robot: on ``cmd_vel`` for a time, as a joystick would, or to a pose, as a navigation stack would."""

from __future__ import annotations

import time

from geometry_msgs.msg import PoseStamped, Twist
from std_msgs.msg import Float64, String

from bridge.ros.client import Client
from models.errors import CommandError
from models.nodes import topics
from models.nodes.qos import COMMAND, EVENT, SENSOR
from models.nodes.velocity import Velocity, velocity_from_twist, velocity_to_twist
from models.types import CommandReply, Mode
from planners.gait.footsteps import Foothold
from planners.nodes.footstep_messages import pose_message

PERIOD = 0.05
"""Time between two velocities: ten fit into the time after which the robot stops [s]."""

ANSWER_TIMEOUT = 5.0
"""Longest wait for the answer to a goal, which is sent again every second [s]."""

STEP_TIMEOUT = 2.0
"""Longest wait for one footstep, on average, and for the start and the end of a walk [s]."""

STANDSTILL_TIMEOUT = 10.0
"""Longest wait for mode 'stand' after the last velocity [s]."""


def walk(client: Client, velocity: Velocity, seconds: float) -> CommandReply:
    """Request mode walk, repeat a velocity for a time, stop, and wait until the robot stands.

    Args:
        client: Talks to the robot.
        velocity: Forward [m/s], left [m/s], turn [rad/s].
        seconds: How long [s].

    Returns:
        Whether the robot stands again, and what happened.

    Raises:
        CommandError: Nobody listens, or a service does not answer.
        MessageError: A velocity is not finite.
    """
    message = velocity_to_twist(velocity)
    velocity_from_twist(message)
    reply = client.trigger("mode/walk")
    if not reply.accepted:
        return reply
    publisher = client.publisher(Twist, topics.CMD_VEL, COMMAND)
    if not client.wait(lambda: publisher.get_subscription_count() > 0 and client.mode == Mode.WALK.value, 5.0):
        raise CommandError(f"nobody listens on {topics.CMD_VEL}: is the robot up? start it with: poise up")
    end = time.monotonic() + seconds
    while time.monotonic() < end and client.mode == Mode.WALK.value:
        publisher.publish(message)
        client.spin(min(PERIOD, max(end - time.monotonic(), 0.0)))
    if client.mode != Mode.WALK.value:
        return CommandReply(False, f"the walk was ended from elsewhere: mode '{client.mode}'")
    return _stand(client, f"walked for {seconds:g} s")


def walk_to(client: Client, goal: tuple[float, float, float]) -> CommandReply:
    """Request mode walk, send a goal, wait until the robot is there, and have it stand.

    Args:
        client: Talks to the robot.
        goal: x [m], y [m] and heading [rad] of the middle between the soles, in ``odom``.

    Returns:
        Whether the robot got there, and what happened.

    Raises:
        CommandError: Nobody listens, or a service does not answer.
    """
    words: list[str] = []
    margins: list[float] = []
    client.subscribe(String, topics.GAIT_ROUTE, lambda message: words.append(message.data), EVENT)
    client.subscribe(Float64, topics.GAIT_CAPTURE_MARGIN, lambda message: margins.append(message.data), SENSOR)
    reply = client.trigger("mode/walk")
    if not reply.accepted:
        return reply
    publisher = client.publisher(PoseStamped, topics.GOAL_POSE, EVENT)
    message = pose_message(Foothold(*goal), topics.ODOM_FRAME)
    margins.clear()

    def begun() -> bool:  # the planner tells its margin once it has taken over the robot
        return publisher.get_subscription_count() > 0 and client.mode == Mode.WALK.value and bool(margins)

    if not client.wait(begun, ANSWER_TIMEOUT):
        raise CommandError(f"nobody listens on {topics.GOAL_POSE}: is the robot up? start it with: poise up")
    end = time.monotonic() + ANSWER_TIMEOUT
    while not words and time.monotonic() < end:
        publisher.publish(message)
        client.wait(lambda: bool(words), 1.0)
    if not words:
        return CommandReply(False, f"no answer on {topics.GAIT_ROUTE}; mode '{client.mode}'")
    word, _, more = words[-1].partition(": ")
    if word == topics.ROUTE_RUNNING:
        steps = int(more.split()[0]) if more.split()[0].isdecimal() else 0
        client.wait(lambda: not words[-1].startswith(topics.ROUTE_RUNNING), (steps + 5) * STEP_TIMEOUT)
    if client.mode != Mode.WALK.value:
        return CommandReply(False, f"the walk was ended from elsewhere: mode '{client.mode}'")
    stood = _stand(client, f"goal {words[-1]}")
    return CommandReply(stood.accepted and words[-1] == topics.ROUTE_DONE, stood.reason)


def _stand(client: Client, told: str) -> CommandReply:
    """Have a walking robot come to a standstill."""
    reply = client.trigger("mode/stand")
    if not reply.accepted:
        return reply
    stands = client.wait(lambda: client.mode == Mode.STAND.value, STANDSTILL_TIMEOUT)
    return CommandReply(stands, f"{told}; mode '{client.mode}'")
