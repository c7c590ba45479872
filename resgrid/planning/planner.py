"""Solve once, answer many starts: a planner is a field and, for blends, the two it is made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.validation import Count
from resgrid._internal.values import frozen, picture_html
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import Boundary, EdgeRule
from resgrid.errors import InputError
from resgrid.planning.blend import blend, dirichlet_share
from resgrid.planning.fields import Field
from resgrid.planning.pipeline import Solution, problem_of, require_uniform, solve_field, solve_problem, work_by
from resgrid.planning.streamline import Outcome, Streamline
from resgrid.planning.trace import Traces, follow, start_points, streamline, streamlines
from resgrid.scene import Scene


@frozen
@dataclass(frozen=True, eq=False)
class Planner:
    """A solved configuration space that answers starts.

    Attributes
    ----------
    field : Field
        The field that streamlines follow.
    solution : Solution
        What was solved: one field, or the halves of every blend.

    Examples
    --------
    >>> planner = rg.plan(rg.read_scene("examples/scenes/lesson.toml"), k=0.5)
    >>> planner
    Planner(field=<Field on 8 x 8 cells: blend, k = 0.5>, solution=<Solution>)
    >>> [round(path.length, 2) for path in planner.at(1.0).paths()]
    [8.71]
    >>> planner.ends([(0.5, 0.5), (7.5, 7.5)]).goal
    array([0, 0])
    """

    field: Field
    solution: Solution

    @property
    def space(self) -> ConfigurationSpace:
        """The space it plans in."""
        return self.field.space

    @property
    def k(self) -> float:
        """Share of the Dirichlet field."""
        return self.field.k

    @property
    def obstacle_field(self) -> Field:
        """The field of k = 1: obstacles on the rail, or behind walls."""
        return self.solution.halves[0]

    @property
    def open_field(self) -> Field:
        """The field of k = 0: open obstacles."""
        return self.solution.halves[1]

    @property
    def scene_starts(self) -> NDArray[np.float64]:
        """Starts that the scene lists, in world coordinates, shape (n, ndim)."""
        return self.solution.problem.starts

    def at(self, k: float) -> Planner:
        """The planner of another blend, k in [0, 1], from the same two solves: of one that was made with a k."""
        return replace(self, field=blend(*self.solution.halves, k))

    def dirichlet_share(self) -> NDArray[np.float64]:
        """How much of the gradient of this blend is that of its Dirichlet half, shape of the space, in [0, 1].

        Away from the goals the Dirichlet gradient falls off exponentially, and the Neumann one does not: with a weight
        of 0.98 the blend is still almost Neumann there.  NaN where neither flows.
        """
        return dirichlet_share(*self.solution.halves, self.k)

    def path(self, start: ArrayLike | None = None, *, cell: Sequence[int] | None = None) -> Streamline:
        """Streamline from a point of the world, or from a cell's centre; see `resgrid.streamline`."""
        return streamline(self.field, start, cell=cell)

    def paths(self, starts: ArrayLike | None = None) -> list[Streamline]:
        """Streamlines from many points of the world, shape (n, ndim); by default from the scene's starts."""
        return [follow(self.field, point) for point in start_points(self.space, self._starts(starts))]

    def ends(self, starts: ArrayLike | None = None) -> Traces:
        """Ends of streamlines from many points, much faster than `paths`; see `resgrid.streamlines`."""
        return streamlines(self.field, self._starts(starts))

    def _starts(self, starts: ArrayLike | None) -> ArrayLike:
        return self.scene_starts if starts is None else starts


def plan(
    where: ConfigurationSpace | Scene,
    *,
    boundary: Boundary | None = None,
    k: float | None = None,
    edge: EdgeRule | Sequence[EdgeRule] | None = None,
    wall_resistance: float | None = None,
    resistance: float | None = None,
    method: str = "auto",
    ranks: Count | None = None,
    launcher: str | None = None,
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
    method : {"auto", "direct", "multigrid", "petsc"}
        As of `resgrid.solve`; ``"petsc"`` is for grids too large for these: processes of PETSc solve it from mapped
        files, to a norm, and ``Planner.field.safe`` tells in which cells it is direction-safe.  Streamlines end at all
        others with ``no_current`` and a `Streamline.reason`.
    ranks : int, optional
        For ``method="petsc"``: how many processes; 2 unless given.
    launcher : str, optional
        For ``method="petsc"``: command that starts the processes, their number included, such as ``"srun -n 64"``, in
        place of ``mpiexec`` with `ranks`.  Processes on other computers need the folder for temporary files
        (``TMPDIR``) under one path, and a Python with petsc4py at one place (``RESGRID_PETSC_PYTHON``).

    Returns
    -------
    Planner

    Raises
    ------
    InputError
        If an option is unknown or does not fit the others.
    AccuracyError
        If the answer is not as right as promised, or a process of PETSc dies.
    ToolMissingError
        If there is no PETSc, or no program of the launcher; the message contains a remedy.
    BudgetError
        If it would not fit in memory, or on the disk.

    Examples
    --------
    >>> planner = rg.plan(rg.read_scene("examples/scenes/lesson.toml"), k=0.5)
    >>> path = planner.path((0.5, 6.5))
    >>> str(path.outcome), round(path.length, 3), round(path.clearance, 3)
    ('reached', 9.036, 0.347)
    """
    work = work_by(method, ranks, launcher)
    if isinstance(where, Scene):
        require_uniform(where, "plan()")
    problem = problem_of(
        where, boundary=boundary, k=k, edge=edge, resistance=resistance, wall_resistance=wall_resistance
    )
    if not problem.ks:
        solution = solve_problem(problem, work=work)
        return Planner(solution.fields[0], solution)
    solution = solve_problem(replace(problem, ks=(1.0, 0.0)), work=work)
    return Planner(blend(*solution.halves, problem.ks[0]), solution)


@frozen
@dataclass(frozen=True, eq=False)
class ClearanceCurve:
    """Clearance of paths against the knob that sets how obstacles behave.

    `knob`: ``"k"`` or ``"wall_resistance"``, in ohms; `value` (n,): its settings; `starts` (m, ndim): in the world;
    `clearance, length` (n, m): of every path, in axis units, NaN where it reaches no goal; `counted` (m,): starts with
    a path at every setting, over which means are taken.
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
    planner: Planner,
    ks: ArrayLike = (0.0, 0.01, 0.1, 0.5, 0.9, 0.99, 1.0),
    starts: ArrayLike | None = None,
    *,
    wall_resistances: ArrayLike | None = None,
) -> ClearanceCurve:
    """Find how far paths keep away from obstacles, against the knob that says so (Connolly & Grupen 1992, section 3.3).

    Parameters
    ----------
    planner : Planner
        Made with a k, so that it holds both fields, unless wall resistances are asked for.
    ks : array_like of float, shape (n,)
        Shares of the Dirichlet field, in [0, 1].
    starts : array_like of float, shape (m, ndim), optional
        In world coordinates.  By default the centres of some 200 cells with a path, evenly spaced among all of them.
    wall_resistances : array_like of float, shape (n,), optional
        In place of `ks` the knob of a single chip, in ohms, one solve each: 0 is Dirichlet, infinity is Neumann.

    Returns
    -------
    ClearanceCurve
        With ``value``, ``clearance`` and ``length`` of every path, and their ``mean`` and ``mean_length``.

    Raises
    ------
    InputError
        If a setting is out of range, the planner holds one field only, or no start has a path at every setting.

    Examples
    --------
    >>> planner = rg.plan(rg.read_scene("examples/scenes/lesson.toml"), k=1.0)
    >>> curve = rg.clearance_curve(planner, ks=(0.0, 0.5, 1.0))
    >>> curve.mean.round(3), curve.mean_length.round(3)
    (array([0.462, 0.494, 0.506]), array([4.511, 4.291, 4.296]))
    """
    space, wiring = planner.space, planner.field.wiring
    if wall_resistances is None:
        knob, values = "k", _settings("k", ks, 1.0)
        fields = [planner.at(k).field for k in values.tolist()]
    else:
        knob, values = "wall_resistance", _settings("wall_resistance", wall_resistances, np.inf)
        walls = [
            replace(wiring, boundary="wall", drive=None, wall_resistance=ohms) if ohms < np.inf else wiring.opened()
            for ohms in values.tolist()
        ]
        fields = [solve_field(space, wall) for wall in walls]
    points = _starts_with_paths(space) if starts is None else start_points(space, starts)
    paths = [[follow(field, point) for point in points] for field in fields]
    reached = np.array([[path.outcome is Outcome.REACHED for path in row] for row in paths])
    counted = np.asarray(reached.all(axis=0))
    if not counted.any():
        flat = [value for value, field in zip(values.tolist(), fields, strict=True) if not field.is_flowing]
        remedy = f"no current flows at {knob} = {flat[0]:g}: leave this setting out" if flat else "choose other starts"
        raise InputError(f"no start reaches a goal at every setting of {knob}; {remedy}")
    clearance, length = (
        np.where(reached, [[getattr(path, name) for path in row] for row in paths], np.nan)
        for name in ("clearance", "length")
    )
    return ClearanceCurve(knob, values, space.to_world(points), clearance, length, counted)


def _settings(knob: str, values: ArrayLike, limit: float) -> NDArray[np.float64]:
    try:
        settings = np.atleast_1d(np.array(values, dtype=np.float64))
    except (TypeError, ValueError) as error:
        raise InputError(f"{knob}: the settings must be numbers") from error
    if settings.ndim != 1 or not settings.size:
        raise InputError(f"{knob}: give at least one setting, in a row")
    within = (settings >= 0) & (settings <= limit)
    if not within.all():
        raise InputError(f"{knob} = {settings[~within][0]} is out of range: it must lie between 0 and {limit:g}")
    return settings


def _starts_with_paths(space: ConfigurationSpace) -> NDArray[np.float64]:
    """Centres of some cells with a path, in axis units, shape (n, ndim)."""
    cells = np.argwhere(space.goal_connected)
    if not len(cells):
        raise InputError("no free cell has a path to a goal, so that there is no clearance to measure")
    chosen = np.unique(np.linspace(0, len(cells) - 1, 200).round().astype(np.int64))
    return space.axis_centre(cells[chosen])
