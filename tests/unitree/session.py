"""The whole graph of a real robot against the robot's side in another process, for tests and measurements."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry

from bridge.launch.graph import Graph
from bridge.launch.hardware import hardware_options
from bridge.ros.processes import process_specs
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.qos import LATCHED, SENSOR
from models.nodes.status import subscribe_status
from models.status import StartStatus

LOOPBACK = Path(__file__).resolve().parents[2] / "bridge" / "config" / "loopback.xml"


class RobotProcess:
    """A ``module`` such as ``tests.unitree.process``, called over its pipes; ``command`` runs it on another machine."""

    def __init__(
        self,
        side: str,
        interface: str,
        folder: Path,
        *numbers: object,
        command: Sequence[str] = (),
        domain: int = 0,
        module: str = "tests.unitree.process",
    ) -> None:
        environment: Mapping[str, str] = os.environ
        if interface == "lo":
            local = {"FASTRTPS_DEFAULT_PROFILES_FILE": str(LOOPBACK), "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT"}
            environment = {**os.environ, **local}
        self._errors = (folder / "robot.log").open("wb")
        words = [sys.executable, "-m", module, side, interface, str(domain), *map(str, numbers)]
        self._process = subprocess.Popen(
            [*command, *words], env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._errors,
            text=True,
        )  # fmt: skip

    def __call__(self, name: str, *arguments: object) -> Any:
        """Call a method of ``Program``; returns its answer."""
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(json.dumps([name, *arguments]) + "\n")
        self._process.stdin.flush()
        if line := self._process.stdout.readline():
            return json.loads(line)
        raise AssertionError("the robot's process has ended")

    def close(self) -> None:
        self._process.terminate()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout, self._errors):
            if pipe is not None:
                pipe.close()


class Session:
    """Robot and graph; entering starts both, leaving ends both."""

    def __init__(
        self,
        side: str,
        folder: Path,
        *,
        graph_domain: int,
        interface: str = "lo",
        robot_interface: str = "lo",
        robot_domain: int = 0,
        rate: int | None = 500,
        speed: float = 1.0,
        command: Sequence[str] = (),
        plant: str = "unitree",
        robot: str = "g1",
        plant_options: str = "",
        module: str = "tests.unitree.process",
    ) -> None:
        numbers = [rate, speed] if plant == "unitree" else [robot, plant_options or "{}", speed]
        os.environ["XDG_STATE_HOME"] = str(folder / "state")
        os.environ["ROS_DOMAIN_ID"] = str(graph_domain)
        self.robot = RobotProcess(
            side, robot_interface, folder, *numbers, command=command, domain=robot_domain, module=module
        )
        try:
            profile, given = hardware_options(plant, robot, interface, robot_domain, rate, plant_options)
            self.graph = Graph(
                profile,
                domain_id=graph_domain,
                specs=given["robot_network"].processes(process_specs("shared"), profile),
                parameters={
                    "robot_driver": {"plant": plant, "plant_options": given["plant_options"]}, **given["rates"]
                },
                log=folder / "graph.log",
                say=lambda text: None,
            )  # fmt: skip
        except BaseException:
            self.robot.close()
            raise
        self.start: StartStatus | None = None
        self.odometry = (0.0, 0.0)
        self._values: dict[str, str] = {}

    def __enter__(self) -> Session:
        try:
            self.graph.__enter__()
        except BaseException:
            self.robot.close()
            raise
        subscribe_status(self.graph.node, StartStatus, topics.START_STATUS, self._on_start, LATCHED)
        self.graph.node.create_subscription(Odometry, topics.ODOM, self._on_odometry, SENSOR)
        self.graph.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self._velocity = self.graph.node.create_publisher(Twist, topics.CMD_VEL, 1)
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        try:
            self.graph.close()
        finally:
            self.robot.close()

    def _on_start(self, status: StartStatus) -> None:
        self.start = status

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "/robot_driver":
                self._values = {item.key: item.value for item in status.values}

    def value(self, name: str) -> str:
        """Newest value in the diagnostics of the driver."""
        return self._values.get(name, "")

    def _on_odometry(self, message: Odometry) -> None:
        place = message.pose.pose.position
        self.odometry = (place.x, place.y)

    def reach(self, state: str, limit: float = 60.0) -> None:
        """Wait for a state of the start."""
        self.graph.wait_for(lambda: self.start is not None and self.start.state == state, limit, f"state {state}")

    def call(self, name: str) -> None:
        accepted, answer = self.graph.call(name)
        assert accepted, answer

    def stand(self) -> None:
        """From the gantry to standing without the rope."""
        self.reach("gantry")
        self.call("start/confirm_gantry")
        self.reach("hanging")
        self.call("start/lower")
        self.robot("set", "rope_speed", 0.05)
        self.graph.wait_standing(90.0)
        self.pass_time(1.0)
        self.robot("set", "hooked", False)

    def pass_time(self, time_s: float, act: Callable[[], object] = lambda: None) -> None:
        """Spin until the robot's time has advanced, which waits on a busy machine."""
        begin = self.robot("report")["t"]
        give_up = time.monotonic() + 10.0 * time_s + 60.0
        while self.robot("report")["t"] - begin < time_s:
            act()
            self.graph.spin(0.1)
            if time.monotonic() > give_up:
                raise PoiseError("the robot's time stands still")

    def walk(self, speed: float, time_s: float) -> None:
        """Walk, and come to a stand."""
        message = Twist()
        message.linear.x = speed
        self.pass_time(time_s, lambda: self._velocity.publish(message))
        self.graph.wait_for(lambda: self.graph.mode == "stand", 60.0, "standing after the walk")

    def wave(self) -> None:
        self.graph.send("wave")
        for mode in ("motion", "stand"):
            self.graph.wait_for(lambda mode=mode: self.graph.mode == mode, 60.0, mode)  # type: ignore[misc]
