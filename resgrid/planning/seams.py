"""Paths across the seams of periodic axes, in coordinates without a jump."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.axis import rounding
from resgrid.errors import InputError
from resgrid.planning.short_path import ShortPath
from resgrid.planning.streamline import Streamline
from resgrid.space import ConfigurationSpace


def unwrap(path: Streamline | ShortPath | ArrayLike, space: ConfigurationSpace) -> NDArray[np.float64]:
    """Points of a path in the world, in continuous coordinates, which may leave the range of a periodic axis.

    Nothing is guessed from distances: a streamline's point that enters a cell on its lower face came upwards, one on
    its upper face downwards, so every step across a seam is known, in a ring of two cells too.  A point differs from
    the streamline's own by whole turns only; the start by none.

    Parameters
    ----------
    path : Streamline, ShortPath or array_like of float, shape (n, ndim)
        An array holds points of the world.  What is no streamline is continuous already, and is checked and copied.
    space : ConfigurationSpace

    Returns
    -------
    ndarray of float64, shape (n, ndim)
        World coordinates.

    Raises
    ------
    InputError
        If the points do not fit the space or are not finite.
    """
    return space.to_world(axis_path(path, space))


def axis_path(path: Streamline | ShortPath | ArrayLike, space: ConfigurationSpace) -> NDArray[np.float64]:
    """Points of a path in axis units and continuous: the door of all that takes paths; as `unwrap` otherwise.

    Shapes: `path` (n, ndim); returns (n, ndim).
    """
    if not isinstance(path, Streamline | ShortPath):
        return space.from_world(_fitting(path, space))
    if path.frame != space.frame:
        raise InputError("the path lies elsewhere in the world than this space, so that it does not belong to it")
    points = _fitting(path.axis_points, space)
    if isinstance(path, ShortPath):
        return points
    return points + _turns(path, space) * (space.upper - space.lower)


def wrap(points: ArrayLike, space: ConfigurationSpace) -> NDArray[np.float64]:
    """Points with periodic coordinates brought back into their axes, ``lower <= x < upper``.

    Shapes: `points` (n, ndim); returns (n, ndim).
    """
    own = _fitting(points, space)
    turned = space.lower + np.mod(own - space.lower, space.upper - space.lower)
    return np.where(space.periodic, np.where(turned < space.upper, turned, space.lower), own)


def length_of(points: NDArray[np.float64]) -> float:
    """Length of a polyline in axis units."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _turns(path: Streamline, space: ConfigurationSpace) -> NDArray[np.int64]:
    """Whole turns of every point around every axis since the start, shape (n, ndim)."""
    cells = path.point_cells
    if cells.shape != path.axis_points.shape or len(path.axis_points) < len(path.cells):
        raise InputError(
            f"the path has {len(path.axis_points)} points and {len(path.cells)} cells; it is no streamline of ours"
        )
    local = (path.axis_points - space.lower) / space.spacing - cells
    step = np.where(np.diff(cells, axis=0) != 0, np.where(local[1:] < 0.5, 1, -1), 0)
    continuous = np.concatenate([cells[:1], cells[:1] + np.cumsum(step, axis=0)])
    turns, left = np.divmod(continuous - cells, np.array(space.shape))
    if left.any():
        raise InputError(f"the path leaps between cells {_leap(cells, left)}; it does not belong to this space")
    outside = np.abs(local - 0.5) > 0.5 + rounding(space.axes)
    if np.any(outside | (cells < 0) | (cells >= space.shape)):
        raise InputError("points of the path lie outside their cells in this space; it belongs to another")
    return np.asarray(turns, dtype=np.int64)


def _leap(cells: NDArray[np.int64], left: NDArray[np.int64]) -> str:
    at = int(np.argmax(left.any(axis=1)))
    return f"{tuple(cells[at - 1].tolist())} and {tuple(cells[at].tolist())}"


def _fitting(path: ArrayLike, space: ConfigurationSpace) -> NDArray[np.float64]:
    try:
        points = np.array(path, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError("a path is a table of numbers, one point a row") from None
    if points.ndim != 2 or points.shape[1] != space.ndim or not len(points):
        raise InputError(f"a path in this space has shape (points, {space.ndim}), got {points.shape}")
    if not np.isfinite(points).all():
        row = int(np.argmin(np.isfinite(points).all(axis=1)))
        raise InputError(f"point {row} of the path is not finite: {points[row].tolist()}")
    return points
