"""Sweeps over a grid, slab by slab: passes in which red cells go ahead of black ones, so that faces are read once.

Slabs are whole blocks; red values that two slabs need are found by both; no slab reads what another one writes; sums
are kept block by block, and added in one order behind all slabs.  What couplings carry from anywhere to anywhere is
noted by the slabs, and added behind them.  So the digits are the same however a level is cut.
"""

from __future__ import annotations

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
    make_room,
    open_second,
    open_window,
    take_step,
)
from resgrid.solvers.multigrid.red_black import BLACK, RED, Indices, Reals, Singles, relax


@inner
def eliminate(level: Row, slab: Slab) -> None:
    """What black cells are due, red ones eliminated, into ``r``; and that relaxed from zero into ``before``."""
    slots, ahead = level.slots, blocks_ahead(level)
    red_inverse, red_fed, r = singles(level.red_inverse, slots), singles(level.red_fed, slots), singles(level.r, slots)
    black_inverse, black_fed = singles(level.black_inverse, slots), singles(level.black_fed, slots)
    before, begin = singles(level.before, slots), max(slab.first - ahead, 0)
    window = open_window(level, slab, begin)
    for step in range(begin, slab.last + ahead):
        to = make_room(level, window, step)
        if step < level.blocks:
            at, count = extent(level, step)
            _divide(red_inverse, red_fed, at, count, window.red, to)
        block = step - ahead
        if block >= slab.first:
            at, count = extent(level, block)
            draw_into(level, BLACK, window.red, window.at[0], block, window.total, ZERO)
            _feed(black_inverse, black_fed, window.total, at, count, r, before)


@inner_fast
def _divide(inverse: Singles, fed: Singles, begin: int, count: int, value: Singles, to: int) -> None:
    """``value = inverse fed`` on a block, the value from slot ``to`` on."""
    at, v_at = np.uint64(begin), np.uint64(to)
    for i in range(count):
        k = np.uint64(i)
        value[v_at + k] = inverse[at + k] * fed[at + k]


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
def eliminate_couplings(level: Row) -> None:
    """The rest of `eliminate`, behind all slabs."""
    slots, joined = level.slots, level.joined
    off_red, off_black = indices(level.off_red, joined), indices(level.off_black, joined)
    g = singles(level.couplings, joined)
    inverse, fed, r = singles(level.red_inverse, slots), singles(level.red_fed, slots), singles(level.r, slots)
    before, black_inverse = singles(level.before, slots), singles(level.black_inverse, slots)
    for m in range(joined):
        r[off_black[m]] += g[m] * np.float32(inverse[off_red[m]] * fed[off_red[m]])
    for m in range(joined):
        black = off_black[m]
        before[black] = black_inverse[black] * r[black]


@inner
def restrict(level: Row, slab: Slab) -> None:
    """Let the red cells follow ``before``, and sum the black residual into the next level."""
    slots, ahead, z = level.slots, blocks_ahead(level), singles(level.before, level.slots)
    aggregate = indices(level.aggregate, slots)
    coarse = singles(level.below_fed, level.below_slots)
    begin, last = max(slab.first - ahead, 0), -(-(slab.end - level.margin) // level.block)
    window = open_window(level, slab, begin)
    draw(level, z, window.drawn)
    for step in range(begin, max(last, slab.last) + ahead):
        lead(level, window, slab, z, step)
        block = step - ahead
        if slab.first <= block < last:
            draw_into(level, BLACK, window.red, window.at[0], block, window.total, ZERO)
            at, count = extent(level, block)
            behind = max(slab.begin - at, 0)
            if behind < count:
                count = min(count, slab.end - at) - behind
                _add_to_nodes(aggregate, at + behind, count, window.total, behind, coarse)


@inner
def restrict_couplings(level: Row) -> None:
    """The rest of `restrict`, behind all slabs."""
    g, red = singles(level.couplings, level.joined), doubles(level.noted, level.joined)
    off_black, aggregate = indices(level.off_black, level.joined), indices(level.aggregate, level.slots)
    coarse = singles(level.below_fed, level.below_slots)
    for m in range(level.joined):
        black = off_black[m]
        coarse[aggregate[black]] += g[m] * np.float32(red[m])
    coarse[0] = 0.0


@inner
def _add_to_nodes(aggregate: Indices, begin: int, count: int, total: Singles, behind: int, coarse: Singles) -> None:
    at, t_at = np.uint64(begin), np.uint64(behind)
    for i in range(count):
        k = np.uint64(i)
        coarse[np.uint32(aggregate[at + k])] += total[t_at + k]


@inner
def _add_from_nodes(aggregate: Indices, begin: int, count: int, coarse: Singles, z: Singles, total: Singles) -> None:
    """``total = z +`` what the slots of a block take from their nodes."""
    at = np.uint64(begin)
    for i in range(count):
        k = at + np.uint64(i)
        total[k] = z[k] + coarse[np.uint32(aggregate[k])]


@inner
def finish(level: Row, slab: Slab, own: Singles, product: Singles, stages: tuple[bool, bool]) -> None:
    """Finish the preconditioner's answer ``z`` to ``r``, and form ``w = S z``; both stages, or one of them.

    First the next level's answer is added to what came ``before``, the red cells follow, and the black ones are
    relaxed.  S is the Schur complement of the black cells, whose diagonal is ``degree``.  ``sums`` receives ``z.r``,
    ``z.w`` and ``z.s``; ``product`` is ``w``.

    Together the stages follow as close upon each other as neighbours allow, which couplings forbid.  ``own``: where the
    slab keeps its values of ``z`` and those next to it: ``z`` itself where there is no other slab.
    """
    (relaxing, multiplying), slots, blocks, ahead = stages, level.slots, level.blocks, blocks_ahead(level)
    aggregate = indices(level.aggregate, slots)
    coarse = singles(level.below, level.below_slots)
    before, r, s, z = (
        singles(level.before, slots),
        singles(level.r, slots),
        singles(level.s, slots),
        singles(level.z, slots),
    )
    degree, black_inverse = doubles(level.degree, slots), singles(level.black_inverse, slots)
    sums, apart = doubles(level.sums, 3 * blocks), slab.last - slab.first < blocks
    around = 2 * ahead if relaxing and multiplying else 0
    first, last = max(slab.first - around, 0), min(slab.last + around, blocks)
    lead_first, lead_second = max(first - ahead, 0), max(slab.first - ahead, 0)
    relaxed, led = 2 * ahead, 3 * ahead if relaxing else 0
    begin = max(first - 2 * ahead, 0) if relaxing else lead_second
    end = slab.last + led + ahead if multiplying else last + relaxed
    window, other = open_window(level, slab, lead_first), open_second(level, slab, lead_second)
    if relaxing:
        _draw_raised(level, aggregate, coarse, before, window.drawn)
    else:
        draw(level, own, other.drawn)
    for step in range(begin, end):
        if relaxing:
            if step < min(last + 2 * ahead, blocks):
                at, count = extent(level, step)
                _add_from_nodes(aggregate, at, count, coarse, before, own)
            if lead_first <= step - ahead < last + ahead:
                lead(level, window, slab, own, step - ahead)
            block = step - relaxed
            if first <= block < last:
                at, count = extent(level, block)
                draw_into(level, BLACK, window.red, window.at[0], block, window.total, ZERO)
                relax(black_inverse, r, at, count, window.total, own)
                if apart and slab.first <= block < slab.last:
                    copy(own, at, count, z)
        if multiplying and lead_second <= step - led:
            lead(level, other, slab, own, step - led)
            block = step - led - ahead
            if slab.first <= block:
                at, count = extent(level, block)
                draw_into(level, BLACK, other.red, other.at[0], block, other.total, ZERO)
                k, sum_of = 3 * block, _multiply(degree, own, r, s, at, count, other.total, product)
                sums[k], sums[k + 1], sums[k + 2] = sum_of


@inner
def _draw_raised(level: Row, aggregate: Indices, coarse: Singles, before: Singles, drawn: Singles) -> None:
    """What every coupling draws into its red cell, once the next level's answer is added."""
    g, off_black = singles(level.couplings, level.joined), indices(level.off_black, level.joined)
    for m in range(level.joined):
        black = off_black[m]
        drawn[m] = g[m] * (before[black] + coarse[aggregate[black]])


@inner
def relax_couplings(level: Row) -> None:
    """Add what couplings feed into black cells that have been relaxed."""
    g, red = singles(level.couplings, level.joined), doubles(level.noted, level.joined)
    off_black = indices(level.off_black, level.joined)
    inverse, z = singles(level.black_inverse, level.slots), singles(level.z, level.slots)
    for m in range(level.joined):
        black = off_black[m]
        z[black] += inverse[black] * g[m] * np.float32(red[m])


@inner
def multiply_couplings(level: Row, product: Singles) -> float:
    """Take what couplings draw off the product; returns by how much ``z.w`` becomes less."""
    less, z, off_black = 0.0, singles(level.z, level.slots), indices(level.off_black, level.joined)
    g, red = singles(level.couplings, level.joined), doubles(level.noted, level.joined)
    for m in range(level.joined):
        black, drawn = off_black[m], g[m] * red[m]
        product[black] -= drawn
        less += z[black] * drawn
    return less


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
def take(level: Row, part: int) -> None:
    """First step of the K-cycle along ``z``, its direction kept in ``c``, and the rest relaxed from zero."""
    slots, sums, step = level.slots, doubles(level.sums, 3 * chunks_of(level)), np.float32(doubles(level.shares, 2)[0])
    r, s, z, c = singles(level.r, slots), singles(level.s, slots), singles(level.z, slots), singles(level.c, slots)
    inverse, before, chunks = singles(level.black_inverse, slots), singles(level.before, slots), chunks_of(level)
    for chunk in range(part * chunks // level.parts, (part + 1) * chunks // level.parts):
        begin, end = chunk * CHUNK, min(chunk * CHUNK + CHUNK, slots)
        sums[3 * chunk], sums[3 * chunk + 1] = take_step(r, s, step, begin, end)
        sums[3 * chunk + 2] = 0.0
        copy(z, begin, end - begin, c)
        _divide(inverse, r, begin, end - begin, before, begin)


@inner
def put_back(level: Row, slab: Slab, own: Singles) -> None:
    """The K-cycle's answer, ``shares`` of both directions, at the black nodes, into ``before``, and at the red ones.

    ``own``: as of `finish`, ``before`` where there is no other slab.
    """
    slots, ahead, blocks = level.slots, blocks_ahead(level), level.blocks
    z, c, black = singles(level.z, slots), singles(level.c, slots), singles(level.before, slots)
    red_inverse, red_fed, red = (
        singles(level.red_inverse, slots),
        singles(level.red_fed, slots),
        singles(level.red, slots),
    )
    on_c, on_z = np.float32(doubles(level.shares, 2)[0]), np.float32(doubles(level.shares, 2)[1])
    off_red, off_black = indices(level.off_red, level.joined), indices(level.off_black, level.joined)
    window, apart = open_window(level, slab, slab.first), slab.last - slab.first < blocks
    for m in range(level.joined):
        combine(z, c, on_c, on_z, off_black[m], off_black[m] + 1, own)
    draw(level, own, window.drawn)
    for step in range(max(slab.first - ahead, 0), slab.last + ahead):
        if step < blocks:
            at, count = extent(level, step)
            combine(z, c, on_c, on_z, at, at + count, own)
            if apart and slab.first <= step < slab.last:
                copy(own, at, count, black)
        block = step - ahead
        if block >= slab.first:
            at, count = extent(level, block)
            draw_into(level, RED, own, ZERO, block, window.total, ZERO)
            while window.at[1] < level.joined and off_red[window.at[1]] < at + count:
                window.total[off_red[window.at[1]] - at] += window.drawn[window.at[1]]
                window.at[1] += 1
            relax(red_inverse, red_fed, at, count, window.total, red)
