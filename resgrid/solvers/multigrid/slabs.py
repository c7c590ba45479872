"""Visits of a hierarchy's grids, whose sweeps run slab by slab, on one thread or several (`sweeps`).

One thread leads, and the others help where there is a part to be done (`atomics`).  Levels are counted from the finest
grid on.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from resgrid.jit import ZERO, inner, kernel
from resgrid.solvers.multigrid import atomics, sweeps
from resgrid.solvers.multigrid.levels import SINGLE, Row, chunks_of, doubles, second_step, singles, sums_of
from resgrid.solvers.multigrid.red_black import Floats, Integers
from resgrid.solvers.multigrid.subnormals import flush_subnormals, restore_subnormals
from resgrid.solvers.multigrid.windows import slab_of

Table = NDArray[Any]
"""Rows of `levels.GRID`, shape (levels,)."""

_CLEAR, _ELIMINATE, _RESTRICT, _RELAX, _MULTIPLY, _FINISH, _TAKE, _PUT_BACK = (cast(int, np.int64(k)) for k in range(8))
"""The sweeps; no literals, as `resgrid.jit.ZERO`."""


@inner
def _sweep(table: Table, state: Integers, kind: int, number: int, visit: int) -> tuple[float, float, float]:
    """Sweep over a level, together with whoever helps where it is cut; returns what is summed over its slabs.

    What couplings carry follows behind all slabs.
    """
    level, part = table[number], ZERO
    if level.parts > 1:
        atomics.announce(state, kind, number, visit, level.parts)
        part = atomics.claim(state)
    while part >= 0:
        _sweep_slab(level, kind, visit, part)
        part = -1
        if level.parts > 1:
            atomics.finish(state)
            part = atomics.claim(state)
    if level.parts > 1:
        atomics.wait_for(state, level.parts)
    first, second, third, sums = 0.0, 0.0, 0.0, sums_of(level)
    if kind >= _MULTIPLY:
        for k in range(chunks_of(level) if kind == _TAKE else level.blocks):
            first, second, third = first + sums[k, 0], second + sums[k, 1], third + sums[k, 2]
    if kind == _ELIMINATE:
        sweeps.eliminate_couplings(level)
    elif kind == _RESTRICT:
        sweeps.restrict_couplings(level)
    elif kind == _RELAX:
        sweeps.relax_couplings(level)
    elif kind == _MULTIPLY:
        second -= sweeps.multiply_couplings(level, singles(_product(level, visit), level.slots))
    return first, second, third


@inner
def _product(level: Row, visit: int) -> int:
    """Where the product of a visit's answer goes."""
    return int(level.s if visit == 1 else level.w)


@kernel
def help_sweep(table: Table, state: Integers) -> None:
    """Sweep over slabs for the thread that leads, until it has no more."""
    flags = flush_subnormals()
    while True:
        part = atomics.await_part(state)
        if part < 0:
            break
        _sweep_slab(table[state[atomics.LEVEL]], state[atomics.KIND], state[atomics.VISIT], part)
        atomics.finish(state)
    restore_subnormals(flags)


@inner
def _sweep_slab(level: Row, kind: int, visit: int, part: int) -> None:
    """A slab's part of a sweep."""
    slab, parts, slots = slab_of(level, part), level.parts, level.slots
    own = level.before if kind == _PUT_BACK else level.z
    if parts > 1 and kind != _MULTIPLY:
        own = level.own + SINGLE * slots * part
    at = singles(own, slots)
    if kind == _CLEAR or kind == _ELIMINATE or kind == _TAKE:  # noqa: PLR1714, SIM109 (compiles in half the time)
        below_fed = singles(level.below_fed, level.below_slots)
        for k in range(part * len(below_fed) // parts, (part + 1) * len(below_fed) // parts):
            below_fed[k] = 0.0
    if kind == _ELIMINATE:
        sweeps.eliminate(level, slab)
    elif kind == _RESTRICT:
        sweeps.restrict(level, slab)
    elif kind == _TAKE:
        sweeps.take(level, part)
    elif kind == _PUT_BACK:
        sweeps.put_back(level, slab, at)
    elif kind >= _RELAX:
        sweeps.finish(level, slab, at, singles(_product(level, visit), slots), (kind != _MULTIPLY, kind != _RELAX))


@inner
def visit_grid(table: Table, state: Integers, number: int, visit: tuple[int, Floats], stop: float) -> bool:
    """Come to a grid for the first, second or third time; returns whether it is solved, or the next level is due.

    Coming from above, red nodes are eliminated; from below, the next level's answer is a direction; each time the level
    is relaxed from zero, and the residual summed into the next level.
    """
    (count, first), solved, kind = visit, False, _ELIMINATE
    if count > 0:
        rest, product, gamma = finish(table, state, number, count)
        solved, shares = True, (0.0, 1.0)
        if count > 1:
            shares = second_step(first[0], first[1], rest, product, gamma)
        else:
            first[0], first[1] = rest, product
            if product > 0.0 and stop < np.inf:
                solved, kind, shares = False, _TAKE, (rest / product, 0.0)
        noted = doubles(table[number].shares, 2)
        noted[0], noted[1] = shares
    if not solved:
        before, after, _ = _sweep(table, state, kind, number, count)
        solved = kind == _TAKE and not after > stop * stop * before
    _sweep(table, state, _PUT_BACK if solved else _RESTRICT, number, count)
    return solved


@inner
def finish(table: Table, state: Integers, number: int, visit: int) -> tuple[float, float, float]:
    """Add the next level's answer, relax, and multiply; returns ``z.r``, ``z.w`` and ``z.s`` (`sweeps.finish`)."""
    kind = _FINISH
    if table[number].joined > 0:
        _sweep(table, state, _RELAX, number, visit)
        kind = _MULTIPLY
    return _sweep(table, state, kind, number, visit)


@inner
def begin(table: Table, state: Integers) -> None:
    """Restrict the finest level's relaxed residual."""
    for kind in (_CLEAR, _RESTRICT):
        _sweep(table, state, kind, ZERO, ZERO)
