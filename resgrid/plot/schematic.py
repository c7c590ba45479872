"""Where the parts of a compiled netlist go on paper, in cells: pure geometry."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from resgrid.grids import crossed_faces
from resgrid.netlist import CellMap
from resgrid.space import Cell

HALF = 0.3
"""Half the side of the square that a rail cell is drawn as, in cells."""

_GAP = 0.5 - HALF
_BAND = 0.5
"""Width of the rail around the grid before it is drawn thinner by the gap on both sides."""


def rail_areas(cells: CellMap) -> tuple[BaseGeometry, BaseGeometry, BaseGeometry]:
    """Areas of obstacle rails, the one around the grid among them, of goal rails, and of cells without a node."""
    cell = in_plane(cells.space.cell)
    has_node = in_plane(cells.node) >= 0
    edges = (*cells.wiring.edges(cells.space), "open")[:2]
    around = _bands(cell.shape, [rule == "obstacle" and cells.obstacle_node >= 0 for rule in edges])
    obstacles, goals = (_squares((cell == code) & has_node) for code in (Cell.OBSTACLE, Cell.GOAL))
    merged = cells.wiring.rails == "merged"
    return (
        _area([[*around, *obstacles]] if merged else [around, *([one] for one in obstacles)]),
        _area([goals] if merged else [[one] for one in goals]),
        _area([[one] for one in _squares(~has_node)]),
    )


def in_plane(values: NDArray[Any]) -> NDArray[Any]:
    """Values of cells of one or two axes, as of two."""
    return values.reshape(len(values), -1)


def resistor_ends(
    cells: CellMap,
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Numbers (m,) of the grid's resistors, starts and ends (m, 2) upwards, and whether they cross a seam (m,).

    Those across a seam are drawn outwards at the upper end.
    """
    across, index = crossed_faces(cells.resistor_face, cells.space.shape)
    number = np.flatnonzero(across >= 0)
    along = np.eye(2, dtype=np.int64)[across[number]]
    face = np.zeros((len(number), 2), dtype=np.int64)
    face[:, : index.shape[1]] = index[number]
    cell = in_plane(cells.space.cell)
    lower, upper = _end(cell, face - along, along, 1), _end(cell, face, along, -1)
    seam = np.array(cells.space.periodic)[across[number]] & ((face * along).sum(axis=1) == 0)
    last = (face + (np.array(cell.shape) - 1) * along)[seam]
    lower[seam] = last + 0.5 + (0.5 + HALF) * along[seam]
    upper[seam] = _end(cell, last, along[seam], 1)
    return number, lower, upper, seam


def _end(cell: NDArray[np.uint8], at: NDArray[np.int64], along: NDArray[np.int64], side: int) -> NDArray[np.float64]:
    """Where a resistor ends in a cell: in its middle, or on the square of a rail; shape (n, 2)."""
    inside = np.all((at >= 0) & (at < cell.shape), axis=1)
    free = inside & (cell[tuple(np.clip(at, 0, np.array(cell.shape) - 1).T)] == Cell.FREE)
    return np.asarray(at + 0.5 + side * along * np.where(free, 0.0, HALF)[:, None])


def _squares(mask: NDArray[np.bool_]) -> list[BaseGeometry]:
    return [shapely.box(i, j, i + 1, j + 1) for i, j in np.argwhere(mask).tolist()]


def _bands(shape: tuple[int, ...], railed: list[bool]) -> list[BaseGeometry]:
    """The rail around the grid, on the sides of the axes that have one."""
    (width, height), (x, y) = shape, (_BAND * rail for rail in railed)
    sides = [(-x, -y, 0, height + y), (width, -y, width + x, height + y)] if railed[0] else []
    sides += [(-x, -y, width + x, 0), (-x, height, width + x, height + y)] if railed[1] else []
    return [shapely.box(*side) for side in sides]


def _area(groups: list[list[BaseGeometry]]) -> BaseGeometry:
    """Groups of touching squares, each joined and drawn thinner by the gap."""
    joined = [shapely.union_all(group).buffer(-_GAP, join_style="mitre") for group in groups if group]
    return shapely.union_all(joined)
