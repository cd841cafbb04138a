"""Has a running robot bring a hand, or another frame of its own, to a place."""

from __future__ import annotations

import math

from bridge.ros.client import Client
from models.nodes import topics
from models.nodes.interfaces import interface
from models.nodes.own_types import PACKAGE
from models.types import CommandReply

PLAN_TIMEOUT = 30.0
"""Longest wait for a plan [s]."""

END_TIMEOUT = 10.0
"""Longest wait for the end of the motion beyond the time that it was planned for [s]."""


def reach(
    client: Client,
    frame: str,
    position: tuple[float, float, float],
    *,
    frame_id: str,
    duration: float = 0.0,
    execute: bool = True,
) -> CommandReply:
    """Ask ``plan_motion`` for a plan, have it executed, and wait until the frame is there.

    Args:
        client: Talks to the robot.
        frame: Frame that is moved, or what people call it, such as ``left_hand``.
        position: Where to (3,) [m].
        frame_id: Frame that this is given in.
        duration: Time to get there [s]; 0: as short as the joints allow.
        execute: Whether the robot moves.

    Returns:
        Whether the motion was planned and played to its end, and what happened.

    Raises:
        CommandError: The service is absent, or does not answer.
        MessageError: Its type is not built.
    """
    kind = interface(PACKAGE, "srv", "PlanMotion")
    request = kind.Request(frame=frame, duration=duration, execute=execute)
    request.target.header.frame_id = frame_id
    place = request.target.pose.position
    place.x, place.y, place.z = position
    client.motion_states.clear()
    answer = client.call(kind, topics.PLAN_MOTION, request, answer_timeout=PLAN_TIMEOUT)
    if not answer.success or not execute:
        return CommandReply(bool(answer.success), str(answer.message))
    end = answer.trajectory.points[-1].time_from_start
    states = client.motion_states
    done = client.wait(lambda: topics.MOTION_DONE in states, math.ceil(end.sec + 1e-9 * end.nanosec) + END_TIMEOUT)
    return CommandReply(done, f"{answer.message}; {topics.MOTION_DONE if done else 'its end was not heard of'}")
