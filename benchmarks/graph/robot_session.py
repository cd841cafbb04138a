"""Session of a complete graph and its robot (another process or the simulated plant), with one interface."""

from __future__ import annotations

import os
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import TypeVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock

from benchmarks.graph.graph_kinds import User
from benchmarks.graph.robot_process import UNITREE_SIDE, RobotProcess
from bridge.launch.graph import Graph
from bridge.launch.hardware import hardware_options
from bridge.launch.layout import process_specs
from bridge.plants.unitree.codec import BUTTONS, PRESS_IT
from models.errors import PoiseError
from models.heading import heading, turned
from models.nodes import topics
from models.nodes.cdr import NANOSECONDS, numbers_of
from models.nodes.messages import stamp_ns
from models.nodes.qos import EVENT, LATCHED, SENSOR
from models.nodes.status import subscribe_status
from models.status import StartStatus
from models.types import Vector

START_TIME = 90.0  #: Maximum wait for a robot to stand at the start [s]
MODE_TIME = 60.0  #: Maximum wait for another mode change [s]
SLOWEST = 0.1  #: Minimum speed of the robot's time [-]

SessionT = TypeVar("SessionT", bound="Session")


def pose_of(message: Odometry) -> tuple[Vector, float]:
    """Return position (3,) [m] and heading [rad] of an odometry message."""
    pose = message.pose.pose
    return numbers_of(pose.position), heading(*numbers_of(pose.orientation))


class Session(ABC):
    """Graph and robot; entering the context starts them, leaving it ends them.

    Attributes:
        odometry: Latest estimated position of the base (2,) [m] and heading [rad].
        base: Latest true position of the base (3,) [m] and heading [rad], set by ``update``.
        t: Robot time [s], set by ``update``.
    """

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.odometry: tuple[Vector, float] = (np.zeros(2), 0.0)
        self.base: tuple[Vector, float] = (np.full(3, np.nan), np.nan)
        self.t = 0.0
        self._values: dict[str, str] = {}

    def __enter__(self: SessionT) -> SessionT:
        self.graph.__enter__()
        node = self.graph.node
        node.create_subscription(Odometry, topics.ODOM, self._on_odometry, SENSOR)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self._user = User(self.graph)
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.graph.close()

    @abstractmethod
    def stand(self) -> None:
        """Bring the robot from its start to standing by itself."""

    @abstractmethod
    def update(self) -> None:
        """Update ``t`` and ``base``."""

    @abstractmethod
    def push(self, force: Vector, duration: float) -> None:
        """Push the base with a force in W (3,) [N] for a time [s]."""

    def value(self, name: str) -> str:
        """Return the latest value in the diagnostics of the driver; empty before the first one."""
        return self._values.get(name, "")

    def number(self, name: str) -> float:
        """Return ``value`` as a number; ``PoiseError`` if it is not a number."""
        try:
            return float(self.value(name))
        except ValueError as error:
            raise PoiseError(
                f"'{name}' in the diagnostics of the driver is not a number: '{self.value(name)}'"
            ) from error

    def pass_time(self, time_s: float) -> None:
        """Spin until the robot time has advanced; it may be slower than real time on a busy machine."""
        self.update()
        end, give_up = self.t + time_s, time.monotonic() + time_s / SLOWEST + MODE_TIME
        while self.t < end:
            self.graph.spin(0.1)
            self.update()
            if time.monotonic() > give_up:
                raise PoiseError("the robot's time does not advance fast enough")

    def walk(self, speed: float, time_s: float, pause_s: float) -> tuple[Vector, Vector]:
        """Walk, stop and pause.

        Returns:
            True and estimated displacement (2,) [m], in the true and in the estimated initial heading.
        """
        (begin, yaw), (estimated, yaw_estimated) = self.base, self.odometry
        self._user.walk(speed)
        self.pass_time(time_s)
        self._user.walk(None)
        self._reach_mode("stand")
        self.pass_time(pause_s)
        return turned((self.base[0] - begin)[:2], -yaw), turned(self.odometry[0] - estimated, -yaw_estimated)

    def drift(self, time_s: float) -> Vector:
        """Stand for a time [s]; return the displacement (3,) [m]."""
        self.update()
        begin, _ = self.base
        self.pass_time(time_s)
        return self.base[0] - begin

    def send(self, motion: str) -> None:
        """Start a motion and wait for its end."""
        self.graph.send(motion)
        for mode in ("motion", "stand"):
            self._reach_mode(mode)

    def _reach_mode(self, mode: str) -> None:
        self.graph.wait_for(lambda: self.graph.mode == mode, MODE_TIME, f"mode {mode}")

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "/robot_driver":
                self._values = {item.key: item.value for item in status.values}

    def _on_odometry(self, message: Odometry) -> None:
        position, yaw = pose_of(message)
        self.odometry = (position[:2], yaw)


class SimulatedSession(Session):
    """Graph with the simulated plant, which uses the robot of the control laws."""

    def __init__(self, robot: str, folder: Path, *, domain: int, seed: int, speed: float, push_time: float) -> None:
        self._push_time = push_time
        driver = {"seed": seed, "speed": speed, "push.duration": push_time}
        super().__init__(
            Graph(
                robot, domain_id=domain, parameters={"robot_driver": driver}, log=folder / "graph.log",
                say=lambda text: None,
            )
        )  # fmt: skip

    def __enter__(self) -> SimulatedSession:
        super().__enter__()
        node = self.graph.node
        node.create_subscription(Clock, topics.CLOCK, self._on_clock, SENSOR)
        node.create_subscription(Odometry, topics.GROUND_TRUTH, self._on_truth, SENSOR)
        self._pushes = node.create_publisher(WrenchStamped, topics.PUSH, EVENT)
        return self

    def stand(self) -> None:
        self.graph.wait_standing(START_TIME)

    def update(self) -> None:
        pass  # set by callbacks

    def push(self, force: Vector, duration: float) -> None:
        if duration != self._push_time:
            raise PoiseError(f"pushes of this session last {self._push_time:g} s, not {duration:g} s")
        message = WrenchStamped()
        message.header.frame_id = topics.BASE_FRAME
        message.wrench.force.x, message.wrench.force.y, message.wrench.force.z = map(float, force)
        self._pushes.publish(message)

    def _on_clock(self, message: Clock) -> None:
        self.t = stamp_ns(message.clock) / NANOSECONDS

    def _on_truth(self, message: Odometry) -> None:
        self.base = pose_of(message)


class HardwareSession(Session):
    """Graph of a real robot with a ``RobotProcess`` as robot side, which receives ``side`` and ``options``.

    Attributes:
        robot: Process of the robot side.
        start: Latest state of the start; empty before the first one.
    """

    def __init__(
        self,
        side: str,
        folder: Path,
        *options: object,
        graph_domain: int,
        interface: str = "lo",
        robot_interface: str = "lo",
        robot_domain: int = 0,
        rate: int | None = 500,
        command: Sequence[str] = (),
        plant: str = "unitree",
        robot: str = "g1",
        plant_options: str = "",
        module: str = UNITREE_SIDE,
    ) -> None:
        os.environ["XDG_STATE_HOME"] = str(folder / "state")
        os.environ["ROS_DOMAIN_ID"] = str(graph_domain)
        self.start = StartStatus("")
        self.robot = RobotProcess(
            side, robot_interface, folder, *options, command=command, domain=robot_domain, module=module
        )
        try:
            profile, given = hardware_options(plant, robot, interface, robot_domain, rate, plant_options)
            driver = {"plant": plant, "plant_options": given["plant_options"]}
            super().__init__(
                Graph(
                    profile,
                    domain_id=graph_domain,
                    specs=given["robot_network"].processes(process_specs("shared"), profile),
                    parameters={"robot_driver": driver, **given["rates"]},
                    log=folder / "graph.log",
                    say=lambda text: None,
                )
            )
        except BaseException:
            self.robot.close()
            raise

    def __enter__(self) -> HardwareSession:
        try:
            super().__enter__()
        except BaseException:
            self.robot.close()
            raise
        subscribe_status(self.graph.node, StartStatus, topics.START_STATUS, self._on_start, LATCHED)
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        try:
            super().__exit__(kind, error, trace)
        finally:
            self.robot.close()

    @property
    def waits_for(self) -> str:
        """Condition that the start waits for, with its reason; empty before the first state."""
        return self.start.waits_for

    def reach(self, state: str, limit: float = MODE_TIME) -> None:
        """Wait for a state of the start."""
        self.graph.wait_for(lambda: self.start.state == state, limit, f"state {state}")

    def stand(self) -> None:
        """Go from the gantry to standing without rope; press the stop button if the start asks for it."""
        self.wait_for(lambda: PRESS_IT in self.waits_for or self.start.state == "gantry", "ready to start")
        if self.start.state != "gantry":
            self.robot("press", BUTTONS.index("B"))
            self.wait_for(lambda: "button B of" in self.waits_for, "reporting the pressed button")
            self.robot("press")
        self.reach("gantry")
        self._call(f"{topics.START}confirm_gantry")
        self.reach("hanging")
        self._call(f"{topics.START}lower")
        self.robot("set", "rope_speed", 0.05)
        self.graph.wait_standing(START_TIME)
        self.pass_time(1.0)
        self.robot("set", "hooked", False)

    def update(self) -> None:
        report = self.robot("report")
        self.t, self.base = report["t"], (np.array(report["base"]), report["heading"])

    def push(self, force: Vector, duration: float) -> None:
        self.robot("push", *map(float, force), duration)

    def wait_for(self, condition: Callable[[], bool], what: str) -> None:
        """Spin until a condition is met; ``PoiseError`` with ``what`` after ``MODE_TIME``."""
        self.graph.wait_for(condition, MODE_TIME, what)

    def _call(self, name: str) -> None:
        accepted, answer = self.graph.call(name)
        if not accepted:
            raise PoiseError(f"{name} refused: {answer}")

    def _on_start(self, status: StartStatus) -> None:
        self.start = status
