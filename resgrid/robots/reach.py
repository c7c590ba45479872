"""The cells of a grid that lie within some distance of a shape, in closed form."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from math import ceil, floor, isinf

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.robots.polygons import mark_polygon
from resgrid.robots.protocol import Sampling
from resgrid.robots.shapes import Ball, Bounds, Box, CellSet, HalfSpace, Polygon, Shape
from resgrid.robots.window import Window, rims
from resgrid.space import Axis

MAX_COPIES = 1000


def mark(out: NDArray[np.bool_], axes: tuple[Axis, ...], shape: Shape, reach: float, rule: Sampling) -> None:
    """Mark, in place, the cells that come within a distance of a shape."""
    if shape.ndim != len(axes):
        raise InputError(f"a shape with {shape.ndim} coordinates does not fit a grid with {len(axes)} axes")
    if isinstance(shape, CellSet):
        out |= _near_cells(shape, axes, reach, rule)
        return
    for copy in copies(shape, axes, reach):
        mark_copy(out, axes, copy, reach, rule)


def mark_copy(
    out: NDArray[np.bool_],
    axes: tuple[Axis, ...],
    shape: Box | Ball | Polygon | HalfSpace,
    reach: float,
    rule: Sampling,
) -> None:
    """The same for one copy of a shape, which is cut off where it sticks out of the grid."""
    window = Window.around(axes, shape.bounds, reach, rule)
    if window is None:
        return
    if isinstance(shape, Polygon):
        mark_polygon(out, axes, window.half, shape, reach)
    elif isinstance(shape, HalfSpace):
        out[window.slices] |= _near_half_space(window, shape, reach)
    else:
        out[window.slices] |= _near_round(window, shape, reach)


def _near_round(window: Window, shape: Box | Ball, reach: float) -> NDArray[np.bool_]:
    lower, upper = (shape.centre, shape.centre) if isinstance(shape, Ball) else shape.bounds
    within = reach + shape.radius if isinstance(shape, Ball) else reach
    squared = np.zeros((1,) * window.ndim)
    for centre, half, low, high in zip(window.grids(), window.half, lower, upper, strict=True):
        gap = np.maximum(np.maximum(centre - half - high, low - (centre + half)), 0.0)
        squared = squared + gap**2
    return np.asarray(squared <= within**2)


def _near_half_space(window: Window, shape: HalfSpace, reach: float) -> NDArray[np.bool_]:
    length = float(np.linalg.norm(shape.normal))
    smallest = np.zeros((1,) * window.ndim)
    for centre, half, component in zip(window.grids(), window.half, shape.normal, strict=True):
        smallest = smallest + component * centre - abs(component) * half
    return np.asarray(smallest <= shape.offset + reach * length)


def _near_cells(shape: CellSet, axes: tuple[Axis, ...], reach: float, rule: Sampling) -> NDArray[np.bool_]:
    if shape.axes != axes:
        raise InputError("the cells of a map can only be obstacles on the map's own grid")
    if reach == 0 or not shape.mask.any():
        return shape.mask
    pad = [(min(ceil(reach / axis.spacing) + 1, axis.cells) if axis.periodic else 0,) * 2 for axis in axes]
    spacing = np.array([axis.spacing for axis in axes])
    mask = np.pad(shape.mask, pad, mode="wrap")
    rim = min(rims(axes)) if rule == "conservative" else 0.0
    near = mask | (_distance_from_boxes(mask, spacing, rule) <= reach - rim)
    return near[tuple(slice(before, size - after) for (before, after), size in zip(pad, mask.shape, strict=True))]


def _distance_from_boxes(mask: NDArray[np.bool_], spacing: NDArray[np.float64], rule: Sampling) -> NDArray[np.float64]:
    """Exact distance from every cell's box (or centre) to the nearest marked box, by a Euclidean distance transform.

    Two boxes ``d`` cells apart leave ``max(|d| - 1, 0)`` cells between them, which is the distance of ``d`` to the
    nearest of ``-1, 0, 1``: grow the mask by one cell all round and measure between lattice points.  A centre and a
    box leave ``max(|d| - 1/2, 0)``: the same on a lattice twice as fine.
    """
    from scipy import ndimage

    if rule == "conservative":
        grown = ndimage.binary_dilation(mask, structure=np.ones((3,) * mask.ndim, dtype=bool))
        return np.asarray(ndimage.distance_transform_edt(~grown, sampling=spacing))
    fine = np.zeros(tuple(2 * n + 1 for n in mask.shape), dtype=bool)
    for offset in product(range(3), repeat=mask.ndim):
        fine[tuple(slice(start, start + 2 * n, 2) for start, n in zip(offset, mask.shape, strict=True))] |= mask
    distance = ndimage.distance_transform_edt(~fine, sampling=spacing / 2)
    return np.asarray(distance[(slice(1, None, 2),) * mask.ndim])


def copies(
    shape: Box | Ball | Polygon | HalfSpace, axes: tuple[Axis, ...], reach: float
) -> Iterator[Box | Ball | Polygon | HalfSpace]:
    """A shape wherever it comes near a grid, by whole turns around its periodic axes."""
    if isinstance(shape, HalfSpace):
        require_upright(shape, axes)
        yield shape
        return
    for by in turns(shape.bounds, axes, (reach,) * len(axes)):
        yield shape.shifted(by) if any(by) else shape


def require_upright(shape: HalfSpace, axes: Sequence[Axis]) -> None:
    """Refuse a half-plane whose border would not meet itself across a seam."""
    for axis, component in zip(axes, shape.normal, strict=True):
        if axis.periodic and component != 0:
            raise InputError(f"a half-plane cannot lean along the periodic axis {axis.name!r}")


def turns(bounds: Bounds, axes: Sequence[Axis], reach: Sequence[float]) -> Iterator[tuple[float, ...]]:
    """Whole turns that bring a shape within some distance of the grid, however many away it is described."""
    lower, upper = bounds
    yield from product(*map(_shifts, axes, lower, upper, reach))


def _shifts(axis: Axis, lower: float, upper: float, reach: float) -> list[float]:
    if not axis.periodic:
        return [0.0]
    period = axis.upper - axis.lower
    first = (axis.lower - upper - reach) / period
    last = (axis.upper - lower + reach) / period
    if isinf(first) or isinf(last) or last - first > MAX_COPIES:
        raise InputError(f"a shape winds around the periodic axis {axis.name!r} more than {MAX_COPIES} times")
    return [turn * period for turn in range(ceil(first), floor(last) + 1)]
