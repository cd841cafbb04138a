"""Picture of walking robots in a grid, rendered by MuJoCo without a display.

Run it as ``python -m benchmarks.stability.robot_pictures PICTURE ROBOT...``, with names of robots as in
``benchmarks/stability/robots.py``. It is a separate process because broken OpenGL libraries end the process.
"""

import math
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.core.loops import advance, start_walk
from benchmarks.stability.robots import GENERATED, walking_loop
from bridge.record.render import portrait
from planners.gait.state import GaitPhase

COLUMNS = 7  #: Number of columns [-]
SIZE = (190, 270)  #: Width and height of one field [pixel]
SPEED = 0.25  #: Walking speed over the speed at which the gait is fast [-]
WALK = 3.0  #: Walking time before the picture [s]
PART = 0.6  #: Fraction of the step at which the picture is taken [-]
PERIOD = 0.01  #: Period of the check of the step [s]


def walking_robot(name: str) -> Any:
    """Return a picture (PIL) of a robot that walks ahead, in the middle of a step; ``PoiseError`` if it falls."""
    with tempfile.TemporaryDirectory() as folder:
        loop = walking_loop(name, Path(folder))
        start_walk(loop, min(SPEED * loop.gait.config.pace.forward, loop.gait.config.velocity.forward), 0.0, 0.0)
        advance(loop, WALK)
        gait = loop.gait.state
        while not (gait.phase is GaitPhase.SINGLE and gait.elapsed > PART * gait.step.time):
            advance(loop, PERIOD)
            gait = loop.gait.state
        return portrait(loop.robot, loop.truth.q, SIZE, label(name))


def label(name: str) -> str:
    """Return the file name without folders, or the kind of a generated robot."""
    kind = name.removeprefix(GENERATED)
    return Path(kind).stem if "/" in kind else kind


def sheet(names: list[str], picture: Path) -> None:
    """Draw all robots of a list into one picture."""
    from PIL import Image

    columns = min(COLUMNS, len(names))
    width, height = SIZE
    made = Image.new("RGB", (columns * width, math.ceil(len(names) / columns) * height), (255, 255, 255))
    for number, name in enumerate(names):
        row, column = divmod(number, columns)
        made.paste(walking_robot(name), (column * width, row * height))
    made.save(picture)


if __name__ == "__main__":
    sheet(sys.argv[2:], Path(sys.argv[1]))
