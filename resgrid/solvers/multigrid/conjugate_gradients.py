"""Flexible conjugate gradients with residual replacement (Notay 2000; van der Vorst & Ye 2000), for grids and netlists.

Steps are taken in single precision, over the black cells of a grid or all rows of a netlist.  After a burst of at most
five digits the true residual is formed in double precision, and the next burst begins with it, search directions kept.
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
from resgrid.solvers.multigrid.hierarchy import GraphProblem, GridProblem, Hierarchy, Problem
from resgrid.solvers.progress import ProgressMonitor
from resgrid.solvers.scaled import Numbers, power
from resgrid.solvers.threads import ALONE, ThreadTeam

MOST_ITERATIONS = 200
LEAST_GAIN = 0.5
"""Factor by which the true residual must fall from burst to burst."""

ROUNDING = 2.0**-52
_TOLD = 5e-7
"""Gain below which the residual that recursion leaves is rounding of single precision."""

_BURST = 1e-5
"""Gain of a burst from its largest residual on: vectors in single precision allow no more."""

_SMOOTH = 0.1
"""Share of the residual allowed that a guess may leave: its error is smooth, and large beside its residual."""

_SAFETY, _NEARLY = 0.95, 1.6
"""Share of the goal that the recursive residual is brought to, and where a relaxation of red and black cells follows:
it halves the residual, for less than a step takes."""

_DRIFT = 2.0
"""By how much the true residual may exceed the recursive one, before the last direction is dropped."""

_FASTEST, _SLOWEST = 0.3, 0.95
"""Bounds on how much shorter the next step is expected to be, which two steps alone tell badly."""

_DOUBT = 10.0
"""By how much a step may go less far than its power lets expect."""

_PASS, _LEAST_PASS = 1e-15, 1e-2
"""By how much a pass of refinement lessens the residual: at most, and at least."""


_RANGE = 400
"""Powers of two between currents and conductances from which squares of voltages may be no doubles."""


def iterate(
    laplacian: Laplacian,
    hierarchy: Hierarchy,
    b: NDArray[np.float64],
    rtol: float,
    guess: NDArray[np.float64] | None = None,
    watch: ProgressMonitor | None = None,
    team: ThreadTeam = ALONE,
) -> tuple[NDArray[np.float64], float]:
    """Solve until the residual norm is ``rtol |b|``, or rounding forbids more; returns `x` (n,) and that norm.

    From a guess on, an error of at most ``rtol`` in every voltage, relative to the largest one, is enough too, as the
    steps tell it (after Hestenes & Stiefel 1952; Strakos & Tichy 2002).

    Shapes: `b` (n,), `guess` (n,).
    """
    unit, slot = hierarchy.unit, hierarchy.slot
    largest = _largest(b)
    binades = math.frexp(largest)[1] - math.frexp(unit)[1] if largest else 0
    if abs(binades) > _RANGE:
        small = np.ldexp(b, -binades), None if guess is None else np.ldexp(guess, -binades)
        x, size = iterate(laplacian, hierarchy, small[0], rtol, small[1], watch, team)
        with np.errstate(over="ignore"):
            return np.ldexp(x, binades), float(np.ldexp(size, binades))
    fed = b / unit
    wanted = rtol * krylov.norm(fed, team)
    problem: Problem
    if hierarchy.grid is None:
        problem = GraphProblem(laplacian, hierarchy, b, team)
    else:
        currents, x = np.zeros((2, 2, len(hierarchy.grid.aggregate)))
        currents.ravel()[slot] = fed
        problem = GridProblem(hierarchy.grid, hierarchy.levels, currents, x, team)
    del fed
    x = problem.x
    if guess is not None:
        x.ravel()[slot] = guess
    stop = Stop(wanted, ROUNDING * hierarchy.largest_degree / unit, unit, guess, rtol)
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
    team: ThreadTeam = ALONE,
) -> Numbers:
    """Up to fifteen digits of ``A^-1`` times scaled numbers, relative to the largest: an inverse for refinement."""
    top = 0
    if e.any() and m.any():
        top = int(e[m != 0].max())
        m = m * power(np.clip(e - top, -8, 0))
    largest = _largest(m)
    if not largest:
        return np.zeros_like(m), np.zeros_like(e)
    x, _ = iterate(laplacian, hierarchy, m / largest, min(max(accuracy, _PASS), _LEAST_PASS), None, watch, team)
    with np.errstate(over="ignore"):
        x *= largest
    return x, np.full_like(e, top)


class Stop:
    """When the iteration may end: by its residual, by rounding, or, from a guess on, by its error.

    A step lessens the square of the error's energy norm by ``(z.r)^2 / p.A p``.  How fast that falls tells how far
    the steps to come still go, as a geometric series that begins with this one.

    `wanted`: the norm of the residual that is small enough; `rounding`: what ``|x|`` is multiplied by for the one that
    rounding leaves, both in units of ``unit``, siemens; `guess` (n,): where the iteration begins, None for 0.
    """

    def __init__(
        self, wanted: float, rounding: float, unit: float = 1.0, guess: NDArray[np.float64] | None = None,
        rtol: float = 0.0,
    ) -> None:  # fmt: skip
        self.wanted, self.rounding, self.unit = wanted, rounding, unit
        self.guessed = guess is not None
        self.small = False
        self._near = 0.0 if guess is None else rtol * _largest(guess)
        self._last = 0.0
        self._far, self._then = 0.0, 1.0

    def goal(self, x: NDArray[np.float64] | None, *, first: bool) -> float:
        """The residual to reach; before any step, when the error may be large beside it, rounding excuses none."""
        if first:
            return _SMOOTH * self.wanted if self.guessed else self.wanted
        return self.wanted if x is None else max(self.wanted, self.rounding * krylov.norm(x.ravel()))

    def moved(self, power: float, far: Callable[[], float]) -> None:
        """A step has lessened the squared norm by so much; ``far`` tells the most it has moved a voltage.

        That is asked only where the steps' powers let expect that it is small, but for the first one.
        """
        if not self._near:
            return
        ratio = math.sqrt(power / self._last) if self._last > 0.0 else _SLOWEST
        ratio = min(max(ratio, _FASTEST), _SLOWEST)
        self._last = power
        ahead = ratio / (1.0 - ratio)
        if self._far * math.sqrt(power / self._then) * ahead <= _DOUBT * self._near:
            self._far, self._then = far(), power
            self.small = self._far * ahead <= self._near


def converge(problem: Problem, stop: Stop, watch: ProgressMonitor | None) -> float:
    """Improve the solution until the residual is small enough, or rounding forbids more; returns its norm, in units."""
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
        stop.small &= size <= max(_DRIFT * burst.left * last, goal)
        if stop.small or not (size > goal and size < LEAST_GAIN * last and left > 0):
            return size
        if first and watch is not None:
            watch.begin(size * stop.unit, goal * stop.unit)
        if size > _DRIFT * burst.left * last or burst.left < _TOLD:
            burst.forget()
        left -= burst.run(size, min(nearly * goal / size, _SAFETY), left)
        last = size


class _Burst:
    """Some steps; search directions outlive a burst.

    Vectors are in single precision, but for the answer: it is summed from the preconditioned residuals at the end,
    so that what the recursive residual stands for is known to all digits.  ``z[:kept]`` are those that are not yet part
    of it; their shares in the answer and in the direction are `on_x, on_p` (depth + 1,), last those of ``p``.
    """

    def __init__(self, problem: Problem, stop: Stop, watch: ProgressMonitor | None) -> None:
        self._problem, self._stop, self._watch = problem, stop, watch
        self._v = problem.vectors
        # Between bursts, the true residual stands where the last steps will be kept.
        self.residual = self._v.z[-2:].reshape(-1).view(np.float64)
        self.left = 1.0
        self._on_x, self._on_p = np.zeros((2, len(self._v.z) + 1))
        self._on_p[-1] = 1.0
        self._kept, self._energy = 0, 0.0

    def forget(self) -> None:
        """Drop the last direction: a residual that is not what recursion left is not orthogonal to it."""
        self._energy = 0.0

    def run(self, size: float, gain: float, most: int) -> int:
        """Reduce the residual, of norm ``size``, by a factor ``gain``; returns the steps taken."""
        v, steps = self._v, 0
        np.divide(self.residual, size, out=v.r, casting="same_kind")
        np.multiply(v.inverse, v.r, out=v.before)
        self.left = largest = 1.0
        while steps < most and not self._stop.small and self.left > max(gain, _BURST * largest):
            if not self._step(size):
                break
            largest = max(largest, self.left)
            steps += 1
            if self._watch is not None:
                self._watch.step(self.left * size * self._stop.unit)
        self._gather(size)
        return steps

    def _each(self, loop: Callable[[int, int], Any]) -> list[Any]:
        """Call a loop for all slots, piece by piece."""
        return self._problem.team.over(len(self._v.r), lambda some: loop(some.start, some.stop))

    def _gather(self, unit: float) -> None:
        """Go the steps kept: they become part of the solution, in units of ``unit``."""
        v, x = self._v, self._problem.x[-1]
        self._each(partial(krylov.add_steps, v.z[: self._kept], self._on_x, self._on_p, v.p, unit, x))
        self._on_x[:], self._on_p[:] = 0.0, 0.0
        self._on_p[-1] = 1.0
        self._kept = 0

    def _step(self, unit: float) -> bool:
        """``p = z + beta p``, ``x += alpha p``, ``r -= alpha A p``, ``z`` about ``A^-1 r``; whether there was one.

        There is none where the direction has no energy ``p.A p``.
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
            """Largest move of a voltage in this step."""
            return float(abs(alpha) * unit * krylov.largest_step(v.z[: self._kept], self._on_p, v.p))

        self._stop.moved(alpha * zr * unit * unit, move)
        if self._kept == len(v.z):
            self._gather(unit)
        squares = self._each(partial(krylov.advance, v.inverse, v.w, v.s, v.r, v.before, beta, alpha))
        self.left = math.sqrt(sum(squares))
        return True


def _largest(values: NDArray[np.float64]) -> float:
    """Largest magnitude."""
    return max(float(values.max(initial=0.0)), -float(values.min(initial=0.0)))
