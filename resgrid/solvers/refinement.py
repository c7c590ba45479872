"""Refinement of scaled double-doubles: from an approximate inverse to an answer that is right entry by entry.

The residual is computed with differences first, relative to the currents at each node, so that every pass gains the
digits of the approximate inverse wherever it is any good.  It ends where a bound on the error of every entry is proved,
or where nothing is left to gain.

The bound: a row that violates KCL by a share ``e_i`` of its currents is right for conductances that differ by no more
than that share.  By the matrix-tree theorem every entry of ``A^-1`` is a ratio of sums of products, positive all of
them, in which each row has one conductance above and one below at most.  So every entry of ``A^-1 b``, be it the
smallest, is off by a share of at most ``2 sum_i e_i`` (for shares that are all alike: O'Cinneide 1993).

Coarse levels see little of slits, along which the potential falls by decades within a few cells, and every pass gains
some fifteen decades.  Where what it leaves is larger than the potential itself, and rows are few, it is found there
directly from what flows in, all decades at once: every number is positive.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.laplacian import Graph, Laplacian
from resgrid.solvers.scaled import NOISE, Floats, Integers, Numbers, Scaled, canonical, logarithm, power
from resgrid.solvers.threads import ALONE, ThreadTeam

_CONVERGED = 1e-12
"""Componentwise backward error up to which an answer is one, whatever is proved of its entries."""

CERTAIN = 1e-9
"""Errors relative to the largest value that need no closer look."""

_MOST_STEPS = 60
_LEAST_GAIN = 0.5

_ALLOWED = 2e-9
"""Violations of KCL, summed over the rows that are not right, that refinement leaves: entries are right to 4e-9, and to
the rounding of the rows' sums, some 4e-9 for a million rows."""

_MARGIN = 0.03
"""Share of what is allowed that the last pass aims at."""

_HOPELESS = 1e-4
"""Componentwise backward error above which some voltages have few digits right, or none."""

_PROVED = 1e-6
"""Bound on the errors of entries up to which an answer is one, whatever its backward error."""

_DIFFERENCE = 4.0
"""Errors that two values may be off by where hardly any current flows, in units of the floor: less is noise."""

_FLAT = 1e-14
"""Share of currents in ``(b + |A| |x|)_i`` below which they may be what rounding leaves of none."""

_STEPS, _FEWEST_STEPS, _LEAST = 8, 2, 128
"""Steps around a row that are solved for with it, fewer where half of what is allowed is reached; more up to a share of
all rows, one in so many: along a slit all that lies below changes with what lies above."""

_MOST, _MOST_OF_PLANE, _SHARE = 20_000, 100_000, 10
"""Rows that are solved directly, at most: so many, on a plane more, or one in so many of all."""

Approximation = Callable[[Floats, Integers, float], Numbers]
"""About ``A^-1`` times scaled numbers, right to a share (the third argument) of the largest; may be better."""


class Refined(NamedTuple):
    """An answer and what it is worth.

    `solution` (n,): voltages in volts; `error`: componentwise backward error; `bound`: no voltage is off by a larger
    share of itself.
    """

    solution: Scaled
    error: float
    bound: float


class Imbalance(NamedTuple):
    """How far KCL is from holding.

    `backward`: componentwise backward error ``max |r_i| / (b + |A| |x|)_i`` (Oettli & Prager 1964); `left`: sum of the
    violations of rows that are not right, each relative to the currents at its row; `right`: that of all other rows,
    those below ``floor`` times ``(b + |A| |x|)_i`` among them, and what rounding may hide; `share`: smallest ratio of
    a row's currents to ``(b + |A| |x|)_i``; `log_size`: natural logarithm of the largest residual.
    """

    backward: float = np.inf
    left: float = np.inf
    right: float = np.inf
    share: float = 0.0
    log_size: float = np.inf

    def plus(self, rest: Imbalance) -> Imbalance:
        """Together with other rows."""
        return Imbalance(
            max(self.backward, rest.backward), self.left + rest.left, self.right + rest.right,
            min(self.share, rest.share), max(self.log_size, rest.log_size),
        )  # fmt: skip


def entry_bound(violation: float) -> float:
    """Share of itself by which an entry is off, at most, from the sum of all rows' violations of KCL."""
    return float(np.expm1(2.0 * violation / (1.0 - violation))) if violation < 0.1 else np.inf


def is_answer(error: float, bound: float) -> bool:
    """Whether a componentwise backward error, or a bound on the error of every entry, tells of an answer."""
    return error <= _CONVERGED or bound <= _PROVED


def refine(
    laplacian: Laplacian,
    rhs: Floats | Scaled,
    approximate: Approximation,
    floor: float,
    *,
    exact: bool = False,
    sure: float = np.inf,
    anew: bool = False,
    team: ThreadTeam = ALONE,
) -> Refined:
    """Solve for a right-hand side without negative entries.  Shapes: `rhs` (n,).

    With ``exact``, or where hardly any current flows, the residual is formed in double-double: answers are then the
    nearest doubles.  An entry of the first approximation is off by a share of at most ``sure``: a correction by more is
    what rounding leaves where conductances differ by more decades than double-doubles hold.  Rows without a digit are
    found ``anew`` where they are few.
    """
    matrix, current = laplacian.graph, scaled_currents(rhs)
    residual = current[0].copy(), current[1].copy()
    x, best, left = Scaled.of(np.zeros(laplacian.size)), Imbalance(), np.inf
    for step in range(1, _MOST_STEPS + 1):
        hopeless = not exact and _HOPELESS < best.backward < np.inf
        some = few_rows(laplacian, residual[0], x, current) if anew and hopeless else None
        new = some or corrected(x, *approximate(*residual, _MARGIN / left))
        if step > 1 and np.isfinite(sure) and _moves(x, new, sure):
            break
        if not exact:
            # More at every step: on the verge of a bound that stands still, rows would come and go, and what they stir
            # up would drown others that are smaller by many decades.
            kept = 1.0 if step == 1 else 4.0 * step
            found = imbalance(matrix, current, new, residual, floor=floor, kept=kept, team=team)
            now = found.left / _ALLOWED
            if now <= 1.0 and found.share <= _FLAT:
                exact, best = True, Imbalance()
        if exact:
            found = imbalance(matrix, current, new, residual, exact=True, team=team)
            now = found.backward / floor
        gains = found.backward < _LEAST_GAIN * best.backward or found.log_size < best.log_size + np.log(_LEAST_GAIN)
        if not gains:  # or there are numbers that are none
            if some is None:
                x = new if step == 1 else x  # beyond the range of doubles, which is told where it is read
                break
            anew = False
        x, best, left = new, found, now
        if left <= 1.0:
            break
    noise = max(NOISE, _DIFFERENCE * floor)
    return Refined(x._replace(noise=noise), float(best.backward), entry_bound(best.left + best.right))


def imbalance(
    matrix: Graph,
    current: Numbers,
    x: Scaled,
    out: Numbers,
    *,
    exact: bool = False,
    floor: float = 0.0,
    kept: float = 1.0,
    team: ThreadTeam = ALONE,
) -> Imbalance:
    """Residual of KCL into ``out``, as `resgrid.solvers.scaled_kernels.residual`; piece by piece."""
    from resgrid.solvers.scaled_kernels import residual

    plain = not (x.exponent.any() or current[1].any())

    def some(rows: slice) -> Imbalance:
        return Imbalance(*residual(matrix, current, x, rows.start, rows.stop, plain, exact, floor, kept, out))

    return reduce(Imbalance.plus, team.over(len(x.hi), some))


def _moves(x: Scaled, new: Scaled, share: float) -> bool:
    """Whether a correction changes an entry by more than such a share."""
    with np.errstate(invalid="ignore"):
        moved = np.abs(new.hi * power(new.exponent - x.exponent)) - np.abs(x.hi)
    return not np.all(np.abs(moved) <= share * np.abs(x.hi))


def corrected(x: Scaled, m: Floats, e: Integers) -> Scaled:
    """Values with a correction.  Shapes: `m, e` (n,)."""
    from resgrid.solvers.scaled_kernels import correct

    new = Scaled(np.empty_like(x.hi), np.empty_like(x.lo), np.empty_like(x.exponent))
    correct(x, m, e, new)
    return new


def scaled_currents(rhs: Floats | Scaled) -> Numbers:
    """Currents as canonical scaled numbers of their own; ``lo`` is left out."""
    given = rhs if isinstance(rhs, Scaled) else Scaled.of(np.asarray(rhs, dtype=np.float64))
    current, scale = given.hi.copy(), given.exponent.copy()
    canonical(current, scale)
    return current, scale


def minus(a: Scaled, b: Scaled) -> Scaled:
    """``a - b``; all of shape (n,)."""
    return corrected(corrected(a, -b.hi, b.exponent), -b.lo, b.exponent)


def quotient(parts: list[Scaled], x: Scaled) -> float:
    """The largest value of any part relative to that of ``x``; 0 where all parts vanish."""
    largest, *logs = (logarithm(np.abs(each.hi), each.exponent).max(initial=-np.inf) for each in (x, *parts))
    with np.errstate(over="ignore"):
        return 0.0 if max(logs) == -np.inf else float(np.exp(max(logs) - largest))


def few_rows(laplacian: Laplacian, left: Floats, x: Scaled, current: Numbers) -> Scaled | None:
    """Values of which those of the rows left, and of some around, are found from all others; None for too many rows.

    What the others feed into them is the residual where their own voltages are 0.

    Shapes: `left` (n,): 0 in rows that are right.
    """
    from resgrid.solvers.supernodal import factor_supernodes

    around = _around(laplacian, left != 0.0)
    if around is None:
        return None
    fed = np.zeros_like(x.hi), np.zeros_like(x.exponent)
    imbalance(laplacian.graph, current, Scaled(np.where(around, 0.0, x.hi), fed[0].copy(), x.exponent), fed)
    new, within = Scaled(x.hi.copy(), np.where(around, 0.0, x.lo), x.exponent.copy()), laplacian.within(around)
    new.hi[around], new.exponent[around] = factor_supernodes(within).substitute(fed[0][around], fed[1][around])
    return new


def _around(laplacian: Laplacian, rows: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
    """Some rows, and all that are few steps away; None for too many.  Shapes: `rows` (n,); returns (n,)."""
    plane = laplacian.grid is not None and laplacian.dimensions == 2
    most, edge = min(_MOST_OF_PLANE if plane else _MOST, laplacian.size // _SHARE), np.flatnonzero(rows)
    seen, count, steps = rows.copy(), len(edge), 0
    while len(edge) and count <= most:
        if steps >= (_STEPS if 2 * count < most else _FEWEST_STEPS) and count >= laplacian.size // _LEAST:
            break
        around = laplacian.edges[edge].indices
        edge = np.unique(around[~seen[around]])
        seen[edge] = True
        count, steps = count + len(edge), steps + 1
    return seen if 0 < count <= most else None
