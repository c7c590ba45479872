"""The cells near a polygon: those near its outline, and those whose centre it encloses."""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil, hypot

import numpy as np
from numpy.typing import NDArray

from resgrid.robots.shapes import Point, Polygon
from resgrid.robots.window import Window

PIECE = 32
"""Longest piece of an edge that is looked at in one go, in cells: its bounding box stays small."""


def mark_polygon(part: NDArray[np.bool_], window: Window, polygon: Polygon, reach: float) -> None:
    """Mark, in place, the cells of a window that come within a distance of a polygon.

    A cell meets a polygon if it meets the outline, or if its centre is enclosed.

    Parameters
    ----------
    part : ndarray of bool, shape of the window
        Cells found are set to True.
    window : Window
        The cells looked at, two axes.
    polygon : Polygon
        The shape.
    reach : float
        The distance, at least 0.
    """
    part |= _encloses(window, polygon)
    for first, last in _pieces(window, polygon, reach):
        _mark_segment(part, window, first, last, reach)


def _encloses(window: Window, polygon: Polygon) -> NDArray[np.bool_]:
    """Even-odd rule, row by row: an edge that crosses the row of centres flips every cell to its right."""
    x, y = window.centres(0), window.centres(1)
    flips = np.zeros((len(x) + 1, len(y)), dtype=np.int32)
    for (x0, y0), (x1, y1) in _edges(polygon):
        rows = np.flatnonzero((y >= min(y0, y1)) & (y < max(y0, y1)))
        if len(rows):
            crossing = x0 + (y[rows] - y0) * ((x1 - x0) / (y1 - y0))
            np.add.at(flips, (np.searchsorted(x, crossing), rows), 1)
    return np.asarray(np.cumsum(flips[:-1], axis=0) % 2 == 1)


def _edges(polygon: Polygon) -> Iterator[tuple[Point, Point]]:
    for ring in polygon.rings:
        yield from zip(ring, (*ring[1:], ring[0]), strict=True)


def _pieces(window: Window, polygon: Polygon, reach: float) -> Iterator[tuple[Point, Point]]:
    """The edges, cut so that the cells around each piece are few; pieces far from the window are left out."""
    width = min(axis.spacing for axis in window.axes)
    longest = max(PIECE * width, reach)
    corner = [axis.lower - reach for axis in window.axes], [axis.upper + reach for axis in window.axes]
    for (x0, y0), (x1, y1) in _edges(polygon):
        clipped = _clip((x0, y0), (x1, y1), *corner)
        if clipped is None:
            continue
        first, last = clipped
        count = max(1, ceil((last - first) * hypot(x1 - x0, y1 - y0) / longest))
        share = np.linspace(first, last, count + 1)
        points = np.stack([x0 + share * (x1 - x0), y0 + share * (y1 - y0)], axis=1)
        points[0] = (x0, y0) if first == 0 else points[0]
        points[-1] = (x1, y1) if last == 1 else points[-1]
        yield from zip(map(tuple, points[:-1]), map(tuple, points[1:]), strict=True)


def _clip(first: Point, last: Point, lower: list[float], upper: list[float]) -> tuple[float, float] | None:
    """The part of a segment inside a box, as shares of its length (Liang and Barsky, 1984), a little generous."""
    enter, leave = 0.0, 1.0
    for start, end, low, high in zip(first, last, lower, upper, strict=True):
        step = end - start
        if step == 0:
            if not low <= start <= high:
                return None
            continue
        at = sorted(((low - start) / step, (high - start) / step))
        enter, leave = max(enter, at[0] - 1e-12), min(leave, at[1] + 1e-12)
    return (enter, leave) if enter <= leave else None


def _mark_segment(part: NDArray[np.bool_], window: Window, first: Point, last: Point, reach: float) -> None:
    bounds = tuple(map(min, first, last)), tuple(map(max, first, last))
    near = Window.around(window.axes, bounds, reach, "centre")
    if near is None:
        return
    start = [max(a, b) for a, b in zip(near.start, window.start, strict=True)]
    stop = [min(a, b) for a, b in zip(near.stop, window.stop, strict=True)]
    if any(a >= b for a, b in zip(start, stop, strict=True)):
        return
    block = Window(window.axes, tuple(start), tuple(stop), window.half)
    offset = [slice(a - o, b - o) for a, b, o in zip(start, stop, window.start, strict=True)]
    part[tuple(offset)] |= _near_segment(block, first, last, reach)


def _near_segment(window: Window, first: Point, last: Point, reach: float) -> NDArray[np.bool_]:
    """Whether each cell's box comes within a distance of a segment.

    They meet unless one of the axes or the segment's normal separates them (separating axes); otherwise the shortest
    line between them ends in a corner of the box or an end of the segment.
    """
    (x0, y0), (x1, y1) = first, last
    x, y = window.grids()
    half_x, half_y = window.half
    dx, dy = x1 - x0, y1 - y0
    outside_x = np.maximum(x - half_x - max(x0, x1), min(x0, x1) - (x + half_x))
    outside_y = np.maximum(y - half_y - max(y0, y1), min(y0, y1) - (y + half_y))
    across = np.abs((x - x0) * dy - (y - y0) * dx) - (half_x * abs(dy) + half_y * abs(dx))
    near = (outside_x <= 0) & (outside_y <= 0) & (across <= 0)
    if reach == 0:
        return np.asarray(near)
    for end_x, end_y in (first, last):
        gap = np.maximum(np.abs(x - end_x) - half_x, 0) ** 2 + np.maximum(np.abs(y - end_y) - half_y, 0) ** 2
        near = near | (gap <= reach**2)
    squared = dx**2 + dy**2
    if squared > 0:
        for sign_x, sign_y in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
            to_x, to_y = x + sign_x * half_x - x0, y + sign_y * half_y - y0
            along = to_x * dx + to_y * dy
            beside = (along >= 0) & (along <= squared)
            near = near | (beside & ((to_x * dy - to_y * dx) ** 2 <= reach**2 * squared))
    return np.asarray(near)
