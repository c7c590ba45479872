"""What a change of cells does to the equations, in a box around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.compiler import behind_wall, has_wall, in_series, of_face
from resgrid.grids import label_regions, slab
from resgrid.solvers.warm import Window, neighbours
from resgrid.space import Cell, ConfigurationSpace
from resgrid.wiring import Wiring

_WINDOW, _SHARE = 12_000, 16
"""Cells of a window, and the share of the space, where the change itself does not take more."""

Box = tuple[slice, ...]

_LEAST_REACH = 6
_MOST_TILES, _TILE = 16, 32
_MOST = 4
"""Share of the space beyond which windows are no gain."""


@dataclass(frozen=True, eq=False)
class _Codes:
    """What the cells of a box are: solved for or free to be (`free`), at the high rail, at the low one."""

    free: NDArray[np.bool_]
    high: NDArray[np.bool_]
    low: NDArray[np.bool_]

    @classmethod
    def of(cls, space: ConfigurationSpace, wiring: Wiring, box: tuple[slice, ...]) -> _Codes:
        cell = space.cell[box]
        free, high = cell == Cell.FREE, cell == Cell.OBSTACLE
        if wiring.boundary == "neumann":
            high = np.zeros_like(high)
        if wiring.start is not None and all(
            ends.start <= i < ends.stop for i, ends in zip(wiring.start, box, strict=True)
        ):
            start = tuple(int(i) - ends.start for i, ends in zip(wiring.start, box, strict=True))
            free[start], high[start] = False, True
        return cls(free, high, cell == Cell.GOAL)


def boxes_around(space: ConfigurationSpace, cells: NDArray[np.int64]) -> list[tuple[Box, Box]] | None:
    """Boxes around changed cells, and the range of cells in each whose equations change; None if these are many.

    Shapes: `cells` (k, ndim).
    """
    tile, number = np.unique(cells // _TILE, axis=0, return_inverse=True)
    if len(tile) > _MOST_TILES:
        return None
    end = np.array(space.shape)
    side = min(_WINDOW, space.cell.size / _SHARE) ** (1 / space.ndim)
    found: list[tuple[NDArray[np.int64], NDArray[np.int64]]] = []
    for k in range(len(tile)):
        here = cells[number.ravel() == k]
        first, last = here.min(axis=0) - 2, here.max(axis=0) + 3
        while met := next((other for other in found if _meet(other, (first, last), side)), None):
            found = [other for other in found if other is not met]
            first, last = np.minimum(first, met[0]), np.maximum(last, met[1])
        found.append((first, last))
    boxes = []
    for first, last in found:
        reach = _reach(first, last, side)
        low = np.maximum(first - reach - 1, 0)
        if low.sum() % 2:
            low[np.argmax(low)] -= 1  # colours are those of the whole grid
        high = np.minimum(last + reach + 1, end)
        around = tuple(slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
        inside = (np.maximum(first, 0), np.minimum(last, end))
        boxes.append((around, tuple(slice(int(a), int(b)) for a, b in zip(*inside, strict=True))))
    volume = sum(np.prod([ends.stop - ends.start for ends in around]) for around, _ in boxes)
    return boxes if volume <= max(space.cell.size / _MOST, _WINDOW) else None


def _reach(first: NDArray[np.int64], last: NDArray[np.int64], side: float) -> NDArray[np.int64]:
    """How far a window reaches beyond a change."""
    return np.maximum((side - (last - first)) / 2, _LEAST_REACH).astype(np.int64)


def _meet(
    one: tuple[NDArray[np.int64], NDArray[np.int64]], other: tuple[NDArray[np.int64], NDArray[np.int64]], side: float
) -> bool:
    apart = _reach(*one, side) + _reach(*other, side) + 2
    return bool(np.all((one[0] - apart <= other[1]) & (other[0] - apart <= one[1])))


def rows_after(
    old: ConfigurationSpace,
    new: ConfigurationSpace,
    wiring: Wiring,
    box: tuple[slice, ...],
    before: NDArray[np.bool_],
) -> NDArray[np.bool_] | None:
    """Which cells of a box have rows after a change; None where more than the box tells must be known.

    All cells around the change that keep their rows, and those freed, hang together in the box, with every rail of
    which they lose a contact; but for parts that are cut off within the box, and from the low rail.  Shapes, as the
    box: `before` (which had rows).
    """
    was, codes = _Codes.of(old, wiring, box), _Codes.of(new, wiring, box)
    changed = (was.free != codes.free) | (was.low != codes.low) | (was.high != codes.high)
    near, stays, edge = _grown(changed), before & codes.free, _beyond(new, wiring, box)
    if np.any(codes.free & near & ~changed & ~before):
        return None  # a part that carried no current is joined
    part = label_regions(stays | (codes.free & changed), (False,) * new.ndim)
    held, leading_out = np.unique(part[near & stays]), np.unique(part[_rim(new, box)])
    main = held if len(held) == 1 else np.intersect1d(held, leading_out)
    if len(main) > 1 or (len(main) == 0 and np.any(before & changed)):
        return None
    joined = np.isin(part, main)
    cut_off = np.isin(part, np.setdiff1d(held, main))
    apart = cut_off | (codes.free & changed & ~joined)
    to_low, to_high = _grown(codes.low), _grown(codes.high) | edge
    if np.any(apart & to_low):
        return None
    lost_low = changed & (was.low | (before & _grown(was.low)))
    lost_high = cut_off & to_high | changed & (was.high | (before & (_grown(was.high) | edge)))
    if np.any(lost_low) and not np.any(joined & to_low):
        return None
    if wiring.drive != "uniform" and np.any(lost_high) and not np.any(joined & to_high):
        return None
    return np.asarray(joined | (stays & ~cut_off))


def window_of(
    space: ConfigurationSpace,
    wiring: Wiring,
    box: tuple[slice, ...],
    changed: tuple[slice, ...],
    row: NDArray[np.bool_],
    amps: float,
) -> Window | None:
    """The equations of a box, with the high rail at 1 V, the low one at 0 V, and so many amperes into every row.

    Shapes: `row` as the box.  None if the change meets the seam of a periodic axis.
    """
    codes, cell = _Codes.of(space, wiring, box), space.cell[box]
    conductivity = None if space.conductivity is None else space.conductivity[box]
    ground, drive = np.zeros(row.shape), np.where(row, amps, 0.0)
    edges = []
    for axis in range(space.ndim):
        edge = _across(space, wiring, axis, cell, conductivity)
        (row_below, row_above), (high_below, high_above) = neighbours(row, axis), neighbours(codes.high, axis)
        low_below, low_above = neighbours(codes.low, axis)
        ground_below, ground_above = neighbours(ground, axis)
        drive_below, drive_above = neighbours(drive, axis)
        ground_below += np.where(row_below & (high_above | low_above), edge, 0.0)
        ground_above += np.where(row_above & (high_below | low_below), edge, 0.0)
        drive_below += np.where(row_below & high_above, edge, 0.0)
        drive_above += np.where(row_above & high_below, edge, 0.0)
        edges.append(np.where(row_below & row_above, edge, 0.0))
        tie = _to_edge(space, wiring, box, axis, conductivity)
        ground += np.where(row, tie, 0.0)
        drive += np.where(row, tie, 0.0)
    core = []
    for ends, near, size, along in zip(box, changed, space.shape, space.axes, strict=True):
        begin = 0 if ends.start == 0 and not along.periodic else 1
        end = ends.stop - ends.start - (0 if ends.stop == size and not along.periodic else 1)
        if near.start - ends.start < begin or near.stop - ends.start > end:
            return None
        core.append(slice(begin, end))
    return Window(
        low=tuple(ends.start for ends in box),
        row=row,
        edges=tuple(edges),
        ground=ground,
        drive=drive,
        core=tuple(core),
        changed=tuple(slice(near.start - e.start, near.stop - e.start) for near, e in zip(changed, box, strict=True)),
    )


def _across(
    space: ConfigurationSpace,
    wiring: Wiring,
    axis: int,
    cell: NDArray[np.uint8],
    conductivity: NDArray[np.float64] | None,
) -> NDArray[np.float64]:
    """Conductances from every cell of a box to the next one along an axis, whatever the two are."""
    below, above = neighbours(cell, axis)
    edge = np.full(below.shape, of_face(space.spacing, axis, wiring.resistance))
    if conductivity is not None:
        edge *= in_series(*neighbours(conductivity, axis), below == Cell.FREE, above == Cell.FREE)
    wall = has_wall(below == Cell.OBSTACLE, above == Cell.OBSTACLE)
    edge[wall] = 0.0 if wiring.boundary == "neumann" else behind_wall(edge[wall], wiring.wall_resistance)
    return edge


def _to_edge(
    space: ConfigurationSpace,
    wiring: Wiring,
    box: tuple[slice, ...],
    axis: int,
    conductivity: NDArray[np.float64] | None,
) -> NDArray[np.float64]:
    """Conductances to the edge of the grid across an axis, where it is an obstacle; of the box's shape."""
    tie = np.zeros([ends.stop - ends.start for ends in box])
    size = tie.shape[axis]
    for at_edge, end in ((box[axis].start == 0, (0, 1)), (box[axis].stop == space.shape[axis], (size - 1, size))):
        if at_edge:
            cells = slab(tie, axis, *end)
            cells += _edge_tie(space, wiring, axis, None if conductivity is None else slab(conductivity, axis, *end))
    return tie


def _edge_tie(
    space: ConfigurationSpace, wiring: Wiring, axis: int, conductivity: NDArray[np.float64] | None
) -> NDArray[np.float64] | float:
    """Conductances from cells at the edge of the grid to the rail beyond it, 0 where there is none; as the cells'."""
    if wiring.boundary == "neumann" or wiring.edges(space)[axis] != "obstacle":
        return 0.0
    one = np.asarray(of_face(space.spacing, axis, wiring.resistance) * (1.0 if conductivity is None else conductivity))
    return behind_wall(one, wiring.wall_resistance)


def _beyond(space: ConfigurationSpace, wiring: Wiring, box: tuple[slice, ...]) -> NDArray[np.bool_]:
    """Cells of a box at an edge of the grid that counts as an obstacle."""
    ties = [_to_edge(space, wiring, box, axis, None) for axis in range(space.ndim)]
    return np.asarray(sum(ties) > 0.0)


def _rim(space: ConfigurationSpace, box: tuple[slice, ...]) -> NDArray[np.bool_]:
    """Cells of a box from which others outside it are reached."""
    rim = np.zeros([ends.stop - ends.start for ends in box], dtype=np.bool_)
    for axis, ends in enumerate(box):
        periodic = space.axes[axis].periodic
        if periodic or ends.start > 0:
            slab(rim, axis, 0, 1)[...] = True
        if periodic or ends.stop < space.shape[axis]:
            slab(rim, axis, rim.shape[axis] - 1, rim.shape[axis])[...] = True
    return rim


def _grown(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A mask and all face neighbours."""
    grown = mask.copy()
    for axis in range(mask.ndim):
        (below, above), (lower, upper) = neighbours(grown, axis), neighbours(mask, axis)
        below |= upper
        above |= lower
    return grown
