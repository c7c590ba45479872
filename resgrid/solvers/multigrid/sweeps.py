"""Sweeps over a grid, slab by slab, in which red cells go ahead of black ones, so that faces are read once.

Slabs are whole blocks; red values that two slabs need are found by both, the same ones, and written at once; no slab
reads what else another one writes; sums are kept block by block, and added in one order behind all slabs; what
couplings carry from anywhere to anywhere is added behind them.  So the digits are the same however a level is cut.
"""

from __future__ import annotations

from typing import cast

import numpy as np

from resgrid._internal.jit import ZERO, inner, inner_fast
from resgrid.solvers.llvm_intrinsics import doubles, indices, singles
from resgrid.solvers.multigrid.levels import (
    Row,
    Slab,
    blocks_ahead,
    combine,
    copy,
    draw_into,
    draw_red,
    extent,
    first_coupling,
    scale,
    take_step,
)
from resgrid.solvers.multigrid.red_black import BLACK, relax
from resgrid.solvers.scaled import Indices, Reals, Singles

CLEAR, ELIMINATE, RESTRICT, RELAX, RAISE, COMBINE, PUT_BACK, TAKE, MULTIPLY = (cast(int, np.int64(k)) for k in range(9))
"""The sweeps; no literals, as `resgrid._internal.jit.ZERO`.

Black cells are fed by red ones in three: `ELIMINATE` tells what they are due, red ones eliminated, in ``r``, and
relaxes that from zero into ``before``; `RESTRICT` sums the residual of ``before`` into the next level; `RELAX` relaxes
``before`` into ``z``.  `MULTIPLY` forms ``S z``, where S is the Schur complement of the black cells, whose diagonal is
``degree``; `PUT_BACK` lets the red cells follow ``before``.

Cell by cell: `RAISE` adds the next level's answer to ``before``; `TAKE` takes the first step of the K-cycle along
``z``, keeps its direction in ``c``, and relaxes the rest from zero; `COMBINE` makes ``before`` of the ``shares`` of
both directions; `CLEAR` does nothing but what `ELIMINATE` and `TAKE` do too: the next level has no currents.
"""


@inner
def feed_black(level: Row, kind: int, slab: Slab) -> None:
    """`ELIMINATE`, `RESTRICT` or `RELAX` on a slab, but for couplings."""
    slots, ahead = level.slots, blocks_ahead(level)
    before, r, z = singles(level.before, slots), singles(level.r, slots), singles(level.z, slots)
    inverse, fed = singles(level.black_inverse, slots), singles(level.black_fed, slots)
    red_inverse, red_fed = singles(level.red_inverse, slots), singles(level.red_fed, slots)
    aggregate, coarse = indices(level.aggregate, slots), singles(level.below_fed, level.below_slots)
    red, total, begin, last = singles(level.w, slots), singles(slab.room, level.block), slab.first - ahead, slab.last
    if kind == RESTRICT:
        last = -(-(slab.end - level.margin) // level.block)
    coupling = first_coupling(level, max(begin, 0))
    for step in range(max(begin, 0), max(last, slab.last) + ahead):
        if step < level.blocks:
            at, count = extent(level, step)
            if kind == ELIMINATE:
                scale(red_inverse, red_fed, at, at, count, red)
            else:
                coupling = draw_red(level, step, before, coupling, total)
                scale(red_inverse, total, ZERO, at, count, red)
        block = step - ahead
        if not slab.first <= block < last:
            continue
        at, count = extent(level, block)
        draw_into(level, BLACK, red, block, total)
        if kind == ELIMINATE:
            _feed(inverse, fed, total, at, count, r, before)
        elif kind == RELAX:
            relax(inverse, r, at, count, total, z)
        elif slab.begin < at + count:
            behind = max(slab.begin - at, 0)
            _add_to_nodes(aggregate, at + behind, min(count, slab.end - at) - behind, total, behind, coarse)


@inner_fast
def _feed(inverse: Singles, fed: Singles, total: Singles, begin: int, count: int, r: Singles, before: Singles) -> None:
    """``r = total + fed``, and ``before = inverse r`` on a block."""
    at = np.uint64(begin)
    for i in range(count):
        k = at + np.uint64(i)
        v = total[np.uint64(i)] + fed[k]
        r[k] = v
        before[k] = inverse[k] * v


@inner
def _add_to_nodes(aggregate: Indices, begin: int, count: int, total: Singles, behind: int, coarse: Singles) -> None:
    at, t_at = np.uint64(begin), np.uint64(behind)
    for i in range(count):
        k = np.uint64(i)
        coarse[np.uint32(aggregate[at + k])] += total[t_at + k]


@inner
def multiply(level: Row, slab: Slab, product: Singles) -> None:
    """`MULTIPLY` on a slab, but for couplings; ``sums`` receives ``z.r``, ``z.w`` and ``z.s``, ``w`` the product."""
    slots, ahead, inverse = level.slots, blocks_ahead(level), singles(level.red_inverse, level.slots)
    r, s, z = singles(level.r, slots), singles(level.s, slots), singles(level.z, slots)
    degree, red, total = doubles(level.degree, slots), doubles(level.led, slots), doubles(slab.room, level.block)
    sums, begin = doubles(level.sums, 3 * level.blocks), max(slab.first - ahead, 0)
    coupling = first_coupling(level, begin)
    for step in range(begin, slab.last + ahead):
        if step < level.blocks:
            at, count = extent(level, step)
            coupling = draw_red(level, step, z, coupling, total)
            scale(inverse, total, ZERO, at, count, red)
        block = step - ahead
        if slab.first <= block:
            at, count = extent(level, block)
            draw_into(level, BLACK, red, block, total)
            k, sum_of = 3 * block, _multiply(degree, z, r, s, at, count, total, product)
            sums[k], sums[k + 1], sums[k + 2] = sum_of


@inner_fast
def _multiply(
    degree: Reals, z: Singles, r: Singles, s: Singles, begin: int, count: int, total: Reals, w: Singles
) -> tuple[float, float, float]:
    """``w = degree z - total`` on a block, and its share of ``z.r``, ``z.w`` and ``z.s``."""
    a, b, c = 0.0, 0.0, 0.0
    at = np.uint64(begin)
    for i in range(count):
        k = at + np.uint64(i)
        one = np.float64(z[k])
        v = degree[k] * one - total[np.uint64(i)]
        w[k] = v
        a += one * r[k]
        b += one * v
        c += one * s[k]
    return a, b, c


@inner
def follow_couplings(level: Row, kind: int, product: Singles) -> float:
    """What couplings carry in a sweep that feeds black cells, behind all slabs; by how much ``z.w`` becomes less."""
    slots, joined, less = level.slots, level.joined, 0.0
    off_red, off_black = indices(level.off_red, joined), indices(level.off_black, joined)
    g, red, exact = singles(level.couplings, joined), singles(level.w, slots), doubles(level.led, slots)
    before, r, z = singles(level.before, slots), singles(level.r, slots), singles(level.z, slots)
    inverse, aggregate = singles(level.black_inverse, slots), indices(level.aggregate, slots)
    coarse = singles(level.below_fed, level.below_slots)
    for m in range(joined):
        black, drawn = off_black[m], g[m] * red[off_red[m]]
        if kind == ELIMINATE:
            r[black] += drawn
            before[black] = inverse[black] * r[black]
        elif kind == RESTRICT:
            coarse[aggregate[black]] += drawn
        elif kind == RELAX:
            z[black] += inverse[black] * drawn
        else:
            product[black] -= g[m] * exact[off_red[m]]
            less += z[black] * g[m] * exact[off_red[m]]
    coarse[0] = 0.0
    return less


@inner
def put_back(level: Row, slab: Slab) -> None:
    """`PUT_BACK` on a slab."""
    slots, total, coupling = level.slots, singles(slab.room, level.block), first_coupling(level, slab.first)
    before, inverse = singles(level.before, slots), singles(level.red_inverse, slots)
    fed, red = singles(level.red_fed, slots), singles(level.red, slots)
    for block in range(slab.first, slab.last):
        at, count = extent(level, block)
        coupling = draw_red(level, block, before, coupling, total)
        relax(inverse, fed, at, count, total, red)


@inner
def pass_over(level: Row, kind: int, slab: Slab) -> None:
    """`RAISE`, `COMBINE` or `TAKE` on a slab, block by block; ``sums`` receives squares."""
    slots, shares, sums = level.slots, doubles(level.shares, 2), doubles(level.sums, 3 * level.blocks)
    r, s, z, c = singles(level.r, slots), singles(level.s, slots), singles(level.z, slots), singles(level.c, slots)
    inverse, before = singles(level.black_inverse, slots), singles(level.before, slots)
    aggregate, coarse = indices(level.aggregate, slots), singles(level.below, level.below_slots)
    on_c, on_z = np.float32(shares[0]), np.float32(shares[1])
    for block in range(slab.first, slab.last):
        begin, count = extent(level, block)
        if kind == RAISE:
            _add_from_nodes(aggregate, begin, count, coarse, before)
        elif kind == COMBINE:
            combine(z, c, on_c, on_z, begin, count, before)
        else:
            sums[3 * block], sums[3 * block + 1] = take_step(r, s, on_c, begin, count)
            sums[3 * block + 2] = 0.0
            copy(z, begin, count, c)
            scale(inverse, r, begin, begin, count, before)


@inner
def _add_from_nodes(aggregate: Indices, begin: int, count: int, coarse: Singles, total: Singles) -> None:
    """Add what some slots take from their nodes."""
    at = np.uint64(begin)
    for i in range(count):
        k = at + np.uint64(i)
        total[k] += coarse[np.uint32(aggregate[k])]
