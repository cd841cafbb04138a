"""Access of processes to the graph: environment (loopback by default), free domains, short-lived participants."""

import fcntl
import itertools
import os
import socket
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path
from typing import IO, Any

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown

from bridge.ros.namespace import absolute_namespace, in_namespace
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.spin import SUPERVISED, log_arguments, log_variables
from models.numerics.threads import THREAD_VARIABLES

#: Variable that Fast DDS of ROS 2 Jazzy reads; it ignores the newer name ``FASTDDS_...``
PROFILE_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
LOOPBACK_PROFILE = Path(str(files("bridge"))) / "config" / "loopback.xml"
#: Port of domain 0, ports per domain, and the last domain below Linux's ephemeral ports (DDSI-RTPS 9.6.1)
DISCOVERY_PORT, DOMAIN_STEP, DOMAIN_MAX = 7400, 250, 101
LAST_DOMAIN = 232  #: Largest domain with valid DDS ports
#: Offset of the first participant's port from the discovery port (the others follow in steps of two); number checked
UNICAST_PORT, PARTICIPANTS = 10, 32
CLAIM_TIME, CLAIM_PERIOD = 0.5, 0.01  #: Timeout and period of attempts to claim a graph [s]; a query may hold the lock
CLAIMS_MAX = 16  #: Number of domains that a process holds: the last ones that were returned
_domains = itertools.count(os.getpid())
_claims: deque[IO[str]] = deque(maxlen=CLAIMS_MAX)


def ros_domain(domain_id: int | None = None) -> int:
    """``domain_id``, or the ROS domain of the environment when None; ``PoiseError`` if the latter is invalid."""
    if domain_id is not None:
        return domain_id
    text = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not text.strip().isdecimal() or int(text) > LAST_DOMAIN:
        raise PoiseError(
            f"ROS_DOMAIN_ID: '{text}' is not a ROS domain, 0 to {LAST_DOMAIN}; export ROS_DOMAIN_ID=1, for example"
        )
    return int(text)


def graph_environment(*, domain_id: int | None = None, network: bool = False) -> dict[str, str]:
    """Environment variables to change, by name; a user-defined profile file is kept.

    ``domain_id`` is the ROS domain, from the environment when None; ``network`` lets other machines join. Raises
    ``PoiseError`` as ``ros_domain``.
    """
    variables = dict.fromkeys(THREAD_VARIABLES, "1")
    variables[SUPERVISED] = "1"
    variables["ROS_DOMAIN_ID"] = str(ros_domain(domain_id))
    profile = str(LOOPBACK_PROFILE)
    if not network and os.environ.get(PROFILE_VARIABLE, profile) == profile:
        variables[PROFILE_VARIABLE] = profile
        variables["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SYSTEM_DEFAULT"  # any other value overrides the profile
    return variables | log_variables()


def join_graph(*, domain_id: int | None = None, network: bool = False) -> None:
    """Set the environment of the graph in this process; call it before ``rclpy.init``."""
    variables = graph_environment(domain_id=domain_id, network=network)
    del variables[SUPERVISED]
    os.environ.update(variables)


def free_domain() -> int:
    """A ROS domain that no process on this machine uses; the next call returns another one.

    A lock file claims the domain for this process. Processes that start graphs at the same time therefore never share
    a domain. Raises ``PoiseError`` when all domains are in use.
    """
    for candidate in itertools.islice(_domains, DOMAIN_MAX):
        domain = 1 + candidate % DOMAIN_MAX
        claim = _lock(f"domain-{domain}")
        if not isinstance(claim, str) and _is_free(domain):
            _claims.append(claim)
            return domain
    raise PoiseError("every ROS domain is in use")


def _lock(name: str, note: str = "", *, shared: bool = False) -> IO[str] | str:
    """Lock file of this user, locked while open; the note of the holder if locked. ``shared`` locks may coexist."""
    file = (Path(tempfile.gettempdir()) / f"poise-{name}-{os.getuid()}.lock").open("a+", encoding="utf-8")
    try:
        fcntl.flock(file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except OSError:
        with file:
            file.seek(0)
            return file.read()
    if not shared:
        file.truncate(0)
        file.write(note)
        file.flush()
    return file


def _graph(domain_id: int | None, namespace: str) -> tuple[str, str]:
    """Lock name and readable location of a graph; the domain is taken from the environment when None."""
    domain = ros_domain(domain_id)
    place = f"ROS domain {domain}" + (f", namespace {namespace}" if namespace else "")
    return f"graph-{domain}{namespace.replace('/', '-')}", place


def claim_graph(robot: str, domain_id: int | None, namespace: str) -> IO[str]:
    """Lock file of a graph on this machine, locked while open; a ``PoiseError`` names robot and process of a holder."""
    name, place = _graph(domain_id, namespace)
    end = time.monotonic() + CLAIM_TIME
    while isinstance(held := _lock(name, f"{robot}, process {os.getpid()}"), str) and time.monotonic() < end:
        time.sleep(CLAIM_PERIOD)
    if isinstance(held, str):
        raise PoiseError(
            f"already running in {place}: {held}; end it with Ctrl-C there, or give this one another --namespace or "
            f"ROS_DOMAIN_ID, but not for the same real robot, which must have one commander only"
        )
    return held


def graph_holder(namespace: str) -> str:
    """Robot and process of the graph on this machine in a namespace and the current domain; empty without a graph."""
    held = _lock(_graph(None, namespace)[0], shared=True)
    if isinstance(held, str):
        return held
    held.close()
    return ""


def graphs_elsewhere(namespace: str) -> str:
    """Graphs of this user on this machine, with remedies; empty if one runs in the current domain and namespace."""
    (own, place), user = _graph(None, namespace), f"-{os.getuid()}.lock"
    held: dict[str, str] = {}
    for file in Path(tempfile.gettempdir()).glob(f"poise-graph-*{user}"):
        name = file.name.removeprefix("poise-").removesuffix(user)
        if isinstance(claim := _lock(name, shared=True), str):
            held[name] = claim
        else:
            claim.close()
    if own in held or not held:
        return ""
    found = []
    for name, claim in sorted(held.items()):
        domain, *parts = name.removeprefix("graph-").split("-")
        there = "".join(f"/{part}" for part in parts)
        remedy = [f"export ROS_DOMAIN_ID={domain}"] if int(domain) != ros_domain() else []
        if there != namespace:
            remedy.append(f"give --namespace {there}" if there else "leave --namespace out")
        found.append(f"{_graph(int(domain), there)[1]} ({claim}): {' and '.join(remedy)}")
    return f"no graph runs in {place}, but in {'; in '.join(found)}"


def namespaces_of_robots(node: Node) -> set[str]:
    """Namespaces of the robots that ``node`` has discovered, each with a leading slash or empty."""
    end = f"/{topics.SUPERVISOR_STATUS}"
    seen = [topic for topic, _ in node.get_topic_names_and_types() if topic.endswith(end)]
    return {topic.removesuffix(end) for topic in seen if node.count_publishers(topic)}


def other_namespaces(robots: set[str]) -> str:
    """Message that names the namespaces of robots, when none is in that of this process, with the remedy."""
    option = "leave --namespace out" if robots == {""} else "give --namespace"
    return f"robots are up in {', '.join(robot or '/' for robot in sorted(robots))}: {option}"


def _is_free(domain: int) -> bool:
    """Whether no socket is bound to the multicast port of a domain or, on loopback, to the port of a participant."""
    first = DISCOVERY_PORT + DOMAIN_STEP * domain
    for port in (first, *(first + UNICAST_PORT + 2 * participant for participant in range(PARTICIPANTS))):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                return False
    return True


@contextmanager
def participant(
    name: str,
    *,
    network: bool = False,
    namespace: str = "",
    make: Callable[..., Any] = SingleThreadedExecutor,
) -> Iterator[tuple[Node, Any]]:
    """Context manager of a node in a separate ROS context, and its executor; the process id is added to ``name``.

    With ``network`` the robot may run on another machine. ``make`` creates the executor. Raises ``PoiseError`` for an
    invalid namespace.
    """
    namespace = absolute_namespace(namespace)
    join_graph(network=network)
    context = Context()
    arguments = [*sys.argv, *log_arguments()]
    rclpy.init(args=arguments, context=context, signal_handler_options=SignalHandlerOptions.NO)
    # Nodes with the same name hide each other
    node = Node(f"{name}_{os.getpid()}", context=context, **in_namespace(namespace))
    executor = make(context=context)
    executor.add_node(node)
    try:
        yield node, executor
    finally:
        executor.remove_node(node)
        executor.shutdown()
        node.destroy_node()
        try_shutdown(context=context)


def ignore(message: Any) -> None:
    """Callback of polled subscriptions; never called."""


def newest(subscription: Any) -> bytes | None:
    """Newest serialised message of a raw subscription of depth 1, or None; messages between polls cost no time."""
    with subscription.handle:
        taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    return None if taken is None else bytes(taken[0])
