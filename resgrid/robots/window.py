"""A block of cells of a grid, and what counts as a cell when distances are measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor, isinf

import numpy as np
from numpy.typing import NDArray

from resgrid.robots.protocol import Sampling
from resgrid.robots.shapes import Bounds
from resgrid.space import Axis

RIM = 1e-9
"""Share of a cell's width that its interior leaves out on every side."""


@dataclass(frozen=True, eq=False)
class Window:
    """A block of neighbouring cells.

    `axes`: the whole grid; `start, stop`: first and past-the-last cell per axis; `half`: half the width of what
    stands for a cell, as `halves` says.
    """

    axes: tuple[Axis, ...]
    start: tuple[int, ...]
    stop: tuple[int, ...]
    half: tuple[float, ...]

    @classmethod
    def around(cls, axes: tuple[Axis, ...], bounds: Bounds, reach: float, rule: Sampling) -> Window | None:
        """The cells that could come within a distance of a box; None if there are none."""
        start = tuple(
            _clip((low - reach - axis.lower) / axis.spacing - 1, axis.cells)
            for axis, low in zip(axes, bounds[0], strict=True)
        )
        stop = tuple(
            _clip((high + reach - axis.lower) / axis.spacing + 2, axis.cells)
            for axis, high in zip(axes, bounds[1], strict=True)
        )
        if any(first >= last for first, last in zip(start, stop, strict=True)):
            return None
        return cls(axes, start, stop, halves(axes, bounds, reach, rule))

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return len(self.axes)

    @property
    def slices(self) -> tuple[slice, ...]:
        """The block, as an index into an array of cells."""
        return tuple(slice(first, last) for first, last in zip(self.start, self.stop, strict=True))

    def centres(self, k: int) -> NDArray[np.float64]:
        """Cell centres along one axis, shape ``(stop[k] - start[k],)``."""
        axis = self.axes[k]
        return np.asarray(axis.lower + (np.arange(self.start[k], self.stop[k]) + 0.5) * axis.spacing)

    def grids(self) -> list[NDArray[np.float64]]:
        """Cell centres along every axis, shaped to broadcast over the block."""
        return [
            self.centres(k).reshape(tuple(-1 if other == k else 1 for other in range(self.ndim)))
            for k in range(self.ndim)
        ]


def rims(axes: Sequence[Axis]) -> list[float]:
    """Width of the rim that a cell's interior leaves out, per axis: 1e-9 cells, or some rounding errors."""
    return [max(RIM * axis.spacing, 8 * float(np.spacing(max(abs(axis.lower), abs(axis.upper))))) for axis in axes]


def halves(axes: Sequence[Axis], bounds: Bounds, reach: float, rule: Sampling) -> tuple[float, ...]:
    """Half the width, per axis, of what stands for a cell beside a shape that grows by a distance."""
    if rule == "centre":
        return (0.0,) * len(axes)
    thin = [high - low + 2 * reach <= 2 * rim for low, high, rim in zip(*bounds, rims(axes), strict=True)]
    return tuple(
        axis.spacing / 2 + rim if flat else max(axis.spacing / 2 - rim, 0.0)
        for axis, rim, flat in zip(axes, rims(axes), thin, strict=True)
    )


def _clip(index: float, cells: int) -> int:
    if isinf(index):
        return 0 if index < 0 else cells
    return max(0, min(cells, ceil(index) if index > 0 else floor(index)))
