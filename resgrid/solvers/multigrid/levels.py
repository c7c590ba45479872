"""What a cycle runs over: grids, each a row of a table with the addresses of its arrays, and graphs below them.

Compiled functions that hand on dozens of arrays take most of their time to compile for that; one that is given a row
of the table (`GRID`) opens what it reads.  Who made the table keeps the arrays.

In a sweep the red cells go ahead of the black ones by as many slots as there are between neighbours, so that faces are
read once; red values are only kept in a window around the slots that it has come to.
"""

from __future__ import annotations

from typing import Any, NamedTuple, cast

import numpy as np

from resgrid.jit import ZERO, inlined, inner, inner_fast
from resgrid.solvers.machine import doubles, indices, integers, singles, singles_by_side
from resgrid.solvers.multigrid.graph_sweeps import Graphs
from resgrid.solvers.multigrid.red_black import RED, Floats, Indices, Integers, Reals, Singles, Stencil, products

CHUNK = 2048
"""Slots over which sums are taken before they are added to others: the same whoever takes them."""

_ROOM = 4
"""Of a window, in units of what is kept and a block; so seldom it is moved."""

_LEAST = 60_000
"""Slots of a colour from which a grid is cut."""

_THICK = 4
"""Blocks of a slab, at least, in units of those that red cells go ahead of black ones: a neighbour finds these too."""

DOUBLE = cast(int, np.int64(np.dtype(np.float64).itemsize))
"""Bytes of a number; no literal, as `resgrid.jit.ZERO`."""

GRID = np.dtype([
    (name, np.int64)
    for name in (
        *("slots", "sides", "margin", "block", "blocks", "joined", "below_slots", "window"),
        *("faces", "distance", "off_red", "off_black", "couplings", "red_inverse", "black_inverse", "degree"),
        *("aggregate", "below_fed", "below"),
        *("red_fed", "black_fed", "red", "before", "r", "s", "z", "w", "c"),
        *("parts", "slabs", "noted", "sums", "shares"),
    )
])  # fmt: skip
"""A grid of a hierarchy, for the compiled cycle: counts, then addresses of arrays.

`slots, sides, margin, block`: of its stencil; `blocks`: how many; `joined`: couplings; `below_slots`: of the next
level's right-hand side; `window`: red values in a window (`Window`).

From `faces` to `aggregate`: as of `GridLevel`, in single precision, but for `degree`; `below_fed, below`: the next
level's right-hand side and answer.

`red_fed, black_fed` (slots,): right-hand side; `red` (slots,): answer at red nodes.  Over black slots: `before`: the
residual, relaxed from zero, for slabs read what others had before they write, and in the end the answer; `r`: the
residual; `s`: what ``z`` is multiplied by too, and the first product; `z`: the answer; `w`: its product; `c`: the first
direction.

`parts`: slabs; `slabs` (parts, 5): as of `Slab`; `noted` (joined,): red values where couplings begin; `sums` (3
blocks,): of products, or of squares, of every block or chunk of slots; `shares` (2,): what both directions of a K-cycle
have in its answer, or the first step's length.
"""

Row = Any
"""A row of such a table."""


class GridLevel(NamedTuple):
    """A grid of a hierarchy.

    `stencil`: in single precision; `degree` (slots,): its black diagonal; `aggregate` (slots,): node of the next level
    that a black slot belongs to: its slot there, red ones first; of a graph, counted from 1; 0 for none.
    """

    stencil: Stencil
    degree: Floats
    aggregate: Indices


class Finest(NamedTuple):
    """The finest grid: in double precision too, and with a black diagonal that makes up for single precision.

    `true`: in double precision; `stencil, degree, aggregate`: as of `GridLevel`, the diagonal
    `grid_level.compensated`.
    """

    true: Stencil
    stencil: Stencil
    degree: Floats
    aggregate: Indices


class Levels(NamedTuple):
    """The levels below a grid, or of a netlist: coarse grids, and graphs below; of a netlist, the first is its own."""

    grids: tuple[GridLevel, ...]
    graphs: Graphs


@inlined
def chunks_of(level: Row) -> int:
    """How many chunks of slots a grid has."""
    return int(-(-level.slots // CHUNK))


@inner
def draw_into(level: Row, colour: int, x: Reals, first: int, block: int, total: Reals, to: int) -> None:
    """``total = sum_j g_ij x_j`` across the faces of a block's cells of one colour, from slot ``to`` on.

    ``x`` begins at slot ``first``.
    """
    faces = singles_by_side(level.faces, level.sides, level.slots)
    begin, count = extent(level, block)
    products(faces, integers(level.distance, level.sides), (colour, begin, count), x, begin - first, total, to)


@inlined
def extent(level: Row, block: int) -> tuple[int, int]:
    """First slot of a block, and how many it has."""
    begin = level.margin + block * level.block
    return begin, min(level.block, level.slots - level.margin - begin)


@inner_fast
def take_step(r: Singles, v: Singles, step: np.float32, begin: int, end: int) -> tuple[float, float]:
    """``r -= step v`` on some slots; returns the squares before and after, summed."""
    before, after, at = 0.0, 0.0, np.uint64(begin)
    for i in range(end - begin):
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
def combine(z: Singles, c: Singles, on_c: np.float32, on_z: np.float32, begin: int, end: int, both: Singles) -> None:
    """``both = on_c c + on_z z`` on some slots."""
    at = np.uint64(begin)
    for i in range(end - begin):
        k = at + np.uint64(i)
        both[k] = on_c * c[k] + on_z * z[k]


class Window(NamedTuple):
    """The red values around the slots that a window has come to.

    `red`: the values; `drawn` (couplings,): what couplings draw into red cells; `total` (block,): for sums; `at` (2,):
    slot of the first of the red values, and the next coupling; `kept`: how many values behind a block may still be
    asked for.
    """

    red: Reals
    drawn: Reals
    total: Reals
    at: Integers
    kept: int


class Slab(NamedTuple):
    """A part of a grid that one thread sweeps over.

    `first, last`: its blocks, the last one left out; `begin, end`: black slots that share their nodes on the next level
    with no other slab's; `room`: where it keeps its window, an address.
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


def values_in_window(stencil: Stencil) -> int:
    """How many red values a window holds."""
    return int(_ROOM * ((-(-stencil.margin // stencil.block) + 1) * stencil.block + stencil.margin))


@inlined
def open_window(level: Row, slab: Slab, block: int) -> Window:
    """A window of single precision that comes to a block first; what couplings draw is left open."""
    red, drawn, total = _rooms(level, slab)
    return _opened(
        level, slab, block, singles(red, level.window), singles(drawn, level.joined), singles(total, level.block)
    )


@inlined
def open_double(level: Row, slab: Slab, block: int) -> Window:
    """The same of double precision."""
    red, drawn, total = _rooms(level, slab)
    return _opened(
        level, slab, block, doubles(red, level.window), doubles(drawn, level.joined), doubles(total, level.block)
    )


@inlined
def _rooms(level: Row, slab: Slab) -> tuple[int, int, int]:
    """Where a slab's window keeps its arrays, behind ``at``."""
    drawn = slab.room + (2 + level.window) * DOUBLE
    return slab.room + 2 * DOUBLE, drawn, drawn + level.joined * DOUBLE


@inner
def _opened(level: Row, slab: Slab, block: int, red: Reals, drawn: Reals, total: Reals) -> Window:
    begin, off_red = level.margin + block * level.block, indices(level.off_red, level.joined)
    at, kept = integers(slab.room, 2), blocks_ahead(level) * level.block + level.margin
    at[0], at[1] = begin - kept, 0
    while at[1] < level.joined and off_red[at[1]] < begin:
        at[1] += 1
    for k in range(len(red)):
        red[k] = 0.0
    return Window(red, drawn, total, at, kept)


@inner
def draw(level: Row, x: Singles, drawn: Reals) -> None:
    """What every coupling draws into its red cell."""
    couplings, off_black = singles(level.couplings, level.joined), indices(level.off_black, level.joined)
    for k in range(level.joined):
        drawn[k] = drawn.dtype.type(couplings[k]) * x[off_black[k]]


@inner
def make_room(level: Row, window: Window, block: int) -> int:
    """Make room for a block of red values; returns where among them it begins."""
    begin = level.margin + block * level.block
    if begin + level.block - window.at[0] > len(window.red):
        behind = begin - window.kept - window.at[0]
        for k in range(window.kept):
            window.red[k] = window.red[behind + k]
        window.at[0] = begin - window.kept
    return int(begin - window.at[0])


@inner
def lead(level: Row, window: Window, slab: Slab, x: Singles, block: int, given: bool) -> None:
    """``red = G x / degree`` on a block, or of what is ``given`` at its red cells; zero behind the last one.

    A slab notes its own where couplings begin.
    """
    to = make_room(level, window, block)
    if block >= level.blocks:
        for k in range(to, to + level.block):
            window.red[k] = 0.0
        return
    begin, count = extent(level, block)
    if given:
        for k in range(count):
            window.red[to + k] = x[begin + k]
    else:
        draw_into(level, RED, x, ZERO, block, window.red, to)
    off_red, noted, first = indices(level.off_red, level.joined), doubles(level.noted, level.joined), window.at[1]
    while window.at[1] < level.joined and off_red[window.at[1]] < begin + count:
        if not given:
            window.red[to + off_red[window.at[1]] - begin] += window.drawn[window.at[1]]
        window.at[1] += 1
    _scale(singles(level.red_inverse, level.slots), begin, count, window.red, to)
    if slab.first <= block < slab.last:
        for m in range(first, window.at[1]):
            noted[m] = window.red[to + off_red[m] - begin]


@inner_fast
def _scale(inverse: Reals, begin: int, count: int, value: Reals, to: int) -> None:
    """``value = inverse * value``, the value from slot ``to`` on."""
    at, v_at = np.uint64(begin), np.uint64(to)
    for i in range(count):
        k = np.uint64(i)
        value[v_at + k] *= inverse[at + k]


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
