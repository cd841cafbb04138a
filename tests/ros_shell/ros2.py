"""What ``ros2`` does, as far as ``steps.py`` asks for it, with rclpy alone: for machines without the command.

    python tests/ros_shell/ros2.py topic list -t

It does not import poise; its words, options and lines are those of ros2cli, so that one list of steps serves both.
"""

import importlib.util
import os
import sys
import time
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from ros2_messages import fill, kind_of, text_of

DISCOVERY = 2.0
"""What a fresh node waits before it lists what it has discovered [s]."""

WAIT = 10.0
"""Longest wait for one that is named: a topic, a node, a service, an action [s]."""


def prefix_of(package: str) -> Path:
    """First prefix on ``AMENT_PREFIX_PATH`` that has a package."""
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix and (Path(prefix) / "share/ament_index/resource_index/packages" / package).is_file():
            return Path(prefix)
    sys.exit(f"Package '{package}' not found")


def executable(package: str, name: str) -> Path:
    """Executable of a package."""
    path = prefix_of(package) / "lib" / package / name
    return path if os.access(path, os.X_OK) else sys.exit("No executable found")


def pkg(verb: str, package: str) -> None:
    """``pkg prefix``, ``pkg executables``."""
    prefix = prefix_of(package)
    if verb == "prefix":
        print(prefix)
        return
    for path in sorted((prefix / "lib" / package).iterdir()):
        if os.access(path, os.X_OK):
            print(package, path.name)


def run(package: str, name: str, *arguments: str) -> None:
    """``run PACKAGE EXECUTABLE``: in this process's place."""
    path = executable(package, name)
    os.execv(path, [str(path), *arguments])


def launch(package: str, name: str, *given: str) -> None:
    """``launch PACKAGE FILE name:=value``: the command of our launch file, in this process's place."""
    path = prefix_of(package) / "share" / package / "launch" / name
    spec = importlib.util.spec_from_file_location("launched", path)
    if spec is None or spec.loader is None:
        sys.exit(f"{path} cannot be loaded")
    file = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(file)
    values = {argument: default for argument, (default, _) in file.ARGUMENTS.items()}
    line = file.command(values | dict(each.split(":=", 1) for each in given))
    os.execv(line[0], line)


class Shell:
    """A node of this process, and the verbs that need one."""

    def __init__(self) -> None:
        import rclpy

        rclpy.init()
        self._rclpy, self._node = rclpy, rclpy.create_node(f"_ros2cli_{os.getpid()}")

    def node(self, verb: str, name: str = "") -> None:
        """``node list``, ``node info NODE``."""
        if verb == "list":
            self._spin(DISCOVERY)
            names = self._node.get_node_names_and_namespaces()
            print("\n".join(sorted(f"{space.rstrip('/')}/{each}" for each, space in names if each[0] != "_")))
            return
        space, _, last = name.rpartition("/")
        publishers = self._named(lambda: self._node.get_publisher_names_and_types_by_node(last, space or "/"))
        subscribers = self._node.get_subscriber_names_and_types_by_node(last, space or "/")
        services = self._node.get_service_names_and_types_by_node(last, space or "/")
        for title, found in (("Subscribers", subscribers), ("Publishers", publishers), ("Service Servers", services)):
            print(f"  {title}:")
            print("\n".join(f"    {each}: {', '.join(kinds)}" for each, kinds in sorted(found)))

    def topic(self, verb: str, *words: str) -> None:
        """``topic list -t``, ``info -v``, ``echo``, ``hz``, ``pub --once -w NUMBER``, ``pub -r RATE --times N``."""
        name = next((word for word in words if word.startswith("/")), "")
        if verb == "list":
            self._spin(DISCOVERY)
            self._print_types(self._node.get_topic_names_and_types())
        elif verb == "info":
            self._info(name)
        elif verb == "pub":
            kind = kind_of(words[-2])
            publisher = self._node.create_publisher(kind, name, 10)
            given = dict(pairwise(words))
            self._named(lambda: publisher.get_subscription_count() >= int(given.get("-w", 1)))
            message = fill(kind(), words[-1])
            rate = float(given.get("-r") or given.get("--rate", 1.0))
            for count in range(1 if "--once" in words else int(given.get("--times", sys.maxsize))):
                publisher.publish(message)
                print(f"publishing #{count + 1}: {message!r}", flush=True)
                self._spin(1.0 / rate)
        else:
            self._listen(verb, name, once="--once" in words)

    def service(self, verb: str, name: str = "", kind: str = "", values: str = "{}") -> None:
        """``service list -t``, ``service call NAME TYPE YAML``."""
        if verb == "list":
            self._spin(DISCOVERY)
            self._print_types(self._node.get_service_names_and_types())
            return
        response = self._call(kind_of(kind), name, values)
        print(f"response:\n{response!r}")

    def param(self, verb: str, node: str, name: str = "", value: str = "") -> None:
        """``param list``, ``describe``, ``get`` and ``set``."""
        import yaml
        from rcl_interfaces import srv
        from rclpy.parameter import Parameter, parameter_value_to_python

        if verb == "list":
            names = self._call(srv.ListParameters, f"{node}/list_parameters").result.names
            print("\n".join(f"  {each}" for each in sorted(names)))
        elif verb == "describe":
            descriptor = self._call(srv.DescribeParameters, f"{node}/describe_parameters", names=[name]).descriptors[0]
            print(f"Parameter name: {descriptor.name}\n  Description: {descriptor.description}\n  Constraints:")
            if descriptor.read_only:
                print("    Read only: true")
            for each in descriptor.floating_point_range:
                print(f"    Min value: {each.from_value}\n    Max value: {each.to_value}")
        elif verb == "get":
            found = self._call(srv.GetParameters, f"{node}/get_parameters", names=[name]).values[0]
            print(f"Value is: {parameter_value_to_python(found)}")
        else:
            parameters = [Parameter(name, value=yaml.safe_load(value)).to_parameter_msg()]
            result = self._call(srv.SetParameters, f"{node}/set_parameters", parameters=parameters).results[0]
            said = "Set parameter successful" if result.successful else f"Setting parameter failed: {result.reason}"
            print(said)

    def lifecycle(self, verb: str, node: str) -> None:
        """``lifecycle get NODE``."""
        from lifecycle_msgs.srv import GetState

        state = self._call(GetState, f"{node}/get_state").current_state
        print(f"{state.label} [{state.id}]")

    def action(self, verb: str, *words: str) -> None:
        """``action list -t``, ``action send_goal --feedback NAME TYPE YAML``."""
        if verb == "list":
            from rclpy.action import get_action_names_and_types

            self._spin(DISCOVERY)
            self._print_types(get_action_names_and_types(self._node))
            return
        name, kind, values = words[-3:]
        self._send_goal(name, kind_of(kind), values, feedback="--feedback" in words)

    def _send_goal(self, name: str, kind: Any, values: str, *, feedback: bool) -> None:
        from action_msgs.msg import GoalStatus
        from rclpy.action import ActionClient

        client = ActionClient(self._node, kind, name)
        self._named(client.server_is_ready)
        say = (lambda message: print(f"Feedback:\n{text_of(message.feedback)}", flush=True)) if feedback else None
        handle = self._answer(client.send_goal_async(fill(kind.Goal(), values), say))
        if not handle.accepted:
            print("Goal was rejected.")
            return
        print("Goal accepted", flush=True)
        future = handle.get_result_async()
        self._rclpy.spin_until_future_complete(self._node, future)
        names = {getattr(GoalStatus, each): each[7:] for each in dir(GoalStatus) if each.startswith("STATUS_")}
        print(f"Result:\n{text_of(future.result().result)}")
        print(f"Goal finished with status: {names[future.result().status]}")

    def _info(self, name: str) -> None:
        self._named(lambda: self._node.count_publishers(name))
        self._spin(DISCOVERY)
        endpoints = self._node.get_publishers_info_by_topic(name) + self._node.get_subscriptions_info_by_topic(name)
        for each in endpoints:
            print(f"Node name: {each.node_name}\nTopic type: {each.topic_type}")
            print(f"Topic type hash: {each.topic_type_hash}")
            print(f"Endpoint type: {each.endpoint_type.name}\n  Reliability: {each.qos_profile.reliability.name}")
            print(f"  Durability: {each.qos_profile.durability.name}\n")

    def _listen(self, verb: str, name: str, *, once: bool) -> None:
        """``echo`` and ``hz``, with the reliability and durability that every publisher offers."""
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        self._named(lambda: self._node.count_publishers(name))
        self._spin(DISCOVERY)
        publishers = self._node.get_publishers_info_by_topic(name)
        qos = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
        if all(each.qos_profile.reliability == ReliabilityPolicy.RELIABLE for each in publishers):
            qos.reliability = ReliabilityPolicy.RELIABLE
        if all(each.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for each in publishers):
            qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
        times: list[float] = []

        def receive(message: Any) -> None:
            times.append(time.monotonic())
            if verb == "echo":
                print(f"{text_of(message)}---", flush=True)
            elif len(times) % 100 == 0:
                print(f"average rate: {(len(times) - 1) / (times[-1] - times[0]):.3f}", flush=True)

        self._node.create_subscription(kind_of(publishers[0].topic_type), name, receive, qos)
        while not (once and times):
            self._rclpy.spin_once(self._node, timeout_sec=0.1)

    def _call(self, kind: Any, name: str, values: str = "{}", **fields: Any) -> Any:
        client = self._node.create_client(kind, name)
        self._named(client.service_is_ready)
        self._spin(0.2)  # the server discovers its client too before it can reply
        return self._answer(client.call_async(fill(kind.Request(**fields), values)))

    def _answer(self, future: Any) -> Any:
        self._rclpy.spin_until_future_complete(self._node, future, timeout_sec=WAIT)
        return future.result() if future.done() else sys.exit("no answer")

    def _named(self, found: Callable[[], Any]) -> Any:
        """Wait for what is named, until it is there."""
        end = time.monotonic() + WAIT
        while time.monotonic() < end:
            try:
                if result := found():
                    return result
            except self._rclpy.node.NodeNameNonExistentError:
                pass
            self._spin(0.1)
        return sys.exit("it is not there")

    def _spin(self, duration: float) -> None:
        end = time.monotonic() + duration
        while (left := end - time.monotonic()) > 0.0:
            self._rclpy.spin_once(self._node, timeout_sec=left)

    def _print_types(self, found: Sequence[tuple[str, list[str]]]) -> None:
        print("\n".join(f"{name} [{', '.join(kinds)}]" for name, kinds in sorted(found)))


def main(words: Sequence[str]) -> None:
    """Carry out one command line."""
    if words[0] in ("pkg", "run", "launch"):
        {"pkg": pkg, "run": run, "launch": launch}[words[0]](*words[1:])
        return
    getattr(Shell(), words[0])(*words[1:])


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except KeyboardInterrupt:
        sys.exit(130)
