"""Signal handlers that inject faults: SIGUSR1 collects garbage, SIGUSR2 makes the next callback raise."""

import gc
import signal
from typing import Any


class InjectedError(RuntimeError):
    """Raised by a callback on SIGUSR2."""


def _raise(*arguments: Any) -> None:
    raise InjectedError("this callback raises on SIGUSR2")


def install(owner: type, callback: str) -> None:
    """Install both handlers; on SIGUSR2 the method ``callback`` of the class ``owner`` raises."""

    def collect(number: int, frame: object) -> None:
        gc.collect()  # skips frozen objects; all objects would take 0.1 s

    signal.signal(signal.SIGUSR1, collect)
    signal.signal(signal.SIGUSR2, lambda number, frame: setattr(owner, callback, _raise))
