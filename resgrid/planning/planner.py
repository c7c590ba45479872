"""Solve once, answer many starts: a planner is a field and, for blends, the two it is made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.errors import InputError
from resgrid.frozen import frozen, picture_html
from resgrid.planning.blend import blend
from resgrid.planning.fields import Field
from resgrid.planning.road import problem_of, require_uniform, solve_halves, solve_problem
from resgrid.planning.separation import Separation, separation
from resgrid.planning.streamline import Outcome, Streamline
from resgrid.planning.trace import Traces, basins, follow, start_cells, start_points, streamline, streamlines
from resgrid.scene import Scene
from resgrid.space import ConfigurationSpace


@frozen
@dataclass(frozen=True, eq=False)
class Planner:
    """A solved configuration space that answers starts.

    Attributes
    ----------
    field : Field
        The field that streamlines follow.
    obstacle_field, open_field : Field or None
        For blends: k = 1, obstacles on the rail (or behind walls), and k = 0, open obstacles.
    scene_starts : ndarray of float64, shape (n, ndim)
        Starts that the scene lists, in world coordinates.
    """

    field: Field
    obstacle_field: Field | None
    open_field: Field | None
    scene_starts: NDArray[np.float64]

    @property
    def space(self) -> ConfigurationSpace:
        """The space it plans in."""
        return self.field.space

    @property
    def k(self) -> float:
        """Share of the Dirichlet field."""
        return self.field.k

    def at(self, k: float) -> Planner:
        """The planner of another blend, from the same two solves.

        Parameters
        ----------
        k : float
            In [0, 1]; 1 is Dirichlet.

        Returns
        -------
        Planner

        Raises
        ------
        InputError
            If k is out of range, or this planner was made without a k and so holds one field only.
        """
        if self.obstacle_field is None or self.open_field is None:
            raise InputError("this planner holds one field only: make it with plan(..., k=...) to blend")
        return replace(self, field=blend(self.obstacle_field, self.open_field, k))

    def path(self, start: ArrayLike | None = None, *, cell: Sequence[int] | None = None) -> Streamline:
        """Streamline from a point of the world, or from a cell's centre; see `resgrid.streamline`."""
        return streamline(self.field, start, cell=cell)

    def paths(self, starts: ArrayLike | None = None) -> list[Streamline]:
        """Streamlines from many points of the world, shape (n, ndim); by default from the scene's starts."""
        return [follow(self.field, point) for point in start_points(self.space, self._starts(starts))]

    def ends(self, starts: ArrayLike | None = None) -> Traces:
        """Ends of streamlines from many points, much faster than `paths`; see `resgrid.streamlines`."""
        return streamlines(self.field, self._starts(starts))

    def basins(self) -> NDArray[np.int32]:
        """Goal region that the streamline of every cell reaches; see `resgrid.basins`."""
        return basins(self.field)

    def separation(
        self, start: ArrayLike | None = None, *, cell: Sequence[int] | None = None, virtual: ArrayLike | None = None
    ) -> Separation:
        """Which obstacles separate a start from the goals; see `resgrid.separation`."""
        return separation(self.space, start, cell=cell, virtual=virtual)

    def _starts(self, starts: ArrayLike | None) -> ArrayLike:
        return self.scene_starts if starts is None else starts


def plan(
    where: ConfigurationSpace | Scene,
    *,
    boundary: str | None = None,
    k: float | None = None,
    edge: str | Sequence[str] | None = None,
    wall_resistance: float | None = None,
    resistance: float | None = None,
) -> Planner:
    """Solve a space once, for any number of starts.

    Parameters
    ----------
    where : ConfigurationSpace or Scene
        A scene is sampled first, and says what the options leave out.
    boundary : {"dirichlet", "neumann", "wall"}, optional
        What obstacles are; for a blend what they are at k = 1.  ``"dirichlet"`` unless the scene says otherwise.
    k : float, optional
        Share of the Dirichlet field, in [0, 1].  With any k, 0 and 1 included, both fields are solved, and
        `Planner.at` gives other blends without solving again.  For a scene, unless a boundary is given, the first of
        its ``k``.
    edge : str or sequence of str, optional
        What the border of the grid is, ``"obstacle"`` or ``"open"``; see `resgrid.compile_space`.
    wall_resistance : float, optional
        For ``boundary="wall"``, in ohms.
    resistance : float, optional
        Resistance between neighbours, in ohms; 10 kohm unless the scene says otherwise.

    Returns
    -------
    Planner

    Raises
    ------
    InputError
        If an option is unknown or does not fit the others.
    CircuitError
        If nothing can be driven.
    """
    if isinstance(where, Scene):
        require_uniform(where, "plan()")
    problem = problem_of(
        where, boundary=boundary, k=k, edge=edge, resistance=resistance, wall_resistance=wall_resistance
    )
    if not problem.ks:
        return Planner(solve_problem(problem).fields[0], None, None, problem.starts)
    halves = solve_halves(problem)
    return Planner(blend(*halves, problem.ks[0]), *halves, problem.starts)


@frozen
@dataclass(frozen=True, eq=False)
class ClearanceCurve:
    """Clearance of paths against the knob that sets how obstacles behave.

    Attributes
    ----------
    knob : {"k", "wall_resistance"}
        Which knob: a share, or a resistance in ohms.
    value : ndarray of float64, shape (n,)
        Its settings.
    starts : ndarray of float64, shape (m, ndim)
        Start points, in world coordinates.
    clearance : ndarray of float64, shape (n, m)
        Clearance of every path, in axis units; NaN where it does not reach a goal.
    length : ndarray of float64, shape (n, m)
        Length of every path, likewise.
    counted : ndarray of bool, shape (m,)
        Starts with a path at every setting: those that the means are taken over.
    """

    knob: str
    value: NDArray[np.float64]
    starts: NDArray[np.float64]
    clearance: NDArray[np.float64]
    length: NDArray[np.float64]
    counted: NDArray[np.bool_]

    _repr_html_ = picture_html

    @property
    def mean(self) -> NDArray[np.float64]:
        """Mean clearance at every setting, shape (n,), in axis units."""
        return np.asarray(self.clearance[:, self.counted].mean(axis=1))

    @property
    def mean_length(self) -> NDArray[np.float64]:
        """Mean length at every setting, shape (n,), in axis units."""
        return np.asarray(self.length[:, self.counted].mean(axis=1))


def clearance_curve(
    planner: Planner, ks: ArrayLike = (0.0, 0.01, 0.1, 0.5, 0.9, 0.99, 1.0), starts: ArrayLike | None = None
) -> ClearanceCurve:
    """Find the mean clearance of paths against the blend k.

    Parameters
    ----------
    planner : Planner
        Made with a k, so that it holds both fields.
    ks : array_like of float, shape (n,)
        In [0, 1].
    starts : array_like of float, shape (m, ndim), optional
        In world coordinates.  By default the centres of some 200 cells with a path, evenly spaced among all of them.

    Returns
    -------
    ClearanceCurve

    Raises
    ------
    InputError
        If a k is out of range, the planner holds one field only, or no start has a path at every k.
    """
    values = _settings("k", ks)
    points = _starts_with_paths(planner.space, starts)
    return _curve(
        "k", values, planner.space.to_world(points), [_measure(planner.at(k).field, points) for k in values.tolist()]
    )


def wall_clearance_curve(
    space: ConfigurationSpace,
    wall_resistances: ArrayLike,
    starts: ArrayLike | None = None,
    *,
    edge: str | tuple[str, ...] = "obstacle",
    resistance: float = 10e3,
) -> ClearanceCurve:
    """Find the mean clearance of paths against the wall resistance, the knob of a single chip: one solve each.

    Parameters
    ----------
    space : ConfigurationSpace
    wall_resistances : array_like of float, shape (n,)
        In ohms, not negative; 0 is Dirichlet, infinity is Neumann with a uniform drive.
    starts : array_like of float, shape (m, ndim), optional
        As in `clearance_curve`.
    edge : str or tuple of str
        What the border of the grid is.
    resistance : float
        Resistance between neighbours, in ohms.

    Returns
    -------
    ClearanceCurve

    Raises
    ------
    InputError
        If a resistance is negative or not a number, or no start has a path at every one.
    """
    values = _settings("wall_resistance", wall_resistances)
    points = _starts_with_paths(space, starts)
    measured = []
    for ohms in values.tolist():
        rule, wall = ("neumann", None) if np.isinf(ohms) else ("wall", ohms)
        planner = plan(space, boundary=rule, wall_resistance=wall, edge=edge, resistance=resistance)
        measured.append(_measure(planner.field, points))
    return _curve("wall_resistance", values, space.to_world(points), measured)


def _settings(knob: str, values: ArrayLike) -> NDArray[np.float64]:
    limit = 1.0 if knob == "k" else np.inf
    try:
        settings = np.atleast_1d(np.asarray(values, dtype=np.float64))
    except (TypeError, ValueError) as error:
        raise InputError(f"{knob}: the settings must be numbers") from error
    if settings.ndim != 1 or not settings.size:
        raise InputError(f"{knob}: give at least one setting, in a row")
    if not np.all((settings >= 0) & (settings <= limit)):
        wrong = settings[~((settings >= 0) & (settings <= limit))][0]
        raise InputError(f"{knob} = {wrong} is out of range: it must lie between 0 and {limit:g}")
    return settings.copy()


def _starts_with_paths(space: ConfigurationSpace, starts: ArrayLike | None) -> NDArray[np.float64]:
    if starts is None:
        cells = np.argwhere(space.goal_connected)
        if not len(cells):
            raise InputError("no free cell has a path to a goal, so that there is no clearance to measure")
        chosen = np.unique(np.linspace(0, len(cells) - 1, 200).round().astype(np.int64))
        return space.axis_centre(cells[chosen])
    points = start_points(space, starts)
    start_cells(space, points)
    return points


def _measure(field: Field, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Clearance and length of every path, shape (2, m); NaN where none reaches a goal."""
    paths = [follow(field, point) for point in points]
    pairs = [(p.clearance, p.length) if p.outcome is Outcome.REACHED else (np.nan, np.nan) for p in paths]
    return np.array(pairs, dtype=np.float64).reshape(-1, 2).T


def _curve(
    knob: str, values: NDArray[np.float64], points: NDArray[np.float64], measured: list[NDArray[np.float64]]
) -> ClearanceCurve:
    clearance, length = np.stack(measured, axis=1)
    counted = np.isfinite(length).all(axis=0)
    if not counted.any():
        raise InputError(f"no start has a path at every setting of {knob}: choose starts that can reach a goal")
    return ClearanceCurve(knob, values, points, clearance, length, counted)
