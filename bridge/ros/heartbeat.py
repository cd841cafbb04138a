"""Heartbeat of a process to its launcher, over a pipe: the launcher kills a process that is stopped or hangs."""

import os
import time
from contextlib import suppress

VARIABLE = "POISE_HEARTBEAT"  #: Environment variable with the file descriptor of the process's end of the pipe
LOOK_MAX = 0.5  #: Upper bound on the counted time between two checks [s]: the launcher itself may have been stopped
START_MAX = 60.0  #: Longest wait for the first heartbeat [s]


def beat() -> None:
    """Send a heartbeat without blocking; no effect without a launcher that expects it."""
    if VARIABLE in os.environ:
        with suppress(OSError):  # pipe full or without a reader
            os.write(int(os.environ[VARIABLE]), b".")


class Heartbeat:
    """Launcher's end of the pipe for one process; ``writer`` is the file descriptor that the process inherits."""

    def __init__(self) -> None:
        self._reader, self.writer = os.pipe()
        for end in (self._reader, self.writer):
            os.set_blocking(end, False)
        self._silence, self._begun, self._looked = 0.0, False, time.monotonic()

    def silent(self, limit: float) -> bool:
        """Whether no heartbeat has arrived for longer than a limit [s], or the first one for ``START_MAX``."""
        now, before = time.monotonic(), self._looked
        self._silence, self._looked = self._silence + min(now - before, LOOK_MAX), now
        with suppress(BlockingIOError):
            if os.read(self._reader, 4096):
                self._silence, self._begun = 0.0, True
        return self._silence > (limit if self._begun else START_MAX)

    def close(self) -> None:
        """Close the launcher's end."""
        os.close(self._reader)
