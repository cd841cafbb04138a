"""Commands from all sources, words and velocities: who is in command, and what the gait is told."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import Twist, TwistStamped
from std_msgs.msg import Bool, Empty, String

from controllers.arbitration import STILL, Arbiter, Velocity
from controllers.arbitration_config import PLAIN, ArbitrationConfig
from controllers.nodes.health_topics import HealthTopics
from controllers.supervisor import Supervisor
from models.errors import CommandError, MessageError, PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS
from models.nodes.messages import stamp_ns
from models.nodes.qos import COMMAND, EVENT, LATCHED
from models.nodes.velocity import require_base_frame, velocity_from_twist, velocity_to_twist
from models.types import CommandReply, Mode

STOP = "stop"
"""The word that everybody may say, whoever is in command."""


class CommandTopics:
    """Hears every source, has the supervisor's law answer its words, and repeats the velocity that counts.

    Each source has a topic for words and one for velocities; ``humanoid_commands``, ``cmd_vel`` and ``cmd_vel_stamped``
    are those of the source ``plain``. In mode ``walk`` the gait is told the velocity at every ``tell``, zero included:
    when that falls silent, the supervisor is gone, and the gait comes to a standstill by itself.

    Args:
        node: Node that subscribes.
        config: Sources and locks.
        law: Answers words.
        reports: The time, and whether anybody can walk.
        reply: Called with topic and answer.
    """

    def __init__(
        self,
        node: PoiseNode,
        config: ArbitrationConfig,
        law: Supervisor,
        reports: HealthTopics,
        reply: Callable[[str, CommandReply], None],
    ) -> None:
        self._node, self._law, self._reports, self._reply = node, law, reports, reply
        self._arbiter = Arbiter(config)
        self._speaker, self._commander = PLAIN, ""
        self._last_stamp = 0
        self._walking = False
        self._velocity = node.announce(Twist, topics.GAIT_VELOCITY, COMMAND)
        self._stop = node.announce(Empty, topics.GAIT_STOP, EVENT)
        self._commander_topic = node.announce(String, topics.COMMANDER, LATCHED)
        for source in config.sources:
            word, velocity = (
                (topics.HUMANOID_COMMANDS, topics.CMD_VEL) if source == PLAIN else topics.source_topics(source)
            )
            node.listen(String, word, self._on_word(source, word), EVENT)
            node.listen(Twist, velocity, self._on_velocity(source, velocity), COMMAND)
        node.listen(TwistStamped, topics.CMD_VEL_STAMPED, self._on_stamped, COMMAND)
        for name in config.locks:
            node.listen(Bool, f"{topics.LOCKS}/{name}", self._on_lock(name), EVENT)
        node.listen(String, topics.GAIT_ROUTE, self._on_route, EVENT)

    def values(self) -> dict[str, str]:
        """For the diagnostics."""
        t = self._reports.t
        return {"in command": self._arbiter.in_command(t), "locks": ", ".join(self._arbiter.locks(t)) or "none"}

    def take(self) -> None:
        """Act on the velocity that a word has set, or on the standstill that it asks for."""
        velocity = self._law.take_velocity()
        if velocity is None:
            return
        if any(velocity):
            self._arbiter.hold(self._speaker, velocity)
        else:
            self._arbiter.forget()
            self._stop.publish(Empty())

    def tell(self) -> None:
        """Repeat the velocity while the robot walks, and tell who is in command when that changes."""
        t, walking = self._reports.t, self._law.mode is Mode.WALK
        if walking:
            self._velocity.publish(velocity_to_twist(STILL if self._law.still else self._arbiter.velocity(t)))
        elif self._walking:
            self._arbiter.forget()
        self._walking = walking
        commander = self._arbiter.in_command(t)
        if commander != self._commander:
            self._commander = commander
            self._commander_topic.publish(String(data=commander))

    def _on_word(self, source: str, topic: str) -> Callable[[Any], None]:
        def on_word(message: Any) -> None:
            if not self._node.active:
                return
            self._law.gait = self._reports.gait_present
            try:
                if message.data.strip().lower() != STOP:
                    self._arbiter.require(source, self._reports.t)
            except CommandError as error:
                self._reply(topic, CommandReply(False, str(error)))
                return
            self._speaker = source
            reply = self._law.text(message.data)
            if reply.accepted:
                self._arbiter.spoke(source, self._reports.t)
            self._reply(topic, reply)

        return on_word

    def _on_velocity(self, source: str, topic: str) -> Callable[[Any], None]:
        return lambda message: self._repeat(source, topic, message)

    def _on_stamped(self, message: Any) -> None:
        stamp = stamp_ns(message.header.stamp)
        self._repeat(PLAIN, topics.CMD_VEL_STAMPED, message.twist, stamp, message.header.frame_id)

    def _repeat(self, source: str, topic: str, twist: Any, stamp: int = 0, frame_id: str = "") -> None:
        if not self._node.active:
            return
        try:
            if self._law.mode is not Mode.WALK:
                raise CommandError(f"no walking in mode '{self._law.mode.value}': request mode/walk first")
            require_base_frame(frame_id)
            velocity: Velocity = velocity_from_twist(twist)
            if stamp:
                self._judge_stamp(stamp, self._arbiter.config.sources[source].timeout)
            self._arbiter.repeat(source, velocity, self._reports.t)
        except PoiseError as error:
            self._node.refuse(topic, error)

    def _judge_stamp(self, stamp: int, timeout: float) -> None:
        """Refuse what is old, repeated, or of another clock than the graph's. A stamp of zero means now."""
        age = self._reports.now - stamp
        if age > timeout * NANOSECONDS:
            raise MessageError(f"header.stamp: {age / NANOSECONDS:.3f} s old; a stamp is of /clock, or zero for now")
        if -age > timeout * NANOSECONDS:
            raise MessageError(f"header.stamp: {-age / NANOSECONDS:.3f} s ahead; a stamp is of /clock, or zero for now")
        if stamp <= self._last_stamp:
            raise MessageError(f"header.stamp: {stamp} ns is not after {self._last_stamp} ns")
        self._last_stamp = stamp

    def _on_lock(self, name: str) -> Callable[[Any], None]:
        return lambda message: self._arbiter.lock(name, message.data, self._reports.t)

    def _on_route(self, message: Any) -> None:
        """Who walks to a goal has done with the velocity of a word."""
        if message.data.partition(":")[0] == topics.ROUTE_RUNNING:
            self._arbiter.forget()
