"""Levels of a hierarchy as arguments of kernels: red-black grids as rows of a table, and graphs below them.

Kernels with dozens of array arguments take most of their compile time for passing these on. A row of the table (`GRID`)
contains addresses of arrays instead, and a kernel opens the ones it needs. The owner of the table keeps the arrays
alive.

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
"""Minimum number of slots of a colour for a grid to be divided into slabs."""

_THICK = 4
"""Minimum thickness of a slab, in units of the lead of red over black cells, which neighbouring slabs compute twice."""

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
"""Record of one grid of a hierarchy, for the compiled cycle: counts, then addresses of arrays.

`slots, sides, margin, block`: of its stencil; `blocks`: number of blocks; `joined`: number of couplings; `below_slots`:
size of the next level's right-hand side.

`faces` to `aggregate`: arrays of `GridLevel`, `degree` is the black diagonal; `below_rhs, below_x`: the next level's
right-hand side and solution.

`red_rhs, black_rhs` (slots,): right-hand side; `red` (slots,): solution at red nodes. Arrays over black slots:
`before`: the relaxed residual, and finally the solution; slabs read values of other slabs here before these are
overwritten; `r`: the residual; `s`: a vector whose product with ``z`` is computed too, and the first product of a
K-cycle; `z`: the correction; `w`: its product with the matrix; `c`: the first direction of a K-cycle.

`red_double` (slots,): red values in double precision; single precision ones are stored in `w` before the product;
`parts`: number of slabs; `slabs` (parts, 5): fields of `Slab`; `sums` (3 blocks,): inner products or squares of every
block; `coefficients` (2,): of both directions of a K-cycle in its solution, or the first step length.
"""

Row = Any
"""A row of the table."""


class GridLevel(NamedTuple):
    """A grid of a hierarchy.

    `stencil`: in single precision, except for its black diagonal; `aggregate` (slots,): node of the next level to which
    a black slot belongs: its slot there, red ones first; if the next level is a graph, its number counted from 1; 0 for
    none.
    """

    stencil: Stencil
    aggregate: Indices


class Finest(NamedTuple):
    """The finest grid.

    `true`: stencil in double precision; `stencil`: in single precision, with a `grid_level.compensated` diagonal;
    `aggregate`: as in `GridLevel`.
    """

    true: Stencil
    stencil: Stencil
    aggregate: Indices


class Levels(NamedTuple):
    """The levels below a grid, or of a netlist: coarse grids, then graphs; the first graph of a netlist is its own."""

    grids: tuple[GridLevel, ...]
    graphs: Graphs


@inner
def multiply_faces(level: Row, colour: int, x: Reals, block: int, total: Reals) -> None:
    """Compute ``total = sum_j g_ij x_j`` across the faces of a block's cells of one colour."""
    faces = singles_by_side(level.faces, level.sides, level.slots)
    begin, count = extent(level, block)
    products(faces, integers(level.distance, level.sides), (colour, begin, count), x, total)


@inlined
def extent(level: Row, block: int) -> tuple[int, int]:
    """Return the first slot of a block, and its number of slots."""
    begin = level.margin + block * level.block
    return begin, min(level.block, level.slots - level.margin - begin)


@inner_fast
def take_step(r: Singles, v: Singles, step: np.float32, begin: int, count: int) -> tuple[float, float]:
    """Set ``r -= step v`` on some slots; returns the sums of squares before and after."""
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
    """Copy ``values[begin:begin + count]`` to the same slots of ``there``."""
    at = np.uint64(begin)
    for i in range(count):
        k = at + np.uint64(i)
        there[k] = values[k]


@inner_fast
def combine(z: Singles, c: Singles, on_c: np.float32, on_z: np.float32, begin: int, count: int, both: Singles) -> None:
    """Set ``both = on_c c + on_z z`` on some slots."""
    at = np.uint64(begin)
    for i in range(count):
        k = at + np.uint64(i)
        both[k] = on_c * c[k] + on_z * z[k]


class Slab(NamedTuple):
    """A part of a grid that one thread sweeps over.

    `first, last`: range of its blocks; `begin, end`: range of black slots whose nodes on the next level have no slot in
    another slab; `buffer`: address of a work array for sums over a block.
    """

    first: int
    last: int
    begin: int
    end: int
    buffer: int = 0


@inner
def slab_of(level: Row, part: int) -> Slab:
    """Return one of the slabs of a grid."""
    of, k = integers(level.slabs, 5 * level.parts), 5 * part
    return Slab(of[k], of[k + 1], of[k + 2], of[k + 3], of[k + 4])


@inner
def blocks_ahead(level: Row) -> int:
    """Return by how many blocks red cells are ahead, so that all neighbours of a black block are computed."""
    return int(-(-level.margin // level.block))


@inner
def first_coupling(level: Row, block: int) -> int:
    """Return the first coupling whose red slot lies in a block or after it."""
    off_red, coupling = indices(level.off_red, level.joined), ZERO
    while coupling < level.joined and off_red[coupling] < level.margin + block * level.block:
        coupling += 1
    return coupling


@inner
def multiply_red(level: Row, block: int, x: Singles, coupling: int, total: Reals) -> int:
    """Compute ``total = G x`` at the red cells of a block; returns the next coupling."""
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
    """Set ``value = inverse x`` on some slots, where ``x`` begins at ``first``; each value is written once."""
    at, x_at = np.uint64(begin), np.uint64(first)
    for i in range(count):
        k = np.uint64(i)
        value[at + k] = inverse[at + k] * x[x_at + k]


def slabs_of(stencil: Stencil, most: int) -> list[Slab]:
    """Divide a stencil into at most `most` slabs; small stencils are not divided.

    No slab is thinner than twice the part that its neighbours compute too. The slots that a slab restricts begin at an
    even index along the first axis, as the blocks of the next level do, so that no node of that level gets values from
    two slabs. Two steps along the first axis are one stride of slots.
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
    """Return the number of blocks."""
    return int(-(-(stencil.faces.shape[1] - 2 * stencil.margin) // stencil.block))
