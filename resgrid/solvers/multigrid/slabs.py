"""Visits of a hierarchy's grids, whose sweeps run slab by slab, on one thread or several (`sweeps`).

One thread leads, and the others help where there is a part to be done (`atomics`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from resgrid.jit import ZERO, inner, kernel
from resgrid.solvers.multigrid import atomics, sweeps
from resgrid.solvers.multigrid.levels import CHUNK, BlackVectors, Finest, Levels, Way, second_step, stencil_at
from resgrid.solvers.multigrid.red_black import Floats, Integers, Singles, Stencil, blocks_of
from resgrid.solvers.multigrid.subnormals import flush_subnormals, restore_subnormals
from resgrid.solvers.multigrid.windows import Slab

_CLEAR, _ELIMINATE, _RESTRICT, _FINISH, _RELAX, _MULTIPLY, _TAKE, _PUT_BACK = range(8)
"""The sweeps."""


class Crew(NamedTuple):
    """What threads share beside the levels.

    Levels are counted from the finest grid on.  `vectors`: of the finest level; `state`: jobs (`atomics`); `slabs`
    (levels, parts, 4): as of `Slab`; `cuts` (levels,): how many there are; `own, own_at`: work space of the slabs of
    every level that has several (parts, slots), one behind the other, 0 in the margins, and where each level's begins;
    `noted, noted_exact` (couplings,): red values where couplings begin; `sums` (blocks, 3): of products, or of squares;
    `shares` (2,): what both directions of a K-cycle have in its answer, or the first step's length.
    """

    finest: Finest
    vectors: BlackVectors
    state: Integers
    slabs: Integers
    cuts: Integers
    own: Singles
    own_at: Integers
    noted: Singles
    noted_exact: Floats
    sums: Floats
    shares: Floats


@inner
def _sweep(crew: Crew, levels: Levels, kind: int, level: int, visit: int) -> None:
    """Sweep over a level, together with whoever helps where it is cut."""
    parts = crew.cuts[level]
    part = ZERO
    if parts > 1:
        atomics.announce(crew.state, kind, level, visit, parts)
        part = atomics.claim(crew.state)
    while part >= 0:
        _sweep_slab(crew, levels, kind, level, visit, part)
        part = -1
        if parts > 1:
            atomics.finish(crew.state)
            part = atomics.claim(crew.state)
    if parts > 1:
        atomics.wait_for(crew.state, parts)


@kernel
def help_sweep(crew: Crew, levels: Levels) -> None:
    """Sweep over slabs for the thread that leads, until it has no more."""
    flags, state = flush_subnormals(), crew.state
    while True:
        part = atomics.await_part(state)
        if part < 0:
            break
        _sweep_slab(crew, levels, state[atomics.KIND], state[atomics.LEVEL], state[atomics.VISIT], part)
        atomics.finish(state)
    restore_subnormals(flags)


@inner
def _at(crew: Crew, levels: Levels, level: int, visit: int) -> tuple[Stencil, Way, BlackVectors]:
    """A level, the way to the next one, and its vectors."""
    stencil, way, of = crew.finest.stencil, crew.finest.way, crew.vectors
    if level > 0:
        grids, work = levels.grids, levels.work
        a, e = grids.slots[level - 1], grids.slots[level]
        product = work.v[a:e] if visit == 1 else work.w[a:e]
        stencil, way = stencil_at(grids, level - 1), Way(grids.aggregate[a:e], grids.weight[a:e])
        of = BlackVectors(work.x[a + e : 2 * e], work.f[a:e], work.v[a:e], work.z[a:e], product, work.c[a:e])
    return stencil, way, of


@inner
def _sweep_slab(crew: Crew, levels: Levels, kind: int, level: int, visit: int, part: int) -> None:
    """A slab's part of a sweep."""
    grids, work, parts = levels.grids, levels.work, crew.cuts[level]
    (stencil, way, of), slots = _at(crew, levels, level, visit), len(crew.vectors.z)
    first, last, begin, end = crew.slabs[level, part]
    slab, a, e = Slab(first, last, begin, end), ZERO, ZERO
    if level > 0:
        a, e = grids.slots[level - 1], grids.slots[level]
        slots = e - a
    below = slice(2 * e, _end_of_next(levels, level))
    own = of.before if kind == _PUT_BACK else of.z
    if parts > 1 and kind != _MULTIPLY:
        own = crew.own[crew.own_at[level] + part * slots : crew.own_at[level] + (part + 1) * slots]
    if kind in (_CLEAR, _ELIMINATE, _TAKE):
        some = work.b[below]
        for k in range(part * len(some) // parts, (part + 1) * len(some) // parts):
            some[k] = 0.0
    if kind == _ELIMINATE:
        sweeps.eliminate(stencil, work.b[2 * a : a + e], work.b[a + e : 2 * e], slab, of)
    elif kind == _RESTRICT:
        sweeps.restrict(stencil, way, of.before, slab, work.b[below], crew.noted)
    elif kind in (_FINISH, _RELAX, _MULTIPLY):
        stages, x = (kind != _MULTIPLY, kind != _RELAX), work.x[below]
        if level == 0:
            noted = crew.noted, crew.noted_exact
            sweeps.finish(stencil, crew.finest.exact, way, x, of, own, slab, stages, noted, crew.sums)
        else:
            sweeps.finish(stencil, stencil, way, x, of, own, slab, stages, (crew.noted, crew.noted), crew.sums)
    elif kind == _TAKE:
        sweeps.take(stencil.black_inverse, of, np.float32(crew.shares[0]), part, parts, crew.sums)
    elif kind == _PUT_BACK:
        on_c, on_z = np.float32(crew.shares[0]), np.float32(crew.shares[1])
        red_fed, red, black = work.b[2 * a : a + e], work.x[2 * a : a + e], work.x[a + e : 2 * e]
        sweeps.put_back(stencil, of, on_c, on_z, red_fed, slab, own, red, black)


@inner
def visit_grid(crew: Crew, levels: Levels, level: int, visit: tuple[int, Floats], stop: float) -> bool:
    """Come to a grid for the first, second or third time; returns whether it is solved, or the next level is due.

    Coming from above, red nodes are eliminated; from below, the next level's answer is a direction; each time the level
    is relaxed from zero, and the residual summed into the next level.  ``level`` counts from the finest one on.
    """
    count, first = visit
    if count == 0:
        _sweep(crew, levels, _ELIMINATE, level, count)
        a, e = levels.grids.slots[level - 1], levels.grids.slots[level]
        stencil, _, of = _at(crew, levels, level, count)
        sweeps.eliminate_couplings(stencil, levels.work.b[2 * a : a + e], of)
        down(crew, levels, level)
        return False
    rest, product, gamma = up(crew, levels, level, count)
    crew.shares[0], crew.shares[1] = 0.0, 1.0
    if count == 1:
        first[0], first[1] = rest, product
    if count > 1:
        crew.shares[0], crew.shares[1] = second_step(first[0], first[1], rest, product, gamma)
    elif product > 0.0 and stop < np.inf:
        crew.shares[0], crew.shares[1] = rest / product, 0.0
        _sweep(crew, levels, _TAKE, level, count)
        squares, left = 0.0, 0.0
        for chunk in range(-(-(levels.grids.slots[level] - levels.grids.slots[level - 1]) // CHUNK)):
            squares, left = squares + crew.sums[chunk, 0], left + crew.sums[chunk, 1]
        if left > stop * stop * squares:
            down(crew, levels, level)
            return False
    _sweep(crew, levels, _PUT_BACK, level, count)
    return True


@inner
def down(crew: Crew, levels: Levels, level: int) -> None:
    """Restrict what a level leaves over to the next one's right-hand side, which comes as 0."""
    _sweep(crew, levels, _RESTRICT, level, ZERO)
    stencil, way, _ = _at(crew, levels, level, ZERO)
    below = slice(2 * levels.grids.slots[level], _end_of_next(levels, level))
    sweeps.restrict_couplings(stencil, way, crew.noted, levels.work.b[below])


@inner
def _end_of_next(levels: Levels, level: int) -> int:
    """Where in `Work.b` and `Work.x` the level behind another one ends, a grid or the first of the graphs."""
    slots = levels.grids.slots
    if level + 1 < len(slots):
        return int(2 * slots[level + 1])
    return int(2 * slots[level] + 1 + levels.graphs.first[1])


@inner
def up(crew: Crew, levels: Levels, level: int, visit: int) -> tuple[float, float, float]:
    """Add the next level's answer, relax, and multiply; returns ``z.r``, ``z.w`` and ``z.s`` (`sweeps.finish`)."""
    stencil, _, of = _at(crew, levels, level, visit)
    coupled = len(stencil.couplings) > 0
    if coupled:
        _sweep(crew, levels, _RELAX, level, visit)
        sweeps.relax_couplings(stencil, crew.noted, of.z)
    _sweep(crew, levels, _MULTIPLY if coupled else _FINISH, level, visit)
    zr, zw, zs = 0.0, 0.0, 0.0
    for block in range(blocks_of(stencil)):
        zr, zw, zs = zr + crew.sums[block, 0], zw + crew.sums[block, 1], zs + crew.sums[block, 2]
    if level == 0:
        return zr, zw - sweeps.multiply_couplings(crew.finest.exact, crew.noted_exact, of.z, of.w), zs
    return zr, zw - sweeps.multiply_couplings(stencil, crew.noted, of.z, of.w), zs


@inner
def begin(crew: Crew, levels: Levels) -> None:
    """Restrict the finest level's relaxed residual."""
    z, margin = crew.vectors.z, crew.finest.stencil.margin
    z[:margin] = 0.0
    z[len(z) - margin :] = 0.0
    _sweep(crew, levels, _CLEAR, ZERO, ZERO)
    down(crew, levels, ZERO)
