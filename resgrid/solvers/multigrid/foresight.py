"""What a potential will be like, from coarse to fine: nested iteration, in which all numbers stay positive.

On a level that is small the equations are solved directly.  Then, level by level, the answer is spread over the blocks
and made better by a multiplicative cycle (Horton & Leutenegger 1994): it is relaxed, the level is put in proportion to
it, and the coarse equations, whose answer is 1 where it is right, tell by what the blocks are multiplied.  Sums know of
proportions only, so that what lies behind a gap, lower by twenty decades, is put right as quickly as all else.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.solvers.multigrid import grade_kernels
from resgrid.solvers.multigrid.boards import Level, in_double, to_graph
from resgrid.solvers.multigrid.coarsening import Coarsened
from resgrid.solvers.multigrid.graded import Gradable, cut_off, summed, transformed
from resgrid.solvers.superlu import symmetric_factors

_SMALL = 4000
"""Nodes up to which a level is solved directly."""

_SWEEPS = 3


def foresee(levels: Gradable, currents: NDArray[np.float64]) -> NDArray[np.float64]:
    """About what the potential will be.  Shapes: `currents` (2, places); returns (2, places)."""
    steps, into = levels.steps, [_into_blocks(levels.steps[0], currents)]
    while steps[len(into) - 1].level.size > _SMALL and len(into) < len(steps):
        into.append(_into_blocks(steps[len(into)], into[-1]))
    coarse = _solved(steps[len(into) - 1].level, into[-1])
    for k in reversed(range(1, len(into))):
        level = steps[k - 1].level
        coarse = _improved(level, steps[k:], into[k - 1], _spread(level, steps[k], coarse))
    x = _spread(levels.level, steps[0], coarse)
    grade_kernels.smooth(levels.first[0], currents, x, _SWEEPS)
    return x


def _into_blocks(
    step: Coarsened, currents: NDArray[np.float64], weight: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Currents, times a weight, into the blocks."""
    fed = np.flatnonzero(currents)
    amps = currents.ravel()[fed] if weight is None else currents.ravel()[fed] * weight.ravel()[fed]
    summed = np.bincount(step.whole_target.ravel()[fed], amps, 2 * step.level.lattice.places)
    return np.asarray(summed.reshape(2, -1), dtype=np.float64)


def _spread(level: Level, step: Coarsened, coarse: NDArray[np.float64]) -> NDArray[np.float64]:
    """A coarse potential, spread over its blocks."""
    x = coarse.ravel()[step.whole_target]
    x[level.degree == 0.0] = 0.0
    return x


def _improved(
    level: Level, steps: list[Coarsened], currents: NDArray[np.float64], x: NDArray[np.float64]
) -> NDArray[np.float64]:
    """A potential made better by one multiplicative cycle down the steps; ``x`` is used up."""
    if not steps:
        return _solved(level, currents)
    step, board = steps[0], in_double(replace(level, degree=level.degree.copy()))
    grade_kernels.smooth(board, currents, x, _SWEEPS)
    x = cut_off(x, level.degree > 0.0)
    below = summed(transformed(level, board, x), step, fed=True)
    ones = (below.degree > 0.0).astype(np.float64)
    factor = _improved(below, steps[1:], _into_blocks(step, currents, x), ones)
    factor[~(factor > 0.0)] = 1.0
    x *= factor.ravel()[step.whole_target]
    grade_kernels.smooth(board, currents, x, _SWEEPS)
    return x


def _solved(level: Level, currents: NDArray[np.float64]) -> NDArray[np.float64]:
    """Potential by sparse factors."""
    graph, number = to_graph(level)
    n, used = graph.size, np.flatnonzero(number >= 0)
    coupling = sparse.csr_array((graph.conductance, graph.indices, graph.indptr), shape=(n, n))
    matrix = sparse.diags_array(coupling.sum(axis=1) + graph.leak) - coupling
    potential = np.zeros(number.size)
    potential[used] = symmetric_factors(matrix).solve(currents.ravel()[used])
    return potential.reshape(currents.shape)
