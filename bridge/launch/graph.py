"""Starts the processes of the graph, activates their nodes in order, restarts crashed ones, and ends them all."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import rclpy
from rclpy.context import Context
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown
from std_msgs.msg import String
from std_srvs.srv import Trigger

from bridge.launch.ending import EndConfig, lower
from bridge.launch.layout import Processes, activation_order, process_specs
from bridge.launch.parameters import Parameters, node_parameters, ros_arguments
from bridge.launch.robot_network import RobotNetwork
from bridge.launch.run import run_until_signal, wait_for
from bridge.ros.client import SETTLE_TIME
from bridge.ros.environment import claim_graph, graph_environment, join_graph
from bridge.ros.lifecycle import ACTIVATE, CONFIGURE, change_state
from bridge.ros.namespace import absolute_namespace
from bridge.ros.processes import GraphProcess, ProcessSpec, stop_all
from controllers.safety.health import SupervisorConfig
from models.config import default_config
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.interfaces import missing_types
from models.nodes.qos import EVENT, LATCHED
from models.nodes.spin import log_arguments, make_executor
from models.nodes.status import subscribe_status
from models.robot_model import RobotModel
from models.status import MotionState, MotionStatus, SupervisorStatus
from planners.library import load_motion, motion_files


def own_motions(robot: str, folder: Path) -> Parameters:
    """Node parameters for a folder of motion files; ``ConfigError`` if empty, or with file and key of an error."""
    model = RobotModel.load(robot)
    names = [load_motion(file, model).name for file in motion_files(folder)]
    known = default_config(SupervisorConfig, "controllers", "supervisor").motions
    motions = {"motions": [*known, *(name for name in names if name not in known)]}
    return {
        "motion_planner": {"motions_folder": str(folder.resolve())},
        "supervisor": motions,
        "action_server": motions,
    }


STARTING = "starting; the first start takes minutes, because the kernels are compiled"
START_TIMEOUT = 900.0  #: Longest wait for the answer of a starting node [s]; the first start compiles
SPIN_TIMEOUT = 0.05  #: Longest wait for a callback between two checks of the processes [s]
RESTARTS_MAX = 5  #: Restarts of one process after which the launcher gives up


class Graph:
    """The running graph, controlled by the process that started it.

    Use it as a context manager: entering starts the processes and activates the nodes, leaving ends them.

    Args:
        robot: Profile, by name or path.
        lockstep: Whether the plant waits for the command of each tick.
        processes: Whether gait planner, controller and estimator share a process.
        domain_id: ROS domain; from the environment when None.
        network: Whether other machines may join.
        parameters: Further parameters by node.
        specs: Processes in start order; from ``process_specs`` when None.
        activation: Nodes in activation order; from ``activation_order`` when None.
        calibration: Folder of the calibration files; when None a temporary one, as the user's may be for another robot.
        log: File for the output of the processes; the output of this process when None.
        namespace: Namespace of every node, topic and service; empty for none.
        say: Called with one line about each event.
        plant: Process of ``robot_driver`` shared by several graphs; this graph detects its end, but does not run it.

    Attributes:
        node: rclpy node of this process, for further topics and services.
        mode: Last published mode; empty before the first.
        driver_state: Last state of the joint drivers; empty before the first.
        refusal: Reason why supervisor or motion planner refused the last text command; empty if they did not.
        exit_codes: Exit code of each process by module, after leaving.
    """

    def __init__(
        self,
        robot: str = "g1",
        *,
        lockstep: bool = False,
        processes: Processes = "shared",
        domain_id: int | None = None,
        network: bool = False,
        parameters: Parameters | None = None,
        specs: Sequence[ProcessSpec] | None = None,
        activation: Sequence[str] | None = None,
        calibration: Path | None = None,
        log: Path | None = None,
        namespace: str = "",
        say: Callable[[str], object] = print,
        plant: GraphProcess | None = None,
    ) -> None:
        self._plant = plant
        self._context = Context()  # a process may hold several graphs
        self._namespace = absolute_namespace(namespace)
        self._folder = tempfile.TemporaryDirectory(prefix="poise_")
        if calibration is None:
            calibration = Path(self._folder.name) / "calibration"
            calibration.mkdir()
        self.mode = self.driver_state = self.refusal = ""
        self._refused: int | None = None  # number of refused text commands in the newest status of the supervisor
        self.exit_codes: dict[str, int | None] = {}
        self._say, self._log = say, log
        self._domain_id, self._network = domain_id, network
        self._specs = list(specs or process_specs(processes))
        self._activation = list(activation or activation_order(self._specs))
        self._parameters = node_parameters(self._specs, robot, lockstep, calibration, parameters or {})
        self._processes: list[GraphProcess] = []
        self._output: IO[bytes] | None = None
        self._robot = robot
        self._claimed: IO[str] | None = None

    def __enter__(self) -> Graph:
        self.open()
        try:
            self.configure()
            self.activate()
        except BaseException:
            self.close()
            raise
        return self

    def claim(self) -> None:
        """Claim domain and namespace on this machine; a ``PoiseError`` names the graph that already runs there."""
        if self._claimed is None:
            self._claimed = claim_graph(self._robot, self._domain_id, self._namespace)

    def open(self) -> None:
        """Join the graph and start the processes; call it before ``configure``, ``activate`` and ``close``."""
        self.claim()
        join_graph(domain_id=self._domain_id, network=self._network)
        rclpy.init(args=log_arguments(), context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node("poise", namespace=self._namespace, context=self._context)
        self._executor = make_executor(self._context)
        self._executor.add_node(self.node)
        self.node.create_subscription(String, topics.MODE, self._on_mode, LATCHED)
        self.node.create_subscription(String, topics.DRIVER_STATE, self._on_driver_state, LATCHED)
        subscribe_status(self.node, SupervisorStatus, topics.SUPERVISOR_STATUS, self._on_status, LATCHED)
        subscribe_status(self.node, MotionStatus, topics.MOTION_STATUS, self._on_motion)
        self._commands = self.node.create_publisher(String, topics.HUMANOID_COMMANDS, EVENT)
        self._clients: dict[str, Any] = {}
        try:
            self._start()
        except BaseException:
            self.close()
            raise

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def stop(self) -> None:
        """End every process."""
        self.exit_codes.update(stop_all(self._processes[::-1]))
        if self._output is not None:
            self._output.close()

    def close(self) -> None:
        """End every process and shut down rclpy."""
        self.stop()
        self._executor.remove_node(self.node)
        self.node.destroy_node()
        try_shutdown(context=self._context)
        self._folder.cleanup()
        if self._claimed is not None:
            self._claimed.close()

    @property
    def pids(self) -> dict[str, int]:
        """Process id by module."""
        return {process.spec.module: process.pid for process in self._processes}

    def spin(self, duration: float) -> None:
        """Serve callbacks and supervise the processes for a time [s]; ``PoiseError`` when one cannot be restarted."""
        end = time.monotonic() + duration
        while time.monotonic() < end:
            self._tick(min(SPIN_TIMEOUT, max(end - time.monotonic(), 0.0)))
            self._supervise(self._processes)

    def wait_for(self, condition: Callable[[], bool], timeout: float, what: str) -> None:
        """Serve callbacks until a condition is met; ``PoiseError`` with ``what`` after ``timeout`` [s]."""
        wait_for(self.spin, condition, timeout, what, lambda: f"mode '{self.mode}', drivers '{self.driver_state}'")

    def wait_standing(self, timeout: float = 60.0) -> None:
        """Wait until the robot stands without support; timeout in [s]."""
        self.wait_for(lambda: self.standing, timeout, "standing")

    @property
    def standing(self) -> bool:
        """Whether the robot stands without support."""
        return self.mode == "stand" and self.driver_state == topics.ACTIVE

    def send(self, text: str) -> None:
        """Publish a text command on ``/humanoid_commands``."""
        self.refusal = ""
        self._commands.publish(String(data=text))

    def call(self, service: str, timeout: float = 5.0) -> tuple[bool, str]:
        """Call a Trigger service; returns acceptance and answer. ``PoiseError`` after ``timeout`` [s]."""
        answer = self.ask(Trigger, service, Trigger.Request(), timeout)
        return bool(answer.success), str(answer.message)

    def ask(self, kind: type, service: str, request: Any, timeout: float = 5.0) -> Any:
        """Call a service; ``PoiseError`` when it is absent or does not answer within ``timeout`` [s]."""
        if service not in self._clients:
            client = self._clients[service] = self.node.create_client(kind, service)
            self.wait_for(client.service_is_ready, timeout, f"offering {service}")
            self.spin(SETTLE_TIME)
        future: Any = self._clients[service].call_async(request)
        self.wait_for(future.done, timeout, f"answering {service}")
        return future.result()

    def _start(self) -> None:
        if self._plant is None:
            self._say(STARTING)
        environment = graph_environment(domain_id=self._domain_id, network=self._network)
        if self._log is not None:
            self._log.parent.mkdir(parents=True, exist_ok=True)
            self._output = self._log.open("ab")
        for spec in self._specs:
            file = Path(self._folder.name) / f"{spec.module}.yaml"
            arguments = [*spec.arguments]
            if spec.nodes:
                arguments += ros_arguments(spec.nodes, self._parameters, self._namespace, file)
            self._processes.append(GraphProcess(spec, arguments, {**environment, **spec.environment}, self._output))
        for process in self._processes:
            process.start()

    def configure(self) -> None:
        """Configure all nodes at once; a ``PoiseError`` names a node that refuses or does not answer."""
        self._change(self._activation, CONFIGURE)

    def activate(self) -> None:
        """Activate the nodes in order; errors as for ``configure``."""
        for name in self._activation:
            self._change([name], ACTIVATE)
        self._say(f"active: {', '.join(self._activation)}")

    def bring_up(self, nodes: Sequence[str]) -> None:
        """Configure and activate the nodes of a restarted process, also those of the shared plant."""
        for transition in (CONFIGURE, ACTIVATE):
            self._change(nodes, transition)

    def _supervise(self, processes: Sequence[GraphProcess]) -> None:
        """Kill silent processes, and restart those that have ended."""
        for process in processes:
            if process.kill_silent():
                self._say(f"{process.spec.module} sent no heartbeat for {process.spec.silence_max:g} s: killed")
        for process in [each for each in processes if each.exit_code is not None]:
            self._restart(process)

    def _restart(self, process: GraphProcess) -> None:
        if not count_restart(process, self._say):
            self._say(f"{process.spec.module} crashed {process.restarts} times: the graph continues without it")
            self._processes.remove(process)
            return
        process.start()
        self.bring_up(process.spec.nodes)
        self._say(f"{', '.join(process.spec.nodes) or process.spec.module} running again")

    def _change(self, names: Sequence[str], transition: int) -> None:
        processes = [*self._processes, *([] if self._plant is None else [self._plant])]
        concerned = [process for process in processes if set(process.spec.nodes) & set(names)]

        def spin() -> None:
            self._tick()
            for process in concerned:
                if process.exit_code is not None:
                    raise PoiseError(f"{process.spec.module} ended with code {process.exit_code} while starting")
            self._supervise([each for each in self._processes if not each.spec.nodes])  # only the guard of a real robot

        change_state(self.node, spin, names, transition, START_TIMEOUT, self._say)

    def _tick(self, timeout: float = SPIN_TIMEOUT) -> None:
        self._executor.spin_once(timeout_sec=timeout)

    def _on_mode(self, message: String) -> None:
        self.mode = message.data
        self._say(f"mode {self.mode}")

    def _on_status(self, status: SupervisorStatus) -> None:
        if self._refused is not None and status.refused > self._refused:
            self.refusal = status.answer
        self._refused = status.refused

    def _on_motion(self, status: MotionStatus) -> None:
        if status.state is MotionState.REFUSED:
            self.refusal = str(status)

    def _on_driver_state(self, message: String) -> None:
        self.driver_state = message.data
        self._say(f"drivers {self.driver_state}")


def up(
    robot: str = "g1",
    *,
    duration: float | None = None,
    processes: Processes = "shared",
    actions: bool = False,
    camera: bool = False,
    terrain_map: bool = False,
    given_map: bool = False,
    robot_network: RobotNetwork | None = None,
    ending: EndConfig | None = None,
    **options: Any,
) -> int:
    """Run the graph until SIGINT or SIGTERM, or for a ``duration`` [s].

    Actions, camera, range sensors and terrain mapper run in separate processes; actions are omitted when their types
    are missing. Only the processes of driver and guard join the network of a real robot, ``robot_network``. ``ending``
    configures the shutdown of a real robot. Other arguments and options are those of ``Graph``. Returns the exit code:
    0 after a signal or the end of ``duration``, 1 when the graph cannot be kept running.
    """

    def make(say: Callable[[str], object]) -> Graph:
        offered = actions_possible(actions, say)
        specs = process_specs(processes, actions=offered, camera=camera, terrain_map=terrain_map, given_map=given_map)
        if robot_network is not None:
            specs = robot_network.processes(specs, robot)
        return Graph(robot, specs=specs, say=say, **options)

    end = None if ending is None or ending.at_end == "damp" else partial(lower, config=ending)
    return run_until_signal(make, robot, duration=duration, end=end)


def actions_possible(requested: bool, say: Callable[[str], object]) -> bool:
    """Whether actions are requested and their types exist; ``say`` is called with the missing types."""
    if requested and (missing := missing_types()):
        say(f"actions are not available: {missing}")
        return False
    return requested


def count_restart(process: GraphProcess, say: Callable[[str], object]) -> bool:
    """Count the restart of an ended process; returns whether it may be restarted. ``PoiseError`` if it is required."""
    process.restarts += 1
    module, restarts = process.spec.module, process.restarts
    say(f"{module} ended with code {process.exit_code}: restart {restarts} of {RESTARTS_MAX}")
    if restarts > RESTARTS_MAX and not process.spec.optional:
        raise PoiseError(f"{module} crashed {restarts} times")
    return restarts <= RESTARTS_MAX
