"""What a map file says, in the package's own terms; every reader of maps returns it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.frame import Frame
from resgrid.space import Axis


@dataclass(frozen=True, eq=False)
class MapData:
    """What a map file says.

    `axes`: the grid, in the map's own coordinates; `frame`: from those to the world's; `cell`: `resgrid.space.Cell`
    codes on the grid; `conductivity`: of free cells, on the grid, or None.
    """

    axes: tuple[Axis, ...]
    frame: Frame
    cell: NDArray[np.uint8]
    conductivity: NDArray[np.float64] | None = None

    def around(self, periodic: Sequence[str]) -> MapData:
        """The same map, its named axes closed to rings."""
        names = [axis.name for axis in self.axes]
        for name in periodic:
            if name not in names:
                raise InputError(f"map.periodic: there is no axis {name!r}; the map has {', '.join(names)}")
        return replace(self, axes=tuple(replace(axis, periodic=axis.name in periodic) for axis in self.axes))


def cells_from_rows(rows: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Picture rows (height, width), the top one first, turned into cells (width, height): x first and y upwards."""
    return np.ascontiguousarray(rows[::-1].T)


def placed_axes(
    shape: tuple[int, ...],
    spacing: float = 1.0,
    origin: Sequence[float] | None = None,
    unit: str | None = None,
) -> tuple[Axis, ...]:
    """Axes of a map that does not say where it lies."""
    corner = [0.0] * len(shape) if origin is None else origin
    if len(corner) != len(shape):
        raise InputError(f"map.origin: needs {len(shape)} coordinates, one for each axis, got {len(corner)}")
    label = unit or ("cell" if spacing == 1 else "m")
    return tuple(
        Axis(name, float(low), low + cells * spacing, cells, unit=label)
        for name, low, cells in zip("xyzw", corner, shape, strict=False)
    )
