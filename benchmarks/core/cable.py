"""Machines with cables between them: network namespaces and pairs of virtual interfaces, gone with their processes."""

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
"""Addresses of two machines on their cable."""

FIRST, SECOND = "10.213.1.2", "10.213.2.2"
"""Addresses of two machines on either side of a router."""

ERROR_MAX = 2000  #: Characters of a program's errors that are reported

REMEDY = (
    "install util-linux and iproute2, and run as root or permit namespaces to users: "
    "sysctl kernel.unprivileged_userns_clone=1 (Debian), kernel.apparmor_restrict_unprivileged_userns=0 (Ubuntu)"
)


@cache
def isolation() -> tuple[str, ...]:
    """Command that gives a program a network namespace; ``Unavailable`` where that is not permitted."""
    why = ""
    for command in (("unshare", "--net"), ("unshare", "--user", "--map-root-user", "--net")):
        cable = "ip link set lo up && ip link add t0 type veth peer name t1"
        trial = f"{cable} && unshare --net --mount mount -t tmpfs tmpfs /dev/shm"
        try:
            done = subprocess.run(
                [*command, "sh", "-c", trial], capture_output=True, text=True, timeout=20, check=False
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise Unavailable(f"no network namespaces here: {error}; {REMEDY}") from error
        if done.returncode == 0:
            return command
        why = done.stderr.strip().splitlines()[-1] if done.stderr.strip() else f"exit code {done.returncode}"
    raise Unavailable(f"no network namespaces here: {why}; {REMEDY}")


def plain_environment(root: Path, folder: Path) -> dict[str, str]:
    """This process's environment without any setting of ROS, for programs with a network of their own.

    Args:
        root: Of the checkout, on the path of Python.
        folder: For logs.
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
        folder: Where it runs.
        environment: All of it.
        timeout: For the whole program [s].
        command: That of ``isolation``, for a network namespace of its own.

    Returns:
        The value of the JSON.

    Raises:
        PoiseError: A program that fails, with the end of its errors, that needs longer, or without JSON.
    """
    try:
        done = subprocess.run(
            [*command, sys.executable, *words], cwd=folder, env=environment, capture_output=True, text=True,
            timeout=timeout, check=False, preexec_fn=die_with_parent,
        )  # fmt: skip
    except subprocess.TimeoutExpired as error:
        raise PoiseError(f"{words[0]} {words[1]} has not ended after {timeout:g} s") from error
    if done.returncode:
        raise PoiseError(f"exit code {done.returncode}: {done.stderr[-ERROR_MAX:].strip()}")
    last = done.stdout.strip().rpartition("\n")[2]
    try:
        return json.loads(last)
    except json.JSONDecodeError as error:
        raise PoiseError(f"no JSON but '{last[-ERROR_MAX:]}': {done.stderr[-ERROR_MAX:].strip()}") from error


@contextmanager
def two_machines() -> Iterator[tuple[str, ...]]:
    """Within a program of ``isolation``: a second machine beside this one, with a cable between them.

    Yields:
        Command that runs a program on the second machine.
    """
    with _machine() as there:
        _lay("cable", HERE, THERE, there)
        yield there


@contextmanager
def routed_machines() -> Iterator[tuple[tuple[str, ...], tuple[str, ...]]]:
    """Within a program of ``isolation``, which becomes a router: two machines in networks of their own.

    A router carries no multicast from one network to another.

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
    """A network namespace, for as long as the context lasts; the command that runs a program in it."""
    own_memory = (
        "mount -t tmpfs tmpfs /dev/shm && echo && exec sleep infinity"  # or two would open the same ports in it
    )
    words = ["unshare", "--net", "--mount", "sh", "-c", own_memory]
    sleeper = subprocess.Popen(words, stdout=subprocess.PIPE, preexec_fn=die_with_parent)
    assert sleeper.stdout is not None
    sleeper.stdout.readline()  # it has its namespaces
    try:
        yield ("nsenter", f"--target={sleeper.pid}", "--net", "--mount", f"--wd={os.getcwd()}")
    finally:
        sleeper.kill()
        sleeper.wait()


def _lay(name: str, address: str, other: str, there: Sequence[str]) -> None:
    """A cable from this machine to another, of networks of 256 addresses."""
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
    """The kernel calls an end up as much as a second late, and a participant never uses one that was not up before."""
    give_up = time.monotonic() + 20.0
    while " UP " not in _ip("-brief", "link", "show", end, inside=inside):
        if time.monotonic() > give_up:
            raise PoiseError(f"{end} does not come up")
        time.sleep(0.01)
