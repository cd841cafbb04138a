"""Topics and services of the driver: commands, modes, sensors, state, time, ground truth, and simulation services."""

import math
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState, LaserScan
from std_msgs.msg import Float64, String
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from bridge.driver.drivers import Drivers, SimulatedDrivers
from bridge.driver.probes import LatencyProbe
from bridge.plants.base import SimulatedPlant
from bridge.plants.fault_effects import FEET, IMU, JOINT_STATES
from bridge.plants.mujoco import MujocoPlant
from bridge.plants.scanner import LaserScanner
from controllers.joints.motor_driver import check_stamp
from models.errors import CommandError, PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS, numbers_of
from models.nodes.messages import (
    ImuCodec,
    JointCommandCodec,
    JointStateCodec,
    WrenchCodec,
    clock_message,
    mode_named,
    set_stamp,
    stamp_ns,
    to_seconds,
)
from models.nodes.odometry import OdometryCodec
from models.nodes.parameters import describe
from models.nodes.perception import scan_to_message
from models.nodes.qos import COMMAND, EVENT, LATCHED, SENSOR, STATE
from models.robot_model import SOLE_FRAMES
from models.types import SensorData, Vector

FACTOR_TIME = 1.0  #: Averaging time of the real-time factor [s]


class CommandInput:
    """Passes modes and commands to the drivers; refuses invalid ones and late commands with the reason.

    A command is late when its sensors are older than ``age_max`` [ns]; ``period`` is the tick [ns]. ``probe``,
    optional, records arrivals; ``on_mode_change`` is called after a mode that may have changed the drivers' state.
    Stamps [ns]: ``now`` of the present tick, set by the node; ``stamp`` of the last accepted command; ``due_since`` of
    the tick from which commands are due, 0 before the first mode with motion; ``judged`` of the newest state that the
    supervisor has received in the present mode, since the last restart, 0 before the first.
    """

    def __init__(
        self,
        node: PoiseNode,
        drivers: Drivers,
        period: int,
        age_max: int,
        probe: LatencyProbe | None,
        on_mode_change: Callable[[], None],
    ) -> None:
        self._node, self._drivers, self._probe, self._on_mode_change = node, drivers, probe, on_mode_change
        self._period, self._age_max = period, age_max
        self._codec = JointCommandCodec(node.model)
        self._accepted = b""
        self.now = period
        self.stamp = 0  # a zero stamp means "now" in a command
        self.judged = 0
        self.due_since = 0
        self._restarted = 0
        node.listen(JointTrajectory, topics.JOINT_SETPOINTS, self.on_command, COMMAND, raw=True)
        node.listen(String, topics.MODE, self.on_mode, LATCHED)
        node.listen(Clock, topics.SUPERVISOR_TIME, self._on_supervisor, SENSOR)

    def restart(self, stamp: int) -> None:
        """Restart of the robot at a stamp [ns]; the estimator starts again from the samples after it."""
        self.judged, self._restarted = 0, stamp

    def _on_supervisor(self, message: Clock) -> None:
        stamp = stamp_ns(message.clock)
        if stamp > self._restarted:
            self.judged = stamp

    def on_command(self, data: bytes) -> None:
        """Callback of a serialised command: pass it to the drivers, or refuse it."""
        if not self._node.active:
            return
        if self._probe is not None:
            self._probe.arrive()
        try:
            stamp, command = self._codec.decode(data)
            if stamp and data == self._accepted:
                return  # a repeated sample has the same command
            check_stamp(stamp, self.stamp, self.now, self._age_max, self._node.counters)
            if self._drivers.command(command):
                self.stamp, self._accepted = stamp or self.stamp, data
                if stamp and self._probe is not None:
                    self._probe.receive(stamp // self._period)
        except PoiseError as error:
            self._node.refuse(topics.JOINT_SETPOINTS, error)

    def on_mode(self, message: String) -> None:
        """Callback of the supervisor's mode."""
        if not self._node.active:
            return
        self.judged = 0
        awaited = self._drivers.awaits_command
        try:
            self._drivers.set_mode(mode_named(message.data))
            if self._drivers.awaits_command and not awaited:
                self.due_since = self.now
        except PoiseError as error:
            self._node.refuse(topics.MODE, error)
        self._on_mode_change()


class SensorTopics:
    """Publishes ``SensorData``, joint states last; faults of a ``simulated`` plant can suppress messages."""

    def __init__(self, node: PoiseNode, simulated: SimulatedPlant | None) -> None:
        self._plant = simulated
        self._imu_codec, self._joint_codec = ImuCodec(topics.IMU_FRAME), JointStateCodec(node.model)
        feet = topics.foot_wrenches(node.model)
        self._foot_codecs = [WrenchCodec(frame) for frame in SOLE_FRAMES]
        self._imu = node.announce(Imu, topics.IMU_RAW, STATE)
        self._feet = [node.announce(WrenchStamped, topic, STATE) for topic in feet]
        self._joints = node.announce(JointState, topics.JOINT_STATES, STATE)

    def publish(self, stamp: int, sensors: SensorData) -> None:
        """Publish a sample with one stamp [ns], without the messages that a fault suppresses."""
        missing: frozenset[str] = frozenset()
        if self._plant is not None:
            delivered = self._plant.transmit(sensors) or sensors
            missing = self._plant.faults.missing
            stamp = max(stamp + round((delivered.t - sensors.t) * NANOSECONDS), 0)
            sensors = delivered
        if IMU not in missing:
            self._imu.publish(self._imu_codec.encode(stamp, sensors.gyro, sensors.accel))
        for foot, publisher in enumerate(self._feet):
            if FEET[foot] not in missing:
                publisher.publish(self._foot_codecs[foot].encode(stamp, sensors.wrenches[foot]))
        if JOINT_STATES not in missing:
            self._joints.publish(self._joint_codec.encode(stamp, sensors.q, sensors.v, sensors.tau))


class ScanTopic:
    """Publishes ``scan`` at the scanner's rate while it has a subscriber; no effect for a robot without a scanner."""

    def __init__(self, node: PoiseNode, plant: MujocoPlant, *, seed: int, noise: float) -> None:
        self._plant = plant
        self._last = self._ticks = 0  # last stamp [ns]; ticks between two scans, 0 without a scanner
        if plant.robot.profile.sensors.scan is None:
            return
        self._scanner = LaserScanner(plant, seed, noise)
        self._period = 1.0 / self._scanner.config.rate
        self._ticks = max(round(self._period / plant.period), 1)
        self._publisher = node.announce(LaserScan, topics.SCAN, STATE)

    def publish(self, tick: int, stamp: int) -> None:
        """Publish the scan of a tick with a stamp [ns], if due; a repeated call for a stamp has no effect."""
        if not self._ticks or tick % self._ticks or stamp == self._last or not self._publisher.get_subscription_count():
            return
        self._last = stamp
        scan = self._plant.transmit_scan(self._scanner.scan(to_seconds(stamp)))
        if scan is not None:
            self._publisher.publish(scan_to_message(stamp, scan, self._period))


class StatusTopics:
    """Publishers of time, ``real_time_factor``, driver state, encoder offsets and robot description.

    The factor is NaN in the first second, and in the first second after a pause.
    """

    def __init__(self, node: PoiseNode, drivers: Drivers) -> None:
        self._drivers, self._published = drivers, ""
        self.real_time_factor = math.nan
        self._factor_since = (math.inf, 0)  # monotonic time [s], stamp [ns]
        self._factor = node.announce(Float64, topics.REAL_TIME_FACTOR, LATCHED)
        self._codec = JointStateCodec(node.model)
        self._zero = np.zeros(node.model.nj)
        self._time = node.announce(Clock, topics.CLOCK, STATE)
        self._state = node.announce(String, topics.DRIVER_STATE, LATCHED)
        self._offsets = node.announce(JointState, topics.ENCODER_OFFSETS, LATCHED)
        self._description = node.announce(String, topics.ROBOT_DESCRIPTION, LATCHED)

    def publish_latched(self, description: str, stamp: int) -> None:
        """Publish description, encoder offsets and state with a stamp [ns]; the node must be active."""
        self._description.publish(String(data=description))
        self.publish_start(stamp)

    def publish_start(self, stamp: int) -> None:
        """Publish encoder offsets with a stamp [ns], and the state even if unchanged: ``held`` again means a reset."""
        offsets = self._drivers.encoder_offsets
        offsets = self._zero if offsets is None else offsets
        self._offsets.publish(self._codec.encode(stamp, offsets, self._zero, self._zero))
        self._published = ""
        self.publish_state()

    def publish_time(self, stamp: int) -> None:
        """Publish the time of the robot [ns]."""
        self._time.publish(clock_message(stamp))
        self.publish_factor(stamp)

    def begin_factor(self, stamp: int, factor: float) -> None:
        """Publish a factor (0 for a pause), and restart the average at the time of the robot [ns]."""
        self.real_time_factor, self._factor_since = factor, (time.monotonic(), stamp)
        self._factor.publish(Float64(data=factor))

    def publish_factor(self, stamp: int) -> None:
        """Publish the real-time factor, if due, at the time of the robot [ns]; 0 while that time stands still."""
        now, (since, first) = time.monotonic(), self._factor_since
        if now - since >= FACTOR_TIME:
            self.real_time_factor = (stamp - first) / NANOSECONDS / (now - since)
            self._factor.publish(Float64(data=self.real_time_factor))
        if not since <= now < since + FACTOR_TIME:
            self._factor_since = (now, stamp)

    def publish_state(self) -> None:
        """Publish the state of the drivers if it has changed."""
        if self._published != self._drivers.state:
            self._published = self._drivers.state
            self._state.publish(String(data=self._published))


class TruthTopics:
    """Publishers of ``ground_truth/odom``, and of ``joint_states`` and ``obstacle`` beside it while subscribed to.

    ``published`` is the stamp of the newest of these states [ns].
    """

    def __init__(self, node: PoiseNode, plant: SimulatedPlant) -> None:
        self._plant = plant
        self._codec, self._joint_codec = OdometryCodec(), JointStateCodec(node.model)
        self._odometry = node.announce(Odometry, topics.GROUND_TRUTH, STATE)
        self._joints = node.announce(JointState, topics.GROUND_TRUTH_JOINTS, STATE)
        self._obstacle = node.announce(PoseStamped, topics.GROUND_TRUTH_OBSTACLE, STATE)
        self.published = 0

    def publish(self, stamp: int) -> None:
        """Publish the true state and the position of the obstacle with a stamp [ns]; joint states last."""
        truth, self.published = self._plant.truth, stamp
        self._odometry.publish(self._codec.encode(stamp, truth))
        centre = self._plant.obstacle.centre
        if centre is not None and self._obstacle.get_subscription_count():
            message = PoseStamped()
            set_stamp(message.header.stamp, stamp)
            message.header.frame_id = topics.ODOM_FRAME
            place = message.pose.position
            place.x, place.y, place.z = centre.tolist()
            self._obstacle.publish(message)
        if self._joints.get_subscription_count():
            self._joints.publish(self._joint_codec.encode(stamp, truth.q[7:], truth.v[6:], truth.tau))


SCENARIO = "faults.scenario"  #: Parameter with the faults that the service ``faults/inject`` injects


def declare_simulation(node: PoiseNode) -> None:
    """Declare the parameters of ``SimulationServices``, which can be changed at any time."""
    parameter = partial(describe, read_only=False)
    for name, default, descriptor in (
        ("push.force", [0.0, 60.0, 0.0], parameter("Force of the service push, in the world [N]")),
        ("push.duration", 0.1, parameter("Duration of a push [s]", low=0.001, high=10.0)),
        ("push.body", "base_link", parameter("Body on which the force of the service push acts")),
        ("obstacle.place", [2.0, 0.0], parameter("Centre of the box of the service obstacle, x and y in W [m]")),
        (SCENARIO, "", parameter("Faults of faults/inject: YAML, a file, or the name of a packaged scenario")),
    ):
        node.declare_parameter(name, default, descriptor)


class SimulationServices:
    """Services of the simulated world.

    - ``pause``, ``hang``, ``obstacle`` (SetBool): ``hang`` lifts the robot off the floor or resets it to its start,
      while it is held or its drivers are off; ``obstacle`` places the box of the terrain at ``obstacle.place``.
    - ``reset``, ``push``, ``faults/inject``, ``faults/clear`` (Trigger): use the present values of ``push.*`` and
      ``faults.scenario``.
    - Topic ``push`` (WrenchStamped): force in W [N] on the body ``header.frame_id`` for ``push.duration``.

    ``restart`` resets the robot to its start (False) or hangs it up (True), and ends a pause. ``pause`` stops (True) or
    resumes (False) simulated time.
    """

    def __init__(
        self,
        node: PoiseNode,
        drivers: SimulatedDrivers,
        restart: Callable[[bool], None],
        pause: Callable[[bool], None],
    ) -> None:
        self._node, self._drivers, self._plant = node, drivers, drivers.plant
        self._restart, self._pause = restart, pause
        self._plant.faults.note = node.get_logger().warning
        node.listen(WrenchStamped, topics.PUSH, self._on_push, EVENT)
        self._offer(SetBool, "pause", self._on_pause)
        self._offer(SetBool, "hang", self._on_hang)
        self._offer(SetBool, "obstacle", self._on_obstacle)
        self._offer(Trigger, "reset", lambda _: self._start_over(False))
        self._offer(Trigger, "push", self._on_push_service)
        self._offer(Trigger, topics.FAULTS_INJECT, self._on_inject)
        self._offer(Trigger, topics.FAULTS_CLEAR, lambda _: self._plant.faults.clear())

    def _offer(self, kind: Any, name: str, act: Callable[[Any], str]) -> None:
        """Offer a service that responds with its effect or the reason of a refusal."""

        def on_call(request: Any, response: Any) -> Any:
            try:
                response.message = act(request)
                response.success = True
            except PoiseError as error:
                self._node.refuse(name, error)
                response.success, response.message = False, str(error)
            return response

        self._node.serve(kind, name, on_call)

    def _value(self, name: str) -> Any:
        return self._node.get_parameter(name).value

    def _push(self, force: Vector, body: str) -> str:
        duration = float(self._value("push.duration"))
        self._plant.push(force, duration, body)
        return self._log(f"push ({force[0]:g}, {force[1]:g}, {force[2]:g}) N for {duration:g} s on {body}")

    def _log(self, text: str) -> str:
        self._node.get_logger().info(text)
        return text

    def _on_push(self, message: WrenchStamped) -> None:
        self._push(numbers_of(message.wrench)[:3], message.header.frame_id or "base_link")

    def _on_push_service(self, request: Any) -> str:
        return self._push(np.asarray(self._value("push.force"), dtype=np.float64), str(self._value("push.body")))

    def _on_pause(self, request: Any) -> str:
        self._pause(request.data)
        return "paused" if request.data else "running"

    def _on_hang(self, request: Any) -> str:
        state = self._drivers.state
        if request.data == (state == topics.HANGING):
            return f"the robot {'hangs' if request.data else 'does not hang'} already"
        if not self._drivers.movable:
            raise CommandError(f"hang refused: the drivers are '{state}'; request mode damp, then off")
        return self._start_over(request.data)

    def _start_over(self, hanging: bool) -> str:
        self._restart(hanging)
        return "the robot hangs, feet in the air" if hanging else "the robot is back at its start, held"

    def _on_obstacle(self, request: Any) -> str:
        if not request.data:
            self._plant.obstacle.remove()
            return self._log("no obstacle")
        place = self._value("obstacle.place")
        if len(place) != 2:
            raise CommandError(f"obstacle.place: expected x and y, found {len(place)} numbers")
        self._plant.obstacle.place(float(place[0]), float(place[1]))
        return self._log(f"obstacle at ({place[0]:g}, {place[1]:g}) m")

    def _on_inject(self, request: Any) -> str:
        scenario = str(self._value(SCENARIO))
        if not scenario.strip():
            raise CommandError(f"the parameter {SCENARIO} is empty: set it to YAML, a file or a scenario")
        return self._plant.faults.inject(scenario)
