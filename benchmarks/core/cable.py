"""Simulated machines and cables: network namespaces and veth pairs that end with their processes."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from benchmarks.core.machine import Unavailable
from models.errors import PoiseError
from models.nodes.realtime import die_with_parent

HERE, THERE = "10.213.0.1", "10.213.0.2"
"""Addresses of the two machines on a cable."""

FIRST, SECOND = "10.213.1.2", "10.213.2.2"
"""Addresses of the two machines on either side of the router."""

LINK_TIME = 20.0  #: Maximum wait for an interface to be up [s]
ERROR_MAX = 2000  #: Maximum length of a program's error output in a message [characters]

REMEDY = (
    "install util-linux and iproute2, and run as root or enable user namespaces: "
    "sysctl kernel.unprivileged_userns_clone=1 (Debian), kernel.apparmor_restrict_unprivileged_userns=0 (Ubuntu)"
)


@cache
def isolation() -> tuple[str, ...]:
    """Return the command that runs a program in a network namespace; ``Unavailable`` without permission."""
    why = ""
    for command in (("unshare", "--net"), ("unshare", "--user", "--map-root-user", "--net")):
        cable = "ip link set lo up && ip link add t0 type veth peer name t1"
        trial = f"{cable} && unshare --net --mount mount -t tmpfs tmpfs /dev/shm"
        try:
            done = subprocess.run(
                [*command, "sh", "-c", trial], capture_output=True, text=True, timeout=20, check=False
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise Unavailable(f"network namespaces are not available: {error}; {REMEDY}") from error
        if done.returncode == 0:
            return command
        why = done.stderr.strip().splitlines()[-1] if done.stderr.strip() else f"exit code {done.returncode}"
    raise Unavailable(f"network namespaces are not available: {why}; {REMEDY}")


def plain_environment(root: Path, folder: Path) -> dict[str, str]:
    """Return the environment of this process without ROS settings, for programs in a separate network.

    Args:
        root: Root of the checkout, added to ``PYTHONPATH``.
        folder: Folder for logs.
    """
    plain = {name: value for name, value in os.environ.items() if not name.startswith(("ROS_", "FAST"))}
    path = os.pathsep.join(filter(None, (str(root), os.environ.get("PYTHONPATH"))))
    return plain | {"PYTHONPATH": path, "ROS_DOMAIN_ID": "7", "ROS_LOG_DIR": str(folder / "log")}


def run_program(
    words: Sequence[str],
    folder: Path,
    environment: Mapping[str, str],
    *,
    timeout: float,
    command: Sequence[str] = (),
) -> Any:
    """Run a Python program that prints JSON on its last line.

    Args:
        words: Script or ``-m`` module, and arguments.
        folder: Working directory.
        environment: Complete environment.
        timeout: Limit for the whole program [s].
        command: Prefix from ``isolation`` that gives the program a separate network namespace.

    Returns:
        The decoded JSON value.

    Raises:
        PoiseError: The program fails (with the end of its error output), exceeds the limit, or prints no JSON.
    """
    try:
        done = subprocess.run(
            [*command, sys.executable, *words], cwd=folder, env=environment, capture_output=True, text=True,
            timeout=timeout, check=False, preexec_fn=die_with_parent,
        )  # fmt: skip
    except subprocess.TimeoutExpired as error:
        raise PoiseError(f"{words[0]} {words[1]} has not ended after {timeout:g} s") from error
    if done.returncode:
        raise PoiseError(f"{' '.join(words[:2])}: exit code {done.returncode}: {done.stderr[-ERROR_MAX:].strip()}")
    last = done.stdout.strip().rpartition("\n")[2]
    try:
        return json.loads(last)
    except json.JSONDecodeError as error:
        raise PoiseError(
            f"{' '.join(words[:2])}: last line of the output is not JSON: '{last[-ERROR_MAX:]}'; "
            f"errors: {done.stderr[-ERROR_MAX:].strip() or 'none'}"
        ) from error


@contextmanager
def two_machines() -> Iterator[tuple[str, ...]]:
    """Add a second machine, connected by a cable; call this inside a program of ``isolation``.

    Yields:
        Command that runs a program on the second machine.
    """
    with _machine() as there:
        _lay("cable", HERE, THERE, there)
        yield there


@contextmanager
def routed_machines() -> Iterator[tuple[tuple[str, ...], tuple[str, ...]]]:
    """Add two machines in separate networks; the calling program of ``isolation`` becomes their router.

    The router does not forward multicast.

    Yields:
        Commands that run a program on the first and on the second machine.
    """
    with _machine() as first, _machine() as second:
        for name, address, machine in (("left", FIRST, first), ("right", SECOND, second)):
            router = f"{address.rpartition('.')[0]}.1"
            _lay(name, router, address, machine)
            _ip("route", "add", "default", "via", router, inside=machine)
        Path("/proc/sys/net/ipv4/ip_forward").write_text("1", encoding="ascii")
        yield first, second


@contextmanager
def _machine() -> Iterator[tuple[str, ...]]:
    """Create a network namespace for the duration of the context; yields the command that runs a program in it."""
    own_memory = (
        "mount -t tmpfs tmpfs /dev/shm && echo && exec sleep infinity"  # in a shared one, two would open the same ports
    )
    words = ["unshare", "--net", "--mount", "sh", "-c", own_memory]
    sleeper = subprocess.Popen(words, stdout=subprocess.PIPE, preexec_fn=die_with_parent)
    assert sleeper.stdout is not None
    sleeper.stdout.readline()  # wait until the namespaces exist
    try:
        yield ("nsenter", f"--target={sleeper.pid}", "--net", "--mount", f"--wd={os.getcwd()}")
    finally:
        sleeper.kill()
        sleeper.wait()


def _lay(name: str, address: str, other: str, there: Sequence[str]) -> None:
    """Connect this machine and another one with a cable; each address is in a /24 network."""
    namespace = next(word for word in there if word.startswith("--target=")).removeprefix("--target=")
    _ip("link", "add", f"{name}0", "type", "veth", "peer", "name", f"{name}1", "netns", namespace)
    for end, own, inside in ((f"{name}0", address, ()), (f"{name}1", other, there)):
        _ip("link", "set", "lo", "up", inside=inside)
        _ip("address", "add", f"{own}/24", "dev", end, inside=inside)
        _ip("link", "set", end, "up", inside=inside)
    _plugged(f"{name}0")
    _plugged(f"{name}1", inside=there)


def _ip(*words: str, inside: Sequence[str] = ()) -> str:
    done = subprocess.run([*inside, "ip", *words], capture_output=True, text=True, check=False)
    if done.returncode:
        raise PoiseError(f"ip {' '.join(words)}: exit code {done.returncode}: {done.stderr.strip()}")
    return done.stdout


def _plugged(end: str, inside: Sequence[str] = ()) -> None:
    """Wait for the interface: it comes up to a second late, and participants ignore one that is down at their start."""
    give_up = time.monotonic() + LINK_TIME
    while " UP " not in _ip("-brief", "link", "show", end, inside=inside):
        if time.monotonic() > give_up:
            raise PoiseError(f"interface {end} is not up after {LINK_TIME:g} s")
        time.sleep(0.01)
