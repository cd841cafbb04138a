"""What the pictures of a report share: a colour and a mark for each robot, and small files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from benchmarks.core.harness import Report

Reports = Mapping[tuple[str, str], Report]  # reports by bench and robot

LOOKS = (("#0072b2", "o"), ("#d55e00", "s"), ("#009e73", "^"), ("#cc79a7", "D"), ("#56b4e9", "v"))
"""Colour and mark of the first robot, the second, ...: of Okabe and Ito, distinguishable for the colour-blind."""

MAP = "cividis"  # colours of a heat map: dark to light for all eyes
BOUND: dict[str, Any] = {"color": "k", "linewidth": 1.0, "linestyle": "--"}  # how a bound is drawn
DPI = 110  # of a picture: at 9 inches it fills a page of documentation at its own size
PALETTE = 255  # colours of a picture's file: indistinguishable for lines and text, and a third of the size


def robots_of(reports: Reports, *benches: str) -> list[str]:
    """Robots that these benchmarks have measured, or any where none is named."""
    return list(dict.fromkeys(robot for bench, robot in reports if not benches or bench in benches))


def look(reports: Reports, robot: str) -> tuple[str, str]:
    """Colour and mark of a robot, the same in every picture."""
    return LOOKS[robots_of(reports).index(robot) % len(LOOKS)]


def colour(reports: Reports, robot: str) -> str:
    """That of ``look``."""
    return look(reports, robot)[0]


def draw_dots(axes: Axes, reports: Reports, values: Mapping[str, Mapping[str, Sequence[float]]], label: str) -> None:
    """Draw one mark a case, by robot and scenario; the label names the unit."""
    names = list(dict.fromkeys(name for of in values.values() for name in of))
    for k, (robot, of) in enumerate(values.items()):
        offset = 0.16 * (k - 0.5 * (len(values) - 1))
        places = [names.index(name) + offset for name, dots in of.items() for _ in dots]
        dots = [dot for dots in of.values() for dot in dots]
        shade, mark = look(reports, robot)
        axes.plot(places, dots, mark, color=shade, markersize=5, alpha=0.7, label=robot)
    axes.set_xticks(range(len(names)), [name.replace("_", " ") for name in names], fontsize=9)
    axes.set_xlim(-0.5, len(names) - 0.5)
    axes.set_ylabel(label)
    axes.grid(axis="y", alpha=0.3)


def save(figure: Figure, file: Path) -> Path:
    """Write a picture with few colours; returns the file."""
    figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    picture.quantize(PALETTE, dither=Image.Dither.NONE).save(file, optimize=True)
    return file
