"""The certificate of a polyline: it meets free cells only; checked without the code that shortened it."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.errors import CertificateError
from resgrid.planning.clearance import face_shares
from resgrid.planning.seams import axis_path
from resgrid.planning.short_path import ShortPath
from resgrid.planning.streamline import Streamline
from resgrid.space import Cell, ConfigurationSpace

RIM = 1e-9
"""Share of a cell's width by which cells count as larger, so that rounding cannot hide a touch."""


def certify_free(points: Streamline | ShortPath | ArrayLike, space: ConfigurationSpace) -> None:
    """Check that no segment of a polyline meets an obstacle cell or leaves the grid.

    Of every segment one of two things must hold: all closed cells it touches, at corners too, are free or goal cells;
    or it lies within one closed free or goal cell, as each segment of a streamline does, which may slide along a wall.
    Cells are taken 1e-9 of their width larger.

    Parameters
    ----------
    points : Streamline, ShortPath or array_like of float, shape (n, ndim)
        An array holds points of the world, continuous across periodic seams.
    space : ConfigurationSpace

    Raises
    ------
    CertificateError
        If a segment does neither; the message names the segment and the cell.
    InputError
        If the points do not fit the space.
    """
    way = axis_path(points, space)
    scaled = (way - space.lower) / space.spacing
    ends = scaled[1:] if len(scaled) > 1 else scaled
    for number, (start, end) in enumerate(zip(scaled, ends, strict=False)):
        touched = _touched(start, end)
        bad = ~_is_free(touched, space)
        if bad.any() and not _within_one(start, end, touched[~bad]):
            cell = tuple(int(i) for i in touched[np.argmax(bad)])
            raise CertificateError(f"segment {number} touches cell {cell}, which is not free or outside the grid")


def _touched(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.int64]:
    """Closed cells that a closed segment touches, shape (n, ndim): at every border it crosses, and between two."""
    border = np.concatenate([[0.0], face_shares(start, end), [1.0]])
    shares = np.concatenate([border, (border[:-1] + border[1:]) / 2])
    at = start + shares[:, np.newaxis] * (end - start)
    options = np.stack([np.floor(at - RIM), np.floor(at + RIM)])
    corners = [options[np.array(pick), :, np.arange(len(start))].T for pick in product((0, 1), repeat=len(start))]
    return np.unique(np.concatenate(corners).astype(np.int64), axis=0)


def _is_free(cells: NDArray[np.int64], space: ConfigurationSpace) -> NDArray[np.bool_]:
    size = np.array(space.shape)
    inside = np.all((cells >= 0) & (cells < size) | space.periodic, axis=1)
    return np.asarray(inside & (space.cell[tuple(np.mod(cells, size).T)] != Cell.OBSTACLE))


def _within_one(start: NDArray[np.float64], end: NDArray[np.float64], cells: NDArray[np.int64]) -> bool:
    def holds(point: NDArray[np.float64]) -> NDArray[np.bool_]:
        return np.asarray(np.all((point >= cells - RIM) & (point <= cells + 1 + RIM), axis=1))

    return bool(np.any(holds(start) & holds(end)))
