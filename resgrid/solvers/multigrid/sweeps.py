"""Sweeps over a grid, slab by slab, in which red cells go ahead of black ones, so that faces are read once.

Slabs are whole blocks; red values that two slabs need are found by both; no slab reads what another one writes; sums
are kept block by block, and added in one order behind all slabs.  What couplings carry from anywhere to anywhere is
noted by the slabs, and added behind them.  So the digits are the same however a level is cut.
"""

from __future__ import annotations

from typing import cast

import numpy as np

from resgrid.jit import ZERO, inner, inner_fast
from resgrid.solvers.machine import doubles, indices, singles
from resgrid.solvers.multigrid.levels import (
    CHUNK,
    Row,
    Slab,
    blocks_ahead,
    chunks_of,
    combine,
    copy,
    draw,
    draw_into,
    extent,
    lead,
    open_double,
    open_window,
    take_step,
)
from resgrid.solvers.multigrid.red_black import BLACK, RED, Indices, Reals, Singles, relax

CLEAR, ELIMINATE, RESTRICT, RELAX, RAISE, COMBINE, PUT_BACK, TAKE, MULTIPLY = (cast(int, np.int64(k)) for k in range(9))
"""The sweeps; no literals, as `resgrid.jit.ZERO`.

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
    slots, ahead, eliminating = level.slots, blocks_ahead(level), kind == ELIMINATE
    before, r, z = singles(level.before, slots), singles(level.r, slots), singles(level.z, slots)
    inverse, fed = singles(level.black_inverse, slots), singles(level.black_fed, slots)
    aggregate, coarse = indices(level.aggregate, slots), singles(level.below_fed, level.below_slots)
    source = singles(level.red_fed if eliminating else level.before, slots)
    begin, last = max(slab.first - ahead, 0), slab.last
    if kind == RESTRICT:
        last = -(-(slab.end - level.margin) // level.block)
    window = open_window(level, slab, begin)
    draw(level, before, window.drawn)
    for step in range(begin, max(last, slab.last) + ahead):
        lead(level, window, slab, source, step, eliminating)
        block = step - ahead
        if not slab.first <= block < last:
            continue
        at, count = extent(level, block)
        draw_into(level, BLACK, window.red, window.at[0], block, window.total, ZERO)
        if eliminating:
            _feed(inverse, fed, window.total, at, count, r, before)
        elif kind == RELAX:
            relax(inverse, r, at, count, window.total, z)
        elif slab.begin < at + count:
            behind = max(slab.begin - at, 0)
            _add_to_nodes(aggregate, at + behind, min(count, slab.end - at) - behind, window.total, behind, coarse)


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
    slots, ahead, degree = level.slots, blocks_ahead(level), doubles(level.degree, level.slots)
    r, s, z = singles(level.r, slots), singles(level.s, slots), singles(level.z, slots)
    sums, begin = doubles(level.sums, 3 * level.blocks), max(slab.first - ahead, 0)
    window = open_double(level, slab, begin)
    draw(level, z, window.drawn)
    for step in range(begin, slab.last + ahead):
        lead(level, window, slab, z, step, False)
        block = step - ahead
        if slab.first <= block:
            at, count = extent(level, block)
            draw_into(level, BLACK, window.red, window.at[0], block, window.total, ZERO)
            k, sum_of = 3 * block, _multiply(degree, z, r, s, at, count, window.total, product)
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
    off_black, g, red = indices(level.off_black, joined), singles(level.couplings, joined), doubles(level.noted, joined)
    before, r, z = singles(level.before, slots), singles(level.r, slots), singles(level.z, slots)
    inverse, aggregate = singles(level.black_inverse, slots), indices(level.aggregate, slots)
    coarse = singles(level.below_fed, level.below_slots)
    for m in range(joined):
        black, drawn = off_black[m], g[m] * red[m]
        if kind == ELIMINATE:
            r[black] += drawn
            before[black] = inverse[black] * r[black]
        elif kind == RESTRICT:
            coarse[aggregate[black]] += drawn
        elif kind == RELAX:
            z[black] += inverse[black] * drawn
        else:
            product[black] -= drawn
            less += z[black] * drawn
    coarse[0] = 0.0
    return less


@inner
def put_back(level: Row, slab: Slab) -> None:
    """`PUT_BACK` on a slab."""
    slots, window = level.slots, open_window(level, slab, slab.first)
    before, inverse = singles(level.before, slots), singles(level.red_inverse, slots)
    fed, red, off_red = singles(level.red_fed, slots), singles(level.red, slots), indices(level.off_red, level.joined)
    draw(level, before, window.drawn)
    for block in range(slab.first, slab.last):
        at, count = extent(level, block)
        draw_into(level, RED, before, ZERO, block, window.total, ZERO)
        while window.at[1] < level.joined and off_red[window.at[1]] < at + count:
            window.total[off_red[window.at[1]] - at] += window.drawn[window.at[1]]
            window.at[1] += 1
        relax(inverse, fed, at, count, window.total, red)


@inner
def pass_over(level: Row, kind: int, part: int) -> None:
    """`RAISE`, `COMBINE` or `TAKE` on one of the level's parts, chunk by chunk; ``sums`` receives squares."""
    slots, chunks, shares = level.slots, chunks_of(level), doubles(level.shares, 2)
    r, s, z, c = singles(level.r, slots), singles(level.s, slots), singles(level.z, slots), singles(level.c, slots)
    inverse, before = singles(level.black_inverse, slots), singles(level.before, slots)
    aggregate, coarse = indices(level.aggregate, slots), singles(level.below, level.below_slots)
    sums = doubles(level.sums, 3 * chunks)
    on_c, on_z = np.float32(shares[0]), np.float32(shares[1])
    for chunk in range(part * chunks // level.parts, (part + 1) * chunks // level.parts):
        begin, end = chunk * CHUNK, min(chunk * CHUNK + CHUNK, slots)
        if kind == RAISE:
            _add_from_nodes(aggregate, begin, end, coarse, before)
        elif kind == COMBINE:
            combine(z, c, on_c, on_z, begin, end, before)
        else:
            sums[3 * chunk], sums[3 * chunk + 1] = take_step(r, s, on_c, begin, end)
            sums[3 * chunk + 2] = 0.0
            copy(z, begin, end - begin, c)
            _divide(inverse, r, begin, end, before)


@inner
def _add_from_nodes(aggregate: Indices, begin: int, end: int, coarse: Singles, total: Singles) -> None:
    """Add what some slots take from their nodes."""
    at = np.uint64(begin)
    for i in range(end - begin):
        k = at + np.uint64(i)
        total[k] += coarse[np.uint32(aggregate[k])]


@inner_fast
def _divide(inverse: Singles, r: Singles, begin: int, end: int, value: Singles) -> None:
    """``value = inverse r`` on some slots."""
    at = np.uint64(begin)
    for i in range(end - begin):
        k = at + np.uint64(i)
        value[k] = inverse[k] * r[k]
