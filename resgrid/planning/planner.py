"""Planners: a solved space from which paths from any number of starts are computed, for one or several blends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field as attribute, replace
from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.numbers import Count
from resgrid._internal.values import frozen
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import Wiring, WiringOptions
from resgrid.planning.any_field import AnyField, FieldPath, blended, ends_of, path_of, paths_of, require_faces
from resgrid.planning.blend import dirichlet_fraction
from resgrid.planning.map_changes import Change
from resgrid.planning.pipeline import Solution, problem_of, require_uniform, solve_options, solve_problem
from resgrid.planning.replanning import KeptCircuits, Replanning, solve_changed
from resgrid.planning.trace import Traces
from resgrid.scene import Scene
from resgrid.scene.maps.arrays import MapCells


@frozen
@dataclass(frozen=True, eq=False)
class Planner:
    """A solved configuration space, which computes paths from any number of starts.

    Attributes
    ----------
    field : Field or LatticeField
        Field that paths follow: a `LatticeField` for another lattice than "square".
    solution : Solution
        The solved fields: one, or the Dirichlet and Neumann fields of all blends.
    space : ConfigurationSpace
        Configuration space of the field.
    k : float
        Weight of the Dirichlet field, in [0, 1].
    obstacle_field, open_field : Field or LatticeField
        Fields of k = 1 (obstacles on the rail) and k = 0 (open obstacles); InputError if the planner was created
        without a k.
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

    field: AnyField
    solution: Solution
    replanning: Replanning | None = attribute(default=None, repr=False)
    _kept: KeptCircuits = attribute(default_factory=KeptCircuits, repr=False)
    _scene: Scene | None = attribute(default=None, repr=False)

    @property
    def space(self) -> ConfigurationSpace:
        """Configuration space of the field."""
        return self.field.space

    @property
    def k(self) -> float:
        """Weight of the Dirichlet field, in [0, 1]."""
        return self.field.k

    @property
    def obstacle_field(self) -> AnyField:
        """Field with the weight k = 1: obstacles are connected to the rail, directly or through wall resistances."""
        return self.solution.halves[0]

    @property
    def open_field(self) -> AnyField:
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
        return replace(self, field=blended(*self.solution.halves, k))

    def update(
        self,
        grid: ArrayLike | ConfigurationSpace | MapCells | None = None,
        *,
        cells: ArrayLike | None = None,
        values: ArrayLike | None = None,
        occupancy: ArrayLike | None = None,
    ) -> Planner:
        """Return the planner of a changed map, which reuses the work of earlier updates.

        On planes, the equations are eliminated by nested dissection, and an update repeats the elimination only around
        the changed cells.  The first update eliminates all cells.  Fields are direction-safe, as those of `plan`, and
        depend on the changed map alone, not on earlier maps.  Other spaces, and maps of which more than a quarter has
        changed, get a fresh plan.  `Planner.replanning` reports the method.

        Parameters
        ----------
        grid : array_like of int, ConfigurationSpace or MapCells, optional
            `Cell` code of every cell, shape of the space; the changed space; or, for a planner of a scene with a map,
            the changed map.  A cell that stays a goal keeps its goal point; in a new goal cell every configuration
            solves the goal.  Obstacles of a changed map grow by the robot's shape, as in `build_space`.
        cells : array_like of int, shape (n, ndim), optional
            Indices of the changed cells, in place of `grid`.
        values : int or array_like of int, shape (n,), optional
            New `Cell` code of each of the changed cells, or one code for all of them.
        occupancy : array_like of int, shape (height, width), optional
            In place of `grid`, for a planner of a scene with a map: occupancies of the map's cells as in the ROS
            message ``nav_msgs/OccupancyGrid``, with row 0 at the bottom.  Cells are occupied from 65 on, free from 0 to
            25, and otherwise unknown (-1); the map's key ``unknown`` decides whether unknown cells are obstacles.

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
        change = Change(grid, cells, values, occupancy)
        solution, report = solve_changed(self.solution, change.applied(self.space, self._scene), self._kept)
        if solution is self.solution:
            return replace(self, replanning=report)
        return Planner(_chosen(solution, self.k), solution, report, self._kept, self._scene)

    def dirichlet_fraction(self) -> NDArray[np.float64]:
        """Return the fraction of the blend's gradient that comes from the Dirichlet field, shape of the space.

        Away from the goals, the Dirichlet gradient decays exponentially, but the Neumann gradient does not.  Even with
        a weight k of 0.98, the blend there is almost the Neumann field.  NaN where both gradients vanish.
        """
        obstacle, opened = (require_faces(field, "dirichlet_fraction") for field in self.solution.halves)
        return dirichlet_fraction(obstacle, opened, self.k)

    def path(self, start: ArrayLike | None = None, *, cell: Sequence[int] | None = None) -> FieldPath:
        """Return the path from a start: the streamline, or for another lattice than "square" the path of nodes.

        Parameters
        ----------
        start : array_like of float, shape (ndim,), optional
            Start in world coordinates; give either `start` or `cell`.
        cell : sequence of int, optional
            Start at the centre of this cell.

        Returns
        -------
        Streamline or NodePath
            Its ``outcome`` states whether it reaches a goal.

        Raises
        ------
        InputError
            If the start lies outside the grid, or not exactly one of `start` and `cell` is given.
        """
        return path_of(self.field, start, cell=cell)

    def paths(self, starts: ArrayLike | None = None) -> list[FieldPath]:
        """Return the paths from several starts.

        Parameters
        ----------
        starts : array_like of float, shape (n, ndim), optional
            Starts in world coordinates; by default those of the scene.

        Returns
        -------
        list of Streamline or NodePath
            One path per start, in the same order.

        Raises
        ------
        InputError
            If a start lies outside the grid.
        """
        return paths_of(self.field, self._starts(starts))

    def ends(self, starts: ArrayLike | None = None) -> Traces:
        """Return outcomes, goals and lengths of the paths from several starts, without the points of the paths.

        For streamlines this is much faster than `paths`.

        Parameters
        ----------
        starts : array_like of float, shape (n, ndim), optional
            Starts in world coordinates; by default those of the scene.

        Returns
        -------
        Traces
            Outcome, goal, length, duration and number of steps of every path.

        Raises
        ------
        InputError
            If a start lies outside the grid.
        """
        return ends_of(self.field, self._starts(starts))

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
    scene = where if isinstance(where, Scene) else None
    return Planner(_chosen(solution, k), solution, _kept=KeptCircuits(work), _scene=scene)


def _chosen(solution: Solution, k: float) -> AnyField:
    """Return the blend of a solution's fields with the weight `k` of the Dirichlet field, or its only field."""
    return blended(*solution.halves, k) if solution.problem.ks else solution.fields[0]
