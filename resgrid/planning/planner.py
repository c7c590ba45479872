"""Solve once, answer many starts: a planner is a field and, for blends, the two it is made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.compiler import compile_space
from resgrid.errors import InputError
from resgrid.nodal.solve import solve
from resgrid.planning.blend import blend, check_share
from resgrid.planning.completeness import Separation, separation
from resgrid.planning.destinations import basins
from resgrid.planning.field import Field, field_of
from resgrid.planning.streamline import Streamline
from resgrid.planning.trace import Traces, follow, start_points, streamline, streamlines
from resgrid.space import ConfigurationSpace

if TYPE_CHECKING:
    from resgrid.scene import Scene


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
    setting = _setting(where)
    if k is not None:
        check_share(k)
    if k is not None and boundary == "neumann":
        raise InputError("a blend has its obstacles on the rail at k = 1: choose boundary = 'dirichlet' or 'wall'")
    if boundary is None:
        k = setting.k if k is None else k
        boundary = setting.boundary if k is None or setting.boundary == "wall" else "dirichlet"
    wall = setting.wall_resistance if wall_resistance is None and boundary == "wall" else wall_resistance
    ohms = setting.resistance if resistance is None else resistance
    edges = setting.edge if edge is None else edge

    def solved(rule: str) -> Field:
        return _field(setting.space, rule, edges, ohms, wall if rule == boundary else None)

    if k is None:
        return Planner(solved(boundary), None, None, setting.starts)
    obstacle_field, open_field = solved(boundary), solved("neumann")
    return Planner(blend(obstacle_field, open_field, k), obstacle_field, open_field, setting.starts)


@dataclass(frozen=True, eq=False)
class _Setting:
    """What a scene says beyond its cells; defaults for a bare space."""

    space: ConfigurationSpace
    starts: NDArray[np.float64]
    boundary: str = "dirichlet"
    k: float | None = None
    edge: str | tuple[str, ...] = "obstacle"
    wall_resistance: float | None = None
    resistance: float = 10e3


def _setting(where: ConfigurationSpace | Scene) -> _Setting:
    if isinstance(where, ConfigurationSpace):
        return _Setting(where, np.empty((0, where.ndim)))
    from resgrid.scene import Scene, sample

    if not isinstance(where, Scene):
        raise InputError(f"plan() takes a configuration space or a scene, got {type(where).__name__}")
    if where.boundary == "neumann" and where.drive == "start":
        raise InputError("a scene with drive = 'start' serves one start at a time; plan() needs drive = 'uniform'")
    return _Setting(
        space=sample(where),
        starts=np.array(where.starts, dtype=np.float64).reshape(-1, where.ndim),
        boundary=where.boundary,
        k=where.k[0] if where.k else None,
        edge=where.edge,
        wall_resistance=where.chip.wall_resistance,
        resistance=where.chip.resistance,
    )


def _field(
    space: ConfigurationSpace, boundary: str, edge: str | Sequence[str], resistance: float, wall: float | None
) -> Field:
    netlist = compile_space(space, boundary=boundary, edge=edge, resistance=resistance, wall_resistance=wall)
    return field_of(solve(netlist))
