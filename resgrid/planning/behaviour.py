"""Behaviour at obstacles (Connolly & Grupen 1992, section 3.3): how far paths keep away, against the knob that says so.

There are two knobs: the share k of the Dirichlet field in a blend, and on one chip the wall resistance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.errors import InputError
from resgrid.planning.field import Field
from resgrid.planning.planner import Planner, plan
from resgrid.planning.streamline import Outcome
from resgrid.planning.trace import follow, start_cells, start_points
from resgrid.space import ConfigurationSpace


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

    def __post_init__(self) -> None:
        for name in ("value", "starts", "clearance", "length", "counted"):
            getattr(self, name).flags.writeable = False

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
