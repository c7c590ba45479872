"""What a cycle runs over: the levels laid one behind the other, and loops over the vectors of one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from resgrid.jit import inner, inner_fast
from resgrid.solvers.multigrid.graph_sweeps import Graphs
from resgrid.solvers.multigrid.red_black import Floats, Indices, Integers, Singles, Stencil

CHUNK = 2048
"""Slots over which sums are taken before they are added to others: the same whoever takes them."""


class Grids(NamedTuple):
    """Coarse red-black grids in single precision, one behind the other.

    Places of level ``l`` stand at ``slots[l] ... slots[l + 1]``, its couplings and faces at the corresponding stretches
    of their arrays (`Stencil`).

    `slots, first_off` (levels + 1,); `margin, block` (levels,); `distance` (levels, 2 ndim); `aggregate`: node of
    the next level that a black slot belongs to: its slot there, red ones first; of a graph, counted from 1; 0 for
    none; `weight`: what it takes from there; empty where that is all (`resgrid.solvers.multigrid.h_transform`).
    """

    slots: Integers
    first_off: Integers
    margin: Integers
    block: Integers
    distance: Integers
    faces: Singles
    couplings: Singles
    off_red: Indices
    off_black: Indices
    red_inverse: Singles
    black_inverse: Singles
    black_degree: Singles
    aggregate: Indices
    weight: Singles


class Work(NamedTuple):
    """Work space of one solve.

    `b, x`: currents and voltages: of both colours of all grids, of nothing at one slot, of all graphs' nodes; `f,
    z`: right-hand side and answer of the grids' black slots; `c, v, w`: first direction and products, of the grids'
    black slots, then of the graphs' nodes.
    """

    b: Singles
    x: Singles
    f: Singles
    z: Singles
    c: Singles
    v: Singles
    w: Singles


class Way(NamedTuple):
    """From the black slots of a grid to the next level, as of `Grids`: `aggregate`, `weight` (slots,)."""

    aggregate: Indices
    weight: Singles


class BlackVectors(NamedTuple):
    """The vectors over a grid's black slots in a visit, shape (slots,).

    `before`: the residual, relaxed from zero: slabs read what others had before they write; `r`: the residual; `s`:
    what ``z`` is multiplied by too; `z`: the answer, and `w` its product; `c`: the first direction.
    """

    before: Singles
    r: Singles
    s: Singles
    z: Singles
    w: Singles
    c: Singles


class Levels(NamedTuple):
    """A packed hierarchy, coarse grids first, graphs below; a netlist's first graph is its finest level."""

    grids: Grids
    graphs: Graphs
    work: Work


class Finest(NamedTuple):
    """The finest level: of a grid with the way to the next one; of a netlist, what its first graph leaves open.

    `stencil`: in single precision; `degree` (slots,): its black diagonal, which makes up for that
    (`grid_level.compensated`); `way`: to the next level; `ground` (n,): from every node of a netlist's first graph to
    known voltages, in units; empty for a grid, as all others are for a netlist.
    """

    stencil: Stencil
    degree: Floats
    way: Way
    ground: Floats


@inner
def stencil_at(grids: Grids, level: int) -> Stencil:
    """One of the grids."""
    sides = grids.distance.shape[1]
    a, e = grids.slots[level], grids.slots[level + 1]
    k, m = grids.first_off[level], grids.first_off[level + 1]
    return Stencil(
        grids.faces[sides * a : sides * e].reshape((sides, e - a)),
        grids.distance[level],
        grids.margin[level],
        grids.block[level],
        grids.off_red[k:m],
        grids.off_black[k:m],
        grids.couplings[k:m],
        grids.red_inverse[a:e],
        grids.black_inverse[a:e],
        grids.black_degree[a:e],
    )


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
def keep_step(z: Singles, c: Singles, step: np.float32, enough: bool, begin: int, end: int) -> None:
    """Where the first step is enough, ``z = step z``, the answer; else ``c = z``, its direction; on some slots."""
    at = np.uint64(begin)
    for i in range(end - begin):
        k = at + np.uint64(i)
        if enough:
            z[k] = step * z[k]
        else:
            c[k] = z[k]


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
