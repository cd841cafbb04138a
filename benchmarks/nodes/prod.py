"""Signals that prod a process of the graph: SIGUSR1 collects garbage, SIGUSR2 has its next callback raise."""

from __future__ import annotations

import gc
import signal
from typing import Any


class Prodded(RuntimeError):
    """A callback was told to raise."""


def _raise(*arguments: Any) -> None:
    raise Prodded("this callback was told to raise")


def listen(owner: type, callback: str) -> None:
    """Obey the two signals.

    Args:
        owner: Class of which a callback is to raise.
        callback: Its name.
    """

    def collect(number: int, frame: object) -> None:
        gc.collect()  # what the graph has frozen is left out; all that lives would take 0.1 s

    signal.signal(signal.SIGUSR1, collect)
    signal.signal(signal.SIGUSR2, lambda number, frame: setattr(owner, callback, _raise))
