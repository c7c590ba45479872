"""The certificate of a polyline: it meets free cells only; checked without the code that shortened it."""

from __future__ import annotations

from itertools import pairwise, product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.axis import rounding
from resgrid.errors import CertificateError, InputError
from resgrid.planning.clearance import face_shares
from resgrid.planning.seams import axis_path
from resgrid.planning.short_path import ShortPath
from resgrid.planning.streamline import Streamline
from resgrid.space import Cell, ConfigurationSpace

Cells = set[tuple[int, ...]]

_LONGEST = 10_000_000


def certify_free(points: Streamline | ShortPath | ArrayLike, space: ConfigurationSpace) -> None:
    """Check that no segment of a polyline meets an obstacle cell or leaves the grid.

    Of every segment one of two things must hold: all closed cells it touches, at corners too, are free or goal cells;
    or it lies within one closed free or goal cell, as each segment of a streamline does, which may slide along a wall.
    From one such cell to the next it must lead through faces of cells that touch the point between: nothing slips
    through the corner or edge at which two obstacles meet.  Cells are taken 1e-9 of their width larger, or as much as
    coordinates far from 0 round to.

    Parameters
    ----------
    points : Streamline, ShortPath or array_like of float, shape (n, ndim)
        An array holds points of the world, continuous across periodic seams.
    space : ConfigurationSpace

    Raises
    ------
    CertificateError
        If a segment does not; the message names the segment and the cell.
    InputError
        If the points do not fit the space.
    """
    scaled = (axis_path(points, space) - space.lower) / space.spacing
    _check_extent(scaled, space)
    here = _free(_touched(scaled[0], scaled[0], space), space)
    segments = pairwise(scaled) if len(scaled) > 1 else [(scaled[0], scaled[0])]
    for number, (start, end) in enumerate(segments):
        touched = _touched(start, end, space)
        free = _free(touched, space)
        if len(free) < len(touched):
            held = {cell for cell in free if _holds(cell, start, space) and _holds(cell, end, space)}
            if not held:
                cell = min(touched - free)
                raise CertificateError(f"segment {number} touches cell {cell}, which is not free or outside the grid")
            here = _joined(here, _free(_touched(start, start, space), space))
            if not here & held:
                raise CertificateError(
                    f"segment {number} enters cell {min(held)} through a corner or edge, between obstacles that meet"
                )
            free = here & held
        here = _joined(free, _free(_touched(end, end, space), space))


def _check_extent(scaled: NDArray[np.float64], space: ConfigurationSpace) -> None:
    """Refuse points outside the grid, and segments around an axis so long that nobody could look at all their cells."""
    slack = rounding(space.axes)
    outside = np.any(~space.periodic & ((scaled < -slack) | (scaled > space.shape + slack)), axis=1)
    if outside.any():
        raise CertificateError(f"point {int(np.argmax(outside))} lies outside the grid")
    if np.any(np.abs(np.diff(scaled, axis=0)) > _LONGEST):
        raise InputError(f"a segment of this path is longer than {_LONGEST:,} cells")


def _touched(start: NDArray[np.float64], end: NDArray[np.float64], space: ConfigurationSpace) -> Cells:
    """Closed cells that a closed segment touches: at every border it crosses, and between two."""
    border = np.concatenate([[0.0], face_shares(start, end), [1.0]])
    shares = np.concatenate([border, (border[:-1] + border[1:]) / 2])
    at = start + shares[:, np.newaxis] * (end - start)
    rim = rounding(space.axes)
    options = np.stack([np.floor(at - rim), np.floor(at + rim)]).astype(np.int64)
    corners = [options[np.array(pick), :, np.arange(len(start))].T for pick in product((0, 1), repeat=len(start))]
    return set(map(tuple, np.concatenate(corners).tolist()))


def _free(cells: Cells, space: ConfigurationSpace) -> Cells:
    """Those of some cells that are free or goal cells."""
    index = np.array(sorted(cells))
    size = np.array(space.shape)
    inside = np.all((index >= 0) & (index < size) | space.periodic, axis=1)
    free = inside & (space.cell[tuple(np.mod(index, size).T)] != Cell.OBSTACLE)
    return set(map(tuple, index[free].tolist()))


def _holds(cell: tuple[int, ...], point: NDArray[np.float64], space: ConfigurationSpace) -> bool:
    return bool(np.all(np.abs(point - cell - 0.5) <= 0.5 + rounding(space.axes)))


def _joined(start: Cells, among: Cells) -> Cells:
    """Cells that are reached from some of them through faces."""
    reached, new = set[tuple[int, ...]](), start & among
    while new:
        reached |= new
        new = {
            cell for cell in among - reached
            if any(sum(abs(i - j) for i, j in zip(cell, other, strict=True)) == 1 for other in new)
        }  # fmt: skip
    return reached
