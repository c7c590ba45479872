"""The `Drawing` class: cells, starts and settings on the live page; conversion from and to scenes and spaces."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.values import frozen
from resgrid.core.axis import Axis
from resgrid.core.cell import Cell
from resgrid.core.lattice import SQUARE, LatticeName
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import EdgeRule, Wiring
from resgrid.errors import InputError

if TYPE_CHECKING:
    from resgrid.planning.pipeline import Problem
    from resgrid.robots import Robot
    from resgrid.scene import Scene

MAX_CELLS = 1 << 20
"""Largest number of cells of a drawing; a larger grid raises InputError."""

_MAX_LEVELS = 64
"""Largest number of different conductivities in a drawing; a map with more raises InputError."""

_MAX_GOAL_POINTS = 50_000
"""Largest number of goal cells with which a drawing stores the goal configuration of each cell.

With more goal cells, every configuration in a goal cell counts as a goal.
"""

_INSIDE = 1e-9
"""Smallest distance of a goal configuration from the border of its cell, as a fraction of the cell's width."""

_OF_CIRCUIT = ("boundary", "drive", "k", "leak", "lattice")
"""Keys of a scene file that a drawing writes from its own settings, even if the scene of an arm has other values."""


@frozen
@dataclass(frozen=True, eq=False)
class Drawing:
    """The state of the live page: cells, starts and settings of the circuit.

    `title`: title of the scene; `axes`: two axes of the grid; `edge`: "obstacle", "open" or "periodic" for each axis;
    `cell` (nx, ny): codes of `Cell`; `level` (nx, ny): index of each cell's conductivity in `palette`; `palette`:
    relative conductivities; `starts` (n, 2): in axis units; `k`: weight of the Dirichlet field, 0 to 1; `wall`: wall
    resistance in ohms, 0 for no wall; `leak`: leak to the obstacle rail, in 1 / (unit of the axes)^2; `lattice`: name
    of the lattice, which defines the neighbours of a node; `driven`: whether every start drives a circuit of its own,
    with open obstacles (the page shows the field of the first start); `chip`: keys and values of the ``[chip]`` table
    of the scene, None for the defaults; `world`: for an arm, the document (keys and tables) of the arm's scene, with
    the workspace from which the cells are computed, else None; `broken`: open resistors, as cell (i, j) and axis, for
    the resistor at the cell's lower face across the axis; `goal_points`: goal configurations, as flat index of the cell
    in C order and two coordinates in axis units; in a goal cell without an entry, every configuration is a goal.
    """

    title: str
    axes: tuple[Axis, ...]
    edge: tuple[EdgeRule, ...]
    cell: NDArray[np.uint8]
    level: NDArray[np.uint8]
    palette: tuple[float, ...]
    starts: NDArray[np.float64]
    k: float = 1.0
    wall: float = 0.0
    driven: bool = False
    chip: Mapping[str, Any] | None = None
    world: Mapping[str, Any] | None = None
    broken: tuple[tuple[int, int, int], ...] = ()
    goal_points: tuple[tuple[int, float, float], ...] = ()
    leak: float = 0.0
    lattice: LatticeName = SQUARE

    @property
    def space(self) -> ConfigurationSpace:
        """Configuration space with the cells, the conductivities and the goal configurations of the drawing."""
        costs = np.array(self.palette)[self.level] if self.level.any() or self.palette[0] != 1.0 else None
        points = np.full((*self.cell.shape, 2), np.nan)
        for number, *point in self.goal_points:
            points.reshape(-1, 2)[number] = point
        own = points[self.cell == Cell.GOAL] if self.goal_points else None
        return ConfigurationSpace(self.axes, self.cell, costs, goal_points=own, robot=self._robot)

    @cached_property
    def _robot(self) -> Robot | None:
        """Arm of the drawing; None if configurations are points in the plane."""
        from resgrid.scene.schema import robot_of

        return None if self.world is None else robot_of(self.world.get("robot", {}))

    @property
    def problem(self) -> Problem:
        """Circuits, weights k and starts to solve, without the mismatch and the open resistors of the chip."""
        from resgrid.planning.pipeline import Problem

        chip = dict(self.chip or {})
        options: dict[str, Any] = {key: chip[key] for key in ("resistance", "supply") if key in chip}
        if self.wall:
            options["wall_resistance"] = self.wall
        wiring = Wiring(
            "wall" if self.wall else "dirichlet", edge=self.edge, leak=self.leak, lattice=self.lattice, **options
        )
        return Problem(self.space, wiring, () if self.driven else (self.k,), self.starts, self.driven)

    def document(self) -> dict[str, Any]:
        """Return the keys and tables of a scene file that gives exactly the cells of the drawing, as a dictionary.

        For an arm, the result contains the arm and its workspace instead of cells, unless cells were changed on the
        page.
        """
        chip = dict(self.chip or {})
        if self.wall:
            chip["wall_resistance"] = self.wall
        if self.broken:
            chip["defects"] = {**chip.get("defects", {}), "open_at": [list(place) for place in self.broken]}
        document: dict[str, Any] = {"schema": 1, "title": self.title}
        if self.driven:
            document |= {"boundary": "neumann", "drive": "start"}
        else:
            document |= {"boundary": "wall" if self.wall else "dirichlet", "k": [self.k]}
        if self.leak:
            document["leak"] = self.leak
        if self.lattice != SQUARE:
            document["lattice"] = self.lattice
        rules = tuple(rule for rule in self.edge if rule != "periodic")
        document["edge"] = list(self.edge if len(set(rules)) > 1 else rules[:1] or ("obstacle",))
        document["starts"] = self.starts.tolist()
        document["chip"] = chip
        if self._has_cells_of_world():
            kept = {key: value for key, value in (self.world or {}).items() if key not in _OF_CIRCUIT}
            return {key: value for key, value in (kept | document).items() if value not in ([], {})}
        document["sampling"] = "centre"
        document["grid"] = {"axes": [_axis_table(axis) for axis in self.axes]}
        document["obstacle"] = [self._rectangle(*box) for box in boxes(self.cell == Cell.OBSTACLE)]
        points = {number: {"point": point} for number, *point in self.goal_points}
        numbers = np.flatnonzero(self.cell == Cell.GOAL).tolist()
        cells = np.argwhere(self.cell == Cell.GOAL).tolist()
        document["goal"] = [points.get(number, {"cell": cell}) for number, cell in zip(numbers, cells, strict=True)]
        document["area"] = [
            {**self._rectangle(*box), "conductivity": value}
            for number, value in enumerate(self.palette)
            if value != 1.0
            for box in boxes(self.level == number)
        ]
        return {key: value for key, value in document.items() if value not in ([], {})}

    def _has_cells_of_world(self) -> bool:
        """Return whether the cells are those that the arm's workspace gives; False without an arm."""
        from pathlib import Path

        from resgrid.scene.reading import build_scene

        if self.world is None:
            return False
        own = drawing_of(build_scene(self.world, "the workspace", Path()))
        return own.axes == self.axes and np.array_equal(own.cell, self.cell) and np.array_equal(own.level, self.level)

    def scene(self) -> Scene:
        """Return the validated scene with the cells and the settings of the drawing."""
        from pathlib import Path

        from resgrid.scene.reading import build_scene

        return build_scene(self.document(), "the drawing", Path())

    def _rectangle(self, lower: tuple[int, int], upper: tuple[int, int]) -> dict[str, Any]:
        ends = [
            [float(f"{axis.lower + index * axis.spacing:.12g}") for axis, index in zip(self.axes, corner, strict=True)]
            for corner in (lower, upper)
        ]
        return {"shape": "rectangle", "lower": ends[0], "upper": ends[1]}


def drawing_of(scene: Scene) -> Drawing:
    """Return the drawing of a scene with two axes; raise InputError for another number of axes.

    Of several weights k of the Dirichlet field, the drawing has the first, or the largest if the first is 0.
    """
    from resgrid.robots import Arm
    from resgrid.scene import build_space
    from resgrid.scene.overrides import document_of

    if scene.ndim != 2:
        raise InputError(f"this scene has {scene.ndim} axes, but the live page needs two; choose a scene of two axes")
    check_size([axis.cells for axis in scene.axes])
    space = build_space(scene, require_goal=False)
    palette, level = _palette(space)
    k = float(scene.boundary != "neumann")
    if scene.k:  # a nonzero k if the scene has one, because the page explains obstacles on a rail
        k = scene.k[0] or max(scene.k)
    document = document_of(scene)
    chip = dict(document["chip"])
    wall = chip.pop("wall_resistance", None) if scene.boundary == "wall" else None
    broken = chip["defects"]["open_at"]
    chip["defects"] |= {"open_at": []}
    return Drawing(
        title=scene.title,
        axes=tuple(scene.axes),
        edge=tuple(scene.edge),
        cell=space.cell,
        level=level,
        palette=palette,
        starts=scene.frame.from_world(np.array(scene.starts, dtype=np.float64).reshape(-1, 2)),
        k=0.0 if scene.drive == "start" else k,
        wall=float(wall or 0.0),
        driven=scene.drive == "start" and scene.boundary == "neumann",
        chip=_changed(chip),
        broken=tuple(tuple(place) for place in broken),
        world=document if isinstance(scene.robot, Arm) and scene.map is None else None,
        goal_points=_goal_points(space),
        leak=scene.leak,
        lattice=scene.lattice,
    )


def is_same_circuit(one: Drawing, other: Drawing) -> bool:
    """Return whether two drawings have the same circuit.

    Titles may differ.  Starts may differ, too, except the first start of a drawing in which starts drive the circuit.
    """

    def parts(drawing: Drawing) -> tuple[object, ...]:
        driver = tuple(drawing.starts[0]) if drawing.driven else None
        rules = drawing.edge, drawing.k, drawing.wall, drawing.driven, driver, sorted(drawing.broken)
        return drawing.axes, rules, drawing.leak, drawing.lattice, dict(drawing.chip or {})

    if one.cell.shape != other.cell.shape or not np.array_equal(one.cell, other.cell):
        return False
    cost, other_cost = (np.array(drawing.palette)[drawing.level] for drawing in (one, other))
    return parts(one) == parts(other) and bool(np.array_equal(cost, other_cost))


def drawing_of_space(space: ConfigurationSpace) -> Drawing:
    """Return the drawing of a space with two axes; raise InputError for another number of axes."""
    if space.ndim != 2:
        raise InputError(f"this space has {space.ndim} axes, but the live page needs two; choose a space of two axes")
    check_size(list(space.shape))
    palette, level = _palette(space)
    edge: tuple[EdgeRule, ...] = tuple("periodic" if axis.periodic else "obstacle" for axis in space.axes)
    none = np.empty((0, 2))
    return Drawing("", space.axes, edge, space.cell, level, palette, none, goal_points=_goal_points(space))


def _goal_points(space: ConfigurationSpace) -> tuple[tuple[int, float, float], ...]:
    """Return the goal configurations of a space, as tuples of the flat index of a goal cell and two coordinates.

    Indices are in C order, coordinates in axis units; points at the border of their cell are moved inside by 1e-9 of
    the cell's width.  Goal cells in which every configuration is a goal have no entry; the result is empty for more
    than 50,000 goal cells.
    """
    cells = np.argwhere(space.cell == Cell.GOAL)
    points = space.goal_point(cells)
    known = ~np.isnan(points).any(axis=1) & (len(cells) <= _MAX_GOAL_POINTS)
    local = np.clip((points - space.lower) / space.spacing - cells, _INSIDE, 1.0 - _INSIDE)
    inside = space.lower + (cells + local) * space.spacing
    numbers = np.flatnonzero(space.cell == Cell.GOAL)
    rows = zip(numbers[known].tolist(), inside[known].tolist(), strict=True)
    return tuple((number, x, y) for number, (x, y) in rows)


def blank(cells: int = 96) -> Drawing:
    """Return a square drawing without obstacles, with one goal and one start; `cells`: number of cells per axis."""
    axes = tuple(Axis(name, 0.0, float(cells), cells, unit="cell") for name in "xy")
    cell = np.zeros((cells, cells), dtype=np.uint8)
    cell[cells * 3 // 4, cells * 3 // 4] = Cell.GOAL
    starts = np.array([[cells // 5 + 0.5, cells // 5 + 0.5]])
    return Drawing("Drawing", axes, ("obstacle", "obstacle"), cell, np.zeros_like(cell), (1.0,), starts)


def check_size(cells: list[int]) -> None:
    """Raise InputError for a grid with more than `MAX_CELLS` (about a million) cells.

    `cells`: number of cells along each axis.
    """
    count = int(np.prod([float(number) for number in cells]))
    if count > MAX_CELLS:
        size = " x ".join(f"{number:,}" for number in cells)
        raise InputError(f"{size} cells are too many to draw; the live page draws up to {MAX_CELLS:,}")


def boxes(mask: NDArray[np.bool_]) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """Yield disjoint boxes that cover exactly the cells of a mask (nx, ny).

    A box is a pair of cell indices ``(i, j)``: lower corner (inclusive) and upper corner (exclusive).
    """
    edges = np.diff(np.pad(mask, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    begun: dict[tuple[int, int], int] = {}
    for column in range(len(mask) + 1):
        row = edges[column] if column < len(mask) else np.zeros(0)
        runs = set(zip(np.flatnonzero(row == 1).tolist(), np.flatnonzero(row == -1).tolist(), strict=True))
        for low, high in sorted(begun.keys() - runs):
            yield (begun.pop((low, high)), low), (column, high)
        begun |= dict.fromkeys(runs - begun.keys(), column)


def _palette(space: ConfigurationSpace) -> tuple[tuple[float, ...], NDArray[np.uint8]]:
    if space.conductivity is None:
        return (1.0,), np.zeros(space.shape, dtype=np.uint8)
    values, level = np.unique(space.conductivity, return_inverse=True)
    if len(values) > _MAX_LEVELS:
        raise InputError(f"this map has {len(values)} different costs; the live page draws up to {_MAX_LEVELS}")
    order = np.argsort(values != 1.0, kind="stable")
    number = np.empty(len(values), dtype=np.uint8)
    number[order] = np.arange(len(values))
    return tuple(values[order].tolist()), number[level].reshape(space.shape)


def _changed(chip: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries of a ``[chip]`` table, `chip`, whose values differ from the defaults of a scene file."""
    from resgrid.scene import Chip
    from resgrid.scene.table_models import plain

    usual = plain(Chip())
    return {key: value for key, value in chip.items() if value != usual.get(key)}


def _axis_table(axis: Axis) -> dict[str, Any]:
    table = {"name": axis.name, "lower": axis.lower, "upper": axis.upper, "cells": axis.cells}
    return table | ({"periodic": True} if axis.periodic else {}) | {"unit": axis.unit}
