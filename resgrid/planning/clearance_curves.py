"""Clearance of paths as a function of the blend or of the wall resistance (Connolly & Grupen 1992, section 3.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.values import frozen, picture_html
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import wiring_of
from resgrid.errors import InputError
from resgrid.planning.any_field import require_faces
from resgrid.planning.pipeline import solve_field
from resgrid.planning.planner import Planner
from resgrid.planning.streamline import Outcome
from resgrid.planning.trace import follow, start_points


@frozen
@dataclass(frozen=True, eq=False)
class ClearanceCurve:
    """Clearance of paths as a function of a parameter of the boundary condition at obstacles.

    Returned by `resgrid.planning.clearance_curve`.

    Attributes
    ----------
    parameter : {"k", "wall_resistance"}
        Name of the parameter: the weight k of the Dirichlet field, or the wall resistance.
    value : ndarray of float64, shape (n,)
        Values of the parameter: pure numbers for ``"k"``, ohms for ``"wall_resistance"``.
    starts : ndarray of float64, shape (m, ndim)
        Starts of the paths, in world coordinates.
    clearance, length : ndarray of float64, shape (n, m)
        Clearance and length of every path, in axis units; NaN if the path reaches no goal.
    counted : ndarray of bool, shape (m,)
        Mask of the starts from which the path reaches a goal at every value; means are computed over these starts.
    mean, mean_length : ndarray of float64, shape (n,)
        Mean clearance and mean length at every value, in axis units.

    Examples
    --------
    >>> planner = rg.plan(rg.read_scene("examples/scenes/lesson.toml"), k=1.0)
    >>> curve = rg.planning.clearance_curve(planner, ks=(0.0, 1.0))
    >>> curve.parameter, curve.clearance.shape
    ('k', (2, 56))
    >>> curve.clearance[:, 10].round(3), curve.length[:, 10].round(3)
    (array([0.03 , 0.211]), array([5.564, 5.46 ]))
    >>> curve.mean.round(3)
    array([0.462, 0.506])
    """

    parameter: str
    value: NDArray[np.float64]
    starts: NDArray[np.float64]
    clearance: NDArray[np.float64]
    length: NDArray[np.float64]
    counted: NDArray[np.bool_]

    _repr_html_ = picture_html

    @property
    def mean(self) -> NDArray[np.float64]:
        """Mean clearance at every value of the parameter, shape (n,), in axis units."""
        return np.asarray(self.clearance[:, self.counted].mean(axis=1))

    @property
    def mean_length(self) -> NDArray[np.float64]:
        """Mean length at every value of the parameter, shape (n,), in axis units."""
        return np.asarray(self.length[:, self.counted].mean(axis=1))


def clearance_curve(
    planner: Planner,
    ks: ArrayLike = (0.0, 0.01, 0.1, 0.5, 0.9, 0.99, 1.0),
    starts: ArrayLike | None = None,
    *,
    wall_resistances: ArrayLike | None = None,
) -> ClearanceCurve:
    """Compute the clearance of paths as a function of k or of the wall resistance.

    Both parameters vary the boundary condition at obstacles between Dirichlet and Neumann (Connolly & Grupen 1992,
    section 3.3).

    Parameters
    ----------
    planner : Planner
        Planner that was created with a k, so that it holds both fields, unless `wall_resistances` are given.
    ks : array_like of float, shape (n,)
        Weights of the Dirichlet field, in [0, 1].
    starts : array_like of float, shape (m, ndim), optional
        Starts in world coordinates.  By default the centres of at most 200 cells with a path, evenly spaced in C order.
    wall_resistances : array_like of float, shape (n,), optional
        Wall resistances in ohms, in place of `ks`, with one solve each: 0 is Dirichlet, infinity is Neumann.

    Returns
    -------
    ClearanceCurve
        Clearances and lengths of all paths, and their means over the starts.

    Raises
    ------
    InputError
        If a value is out of range, the planner holds one field only, or no start has a path at every value.

    Examples
    --------
    >>> planner = rg.plan(rg.read_scene("examples/scenes/lesson.toml"), k=1.0)
    >>> curve = rg.planning.clearance_curve(planner, ks=(0.0, 0.5, 1.0))
    >>> curve.mean.round(3), curve.mean_length.round(3)
    (array([0.462, 0.494, 0.506]), array([4.511, 4.291, 4.296]))
    """
    require_faces(planner.field, "clearance_curve")
    space, wiring = planner.space, planner.field.wiring
    if wall_resistances is None:
        parameter, values = "k", _settings("k", ks, 1.0)
        fields = [require_faces(planner.at(k).field, "clearance_curve") for k in values.tolist()]
    else:
        parameter, values = "wall_resistance", _settings("wall_resistance", wall_resistances, np.inf)
        walls = [
            wiring_of(wiring, {"boundary": "wall", "wall_resistance": ohms}) if ohms < np.inf else wiring.opened()
            for ohms in values.tolist()
        ]
        fields = [solve_field(space, wall) for wall in walls]
    points = _starts_with_paths(space) if starts is None else start_points(space, starts)
    paths = [[follow(field, point) for point in points] for field in fields]
    reached = np.array([[path.outcome is Outcome.REACHED for path in row] for row in paths])
    counted = np.asarray(reached.all(axis=0))
    if not counted.any():
        flat = [value for value, field in zip(values.tolist(), fields, strict=True) if not field.is_flowing]
        remedy = (
            f"no current flows at {parameter} = {flat[0]:g}: leave this value out" if flat else "choose other starts"
        )
        raise InputError(f"no start reaches a goal at every value of {parameter}; {remedy}")
    clearance, length = (
        np.where(reached, [[getattr(path, name) for path in row] for row in paths], np.nan)
        for name in ("clearance", "length")
    )
    return ClearanceCurve(parameter, values, space.to_world(points), clearance, length, counted)


def _settings(parameter: str, values: ArrayLike, limit: float) -> NDArray[np.float64]:
    """Return `values` of a parameter as an array (n,); raise InputError unless they lie in [0, `limit`].

    `parameter`: name of the parameter in the message.
    """
    try:
        settings = np.atleast_1d(np.array(values, dtype=np.float64))
    except (TypeError, ValueError) as error:
        raise InputError(f"{parameter}: the values must be numbers") from error
    if settings.ndim != 1 or not settings.size:
        raise InputError(f"{parameter}: give a one-dimensional sequence of at least one value")
    within = (settings >= 0) & (settings <= limit)
    if not within.all():
        raise InputError(f"{parameter} = {settings[~within][0]} is out of range: it must lie between 0 and {limit:g}")
    return settings


def _starts_with_paths(space: ConfigurationSpace) -> NDArray[np.float64]:
    """Return the centres (n, ndim), in axis units, of at most 200 goal-connected cells, evenly spaced in C order."""
    cells = np.argwhere(space.goal_connected)
    if not len(cells):
        raise InputError("no free cell has a path to a goal: move the goal, or open a passage to it")
    chosen = np.unique(np.linspace(0, len(cells) - 1, 200).round().astype(np.int64))
    return space.axis_centre(cells[chosen])
