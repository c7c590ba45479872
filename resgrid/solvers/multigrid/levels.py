"""What a cycle runs over: grids, each a row of a table with the addresses of its arrays, and graphs below them.

Compiled functions that hand on dozens of arrays take most of their time to compile for that; one that is given a row
of the table (`GRID`) opens what it reads.  Who made the table keeps the arrays.
"""

from __future__ import annotations

from typing import Any, NamedTuple, cast

import numpy as np

from resgrid.jit import inlined, inner, inner_fast
from resgrid.solvers.machine import integers, singles_by_side
from resgrid.solvers.multigrid.graph_sweeps import Graphs
from resgrid.solvers.multigrid.red_black import Floats, Indices, Reals, Singles, Stencil, products

CHUNK = 2048
"""Slots over which sums are taken before they are added to others: the same whoever takes them."""

SINGLE, DOUBLE = (cast(int, np.int64(kind.itemsize)) for kind in (np.dtype(np.float32), np.dtype(np.float64)))
"""Bytes of a number; no literals, as `resgrid.jit.ZERO`."""

GRID = np.dtype([
    (name, np.int64)
    for name in (
        *("slots", "sides", "margin", "block", "blocks", "joined", "weighted", "below_slots", "window"),
        *("faces", "distance", "off_red", "off_black", "couplings", "red_inverse", "black_inverse", "degree"),
        *("aggregate", "weight", "below_fed", "below"),
        *("red_fed", "black_fed", "red", "before", "r", "s", "z", "w", "c"),
        *("parts", "slabs", "own", "noted", "sums", "shares"),
    )
])  # fmt: skip
"""A grid of a hierarchy, for the compiled cycle: counts, then addresses of arrays.

`slots, sides, margin, block`: of its stencil; `blocks`: how many; `joined`: couplings; `weighted`: whether what its
nodes take from the next level has weights; `below_slots`: of the next level's right-hand side; `window`: red values in
a window (`resgrid.solvers.multigrid.windows`).

From `faces` to `weight`: as of `GridLevel`, in single precision, but for `degree`; `below_fed, below`: the next level's
right-hand side and answer.

`red_fed, black_fed` (slots,): right-hand side; `red` (slots,): answer at red nodes.  Over black slots: `before`: the
residual, relaxed from zero, for slabs read what others had before they write, and in the end the answer; `r`: the
residual; `s`: what ``z`` is multiplied by too, and the first product; `z`: the answer; `w`: its product; `c`: the first
direction.

`parts`: slabs; `slabs` (parts, 5): as of `Slab`; `own` (parts, slots): their answers; `noted` (joined,): red values
where couplings begin; `sums` (3 blocks,): of products, or of squares, of every block or chunk of slots; `shares` (2,):
what both directions of a K-cycle have in its answer, or the first step's length.
"""

Row = Any
"""A row of such a table."""


class Way(NamedTuple):
    """From the black slots of a grid to the next level.

    `aggregate` (slots,): node of the next level that a slot belongs to: its slot there, red ones first; of a graph,
    counted from 1; 0 for none; `weight` (slots,): what it takes from there; empty where that is all
    (`resgrid.solvers.multigrid.h_transform`).
    """

    aggregate: Indices
    weight: Singles


class GridLevel(NamedTuple):
    """A grid of a hierarchy.

    `stencil`: in single precision; `degree` (slots,): its black diagonal; `way`: to the next level.
    """

    stencil: Stencil
    degree: Floats
    way: Way


class Finest(NamedTuple):
    """The finest grid: in double precision too, and with a black diagonal that makes up for single precision.

    `true`: in double precision; `stencil, degree, way`: as of `GridLevel`, the diagonal `grid_level.compensated`.
    """

    true: Stencil
    stencil: Stencil
    degree: Floats
    way: Way


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


@inner
def second_step(alpha: float, energy: float, rest: float, product: float, gamma: float) -> tuple[float, float]:
    """Shares of both directions in the answer."""
    second = product - gamma * gamma / energy
    step = rest / second if second > 0.0 else 0.0
    return (alpha - gamma * step) / energy, step


@inner_fast
def combine(z: Singles, c: Singles, on_c: np.float32, on_z: np.float32, begin: int, end: int, both: Singles) -> None:
    """``both = on_c c + on_z z`` on some slots."""
    at = np.uint64(begin)
    for i in range(end - begin):
        k = at + np.uint64(i)
        both[k] = on_c * c[k] + on_z * z[k]
