"""Longer requests to a running robot: walks at a velocity or to a pose, and reaching."""

import math
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial

from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.time import Time
from std_msgs.msg import Float64

from bridge.ros.client import LIMITING, Client, next_step, open_locks
from bridge.ros.environment import ignore, newest
from bridge.ros.namespace import in_namespace
from controllers.commands.arbitration import NO_SOURCE, PLAIN
from models.errors import CommandError, MessageError
from models.nodes import topics
from models.nodes.interfaces import interface
from models.nodes.odometry import velocity_from_twist, velocity_to_twist
from models.nodes.qos import COMMAND, EVENT, SENSOR
from models.nodes.services import PACKAGE
from models.nodes.status import subscribe_status
from models.status import MotionState, MotionStatus, RouteState, RouteStatus
from models.types import CommandReply, Mode, Velocity
from planners.gait.footsteps import Foothold
from planners.nodes.footstep_messages import foothold_from_pose, pose_message

PERIOD = 0.05  #: Period of velocity messages [s], a tenth of the command timeout of the robot
ANSWER_TIMEOUT = 5.0  #: Longest wait for a subscriber, and for the answer to a repeated request [s]
STEP_TIMEOUT = 2.0  #: Longest mean time of a footstep [s]; start and end of a walk count as footsteps
RESET_TIMEOUT = 60.0  #: Longest wait until the robot stands after a reset [s]
STAND_PERIOD = 2.0  #: Time between two requests to stand after a reset [s]
STANDSTILL_TIMEOUT = 10.0  #: Longest wait for mode 'stand' after the last velocity [s]
REPORT_PERIOD = 5.0  #: Time between two reports on the way to a goal [s]
LATE = 0.3  #: Longest wait for the mode, and its reasons, after the end of a motion or a walk [s]
SILENCE = 5.0  #: Time without odometry after which a request ends [s]


class RobotClock:
    """Time of the robot, simulated or real: the newest stamp of the odometry."""

    def __init__(self, client: Client) -> None:
        here = partial(client.node.count_publishers, topics.ODOM)
        client.expect(lambda: here() > 0, ANSWER_TIMEOUT, "publisher on", topics.ODOM)
        self._client, self._now, self._received = client, math.nan, time.monotonic()
        self._newest: Odometry | None = None
        name = f"{client.node.get_name()}_clock"
        self._node = Node(name, context=client.node.context, **in_namespace(client.namespace))  # not spun
        self._odometry = self._node.create_subscription(Odometry, topics.ODOM, ignore, SENSOR, raw=True)
        client.wait(lambda: self.now() > -math.inf, math.inf)

    def now(self) -> float:
        """Newest stamp [s], NaN before the first; ``CommandError`` after ``SILENCE`` without a message."""
        if (data := newest(self._odometry)) is not None:
            message = deserialize_message(data, Odometry)
            self._now, self._received = 1e-9 * Time.from_msg(message.header.stamp).nanoseconds, time.monotonic()
            self._newest = message
        elif time.monotonic() - self._received > SILENCE:
            why = self._client.paused or "poise status shows the state of the robot"
            raise CommandError(f"no message on {topics.ODOM} for {SILENCE:g} s: {why}")
        return self._now

    def base(self) -> Foothold | None:
        """Pose of the base in ``odom``; None without a valid message."""
        try:
            return self._newest and foothold_from_pose(topics.ODOM, self._newest.pose.pose)
        except MessageError:
            return None

    def place(self) -> str:
        """Pose of the base in ``odom`` as text; empty without a valid message."""
        base = self.base()
        return f"; base at x {base.x:.2f} m, y {base.y:.2f} m, heading {base.yaw:.2f} rad" if base else ""

    def wait(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Like ``Client.wait``, with a ``timeout`` in robot time [s]."""
        end = self.now() + timeout
        return self._client.wait(lambda: condition() or self.now() > end, math.inf) and condition()


@contextmanager
def _stand_after_interrupt(client: Client) -> Iterator[None]:
    """Request mode stand when Ctrl-C interrupts a walk, which would continue to its goal."""
    try:
        yield
    except KeyboardInterrupt:
        client.trigger("mode/stand", at_once=True)
        raise


def walk(client: Client, velocity: Velocity, seconds: float) -> CommandReply:
    """Request mode walk, publish a velocity for ``seconds`` of robot time, stop, and wait until the robot stands.

    ``velocity`` is forward [m/s], left [m/s], turn [rad/s]. A hold ends the walk. The reply is accepted when the robot
    followed the velocity at the end of the whole time, was not blocked by the ground, and stands again. Raises
    ``CommandError`` for a velocity that is not finite, without a subscriber or an answer, and when the robot time
    stands still.
    """
    if not all(map(math.isfinite, velocity)):
        raise CommandError(f"velocity {velocity}: forward [m/s], left [m/s] and turn [rad/s] must be finite")
    message = velocity_to_twist(velocity)
    clock = RobotClock(client)
    followed: list[bool] = []  # whether the supervisor passes a nonzero velocity to the gait
    listen = client.node.create_subscription
    listen(Twist, topics.GAIT_VELOCITY, lambda m: followed.append(any(velocity_from_twist(m))), COMMAND)
    reply = client.trigger("mode/walk")
    if not reply.accepted:
        return reply
    publisher = client.node.create_publisher(Twist, topics.CMD_VEL, COMMAND)

    def ready() -> bool:
        known = client.gait is not None and bool(followed)
        return publisher.get_subscription_count() > 0 and client.mode == Mode.WALK.value and known

    def follows() -> bool:
        return client.commander == PLAIN and (followed[-1] or not any(velocity))

    client.expect(ready, ANSWER_TIMEOUT, "subscriber in mode 'walk' on", topics.CMD_VEL)
    end, first = clock.now() + seconds, len(client.gaits) - 1  # index of the status at the begin
    with _stand_after_interrupt(client):
        while (left := end - clock.now()) > 0.0 and client.mode == Mode.WALK.value and not client.holds:
            publisher.publish(message)
            client.spin(min(PERIOD, left))
    gait = client.gait
    assert gait is not None  # ensured by ``ready``
    reports = client.gaits[first:]
    blocked = _last(f"{each.blocked} on the way" for each in reports if each.blocked)
    limit = "".join(f"; {each}" for each in (gait.limited, blocked, _last(each.unmapped for each in reports)) if each)
    ended = client.holds and f"the walk was held after {seconds - left:.1f} s: {client.holds}"
    if not ended and seconds and client.mode == Mode.WALK.value and not client.wait(follows, LIMITING):
        ended = f"the robot does not follow the velocity: {_reasons(client)}"
    if gait.blocked:
        ended = ended or f"{gait.blocked} (after {seconds:g} s)"
    stood = _stand(client, clock, ended or f"walked for {seconds:g} s{limit}")
    return CommandReply(stood.accepted and not ended, stood.reason)


def _last(texts: Iterable[str]) -> str:
    """The last of some texts that is not empty; empty without one."""
    return next(filter(None, reversed([*texts])), "")


def _reasons(client: Client) -> str:
    """Why the supervisor does not pass the velocity of this client to the gait, with the remedy."""
    status, found = client.status, []
    if client.commander not in (PLAIN, NO_SOURCE):
        found.append(f"'{client.commander}' is in command")
    if status is not None:
        found += filter(None, (open_locks(status), status.obstacle))
        if not found and status.refusal.startswith(f"{topics.CMD_VEL}: "):
            found.append(f"the supervisor refused {status.refusal}")
    topic = client.node.resolve_topic_name(topics.CMD_VEL)
    names = {end.node_name for end in client.node.get_publishers_info_by_topic(topic)} - {client.node.get_name()}
    if names:
        found.append(f"end {' and '.join(sorted(names))}, which also publishes on {topic}")
    return "; ".join(found) or "the terminal of poise up and ros2 topic echo /refusals show the reason"


def walk_to(
    client: Client,
    goal: tuple[float, float, float],
    around: bool | None = None,
    report: Callable[[str], object] | None = None,
) -> CommandReply:
    """Request mode walk, send a goal, wait until the robot has arrived, and request mode stand.

    ``goal`` is x [m], y [m] and heading [rad] of the midpoint of the soles, in ``odom``. The reply is accepted when the
    robot has arrived. Unless None, ``around`` first sets the parameter of that name of the gait planner. On the way
    ``report`` receives the distance from the goal, every ``REPORT_PERIOD``. Raises ``CommandError`` for a goal that is
    not finite, and without a subscriber or an answer.
    """
    if not all(map(math.isfinite, goal)):
        raise CommandError(f"goal {goal}: x [m], y [m] and heading [rad] must be finite")
    if around is not None:
        client.set_parameter("gait_planner", "around", around)
    clock = RobotClock(client)
    routes: list[RouteStatus] = []
    margins: list[float] = []
    subscribe_status(client.node, RouteStatus, topics.ROUTE_STATUS, routes.append)
    listen = client.node.create_subscription
    listen(Float64, topics.GAIT_CAPTURE_MARGIN, lambda message: margins.append(message.data), SENSOR)
    reply = client.trigger("mode/walk")
    if not reply.accepted:
        return reply
    publisher = client.node.create_publisher(PoseStamped, topics.GOAL_POSE, EVENT)
    message = pose_message(Foothold(*goal), topics.ODOM_FRAME)
    margins.clear()

    def begun() -> bool:  # the planner publishes its margin once it controls the robot
        return publisher.get_subscription_count() > 0 and client.mode == Mode.WALK.value and bool(margins)

    reported = time.monotonic()

    def arrived() -> bool:
        nonlocal reported
        if report is not None and time.monotonic() > reported + REPORT_PERIOD and (base := clock.base()) is not None:
            reported = time.monotonic()
            report(f"{math.hypot(goal[0] - base.x, goal[1] - base.y):.2f} m from the goal")
        return routes[-1].state is not RouteState.RUNNING

    client.expect(begun, ANSWER_TIMEOUT, "subscriber in mode 'walk' on", topics.GOAL_POSE)
    end, before = time.monotonic() + ANSWER_TIMEOUT, len(client.gaits)
    with _stand_after_interrupt(client):
        while not routes and time.monotonic() < end:
            publisher.publish(message)
            client.wait(lambda: bool(routes), 1.0)
        if not routes:
            return CommandReply(False, f"no answer on {topics.ROUTE_STATUS}; mode '{client.mode}'")
        clock.wait(arrived, (routes[-1].footsteps + 5) * STEP_TIMEOUT)
    done = routes[-1].state is RouteState.DONE
    if not done:  # the cause may be reported later
        client.wait(lambda: bool(client.obstacle), LATE)
    why = f"; {client.obstacle}" if client.obstacle and not done else ""
    if remark := _last(each.unmapped for each in client.gaits[before:]):
        why += f"; {remark}"
    stood = _stand(client, clock, f"goal x {goal[0]:.2f} m, y {goal[1]:.2f} m: {routes[-1]}{why}")
    return CommandReply(stood.accepted and done, stood.reason)


def reset(client: Client) -> CommandReply:
    """Put a simulated robot back on its feet at its start, and wait until it stands; ``CommandError`` on hardware."""
    try:
        reply = client.trigger("reset")
    except CommandError as error:
        if client.status is None:  # no robot is up
            raise
        raise CommandError(f"{error}; it is for simulated robots only: lift a real robot with its gantry") from error
    if not reply.accepted:
        return reply
    client.wait(lambda: client.driver_state == topics.HELD, ANSWER_TIMEOUT)
    end = time.monotonic() + RESET_TIMEOUT
    while time.monotonic() < end:
        if client.wait(lambda: client.mode == Mode.STAND.value and client.driver_state == topics.ACTIVE, STAND_PERIOD):
            return CommandReply(True, "the robot stands at its start")
        reply = client.trigger("mode/stand")  # needed without auto_stand; refused until preflight has passed
    state = f"mode '{client.mode}', drivers '{client.driver_state}'"
    return CommandReply(False, state) if reply.accepted else reply


def _stand(client: Client, clock: RobotClock, outcome: str) -> CommandReply:
    if client.mode != Mode.WALK.value:
        return CommandReply(False, f"the walk was {_end_of_walk(client)}; mode '{client.mode}'")
    reply = client.trigger("mode/stand")
    if not reply.accepted:
        return reply
    if clock.wait(lambda: client.mode == Mode.STAND.value, STANDSTILL_TIMEOUT):
        return CommandReply(True, f"{outcome}{clock.place()}; mode '{client.mode}'")
    return CommandReply(
        False, f"{outcome}, but the robot does not stand {STANDSTILL_TIMEOUT:g} s later: mode '{client.mode}'"
    )


def _end_of_walk(client: Client) -> str:
    """Cause of the end of a walk that this client did not end, with the remedy."""
    current = client.wait(client.status_is_current, LATE)
    if client.holds:
        return f"held: {client.holds}"
    if client.status is None or not current or not client.status.faults:
        return "ended by another client"
    return "; ".join((f"ended: {', '.join(client.status.faults)}", next_step(client.status)))


PLAN_TIMEOUT = 30.0  #: Longest wait for a plan [s]
END_TIMEOUT = 10.0  #: Longest wait for the end of the motion after the planned time, in robot time [s]


def reach(
    client: Client,
    frame: str,
    position: tuple[float, float, float],
    *,
    frame_id: str,
    duration: float = 0.0,
    execute: bool = True,
) -> CommandReply:
    """Request a plan from ``plan_motion``, execute it, and wait until the frame has arrived.

    ``frame``, or an alias such as ``left_hand``, is moved to ``position`` (3,) [m] in ``frame_id`` within ``duration``
    [s]; 0 means as fast as the joints allow. The reply is accepted when the motion was planned and, with ``execute``,
    played to its end; otherwise it has the reason. Raises ``CommandError`` when the service is absent or does not
    answer, and without odometry; ``MessageError`` when the type of the service is not built.
    """
    kind = interface(PACKAGE, "srv", "PlanMotion")
    request = kind.Request(frame=frame, duration=duration, execute=execute)
    request.target.header.frame_id = frame_id
    place = request.target.pose.position
    place.x, place.y, place.z = position
    client.motions.clear()
    answer = client.call(kind, topics.PLAN_MOTION, request, answer_timeout=PLAN_TIMEOUT)
    if not answer.success or not execute:
        return CommandReply(bool(answer.success), str(answer.message))
    length = answer.trajectory.points[-1].time_from_start
    ends: list[MotionStatus] = []

    over = (MotionState.DONE, MotionState.ENDED, MotionState.REFUSED)

    def damped() -> bool:
        return client.mode in (Mode.DAMP.value, Mode.OFF.value)

    def ended() -> bool:  # a refusal with a request concerns another motion
        ends[:] = [m for m in client.motions if m.state in over and not m.request]
        return bool(ends) or damped()

    RobotClock(client).wait(ended, length.sec + 1e-9 * length.nanosec + END_TIMEOUT)
    if client.wait(damped, LATE if ends and ends[0].state is MotionState.ENDED else 0.0):
        client.wait(client.status_is_current, LATE)
        why = "; ".join((f"mode '{client.mode}'", *(client.status.faults if client.status else ())))
        return CommandReply(False, f"{answer.message}; ended: {why}")
    done = bool(ends) and ends[0].state is MotionState.DONE
    return CommandReply(done, f"{answer.message}; {ends[0] if ends else 'its end was not reported'}")
