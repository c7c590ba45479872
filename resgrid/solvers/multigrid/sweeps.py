"""Sweeps over a stencil, slab by slab: passes in which red cells go ahead of black ones, so that faces are read once.

Slabs are whole blocks; red values that two slabs need are found by both; no slab reads what another one writes; sums
are kept block by block, and added in one order behind all slabs.  What couplings carry from anywhere to anywhere is
noted by the slabs, and added behind them.  So the digits are the same however a level is cut.
"""

from __future__ import annotations

import math

import numpy as np

from resgrid.jit import ZERO, inlined, inner, inner_fast
from resgrid.solvers.multigrid.levels import CHUNK, BlackVectors, Way, combine, take_step
from resgrid.solvers.multigrid.red_black import (
    BLACK,
    RED,
    Floats,
    Indices,
    Reals,
    Singles,
    Stencil,
    blocks_of,
    draw,
    draw_into,
    extent,
    relax,
)
from resgrid.solvers.multigrid.windows import (
    Slab,
    blocks_ahead,
    draw_into_red,
    lead,
    make_room,
    note,
    open_window,
)


@inner
def eliminate(stencil: Stencil, red_fed: Singles, black_fed: Singles, slab: Slab, of: BlackVectors) -> None:
    """What black cells are due, red ones eliminated, into ``of.r``; and that relaxed from zero into ``of.before``."""
    total, ahead, r, before = np.empty(stencil.block, of.r.dtype), blocks_ahead(stencil), of.r, of.before
    red_inverse, black_inverse = stencil.red_inverse, stencil.black_inverse
    begin = max(slab.first - ahead, 0)
    window = open_window(stencil, begin, r)
    for step in range(begin, slab.last + ahead):
        to = make_room(stencil, window, step)
        if step < blocks_of(stencil):
            at, count = extent(stencil, step)
            _divide(red_inverse, red_fed, at, count, window.red, to)
        block = step - ahead
        if block >= slab.first:
            at, count = extent(stencil, block)
            draw_into(stencil, BLACK, window.red, window.at[0], block, total, ZERO)
            _feed(black_inverse, black_fed, total, at, count, r, before)


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
def eliminate_couplings(stencil: Stencil, red_fed: Singles, of: BlackVectors) -> None:
    """The rest of `eliminate`, behind all slabs."""
    for m in range(len(stencil.couplings)):
        red, black = stencil.off_red[m], stencil.off_black[m]
        value = np.float32(stencil.red_inverse[red] * red_fed[red])
        of.r[black] += stencil.couplings[m] * value
    for m in range(len(stencil.couplings)):
        black = stencil.off_black[m]
        of.before[black] = stencil.black_inverse[black] * of.r[black]


@inner
def restrict(stencil: Stencil, way: Way, z: Singles, slab: Slab, coarse: Singles, noted: Singles) -> None:
    """Let the red cells follow the black values ``z``, and sum the black residual into the next level."""
    (aggregate, weight), total = way, np.empty(stencil.block, stencil.red_inverse.dtype)
    ahead = blocks_ahead(stencil)
    begin, last = max(slab.first - ahead, 0), -(-(slab.end - stencil.margin) // stencil.block)
    window = open_window(stencil, begin, z)
    draw(stencil, z, window.coupled)
    for step in range(begin, max(last, slab.last) + ahead):
        lead(stencil, window, z, step)
        block = step - ahead
        if slab.first <= block < last:
            draw_into(stencil, BLACK, window.red, window.at[0], block, total, ZERO)
            at, count = extent(stencil, block)
            behind = max(slab.begin - at, 0)
            if behind < count:
                count = min(count, slab.end - at) - behind
                _add_to_nodes(aggregate, weight, at + behind, count, total[behind:], coarse)
    _hand_on(stencil, slab, window.coupled, noted)


@inlined
def _share(way: Way, black: int) -> np.float32:
    """What a black slot counts for on the next level, and takes from it."""
    return way.weight[black] if len(way.weight) > 0 else np.float32(1.0)


@inner
def restrict_couplings(stencil: Stencil, way: Way, coupled: Singles, coarse: Singles) -> None:
    """The rest of `restrict`, behind all slabs."""
    for m in range(len(stencil.couplings)):
        black = stencil.off_black[m]
        coarse[way.aggregate[black]] += _share(way, black) * stencil.couplings[m] * coupled[m]
    coarse[0] = 0.0


@inner
def _add_to_nodes(aggregate: Indices, weight: Singles, begin: int, count: int, total: Reals, coarse: Singles) -> None:
    at = np.uint64(begin)
    if len(weight) > 0:
        for i in range(count):
            k = np.uint64(i)
            coarse[np.uint32(aggregate[at + k])] += weight[at + k] * total[k]
        return
    for i in range(count):
        k = np.uint64(i)
        coarse[np.uint32(aggregate[at + k])] += total[k]


@inner
def _add_from_nodes(
    aggregate: Indices, weight: Singles, begin: int, count: int, coarse: Singles, z: Singles, total: Singles
) -> None:
    """``total = z +`` what the slots of a block take from their nodes."""
    at = np.uint64(begin)
    if len(weight) > 0:
        for i in range(count):
            k = at + np.uint64(i)
            total[k] = z[k] + weight[k] * coarse[np.uint32(aggregate[k])]
        return
    for i in range(count):
        k = at + np.uint64(i)
        total[k] = z[k] + coarse[np.uint32(aggregate[k])]


@inner
def finish(
    stencil: Stencil, degree: Reals, way: Way, coarse: Singles, of: BlackVectors, own: Singles, slab: Slab,
    stages: tuple[bool, bool], noted: tuple[Singles, Reals], sums: Floats,
) -> None:  # fmt: skip
    """Finish the preconditioner's answer ``z`` to ``r``, and form ``w = S z``; both stages, or one of them.

    First the next level's answer is added to what came ``before``, the red cells follow, and the black ones are
    relaxed.  S is the Schur complement of the black cells, whose diagonal is ``degree``, in a precision of its own.
    ``sums`` (blocks, 3) receives ``z.r``, ``z.w`` and ``z.s``.

    Together the stages follow as close upon each other as neighbours allow, which couplings forbid.  ``own``: where the
    slab keeps its values of ``z`` and those next to it: ``z`` itself where there is no other slab.
    """
    (relaxing, multiplying), blocks, ahead = stages, blocks_of(stencil), blocks_ahead(stencil)
    (aggregate, weight), (before, r, s, z, w, _), apart = way, of, slab.last - slab.first < blocks
    around = 2 * ahead if relaxing and multiplying else 0
    first, last = max(slab.first - around, 0), min(slab.last + around, blocks)
    lead_first, lead_second = max(first - ahead, 0), max(slab.first - ahead, 0)
    relaxed, led = 2 * ahead, 3 * ahead if relaxing else 0
    begin = max(first - 2 * ahead, 0) if relaxing else lead_second
    end = slab.last + led + ahead if multiplying else last + relaxed
    window, other = open_window(stencil, lead_first, own), open_window(stencil, lead_second, degree)
    total, product = np.empty(stencil.block, own.dtype), np.empty(stencil.block, degree.dtype)
    if relaxing:
        _draw_raised(stencil, way, coarse, before, window.coupled)
    else:
        draw(stencil, own, other.coupled)
    for step in range(begin, end):
        if relaxing:
            if step < min(last + 2 * ahead, blocks):
                at, count = extent(stencil, step)
                _add_from_nodes(aggregate, weight, at, count, coarse, before, own)
            if lead_first <= step - ahead < last + ahead:
                lead(stencil, window, own, step - ahead)
            block = step - relaxed
            if first <= block < last:
                at, count = extent(stencil, block)
                draw_into(stencil, BLACK, window.red, window.at[0], block, total, ZERO)
                relax(stencil.black_inverse, r, at, count, total, own)
                if apart and slab.first <= block < slab.last:
                    _copy(own, at, count, z)
        if multiplying and lead_second <= step - led:
            lead(stencil, other, own, step - led)
            block = step - led - ahead
            if slab.first <= block:
                at, count = extent(stencil, block)
                draw_into(stencil, BLACK, other.red, other.at[0], block, product, ZERO)
                sums[block, 0], sums[block, 1], sums[block, 2] = _multiply(degree, own, r, s, at, count, product, w)
    if relaxing:
        _hand_on(stencil, slab, window.coupled, noted[0])
    if multiplying:
        _hand_on(stencil, slab, other.coupled, noted[1])


@inner
def _draw_raised(stencil: Stencil, way: Way, coarse: Singles, before: Singles, drawn: Singles) -> None:
    """What every coupling draws into its red cell, once the next level's answer is added."""
    for m in range(len(drawn)):
        black = stencil.off_black[m]
        drawn[m] = stencil.couplings[m] * (before[black] + _share(way, black) * coarse[way.aggregate[black]])


@inner
def relax_couplings(stencil: Stencil, coupled: Singles, z: Singles) -> None:
    """Add what couplings feed into black cells that have been relaxed."""
    for m in range(len(stencil.couplings)):
        black = stencil.off_black[m]
        z[black] += stencil.black_inverse[black] * stencil.couplings[m] * coupled[m]


@inner
def multiply_couplings(stencil: Stencil, coupled: Reals, z: Singles, w: Singles) -> float:
    """Take what couplings draw off the product; returns by how much ``z.w`` becomes less."""
    less = 0.0
    for m in range(len(stencil.couplings)):
        black, drawn = stencil.off_black[m], stencil.couplings[m] * coupled[m]
        w[black] -= drawn
        less += z[black] * drawn
    return less


@inner_fast
def _copy(values: Singles, begin: int, count: int, there: Singles) -> None:
    at = np.uint64(begin)
    for i in range(count):
        k = at + np.uint64(i)
        there[k] = values[k]


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
def take(inverse: Singles, of: BlackVectors, step: np.float32, part: int, parts: int, sums: Floats) -> None:
    """First step of the K-cycle along ``z``, its direction kept in ``c``, and the rest relaxed from zero."""
    (before, r, _, z, w, c), chunks = of, -(-len(of.r) // CHUNK)
    for chunk in range(part * chunks // parts, (part + 1) * chunks // parts):
        begin, end = chunk * CHUNK, min(chunk * CHUNK + CHUNK, len(r))
        sums[chunk, 0], sums[chunk, 1] = take_step(r, w, step, begin, end)
        sums[chunk, 2] = 0.0
        _copy(z, begin, end - begin, c)
        _divide(inverse, r, begin, end - begin, before, begin)


@inner
def put_back(
    stencil: Stencil, of: BlackVectors, shares: tuple[np.float32, np.float32], red_fed: Singles, slab: Slab,
    own: Singles, red: Singles,
) -> None:  # fmt: skip
    """The K-cycle's answer, ``shares`` of both directions, at the black nodes, into ``of.before``, and at the red ones.

    ``own``: as of `finish`, ``of.before`` where there is no other slab.
    """
    ahead, blocks, coupling = blocks_ahead(stencil), blocks_of(stencil), ZERO
    z, c, black, (on_c, on_z), apart = of.z, of.c, of.before, shares, slab.last - slab.first < blocks
    total, drawn = np.empty(stencil.block, own.dtype), np.empty(len(stencil.couplings), own.dtype)
    for m in range(len(stencil.couplings)):
        combine(z, c, on_c, on_z, stencil.off_black[m], stencil.off_black[m] + 1, own)
    draw(stencil, own, drawn)
    while coupling < len(drawn) and stencil.off_red[coupling] < stencil.margin + slab.first * stencil.block:
        coupling += 1
    for step in range(max(slab.first - ahead, 0), slab.last + ahead):
        if step < blocks:
            at, count = extent(stencil, step)
            combine(z, c, on_c, on_z, at, at + count, own)
            if apart and slab.first <= step < slab.last:
                _copy(own, at, count, black)
        block = step - ahead
        if block >= slab.first:
            at, count = extent(stencil, block)
            draw_into(stencil, RED, own, ZERO, block, total, ZERO)
            while coupling < len(drawn) and stencil.off_red[coupling] < at + count:
                total[stencil.off_red[coupling] - at] += drawn[coupling]
                coupling += 1
            relax(stencil.red_inverse, red_fed, at, count, total, red)


@inner
def residual(stencil: Stencil, b: Floats, x: Floats, r: Floats, slab: Slab, noted: Floats, squares: Floats) -> None:
    """Relax the red cells exactly, and form the residual at the black ones; ``b`` and ``x`` of shape (2, slots).

    ``squares`` (blocks,) receives the squares of every block, summed.
    """
    total, ahead = np.empty(stencil.block), blocks_ahead(stencil)
    begin = max(slab.first - ahead, 0)
    window = open_window(stencil, begin, r)
    draw(stencil, x[1], window.coupled)
    for step in range(begin, slab.last + ahead):
        to = draw_into_red(stencil, window, x[1], step)
        if step < blocks_of(stencil):
            at, count = extent(stencil, step)
            _relax_both(stencil.red_inverse, b[0], at, count, window.red, to, x[0])
            note(stencil, window, at, to)
        block = step - ahead
        if block >= slab.first:
            at, count = extent(stencil, block)
            draw_into(stencil, BLACK, window.red, window.at[0], block, total, ZERO)
            squares[block] = _subtract(stencil.black_degree, b[1], x[1], at, count, total, r)
    _hand_on(stencil, slab, window.coupled, noted)


@inner
def residual_couplings(stencil: Stencil, noted: Floats, squares: Floats, r: Floats) -> float:
    """The rest of `residual`, behind all slabs; returns the norm."""
    r[: stencil.margin] = 0.0
    r[len(r) - stencil.margin :] = 0.0
    if len(stencil.couplings) > 0:
        for m in range(len(stencil.couplings)):
            r[stencil.off_black[m]] += stencil.couplings[m] * noted[m]
        return math.sqrt(_squares(r))
    total = 0.0
    for block in range(len(squares)):
        total += squares[block]
    return math.sqrt(total)


@inner_fast
def _squares(r: Floats) -> float:
    total = 0.0
    for k in range(len(r)):
        total += r[k] * r[k]
    return total


@inner_fast
def _relax_both(inverse: Reals, fed: Reals, begin: int, count: int, drawn: Reals, to: int, red: Reals) -> None:
    """``red = inverse (fed + drawn)``, put in place of what is drawn too."""
    at, d_at = np.uint64(begin), np.uint64(to)
    for i in range(count):
        k = np.uint64(i)
        v = inverse[at + k] * (fed[at + k] + drawn[d_at + k])
        red[at + k] = v
        drawn[d_at + k] = v


@inner_fast
def _subtract(degree: Reals, b: Reals, x: Reals, begin: int, count: int, total: Reals, r: Reals) -> float:
    """``r = b + total - degree x`` on a block; returns its squares, summed."""
    squares = 0.0
    at = np.uint64(begin)
    for i in range(count):
        k = at + np.uint64(i)
        v = b[k] + (total[np.uint64(i)] - degree[k] * x[k])
        r[k] = v
        squares += v * v
    return squares


@inner
def _hand_on(stencil: Stencil, slab: Slab, coupled: Reals, noted: Reals) -> None:
    """Hand on a slab's red values where couplings begin."""
    begin, end = stencil.margin + slab.first * stencil.block, stencil.margin + slab.last * stencil.block
    for m in range(len(coupled)):
        if begin <= stencil.off_red[m] < end:
            noted[m] = coupled[m]
