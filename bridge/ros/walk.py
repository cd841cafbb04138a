"""Walks a running robot on ``cmd_vel`` for a time, as a joystick would."""

from __future__ import annotations

import time

from geometry_msgs.msg import Twist

from bridge.ros.client import Client
from models.errors import CommandError
from models.nodes import topics
from models.nodes.qos import COMMAND
from models.nodes.velocity import Velocity, velocity_from_twist, velocity_to_twist
from models.types import CommandReply, Mode

PERIOD = 0.05
"""Time between two velocities: ten fit into the time after which the robot stops [s]."""

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
    reply = client.trigger("mode/stand")
    if not reply.accepted:
        return reply
    stands = client.wait(lambda: client.mode == Mode.STAND.value, STANDSTILL_TIMEOUT)
    return CommandReply(stands, f"walked for {seconds:g} s; mode '{client.mode}'")
