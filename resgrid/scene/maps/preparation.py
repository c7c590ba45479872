"""Preparation of a map after its reading: crop to a part, then coarsen or refine its cells."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import product
from math import ceil, floor, inf, isfinite, prod
from typing import Annotated, Any, Literal, Protocol

import numpy as np
from annotated_types import Ge, Le, Len
from numpy.typing import NDArray

from resgrid._internal.coordinates import interval_text
from resgrid.core.axis import Axis, rounding
from resgrid.core.cell import Cell
from resgrid.core.frame import Frame
from resgrid.errors import InputError
from resgrid.robots import CellSet
from resgrid.scene.maps.arrays import MapCells
from resgrid.scene.maps.size_advice import require_divided_memory

Window = tuple[tuple[int, int], ...]
"""Part of a map: for each axis the index of its first cell, and of the cell after its last one."""


class MapSource(Protocol):
    """Interface of a map of which parts can be read."""

    @property
    def axes(self) -> tuple[Axis, ...]:
        """Axes of the whole map, in its own coordinates."""

    @property
    def frame(self) -> Frame:
        """Transformation from map coordinates to world coordinates."""

    def known(self) -> Window | None:
        """Return the index ranges (first, end), one per axis, end excluded, of the smallest box with all known cells.

        None if no cell is known.  Raises InputError for a format without unknown cells.
        """

    def cells(self, window: Window) -> MapCells:
        """Return the cells of a part, with its axes; `window`: index range (first, end) per axis, end excluded."""


@dataclass(frozen=True)
class Preparation:
    """Changes of a map between its file and the scene, in this order: crop, then coarsen or refine.

    Attributes
    ----------
    crop
        Part of the map that is kept, by default the whole map: `"known"` (the smallest box with all cells of known
        occupancy), or lower and upper corner of a box in world coordinates, `[x0, y0, x1, y1]` in the plane.  On a
        rotated map, the part is the smallest rectangle of rows and columns that covers the box.  Obstacles outside the
        part that the robot can touch from inside still count.
    coarsen
        Number n of cells along each axis that are joined into one.  A coarse cell is free only if all its cells are
        free, and its conductivity is their smallest one.  Coarse cells that extend past the map are obstacles.
    refine
        Number n of cells into which each cell is divided along each axis.
    inflate_around_unknown
        Whether the robot's body stays out of unknown cells that are obstacles; otherwise only its reference point does.
        Nav2's inflation layer has a parameter of this name, whose default is the opposite.
    extent
        Largest distance from the robot's reference point to a point of the robot, in axis units; not a key of files.
    """

    crop: Literal["known"] | Annotated[tuple[float, ...], Len(2, 8)] | None = None
    coarsen: Annotated[int, Ge(1), Le(10**6)] = 1
    refine: Annotated[int, Ge(1), Le(10**3)] = 1
    inflate_around_unknown: bool = True
    extent: float = 0.0

    @classmethod
    def of(cls, table: Mapping[str, Any], extent: float) -> Preparation:
        """Return the cropping, joining and dividing of cells that a ``[map]`` table demands.

        `extent`: largest distance from the robot's reference point to a point of the robot, in axis units. Raises
        InputError if the table both joins and divides cells.
        """
        given = {key: table[key] for key in KEYS if table.get(key) is not None}
        preparation = cls(**given, extent=extent)
        if preparation.coarsen > 1 and preparation.refine > 1:
            raise InputError(
                f"map.coarsen = {preparation.coarsen} and map.refine = {preparation.refine} exclude each other; remove "
                "one of them"
            )
        return preparation

    def apply(self, source: MapSource, periodic: Sequence[str] = ()) -> MapCells:
        """Return the cells of a map after cropping, and after joining or dividing cells.

        `source`: the map; `periodic`: names of its periodic axes. Raises InputError if the cropped part is empty, if a
        periodic axis would be cut, or if cells are joined over more than the map.
        """
        axes = source.axes
        whole = whole_window(axes)
        kept = whole if self.crop is None else self._window(source)
        step = self.coarsen
        _require_joined_cells(axes, kept, step)
        inner = tuple((first, first + step * ceil((end - first) / step)) for first, end in kept)
        for axis, part, full in zip(axes, inner, whole, strict=True):
            if axis.name in periodic and part != full:
                key = "crop" if self.crop is not None else "coarsen"
                raise InputError(
                    f"map.{key}: this would cut the periodic axis {axis.name!r}, which has {axis.cells} cells; remove "
                    f"{key}, or remove {axis.name!r} from periodic"
                )
        margins = [self._margin(axis) for axis in axes]
        outer = tuple(
            (max(first - margin, 0), min(end + margin, axis.cells))
            for (first, end), margin, axis in zip(inner, margins, axes, strict=True)
        )
        if outer == inner and self.coarsen == self.refine == 1:
            return replace(source.cells(outer), extent=inf if self.crop is None else self.extent)
        return self._resized(source, inner, outer)

    def _margin(self, axis: Axis) -> int:
        """Return the width, in cells, of the border around a cropped part within which the robot can touch obstacles.

        The width is 0 without cropping, and for a point. `axis`: axis of the map along which the width is measured.
        """
        if self.crop is None or not self.extent:
            return 0
        return ceil(min(self.extent / axis.spacing, axis.cells)) + 2 * self.coarsen

    def _inflated(self, codes: NDArray[np.uint8], unknown: NDArray[np.bool_] | None) -> NDArray[np.bool_]:
        """Return the mask of obstacle cells that no point of the robot may touch, in the shape of `codes`.

        `codes`: cell codes; `unknown`: mask of unknown cells, None without any.  If `inflate_around_unknown` is False,
        unknown cells are not in the result.
        """
        blocked = np.asarray(codes == Cell.OBSTACLE)
        return blocked if self.inflate_around_unknown or unknown is None else np.asarray(blocked & ~unknown)

    def _window(self, source: MapSource) -> Window:
        if self.crop == "known":
            known = source.known()
            if known is None:
                raise InputError('map.crop = "known": no cell of this map is known; remove crop')
            return known
        assert self.crop is not None
        return window_of_box(source.axes, source.frame, self.crop)

    def _resized(self, source: MapSource, inner: Window, outer: Window) -> MapCells:
        """Return the cells of the window `inner`, joined or divided, with the obstacles around this window.

        `source`: the whole map; `outer`: window that contains these obstacles.
        """
        axes, step = source.axes, self.coarsen
        pads = []
        for (first, end), (low, high) in zip(inner, outer, strict=True):
            lead = (low - first) % step
            count = step * ceil((lead + max(high, end) - low) / step)
            pads.append((lead, count - lead - (high - low)))
        joined = _coarsened_in_bands(source, step, outer, pads)
        if self.refine > 1:
            require_divided_memory(joined[0].shape, self.refine)
        codes, unknown, conductivity = (_repeated(values, self.refine) for values in joined)
        assert codes is not None
        begins = [(low - lead, axis) for (low, _), (lead, _), axis in zip(outer, pads, axes, strict=True)]
        around = tuple(
            part_of(axis, begin, begin + size * step // self.refine, size)
            for (begin, axis), size in zip(begins, codes.shape, strict=True)
        )
        at = tuple(
            slice((first - begin) * self.refine // step, (end - begin) * self.refine // step)
            for (first, end), (begin, _) in zip(inner, begins, strict=True)
        )
        kept = tuple(
            part_of(axis, first, end, part.stop - part.start)
            for axis, (first, end), part in zip(axes, inner, at, strict=True)
        )
        is_whole = all(part == slice(0, size) for part, size in zip(at, codes.shape, strict=True))
        return MapCells(
            kept,
            np.ascontiguousarray(codes[at]),
            source.frame,
            None if conductivity is None else np.ascontiguousarray(conductivity[at]),
            None if unknown is None else np.ascontiguousarray(unknown[at]),
            surroundings=None if is_whole else CellSet(around, self._inflated(codes, unknown)),
            extent=inf if self.crop is None else self.extent,
        )


def _require_joined_cells(axes: Sequence[Axis], kept: Window, step: int) -> None:
    """Raise InputError if every joined cell would extend past the map, because all would then be obstacles.

    `axes`: axes of the map; `kept`: window of the cells that are joined; `step`: number of cells per axis that are
    joined into one.
    """
    most = min(axis.cells - first for axis, (first, _) in zip(axes, kept, strict=True))
    if step > most:
        size = " x ".join(str(end - first) for first, end in kept)
        raise InputError(
            f"map.coarsen = {step} exceeds the size of the map, {size} cells: every joined cell would extend past its "
            f"border and be an obstacle; give at most {most}"
        )


KEYS = tuple(item.name for item in fields(Preparation) if item.name != "extent")
"""Keys of a ``[map]`` table that crop the map or join or divide its cells, and ``inflate_around_unknown``."""


@dataclass(frozen=True)
class LoadedMap:
    """A map whose cells are all in memory, of which parts can be read; `loaded`: the cells."""

    loaded: MapCells

    @property
    def axes(self) -> tuple[Axis, ...]:
        """Axes of the whole map."""
        return self.loaded.axes

    @property
    def frame(self) -> Frame:
        """Transformation from map coordinates to world coordinates."""
        return self.loaded.frame

    def known(self) -> Window | None:
        """Return the index ranges (first, end), one per axis, end excluded, of the smallest box with all known cells.

        None if no cell is known.  Raises InputError for a format without unknown cells.
        """
        if self.loaded.unknown is None:
            raise no_unknown_cells(len(self.axes))
        return extent_of_mask(~self.loaded.unknown)

    def cells(self, window: Window) -> MapCells:
        """Return the cells of a part, copied unless it is the whole map; `window`: range (first, end) per axis."""
        at = tuple(slice(*ends) for ends in window)
        if all(part == slice(0, size) for part, size in zip(at, self.loaded.cell.shape, strict=True)):
            return self.loaded
        costs, unknown = self.loaded.conductivity, self.loaded.unknown
        return MapCells(
            axes_of_window(self.axes, window),
            np.ascontiguousarray(self.loaded.cell[at]),
            self.frame,
            None if costs is None else np.ascontiguousarray(costs[at]),
            None if unknown is None else np.ascontiguousarray(unknown[at]),
        )


def no_unknown_cells(ndim: int) -> InputError:
    """Return the InputError for ``crop = "known"`` on a map with `ndim` axes whose format has no unknown cells."""
    box = [0] * ndim + [10, 5, 3, 2][:ndim]
    return InputError(
        'map.crop = "known": this format has no unknown cells; give the part as a box in world coordinates, '
        f"such as crop = {box} (--crop {','.join(map(str, box))})"
    )


def extent_of_mask(mask: NDArray[np.bool_]) -> Window | None:
    """Return the ranges (first, end), one per axis, of the smallest box with all True entries; None without any."""
    ends = []
    for axis in range(mask.ndim):
        found = np.flatnonzero(mask.any(axis=tuple(other for other in range(mask.ndim) if other != axis)))
        if not len(found):
            return None
        ends.append((int(found[0]), int(found[-1]) + 1))
    return tuple(ends)


def window_of_box(axes: Sequence[Axis], frame: Frame, box: Sequence[float]) -> Window:
    """Return the index ranges (first, end), one per axis, of the fewest cells that cover the part of a box in the map.

    `axes`: axes of the map; `frame`: transformation from map coordinates to the world; `box`: lower corner, then upper
    corner, in world coordinates. Raises InputError for a box without an inside, or without a common cell with the map.
    """
    ndim = len(axes)
    if len(box) != 2 * ndim:
        raise InputError(
            f"map.crop needs {2 * ndim} numbers, the lower and the upper corner of a box in world coordinates, got "
            f"{len(box)}"
        )
    check_corners(box)
    lower, upper = box[:ndim], box[ndim:]
    corners = frame.from_world(np.array(list(product(*zip(lower, upper, strict=True)))))
    slack = rounding(axes, frame.reach(axes)) * 8
    window = []
    for axis, low, high, loose in zip(axes, corners.min(axis=0), corners.max(axis=0), slack, strict=True):
        first, end = (low - axis.lower) / axis.spacing + loose, (high - axis.lower) / axis.spacing - loose
        window.append((max(floor(max(first, -1)), 0), min(ceil(min(end, axis.cells + 1)), axis.cells)))
    if any(first >= end for first, end in window):
        edges = frame.to_world(np.array(list(product(*((axis.lower, axis.upper) for axis in axes)))))
        extent = ", ".join(
            interval_text(axis.name, low, high)
            for axis, low, high in zip(axes, edges.min(axis=0), edges.max(axis=0), strict=True)
        )
        raise InputError(f"map.crop = {list(box)}: this box lies outside the map, which extends over {extent}")
    return tuple(window)


def check_corners(box: Sequence[float]) -> None:
    """Raise InputError unless both corners of a box are finite, and the lower one is below the upper one on each axis.

    `box`: coordinates of the lower corner, then of the upper corner.
    """
    lower, upper = box[: len(box) // 2], box[len(box) // 2 :]
    if not all(isfinite(low) and isfinite(high) and low < high for low, high in zip(lower, upper, strict=True)):
        raise InputError(f"map.crop = {list(box)}: the lower corner comes first, and must lie below the upper corner")


def whole_window(axes: Sequence[Axis]) -> Window:
    """Return the index ranges of all cells of a map with the given axes: (0, number of cells) for each axis."""
    return tuple((0, axis.cells) for axis in axes)


def axes_of_window(axes: Sequence[Axis], window: Window) -> tuple[Axis, ...]:
    """Return the axes of a part of a map with the axes `axes`; `window`: index range (first, end) for each axis."""
    return tuple(part_of(axis, first, end, end - first) for axis, (first, end) in zip(axes, window, strict=True))


def part_of(axis: Axis, first: int, end: int, cells: int) -> Axis:
    """Return the axis between two cell borders of `axis`, divided into `cells` cells.

    `first`, `end`: indices of the borders; border 0 is the lower end of `axis`.
    """
    if (first, end, cells) == (0, axis.cells, axis.cells):
        return axis
    lower, upper = (axis.lower + border * axis.spacing for border in (first, end))
    return replace(axis, lower=lower, upper=axis.upper if end == axis.cells else upper, cells=cells)


Arrays = tuple[NDArray[np.uint8], NDArray[np.bool_] | None, NDArray[np.float64] | None]
"""Cell codes, mask of unknown cells, and conductivities of a map, of equal shapes; the last two may be None."""

_CELLS_PER_BAND = 1 << 22
"""Number of cells of a map that are read at once before they are joined to coarse cells; limits the memory."""


def _coarsened_in_bands(source: MapSource, step: int, window: Window, pads: Sequence[tuple[int, int]]) -> Arrays:
    """Return codes, unknown cells and conductivity of the joined cells of a window, read in bands along the last axis.

    `source`: the map; `step`: number of cells along each axis that are joined into one; `window`: the cells to join;
    `pads`: numbers of cells of the map that are added at the lower end (free cells) and at the upper end (obstacles) of
    each axis, before cells are joined.
    """
    (low, high), (lead, tail) = window[-1], pads[-1]
    width = prod(end - first for first, end in window[:-1])
    count = high - low if step == 1 else step * max(1, _CELLS_PER_BAND // (step * width))
    parts = []
    first = low
    while first < high:
        end = min(first + count - (lead if first == low else 0), high)
        ends = (lead if first == low else 0, tail if end == high else 0)
        parts.append(_coarsened(source.cells((*window[:-1], (first, end))), step, [*pads[:-1], ends]))
        first = end
    codes, unknown, costs = zip(*parts, strict=True)
    joined = (None if part[0] is None else np.concatenate(part, axis=-1) for part in (codes, unknown, costs))
    return tuple(joined)  # type: ignore[return-value]


def _coarsened(cells: MapCells, step: int, pads: Sequence[tuple[int, int]]) -> Arrays:
    """Return codes, unknown cells and conductivity of coarse cells, each of `step` cells along every axis.

    `cells`: the fine cells; `pads`: number of cells added before and after them along each axis, free before and
    obstacles after. A coarse cell is an obstacle if one of its cells is an obstacle, otherwise a goal if one of its
    cells is a goal. It is unknown if one of its cells is unknown and none is a known obstacle. Its conductivity is the
    smallest one of its cells, as Nav2's CostmapDownsampler takes the largest cost.
    """
    unknown = cells.unknown
    if step == 1:
        return cells.cell, unknown, cells.conductivity
    before = [(lead, 0) for lead, _ in pads]
    after = [(0, tail) for _, tail in pads]

    def joined(mask: NDArray[np.bool_], tail: bool = False) -> NDArray[np.bool_]:
        padded = np.pad(np.pad(mask, before), after, constant_values=tail)
        return np.asarray(_blocks(padded, step).any(axis=tuple(range(1, 2 * mask.ndim, 2))))

    blocked = cells.cell == Cell.OBSTACLE
    occupied = joined(blocked if unknown is None else blocked & ~unknown, tail=True)
    unseen = None if unknown is None else joined(unknown) & ~occupied
    codes = np.where(joined(cells.cell == Cell.GOAL), np.uint8(Cell.GOAL), np.uint8(Cell.FREE))
    codes[joined(blocked, tail=True)] = Cell.OBSTACLE
    conductivity = None
    if cells.conductivity is not None:
        padded = np.pad(cells.conductivity, pads, constant_values=inf)
        conductivity = _blocks(padded, step).min(axis=tuple(range(1, 2 * padded.ndim, 2)))
        conductivity[np.isinf(conductivity)] = 1.0
    return codes, unseen, conductivity


def _repeated(values: NDArray[Any] | None, times: int) -> NDArray[Any] | None:
    """Return an array with every entry repeated `times` times along every axis; None stays None."""
    if values is not None and times > 1:
        for axis in range(values.ndim):
            values = np.repeat(values, times, axis=axis)
    return values


def _blocks(values: NDArray[Any], step: int) -> NDArray[Any]:
    """Return a view of an array whose axes are divided into blocks of `step` entries: shape (n, step, m, step, ...)."""
    return values.reshape(tuple(part for size in values.shape for part in (size // step, step)))
