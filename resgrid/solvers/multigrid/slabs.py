"""Visits of a hierarchy's grids, whose sweeps run slab by slab, on one thread or several (`sweeps`).

One thread leads, and the others help where there is a part to be done (`atomics`).
"""

from __future__ import annotations

from typing import NamedTuple, cast

import numpy as np

from resgrid.jit import ZERO, inner, kernel
from resgrid.solvers.multigrid import atomics, sweeps
from resgrid.solvers.multigrid.levels import BlackVectors, Finest, Grids, Way, Work, second_step, stencil_at
from resgrid.solvers.multigrid.red_black import Floats, Integers, Singles, Stencil
from resgrid.solvers.multigrid.subnormals import flush_subnormals, restore_subnormals
from resgrid.solvers.multigrid.windows import Slab

_CLEAR, _ELIMINATE, _RESTRICT, _RELAX, _MULTIPLY, _FINISH, _TAKE, _PUT_BACK = (cast(int, np.int64(k)) for k in range(8))
"""The sweeps; no literals, as `resgrid.jit.ZERO`."""


class Crew(NamedTuple):
    """What threads share beside the levels, which are counted from the finest grid on.

    `state`: jobs (`atomics`); `slabs` (levels, parts, 4): as of `Slab`; `sizes` (levels, 5): how many slabs there are;
    how many blocks and how many chunks have sums of their own; where in `Work.b` and `Work.x` the next level ends; how
    many couplings there are; `own, own_at`: work space of the slabs of every level that has several (parts, slots), one
    behind the other, 0 in the margins, and where each level's begins; `noted, noted_exact` (couplings,): red values
    where couplings begin; `sums` (blocks, 3): of products, or of squares; `shares` (2,): what both directions of a
    K-cycle have in its answer, or the first step's length.
    """

    state: Integers
    slabs: Integers
    sizes: Integers
    own: Singles
    own_at: Integers
    noted: Singles
    noted_exact: Floats
    sums: Floats
    shares: Floats


class Places(NamedTuple):
    """Where grids stand: the finest one and its vectors, and the others, with their work space."""

    finest: Finest
    vectors: BlackVectors
    grids: Grids
    work: Work


class _Level(NamedTuple):
    """A grid, the way to the next level, and its vectors; what red and black nodes are fed, and what red ones are.

    `below_fed, below`: the next level's right-hand side and answer; `degree`: of the finest grid.
    """

    stencil: Stencil
    way: Way
    of: BlackVectors
    red_fed: Singles
    black_fed: Singles
    red: Singles
    below_fed: Singles
    below: Singles
    degree: Floats


@inner
def _at(places: Places, level: int, visit: int, end: int) -> _Level:
    """A level of a hierarchy, the one behind which ends where in `Work.b`."""
    (finest, of, grids, work), a = places, ZERO
    stencil, way, e = finest.stencil, finest.way, grids.slots[level]
    if level > 0:
        a = grids.slots[level - 1]
        product = work.v[a:e] if visit == 1 else work.w[a:e]
        stencil, way = stencil_at(grids, level - 1), Way(grids.aggregate[a:e], grids.weight[a:e])
        of = BlackVectors(work.x[a + e : 2 * e], work.f[a:e], work.v[a:e], work.z[a:e], product, work.c[a:e])
    b, x = work.b, work.x
    fed, red = b[2 * a : a + e], x[2 * a : a + e]
    return _Level(stencil, way, of, fed, b[a + e : 2 * e], red, b[2 * e : end], x[2 * e : end], finest.degree)


@inner
def _sweep(crew: Crew, places: Places, kind: int, level: int, visit: int) -> tuple[float, float, float]:
    """Sweep over a level, together with whoever helps where it is cut; returns what is summed over its slabs.

    What couplings carry follows behind all slabs.
    """
    parts, blocks, chunks, end, _ = crew.sizes[level]
    at, part = _at(places, level, visit, end), ZERO
    if parts > 1:
        atomics.announce(crew.state, kind, level, visit, parts)
        part = atomics.claim(crew.state)
    while part >= 0:
        _sweep_slab(crew, at, kind, level, part)
        part = -1
        if parts > 1:
            atomics.finish(crew.state)
            part = atomics.claim(crew.state)
    if parts > 1:
        atomics.wait_for(crew.state, parts)
    first, second, third = 0.0, 0.0, 0.0
    if kind >= _MULTIPLY:
        for k in range(chunks if kind == _TAKE else blocks):
            first, second, third = first + crew.sums[k, 0], second + crew.sums[k, 1], third + crew.sums[k, 2]
    if kind == _ELIMINATE:
        sweeps.eliminate_couplings(at.stencil, at.red_fed, at.of)
    elif kind == _RESTRICT:
        sweeps.restrict_couplings(at.stencil, at.way, crew.noted, at.below_fed)
    elif kind == _RELAX:
        sweeps.relax_couplings(at.stencil, crew.noted, at.of.z)
    elif kind == _MULTIPLY:
        if level == 0:
            second -= sweeps.multiply_couplings(at.stencil, crew.noted_exact, at.of.z, at.of.w)
        else:
            second -= sweeps.multiply_couplings(at.stencil, crew.noted, at.of.z, at.of.w)
    return first, second, third


@kernel
def help_sweep(crew: Crew, places: Places) -> None:
    """Sweep over slabs for the thread that leads, until it has no more."""
    flags, state = flush_subnormals(), crew.state
    while True:
        part = atomics.await_part(state)
        if part < 0:
            break
        level = state[atomics.LEVEL]
        at = _at(places, level, state[atomics.VISIT], crew.sizes[level, 3])
        _sweep_slab(crew, at, state[atomics.KIND], level, part)
        atomics.finish(state)
    restore_subnormals(flags)


@inner
def _sweep_slab(crew: Crew, at: _Level, kind: int, level: int, part: int) -> None:
    """A slab's part of a sweep."""
    stencil, of, parts, slots = at.stencil, at.of, crew.sizes[level, 0], len(at.of.z)
    first, last, begin, end = crew.slabs[level, part]
    slab, own = Slab(first, last, begin, end), of.before if kind == _PUT_BACK else of.z
    if parts > 1 and kind != _MULTIPLY:
        own = crew.own[crew.own_at[level] + part * slots : crew.own_at[level] + (part + 1) * slots]
    if kind == _CLEAR or kind == _ELIMINATE or kind == _TAKE:  # noqa: PLR1714, SIM109 (compiles in half the time)
        some = at.below_fed
        for k in range(part * len(some) // parts, (part + 1) * len(some) // parts):
            some[k] = 0.0
    if kind == _ELIMINATE:
        sweeps.eliminate(stencil, at.red_fed, at.black_fed, slab, of)
    elif kind == _RESTRICT:
        sweeps.restrict(stencil, at.way, of.before, slab, at.below_fed, crew.noted)
    elif kind == _TAKE:
        sweeps.take(stencil.black_inverse, of, np.float32(crew.shares[0]), part, parts, crew.sums)
    elif kind == _PUT_BACK:
        shares = np.float32(crew.shares[0]), np.float32(crew.shares[1])
        sweeps.put_back(stencil, of, shares, at.red_fed, slab, own, at.red)
    elif kind >= _RELAX:
        stages = (kind != _MULTIPLY, kind != _RELAX)
        if level == 0:
            noted = crew.noted, crew.noted_exact
            sweeps.finish(stencil, at.degree, at.way, at.below, of, own, slab, stages, noted, crew.sums)
        else:
            alike = crew.noted, crew.noted
            sweeps.finish(stencil, stencil.black_degree, at.way, at.below, of, own, slab, stages, alike, crew.sums)


@inner
def visit_grid(crew: Crew, places: Places, level: int, visit: tuple[int, Floats], stop: float) -> bool:
    """Come to a grid for the first, second or third time; returns whether it is solved, or the next level is due.

    Coming from above, red nodes are eliminated; from below, the next level's answer is a direction; each time the level
    is relaxed from zero, and the residual summed into the next level.  ``level`` counts from the finest one on.
    """
    (count, first), solved, kind = visit, False, _ELIMINATE
    if count > 0:
        rest, product, gamma = finish(crew, places, level, count)
        solved, shares = True, (0.0, 1.0)
        if count > 1:
            shares = second_step(first[0], first[1], rest, product, gamma)
        else:
            first[0], first[1] = rest, product
            if product > 0.0 and stop < np.inf:
                solved, kind, shares = False, _TAKE, (rest / product, 0.0)
        crew.shares[0], crew.shares[1] = shares
    if not solved:
        before, after, _ = _sweep(crew, places, kind, level, count)
        solved = kind == _TAKE and not after > stop * stop * before
    _sweep(crew, places, _PUT_BACK if solved else _RESTRICT, level, count)
    return solved


@inner
def finish(crew: Crew, places: Places, level: int, visit: int) -> tuple[float, float, float]:
    """Add the next level's answer, relax, and multiply; returns ``z.r``, ``z.w`` and ``z.s`` (`sweeps.finish`)."""
    kind = _FINISH
    if crew.sizes[level, 4] > 0:
        _sweep(crew, places, _RELAX, level, visit)
        kind = _MULTIPLY
    return _sweep(crew, places, kind, level, visit)


@inner
def begin(crew: Crew, places: Places) -> None:
    """Restrict the finest level's relaxed residual."""
    for kind in (_CLEAR, _RESTRICT):
        _sweep(crew, places, kind, ZERO, ZERO)
