"""Planners: a solved space from which paths from any number of starts are computed, for one or several blends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field as attribute, replace
from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.numbers import Count
from resgrid._internal.values import frozen, picture_html
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import Wiring, WiringOptions, wiring_of
from resgrid.errors import InputError
from resgrid.planning.blend import blend, dirichlet_share
from resgrid.planning.fields import Field
from resgrid.planning.pipeline import Solution, problem_of, require_uniform, solve_field, solve_options, solve_problem
from resgrid.planning.replanning import KeptCircuits, Replanning, changed_space, solve_changed
from resgrid.planning.streamline import Outcome, Streamline
from resgrid.planning.trace import Traces, follow, start_points, streamline, streamlines
from resgrid.scene import Scene


@frozen
@dataclass(frozen=True, eq=False)
class Planner:
    """A solved configuration space, which computes paths from any number of starts.

    Attributes
    ----------
    field : Field
        Field that streamlines follow.
    solution : Solution
        The solved fields: one, or the Dirichlet and Neumann fields of all blends.
    space : ConfigurationSpace
        Configuration space of the field.
    k : float
        Weight of the Dirichlet field, in [0, 1].
    obstacle_field, open_field : Field
        Fields of k = 1 (obstacles on the rail) and k = 0 (open obstacles).
    scene_starts : ndarray of float64, shape (n, ndim)
        Starts of the scene, in world coordinates.
    replanning : Replanning or None
        Method of the update that made this planner, and the reason for a fresh plan; None without an update.

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
    replanning: Replanning | None = attribute(default=None, repr=False)
    _kept: KeptCircuits = attribute(default_factory=KeptCircuits, repr=False)

    @property
    def space(self) -> ConfigurationSpace:
        """Configuration space of the field."""
        return self.field.space

    @property
    def k(self) -> float:
        """Weight of the Dirichlet field, in [0, 1]."""
        return self.field.k

    @property
    def obstacle_field(self) -> Field:
        """Field with the weight k = 1: obstacles are connected to the rail, directly or through wall resistances."""
        return self.solution.halves[0]

    @property
    def open_field(self) -> Field:
        """Neumann field, with the weight k = 0: obstacles are open, so that no current flows into them."""
        return self.solution.halves[1]

    @property
    def scene_starts(self) -> NDArray[np.float64]:
        """Starts of the scene in world coordinates, shape (n, ndim)."""
        return self.solution.problem.starts

    def at(self, k: float) -> Planner:
        """Return a planner for another blend, without solving again.

        Parameters
        ----------
        k : float
            Weight of the Dirichlet field, in [0, 1].

        Returns
        -------
        Planner
            Planner for the blend, which shares the solved fields.

        Raises
        ------
        InputError
            If `k` is out of range, or the planner was created without a k, so that it does not hold both fields.
        """
        return replace(self, field=blend(*self.solution.halves, k))

    def update(
        self,
        grid: ArrayLike | ConfigurationSpace | None = None,
        *,
        cells: ArrayLike | None = None,
        values: ArrayLike | None = None,
    ) -> Planner:
        """Return the planner of a changed map, which reuses the work of earlier updates.

        On planes, the equations are eliminated by nested dissection, and an update repeats the elimination only around
        the changed cells.  The first update eliminates all cells.  Fields are direction-safe, as those of `plan`, and
        depend on the changed map alone, not on earlier maps.  Other spaces, and maps of which more than a quarter has
        changed, get a fresh plan.  `Planner.replanning` reports the method.

        Parameters
        ----------
        grid : array_like of int or ConfigurationSpace, optional
            `Cell` code of every cell, shape of the space, or the changed space.  A cell that stays a goal keeps its
            goal point; in a new goal cell every configuration solves the goal.
        cells : array_like of int, shape (n, ndim), optional
            Indices of the changed cells, in place of `grid`.
        values : int or array_like of int, shape (n,), optional
            Code of these cells, or of every one of them.

        Returns
        -------
        Planner
            A new planner; this one stays valid.

        Raises
        ------
        InputError
            If the arguments do not fit the space, or no cell is a goal.

        Examples
        --------
        >>> planner = rg.plan(rg.build_space(rg.read_scene("examples/scenes/lesson.toml")))
        >>> planner.path((0.5, 6.5))
        <Streamline reached goal 0: 12 points, length 8.712, clearance 0.4148>
        >>> planner = planner.update(cells=[(2, 6), (3, 6)], values=rg.Cell.OBSTACLE)
        >>> planner.path((0.5, 6.5))
        <Streamline reached goal 0: 12 points, length 8.788, clearance 0.3157>
        >>> planner.replanning.method, planner.replanning.changed
        ('elimination', 2)
        """
        space = changed_space(self.space, grid, cells, values)
        solution, report = solve_changed(self.solution, space, self._kept)
        if solution is self.solution:
            return replace(self, replanning=report)
        return Planner(_chosen(solution, self.k), solution, report, self._kept)

    def dirichlet_share(self) -> NDArray[np.float64]:
        """Return the fraction of the blend's gradient that comes from the Dirichlet field, shape of the space.

        Away from the goals, the Dirichlet gradient decays exponentially, but the Neumann gradient does not.  Even with
        a weight k of 0.98, the blend there is almost the Neumann field.  NaN where both gradients vanish.
        """
        return dirichlet_share(*self.solution.halves, self.k)

    def path(self, start: ArrayLike | None = None, *, cell: Sequence[int] | None = None) -> Streamline:
        """Return the streamline from a start.

        Parameters
        ----------
        start : array_like of float, shape (ndim,), optional
            Start in world coordinates; give either `start` or `cell`.
        cell : sequence of int, optional
            Start at the centre of this cell.

        Returns
        -------
        Streamline
            Its ``outcome`` tells whether it reaches a goal.

        Raises
        ------
        InputError
            If the start lies outside the grid, or not exactly one of `start` and `cell` is given.
        """
        return streamline(self.field, start, cell=cell)

    def paths(self, starts: ArrayLike | None = None) -> list[Streamline]:
        """Return the streamlines from several starts.

        Parameters
        ----------
        starts : array_like of float, shape (n, ndim), optional
            Starts in world coordinates; by default those of the scene.

        Returns
        -------
        list of Streamline
            One streamline per start, in the same order.

        Raises
        ------
        InputError
            If a start lies outside the grid.
        """
        return [follow(self.field, point) for point in start_points(self.space, self._starts(starts))]

    def ends(self, starts: ArrayLike | None = None) -> Traces:
        """Return only the ends of the streamlines from several starts, much faster than `paths`.

        Parameters
        ----------
        starts : array_like of float, shape (n, ndim), optional
            Starts in world coordinates; by default those of the scene.

        Returns
        -------
        Traces
            Outcome, goal, length, duration and number of steps of every streamline.

        Raises
        ------
        InputError
            If a start lies outside the grid.
        """
        return streamlines(self.field, self._starts(starts))

    def _starts(self, starts: ArrayLike | None) -> ArrayLike:
        """Return `starts` (n, ndim), in world coordinates, by default the starts of the scene."""
        return self.scene_starts if starts is None else starts


def plan(
    where: ConfigurationSpace | Scene,
    wiring: Wiring | None = None,
    *,
    k: float | None = None,
    method: str = "auto",
    ranks: Count | None = None,
    launcher: str | None = None,
    **options: Unpack[WiringOptions],
) -> Planner:
    """Solve a space once, for paths from any number of starts.

    Parameters
    ----------
    where : ConfigurationSpace or Scene
        Space to solve.  A scene is sampled into cells first; the keys of the scene hold where neither `wiring` nor
        `options` give a value.
    wiring : Wiring, optional
        Boundary conditions and element values; by default those of the scene, or obstacles on the rail.  In a blend the
        wiring describes the circuit at k = 1.
    k : float, optional
        Weight of the Dirichlet field, in [0, 1].  With any k, 0 and 1 included, both fields are solved, and
        `Planner.at` gives other blends without solving again.  By default, the first ``k`` of the scene, unless a
        boundary is given.
    method : {"auto", "direct", "multigrid", "petsc"}
        Solution method of `resgrid.solve`.  Use ``"petsc"`` for grids that do not fit in memory: PETSc processes solve
        them from memory-mapped files, to a normwise tolerance.  ``Planner.field.safe`` is then the mask of
        direction-safe cells, and streamlines end at all other cells with ``no_current`` and a `Streamline.reason`.
    ranks : int, optional
        Number of processes for ``method="petsc"``, 2 by default.
    launcher : str, optional
        For ``method="petsc"``: command that starts the processes and sets their number, such as ``"srun -n 64"``, in
        place of ``mpiexec`` with `ranks`.  Processes on other computers need the folder for temporary files
        (``TMPDIR``) under one path, and a Python with petsc4py at one place (``RESGRID_PETSC_PYTHON``).
    **options
        Fields of `Wiring`, such as ``boundary="neumann"``, which replace fields of the given or default wiring.

    Returns
    -------
    Planner
        The solved space, from which paths are computed.

    Raises
    ------
    InputError
        If an option is unknown or does not fit the others.
    AccuracyError
        If the solution is not direction-safe, or a PETSc process terminates early.
    ToolMissingError
        If PETSc or the program of the launcher is not installed; the message explains the installation.
    BudgetError
        If the solution would not fit in memory, or on the disk.

    Examples
    --------
    >>> planner = rg.plan(rg.read_scene("examples/scenes/lesson.toml"), k=0.5)
    >>> path = planner.path((0.5, 6.5))
    >>> str(path.outcome), round(path.length, 3), round(path.clearance, 3)
    ('reached', 9.036, 0.347)
    """
    work = solve_options(method, ranks, launcher)
    if isinstance(where, Scene):
        require_uniform(where, "plan()")
    problem = problem_of(where, wiring, k=k, **options)
    k = problem.ks[0] if problem.ks else 1.0
    solution = solve_problem(replace(problem, ks=(1.0, 0.0)) if problem.ks else problem, work=work)
    return Planner(_chosen(solution, k), solution, _kept=KeptCircuits(work))


def _chosen(solution: Solution, k: float) -> Field:
    """Return the blend of a solution's fields with the weight `k` of the Dirichlet field, or its only field."""
    return blend(*solution.halves, k) if solution.problem.ks else solution.fields[0]


@frozen
@dataclass(frozen=True, eq=False)
class ClearanceCurve:
    """Clearance of paths as a function of a parameter of the boundary condition at obstacles.

    Returned by `resgrid.planning.clearance_curve`.

    Attributes
    ----------
    knob : {"k", "wall_resistance"}
        The parameter.
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
    >>> curve.knob, curve.clearance.shape
    ('k', (2, 56))
    >>> curve.clearance[:, 10].round(3), curve.length[:, 10].round(3)
    (array([0.03 , 0.211]), array([5.564, 5.46 ]))
    >>> curve.mean.round(3)
    array([0.462, 0.506])
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
        Starts in world coordinates.  By default the centres of about 200 cells with a path, evenly spaced in C order.
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
    space, wiring = planner.space, planner.field.wiring
    if wall_resistances is None:
        knob, values = "k", _settings("k", ks, 1.0)
        fields = [planner.at(k).field for k in values.tolist()]
    else:
        knob, values = "wall_resistance", _settings("wall_resistance", wall_resistances, np.inf)
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
        remedy = f"no current flows at {knob} = {flat[0]:g}: leave this value out" if flat else "choose other starts"
        raise InputError(f"no start reaches a goal at every value of {knob}; {remedy}")
    clearance, length = (
        np.where(reached, [[getattr(path, name) for path in row] for row in paths], np.nan)
        for name in ("clearance", "length")
    )
    return ClearanceCurve(knob, values, space.to_world(points), clearance, length, counted)


def _settings(knob: str, values: ArrayLike, limit: float) -> NDArray[np.float64]:
    """Return `values` of a parameter as an array (n,); raise InputError unless they lie between 0 and `limit`.

    `knob`: name of the parameter in the message.
    """
    try:
        settings = np.atleast_1d(np.array(values, dtype=np.float64))
    except (TypeError, ValueError) as error:
        raise InputError(f"{knob}: the values must be numbers") from error
    if settings.ndim != 1 or not settings.size:
        raise InputError(f"{knob}: give a one-dimensional sequence of at least one value")
    within = (settings >= 0) & (settings <= limit)
    if not within.all():
        raise InputError(f"{knob} = {settings[~within][0]} is out of range: it must lie between 0 and {limit:g}")
    return settings


def _starts_with_paths(space: ConfigurationSpace) -> NDArray[np.float64]:
    """Return the centres (n, ndim), in axis units, of at most 200 goal-connected cells, evenly spaced in C order."""
    cells = np.argwhere(space.goal_connected)
    if not len(cells):
        raise InputError("no free cell has a path to a goal: move the goal, or open a passage to it")
    chosen = np.unique(np.linspace(0, len(cells) - 1, 200).round().astype(np.int64))
    return space.axis_centre(cells[chosen])
