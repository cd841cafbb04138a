"""What ``ros2`` does, as far as ``steps.py`` asks for it, with rclpy alone: for machines without the command.

    python tests/ros_shell/ros2.py topic list -t

It does not import poise; its words, options and lines are those of ros2cli, so that one list of steps serves both.
"""

import argparse
import importlib.util
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ros2_messages import field_of, fill, kind_of, text_of

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
    if not path.is_file() or not os.access(path, os.X_OK):
        sys.exit(f"No executable '{name}' found: ros2 pkg executables {package} lists them")
    return path


def pkg(verb: str, package: str) -> None:
    """``pkg prefix``, ``pkg executables``."""
    prefix = prefix_of(package)
    if verb == "prefix":
        print(prefix)
        return
    if not (prefix / "lib" / package).is_dir():
        sys.exit(f"Package '{package}' has no executables")
    for path in sorted((prefix / "lib" / package).iterdir()):
        if os.access(path, os.X_OK):
            print(package, path.name)


def run(package: str, name: str, *arguments: str) -> None:
    """``run PACKAGE EXECUTABLE``: in this process's place."""
    path = executable(package, name)
    os.execv(path, [str(path), *arguments])


def interface(verb: str, name: str) -> None:
    """``interface show TYPE``."""
    package, _, rest = name.partition("/")
    kind, _, last = rest.partition("/")
    path = prefix_of(package) / "share" / package / kind / f"{last}.{kind}"
    print(path.read_text(encoding="utf-8") if path.is_file() else sys.exit(f"Unknown interface '{name}'"))


def launch(package: str, name: str, *given: str) -> None:
    """``launch PACKAGE FILE name:=value``: the command of our launch file, in this process's place."""
    path = prefix_of(package) / "share" / package / "launch" / name
    spec = importlib.util.spec_from_file_location("launched", path)
    if spec is None or spec.loader is None or not path.is_file():
        sys.exit(f"{path} cannot be loaded")
    file = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(file)
    values = {argument: default for argument, (default, _) in file.ARGUMENTS.items()}
    if "--show-args" in given or "-s" in given:
        for argument, (default, text) in file.ARGUMENTS.items():
            print(f"    '{argument}':\n        {text}\n        (default: {default!r})")
        return
    for each in given:
        argument, assigned, value = each.partition(":=")
        if not assigned or argument not in values:
            sys.exit(f"'{each}' is no argument; give NAME:=VALUE, with a name of {', '.join(values)}")
        values[argument] = value
    try:
        line = file.command(values)
    except ValueError as error:
        sys.exit(str(error))
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
        publishers = self._named(
            name, lambda: self._node.get_publisher_names_and_types_by_node(last, space or "/"), "ros2 node list"
        )
        subscribers = self._node.get_subscriber_names_and_types_by_node(last, space or "/")
        services = self._node.get_service_names_and_types_by_node(last, space or "/")
        for title, found in (("Subscribers", subscribers), ("Publishers", publishers), ("Service Servers", services)):
            print(f"  {title}:")
            print("\n".join(f"    {each}: {', '.join(kinds)}" for each, kinds in sorted(found)))

    def topic(self, verb: str, name: str = "", **given: Any) -> None:
        """``topic list``, ``info``, ``echo``, ``hz`` and ``pub``; ``given`` are the options."""
        if verb == "list":
            self._spin(DISCOVERY)
            self._print_types(self._node.get_topic_names_and_types())
        elif verb == "info":
            self._info(name)
        elif verb == "pub":
            kind = kind_of(given["kind"])
            message = fill(kind(), given["values"])
            publisher = self._node.create_publisher(kind, name, 10)
            least = given["w"]
            self._named(f"{least} subscribers of {name}", lambda: publisher.get_subscription_count() >= least)
            for count in range(1 if given["once"] else given["times"]):
                publisher.publish(message)
                print(f"publishing #{count + 1}: {message!r}", flush=True)
                self._spin(1.0 / given["rate"])
        else:
            self._listen(verb, name, once=bool(given.get("once")), field=given.get("field"))

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

        if verb in ("describe", "get"):
            names = self._call(srv.ListParameters, f"{node}/list_parameters").result.names
            if name not in names:
                sys.exit(f"Parameter not set: '{name}'; ros2 param list {node}")
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
            try:
                parameters = [Parameter(name, value=yaml.safe_load(value)).to_parameter_msg()]
            except (TypeError, yaml.YAMLError) as error:
                sys.exit(f"'{value}' is no value of a parameter: {' '.join(str(error).split())}")
            result = self._call(srv.SetParameters, f"{node}/set_parameters", parameters=parameters).results[0]
            said = "Set parameter successful" if result.successful else f"Setting parameter failed: {result.reason}"
            print(said)

    def lifecycle(self, verb: str, node: str) -> None:
        """``lifecycle get NODE``."""
        from lifecycle_msgs.srv import GetState

        state = self._call(GetState, f"{node}/get_state").current_state
        print(f"{state.label} [{state.id}]")

    def action(self, verb: str, name: str = "", kind: str = "", values: str = "{}", *, feedback: bool = False) -> None:
        """``action list -t``, ``action send_goal --feedback NAME TYPE YAML``."""
        if verb == "list":
            from rclpy.action import get_action_names_and_types

            self._spin(DISCOVERY)
            self._print_types(get_action_names_and_types(self._node))
            return
        self._send_goal(name, kind_of(kind), values, feedback=feedback)

    def _send_goal(self, name: str, kind: Any, values: str, *, feedback: bool) -> None:
        from action_msgs.msg import GoalStatus
        from rclpy.action import ActionClient

        goal = fill(kind.Goal(), values)
        client = ActionClient(self._node, kind, name)
        self._named(name, client.server_is_ready, "ros2 action list -t")
        say = (lambda message: print(f"Feedback:\n{text_of(message.feedback)}", flush=True)) if feedback else None
        handle = self._answer(client.send_goal_async(goal, say))
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
        self._spin(DISCOVERY)
        endpoints = self._node.get_publishers_info_by_topic(name) + self._node.get_subscriptions_info_by_topic(name)
        if not endpoints:
            sys.exit(f"Unknown topic '{name}': ros2 topic list")
        for each in endpoints:
            print(f"Node name: {each.node_name}\nTopic type: {each.topic_type}")
            print(f"Topic type hash: {each.topic_type_hash}")
            print(f"Endpoint type: {each.endpoint_type.name}\n  Reliability: {each.qos_profile.reliability.name}")
            print(f"  Durability: {each.qos_profile.durability.name}\n")

    def _listen(self, verb: str, name: str, *, once: bool, field: str | None) -> None:
        """``echo`` and ``hz``, with the reliability and durability that every publisher offers."""
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        self._named(f"publisher of {name}", lambda: self._node.count_publishers(name), f"ros2 topic info {name}")
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
                print(f"{text_of(field_of(message, field))}---", flush=True)
            elif len(times) % 100 == 0:
                print(f"average rate: {(len(times) - 1) / (times[-1] - times[0]):.3f}", flush=True)

        self._node.create_subscription(kind_of(publishers[0].topic_type), name, receive, qos)
        while not (once and times):
            self._rclpy.spin_once(self._node, timeout_sec=0.1)

    def _call(self, kind: Any, name: str, values: str = "{}", **fields: Any) -> Any:
        request = fill(kind.Request(**fields), values)
        client = self._node.create_client(kind, name)
        self._named(name, client.service_is_ready, "ros2 service list -t")
        self._spin(0.2)  # the server discovers its client too before it can reply
        return self._answer(client.call_async(request))

    def _answer(self, future: Any) -> Any:
        self._rclpy.spin_until_future_complete(self._node, future, timeout_sec=WAIT)
        return future.result() if future.done() else sys.exit("no answer")

    def _named(self, what: str, found: Callable[[], Any], remedy: str = "ros2 topic list") -> Any:
        """Wait for what is named, until it is there; otherwise end with the command that lists what there is."""
        end = time.monotonic() + WAIT
        while time.monotonic() < end:
            try:
                if result := found():
                    return result
            except self._rclpy.node.NodeNameNonExistentError:
                pass
            self._spin(0.1)
        domain = os.environ.get("ROS_DOMAIN_ID") or "0"
        return sys.exit(f"no {what} within {WAIT:g} s in ROS domain {domain}; {remedy} lists what there is")

    def _spin(self, duration: float) -> None:
        end = time.monotonic() + duration
        while (left := end - time.monotonic()) > 0.0:
            self._rclpy.spin_once(self._node, timeout_sec=left)

    def _print_types(self, found: Sequence[tuple[str, list[str]]]) -> None:
        print("\n".join(f"{name} [{', '.join(kinds)}]" for name, kinds in sorted(found)))


def _at_least(kind: type, low: float) -> Callable[[str], Any]:
    """Type of an argument: a finite number not below a bound."""

    def number(text: str) -> Any:
        value = kind(text)
        if not low <= value < float("inf"):
            raise ValueError(text)
        return value

    number.__name__ = f"number of at least {low:g}"
    return number


def _parser() -> argparse.ArgumentParser:
    """The words and options that are known."""
    top = argparse.ArgumentParser(prog="ros2", description=(__doc__ or "").splitlines()[0], allow_abbrev=False)
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def verbs(command: str, **known: str) -> dict[str, argparse.ArgumentParser]:
        group = commands.add_parser(command, help=", ".join(known)).add_subparsers(dest="verb", required=True)
        made = {verb: group.add_parser(verb) for verb in known}
        for verb, words in known.items():
            for word in words.split():
                made[verb].add_argument(word.strip("?"), nargs="?" if word.endswith("?") else None, default="{}")
        return made

    verbs("pkg", prefix="package", executables="package")
    verbs("interface", show="name")
    for command in ("run", "launch"):
        parser = commands.add_parser(command, help="PACKAGE NAME ...")
        for word, count in (("package", None), ("name", None), ("arguments", argparse.REMAINDER)):
            parser.add_argument(word, nargs=count)
    topic = verbs("topic", list="", info="name", echo="name kind?", hz="name", pub="name kind values?")
    listed = [topic, verbs("service", list="", call="name kind values?"), verbs("node", list="", info="name")]
    verbs("param", list="node", describe="node name", get="node name", set="node name value")
    verbs("lifecycle", get="node")
    listed.append(verbs("action", list="", send_goal="name kind values?"))
    listed[-1]["send_goal"].add_argument("--feedback", action="store_true")
    for group in listed:
        group["list"].add_argument("-t", action="store_true", help="with types, as always here")
    topic["info"].add_argument("-v", "--verbose", action="store_true", help="as always here")
    for verb in ("echo", "pub"):
        topic[verb].add_argument("--once", action="store_true")
    topic["echo"].add_argument("--field", help="one field, such as info.resolution")
    for option in ("qos-reliability", "qos-durability", "qos-history", "qos-depth"):
        topic["echo"].add_argument(f"--{option}", help="without effect here: the QoS of the publisher")
    topic["pub"].add_argument("-r", "--rate", type=_at_least(float, 1e-3), default=1.0)
    topic["pub"].add_argument("--times", type=_at_least(int, 1), default=sys.maxsize)
    topic["pub"].add_argument("-w", type=_at_least(int, 0), default=1, help="subscribers to wait for")
    return top


def main(words: Sequence[str]) -> None:
    """Carry out one command line; what is wrong with it is one line of the standard error."""
    given = vars(_parser().parse_args(words))
    command = given.pop("command")
    if command in ("run", "launch"):
        {"run": run, "launch": launch}[command](given["package"], given["name"], *given["arguments"])
        return
    for option in ("t", "verbose", "qos_reliability", "qos_durability", "qos_history", "qos_depth"):
        given.pop(option, None)
    if command in ("pkg", "interface"):
        {"pkg": pkg, "interface": interface}[command](**given)
        return
    try:
        shell = Shell()
    except Exception as error:  # of rclpy, which may be missing: no ROS 2 is sourced, or the domain is none
        sys.exit(f"ROS 2 cannot be used: {str(error).splitlines()[0]}; source it, and check ROS_DOMAIN_ID (0 to 232)")
    from rclpy.exceptions import InvalidServiceNameException, InvalidTopicNameException

    try:
        getattr(shell, command)(**given)
    except (InvalidTopicNameException, InvalidServiceNameException) as error:
        sys.exit(" ".join(str(error).split()))
    except ValueError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:  # as with | head
        os._exit(0)
