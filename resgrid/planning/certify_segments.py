"""Certificate of polylines: no segment meets an obstacle cell or leaves the grid."""

from __future__ import annotations

from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from resgrid.core.cell import Cell
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import CertificateError, InputError
from resgrid.planning.any_path import AnyPath
from resgrid.planning.clearance import face_crossings

Cells = set[tuple[int, ...]]
_LONGEST = 10_000_000  # maximum length of a segment, in cells along an axis


def certify_collision_free(path: AnyPath) -> None:
    """Check that no segment of a polyline meets an obstacle cell or leaves the grid.

    Cells are closed boxes.  Every segment must satisfy one of two conditions: all cells that it touches are free or
    goal cells; or one free or goal cell contains the whole segment, which may then lie on the face of an obstacle.  A
    path must not pass between obstacles that meet at a corner.  At the start of a segment of the second kind, the cell
    that contains this segment must therefore be connected, through faces of free or goal cells that touch the starting
    point, with a cell of the segment before.  Cells are enlarged by 1e-9 of their width, or by the rounding error of
    large coordinates.

    Parameters
    ----------
    path : Streamline, ShortPath, Polyline or NodePath
        The path to check.

    Raises
    ------
    CertificateError
        If a segment violates both conditions; the message names the segment and the cell.
    InputError
        If a segment is longer than 10,000,000 cells along an axis.

    Examples
    --------
    >>> space = rg.build_space(rg.read_scene("examples/scenes/lesson.toml"))
    >>> rg.certify_collision_free(rg.Polyline([(0.5, 6.5), (5.5, 5.5), (6.5, 1.5)], space))
    >>> rg.certify_collision_free(rg.Polyline([(0.5, 6.5), (6.5, 1.5)], space))
    Traceback (most recent call last):
        ...
    resgrid.errors.CertificateError: segment 0 touches cell (2, 4), which is not free or outside the grid
    """
    space = path.space
    scaled = (path.line - space.lower) / space.spacing
    _check_segments(scaled, space)
    here = _free(_touched(scaled[0], scaled[0], space), space)
    segments = pairwise(scaled) if len(scaled) > 1 else [(scaled[0], scaled[0])]
    for number, (start, end) in enumerate(segments):
        touched = _touched(start, end, space)
        free = _free(touched, space)
        if len(free) < len(touched):
            containing = {cell for cell in free if _contains(cell, start, space) and _contains(cell, end, space)}
            if not containing:
                cell = min(touched - free)
                raise CertificateError(f"segment {number} touches cell {cell}, which is not free or outside the grid")
            here = _connected(here, _free(_touched(start, start, space), space))
            if not here & containing:
                cell = min(containing)
                raise CertificateError(f"segment {number} enters cell {cell} through a corner or edge of obstacles")
            free = here & containing
        here = _connected(free, _free(_touched(end, end, space), space))


def _check_segments(scaled: NDArray[np.float64], space: ConfigurationSpace) -> None:
    """Raise CertificateError if a point lies outside the grid, and InputError if a segment is too long.

    `scaled` (n, ndim): corners of the polyline, in cell widths from the lower corner of the grid.
    """
    slack = space.rounding
    outside = np.any(~space.periodic & ((scaled < -slack) | (scaled > space.shape + slack)), axis=1)
    if outside.any():
        raise CertificateError(f"point {int(np.argmax(outside))} lies outside the grid")
    if np.any(np.abs(np.diff(scaled, axis=0)) > _LONGEST):
        raise InputError(f"a segment of this path is longer than {_LONGEST:,} cells; split it")


def _touched(start: NDArray[np.float64], end: NDArray[np.float64], space: ConfigurationSpace) -> Cells:
    """Return the index tuples of all closed cells that a segment touches; indices may lie outside the grid.

    `start`, `end` (ndim,): end points of the segment, in cell widths from the lower corner of the grid.
    """
    # Each of these cells contains a crossing of a face, or a midpoint between two crossings.
    crossings = np.concatenate([[0.0], face_crossings(start, end), [1.0]])
    parameters = np.concatenate([crossings, (crossings[:-1] + crossings[1:]) / 2])
    at = start + parameters[:, np.newaxis] * (end - start)
    rim = space.rounding
    options = np.stack([np.floor(at - rim), np.floor(at + rim)]).astype(np.int64)
    corners = [options[np.array(pick), :, np.arange(len(start))].T for pick in product((0, 1), repeat=len(start))]
    return set(map(tuple, np.concatenate(corners).tolist()))


def _free(cells: Cells, space: ConfigurationSpace) -> Cells:
    """Return those of `cells` (index tuples) that are free or goal cells; cells outside the grid are neither."""
    index = np.array(sorted(cells))
    size = np.array(space.shape)
    inside = np.all((index >= 0) & (index < size) | space.periodic, axis=1)
    free = inside & (space.cell[tuple(np.mod(index, size).T)] != Cell.OBSTACLE)
    return set(map(tuple, index[free].tolist()))


def _contains(cell: tuple[int, ...], point: NDArray[np.float64], space: ConfigurationSpace) -> bool:
    """Return whether a closed cell contains a point to within rounding error.

    `cell`: indices; `point` (ndim,): in cell widths from the lower corner of the grid.
    """
    return bool(np.all(np.abs(point - cell - 0.5) <= 0.5 + space.rounding))


def _connected(start: Cells, among: Cells) -> Cells:
    """Return the cells of the set `among` that are connected through faces, within `among`, to cells of `start`."""
    reached, new = set[tuple[int, ...]](), start & among
    while new:
        reached |= new
        new = {
            cell for cell in among - reached
            if any(sum(abs(i - j) for i, j in zip(cell, other, strict=True)) == 1 for other in new)
        }  # fmt: skip
    return reached
