"""Flexible conjugate gradients over the rows of a netlist that is no grid.

They run in the order of the first level, over its conductances in single precision, in bursts: after each the true
residual is formed from the true conductances, and the next begins with it, search directions kept.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.laplacian import Laplacian
from resgrid.solvers.monitor import Watch
from resgrid.solvers.multigrid import graph_kernels as passes
from resgrid.solvers.multigrid.kernels import Stack, cycle, norm
from resgrid.solvers.multigrid.ordering import inverse_of
from resgrid.solvers.multigrid.stack import own_work
from resgrid.solvers.multigrid.stopping import DRIFT, LEAST_GAIN, MOST_ITERATIONS, ErrorBound, largest
from resgrid.solvers.multigrid.subnormals import subnormals_as_zero

_BURST = 1e-5
_ROUNDING = 2.0**-52
_ENOUGH = 0.15
"""Residual after the first step of a K-cycle that spares the second."""


def iterate_on_graph(
    laplacian: Laplacian,
    stack: Stack,
    unit: float,
    b: NDArray[np.float64],
    rtol: float,
    guess: NDArray[np.float64] | None,
    watch: Watch,
) -> tuple[NDArray[np.float64], float]:
    """As `resgrid.solvers.multigrid.iteration.iterate`, over the rows of a netlist; ``unit`` is the hierarchy's."""
    error = ErrorBound(guess, rtol)
    burst = _Burst(stack, laplacian.ground[stack.order] / unit, unit, error, watch)
    residual = partial(passes.residual_in_order, *matrix_rows(laplacian), inverse_of(stack.order))
    x, last, left = np.zeros(len(b)) if guess is None else guess.copy(), np.inf, MOST_ITERATIONS
    wanted, rounding = rtol * norm(b), _ROUNDING * float(laplacian.diagonal.max(initial=0.0))
    while True:
        at_zero = guess is None and not math.isfinite(last)
        size = passes.put_in_order(stack.order, b, burst.r) if at_zero else residual(b, x, burst.r)
        goal = max(wanted, rounding * norm(x))
        error.small &= size <= max(DRIFT * burst.left * last, goal)
        if error.small or not (size > goal and size < LEAST_GAIN * last and left > 0):
            return x, size
        if not math.isfinite(last):
            watch.begin(size, goal)
        left -= burst.run(size, max(_BURST, 0.95 * goal / size), left)
        passes.add_in_order(stack.order, burst.x, size / unit, x)
        last = size


class _Burst:
    """Some steps from a residual of norm 1; search directions outlive a burst."""

    def __init__(self, stack: Stack, leak: NDArray[np.float64], unit: float, error: ErrorBound, watch: Watch) -> None:
        n = len(leak)
        self._stack, self._leak = own_work(stack), leak
        self._b, self._z = self._stack.b[:n], self._stack.x[:n]
        self.r, self.x, self._p, self._s, self._w = np.zeros((5, n))
        self._energy = 0.0
        self._error, self._watch, self._unit = error, watch, unit
        self.left = 1.0

    def run(self, size: float, gain: float, most: int) -> int:
        """Reduce ``r``, of norm ``size``, by a factor ``gain``; ``size x`` corrects it; returns the steps taken."""
        self.x[:] = 0.0
        self.r /= size
        self.left, steps = 1.0, 0
        # What recursion leaves is orthogonal to the last direction, the true residual is not.  BLAS would take threads.
        along = float(np.einsum("i,i", self._p, self.r))
        while self.left > gain and steps < most and not self._error.small:
            passes.put_scaled(self.r, self.left, self._b)
            with subnormals_as_zero():
                cycle(self._stack, _ENOUGH, 1)
            zr, zw, zs = passes.multiply(self._stack, self._leak, self.r, self._s, self._w)
            beta = -zs / self._energy if self._energy > 0.0 else 0.0
            self._energy = zw + beta * zs
            if not self._energy > 0.0:
                break
            step, along = (zr + beta * along) / self._energy, 0.0
            self.left = math.sqrt(passes.advance(self._z, self._w, self._p, self._s, self.x, self.r, beta, step))
            self._error.moved(zr * step * size * size, partial(self._step, abs(step) * size / self._unit))
            self._watch.step(self.left * size)
            steps += 1
        return steps

    def _step(self, factor: float) -> float:
        """Largest move of a voltage, so many times that of the last direction."""
        return factor * largest(self._p)


def matrix_rows(
    laplacian: Laplacian,
) -> tuple[NDArray[np.uint32], NDArray[np.uint32], NDArray[np.float64], NDArray[np.float64]]:
    """The nodal matrix in compressed rows, with indices that need no sign."""
    rows = laplacian.rows
    return rows.indptr.view(np.uint32), rows.indices.view(np.uint32), rows.data, laplacian.ground
