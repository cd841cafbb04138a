"""Robot side as a real-time process: ``GantryRobot`` behind Unitree's SDK or behind rclpy.

    python -m benchmarks.graph.unitree_side sdk|ros INTERFACE DOMAIN [ROBOT [RATE [SPEED [SEED [DEVIATION]]]]]

ROBOT is a profile, RATE the rate of states and commands [Hz], SPEED the speed of the robot's time over real time, SEED
the seed of the sensor noise, DEVIATION the difference from the profile (``bridge/plants/deviation.py``, JSON).
``sdk`` uses the package ``far-unitree-sdk``: Unitree's C++ SDK with CycloneDDS in the role of the robot, in DDS domain
0. ``ros`` publishes the same messages with this project's codec, and the remote controller, which the SDK lacks.
Each line on the standard input is a call of ``Program`` in JSON, ``["name", arguments...]``; a line answers it.
"""

import json
import os
import select
import sys
import time
from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np

from bridge.plants.deviation import Deviation
from bridge.plants.gantry import STEP
from bridge.plants.unitree.codec import ENABLED
from bridge.plants.unitree.simulated import GantryRobot
from bridge.plants.unitree.wire import LOW_CMD
from models.config import parse_config
from models.nodes.realtime import use_fifo
from models.types import JointCommand

PRIORITY = 50  #: SCHED_FIFO priority, above the graph, where permitted
LAG = 10  #: Steps without a new command after which the time of a slowed robot waits for one [ms]
WAIT = 0.02  #: Longest wait after each state, below the driver's limit for silent states [s]
LOOPBACK = """<CycloneDDS><Domain Id="any"><General><Interfaces>
<NetworkInterface name="lo" multicast="false"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>
<Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>"""


class TimedSide:
    """Robot side with a network that can be disconnected; records the times of received commands."""

    def __init__(self, robot: Any) -> None:
        self._robot = robot
        self.connected = True
        self.published = 0.0  #: Time of the latest state [s]
        self.answers: list[float] = []  #: Times from a state to the command computed from it [s]
        self.gaps: list[float] = []  #: Times between two commands [s]
        self._last = 0.0

    def receive(self, data: bytes, since: float | None) -> None:
        """Receive a command; ``since`` is the publication time of the state it was computed from [s]."""
        if not self.connected:
            return
        now = time.monotonic()
        self._robot.receive(data)
        if since is not None:
            self.answers.append(now - since)
        self.gaps.append(now - self._last)
        self._last = now


class SdkSide:
    """Robot side with Unitree's SDK; its motion switcher always answers that no controller is active."""

    def __init__(self, robot: GantryRobot, interface: str, domain: int) -> None:
        if domain:
            raise SystemExit("the SDK's robot is in domain 0")
        sdk: Any = import_module("unitree_interface")  # the stubs lack the calls for the robot side
        self._robot = robot
        kind = sdk.MessageType.HG
        create = sdk.UnitreeInterface.create_g1
        self._side = create(interface, kind, dds_config=LOOPBACK) if interface == "lo" else create(interface, kind)
        self._side.enable_motion_switcher_responder()
        self._state = sdk.LowState(robot.model.nj)
        self._last: Any = None

    def exchange(self) -> None:
        """Publish the present state."""
        robot, state = self._robot, self._state
        sensors = robot.read()
        state.tick, state.mode_machine = robot.tick, robot.mode_machine
        state.motor.q, state.motor.dq, state.motor.tau_est = (
            sensors.q.tolist(),
            sensors.v.tolist(),
            sensors.tau.tolist(),
        )
        state.motor.temperature, state.motor.voltage = robot.temperature.tolist(), robot.voltage.tolist()
        state.imu.omega, state.imu.accel = sensors.gyro.tolist(), sensors.accel.tolist()
        state.imu.quat = robot.imu_quaternion.tolist()
        self._side.publish_low_state(state)

    def take(self) -> None:
        """Receive the latest command."""
        given = self._side.read_incoming_command()
        rows = [given.q_target, given.dq_target, given.tau_ff, given.kp, given.kd]
        if rows != self._last:
            self._last = rows
            values = np.array(rows)
            if values[2:].any():  # zeros before the first command
                self._robot.vendor = ""
                self._robot.accept(JointCommand(*values))


class RosSide(TimedSide):
    """Robot side with rclpy."""

    def __init__(self, robot: GantryRobot, interface: str, domain: int) -> None:
        from rclpy.qos import QoSProfile, ReliabilityPolicy

        from bridge.plants.participant import SENSOR, ignore, join
        from bridge.plants.unitree.link import RELEASE, VERSION
        from models.nodes.interfaces import interface as find

        super().__init__(robot)
        _, self._node = join(domain, "robot")
        best = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._states = self._node.create_publisher(find("unitree_hg", "msg", "LowState"), "lowstate", best)
        self._kind = find("unitree_hg", "msg", "LowCmd")
        self._commands = self._node.create_subscription(self._kind, "lowcmd", ignore, SENSOR, raw=True)
        request, self._response = (find("unitree_api", "msg", name) for name in ("Request", "Response"))
        self._requests = self._node.create_subscription(request, "api/motion_switcher/request", ignore, 10)
        self._responses = self._node.create_publisher(self._response, "api/motion_switcher/response", 10)
        self._other: Any = None  # publisher of another program's commands
        self.other = False
        self._version, self._release = VERSION, RELEASE
        self.sent: dict[int, float] = {}  #: Publication time of the states by tick [s]

    def exchange(self) -> None:
        """Publish the present state, and the commands of another program if enabled."""
        data = self._robot.state()
        if self.other:
            self._other = self._other or self._node.create_publisher(self._kind, "lowcmd", 1)
            record = LOW_CMD.new()
            record["mode_machine"] = self._robot.mode_machine
            motors = record["motor_cmd"][: self._robot.model.nj]
            motors["mode"], motors["kd"] = ENABLED, self._robot.model.kd
            self._other.publish(LOW_CMD.write(record))
        if self.connected:
            self.sent[self._robot.tick] = time.monotonic()
            self._states.publish(data)
            if len(self.sent) > 100:
                del self.sent[next(iter(self.sent))]

    def take(self) -> None:
        """Receive the commands and requests since the last call."""
        from bridge.plants.participant import take, take_all

        for data in take_all(self._commands):
            self.receive(data, self.sent.get(int(LOW_CMD.read(data)["reserve"][1])))
        while (request := take(self._requests)) is not None:
            response = self._response()
            response.header.identity = request.header.identity
            if request.header.identity.api_id == self._release:
                self._robot.vendor = ""
            response.data = json.dumps({"form": "0", "name": self._robot.vendor})
            if request.header.identity.api_id == self._version:
                response.data = self._robot.switcher_version
            self._responses.publish(response)


class Program:
    """Paces the robot and answers the calls on the standard input.

    With ``speed`` below 1 this machine is known to be too slow for the graph. The time of a robot that stands without
    rope then also waits for late commands: each state waits up to ``WAIT``.
    """

    def __init__(self, robot: Any, make_side: Callable[[Any], Any], speed: float = 1.0) -> None:
        self._answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
        os.dup2(2, 1)  # keeps the output of the SDK out of the answers
        self.robot = robot
        self.side = make_side(robot)
        self.speed = speed
        self.late = 0.0  # delay of the physics behind the clock [s]
        self.skipped = 0
        self._buffer = b""
        self._done = False
        self._received = self._received_at = 0  # count of received commands, and tick of the newest
        self._waiting = (0, 0.0)  # tick that waits for a command, and monotonic end of the wait [s]
        self._stopped_at: int | None = None  # tick of the stop
        self.stop_ms: int | None = None  #: Time from the stop to the first command without stiffness, in ticks [ms]

    def run(self) -> None:
        """Step the robot in real time until the end of the input."""
        use_fifo(PRIORITY, lambda text: print(text, file=sys.stderr, flush=True))  # a real robot has its own computer
        period = STEP / self.speed
        due = time.monotonic()
        while not self._done:
            self.side.take()
            if self._stopped_at is not None and self._limp:
                self.stop_ms, self._stopped_at = self.robot.tick - self._stopped_at, None
            if self._waits:
                time.sleep(0.5 * period)
                continue
            self.robot.step()
            if self.robot.due:
                self.side.exchange()
                self._serve()
            due += period
            now = time.monotonic()
            if now < due:
                time.sleep(due - now)
            elif now - due > 0.005:  # the robot's time waits: a real robot has no other programs
                self.late += now - due
                self.skipped += 1
                due = now

    def _serve(self) -> None:
        while select.select([0], [], [], 0.0)[0]:
            data = os.read(0, 65536)
            if not data:
                self._done = True
                return
            self._buffer += data
            while b"\n" in self._buffer:
                line, self._buffer = self._buffer.split(b"\n", 1)
                name, *arguments = json.loads(line)
                self._answers.write(json.dumps(getattr(self, name)(*arguments)) + "\n")
                self._answers.flush()

    @property
    def _waits(self) -> bool:
        """Whether the robot's time waits for a late command."""
        robot = self.robot
        if robot.received != self._received:
            self._received, self._received_at = robot.received, robot.tick
        if self.speed >= 1.0 or robot.hooked or self._limp or not robot.due or robot.tick - self._received_at <= LAG:
            return False
        if self._waiting[0] != robot.tick:
            self._waiting = robot.tick, time.monotonic() + WAIT
        return time.monotonic() < self._waiting[1]

    @property
    def _limp(self) -> bool:
        command = self.robot.command
        return command is not None and command.kp is not None and not command.kp.any()

    def stop(self, name: str, *arguments: Any) -> Any:
        """Call a method that must stop the robot; ``stop_ms`` counts from this call."""
        self._stopped_at = self.robot.tick
        return getattr(self, name)(*arguments)

    def report(self) -> dict[str, Any]:
        """Return true state and counts."""
        answers = np.array(getattr(self.side, "answers", []) or [np.nan])
        gaps = np.array(getattr(self.side, "gaps", [])[1:] or [np.nan])
        command = self.robot.command
        return {
            "t": self.robot.tick * STEP,
            "base": self.robot.base.round(5).tolist(),
            "heading": self.robot.heading,
            "load": self.robot.plant.load,
            "received": self.robot.received,
            "refused": self.robot.refused,
            "vendor": getattr(self.robot, "vendor", ""),
            "late": self.late,
            "stalls": self.skipped,
            "answer_ms": [round(1e3 * float(np.nanpercentile(answers, q)), 2) for q in (50, 99, 100)],
            "stop_ms": self.stop_ms,
            "gap_ms": [round(1e3 * float(np.nanpercentile(gaps, q)), 2) for q in (50, 99, 100)],
            "kp": 0.0 if command is None or command.kp is None else float(np.max(command.kp)),
            "kd": 0.0 if command is None or command.kd is None else float(np.max(command.kd)),
        }

    def set(self, name: str, value: Any) -> bool:
        """Set an attribute of the robot."""
        setattr(self.robot, name, value)
        return True

    def press(self, *buttons: int) -> bool:
        """Press buttons of the remote controller."""
        self.robot.press(*buttons)
        return True

    def connect(self, connected: bool) -> bool:
        """Connect or disconnect the network (ros only)."""
        self.side.connected = connected
        return True

    def other(self, on: bool) -> bool:
        """Start or end another program that damps the robot at every state (ros only)."""
        self.side.other = on
        return True

    def tie(self) -> bool:
        """Tie the rope to the robot at its present position."""
        self.robot.tie()
        return True

    def push(self, x: float, y: float, z: float, duration: float) -> bool:
        """Push the base at its CoM with a force in W [N] for a time [s]."""
        self.robot.plant.push((x, y, z), duration)
        return True

    def fill(self, name: str, value: float) -> bool:
        """Fill an array of the robot, such as its temperatures."""
        getattr(self.robot, name)[:] = value
        return True

    def clear(self) -> bool:
        """Discard the latencies recorded so far."""
        if hasattr(self.side, "answers"):
            self.side.answers.clear()
            self.side.gaps.clear()
        self.late, self.skipped = 0.0, 0
        return True


def main(
    kind: str,
    where: str,
    domain: str,
    robot: str = "g1",
    rate: str = "500",
    speed: str = "1",
    seed: str = "0",
    deviation: str = "{}",
) -> None:
    """Run the robot and its side until the end of the input."""
    side = {"sdk": SdkSide, "ros": RosSide}[kind]
    differs = parse_config(Deviation, json.loads(deviation), "deviation")
    gantry = GantryRobot(robot, rate=float(rate), seed=int(seed), deviation=differs, released=kind == "sdk")
    Program(gantry, lambda robot: side(robot, where, int(domain)), float(speed)).run()


if __name__ == "__main__":
    main(*sys.argv[1:])
