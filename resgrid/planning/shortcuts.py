"""Shortcuts: replacement of the bends of a path by straight lines through free cells."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import NDArray

from resgrid._internal.numbers import Natural, NotNegative
from resgrid.core.cell import Cell
from resgrid.errors import InputError
from resgrid.planning.certify_segments import certify_collision_free
from resgrid.planning.clearance import clearance_of
from resgrid.planning.fields import Field
from resgrid.planning.lattice_fields import LatticeField
from resgrid.planning.node_paths import NodePath
from resgrid.planning.short_path import ShortPath
from resgrid.planning.streamline import Outcome, Streamline, distinct_rows, length_of

LineTest = Callable[[NDArray[np.float64], NDArray[np.float64]], bool]
"""Function of two points (ndim,), in axis units, that returns whether a path may follow the line between them."""

_GAIN = 1e-12
"""Relative reduction of length above which a chord replaces a part of the path; smaller ones may be rounding errors."""


def shortcut(
    path: Streamline | NodePath,
    *,
    clearance: NotNegative | None = None,
    rounds: Annotated[int, Ge(0), Le(1_000_000)] = 200,
    seed: Natural = 0,
) -> ShortPath:
    """Shorten a path by straight lines wherever all cells that they touch are free or goal cells.

    First, each corner is connected to a farther point of the path, found by doubling steps and bisection.  Then
    ``rounds`` random chords between points of the path are tried (Geraerts & Overmars, Int. J. Robotics Research 26
    (2007) 845).  Other parts of the path are unchanged, so that the path meets no obstacle, and its length never
    increases.  New lines keep the distance ``clearance``, so that the path has at least half of the original's
    clearance, unless a smaller value is given.  Costs (the space's conductivity) are ignored.

    Parameters
    ----------
    path : Streamline or NodePath
        A path that reached a goal.
    clearance : float, optional
        Minimum distance, in axis units, of new lines from obstacle cells and from edges that count as obstacles, at
        least 0.  By default half of the path's clearance, but at least a quarter of the smallest cell width.
        With 0, lines may pass obstacles at a distance of rounding errors.
    rounds : int
        Number of random chords that are tried.
    seed : int
        Seed of the random chords; the result is reproducible.

    Returns
    -------
    ShortPath
        The shortened path, verified by `certify_collision_free`.

    Raises
    ------
    InputError
        If the path reached no goal, or an option is out of range.
    CertificateError
        If the result touches an obstacle, which would be an error in this function.

    Examples
    --------
    >>> path = rg.plan(rg.read_scene("examples/scenes/lesson.toml")).path((0.5, 6.5))
    >>> short, kept = rg.shortcut(path), rg.shortcut(path, clearance=0.2)
    >>> round(path.length, 3), round(short.length, 3), round(kept.length, 3)
    (8.712, 8.27, 8.228)
    >>> round(path.clearance, 3), round(short.clearance, 3), round(kept.clearance, 3)
    (0.415, 0.251, 0.207)
    """
    if path.outcome is not Outcome.REACHED:
        raise InputError(f"this path ended with '{path.outcome}': only a path that reached a goal can be shortened")
    clear = _line_of_sight(path.field, default_clearance(path) if clearance is None else clearance)
    points = _greedy(_random_chords(_greedy(path.line, clear), clear, rounds, seed), clear)
    points = points[distinct_rows(points, 0.5 * path.space.rounding * path.space.spacing)]
    short = ShortPath(
        axis_points=points,
        length=min(length_of(points), length_of(path.line)),
        clearance=clearance_of(points, path.space, path.field.edge, path.field.obstacle_reach),
        original=path,
    )
    certify_collision_free(short)
    return short


def default_clearance(path: Streamline | NodePath) -> float:
    """Return the default minimum distance of the lines of a shortcut from obstacles, in axis units.

    It is half of the path's clearance, but at least a quarter of the smallest cell width; 0 without obstacles.
    """
    least = float(path.space.spacing.min()) / 4
    return max(path.clearance / 2, least) if np.isfinite(path.clearance) else 0.0


def _line_of_sight(field: Field | LatticeField, clearance: float) -> LineTest:
    """Return a function of two points (ndim,), in axis units, that returns whether a path may follow their line.

    The line must touch only free or goal cells, and its distance from obstacles must be at least `clearance`, in axis
    units.  `field`: gives the cells and the rules of the grid's edge.
    """
    from resgrid.planning import kernels

    space, edge, reach = field.space, field.edge, None if field.obstacle_reach is None else clearance
    blocked = (space.cell == Cell.OBSTACLE).ravel()
    free = ~blocked
    shape, periodic = np.array(space.shape, dtype=np.int64), space.periodic
    lower, spacing = space.lower, space.spacing
    rim = 2.0 * float(space.rounding.max())  # certify_collision_free must also accept points rounded to world units

    def clear(start: NDArray[np.float64], end: NDArray[np.float64]) -> bool:
        """Return whether the line from `start` to `end` (ndim,) touches only free or goal cells and keeps a distance.

        The distance, from obstacle cells and from edges that count as obstacles, is the argument `clearance` of
        `_line_of_sight`.  Points and distance are in axis units.
        """
        if not kernels.segment_is_free((start - lower) / spacing, (end - lower) / spacing, free, shape, periodic, rim):
            return False
        line = np.stack([start, end])
        return not clearance or clearance_of(line, space, edge, reach, blocked) >= clearance

    return clear


def _greedy(points: NDArray[np.float64], clear: LineTest) -> NDArray[np.float64]:
    """Return the corners (m, ndim) that remain if the path moves from each corner straight to a far visible corner.

    A corner is visible from another one if `clear` is True for the line between them.  `points` (n, ndim): corners of
    the path, in axis units; `clear`: function of two points (ndim,) that returns whether a path may follow their line.
    """
    kept = [0]
    last = len(points) - 1
    while kept[-1] < last:
        kept.append(_farthest(points, kept[-1], last, clear))
    return points[kept]


def _farthest(points: NDArray[np.float64], here: int, last: int, clear: LineTest) -> int:
    """Return the largest index found in ``here + 1 .. last`` of a point that is visible from point number `here`.

    A point is visible from another one if `clear` is True for the line between them.  `points` (n, ndim): corners of
    the path, in axis units; `clear`: function of two points (ndim,) that returns whether a path may follow their line.
    The search doubles its steps, and then bisects, so that the result is not always the last visible point.
    """
    visible, step = here + 1, 2
    while visible < last and clear(points[here], points[min(here + step, last)]):
        visible = min(here + step, last)
        step *= 2
    low, high = visible, min(here + step, last)
    while high - low > 1:
        middle = (low + high) // 2
        if clear(points[here], points[middle]):
            low = middle
        else:
            high = middle
    return low


def _random_chords(points: NDArray[np.float64], clear: LineTest, rounds: int, seed: int) -> NDArray[np.float64]:
    """Return a path (m, ndim) in which free chords between random points replace parts that are longer than the chord.

    `points` (n, ndim): corners of the path, in axis units; `clear`: function of two points (ndim,) that returns whether
    a path may follow their line; `rounds`: number of chords that are tried; `seed`: seed of the random generator.
    """
    generator = np.random.default_rng(seed)
    for _ in range(rounds):
        if len(points) < 3:
            break
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        first, last = np.sort(generator.uniform(0.0, along[-1], 2))
        before, after = np.searchsorted(along, [first, last], side="right") - 1
        if before == after or after >= len(points) - 1:
            continue
        start, end = _at(points, along, before, first), _at(points, along, after, last)
        shorter = np.linalg.norm(end - start) < (last - first) * (1.0 - _GAIN)
        if shorter and clear(start, end):
            points = np.concatenate([points[: before + 1], [start, end], points[after + 1 :]])
    return points


def _at(points: NDArray[np.float64], along: NDArray[np.float64], corner: int, length: float) -> NDArray[np.float64]:
    """Return the point (ndim,) of a path at an arc length `length`, between corner number `corner` and the next.

    `points` (n, ndim): corners of the path; `along` (n,): their arc lengths, in the unit of the points.
    """
    fraction = (length - along[corner]) / (along[corner + 1] - along[corner])
    return np.asarray(points[corner] + fraction * (points[corner + 1] - points[corner]))
