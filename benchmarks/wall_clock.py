"""A wall clock that is wrong for some processes alone; see ``wall_clock_shift.c``. The machine keeps its own."""

from __future__ import annotations

import mmap
import shutil
import struct
import subprocess
from importlib.resources import files
from pathlib import Path

from models.errors import PoiseError

COMPILER = "cc"


class WallClock:
    """Shift of the wall clock of the processes that are started with ``variables``.

    Args:
        folder: Where the library and the shift are kept.

    Raises:
        PoiseError: There is no C compiler, or it fails.
    """

    def __init__(self, folder: Path) -> None:
        if shutil.which(COMPILER) is None:
            raise PoiseError(f"no C compiler: {COMPILER} is not there")
        library, state = folder / "wall_clock_shift.so", folder / "wall_clock_shift"
        source = Path(str(files("benchmarks"))) / "wall_clock_shift.c"
        command = [COMPILER, "-O2", "-shared", "-fPIC", "-o", str(library), str(source), "-ldl", "-lpthread"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise PoiseError(f"{COMPILER} fails: {done.stderr.strip()[:200]}")
        state.write_bytes(struct.pack("q", 0))
        with state.open("r+b") as file:
            self._page = mmap.mmap(file.fileno(), 8)
        self.variables = {"LD_PRELOAD": str(library), "WALL_CLOCK_SHIFT": str(state)}

    def shift(self, seconds: float) -> None:
        """Have the clock be wrong by so much from now on [s]."""
        self._page[:] = struct.pack("q", round(seconds * 1e9))
