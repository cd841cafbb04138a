"""Plant of a robot behind ros2_control."""

from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np
from msgspec.structs import replace

from bridge.plants.hardware import CLOSED, Finding, ForeignCommands, Level, RealPlant, RobotClock, real_robot
from bridge.plants.ros2_control.commands import GUARD, command_codec, driver_mark
from bridge.plants.ros2_control.config import COMMAND, FEET, IMU, JOINTS, read_config, sources
from bridge.plants.ros2_control.link import ControlLink, Message, RosLink
from bridge.plants.ros2_control.sensors import ImuDecoder, JointStateDecoder, WrenchDecoder
from controllers.estimation.assembler import SampleAssembler
from models.constants import NANOSECONDS
from models.errors import MessageError, PoiseError
from models.nodes.cdr import stamp_of
from models.robot_model import RobotModel
from models.types import JointCommand, SensorData

NANOSECOND = 1.0 / NANOSECONDS  #: [s]
ACTIVE = "active"  #: State of a controller that runs


class Ros2ControlPlant(RealPlant):
    """Broadcasters in, commands of one controller out, on the clock of the stamps of the joint states.

    Each sample has one joint state; IMU and foot samples are assigned to it by their stamps. ``close`` damps the joints
    and leaves an effort controller at zero torque, because it keeps the last command without a timeout. A file in the
    user's state folder marks a driver that has commanded the robot and not been closed: ``crashed``.

    Args:
        model: The robot; feet with sensors need broadcasters.
        network_interface: This computer's interface to the robot; only for messages.
        domain: DDS domain of the robot.
        marker: File that marks an unfinished run; empty for the default of interface and domain.
        link: Connection to the robot; over DDS when None.
        options: Values that replace those of ``bridge/config/ros2_control.yaml``, by nested keys.

    Raises:
        ConfigError: A wrong option.
        MessageError: Message types are not built.
    """

    guard_process = "bridge.plants.ros2_control.guard:connect"

    def __init__(
        self,
        model: RobotModel,
        network_interface: str = "lo",
        domain: int = 0,
        marker: str = "",
        link: ControlLink | None = None,
        **options: Any,
    ) -> None:
        self.config = config = read_config(options)
        self._domain, self._where = domain, f"{network_interface}, domain {domain}"
        super().__init__(model, "ros2_control", f"{network_interface}-{domain}", marker, 1.0 / config.rate)
        self._clock = RobotClock(self._period, real_robot().gap_max, NANOSECOND, 1 << 63)
        self._sources = sources(model)
        self._needed = [config.controllers[source] for source in (*self._sources, COMMAND)]  # required controllers
        self._joints, self._imu = JointStateDecoder(model), ImuDecoder(model, config.imu_distance_max)
        self._feet = [WrenchDecoder(model, foot) for foot in range(len(FEET))]
        age, gap = (round(limit * NANOSECONDS) for limit in (config.part_age_max, real_robot().gap_max))
        self._assembler = SampleAssembler(age, gap, feet=FEET[0] in self._sources)
        self._mark = driver_mark()
        self._codec = command_codec(model, config, self._mark)
        self._foreign = ForeignCommands("command", config.foreign_commands)
        self._in_force = b""  # last command of this driver or its guard
        self._others: Finding | None = None  # commands of other programs
        self._samples: list[SensorData] = []  # complete samples, not read yet
        self._t = 0.0  # time of the newest joint state [s]
        self._seen: dict[str, int] = {}  # stamp of the newest message by source [ns]
        self._restarts_seen = 0
        self.refused = Counter[str]()  #: Refused messages, by source
        self._why: dict[str, str] = {}  # error of the last refused message, by source
        self._link: ControlLink = RosLink(domain, config, self._sources, self._codec.kind) if link is None else link

    def read(self) -> SensorData:
        self._stop, self._jumped = "", False
        if self._closed:
            return self._sensors
        self.guard.step(self._link.beats(), commanded=self._marker.made)
        commands = [(self._codec.mark(data), data) for data in self._link.commands()]
        ours = [each for each in commands if each[0] in (self._mark, GUARD)]
        if ours and ours[-1][0] == GUARD:  # this driver hung
            self._in_force = ours[-1][1]
        self._others = self._foreign.step(len(commands) - len(ours), self._period)
        self._gather()
        samples, self._samples = self._samples, []
        self.counter.idle(arrived=bool(samples))
        for sample in samples:
            self.counter.step(sample.t)
            self._sensors = sample
        self._stop = self._reason_to_stop()
        return self._sensors

    def mark(self, data: bytes) -> str:
        """Mark of the sender in a serialised command."""
        return self._codec.mark(data)

    @property
    def arrived(self) -> bool:
        """Whether a complete sample has arrived since the last ``read``."""
        if not self._samples and not self._closed:
            self._gather()
        return bool(self._samples)

    def _gather(self) -> None:
        """Process the received messages; invalid ones are counted."""
        for message in sorted(self._link.take(), key=_order):
            try:
                self._add(message)
            except PoiseError as error:
                self.refused[message[0]] += 1
                self._why[message[0]] = str(error)

    def _add(self, message: Message) -> None:
        source, data = message
        if source == JOINTS:
            stamp, *joints = self._joints.decode(data)
            self._t = self._clock.step(stamp)
            if self._clock.restarts > self._restarts_seen:
                self._assembler.reset()
                self._seen.clear()
            sample = self._assembler.add_joints(stamp, *joints)
        elif source == IMU:
            stamp, gyro, accel = self._imu.decode(data)
            sample = self._assembler.add_imu(stamp, gyro, accel)
        else:
            foot = FEET.index(source)
            stamp, wrench = self._feet[foot].decode(data)
            sample = self._assembler.add_foot(foot, stamp, wrench)
        self._seen[source] = stamp
        self._why.pop(source, None)
        if sample is not None:
            self._samples.append(replace(sample, t=self._t))

    def _reason_to_stop(self) -> str:
        if self._clock.restarts > self._restarts_seen:
            self._restarts_seen, self._jumped = self._clock.restarts, True
            return "the robot's clock has jumped: it was restarted"
        if self.counter.silence > self.config.silent_max and JOINTS in self._why:
            return f"{JOINTS}: refused: {self._why[JOINTS]}"
        for source, age in self._ages().items():
            if age > self.config.silent_max:
                return f"{source}: the newest message is {age:.3f} s older than the joint states"
        if self._others is not None and self._others.level is Level.DAMP:
            return self._others.reason
        if self._marker.made and (inactive := self._inactive()):
            return "; ".join(inactive)
        return ""

    def _ages(self) -> dict[str, float]:
        """Age of the newest message of each source, relative to the joint states [s]."""
        joints = self._seen.get(JOINTS, 0)
        return {source: (joints - stamp) * NANOSECOND for source, stamp in self._seen.items() if source != JOINTS}

    def _inactive(self) -> list[str]:
        """Advice for each required controller that is not active; empty while unknown."""
        states = self._link.controllers()
        if states is None:
            return []
        return [self._advice(name, states.get(name)) for name in self._needed if states.get(name) != ACTIVE]

    def _advice(self, name: str, state: str | None) -> str:
        """Error of a controller, and the command that fixes it, in the robot's domain."""
        manager = "" if self.config.manager == "/controller_manager" else f" -c {self.config.manager}"
        begin = f"ROS_DOMAIN_ID={self._domain} ros2 control"
        if state is None:
            return f"controller '{name}' is not loaded: {begin} load_controller{manager} --set-state active {name}"
        return f"controller '{name}' is {state}: {begin} switch_controllers{manager} --activate {name}"

    def _encode_command(self, command: JointCommand) -> bytes:
        """Serialised message of a command for the newest state.

        Without a state for ``state_age_max``, an effort controller gets the feed-forward torque without feedback, which
        would act on an old velocity.
        """
        if self._codec.evaluated and self.counter.silence > self.config.state_age_max:
            command = JointCommand.torque(command.tau)
        stamp, sensors = self._seen.get(JOINTS, 0), self._sensors
        self._in_force = self._codec.encode(stamp, command, sensors.q, sensors.v, self._in_force)
        return self._in_force

    def _decode_command(self, data: bytes) -> JointCommand:
        return self._codec.decode(data)

    @property
    def evaluates(self) -> bool:
        return not self._codec.evaluated

    def executed(self, command: JointCommand) -> JointCommand:
        return self._codec.executed(command)

    def _finish(self) -> None:
        """Leave an effort controller at zero torque, unless the guard process continues to damp."""
        if self._codec.evaluated and (not self.guard.armed or self.guard.holds):
            zero = np.zeros(self._model.nj)
            self._link.send(self._codec.encode(self._seen.get(JOINTS, 0), JointCommand.torque(zero), zero, zero))

    @property
    def findings(self) -> tuple[str, ...]:
        """Failed checks of messages and controllers."""
        if self._closed:
            return (CLOSED,)
        topics, found = self.config.topic_of, []
        for source in self._sources:
            if source in self._why:
                found.append(f"{self.refused[source]} messages of {source} refused: {self._why[source]}")
            elif source not in self._seen:
                found.append(f"no message of {source} on '{topics[source]}' ({self._where})")
        if self._t:
            found += self._doubtful
            found += self.guard.warnings
            found += self.counter.findings("complete samples")
            found += self.guard.holds
        if self.config.controller_manager:
            if self._link.controllers() is None:
                found.append(f"'{self.config.manager}/list_controllers' does not answer ({self._where})")
            found += self._inactive()
        if self.config.command == "feedback":
            found += self._order_findings()
        if self._others is not None:
            found.append(self._others.reason)
        return tuple(found)

    def _order_findings(self) -> list[str]:
        order, mine = self._link.joint_order(), list(self._model.joint_names)
        if order is None:
            return [f"no message on '{self.config.topic_of['state']}' ({self._where})"]
        if list(order) == mine:
            return []
        other = [name for name in order if name not in mine] or [name for name in mine if name not in order]
        what = f"only one of them has '{other[0]}'" if other else "the order differs"
        name = self.config.controllers[COMMAND]
        return [
            f"controller '{name}' has other joints than robot '{self._model.name}': {what}; "
            f"configure it with the file that 'poise controllers' writes"
        ]

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why the command controller is not known to be active."""
        if self.vendor is not None:
            return ()
        return (*self._inactive(), f"controller '{self.config.controllers[COMMAND]}' is not known to be active")[:1]

    @property
    def own_controller(self) -> str:
        """Empty: ros2_control has no vendor's controller."""
        return ""

    @property
    def vendor(self) -> str | None:
        """Empty while the command controller is active, because no other one can command its joints; else None."""
        if self._closed:
            return None
        if not self.config.controller_manager:
            return ""
        states = self._link.controllers()
        return "" if states is not None and states.get(self.config.controllers[COMMAND]) == ACTIVE else None

    def release_vendor(self) -> None:
        """No effect: the operator activates the command controller."""

    def hand_over(self) -> None:
        """No effect: no other controller becomes active by itself."""

    @property
    def _doubtful(self) -> tuple[str, ...]:
        """Warnings: sources without a message of the newest sample's stamp, and commands of other programs."""
        rate = self.config.rate
        mixed = (
            f"{source}: no message with the stamp of the joint states; its broadcaster must run at {rate:g} Hz"
            for source in self._assembler.mixed
        )
        return *mixed, *self._others_at(Level.WARN)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Samples of several stamps, commands of other programs, and warnings of ``RealPlant``."""
        return *self._doubtful, *super().warnings

    @property
    def holds(self) -> tuple[str, ...]:
        """Commands of other programs and holds of the guard; temperatures and voltages have no standard topics."""
        return *self._others_at(Level.HOLD), *super().holds

    @property
    def foreign(self) -> bool:
        return self._others is not None

    def _others_at(self, level: Level) -> tuple[str, ...]:
        return () if self._others is None or self._others.level is not level else (self._others.reason,)

    @property
    def report(self) -> Mapping[str, str]:
        """Counts of messages."""
        assembler = self._assembler
        inactive = "unknown" if self._link.controllers() is None else "; ".join(self._inactive()) or "none"
        return {
            **self.guard.values,
            "state rate [Hz]": f"{self.counter.rate:.0f}",
            "states lost": str(self.counter.lost),
            "samples of several stamps": str(assembler.incomplete),
            "messages refused": ", ".join(f"{source} {n}" for source, n in self.refused.items()) or "0",
            "restarts of the robot": str(self._clock.restarts),
            "inactive controllers": inactive,
        }


def _order(message: Message) -> tuple[int, bool]:
    """Sort key: the stamp, with joint states after the other messages of a stamp."""
    source, data = message
    try:
        return stamp_of(data), source == JOINTS
    except MessageError:
        return 0, False
