"""Axes of a configuration space, the cells of points, and rounding errors of coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.coordinates import interval_text
from resgrid._internal.numbers import per_axis
from resgrid._internal.validation import checked
from resgrid.errors import InputError

LARGEST = 1e60
"""Largest accepted magnitude of a coordinate, in axis units: products of four such coordinates do not overflow.

Larger coordinates raise InputError.
"""

Coordinate = Annotated[float, Ge(-LARGEST), Le(LARGEST)]
Point = tuple[Coordinate, ...]


_NAMES = ("x", "y", "z", "w")
"""Names of the first to fourth axis of a grid that the user gives as an array, without axes."""


@checked
@dataclass(frozen=True)
class Axis:
    """A coordinate of a configuration space, divided into cells of equal width.

    Cell ``i`` covers ``[lower + i h, lower + (i + 1) h]`` with ``h = spacing``.

    Parameters
    ----------
    name : str
        Name of the coordinate, such as ``"x"`` or ``"theta_1"``.
    lower, upper : float
        Ends of the axis, in ``unit``; ``lower < upper``.
    cells : int
        Number of cells, at least 1.
    periodic : bool
        Whether the last cell is a neighbour of the first one.
    unit : str
        Unit of the coordinate, such as ``"m"``, ``"rad"`` or ``"cell"``; for labels only.

    Raises
    ------
    InputError
        If the ends are not finite and increasing, there is no cell, or cells are narrower than 64 times the
        floating-point spacing at the larger magnitude of the two ends.

    Examples
    --------
    >>> axis = rg.Axis("x", 0.0, 2.0, 4)
    >>> axis.spacing, axis.centres
    (0.5, array([0.25, 0.75, 1.25, 1.75]))
    """

    name: str
    lower: Coordinate
    upper: Coordinate
    cells: Annotated[int, Ge(1)]
    periodic: bool = False
    unit: str = "m"

    def __post_init__(self) -> None:
        if not self.lower < self.upper:
            raise InputError(f"axis {self.name!r}: lower = {self.lower} must lie below upper = {self.upper}")
        if self.spacing < 64 * np.spacing(max(abs(float(self.lower)), abs(float(self.upper)))):
            raise InputError(
                f"axis {self.name!r}: its cells of {self.spacing:g} are too narrow for floating point at coordinates "
                f"from {self.lower:g} to {self.upper:g}; use fewer cells, or move the axis towards 0"
            )

    @property
    def spacing(self) -> float:
        """Width of a cell, in ``unit`` of the axis."""
        return float((self.upper - self.lower) / self.cells)

    @property
    def centres(self) -> NDArray[np.float64]:
        """Cell centres, shape ``(cells,)``, in ``unit``."""
        return np.asarray(self.lower + (np.arange(self.cells) + 0.5) * self.spacing, dtype=np.float64)

    @property
    def edges(self) -> NDArray[np.float64]:
        """Cell borders, ascending, shape ``(cells + 1,)``, in ``unit``."""
        return np.linspace(self.lower, self.upper, self.cells + 1)


def extent_of(axes: Sequence[Axis]) -> str:
    """Return the ranges of axes as text, such as ``x in [0, 8], y in [0, 8]``."""
    return ", ".join(interval_text(axis.name, axis.lower, axis.upper) for axis in axes)


def split_points(
    axes: Sequence[Axis], point: ArrayLike, reach: ArrayLike | None = None
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the cells of points (..., ndim), and the positions in these cells as fractions in [0, 1] (..., ndim).

    Periodic coordinates are wrapped first.  A point on the border of two cells belongs to the upper cell, except at the
    upper end of an axis.  A point that lies outside the grid by at most the rounding error is moved to the border of
    the grid; other points outside raise InputError.

    `axes`: axes of the space; `point` (..., ndim): points in axis units; `reach` (ndim,): largest magnitude of a
    coordinate per axis that occurs in the conversion between world and space (`Frame.reach`), from which the rounding
    error follows; None for the larger magnitude of the two ends of every axis.
    """
    points = np.asarray(point, dtype=np.float64)
    if points.shape[-1:] != (len(axes),):
        raise InputError(f"a point of this space has {len(axes)} coordinates, got {points.tolist()!r}")
    lower, spacing, size = np.array([(axis.lower, axis.spacing, axis.cells) for axis in axes]).T
    scaled = (points - lower) / spacing
    with np.errstate(invalid="ignore"):
        scaled = np.where([axis.periodic for axis in axes], np.mod(scaled, size), scaled)
    slack = rounding_errors(axes, reach)
    inside = np.all((scaled >= np.negative(slack)) & (scaled <= size + slack), axis=-1)
    if not np.all(inside):
        wrong = np.atleast_2d(points)[~np.atleast_1d(inside)][0]
        raise InputError(
            f"the point {tuple(wrong.tolist())} lies outside the grid; give a point with {extent_of(axes)}"
        )
    cells = np.clip(np.floor(scaled), 0, size - 1).astype(np.int64)
    return cells, np.clip(scaled - cells, 0.0, 1.0)


def rounding_errors(axes: Sequence[Axis], reach: ArrayLike | None = None) -> NDArray[np.float64]:
    """Return a bound on the rounding error of coordinates per axis, as fractions of a cell's width, (ndim,).

    The bound is 8 times the floating-point spacing at the largest magnitude of a coordinate.
    `axes`: axes of the space; `reach` (ndim,): largest magnitude of a coordinate per axis that occurs in the conversion
    between world and space (`Frame.reach`); None for the larger magnitude of the two ends of every axis.
    """
    largest = largest_coordinates(axes) if reach is None else np.asarray(reach, dtype=np.float64)
    return np.asarray(8 * np.spacing(largest) / [axis.spacing for axis in axes])


def rounding(axes: Sequence[Axis], reach: ArrayLike | None = None) -> NDArray[np.float64]:
    """Return the tolerance of positions per axis, as fractions of a cell's width, (ndim,).

    The tolerance is the larger one of 1e-9 and the rounding error of coordinates.  `axes`: axes of the space; `reach`
    (ndim,): largest magnitude of a coordinate per axis that occurs in the conversion between world and space
    (`Frame.reach`); None for the larger magnitude of the two ends of every axis.
    """
    return np.asarray(np.maximum(1e-9, rounding_errors(axes, reach)))


def largest_coordinates(axes: Sequence[Axis]) -> NDArray[np.float64]:
    """Return the larger magnitude of the two ends of every axis, in axis units, shape (ndim,)."""
    return np.array([max(abs(float(axis.lower)), abs(float(axis.upper))) for axis in axes])


def grid_axes(
    shape: Sequence[int], spacing: ArrayLike, origin: ArrayLike, periodic: bool | Sequence[bool], unit: str
) -> tuple[Axis, ...]:
    """Return axes named x, y, z and w for a grid of cells; raise InputError unless it has one to four dimensions.

    `shape`: number of cells along every axis; `spacing`, `origin`: width of a cell and lower corner of the grid, in
    `unit`, one number for all axes or one for each; `periodic`: whether axes are periodic, one bool for all axes or one
    for each; `unit`: unit of all axes, for labels.
    """
    if not 1 <= len(shape) <= len(_NAMES):
        raise InputError(f"cell has {len(shape)} dimensions; a space has one to {len(_NAMES)}")
    widths = per_axis("spacing", spacing, len(shape), "a positive number", above=0).tolist()
    lower = per_axis("origin", origin, len(shape), "a finite number").tolist()
    rings = [periodic] * len(shape) if isinstance(periodic, bool) else list(periodic)
    if len(rings) != len(shape):
        raise InputError(f"periodic has {len(rings)} entries, but the array has {len(shape)} dimensions")
    ends = zip(_NAMES, lower, widths, shape, rings, strict=False)
    return tuple(Axis(name, low, low + count * width, count, ring, unit) for name, low, width, count, ring in ends)
