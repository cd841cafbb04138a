"""The world that the bridges of one process share, as ``run_plant`` drives it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import rclpy
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock

from bridge.mujoco_world import MujocoWorld
from models.errors import ConfigError
from models.nodes import topics
from models.nodes.cdr import NANOSECONDS
from models.nodes.messages import set_stamp
from models.nodes.qos import SENSOR

if TYPE_CHECKING:
    from bridge.nodes.mujoco_bridge import MujocoBridge

SHARED = ("lockstep", "speed", "terrain", "slow_rate")
"""Parameters that must be the same for every bridge of a world."""


def robot_name(node: Any) -> str:
    """Name of a bridge's robot in the world: its namespace."""
    return str(node.get_namespace()).strip("/")


class BridgedWorld:
    """One world and one time for several bridges, each with the topics of its robot in a namespace of its own.

    The world is built when the first bridge is configured. A robot whose bridge is not active stands still as a statue;
    one that is put back to its start settles while the others stand still. Time passes for all or, where one bridge is
    paused, for none. ``/clock`` of no namespace, for RViz and others that look at all of them, has the same
    time as that of each robot.

    In lockstep the world waits for the command of every robot whose drivers take commands; a robot that is held without
    a mode is not waited for once another has one.

    Attributes:
        bridges: The bridges; they enter themselves.
        tick: Number of this tick.
    """

    def __init__(self) -> None:
        self.bridges: list[MujocoBridge] = []
        self.tick = 1
        self._world: MujocoWorld | None = None

    def open(self) -> None:
        """Begin to publish ``/clock``; once rclpy is up and the bridges are made."""
        mute = [Parameter("start_type_description_service", value=False)]  # it publishes, and nothing else
        self._node = rclpy.create_node("mujoco_world", start_parameter_services=False, parameter_overrides=mute)
        self._clock = self._node.create_publisher(Clock, topics.CLOCK, SENSOR)

    def close(self) -> None:
        """Cease to."""
        self._node.destroy_node()

    @property
    def world(self) -> MujocoWorld:
        """The world; built now if need be.

        Raises:
            ConfigError: The bridges do not agree on it, or two robots touch at the start.
        """
        if self._world is None:
            first = self.bridges[0].given
            for name in SHARED:
                values = {getattr(bridge.given, name) for bridge in self.bridges}
                if len(values) > 1:
                    raise ConfigError(f"{name}: the robots of a world share it, and {values} were given")
            self._world = MujocoWorld(
                {robot_name(bridge): bridge.model for bridge in self.bridges},
                {robot_name(bridge): bridge.given.place for bridge in self.bridges},
                payload_kg={robot_name(bridge): bridge.given.payload for bridge in self.bridges},
                terrain=first.terrain,
            )
        return self._world

    @property
    def lockstep(self) -> bool:
        """Whether the plant waits for commands."""
        return self.bridges[0].lockstep

    @property
    def period(self) -> float:
        """Time that a tick takes in real time [s]."""
        return self._moving[0].period

    @property
    def callbacks_min(self) -> int:
        """Callbacks served in a tick, however late it is: a command for each."""
        return len(self.bridges)

    @property
    def _moving(self) -> list[MujocoBridge]:
        return [bridge for bridge in self.bridges if bridge.active]

    @property
    def running(self) -> bool:
        """Whether simulated time passes."""
        moving = self._moving
        return bool(moving) and not any(bridge.paused for bridge in moving)

    @property
    def answered(self) -> bool:
        """Whether all drivers that take commands have that of this tick."""
        asked = [bridge for bridge in self._moving if bridge.driven.awaits_command]
        return bool(asked) and all(bridge.answered for bridge in asked)

    @property
    def free_running(self) -> bool:
        """Whether nobody's drivers take commands although somebody is let go."""
        moving = self._moving
        return not any(b.driven.awaits_command for b in moving) and any(b.free_running for b in moving)

    def publish_tick(self, late: float) -> None:
        """Publish the sensors of this tick of all robots, which began so late after its deadline [s]."""
        for bridge in self._moving:
            bridge.publish_tick(late)
        if self.tick % self._moving[0].slow_ticks == 0:
            self._publish_time()

    def step(self) -> None:
        """Advance by one tick, together."""
        moving = self._moving
        for bridge in moving:
            bridge.driven.before_physics()
        self.world.step([bridge.driven.plant for bridge in moving])
        for bridge in moving:
            bridge.after_physics()
        self.tick += 1
        for bridge in self.bridges:
            bridge.tick = self.tick  # of those that are not active too: their stamps go on with the others'

    def overrun(self, ticks: int) -> None:
        """Count skipped ticks."""
        for bridge in self._moving:
            bridge.overrun(ticks)

    def idle(self) -> None:
        """Publish the time."""
        for bridge in self._moving:
            bridge.idle()
        if self._moving:
            self._publish_time()

    def _publish_time(self) -> None:
        message = Clock()
        set_stamp(message.clock, round(self.tick * self.world.period * NANOSECONDS))
        self._clock.publish(message)
