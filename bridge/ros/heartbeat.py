"""Heartbeat of a process to its launcher, over a pipe: the launcher ends one that is stopped or hangs."""

import os
import time
from contextlib import suppress

VARIABLE = "POISE_HEARTBEAT"  #: Environment variable: file descriptor of the process's end of the pipe
LOOK_MAX = 0.5  #: Longest time between two looks that counts: the launcher may have been stopped, too [s]
START_MAX = 60.0  #: Longest wait for the first heartbeat [s]


def beat() -> None:
    """Send a heartbeat, without waiting; no effect without a launcher that expects it."""
    if VARIABLE in os.environ:
        with suppress(OSError):  # full, as the launcher does not read, or without a launcher
            os.write(int(os.environ[VARIABLE]), b".")


class Heartbeat:
    """The launcher's end, for one process; ``writer`` is the descriptor that the process inherits."""

    def __init__(self) -> None:
        self._reader, self.writer = os.pipe()
        for end in (self._reader, self.writer):
            os.set_blocking(end, False)
        self._silence, self._begun, self._looked = 0.0, False, time.monotonic()

    def silent(self, limit: float) -> bool:
        """Whether no heartbeat has come for longer than a limit [s], or the first one is missing."""
        now, before = time.monotonic(), self._looked
        self._silence, self._looked = self._silence + min(now - before, LOOK_MAX), now
        with suppress(BlockingIOError):
            if os.read(self._reader, 4096):
                self._silence, self._begun = 0.0, True
        return self._silence > (limit if self._begun else START_MAX)

    def close(self) -> None:
        """Close the launcher's end."""
        os.close(self._reader)
