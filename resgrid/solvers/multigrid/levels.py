"""Multigrid levels as arguments of kernels: grids as rows of a table of addresses, then graphs; kernels over blocks.

Kernels with dozens of array arguments take most of their compile time for passing these on. A row of the table (`GRID`)
contains addresses of arrays instead, and a kernel opens the arrays that it needs. The owner of the table keeps the
arrays alive. The slot of a cell is its index in an array (slots,) over the cells of its colour, which also has unused
slots, at least at both ends; red and black slots both count from 0.

In a sweep the red cells are ahead of the black ones by the distance of neighbours (wavefront sweep), so that faces are
read once.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from resgrid._internal.jit import ZERO, inlined, inner, inner_fast
from resgrid.solvers.llvm_intrinsics import indices, integers, singles, singles_by_side
from resgrid.solvers.multigrid.graph_sweeps import Graphs
from resgrid.solvers.multigrid.red_black import RED, Stencil, products
from resgrid.solvers.scaled import Indices, Reals, Singles

_LEAST = 60_000
"""Number of array entries per colour below which a grid is not divided into slabs (parts for the threads)."""

_THICK = 4
"""Smallest thickness of a slab, in multiples of the lead of red over black cells in a wavefront sweep.

Both slabs at a border compute the red cells of the lead.
"""

GRID = np.dtype([
    (name, np.int64)
    for name in (
        *("slots", "sides", "margin", "block", "blocks", "joined", "below_slots"),
        *("faces", "distance", "off_red", "off_black", "couplings", "red_inverse", "black_inverse", "degree"),
        *("aggregate", "below_rhs", "below_x"),
        *("red_rhs", "black_rhs", "red", "before", "r", "s", "z", "w", "c"),
        *("red_double", "parts", "slabs", "sums", "coefficients"),
    )
])  # fmt: skip
"""Data type of the record of one grid in the compiled cycle: numbers, and addresses of arrays.

The slot of a cell is its index in an array (slots,) over the cells of its colour, red or black; both count from 0.

`slots, sides, margin, block`: number of slots per colour, of faces per cell, of unused slots at either end, and of
slots per block; `blocks`: number of blocks; `joined`: number of couplings; `below_slots`: size of the next level's
right-hand side, over red and black nodes.

`faces` to `black_inverse`: arrays of `Stencil`; `degree` (slots,): black diagonal, in double precision; `aggregate`
(slots,): index in `below_rhs` of the node of the next level to which every black cell belongs (see `GridLevel`);
`below_rhs, below_x` (below_slots,): the next level's right-hand side and solution.

`red_rhs, black_rhs` (slots,): right-hand side; `red` (slots,): solution at red cells. Arrays over black slots:
`before`: relaxed residual, and finally the solution; slabs read values of other slabs here before these are
overwritten; `r`: residual; `s`: vector whose product with ``z`` is computed too, and the first product of a K-cycle;
`z`: correction; `w`: product of the matrix with ``z``, and before that the red values in single precision; `c`: first
direction of a K-cycle.

`red_double` (slots,): red values in double precision; `parts`: number of slabs; `slabs` (parts, 5): fields of `Slab`;
`sums` (3 blocks,): inner products or squares of every block; `coefficients` (2,): coefficients of both directions of a
K-cycle in the solution, or the first step length.
"""

Row = Any
"""A record of the table of grids: sizes, and addresses of the arrays of one grid (data type `GRID`)."""


class GridLevel(NamedTuple):
    """A grid of a hierarchy, and its restriction to the next level.

    `stencil`: conductances, in single precision except for the black diagonal; `aggregate` (slots,): node of the next
    level to which every black cell belongs, 0 for none. If the next level is a grid, an entry is the slot of a red node
    (never 0, an unused slot), or the number of coarse slots of a colour plus the slot of a black node. If it is a
    graph, an entry is the number of the node, counted from 1.
    """

    stencil: Stencil
    aggregate: Indices


class Finest(NamedTuple):
    """The finest grid of a hierarchy.

    `true`: conductances in double precision; `stencil`: conductances in single precision, with a black diagonal that
    compensates their rounding (`grid_level.compensated`); `aggregate` (slots,): node of the next level to which every
    black cell belongs, 0 for none: in a grid, the slot of a red node (never 0, an unused slot), or the number of slots
    of a colour plus the slot of a black node; in a graph, the number of the node, counted from 1.
    """

    true: Stencil
    stencil: Stencil
    aggregate: Indices


class Levels(NamedTuple):
    """The levels of a hierarchy below the finest grid, or all levels of a netlist.

    `grids`: coarse grids, finest first; empty for a netlist; `graphs`: graphs below the grids; for a netlist, the
    netlist is the first graph.
    """

    grids: tuple[GridLevel, ...]
    graphs: Graphs


@inner
def multiply_faces(level: Row, colour: int, x: Reals, block: int, total: Reals) -> None:
    """Set ``total`` to ``sum_j g_ij x_j`` over the neighbours ``j`` across faces of each cell ``i`` of a block.

    `level`: record of the grid; `colour`: colour of the cells ``i``, 0 for red and 1 for black; `x` (slots,): values at
    the cells of the other colour; `block`: number of the block of cells, from 0; `total` (block,): result.
    """
    faces = singles_by_side(level.faces, level.sides, level.slots)
    begin, count = extent(level, block)
    products(faces, integers(level.distance, level.sides), (colour, begin, count), x, total)


@inlined
def extent(level: Row, block: int) -> tuple[int, int]:
    """Return the index of the first cell of a block in arrays over one colour, and the number of cells of the block.

    `level`: record of the grid; `block`: number of the block, from 0.
    """
    begin = level.margin + block * level.block
    return begin, min(level.block, level.slots - level.margin - begin)


@inner_fast
def take_step(r: Singles, v: Singles, step: np.float32, begin: int, count: int) -> tuple[float, float]:
    """Set ``r -= step v`` on ``count`` entries from ``begin`` on; return ``|r|^2`` over them before and after.

    `r, v` (slots of a grid, or nodes of a graph): residual, and product of the matrix with the search direction;
    `step`: length of the step; `begin, count`: index of the first entry, and number of entries.
    """
    before, after, at = 0.0, 0.0, np.uint64(begin)
    for i in range(count):
        k = at + np.uint64(i)
        old = r[k]
        new = old - step * v[k]
        r[k] = new
        before += np.float64(old) * np.float64(old)
        after += np.float64(new) * np.float64(new)
    return before, after


@inner_fast
def copy(values: Singles, begin: int, count: int, there: Singles) -> None:
    """Copy ``values[begin:begin + count]`` to ``there[begin:begin + count]``."""
    at = np.uint64(begin)
    for i in range(count):
        k = at + np.uint64(i)
        there[k] = values[k]


@inner_fast
def combine(z: Singles, c: Singles, on_c: np.float32, on_z: np.float32, begin: int, count: int, both: Singles) -> None:
    """Set ``both = on_c c + on_z z``, a sum of two search directions, on ``count`` entries from ``begin`` on.

    `c, z, both` (n,): first direction, second direction, and result, over the black cells of a grid or the nodes of a
    graph.
    """
    at = np.uint64(begin)
    for i in range(count):
        k = at + np.uint64(i)
        both[k] = on_c * c[k] + on_z * z[k]


class Slab(NamedTuple):
    """A part of a grid that one thread sweeps over.

    A block is a range of ``level.block`` successive cells of one colour, the unit of work of a sweep.

    `first, last`: first block of cells, and block after the last; `begin, end`: range of indices, in arrays over the
    black cells, of the cells whose nodes on the next level belong to this slab alone; `buffer`: address of a work array
    (block,) for sums, 0 for none.
    """

    first: int
    last: int
    begin: int
    end: int
    buffer: int = 0


@inner
def slab_of(level: Row, part: int) -> Slab:
    """Return slab number ``part`` (from 0) of a grid; `level`: record of the grid."""
    of, k = integers(level.slabs, 5 * level.parts), 5 * part
    return Slab(of[k], of[k + 1], of[k + 2], of[k + 3], of[k + 4])


@inner
def blocks_ahead(level: Row) -> int:
    """Return the number of blocks by which red cells are computed ahead of black ones, in a sweep over a grid.

    All red neighbours of a black block are then known. `level`: record of the grid.
    """
    return int(-(-level.margin // level.block))


@inner
def first_coupling(level: Row, block: int) -> int:
    """Return the index of the first coupling whose red cell lies in block number ``block`` or in a later block.

    `level`: record of the grid. If there is no such coupling, the result is the number of couplings. Couplings are
    edges that cross no face of the grid, sorted by red cell.
    """
    off_red, coupling = indices(level.off_red, level.joined), ZERO
    while coupling < level.joined and off_red[coupling] < level.margin + block * level.block:
        coupling += 1
    return coupling


@inner
def multiply_red(level: Row, block: int, x: Singles, coupling: int, total: Reals) -> int:
    """Set ``total = G x`` at the red cells of a block, from all edges; return the index of the next coupling.

    ``G`` contains the conductances from black to red cells. Couplings are edges that cross no face of the grid.
    `level`: record of the grid; `block`: number of the block, from 0; `x` (slots,): values at the slots of black cells,
    0 at unused slots; `coupling`: index of the first coupling of the block; `total` (block,): result.
    """
    multiply_faces(level, RED, x, block, total)
    begin, count = extent(level, block)
    off_red, off_black = indices(level.off_red, level.joined), indices(level.off_black, level.joined)
    g = singles(level.couplings, level.joined)
    while coupling < level.joined and off_red[coupling] < begin + count:
        total[off_red[coupling] - begin] += total.dtype.type(g[coupling]) * x[off_black[coupling]]
        coupling += 1
    return coupling


@inner_fast
def scale(inverse: Singles, x: Reals, first: int, begin: int, count: int, value: Reals) -> None:
    """Set ``value[k] = inverse[k] x[first + k - begin]`` for the ``count`` indices ``k`` from ``begin`` on.

    `inverse, value` (slots,): reciprocal diagonal and result over the cells of a colour; `x`: currents, whose entry
    ``first`` belongs to the cell ``begin``.
    """
    at, x_at = np.uint64(begin), np.uint64(first)
    for i in range(count):
        k = np.uint64(i)
        value[at + k] = inverse[at + k] * x[x_at + k]


def slabs_of(stencil: Stencil, most: int) -> list[Slab]:
    """Return the slabs of a grid, at most `most`; a grid with less than 60,000 array entries per colour is one slab.

    No slab is thinner than `_THICK` times the lead of red over black cells. The cells that a slab restricts to the next
    level begin at an even index along the first axis, as the blocks of the next level do. Therefore no node of that
    level gets values from two slabs.
    """
    margin, blocks, slots = stencil.margin, blocks_of(stencil), stencil.faces.shape[1]
    count = min(most, int(blocks // (_THICK * -(-margin // stencil.block)))) if slots >= _LEAST else 1
    if count < 2:
        return [Slab(0, blocks, int(margin), int(slots - margin))]
    stride, end = int(stencil.distance[1] - stencil.distance[0]), stencil.first_extra

    def from_even_row(block: int) -> int:
        return min(int(margin) - (-(block * stencil.block) // stride) * stride, end)

    borders = [blocks * k // count for k in range(count + 1)]
    begins = [from_even_row(block) for block in borders[:-1]] + [end]
    return [Slab(*borders[k : k + 2], *begins[k : k + 2]) for k in range(count)]


def blocks_of(stencil: Stencil) -> int:
    """Return the number of blocks of cells of one colour into which a grid is divided."""
    return int(-(-(stencil.faces.shape[1] - 2 * stencil.margin) // stencil.block))
