"""Compiled loops over the rows of a plane grid: the cells near parallelograms, and those that rings enclose.

Numba takes seconds to import: only functions that are about to sample import this module.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.jit import inner

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]


class Plane(NamedTuple):
    """A grid of the plane, and what stands for a cell: a box around its centre.

    `x, y`: lower corner; `width, height`: of a cell; `half_x, half_y`: half the width and height of what stands for a
    cell; 0 for its centre alone.
    """

    x: float
    y: float
    width: float
    height: float
    half_x: float
    half_y: float


@inner
def _index(scaled: float, count: int) -> int:
    """A coordinate counted in cells as an index from 0 to ``count``, rounded up."""
    return math.ceil(min(max(scaled, 0.0), float(count)))


@inner
def _extent_of_disc(y: float, radius: float, low: float, high: float) -> float:
    """Half the width of what a row cuts from a disc; negative where it cuts nothing."""
    away = max(0.0, low - y, y - high)
    return math.sqrt((radius - away) * (radius + away)) if away <= radius else -1.0


@inner
def _ends_of_segment(ax: float, ay: float, bx: float, by: float, low: float, high: float) -> tuple[float, float]:
    """Smallest and largest x of what a row cuts from a segment; reversed where it cuts nothing."""
    if ay > by:
        ax, ay, bx, by = bx, by, ax, ay
    if ay > high or by < low:
        return math.inf, -math.inf
    first, last = ax, bx
    if ay < low:
        first = ax + (low - ay) * ((bx - ax) / (by - ay))
    if by > high:
        last = ax + (high - ay) * ((bx - ax) / (by - ay))
    return min(first, last), max(first, last)


@njit(cache=True)
def mark_parallelograms(out: Flags, pieces: Floats, reach: float, plane: Plane) -> None:
    """Mark the cells that come within a distance of a parallelogram.

    What lies within a distance of a convex set is convex, and so is what a row of cells cuts from it: an interval of
    x decides a whole row.  It ends on the circles around the corners, or on the edges moved outwards.

    Shapes: `out` (columns, rows), `pieces` (p, 6).
    """
    columns, rows = out.shape
    for piece in range(len(pieces)):
        x, y, ax, ay, bx, by = pieces[piece]
        lowest = y + min(0.0, ay) + min(0.0, by) - reach - plane.half_y
        highest = y + max(0.0, ay) + max(0.0, by) + reach + plane.half_y
        first = _index((lowest - plane.y) / plane.height - 1.5, rows)
        last = _index((highest - plane.y) / plane.height + 0.5, rows)
        for row in range(first, last):
            middle = plane.y + (row + 0.5) * plane.height
            low, high = middle - plane.half_y, middle + plane.half_y
            left, right = math.inf, -math.inf
            for corner in range(4):
                cx = x + (ax if corner & 1 else 0.0) + (bx if corner & 2 else 0.0)
                cy = y + (ay if corner & 1 else 0.0) + (by if corner & 2 else 0.0)
                extent = _extent_of_disc(cy, reach, low, high)
                if extent >= 0.0:
                    left, right = min(left, cx - extent), max(right, cx + extent)
            for edge in range(4):
                dx, dy = (ax, ay) if edge & 1 else (bx, by)
                sx = x + (0.0 if edge < 2 else (bx if edge & 1 else ax))
                sy = y + (0.0 if edge < 2 else (by if edge & 1 else ay))
                length = math.hypot(dx, dy)
                if length == 0.0:
                    continue
                for side in (-reach, reach):
                    ox, oy = -dy / length * side, dx / length * side
                    ends = _ends_of_segment(sx + ox, sy + oy, sx + dx + ox, sy + dy + oy, low, high)
                    left, right = min(left, ends[0]), max(right, ends[1])
            if left <= right:
                start = _index((left - plane.half_x - plane.x) / plane.width - 0.5, columns)
                stop = _index((right + plane.half_x - plane.x) / plane.width - 0.5, columns)
                if stop < columns and plane.x + (stop + 0.5) * plane.width <= right + plane.half_x:
                    stop += 1
                out[start:stop, row] = True


@njit(cache=True)
def mark_enclosed(out: Flags, edges: Floats, plane: Plane) -> None:
    """Mark the cells whose centre closed rings enclose: in every row an edge flips all that lies to its right.

    Shapes: `out` (columns, rows), `edges` (e, 4).
    """
    columns, rows = out.shape
    flips = np.zeros(columns + 1, dtype=np.bool_)
    first = _index((edges[:, 1].min() - plane.y) / plane.height - 1.5, rows)
    last = _index((edges[:, 1].max() - plane.y) / plane.height + 0.5, rows)
    for row in range(first, last):
        middle = plane.y + (row + 0.5) * plane.height
        flips[:] = False
        for edge in range(len(edges)):
            ax, ay, bx, by = edges[edge]
            if (ay <= middle) != (by <= middle):
                crossing = ax + (middle - ay) * ((bx - ax) / (by - ay))
                at = _index((crossing - plane.x) / plane.width - 0.5, columns)
                flips[at] = not flips[at]
        inside = False
        for column in range(columns):
            inside ^= flips[column]
            if inside:
                out[column, row] = True
