"""A block of cells of a grid, and what counts as a cell when distances are measured."""

from __future__ import annotations

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

    Attributes
    ----------
    axes : tuple of Axis
        The whole grid.
    start, stop : tuple of int
        First and past-the-last cell per axis.
    half : tuple of float
        Half the width of what stands for a cell: its interior, or nothing but its centre.
    """

    axes: tuple[Axis, ...]
    start: tuple[int, ...]
    stop: tuple[int, ...]
    half: tuple[float, ...]

    @classmethod
    def around(cls, axes: tuple[Axis, ...], bounds: Bounds, reach: float, rule: Sampling) -> Window | None:
        """The cells that could come within a distance of a box; None if there are none.

        Parameters
        ----------
        axes : tuple of Axis
            The grid.
        bounds : pair of tuple of float
            Lower and upper corner of the box; may be infinite.
        reach : float
            The distance.
        rule : {"conservative", "centre"}
            What stands for a cell.

        Returns
        -------
        Window or None
        """
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
        rim = cls.rim(axes)
        half = tuple(max(axis.spacing / 2 - rim, 0.0) if rule == "conservative" else 0.0 for axis in axes)
        return cls(axes, start, stop, half)

    @staticmethod
    def rim(axes: tuple[Axis, ...]) -> float:
        """Width of the rim that a cell's interior leaves out, in axis units: 1e-9 cells, or some rounding errors."""
        return max(
            max(RIM * axis.spacing, 8 * float(np.spacing(max(abs(axis.lower), abs(axis.upper))))) for axis in axes
        )

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


def index_on(axis: Axis, value: float) -> int | None:
    """Number of the cell of an axis that a coordinate lies in; the upper of two on their border.

    Parameters
    ----------
    axis : Axis
    value : float
        In axis units; wrapped where the axis is periodic.

    Returns
    -------
    int or None
        None outside the axis, by more than rounding.
    """
    scaled = (value - axis.lower) / axis.spacing
    scaled = scaled % axis.cells if axis.periodic else scaled
    if not -RIM <= scaled <= axis.cells + RIM:
        return None
    return min(max(int(scaled), 0), axis.cells - 1)


def _clip(index: float, cells: int) -> int:
    if isinf(index):
        return 0 if index < 0 else cells
    return max(0, min(cells, ceil(index) if index > 0 else floor(index)))
