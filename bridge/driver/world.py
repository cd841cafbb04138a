"""Several simulated robots in one world and one process, driven by ``run_plant``."""

from typing import Any, Protocol

import rclpy
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock

from bridge.driver.drivers import Drivers
from bridge.driver.run_loop import Paced
from bridge.plants.config import DriverConfig
from bridge.plants.mujoco import step_world
from bridge.plants.world import MujocoWorld, Place
from models.errors import CommandError, ConfigError
from models.nodes import topics
from models.nodes.cdr import NANOSECONDS
from models.nodes.messages import clock_message
from models.nodes.qos import STATE
from models.robot_model import RobotModel

#: Parameters that must be equal for all drivers of a world
SHARED = ("lockstep", "speed", "terrain", "slow_rate", "rate", "real_time")


def robot_name(node: Any) -> str:
    """Name of a driver's robot in the world: the node's namespace."""
    return str(node.get_namespace()).strip("/")


class DrivenRobot(Paced, Protocol):
    """Driver node of one robot in the world."""

    config: DriverConfig
    drivers: Drivers
    active: bool
    paused: bool
    tick: int
    slow_ticks: int

    @property
    def model(self) -> RobotModel:
        """The robot."""

    @property
    def simulation(self) -> Any:
        """The simulated plant."""

    def after_physics(self) -> None:
        """Last part of a tick."""


class DriverWorld:
    """One world and one time for several drivers, each with the topics of its robot in a namespace.

    The world is built when the first driver is configured. A robot with an inactive driver stands still; while a robot
    settles after a reset, the others stand still. Time advances for all robots, or for none while a driver is paused.
    ``/clock`` without a namespace, for RViz and other tools that show all robots, has the same time as each robot.

    In lockstep the world waits for the commands of all robots whose drivers accept commands. It does not wait for a
    held robot without a mode once another one has a mode. The driver nodes add themselves to ``drivers``.
    """

    def __init__(self) -> None:
        self.drivers: list[DrivenRobot] = []
        self.tick = 1
        self._world: MujocoWorld | None = None

    def open(self) -> None:
        """Create the publisher of ``/clock``; rclpy and the drivers must exist."""
        mute = [Parameter("start_type_description_service", value=False)]  # publishes only
        self._node = rclpy.create_node("mujoco_world", start_parameter_services=False, parameter_overrides=mute)
        self._clock = self._node.create_publisher(Clock, topics.CLOCK, STATE)

    def close(self) -> None:
        """Destroy the publisher of ``/clock``."""
        self._node.destroy_node()

    @property
    def follows_samples(self) -> bool:
        """False: simulated robots have no clock."""
        return False

    sample_due = command_due = fresh = follows_samples

    @property
    def world(self) -> MujocoWorld:
        """The world, built at the first call; ``ConfigError`` if shared parameters differ or robots touch."""
        if self._world is None:
            first = self.drivers[0].config
            for name in SHARED:
                values = {getattr(driver.config, name) for driver in self.drivers}
                if len(values) > 1:
                    raise ConfigError(f"{name}: must be equal for all robots of a world, found {values}")
            self._world = MujocoWorld(
                {robot_name(driver): driver.model for driver in self.drivers},
                {robot_name(driver): Place(*driver.config.place) for driver in self.drivers},
                payload_kg={robot_name(driver): driver.config.payload for driver in self.drivers},
                terrain=first.terrain,
                timestep=1.0 / first.rate,
            )
        return self._world

    @property
    def lockstep(self) -> bool:
        """Whether the plant waits for commands."""
        return self.drivers[0].lockstep

    @property
    def period(self) -> float:
        """Real-time period of a tick [s]."""
        return self._moving[0].period

    @property
    def callbacks_min(self) -> int:
        """Callbacks served in every tick, even a late one: one command per robot."""
        return len(self.drivers)

    @property
    def _moving(self) -> list[DrivenRobot]:
        return [driver for driver in self.drivers if driver.active]

    @property
    def running(self) -> bool:
        """Whether simulated time advances."""
        moving = self._moving
        return bool(moving) and not any(driver.paused for driver in moving)

    def require_time(self, asking: DrivenRobot) -> None:
        """Raise ``CommandError`` while another robot pauses the world."""
        for driver in self._moving:
            if driver.paused and driver is not asking:
                name = robot_name(driver)
                raise CommandError(
                    f"'{name}' has paused the world, so no robot moves; end the pause: "
                    f"ros2 service call /{name}/pause std_srvs/srv/SetBool '{{data: false}}'"
                )

    @property
    def answered(self) -> bool:
        """Whether all drivers that accept commands have the command of this tick; at least one must accept them."""
        asked = [driver for driver in self._moving if driver.drivers.awaits_command]
        return bool(asked) and all(driver.answered for driver in asked)

    @property
    def free_running(self) -> bool:
        """Whether no driver accepts commands although a robot is released or hangs."""
        moving = self._moving
        return not any(d.drivers.awaits_command for d in moving) and any(d.free_running for d in moving)

    @property
    def behind(self) -> bool:
        """Whether time waits for the commands, the supervisor or the perception of a robot."""
        waits = [driver.behind for driver in self._moving]  # all of them, so that no wait begins after another one
        return any(waits)

    def publish_tick(self, late: float) -> None:
        """Publish the sensors of all robots for this tick, which began ``late`` after its deadline [s]."""
        for driver in self._moving:
            driver.publish_tick(late)
        if self.tick % self._moving[0].slow_ticks == 0:
            self._publish_time()

    def step(self) -> None:
        """Advance all robots by one tick."""
        moving = self._moving
        for driver in moving:
            driver.drivers.act()
        step_world(self.world, [driver.simulation for driver in moving])
        for driver in moving:
            driver.after_physics()
        self.tick += 1
        for driver in self.drivers:
            driver.tick = self.tick  # stamps of inactive drivers advance, too

    def overrun(self, ticks: int) -> None:
        """Count skipped ticks."""
        for driver in self._moving:
            driver.overrun(ticks)

    def idle(self) -> None:
        """Publish the time."""
        for driver in self._moving:
            driver.idle()
        if self._moving:
            self._publish_time()

    def _publish_time(self) -> None:
        self._clock.publish(clock_message(round(self.tick * self.world.period * NANOSECONDS)))
