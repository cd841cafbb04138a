"""Commands and velocities of all sources: arbitration, and the velocity of the gait."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

from geometry_msgs.msg import Twist, TwistStamped
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Bool, Empty, String

from controllers.commands.arbitration import PLAIN, Arbiter, ArbitrationConfig
from controllers.commands.command_signature import Verifier
from controllers.commands.obstacle_stop import ObstacleStop
from controllers.nodes.health_topics import HealthTopics
from controllers.safety.supervisor import Supervisor
from models.errors import CommandError, MessageError, PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS
from models.nodes.messages import stamp_ns
from models.nodes.odometry import require_base_frame, velocity_from_twist, velocity_to_twist
from models.nodes.perception import scan_from_message
from models.nodes.qos import COMMAND, EVENT, LATCHED, SENSOR
from models.status import RouteState, RouteStatus
from models.types import STILL, CommandReply, Mode, Velocity

VELOCITY = "velocity "  #: Prefix of a text command with a velocity
STOP = "stop"  #: Command that every source may send at any time


def velocity_from_words(text: str) -> Velocity:
    """Parse ``velocity FORWARD LEFT TURN`` [m/s, m/s, rad/s]; ``CommandError`` unless three finite numbers."""
    try:
        forward, left, turn = (float(value) for value in text.split()[1:])
    except ValueError:
        raise CommandError(f"{text[:40]!r} is not 'velocity FORWARD LEFT TURN'") from None
    if not all(math.isfinite(value) for value in (forward, left, turn)):
        raise CommandError(f"{text[:40]!r} is not finite")
    return forward, left, turn


class CommandTopics:
    """Receives commands of all sources, passes them to the supervisor, and repeats the velocity in force.

    Each source has a topic for text commands and one for velocities. ``humanoid_commands`` (also ``text_command``),
    ``cmd_vel`` and ``cmd_vel_stamped`` belong to the source ``plain``. In mode ``walk`` every ``publish`` repeats the
    velocity, zero included; without it the gait stops. ``law`` decides whether a velocity starts a walk.

    With a key, all text commands but ``stop`` must be signed (``controllers/commands/command_signature.py``). The
    signature determines the source on any topic, and velocities are sent as the text ``velocity FORWARD LEFT TURN``.
    ``verifier`` is None for unsigned commands; ``obstacles`` limits the velocity, disabled when None; ``reply`` is
    called with topic and answer.
    """

    def __init__(
        self,
        node: PoiseNode,
        config: ArbitrationConfig,
        law: Supervisor,
        reports: HealthTopics,
        reply: Callable[[str, CommandReply], None],
        obstacles: ObstacleStop | None = None,
        verifier: Verifier | None = None,
    ) -> None:
        self._node, self._law, self._reports, self._on_reply = node, law, reports, reply
        self._arbiter, self._verifier = Arbiter(config), verifier
        self._obstacles, self._obstacle, self._on_the_way = obstacles, "", False
        if obstacles is not None:
            ScanTopic(node, obstacles, lambda: reports.t)
        self._speaker, self._commander = PLAIN, ""
        self._last_stamp = 0
        self._newest = dict.fromkeys(config.sources, -math.inf)  # time of each source's newest velocity [s]
        self._t = 0.0  # newest time [s]
        self._walking = False
        self._velocity = node.announce(Twist, topics.GAIT_VELOCITY, COMMAND)
        self._stop = node.announce(Empty, topics.GAIT_STOP, EVENT)
        self._commander_topic = node.announce(String, topics.COMMANDER, LATCHED)
        for source in config.sources:
            *words, velocity = (
                (topics.HUMANOID_COMMANDS, topics.TEXT_COMMAND, topics.CMD_VEL)
                if source == PLAIN
                else topics.source_topics(source)
            )
            for word in words:
                node.listen(String, word, partial(self._on_word, source, word), EVENT, while_active=True)
            node.listen(Twist, velocity, partial(self._repeat, source, velocity), COMMAND, while_active=True)
        node.listen(TwistStamped, topics.CMD_VEL_STAMPED, self._on_stamped, COMMAND, while_active=True)
        for name in config.locks:
            node.listen(Bool, f"{topics.LOCKS}/{name}", partial(self._on_lock, name), EVENT)
        node.listen_status(RouteStatus, topics.ROUTE_STATUS, self._on_route)

    def values(self) -> dict[str, str]:
        """Items for the diagnostics."""
        return {
            "in command": self._arbiter.in_command(self._reports.t),
            "locks": ", ".join(self.locks) or "none",
            "obstacles": self._obstacle or ("none in the way" if self._obstacles is not None else "not watched"),
        }

    @property
    def locks(self) -> tuple[str, ...]:
        """Names of the closed locks."""
        return self._arbiter.locks(self._reports.t)

    @property
    def obstacle(self) -> str:
        """Limit of the walk by an obstacle; empty if none."""
        return self._obstacle if self._walking else ""

    def take(self) -> None:
        """Apply a velocity or a standstill that a text command has requested."""
        velocity = self._law.take_velocity()
        if velocity is None:
            return
        if any(velocity):
            self._arbiter.hold(self._speaker, velocity)
        else:
            self._arbiter.forget()
            self._stop.publish(Empty())

    def publish(self) -> None:
        """Repeat the velocity while the robot walks, and publish a change of the commanding source."""
        t, walking = self._now(), self._law.mode is Mode.WALK
        if walking:
            self._velocity.publish(velocity_to_twist(self._allowed(t)))
            if not (self._on_the_way or self._reports.gait_active or any(self._arbiter.velocity(t))):
                self._law.rest()
        elif self._walking:
            self._arbiter.forget()
        self._walking = walking
        commander = self._arbiter.in_command(t)
        if commander != self._commander:
            self._commander = commander
            self._commander_topic.publish(String(data=commander))

    def _now(self) -> float:
        """Time [s]; discards earlier commands when ``/clock`` starts or goes back, as with a new plant."""
        t = self._reports.t
        if t < self._t or not self._t:
            self._arbiter.restart()
            self._newest = dict.fromkeys(self._newest, t)  # a continued stream is not fresh
            self._last_stamp = 0
        self._t = t
        return t

    def _allowed(self, t: float) -> Velocity:
        """Commanded velocity, limited by holds and obstacles; ends a walk to a goal that is held or blocked."""
        velocity = STILL if self._law.still else self._arbiter.velocity(t)
        if self._on_the_way and self._law.still:
            self._end_walk()
        if self._obstacles is None:
            return velocity
        before, desired = self._obstacle, self._reports.walking_velocity if self._on_the_way else velocity
        allowed, self._obstacle = self._obstacles.limit(desired, t)
        if self._obstacle != before:
            self._node.get_logger().info(f"obstacles: {self._obstacle or 'none in the way'}")
        if not self._on_the_way:
            return allowed
        if not any(allowed[:2]) and any(desired[:2]):
            self._end_walk()
        return velocity

    def _end_walk(self) -> None:
        """End a walk to a goal."""
        self._on_the_way = False
        self._stop.publish(Empty())

    def reply(self, source: str, topic: str, text: str) -> CommandReply:
        """Answer a text command from a topic or a service, and pass the reply to the node, which logs it."""
        try:
            reply = self._answer(source, text)
        except PoiseError as error:
            reply = CommandReply(False, str(error))
        self._on_reply(topic, reply)
        return reply

    def _on_word(self, source: str, topic: str, message: Any) -> None:
        self.reply(source, topic, message.data)

    def _answer(self, source: str, text: str) -> CommandReply:
        """Answer a text command; ``PoiseError`` if its source may not command, or without a valid signature."""
        t = self._reports.t
        if text.strip().lower() != STOP:
            if self._verifier is not None:
                command = self._verifier.verify(text)
                source, text = command.source, command.text
            if text.startswith(VELOCITY):
                velocity = velocity_from_words(text)
                self._drive(source, topics.GAIT_VELOCITY, velocity)
                return CommandReply(True, f"velocity {velocity}")
            self._arbiter.require(source, t)
        self._speaker = source
        reply = self._law.text(text)
        if reply.accepted:
            self._arbiter.executed(source, t)
        return reply

    def _drive(self, source: str, topic: str, velocity: Velocity) -> None:
        """Accept a velocity of a source; ``CommandError`` if it is refused."""
        t, law, mode = self._now(), self._law, self._law.mode
        walking, moving = mode is Mode.WALK, any(velocity)
        fresh = t - self._newest[source] > self._arbiter.config.sources[source].timeout or not moving
        self._newest[source] = t
        if walking and not law.barred(source, fresh=fresh):
            self._arbiter.repeat(source, velocity, t)
            moving = any(self._arbiter.velocity(t))
        elif moving:
            self._arbiter.require(source, t)
        reply = law.drive(moving, fresh=fresh, source=source)
        if not reply.accepted:
            raise CommandError(reply.reason)
        if law.mode is not mode:
            self._arbiter.repeat(source, velocity, t)
            self._on_reply(topic, reply)

    def _on_stamped(self, message: Any) -> None:
        topic, header = topics.CMD_VEL_STAMPED, message.header
        self._repeat(PLAIN, topic, message.twist, stamp_ns(header.stamp), header.frame_id)

    def _repeat(self, source: str, topic: str, twist: Any, stamp: int = 0, frame_id: str = "") -> None:
        if self._verifier is not None:
            raise CommandError("unsigned: velocities come as the signed word 'velocity FORWARD LEFT TURN'")
        require_base_frame(frame_id)
        velocity: Velocity = velocity_from_twist(twist)
        if stamp:
            self._check_stamp(stamp, self._arbiter.config.sources[source].timeout)
        self._drive(source, topic, velocity)

    def _check_stamp(self, stamp: int, timeout: float) -> None:
        """Refuse stamps that are old, repeated, or of another clock. A stamp of zero means now."""
        age = (self._reports.now - stamp) / NANOSECONDS
        if abs(age) > timeout:
            text = f"{age:.3f} s old" if age > 0.0 else f"{-age:.3f} s ahead"
            raise MessageError(f"header.stamp: {text}; stamp with /clock, or with zero for the present time")
        if stamp <= self._last_stamp:
            raise MessageError(f"header.stamp: {stamp} ns is not after {self._last_stamp} ns")
        self._last_stamp = stamp

    def _on_lock(self, name: str, message: Any) -> None:
        self._arbiter.lock(name, message.data, self._reports.t)

    def _on_route(self, status: RouteStatus) -> None:
        """Handle the status of a walk to a goal, which replaces the commanded velocity."""
        running = status.state is RouteState.RUNNING
        self._on_the_way = running or (self._on_the_way and status.state is RouteState.REFUSED)
        if running:
            self._arbiter.forget()


class ScanTopic:
    """Passes scans to ``law`` after the first ``/clock``; refuses malformed, old and future ones, naming the field."""

    def __init__(self, node: PoiseNode, law: ObstacleStop, now: Callable[[], float]) -> None:
        self._law, self._now = law, now
        if law.expected:
            node.listen(LaserScan, topics.SCAN, self._on_scan, SENSOR)

    def _on_scan(self, message: Any) -> None:
        now = self._now()
        if not now:
            return
        scan = scan_from_message(message)
        if abs(now - scan.t) > self._law.config.scan_timeout:
            raise MessageError(f"header.stamp: {scan.t:.3f} s, while /clock is at {now:.3f} s")
        if self._law.stamp is not None and self._law.stamp > now + self._law.config.scan_timeout:
            self._law.reset()  # /clock was reset: the bridge was restarted
        self._law.update(scan)
