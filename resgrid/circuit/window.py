"""What a change of cells does to the equations, in a box around it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.compiler import Kind, contacts_of_box
from resgrid.grids import before_and_behind, label_regions, slab
from resgrid.solvers.warm import Window, neighbours
from resgrid.space import ConfigurationSpace
from resgrid.wiring import Wiring

_WINDOW, _SHARE = 12_000, 16
"""Cells of a window, and the share of the space, where the change itself does not take more."""

Box = tuple[slice, ...]

_LEAST_REACH = 6
_MOST_TILES, _TILE = 16, 32
_MOST = 4
"""Share of the space beyond which windows are no gain."""


class _Cells(NamedTuple):
    """What the cells of a box are, of its shape: nodes, or at either rail; and whether they touch either rail."""

    free: NDArray[np.bool_]
    low: NDArray[np.bool_]
    high: NDArray[np.bool_]
    by_low: NDArray[np.bool_]
    by_high: NDArray[np.bool_]

    @classmethod
    def of(cls, space: ConfigurationSpace, wiring: Wiring, box: Box) -> _Cells:
        """The cells of a space."""
        kind = contacts_of_box(space, wiring, _ranges(box), connected=False).kind
        is_kind = (kind == Kind.NODE, kind == Kind.LOW, kind == Kind.HIGH)
        inside = (slice(1, -1),) * space.ndim
        return cls(*(cells[inside] for cells in (*is_kind, _grown(is_kind[1]), _grown(is_kind[2]))))


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
    was, now = (_Cells.of(space, wiring, box) for space in (old, new))
    changed, free = (was.free != now.free) | (was.low != now.low) | (was.high != now.high), now.free
    near, stays = _grown(changed), before & free
    if np.any(free & near & ~changed & ~before):
        return None  # a part that carried no current is joined
    part = label_regions(stays | (free & changed), (False,) * new.ndim)
    held, leading_out = np.unique(part[near & stays]), np.unique(part[_rim(new, box)])
    main = held if len(held) == 1 else np.intersect1d(held, leading_out)
    if len(main) > 1 or (len(main) == 0 and np.any(before & changed)):
        return None
    joined = np.isin(part, main)
    cut_off = np.isin(part, np.setdiff1d(held, main))
    apart = cut_off | (free & changed & ~joined)
    if np.any(apart & now.by_low):
        return None
    lost_low = changed & (was.low | (before & was.by_low))
    lost_high = cut_off & now.by_high | changed & (was.high | (before & was.by_high))
    if np.any(lost_low) and not np.any(joined & now.by_low):
        return None
    if wiring.drive != "uniform" and np.any(lost_high) and not np.any(joined & now.by_high):
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
    contacts = contacts_of_box(space, wiring, _ranges(box), connected=False)
    ground, drive = np.zeros(row.shape), np.where(row, amps, 0.0)
    edges = []
    for axis, siemens in enumerate(contacts.conductance):
        cells = row.shape[axis]
        for kind, first in zip(before_and_behind(contacts.kind, axis), (0, 1), strict=True):
            tie, beside = slab(siemens, axis, first, first + cells), slab(kind, axis, first, first + cells)
            ground += np.where(row & (beside != Kind.NODE), tie, 0.0)
            drive += np.where(row & (beside == Kind.HIGH), tie, 0.0)
        below, above = neighbours(row, axis)
        edges.append(np.where(below & above, slab(siemens, axis, 1, cells), 0.0))
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


def _ranges(box: Box) -> list[tuple[int, int]]:
    return [(ends.start, ends.stop) for ends in box]


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
