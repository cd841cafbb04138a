"""Provenance of figures: versions, source, configuration, and the machine in general terms."""

import hashlib
import json
import os
import platform
import subprocess
from collections.abc import Mapping
from dataclasses import asdict
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

from models.config import read_yaml
from models.profile import load_profile
from models.urdf import resolve_uri

#: Packages whose versions affect the figures
MEASURED_PACKAGES = (
    *("poise", "pin", "placo", "mujoco", "daqp", "quadprog", "numba", "numpy", "ros-rclpy"),
    *("qpsolvers", "osqp", "proxsuite", "piqp", "clarabel", "pin-pink", "mink", "example-robot-data"),
)
ROOT = Path(__file__).resolve().parents[2]  # root of the checkout, if there is one

#: Sources that affect the figures; a report written into the checkout does not
SOURCES = ("models", "planners", "controllers", "bridge", "benchmarks", "pyproject.toml", "constraints.txt")
DIGEST = 12  # kept characters of a hash


def usable_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


def machine() -> str:
    """Describe this machine in general terms: cores, architecture, memory, kernel."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    kernel = ".".join(platform.release().split(".")[:2])
    return f"{usable_cores()} cores, {platform.machine()}, {memory:.0f} GiB of memory, {platform.system()} {kernel}"


@cache
def versions() -> dict[str, str]:
    """Return the versions of Python and of ``MEASURED_PACKAGES``, as of the first call."""
    found = {"python": platform.python_version(), "machine": platform.machine()}
    for name in MEASURED_PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def difference(theirs: tuple[str, Mapping[str, str]], own: tuple[str, Mapping[str, str]]) -> str:
    """Return why cases of another process (``source_state``, ``versions``) are not comparable; empty if they are."""
    if theirs[0] != own[0]:
        return f"runs revision {theirs[0]}, not {own[0]}"
    for name in sorted({*theirs[1], *own[1]}):
        there, here = theirs[1].get(name, "none"), own[1].get(name, "none")
        if there != here:
            return f"has {name} {there}, not {here}"
    return ""


def revision() -> str:
    """Return the Git revision, with ``+`` for local changes; ``unknown`` outside of a checkout."""
    try:
        return _head() + ("+" if _git("status", "--porcelain", "--untracked-files=no") else "")
    except (OSError, subprocess.SubprocessError):
        return "unknown"


@cache
def source_state() -> str:
    """Return Git revision and hash of local changes and new files, cached; the version outside of a checkout."""
    try:
        head, changes = _head(), _git("diff", "HEAD", "--", *SOURCES)
        new = _git("ls-files", "--others", "--exclude-standard", "-z", "--", *SOURCES).split("\0")
        parts = [
            part for name in new if (ROOT / name).is_file() for part in (name.encode(), (ROOT / name).read_bytes())
        ]
    except (OSError, subprocess.SubprocessError):
        return f"version {versions().get('poise', 'unknown')}"
    return head + (f"+{digest(changes.encode(), *parts)}" if changes or parts else "")


def digest(*parts: bytes) -> str:
    """Return a short hash of bytes."""
    return hashlib.sha256(b"\0".join(parts)).hexdigest()[:DIGEST]


def is_policy(contender: str) -> bool:
    """Whether the contender is a policy file and not ``module:Class``."""
    return contender.endswith((".yaml", ".yml"))


def _source_of(name: str) -> list[Path]:
    """Return the files of a contender (module, or policy and model); empty if ``contender.load`` would refuse it."""
    if is_policy(name):
        file = Path(name)
        return [file, file.parent / str(read_yaml(file).get("model"))] if file.is_file() else []
    try:
        spec = find_spec(name.partition(":")[0])
    except (ImportError, ValueError):
        return []
    return [Path(spec.origin)] if spec is not None and spec.origin else []


def configuration(robot: str, contender: str = "") -> str:
    """Return a hash of the benchmarks' YAML files, profile and URDF of the robot, and files of the contender."""
    profile = load_profile(robot)
    urdf = resolve_uri(profile.urdf, Path(profile.source).parent)
    files = [*sorted((ROOT / "benchmarks/config").glob("*.yaml")), urdf]
    if contender:
        files += _source_of(contender)
    values = json.dumps(asdict(profile) | {"source": "", "urdf": ""}).encode()
    return digest(values, *(file.read_bytes() for file in files if file.is_file()))


def _git(*arguments: str) -> str:
    command = ["git", "-C", str(ROOT), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=20).stdout.strip()


def _head() -> str:
    """Return the revision of the checkout; ``OSError`` outside of one."""
    if Path(_git("rev-parse", "--show-toplevel")).resolve() != ROOT:
        raise FileNotFoundError("not a checkout")
    return _git("rev-parse", "HEAD")
