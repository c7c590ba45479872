"""Flexible conjugate gradients with residual replacement (Notay 2000; van der Vorst & Ye 2000), for grids and netlists.

Iterations are in single precision, over the black cells of a grid or all rows of a netlist. After a burst of at most
five digits the residual is recomputed in double precision, and the next burst starts from it with the same search
directions.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.laplacian import Laplacian
from resgrid.solvers.multigrid import krylov
from resgrid.solvers.multigrid.hierarchy import GraphProblem, GridProblem, Hierarchy, MultigridProblem
from resgrid.solvers.progress import ProgressMonitor
from resgrid.solvers.scaled import Numbers, power
from resgrid.solvers.threads import SINGLE_THREAD, ThreadTeam

MOST_ITERATIONS = 200
"""Maximum number of iterations of a solve."""
LEAST_GAIN = 0.5
"""Ratio of the true residuals of two successive bursts of iterations above which the solve stops as stagnating."""

ROUNDING = 2.0**-52
"""Machine epsilon of double precision."""
_SINGLE = 5e-7
"""Relative residual below which the recursive residual is rounding error of single precision."""

_BURST = 1e-5
"""Ratio of the residual to its largest value within a burst (the iterations between two computations of the true
residual) at which the burst ends: single precision vectors gain nothing more."""

_SMOOTH = 0.1
"""Fraction of the target residual at which an initial guess is accepted: its error is smooth, hence large for its
residual."""

_SAFETY, _NEARLY = 0.95, 1.6
"""Ratios of the recursive residual to the target at which a burst ends, without and with a final relaxation.

A relaxation of red and black cells halves the residual and costs less than an iteration.
"""

_DRIFT = 2.0
"""Ratio of the true to the recursive residual above which the last search direction is dropped."""

_FASTEST, _SLOWEST = 0.3, 0.95
"""Bounds on the estimated convergence factor, which two iterations alone determine badly."""

_DOUBT = 10.0
"""Safety factor of the cheap estimate of the remaining error: only an estimate below this multiple of the tolerance is
replaced by a computed step length."""

_PASS, _LEAST_PASS = 1e-15, 1e-2
"""Smallest and largest relative residual that is requested of one pass of iterative refinement."""


_RANGE = 400
"""Rescale if the binary exponents of currents and conductances differ by more: squares of voltages could overflow."""


def iterate(
    laplacian: Laplacian,
    hierarchy: Hierarchy,
    b: NDArray[np.float64],
    rtol: float,
    guess: NDArray[np.float64] | None = None,
    watch: ProgressMonitor | None = None,
    threads: ThreadTeam = SINGLE_THREAD,
) -> tuple[NDArray[np.float64], float]:
    """Solve to a residual norm of ``rtol |b|``, or to the limit of rounding; returns `x` (n,) and the norm.

    With a guess the iteration also ends if the estimated error of every voltage is at most ``rtol`` times the largest
    voltage (after Hestenes & Stiefel 1952; Strakos & Tichy 2002).

    Shapes: `b` (n,), `guess` (n,).
    """
    unit, slot = hierarchy.unit, hierarchy.slot
    largest = _largest(b)
    binades = math.frexp(largest)[1] - math.frexp(unit)[1] if largest else 0
    if abs(binades) > _RANGE:
        rescaled = np.ldexp(b, -binades), None if guess is None else np.ldexp(guess, -binades)
        x, size = iterate(laplacian, hierarchy, rescaled[0], rtol, rescaled[1], watch, threads)
        with np.errstate(over="ignore"):
            return np.ldexp(x, binades), float(np.ldexp(size, binades))
    scaled_rhs = b / unit
    wanted = rtol * krylov.norm(scaled_rhs, threads)
    problem: MultigridProblem
    if hierarchy.grid is None:
        problem = GraphProblem(laplacian, hierarchy, b, threads)
    else:
        currents, x = np.zeros((2, 2, len(hierarchy.grid.aggregate)))
        currents.ravel()[slot] = scaled_rhs
        problem = GridProblem(hierarchy.grid, hierarchy.levels, currents, x, threads)
    del scaled_rhs
    x = problem.x
    if guess is not None:
        x.ravel()[slot] = guess
    stop = StoppingRule(wanted, ROUNDING * hierarchy.largest_degree / unit, unit, guess, rtol)
    size = converge(problem, stop, ProgressMonitor() if watch is None else watch)
    del problem
    return np.take(x.ravel(), slot), size * unit


def approximate(
    laplacian: Laplacian,
    hierarchy: Hierarchy,
    watch: ProgressMonitor | None,
    m: NDArray[np.float64],
    e: NDArray[np.int64],
    accuracy: float,
    threads: ThreadTeam = SINGLE_THREAD,
) -> Numbers:
    """Solve for scaled numbers with an error relative to the largest entry: the approximate inverse of refinement.

    `accuracy`: relative residual, limited to the range of a pass. Returns scaled numbers (n,).
    """
    top = 0
    if e.any() and m.any():
        top = int(e[m != 0].max())
        m = m * power(np.clip(e - top, -8, 0))
    largest = _largest(m)
    if not largest:
        return np.zeros_like(m), np.zeros_like(e)
    x, _ = iterate(laplacian, hierarchy, m / largest, min(max(accuracy, _PASS), _LEAST_PASS), None, watch, threads)
    with np.errstate(over="ignore"):
        x *= largest
    return x, np.full_like(e, top)


class StoppingRule:
    """Stopping criteria: residual norm, limit of rounding, and with a guess the estimated error.

    An iteration reduces the squared energy norm of the error by ``(z.r)^2 / p.A p``. The remaining change of the
    solution is estimated as a geometric series from the decrease of these reductions.

    `wanted`: sufficient residual norm; `rounding`: ratio of the residual that rounding leaves to ``|x|``, both in units
    of ``unit``, siemens; `guess` (n,): initial solution, None for 0; `rtol`: sufficient error relative to the largest
    guessed voltage. `accurate`: whether the estimated error is small enough.
    """

    def __init__(
        self, wanted: float, rounding: float, unit: float = 1.0, guess: NDArray[np.float64] | None = None,
        rtol: float = 0.0,
    ) -> None:  # fmt: skip
        self.wanted, self.rounding, self.unit = wanted, rounding, unit
        self.guessed = guess is not None
        self.accurate = False
        self._near = 0.0 if guess is None else rtol * _largest(guess)
        self._last = 0.0
        self._length, self._power_then = 0.0, 1.0

    def goal(self, x: NDArray[np.float64] | None, *, first: bool) -> float:
        """Return the target residual norm.

        Before the first iteration the error may be large in spite of a residual at the rounding limit: the limit then
        does not count.
        """
        if first:
            return _SMOOTH * self.wanted if self.guessed else self.wanted
        return self.wanted if x is None else max(self.wanted, self.rounding * krylov.norm(x.ravel()))

    def record(self, power: float, length: Callable[[], float]) -> None:
        """Record ``power``, the reduction of the error's squared energy norm by an iteration.

        ``length`` returns the largest change of a voltage by this iteration. It is called for the first iteration, and
        if the reductions suggest that the change is small.
        """
        if not self._near:
            return
        ratio = math.sqrt(power / self._last) if self._last > 0.0 else _SLOWEST
        ratio = min(max(ratio, _FASTEST), _SLOWEST)
        self._last = power
        ahead = ratio / (1.0 - ratio)
        if self._length * math.sqrt(power / self._power_then) * ahead <= _DOUBT * self._near:
            self._length, self._power_then = length(), power
            self.accurate = self._length * ahead <= self._near


def converge(problem: MultigridProblem, stop: StoppingRule, watch: ProgressMonitor | None) -> float:
    """Improve the solution until the rule is met or the residual stagnates; returns the residual norm, in units."""
    burst, x = _Burst(problem, stop, watch), problem.x
    last, left, nearly = np.inf, MOST_ITERATIONS, _NEARLY if problem.relaxes else _SAFETY
    while True:
        first = not math.isfinite(last)
        size = problem.residual(burst.residual)
        goal = stop.goal(None, first=first)
        if size > goal:
            goal = stop.goal(x, first=first)
        if not first and goal < size <= nearly * goal:
            x[-1] += problem.vectors.inverse * burst.residual
            burst.forget()
            size = problem.residual(burst.residual)
        stop.accurate &= size <= max(_DRIFT * burst.left * last, goal)
        if stop.accurate or not (size > goal and size < LEAST_GAIN * last and left > 0):
            return size
        if first and watch is not None:
            watch.begin(size * stop.unit, goal * stop.unit)
        if size > _DRIFT * burst.left * last or burst.left < _SINGLE:
            burst.forget()
        left -= burst.run(size, min(nearly * goal / size, _SAFETY), left)
        last = size


class _Burst:
    """Iterations between two evaluations of the true residual; search directions are kept across bursts.

    Vectors are in single precision, except for the solution. It is accumulated from the preconditioned residuals at the
    end of a burst, so that it matches the recursive residual to all digits. ``z[:kept]`` are the preconditioned
    residuals that are not accumulated yet. Their coefficients in the solution and in the search direction are `on_x,
    on_p` (depth + 1,), with those of ``p`` at the end.
    """

    def __init__(self, problem: MultigridProblem, stop: StoppingRule, watch: ProgressMonitor | None) -> None:
        self._problem, self._stop, self._watch = problem, stop, watch
        self._v = problem.vectors
        # Between bursts, the true residual stands where the last steps will be kept.
        self.residual = self._v.z[-2:].reshape(-1).view(np.float64)
        self.left = 1.0
        self._on_x, self._on_p = np.zeros((2, len(self._v.z) + 1))
        self._on_p[-1] = 1.0
        self._kept, self._energy = 0, 0.0

    def forget(self) -> None:
        """Drop the last search direction, since a replaced residual is not orthogonal to it."""
        self._energy = 0.0

    def run(self, size: float, gain: float, limit: int) -> int:
        """Reduce the residual norm ``size`` to ``gain size`` in at most ``limit`` iterations; returns their number."""
        v, steps = self._v, 0
        np.divide(self.residual, size, out=v.r, casting="same_kind")
        np.multiply(v.inverse, v.r, out=v.before)
        self.left = largest = 1.0
        while steps < limit and not self._stop.accurate and self.left > max(gain, _BURST * largest):
            if not self._step(size):
                break
            largest = max(largest, self.left)
            steps += 1
            if self._watch is not None:
                self._watch.step(self.left * size * self._stop.unit)
        self._gather(size)
        return steps

    def _each(self, kernel: Callable[[int, int], Any]) -> list[Any]:
        """Call a kernel for slices of all slots, on all threads; return its results."""
        return self._problem.threads.over(len(self._v.r), lambda some: kernel(some.start, some.stop))

    def _gather(self, unit: float) -> None:
        """Accumulate the kept steps in the solution, in units of ``unit``."""
        v, x = self._v, self._problem.x[-1]
        self._each(partial(krylov.add_steps, v.z[: self._kept], self._on_x, self._on_p, v.p, unit, x))
        self._on_x[:], self._on_p[:] = 0.0, 0.0
        self._on_p[-1] = 1.0
        self._kept = 0

    def _step(self, unit: float) -> bool:
        """Iterate once: ``p = z + beta p``, ``x += alpha p``, ``r -= alpha A p``; ``z`` is the preconditioned ``r``.

        Returns False, without a step, if the direction has no energy ``p.A p``.
        """
        v, problem = self._v, self._problem
        zr, zw, zs = problem.precondition(v.z[self._kept])
        beta = -zs / self._energy if self._energy > 0.0 else 0.0
        self._energy = zw + beta * zs
        if not self._energy > 0.0:
            return False
        alpha = zr / self._energy
        self._on_p *= beta
        self._on_p[self._kept] = 1.0
        self._on_x += alpha * self._on_p
        self._kept += 1

        def move() -> float:
            """Return the largest change of a voltage in this step."""
            return float(abs(alpha) * unit * krylov.largest_step(v.z[: self._kept], self._on_p, v.p))

        self._stop.record(alpha * zr * unit * unit, move)
        if self._kept == len(v.z):
            self._gather(unit)
        squares = self._each(partial(krylov.advance, v.inverse, v.w, v.s, v.r, v.before, beta, alpha))
        self.left = math.sqrt(sum(squares))
        return True


def _largest(values: NDArray[np.float64]) -> float:
    """Return the largest magnitude."""
    return max(float(values.max(initial=0.0)), -float(values.min(initial=0.0)))
