"""Arrays of an elimination tree: its structure, the equations of a plane, and the eliminated fronts."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Tree(NamedTuple):
    """Nested dissection of a plane of cells: a binary tree of rectangles, children before parents.

    A node without children holds all cells of a small rectangle.  Every other node holds a line of cells that separates
    the rectangles of its two children.  Cells are numbered in the order of elimination (ranks), node by node.

    `rank` (nx, ny): rank of every cell; `neighbour` (cells, 4): ranks of the neighbours of the cell of every rank, at
    the lower and the higher index along the first axis, then along the second, -1 beyond the grid; `owner` (cells,):
    node of the cell of every rank; `first, last` (nodes,): lowest rank of a node's cells, and highest rank plus 1;
    `left, right, parent` (nodes,): children and parent, -1 without one; `offset` (nodes + 1,): index into
    ``Fronts.values`` of the first value of a node's front; `first_row` (nodes + 1,): index into ``Fronts.cell`` of the
    front's first row.
    """

    rank: NDArray[np.int32]
    neighbour: NDArray[np.int32]
    owner: NDArray[np.int32]
    first: NDArray[np.int64]
    last: NDArray[np.int64]
    left: NDArray[np.int64]
    right: NDArray[np.int64]
    parent: NDArray[np.int64]
    offset: NDArray[np.int64]
    first_row: NDArray[np.int64]


class Planes(NamedTuple):
    """Equations of a plane of cells, by rank (number in the order of elimination).

    `is_active` (cells,): whether a cell has an equation; `conductance` (cells, 4): conductances to the neighbours at
    the lower and the higher index along the first axis, then along the second, 0 without a resistor; `ground` (cells,):
    conductance to nodes of known voltage; `is_marked` (nodes,): whether a node of the tree must be eliminated again.
    Conductances have any common unit.
    """

    is_active: NDArray[np.bool_]
    conductance: NDArray[np.float64]
    ground: NDArray[np.float64]
    is_marked: NDArray[np.bool_]


class Fronts(NamedTuple):
    """Fronts of all nodes of a tree: dense matrices over a node's cells and the later cells connected to them.

    `pivots, rows` (nodes,): number of the node's cells with an equation, and of all rows; `cell` (rows of all fronts,):
    rank of the cell of every row, ascending within a front; `values` (entries,): lower triangles by columns.  In the
    columns of pivots these are the pivots and, below, the fractions of a current that elimination passes on to later
    cells; in later columns, the conductances between later cells after the elimination.  `ground` (rows of all
    fronts,): conductance of every row to the ground (nodes of known voltage), in rows of pivots divided by the pivot;
    `longest`: largest number of rows of a front.
    """

    pivots: NDArray[np.int64]
    rows: NDArray[np.int64]
    cell: NDArray[np.int32]
    values: NDArray[np.float64]
    ground: NDArray[np.float64]
    longest: int
