"""What a cycle runs over: grids, each a row of a table with the addresses of its arrays, and graphs below them.

Compiled functions that hand on dozens of arrays take most of their time to compile for that; one that is given a row
of the table (`GRID`) opens what it reads.  Who made the table keeps the arrays.

In a sweep the red cells go ahead of the black ones by as many slots as there are between neighbours, so that faces are
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
"""Slots of a colour from which a grid is cut."""

_THICK = 4
"""Blocks of a slab, at least, in units of those that red cells go ahead of black ones: a neighbour finds these too."""

GRID = np.dtype([
    (name, np.int64)
    for name in (
        *("slots", "sides", "margin", "block", "blocks", "joined", "below_slots"),
        *("faces", "distance", "off_red", "off_black", "couplings", "red_inverse", "black_inverse", "degree"),
        *("aggregate", "below_fed", "below"),
        *("red_fed", "black_fed", "red", "before", "r", "s", "z", "w", "c"),
        *("led", "parts", "slabs", "sums", "shares"),
    )
])  # fmt: skip
"""A grid of a hierarchy, for the compiled cycle: counts, then addresses of arrays.

`slots, sides, margin, block`: of its stencil; `blocks`: how many; `joined`: couplings; `below_slots`: of the next
level's right-hand side.

From `faces` to `aggregate`: as of `GridLevel`, `degree` the black diagonal; `below_fed, below`: the next
level's right-hand side and answer.

`red_fed, black_fed` (slots,): right-hand side; `red` (slots,): answer at red nodes.  Over black slots: `before`: the
residual, relaxed from zero, for slabs read what others had before they write, and in the end the answer; `r`: the
residual; `s`: what ``z`` is multiplied by too, and the first product; `z`: the answer; `w`: its product; `c`: the first
direction.

`led` (slots,): red values that follow the answer, in double precision; other ones are kept where the product will be;
`parts`: slabs; `slabs` (parts, 5): as of `Slab`; `sums` (3 blocks,): of products, or of squares, of every block;
`shares` (2,): what both directions of a K-cycle have in its answer, or the first step's length.
"""

Row = Any
"""A row of such a table."""


class GridLevel(NamedTuple):
    """A grid of a hierarchy.

    `stencil`: in single precision, but for its black diagonal; `aggregate` (slots,): node of the next level that a
    black slot belongs to: its slot there, red ones first; of a graph, counted from 1; 0 for none.
    """

    stencil: Stencil
    aggregate: Indices


class Finest(NamedTuple):
    """The finest grid: as `GridLevel`, its diagonal `grid_level.compensated`; and `true`, in double precision."""

    true: Stencil
    stencil: Stencil
    aggregate: Indices


class Levels(NamedTuple):
    """The levels below a grid, or of a netlist: coarse grids, and graphs below; of a netlist, the first is its own."""

    grids: tuple[GridLevel, ...]
    graphs: Graphs


@inner
def draw_into(level: Row, colour: int, x: Reals, block: int, total: Reals) -> None:
    """``total = sum_j g_ij x_j`` across the faces of a block's cells of one colour."""
    faces = singles_by_side(level.faces, level.sides, level.slots)
    begin, count = extent(level, block)
    products(faces, integers(level.distance, level.sides), (colour, begin, count), x, total)


@inlined
def extent(level: Row, block: int) -> tuple[int, int]:
    """First slot of a block, and how many it has."""
    begin = level.margin + block * level.block
    return begin, min(level.block, level.slots - level.margin - begin)


@inner_fast
def take_step(r: Singles, v: Singles, step: np.float32, begin: int, count: int) -> tuple[float, float]:
    """``r -= step v`` on some slots; returns the squares before and after, summed."""
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
    """Copy some slots."""
    at = np.uint64(begin)
    for i in range(count):
        k = at + np.uint64(i)
        there[k] = values[k]


@inner_fast
def combine(z: Singles, c: Singles, on_c: np.float32, on_z: np.float32, begin: int, count: int, both: Singles) -> None:
    """``both = on_c c + on_z z`` on some slots."""
    at = np.uint64(begin)
    for i in range(count):
        k = at + np.uint64(i)
        both[k] = on_c * c[k] + on_z * z[k]


class Slab(NamedTuple):
    """A part of a grid that one thread sweeps over.

    `first, last`: its blocks, the last one left out; `begin, end`: black slots that share their nodes on the next level
    with no other slab's; `room`: where it sums over a block, an address.
    """

    first: int
    last: int
    begin: int
    end: int
    room: int = 0


@inner
def slab_of(level: Row, part: int) -> Slab:
    """One of the slabs of a grid."""
    of, k = integers(level.slabs, 5 * level.parts), 5 * part
    return Slab(of[k], of[k + 1], of[k + 2], of[k + 3], of[k + 4])


@inner
def blocks_ahead(level: Row) -> int:
    """How many blocks red cells go ahead of black ones, so that all neighbours of these are there."""
    return int(-(-level.margin // level.block))


@inner
def first_coupling(level: Row, block: int) -> int:
    """The first coupling that begins in a block or behind it."""
    off_red, coupling = indices(level.off_red, level.joined), ZERO
    while coupling < level.joined and off_red[coupling] < level.margin + block * level.block:
        coupling += 1
    return coupling


@inner
def draw_red(level: Row, block: int, x: Singles, coupling: int, total: Reals) -> int:
    """``total = G x`` at the red cells of a block; returns the next coupling."""
    draw_into(level, RED, x, block, total)
    begin, count = extent(level, block)
    off_red, off_black = indices(level.off_red, level.joined), indices(level.off_black, level.joined)
    g = singles(level.couplings, level.joined)
    while coupling < level.joined and off_red[coupling] < begin + count:
        total[off_red[coupling] - begin] += total.dtype.type(g[coupling]) * x[off_black[coupling]]
        coupling += 1
    return coupling


@inner_fast
def scale(inverse: Singles, x: Reals, first: int, begin: int, count: int, value: Reals) -> None:
    """``value = inverse x`` on some slots, of which ``x`` begins at ``first``; each is written once."""
    at, x_at = np.uint64(begin), np.uint64(first)
    for i in range(count):
        k = np.uint64(i)
        value[at + k] = inverse[at + k] * x[x_at + k]


def slabs_of(stencil: Stencil, most: int) -> list[Slab]:
    """Cut a stencil into so many slabs, or fewer; small ones are not cut.

    No slab is thinner than what its neighbours find of it too, twice.  Nodes of the next level are parts of blocks that
    begin at even indices along the first axis; two rows along it take a stride of slots.
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
    """How many blocks there are."""
    return int(-(-(stencil.faces.shape[1] - 2 * stencil.margin) // stencil.block))
