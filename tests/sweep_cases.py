"""Cases for tests of the runner: they tell who measured them, and can be slow or kill their worker."""

import os
import signal
import time
from pathlib import Path
from typing import Any

from benchmarks.core.results import NOT_RUN
from models.numerics.threads import THREAD_VARIABLES


def square(seed: int, robot: str = "g1") -> dict[str, Any]:
    """Its worker, and what came out."""
    return {"square": seed * seed, "pid": os.getpid(), "threads": [os.environ.get(name) for name in THREAD_VARIABLES]}


def slow_square(seed: int, folder: str) -> dict[str, Any]:
    """Leaves a file named after its worker as soon as it has begun, and takes its time."""
    (Path(folder) / f"{os.getpid()}.{seed}").touch()
    time.sleep(0.2)
    return {"square": seed * seed}


def lacking(seed: int) -> dict[str, Any]:
    """Cannot be measured here when its seed is odd."""
    return {"square": 0, NOT_RUN: True} if seed % 2 else {"square": seed * seed}


def slow_network(seed: int) -> dict[str, Any]:
    """Takes its time, and returns the network namespace of its worker."""
    time.sleep(0.2)
    return {"network": os.readlink("/proc/self/ns/net")}


def deadly(seed: int) -> dict[str, Any]:
    """Kills its worker, every time."""
    os.kill(os.getpid(), signal.SIGKILL)
    return {}


def refused(seed: int) -> dict[str, Any]:
    """Fails."""
    raise KeyError(seed)
