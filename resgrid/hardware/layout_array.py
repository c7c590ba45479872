"""The array of a layout: which tile has which resistors, nodes and ties to rails, from a compiled space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.core.cell import Cell
from resgrid.core.netlist import Netlist
from resgrid.core.regions import face_shape
from resgrid.hardware.layout_rules import Label, MetalRules, Placement
from resgrid.hardware.layout_tiles import TileGeometry, placements

ORIGIN = (-1, -1)
"""Column and row of the first tile: a margin of one tile around the grid belongs to the obstacle rail."""


@dataclass(frozen=True, eq=False)
class TileArray:
    """Contents of all tiles; arrays have one entry per tile, with a margin of one tile around the grid.

    `along_x`, `along_y` (columns + 2, rows + 2): number of the resistor's value, -1 without a resistor; `node`: tiles
    with a bar; `obstacle`: tiles tied to the obstacle rail; `region`: number of the net of metal 3 of a tile, a goal
    region or the start, -1 elsewhere; `nets`: names of these nets.
    """

    along_x: NDArray[np.int64]
    along_y: NDArray[np.int64]
    node: NDArray[np.bool_]
    obstacle: NDArray[np.bool_]
    region: NDArray[np.int64]
    nets: tuple[str, ...]


def tile_array(netlist: Netlist, value: NDArray[np.int64]) -> TileArray:
    """Return the contents of the tiles of a compiled space.

    `netlist`: netlist with merged rails of a space of two axes; `value` (resistors,): number of each resistor's value.
    """
    cells = netlist.cells
    space, shape = cells.space, cells.space.shape
    counts = [int(np.prod(face_shape(shape, axis))) for axis in range(2)]
    numbers = np.full(sum(counts), -1, dtype=np.int64)
    numbers[cells.resistor_face] = value
    wide = (shape[0] + 2, shape[1] + 2)
    along_x, along_y = np.full(wide, -1, dtype=np.int64), np.full(wide, -1, dtype=np.int64)
    along_x[:-1, 1:-1] = numbers[: counts[0]].reshape(face_shape(shape, 0))
    along_y[1:-1, :-1] = numbers[counts[0] :].reshape(face_shape(shape, 1))
    touched = (along_x >= 0) | (along_y >= 0)
    touched[1:] |= along_x[:-1] >= 0
    touched[:, 1:] |= along_y[:, :-1] >= 0
    kind = np.pad(space.cell, 1, constant_values=Cell.OBSTACLE)
    region = np.pad(np.where(space.cell == Cell.GOAL, space.goal_region, -1), 1, constant_values=-1).astype(np.int64)
    nets = [f"goal_{number}" for number in range(space.goal_count)]
    start = cells.wiring.start
    if start is not None:
        region[start[0] + 1, start[1] + 1] = len(nets)
        nets.append(f"n_{start[0]}_{start[1]}")
    return TileArray(along_x, along_y, touched | (region >= 0), touched & (kind == Cell.OBSTACLE), region, tuple(nets))


def array_placements(array: TileArray, tile: TileGeometry, values: int) -> list[Placement]:
    """Return the placements of nodes, ties and resistors of all tiles; `values`: number of different resistors."""
    placed = placements("node", array.node, tile, ORIGIN)
    placed += placements("tie_obstacle", array.obstacle, tile, ORIGIN)
    placed += placements("tie_goal", array.region >= 0, tile, ORIGIN)
    for name, numbers in (("x", array.along_x), ("y", array.along_y)):
        for value in range(values):
            placed += placements(f"{name}{value}", numbers == value, tile, ORIGIN)
    return placed


def node_labels(array: TileArray, tile: TileGeometry, metal: MetalRules) -> list[Label]:
    """Return one label per node of a free cell, on its bar of metal 1: ``n_3_4``."""
    own = array.node & ~array.obstacle & (array.region < 0)
    return [Label(f"n_{i}_{j}", i * tile.px, j * tile.py, metal.text) for i, j in (np.argwhere(own) + ORIGIN).tolist()]


def used_range(mask: NDArray[np.bool_], axis: int) -> tuple[int, int]:
    """Return the first and last tile along an axis that a mask contains, as columns or rows of the grid."""
    used = np.flatnonzero(mask.any(axis=1 - axis))
    return int(used[0]) + ORIGIN[axis], int(used[-1]) + ORIGIN[axis]


def first_cells(array: TileArray, region: int) -> Sequence[tuple[int, int]]:
    """Return column and row of the lowest tile of a net in every column that it has, from left to right."""
    places = np.argwhere(array.region == region) + ORIGIN
    columns, first = np.unique(places[:, 0], return_index=True)
    return [(int(column), int(places[place, 1])) for column, place in zip(columns, first, strict=True)]
