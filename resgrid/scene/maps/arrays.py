"""The cells of a map file (`MapCells`), and the reader of maps in NumPy format."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from io import BytesIO
from math import inf, prod
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Gt, Len
from numpy.typing import NDArray

from resgrid._internal.files import read_bytes
from resgrid._internal.memory import SMALLER_MAP, require_grid_memory
from resgrid._internal.values import frozen
from resgrid.core.axis import Axis
from resgrid.core.cell import MAX_DIMENSIONS, Cell
from resgrid.core.frame import Frame
from resgrid.errors import InputError
from resgrid.robots import CellSet, Robot

HEADER_READERS = {
    (1, 0): "read_array_header_1_0",
    (2, 0): "read_array_header_2_0",
    (3, 0): "read_array_header_2_0",  # differs from 2.0 only in the encoding of field names
}
"""Names of the functions of `numpy.lib.format` that read the header of an .npy file, by version of the format."""

HEADINGS = 36
"""Default number of cells of the heading axis of a turning robot on a map."""


@frozen
@dataclass(frozen=True, eq=False)
class MapCells:
    """Cells of a map file, with axes, frame and costs.

    The type of `Scene.map`, which `resgrid.read_scene` fills for a map file and for a scene with a ``[map]`` table.

    Attributes
    ----------
    axes : tuple of Axis
        Axes of the map in its own coordinates.  They are the axes of the scene, unless the scene's robot turns or is an
        arm.
    cell : ndarray of uint8, one dimension per axis
        `resgrid.Cell` codes on these axes, before obstacles grow by the robot's radius.
    frame : Frame
        Transformation from map coordinates to world coordinates.
    conductivity : ndarray of float64, shape of `cell`, or None
        Relative conductivity of every cell, a positive number; None where the map has no costs.
    unknown : ndarray of bool, shape of `cell`, or None
        Cells of unknown occupancy, which are obstacles or free in `cell`; None for a format without unknown cells.
    table : mapping
        The ``[map]`` table of the scene; ``file`` is an absolute path.
    surroundings : CellSet or None
        Obstacles of a cropped map: the obstacle cells of the part, and those around the part that the robot can touch
        from inside, on axes that extend beyond `axes`.  None if all obstacles are in `cell`.
    extent : float
        Largest `Robot.extent` for which `surroundings` is complete, in axis units; infinite for a map that is not
        cropped.
    obstacles : CellSet
        All obstacles of the map, as a shape in map coordinates; without unknown cells if the key
        ``inflate_around_unknown`` of `table` is false.

    Examples
    --------
    >>> cell = np.zeros((3, 2), dtype=np.uint8)
    >>> cell[1, 0], cell[2, 1] = rg.Cell.OBSTACLE, rg.Cell.GOAL
    >>> np.save("cells.npy", cell)
    >>> cells = rg.read_scene("cells.npy").map
    >>> [axis.cells for axis in cells.axes], cells.unknown
    ([3, 2], None)
    >>> cells.cell
    array([[0, 0],
           [1, 0],
           [0, 2]], dtype=uint8)
    """

    axes: tuple[Axis, ...]
    cell: NDArray[np.uint8]
    frame: Frame = field(default_factory=Frame)
    conductivity: NDArray[np.float64] | None = None
    unknown: NDArray[np.bool_] | None = None
    table: Mapping[str, Any] = field(default_factory=dict)
    surroundings: CellSet | None = None
    extent: float = inf

    def with_table(self, table: Mapping[str, Any]) -> MapCells:
        """Return a copy of the map with another ``[map]`` table; the axes that this table lists become periodic.

        Parameters
        ----------
        table : mapping
            The table; ``periodic`` lists names of axes, and all other axes become not periodic.

        Returns
        -------
        MapCells

        Raises
        ------
        InputError
            If the map has no axis of a listed name.
        """
        names, periodic = [axis.name for axis in self.axes], table.get("periodic", ())
        for name in periodic:
            if name not in names:
                raise InputError(f"map.periodic: there is no axis {name!r}; the map has {', '.join(names)}")
        axes = tuple(replace(axis, periodic=axis.name in periodic) for axis in self.axes)
        around = self.surroundings
        if around is not None:
            around = CellSet(tuple(replace(axis, periodic=axis.name in periodic) for axis in around.axes), around.mask)
        return replace(self, axes=axes, table=table, surroundings=around)

    @property
    def obstacles(self) -> CellSet:
        """Obstacle cells of the map, and those around a cropped map that the robot can touch, in map coordinates.

        Unknown cells are not included if the key ``inflate_around_unknown`` of `table` is false.
        """
        if self.surroundings is not None:
            return self.surroundings
        blocked = self.cell == Cell.OBSTACLE
        if self.unknown is not None and not self.table.get("inflate_around_unknown", True):
            blocked &= ~self.unknown
        return CellSet(self.axes, blocked)

    def space_of(self, robot: Robot) -> tuple[tuple[Axis, ...], Frame]:
        """Return the axes and the frame of the configuration space of a robot on this map.

        Parameters
        ----------
        robot : Robot
            The robot.

        Returns
        -------
        axes : tuple of Axis
            Axes of the space; a turning robot adds one for its heading.
        frame : Frame
            Transformation from axis units to world coordinates.

        Raises
        ------
        InputError
            If the map was cropped for a smaller robot, or the robot does not fit on a map.
        """
        if robot.extent > self.extent:
            raise InputError(
                f"the map was cropped for a robot that extends {self.extent:g} from its reference point, and this "
                f"robot extends {robot.extent:g}; read the scene again with this robot"
            )
        if robot.turning_length is not None and len(self.axes) != 2:
            names = ", ".join(axis.name for axis in self.axes)
            raise InputError(
                f"{self.table.get('file', 'map')}: a robot that turns moves in the plane, but this map has the axes "
                f"{names}; use a point or a ball (robot.radius)"
            )
        axes = robot.axes_on_map(self.axes, self.table.get("headings", HEADINGS))
        return tuple(axes), replace(self.frame, turning_length=robot.turning_length)

    def without_obstacles(self) -> MapCells:
        """Return a copy of the map in which obstacle cells are free, without unknown cells and obstacles around it."""
        cell = np.where(self.cell == Cell.OBSTACLE, np.uint8(Cell.FREE), self.cell)
        return replace(self, cell=cell, unknown=None, surroundings=None)


def cells_from_rows(rows: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the pixels of a picture as cells (width, height): x along the first axis, y upwards along the second.

    `rows` (height, width): values of the pixels, top row first.
    """
    return np.ascontiguousarray(rows[::-1].T)


def placed_axes(
    shape: tuple[int, ...],
    spacing: Annotated[float, Gt(0)] = 1.0,
    origin: Annotated[tuple[float, ...], Len(1, 4)] | None = None,
    unit: str | None = None,
) -> tuple[Axis, ...]:
    """Return the axes of a map from a file format without position and resolution.

    `shape`: number of cells along each axis.

    Parameters
    ----------
    spacing
        Width of a cell; required for point clouds, otherwise 1 by default.
    origin
        Lower corner of the map; by default all coordinates are 0.
    unit
        Unit of lengths; by default cell for a spacing of 1, otherwise m.
    """
    corner = [0.0] * len(shape) if origin is None else origin
    if len(corner) != len(shape):
        raise InputError(f"map.origin: needs {len(shape)} coordinates, one for each axis, got {len(corner)}")
    label = unit or ("cell" if spacing == 1 else "m")
    return tuple(
        Axis(name, float(low), low + cells * spacing, cells, unit=label)
        for name, low, cells in zip("xyzw", corner, shape, strict=False)
    )


def read_npy(path: Path) -> NDArray[np.uint8]:
    """Return the cell codes of a file in NumPy format; axes and order of the array are those of the map.

    The file holds codes (0 free, 1 obstacle, 2 goal) or booleans (true is an obstacle).
    """
    data = read_bytes(path)
    _check_npy(data, path)
    try:
        array = np.lib.format.read_array(BytesIO(data), allow_pickle=False)
    except (ValueError, TypeError, EOFError, OSError) as error:
        raise InputError(f"{path}: the array is damaged ({error}); copy or save it again") from None
    wrong = ~np.isin(array, list(Cell))
    if wrong.any():
        where = tuple(int(i) for i in np.argwhere(wrong)[0])
        raise InputError(f"{path}: cell {where} is {array[where]}; it must be 0 (free), 1 (obstacle) or 2 (goal)")
    return np.ascontiguousarray(array, dtype=np.uint8)


def _check_npy(data: bytes, path: Path) -> None:
    """Raise InputError or BudgetError if the header of an .npy file describes an invalid or too large array.

    `data`: content of the file; `path`: name of the file, for messages.  The check precedes the allocation of memory.
    """
    stream = BytesIO(data)
    try:
        version = np.lib.format.read_magic(stream)
        read_header = getattr(np.lib.format, HEADER_READERS[version])
        shape, _, dtype = read_header(stream)
    except Exception as error:  # for damaged headers, Python's tokenizer raises exceptions of many types
        raise InputError(f"{path}: this is not a readable .npy file ({error}); save it with np.save") from None
    if dtype.kind not in "bui":
        raise InputError(
            f"{path}: cells must be whole numbers or booleans, but this array has dtype {dtype}; save it with "
            ".astype(np.uint8)"
        )
    if not 1 <= len(shape) <= MAX_DIMENSIONS or min(shape) < 1:
        raise InputError(
            f"{path}: the array has shape {shape}; a map has 1 to {MAX_DIMENSIONS} axes of at least 1 cell each"
        )
    require_grid_memory(shape, str(path), remedy=SMALLER_MAP)
    missing = prod(shape) * dtype.itemsize - (len(data) - stream.tell())
    if missing > 0:
        raise InputError(f"{path}: the file is cut short: {missing} bytes are missing; copy it again")
