"""The type `Change`, a change of some cells of a map, and the configuration space after the change."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.numbers import real_numbers
from resgrid.core.cell import Cell
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.planning.trace import cell_indices
from resgrid.scene import Scene, build_space
from resgrid.scene.maps.arrays import MapCells
from resgrid.scene.maps.occupancies import cells_of_occupancies


@dataclass(frozen=True, eq=False)
class Change:
    """A change of a map in one of three forms: `grid`, `cells` with `values`, or `occupancy`; the others are None.

    `grid`: `Cell` code of every cell, the changed space, or the changed map; `cells` (n, ndim), `values` (n,) or ():
    indices of the changed cells, and the new `Cell` codes of these cells, one each or one for all; `occupancy` (height,
    width): occupancies of the cells of the map, in percent, -1 if unknown, bottom row first, as in the ROS message
    ``nav_msgs/OccupancyGrid``.
    """

    grid: ArrayLike | ConfigurationSpace | MapCells | None
    cells: ArrayLike | None
    values: ArrayLike | None
    occupancy: ArrayLike | None

    def __post_init__(self) -> None:
        given = [part is not None for part in (self.grid, self.cells, self.occupancy)]
        if sum(given) != 1 or (self.cells is None) != (self.values is None):
            raise InputError("update() needs one of grid (the codes of all cells), occupancy, or both cells and values")

    def applied(self, space: ConfigurationSpace, scene: Scene | None) -> ConfigurationSpace:
        """Return the space after the change.

        The result is `grid` itself if `grid` is a space, and `space` itself if no cell changes.  `space`: space before
        the change; `scene`: scene of this space, None without a scene.  Raise InputError for invalid values.
        """
        if isinstance(self.grid, ConfigurationSpace):
            return self.grid
        if isinstance(self.grid, MapCells) or self.occupancy is not None:
            return self._mapped(space, scene)
        codes = self._codes(space)
        return space if np.array_equal(codes, space.cell) else space.with_cells(codes)

    def _codes(self, space: ConfigurationSpace) -> NDArray[np.integer]:
        """Return the code of every cell after the change, shape of the space.

        A `grid` of another shape is returned as it is; the new space rejects it.
        """
        if self.grid is not None:
            codes = real_numbers("grid", self.grid)  # type: ignore[arg-type]
            return codes.astype(np.uint8) if codes.dtype == bool else codes
        assert self.cells is not None and self.values is not None
        cells = np.empty((0, space.ndim), dtype=np.int64) if np.size(self.cells) == 0 else self.cells
        index, values = cell_indices(space, cells, ndim=2), real_numbers("values", self.values)
        if values.shape not in ((), (len(index),)):
            raise InputError(f"values has shape {values.shape}; give one code, or one per cell in cells ({len(index)})")
        wrong = ~np.isin(values, list(Cell))
        if wrong.any():
            code = values[wrong].flat[0]
            raise InputError(f"values: {code} is no cell code; use 0 (free), 1 (obstacle) or 2 (goal)")
        codes = space.cell.copy()
        codes[tuple(index.T)] = values
        return codes

    def _mapped(self, space: ConfigurationSpace, scene: Scene | None) -> ConfigurationSpace:
        """Return the space of the scene with the changed map; `space` itself if nothing changes.

        Raise InputError if there is no scene with a map, or the axes of the changed map differ.
        """
        if scene is None or scene.map is None:
            raise InputError(
                "this planner has no scene with a map, so that update() needs grid, an array with the code of every "
                "cell, or cells and values"
            )
        new = self.grid if isinstance(self.grid, MapCells) else _from_occupancy(scene.map, self.occupancy)
        if new.axes != scene.map.axes:
            raise InputError(
                "the changed map has other axes than the map of the scene; plan again: rg.plan(scene.replace(map=...))"
            )
        changed = build_space(scene.replace(map=new))
        return space if _same(space, changed) else changed


def _same(one: ConfigurationSpace, other: ConfigurationSpace) -> bool:
    """Return whether two spaces of one scene have equal cells, conductivities and goal points."""
    pairs = ((getattr(space, name) for space in (one, other)) for name in ("cell", "conductivity", "goal_points"))
    return all(a is b or (a is not None and b is not None and np.array_equal(a, b, equal_nan=True)) for a, b in pairs)


def _from_occupancy(old: MapCells, occupancy: ArrayLike | None) -> MapCells:
    """Return the map `old` with other occupancies; its goal cells stay goals where they are free.

    `occupancy` (height, width): values in percent, -1 if unknown, bottom row first.
    """
    assert occupancy is not None
    values = real_numbers("occupancy", occupancy)
    if values.ndim != 2 or values.shape[::-1] != old.cell.shape:
        raise InputError(
            f"occupancy has shape {values.shape}, but the map has {old.cell.shape[-1]} rows and {old.cell.shape[0]} "
            "columns; row 0 is the bottom row"
        )
    cell, unknown = cells_of_occupancies(values, old.table.get("unknown", "obstacle"))
    cell[(old.cell == Cell.GOAL) & (cell == Cell.FREE)] = Cell.GOAL
    return replace(old, cell=cell, unknown=unknown)
