"""Flexible conjugate gradients with residual replacement (Notay 2000; van der Vorst & Ye 2000), for grids and netlists.

Iterations are in single precision, over the black cells of a grid or all rows of a netlist. A burst is a sequence of
iterations that reduces the residual by at most five digits. After each burst the residual is recomputed in double
precision, and the next burst starts from it with the same search directions.
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
"""Maximum number of iterations of a solve, summed over all bursts."""
LEAST_GAIN = 0.5
"""Ratio of the true residual norms after and before a burst of iterations above which the solve stops as stagnating."""

ROUNDING = 2.0**-52
"""Machine epsilon of double precision."""
_SINGLE = 5e-7
"""Recursive residual norm, relative to the begin of a burst of iterations, below which the residual is rounding error.

The recursive residual is the one that each iteration updates in single precision. The next burst then starts without
the last search direction.
"""

_BURST = 1e-5
"""Ratio of the residual norm to the largest one within a burst at which the burst ends.

A burst consists of the iterations between two computations of the true residual. Vectors in single precision are too
inaccurate for a larger reduction.
"""

_SMOOTH = 0.1
"""Fraction of the target residual norm at which an initial guess is accepted without iterations.

It is small because the error of a guess is smooth, and therefore large for its residual.
"""

_SAFETY, _NEARLY = 0.95, 1.6
"""Ratios of the recursive residual norm to the target norm at which a burst ends, without and with a final relaxation.

The recursive residual is the one that the iterations update. A relaxation of red and black cells halves the residual
and costs less than an iteration.
"""

_DRIFT = 2.0
"""Ratio of the true to the recursive residual norm above which the next burst starts without the last search direction.

The recursive residual is the one that the iterations update; the true one is recomputed from the solution.
"""

_FASTEST, _SLOWEST = 0.3, 0.95
"""Limits to which the estimated convergence factor per iteration is clipped; two iterations alone determine it badly.
"""

_DOUBT = 10.0
"""Multiple of the tolerance of the error below which the estimate of the remaining error is recomputed.

The cheap estimate extrapolates an earlier largest change of a voltage. Once it is at most this multiple of the
tolerance, the largest change in the last iteration is computed, which needs all stored search directions.
"""

_PASS, _LEAST_PASS = 1e-15, 1e-2
"""Smallest and largest relative residual norm that iterative refinement may request of one solve."""


_RANGE = 400
"""Difference of binary exponents above which the currents are rescaled, since squares of voltages could overflow.

The exponents are those of the largest current in amperes and of the conductance ``hierarchy.unit`` in siemens; the
magnitude of their difference counts.
"""


def iterate(
    laplacian: Laplacian,
    hierarchy: Hierarchy,
    b: NDArray[np.float64],
    rtol: float,
    guess: NDArray[np.float64] | None = None,
    watch: ProgressMonitor | None = None,
    threads: ThreadTeam = SINGLE_THREAD,
) -> tuple[NDArray[np.float64], float]:
    """Return the solution (n,) in volts, and its residual norm in amperes.

    The iteration ends at the residual norm ``rtol |b|``, at the limit of rounding, or above both if it stagnates or
    after `MOST_ITERATIONS`; the caller checks the returned norm. With a guess it also ends if the estimated error of
    every voltage is at most ``rtol`` times the largest magnitude of a voltage of the guess (after Hestenes & Stiefel
    1952; Strakos & Tichy 2002).

    `hierarchy`: multigrid levels of the matrix `laplacian`; `b` (n,): right-hand side in amperes; `rtol`: relative
    residual norm; `guess` (n,): initial solution in volts, None for 0; `watch`: records iterations, and can cancel
    them; None for neither; `threads`: share the work.
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
    """Return a solution with an error that is small relative to its largest magnitude, in numbers with own exponents.

    The function is the approximate inverse of iterative refinement. Every number is ``mantissa * 2**(256 * exponent)``.
    Its results are in volts for right-hand sides in amperes.

    `laplacian, hierarchy`: the matrix and its multigrid levels; `watch`: records iterations, None for no record; `m, e`
    (n,): mantissas and exponents of the right-hand side; `accuracy`: requested relative residual norm, raised to 1e-15
    or lowered to 1e-2 beyond these limits; `threads`: share the work. The result is a tuple of mantissas and exponents,
    (n,) each.
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

    An iteration reduces the squared energy norm of the error by ``(z.r)^2 / p.A p``, with residual ``r``,
    preconditioned residual ``z`` and search direction ``p``. The remaining change of the solution is estimated as a
    geometric series from the decrease of these reductions.

    `unit`: conductance in siemens by which all equations are divided; `wanted`: sufficient residual norm, in amperes
    divided by `unit`; `rounding`: rounding error of the residual norm per ``|x|``, in siemens divided by `unit`;
    `guess` (n,): initial solution in volts, None for 0; `rtol`: sufficient error relative to the largest guessed
    voltage, 0 to disable this criterion, as does ``guess=None``. `accurate`: whether the estimated error is small
    enough.
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
        """Return the target residual norm, in amperes divided by `unit`.

        `x`: present solution in volts, None to ignore the limit of rounding; `first`: whether no iteration has been
        made. Before the first iteration the error may be large in spite of a residual at the limit of rounding, and
        this limit does not count.
        """
        if first:
            return _SMOOTH * self.wanted if self.guessed else self.wanted
        return self.wanted if x is None else max(self.wanted, self.rounding * krylov.norm(x.ravel()))

    def record(self, power: float, length: Callable[[], float]) -> None:
        """Record the reduction of the error by an iteration, and set `accurate` if the estimated error is small enough.

        `power`: reduction of the squared energy norm of the error; `length`: function that returns the largest
        magnitude of a change of a voltage by this iteration, in volts. The function is called for the first iteration,
        and whenever the reductions suggest that the remaining change is at most 10 times the tolerance. Nothing is done
        without a guess.
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
    """Improve ``problem.x`` until a stopping rule is met or the residual stagnates; return the final residual norm.

    A burst is a sequence of iterations between two computations of the true residual. The residual stagnates if a burst
    gains less than a factor of 2; at most 200 iterations are made.

    The norm is in amperes divided by ``stop.unit``. `problem`: equations, solution and preconditioner; `stop`: stopping
    rule; `watch`: records iterations, and can cancel them; None for neither.
    """
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
    """Iterations between two evaluations of the true residual; search directions are kept from burst to burst.

    Vectors are in single precision, except for the solution. The solution is accumulated from the preconditioned
    residuals at the end of a burst, so that it matches the recursive residual (updated by the iterations) to all
    digits.

    `problem`: equations, solution and preconditioner; `stop`: stopping rule; `watch`: records iterations, None for no
    record. `residual` (n,): true residual between bursts, in double precision; `left`: recursive residual norm relative
    to the begin of the burst.

    Private fields: ``_v.z[:_kept]`` are the preconditioned residuals that are not accumulated yet; ``_on_x, _on_p``
    (largest number of such residuals plus 1,) are their coefficients in the solution and in the search direction; the
    last entry of each is the coefficient of ``_v.p``, the search direction before these residuals; ``_energy`` is
    ``p.A p`` of the last direction, 0 for none.
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
        """Drop the last search direction; it is not conjugate to directions that start from a recomputed residual."""
        self._energy = 0.0

    def run(self, size: float, gain: float, limit: int) -> int:
        """Reduce the residual norm from ``size`` to ``gain * size`` within ``limit`` iterations; return their number.

        ``size`` is the norm of the true residual in amperes, divided by ``hierarchy.unit`` in siemens. The iterations
        end earlier if the norm is 1e-5 of its largest value in the burst, if the estimated error is small enough, or if
        an iteration fails.
        """
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
        """Return the results of ``kernel(begin, end)`` for the ranges of vector entries that the threads process.

        The ranges cover all entries; the results are in the order of the ranges.
        """
        return self._problem.threads.over(len(self._v.r), lambda some: kernel(some.start, some.stop))

    def _gather(self, unit: float) -> None:
        """Add the stored preconditioned residuals, with their coefficients times ``unit``, to the solution.

        `unit`: norm of the residual at the first iteration after the last recomputation of the residual; the stored
        vectors are divided by this norm.
        """
        v, x = self._v, self._problem.x[-1]
        self._each(partial(krylov.add_steps, v.z[: self._kept], self._on_x, self._on_p, v.p, unit, x))
        self._on_x[:], self._on_p[:] = 0.0, 0.0
        self._on_p[-1] = 1.0
        self._kept = 0

    def _step(self, unit: float) -> bool:
        """Make one iteration of conjugate gradients; return whether it succeeded.

        It fails, without a step, if ``p.A p`` is not positive. The iteration is ``p = z + beta p``, ``x += alpha p``,
        ``r -= alpha A p``, where ``z`` is the preconditioned residual ``r``. `unit`: norm of the residual after the
        last recomputation from the solution, by which the vectors are divided.
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
            """Return the largest magnitude of a change of a voltage in this step, in volts."""
            return float(abs(alpha) * unit * krylov.largest_step(v.z[: self._kept], self._on_p, v.p))

        self._stop.record(alpha * zr * unit * unit, move)
        if self._kept == len(v.z):
            self._gather(unit)
        squares = self._each(partial(krylov.advance, v.inverse, v.w, v.s, v.r, v.before, beta, alpha))
        self.left = math.sqrt(sum(squares))
        return True


def _largest(values: NDArray[np.float64]) -> float:
    """Return the largest magnitude of an entry of ``values``; 0 for an empty array."""
    return max(float(values.max(initial=0.0)), -float(values.min(initial=0.0)))
