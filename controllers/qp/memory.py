"""Named arrays in one piece of memory, which a compiled kernel takes as two arguments.

Each array passed to a compiled kernel costs a tenth of a microsecond, more when caches are cold; a tick would pass
hundreds. A ``Block`` is one flat array and a table of the offsets of its parts. Kernels find a part by its number with
``part_1`` to ``part_3``; the sizes are data, not types, so that one compilation serves every robot and contact mode.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from models.numerics.compiled import njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class Block:
    """Zeroed float64 arrays by name.

    Args:
        shapes: Shape of each part, at most three-dimensional; their order numbers the parts.

    Attributes:
        data: All parts (n,).
        layout: For each part its offset in ``data`` and its three dimensions, missing ones being 1 (k, 4).
    """

    def __init__(self, shapes: Mapping[str, tuple[int, ...]]) -> None:
        sizes = [int(np.prod(shape)) for shape in shapes.values()]
        offsets = np.concatenate([[0], np.cumsum(sizes)])
        self.data: Array = np.zeros(int(offsets[-1]))
        self.layout: Index = np.ones((len(sizes), 4), dtype=np.int64)
        self._parts: dict[str, Array] = {}
        for k, (name, shape) in enumerate(shapes.items()):
            self.layout[k, 0] = offsets[k]
            self.layout[k, 1 : 1 + len(shape)] = shape
            self._parts[name] = self.data[offsets[k] : offsets[k + 1]].reshape(shape)

    def __getitem__(self, name: str) -> Array:
        """One part; writing to it writes to the block."""
        return self._parts[name]


@njit(cache=True)
def part_1(data: Array, layout: Index, k: int) -> Array:
    """Vector number k of a block."""
    first = layout[k, 0]
    return data[first : first + layout[k, 1]]


@njit(cache=True)
def part_2(data: Array, layout: Index, k: int) -> Array:
    """Matrix number k of a block."""
    first, m, n = layout[k, 0], layout[k, 1], layout[k, 2]
    return data[first : first + m * n].reshape((m, n))


@njit(cache=True)
def part_3(data: Array, layout: Index, k: int) -> Array:
    """Three-dimensional array number k of a block."""
    first, m, n, p = layout[k, 0], layout[k, 1], layout[k, 2], layout[k, 3]
    return data[first : first + m * n * p].reshape((m, n, p))
