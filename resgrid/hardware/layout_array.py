"""Contents of the tiles of a layout (one tile per cell of the grid): resistors, nodes and ties to rails."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.core.cell import Cell
from resgrid.core.netlist import Netlist
from resgrid.core.regions import face_shape
from resgrid.hardware.layout_rules import CellPlacement, Label, MetalRules
from resgrid.hardware.layout_tiles import TileGeometry, placements

ORIGIN = (-1, -1)
"""Column and row, in the grid, of the first tile of a `TileArray`: its arrays have a margin of one tile on all sides.

A tile is the drawing of one cell of the grid; the tiles of the margin belong to the obstacle rail.
"""


@dataclass(frozen=True, eq=False)
class TileArray:
    """Contents of all tiles of a layout; a tile is the drawing of one cell of the grid.

    Arrays have the shape (columns + 2, rows + 2), row 0 at the bottom: a margin of one tile around the grid belongs to
    the obstacle rail. `along_x`, `along_y`: for the resistor from a tile to the next one along x or y, the index of its
    resistance among the different resistances of the layout, -1 without a resistor; `node`: whether a tile has a metal
    bar, which is its node; `obstacle`: whether a tile is tied to the obstacle rail; `region`: for a tile of a goal
    region or the start, the index of its net in `nets`, -1 elsewhere; `nets`: names of the nets of the goal regions and
    the start.
    """

    along_x: NDArray[np.int64]
    along_y: NDArray[np.int64]
    node: NDArray[np.bool_]
    obstacle: NDArray[np.bool_]
    region: NDArray[np.int64]
    nets: tuple[str, ...]


def tile_array(netlist: Netlist, value: NDArray[np.int64]) -> TileArray:
    """Return the contents of the tiles (drawings of one cell each) of a compiled space.

    `netlist`: netlist with merged rails of a space of two axes; `value` (resistors,): index of each resistor's
    resistance among the different resistances.
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


def array_placements(array: TileArray, tile: TileGeometry, values: int) -> list[CellPlacement]:
    """Return the placements of bars, ties to rails and resistors of all tiles.

    A bar is the vertical piece of metal 1 that is the node of a tile; a tie is a set of vias from a bar to its rail.
    `array`: contents of the tiles; `tile`: measures of a tile; `values`: number of different resistances.
    """
    placed = placements("node", array.node, tile, ORIGIN)
    placed += placements("tie_obstacle", array.obstacle, tile, ORIGIN)
    placed += placements("tie_goal", array.region >= 0, tile, ORIGIN)
    for name, numbers in (("x", array.along_x), ("y", array.along_y)):
        for value in range(values):
            placed += placements(f"{name}{value}", numbers == value, tile, ORIGIN)
    return placed


def node_labels(array: TileArray, tile: TileGeometry, metal: MetalRules) -> list[Label]:
    """Return one label such as ``n_3_4`` (column, row) per node of a free cell except the start.

    The label lies at the node, on the bar of metal of the cell's tile. `metal`: rules of this metal, whose label layer
    is used.
    """
    own = array.node & ~array.obstacle & (array.region < 0)
    return [Label(f"n_{i}_{j}", i * tile.px, j * tile.py, metal.text) for i, j in (np.argwhere(own) + ORIGIN).tolist()]


def used_range(mask: NDArray[np.bool_], axis: int) -> tuple[int, int]:
    """Return the first and last column (`axis` 0) or row (`axis` 1) of the grid in which a mask of tiles is true.

    A tile is the drawing of one cell. `mask` (columns + 2, rows + 2): true at least once. The margin of one tile around
    the grid counts: column -1 is left of the grid, row -1 below.
    """
    used = np.flatnonzero(mask.any(axis=1 - axis))
    return int(used[0]) + ORIGIN[axis], int(used[-1]) + ORIGIN[axis]


def first_cells(array: TileArray, region: int) -> Sequence[tuple[int, int]]:
    """Return column and row of the lowest tile of a net in each column that contains the net, from left to right.

    Columns and rows are those of the grid. `region`: index of the net in `array.nets`.
    """
    places = np.argwhere(array.region == region) + ORIGIN
    columns, first = np.unique(places[:, 0], return_index=True)
    return [(int(column), int(places[place, 1])) for column, place in zip(columns, first, strict=True)]
