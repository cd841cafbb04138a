"""Node ``robot_driver``: a plant and its joint drivers behind the topics of a robot."""

import math
import sys
import time
from collections import defaultdict
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.utilities import remove_ros_args

from bridge.driver.drivers import Drivers, HardwareDrivers, SimulatedDrivers
from bridge.driver.operator import StartServices
from bridge.driver.probes import AnswerTimes, LatencyProbe
from bridge.driver.run_loop import run_plant
from bridge.driver.topics import (
    CommandInput,
    ScanTopic,
    SensorTopics,
    SimulationServices,
    StatusTopics,
    TruthTopics,
    declare_simulation,
)
from bridge.driver.world import DriverWorld, robot_name
from bridge.plants.base import HardwarePlant, Plant, SimulatedPlant, make_plant
from bridge.plants.config import DriverConfig, LoopConfig, read_options
from bridge.plants.mujoco import MujocoPlant
from bridge.plants.sensors import read_sensor_errors
from bridge.plants.world import ALONE, Place
from bridge.ros.namespace import absolute_namespace, namespace_rules
from models.config import default_config
from models.errors import ConfigError, PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.calibration_file import NO_FILE, CalibrationFile, declare_calibration
from models.nodes.cdr import NANOSECONDS
from models.nodes.parameters import declare_config
from models.nodes.progress import ProgressOfNodes
from models.nodes.spin import Stop, run
from models.types import SensorData

COMMANDS, SUPERVISOR = "commands", "the supervisor"  #: What simulated time waits for, besides perception nodes
MUJOCO = "mujoco"  #: Name of the built-in simulated plant
SLOW = 0.9  #: Real-time factor, relative to the requested speed, below which it is reported [-]


class RobotDriver(PoiseNode):
    """Publishes the sensors of every tick and passes the newest command to the plant; ``run_plant`` paces it.

    The stamps of a simulated plant count its ticks and continue through resets; services and topics control its world.
    The stamps of any other plant, and ``/clock``, follow the clock of its samples and stop with them. ``world``,
    optional, is shared by several simulated robots.

    Attributes:
        config: Parameters of the node.
        lockstep: Whether the plant waits for the command of each tick.
        tick: Number of the present tick, from 1; ``restart`` does not reset it.
        paused: Whether simulated time stands still.
        drivers: Joint drivers of the plant; set by ``configure``.
        period: Real time between two ticks [s].
        slow_ticks: Ticks between two messages of ``clock`` and ``ground_truth/odom``.
        commands: Input of commands and modes.
    """

    callbacks_min = 1

    def __init__(self, world: DriverWorld | None = None, **kwargs: Any) -> None:
        super().__init__("robot_driver", **kwargs)
        self.config: DriverConfig = declare_config(self, default_config(DriverConfig, "bridge", "robot_driver"))
        declare_calibration(self, NO_FILE)
        declare_simulation(self)
        self.lockstep = self.config.lockstep
        self.tick = 1
        self.paused = False
        self.drivers: Drivers
        self._world = world
        if world is not None:
            world.drivers.append(self)
        self._settled: SensorData | None = None  # published in the first tick after a restart in lockstep
        self._late_since: dict[str, float] = {}  # monotonic start of each wait of simulated time [s]
        self._waited: defaultdict[str, float] = defaultdict(float)  # real time of such waits that ended [s]

    def configure(self) -> None:
        config = self.config
        plant = self._make_plant()
        simulated = plant if isinstance(plant, SimulatedPlant) else None
        for name in ("lockstep", "latency_file"):
            if getattr(config, name) and simulated is None:
                raise ConfigError(f"{name}: for simulated plants only, and '{config.plant}' is not simulated")
        self._simulated: SimulatedDrivers | None = None
        speed = 1.0
        if simulated is not None:
            start = default_config(LoopConfig, "bridge", "closed_loop")
            self.drivers = self._simulated = SimulatedDrivers(simulated, self.model, start)
            speed = config.speed
        elif isinstance(plant, HardwarePlant):
            self.drivers = HardwareDrivers(plant, self.model)
            speed = plant.speed
        else:
            self.drivers = Drivers(plant, self.model)
        self.period = plant.period / speed
        self._period_ns = round(plant.period * NANOSECONDS)
        self._sensor_ticks = _ticks_between(config.sensor_rate, plant.period) if config.sensor_rate else 1
        self.slow_ticks = max(round(1.0 / (config.slow_rate * plant.period)), 1)
        self._probe = LatencyProbe() if config.latency_file else None
        self._sensors = SensorTopics(self, simulated)
        self._status = StatusTopics(self, self.drivers)
        age_max = round(config.command_age_max * NANOSECONDS)
        self.commands = CommandInput(
            self, self.drivers, self._period_ns, age_max, self._probe, self._status.publish_state
        )
        self._calibration = CalibrationFile(self)
        self._start: StartServices | None = None
        if isinstance(self.drivers, HardwareDrivers):
            self._start = StartServices(self, self.drivers, self._status.publish_state)
        self._answers = AnswerTimes()
        self._sent = 0  # stamp of the newest command sent to a real robot [ns]
        self._stamp = self._published_stamp = 0  # stamps of the newest and the last published sample [ns]
        self._scan: ScanTopic | None = None
        if self._simulated is not None:
            self._truth = TruthTopics(self, self._simulated.plant)
            self._perception = ProgressOfNodes(self)
            SimulationServices(self, self._simulated, self._restart_on_request, self._pause)
        if isinstance(plant, MujocoPlant):
            noise = float(config.sensor_noise)
            self._scan = ScanTopic(self, plant, seed=config.seed, noise=noise)

    def _make_plant(self) -> Plant:
        config = self.config
        if config.plant != MUJOCO:
            if self._world is not None:
                raise ConfigError(f"plant: several robots share a world of '{MUJOCO}', not of '{config.plant}'")
            return make_plant(config.plant, self.model, read_options(config.plant_options))
        if self._world is None and any(config.place):
            raise ConfigError("place: only robots of a world with several robots have one")
        Place(*config.place)  # refuses non-finite values
        return MujocoPlant(
            self.model,
            seed=config.seed,
            sensor_noise=config.sensor_noise,
            payload_kg=config.payload,
            terrain=config.terrain,
            timestep=1.0 / config.rate,
            sensor_errors=read_sensor_errors(config.sensor_errors),
            faults=config.faults.plan,
            world=None if self._world is None else self._world.world,
            name=ALONE if self._world is None else robot_name(self),
        )

    @property
    def simulation(self) -> Any:
        """The simulated plant."""
        return self.drivers.plant

    def activate(self) -> None:
        """Hold a simulated robot at its start and let it settle; no torque for any other robot."""
        self.restart()

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition; publishers are active after it."""
        result = super().on_activate(state)
        self._status.publish_latched(self.model.description, self.stamp)
        return result

    def deactivate(self) -> None:
        """Release the torque and write the measured latencies."""
        self.drivers.plant.close()
        if isinstance(self.drivers, HardwareDrivers) and (warning := self.drivers.plant.end_warning):
            self.get_logger().error(warning)
        if self._probe is not None:
            self._probe.save(Path(self.config.latency_file))

    def restart(self, hanging: bool = False) -> None:
        """Apply the newest calibration; reset a simulated robot to its start, or hang it up. Stamps continue.

        Ends a pause of this driver. Raises ``CommandError``, without an effect, if another robot is in its place.
        """
        offsets = self._calibration.read().encoder_offsets
        if self._simulated is not None:
            self._simulated.reset(hanging=hanging)
        self._pause(False)
        self.drivers.encoder_offsets = offsets if offsets.any() else None
        if self._simulated is not None:
            settled = self._simulated.settle()
            self._settled = settled if self.lockstep else None
        self.commands.restart(self.stamp)
        self._status.publish_start(self.stamp)

    def _restart_on_request(self, hanging: bool) -> None:
        """As ``restart``; ``CommandError`` also while another robot pauses the world, as the robot could not settle."""
        if self._world is not None:
            self._world.require_time(self)
        self.restart(hanging)

    @property
    def stamp(self) -> int:
        """Stamp of this tick [ns]."""
        return self._stamp if self._simulated is None else self.tick * self._period_ns

    @property
    def running(self) -> bool:
        """Whether the plant's time advances."""
        return self.active and not self.paused

    @property
    def answered(self) -> bool:
        """Whether the drivers have the command of this tick, or none is due: sensors not published or corrupted."""
        return self.commands.stamp == self.stamp or not self._sensing or self.simulation.faults.corrupted

    @property
    def follows_samples(self) -> bool:
        """Whether the samples of a real robot trigger the ticks."""
        return self._start is not None

    @property
    def sample_due(self) -> bool:
        """Whether the next sample of a real robot has arrived."""
        return isinstance(self.drivers, HardwareDrivers) and self.drivers.plant.arrived

    @property
    def command_due(self) -> bool:
        """Whether a command has arrived that was not sent to the drives yet, or none is awaited."""
        return not self.drivers.awaits_command or self.commands.stamp > self._sent

    @property
    def fresh(self) -> bool:
        """Whether this tick has a new sample."""
        return self.drivers.stale == 0.0

    @property
    def behind(self) -> bool:
        """Whether simulated time waits for the command, the supervisor or a perception node.

        Time waits while one of them refers to a state older than its bound, for at most ``yield_max``. The waits are
        independent: without a supervisor, time still waits for commands. Time does not wait with faults of the sensors,
        or for a robot that hangs or was released without commands. A perception node that exceeded ``yield_max`` is not
        waited for until it reports again.
        """
        if self._simulated is None or self.config.real_time != "yield":
            return False
        given, commands, now = self.config, self.commands, time.monotonic()
        reached = self._perception.reached
        due = self.stamp - self._sensor_ticks * self._period_ns
        late = []
        if not self.free_running and not self.simulation.faults.corrupted:
            answered = max(commands.stamp, commands.due_since)
            if self.drivers.awaits_command and due - answered > given.yield_lag * NANOSECONDS:
                late.append(COMMANDS)
            if commands.judged and due - commands.judged > given.yield_supervisor * NANOSECONDS:
                late.append(SUPERVISOR)
            oldest = min(self._truth.published, due) - given.yield_perception * NANOSECONDS
            late += [node for node, stamp in reached.items() if stamp < oldest]
        if not late and not self._late_since:
            return False
        for each in late:
            if each not in self._late_since:
                self.counters[f"waits for {each}"] += 1
        for each in set(self._late_since) - set(late):
            self._waited[each] += now - self._late_since[each]
        self._late_since = {each: self._late_since.get(each, now) for each in late}
        waits = [each for each, begin in self._late_since.items() if now - begin < given.yield_max]
        for each in set(late) - set(waits):
            self._perception.forget(each)  # the node has ended, or is too slow
        return bool(waits)

    @property
    def _sensing(self) -> bool:
        return self.tick % self._sensor_ticks == 0

    @property
    def free_running(self) -> bool:
        """Whether the drivers accept no commands although the robot is released or hangs."""
        return self.drivers.state != topics.HELD and not self.drivers.awaits_command

    def _pause(self, paused: bool) -> None:
        if paused is not self.paused:
            self.paused = paused
            self._status.begin_factor(self.stamp, 0.0 if paused else math.nan)

    def publish_tick(self, late: float) -> None:
        """Publish the sensors of this tick, which began ``late`` after its deadline [s]."""
        if self._simulated is None:
            self._stamp = round(self.drivers.read().t * NANOSECONDS)
            if self._stamp <= self._published_stamp:
                self.counters["ticks without a new sample"] += 1
                self._status.publish_factor(self._stamp)
                return
            self._published_stamp = self._stamp
            self._answers.arrive(self._stamp)
        self.commands.now = self.stamp
        if self._sensing:
            self._publish_sensors(late)
        if self._scan is not None:
            self._scan.publish(self.tick, self.stamp)
        if self.tick % self.slow_ticks == 0:
            self._status.publish_time(self.stamp)
            if self._simulated is not None:
                self._truth.publish(self.stamp)

    def _publish_sensors(self, late: float) -> None:
        if self._probe is not None:
            self._probe.publish(self.tick, late, self.drivers.state == topics.ACTIVE)
        self._sensors.publish(self.stamp, self.drivers.read() if self._settled is None else self._settled)
        if self._probe is not None:
            self._probe.send(self.tick)

    def step(self) -> None:
        """Advance by one tick."""
        self.drivers.act()
        if self._start is not None:
            self._sent = self.commands.stamp
            self._answers.send(self._sent)
        if self._simulated is not None:
            self._simulated.plant.step()
        self.after_physics()

    def after_physics(self) -> None:
        """Last part of a tick, after the physics."""
        if self._simulated is not None:
            self._simulated.after_physics()
        self._settled = None
        self.tick += 1
        self._status.publish_state()
        if self._start is not None and self.tick % self.slow_ticks == 0:
            self._start.publish()

    def overrun(self, ticks: int) -> None:
        """Count skipped ticks."""
        if ticks:
            self.counters["ticks skipped"] += ticks
            if self._probe is not None:
                self._probe.skip(self.tick, ticks)

    def idle(self) -> None:
        """Publish the time."""
        if self.active:
            self._status.publish_time(self.stamp)

    def before_diagnostics(self) -> None:
        if not self.active:
            return
        paused = not (self._world or self).running
        self.message = "paused" if paused else self.drivers.state
        servo = self.drivers.servo
        self.values["driver timeouts"], self.values["setpoints refused"] = str(servo.timeouts), str(servo.refused)
        self.values["silence before timeout [s]"] = f"{servo.silence:.4f}"
        self.values["starts interrupted"] = str(self.drivers.interruptions)
        factor = self._status.real_time_factor
        self.values["real-time factor"] = f"{factor:.2f}"
        if self._simulated is not None and not paused and factor < SLOW * self.config.speed:
            why = f" and waited longest for {max(self._waited, key=self._waited.__getitem__)}" if self._waited else ""
            self.get_logger().warning(
                f"simulated time runs at {factor:.2f} of real time{why}: the processor is slow, or other programs use "
                "it; poise status has the present factor",
                throttle_duration_sec=600.0,
            )
        if self._start is not None:
            self.level, message = self._start.diagnose()
            self.message = f"{self.message}; {message}"
            self.values |= self._start.values | self._answers.values
        if self._simulated is not None:
            self.values["faults injected"] = self._simulated.plant.faults.summary


def _ticks_between(rate: float, period: float) -> int:
    """Ticks of a period [s] between samples at a rate [Hz]; ``ConfigError`` unless the rate divides the tick rate."""
    ticks = round(1.0 / (rate * period))
    if ticks < 1 or abs(ticks * rate * period - 1.0) > 1e-6:  # 1e-6: rounding of the quotient
        raise ConfigError(f"sensor_rate: the tick rate {1.0 / period:.0f} Hz is not a multiple of {rate:g} Hz")
    return ticks


def main(args: list[str] | None = None) -> None:
    """Run one node, or several nodes in one world; the command line arguments are then their namespaces."""
    given = list(sys.argv if args is None else args)
    names = remove_ros_args(given)[1:]
    if not names:
        sys.exit(run([RobotDriver], given, run_plant))
    if len(set(names)) != len(names):
        sys.exit(
            "robot_driver: a name is given twice; usage: robot_driver robot_1 robot_2 --ros-args --params-file FILE"
        )
    try:
        namespaces = [absolute_namespace(name) for name in names]
    except PoiseError as error:
        sys.exit(str(error))
    world = DriverWorld()
    rules = ["--ros-args", *namespace_rules()]
    drivers = [partial(RobotDriver, world, namespace=each, cli_args=rules) for each in namespaces]

    def loop(executor: Any, nodes: Sequence[Any], stop: Stop) -> None:
        world.open()
        try:
            run_plant(executor, [world], stop)
        finally:
            world.close()

    sys.exit(run(list(drivers), given, loop))


if __name__ == "__main__":
    main()
