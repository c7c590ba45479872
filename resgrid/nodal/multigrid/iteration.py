"""Flexible conjugate gradients (Notay 2000), preconditioned by one cycle of the hierarchy.

On a grid the iteration runs on the black cells alone, over conductances in single precision, in bursts: after each
the true residual is formed from the true conductances, and the next begins with it, search directions kept.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from resgrid.nodal.multigrid import checkerboard_kernels as passes
from resgrid.nodal.multigrid import kernels
from resgrid.nodal.multigrid.checkerboard_kernels import Board
from resgrid.nodal.multigrid.hierarchy import Hierarchy
from resgrid.nodal.multigrid.kernels import Stack
from resgrid.nodal.system import NodalSystem
from resgrid.nodal.watch import Watch

_MOST_ITERATIONS = 200
_BURST = 1e-5
_LEAST_GAIN = 0.5
_ROUNDING = 2.0**-52
_FASTEST, _SLOWEST = 0.3, 0.95
"""Bounds on how much shorter the next step is expected to be, which two steps alone tell badly."""

_DRIFT = 2.0
"""By how much the true residual may exceed the recursive one where the iteration has ended on its error."""

_ENOUGH = 0.25
"""Residual after the first step of a K-cycle that spares the second."""


def iterate(
    system: NodalSystem,
    hierarchy: Hierarchy,
    b: NDArray[np.float64],
    rtol: float,
    guess: NDArray[np.float64] | None = None,
    watch: Watch | None = None,
) -> tuple[NDArray[np.float64], float]:
    """Solve until the residual norm is ``rtol |b|``, or rounding forbids more.

    From a guess on, an error of at most ``rtol`` in every voltage, relative to the largest one, is enough too, as the
    steps tell it (after Hestenes & Stiefel 1952; Strakos & Tichy 2002).

    Parameters
    ----------
    system : NodalSystem
    hierarchy : Hierarchy
    b : ndarray of float64, shape (n,)
        Currents in amperes.
    rtol : float
    guess : ndarray of float64, shape (n,), optional
        Where to begin, in volts.
    watch : Watch, optional
        Told every step.

    Returns
    -------
    x : ndarray of float64, shape (n,)
        Voltages in volts.
    residual : float
        Norm of the true residual, in amperes.
    """
    watch = Watch() if watch is None else watch
    if hierarchy.board is None:
        return _iterate_on_graph(system, hierarchy, b, rtol, guess, watch)
    return _iterate_on_board(system, hierarchy, hierarchy.board, b, rtol, guess, watch)


class _Error:
    """Judges from the steps of conjugate gradients whether the error is small enough already.

    A step lessens the square of the error's energy norm by ``(z.r)^2 / p.A p``.  How fast that falls tells how far
    the steps to come still go, as a geometric series that begins with this one.
    """

    def __init__(self, guess: NDArray[np.float64] | None, rtol: float) -> None:
        self.small = False
        self._near = 0.0 if guess is None else rtol * _largest(guess)
        self._last = 0.0

    def moved(self, direction: NDArray[np.float64], factor: float, power: float) -> None:
        """A step has gone ``factor`` times a direction, and has lessened the squared norm by so much."""
        if not self._near:
            return
        ratio = math.sqrt(power / self._last) if self._last > 0.0 else _SLOWEST
        ratio = min(max(ratio, _FASTEST), _SLOWEST)
        self._last = power
        self.small = abs(factor) * _largest(direction) * ratio / (1.0 - ratio) <= self._near


def _largest(values: NDArray[np.float64]) -> float:
    return max(float(values.max(initial=0.0)), -float(values.min(initial=0.0)))


def _iterate_on_board(
    system: NodalSystem,
    hierarchy: Hierarchy,
    board: Board,
    b: NDArray[np.float64],
    rtol: float,
    guess: NDArray[np.float64] | None,
    watch: Watch,
) -> tuple[NDArray[np.float64], float]:
    error = _Error(guess, rtol)
    burst = _Burst(hierarchy, board, error, watch)
    matrix = (*_rows(system), 1.0 / system.degree, hierarchy.place, hierarchy.reach)
    x, last, left = np.zeros(len(b)) if guess is None else guess.copy(), np.inf, _MOST_ITERATIONS
    wanted, rounding = rtol * kernels.norm(b), _ROUNDING * float(system.degree.max(initial=0.0))
    while True:
        size = passes.black_residual(*matrix, b, x, burst.r)
        goal = max(wanted, rounding * kernels.norm(x))
        error.small &= size <= max(_DRIFT * burst.left * last, goal)
        if error.small or not (size > goal and size < _LEAST_GAIN * last and left > 0):
            return x, size
        if not math.isfinite(last):
            watch.begin(size, goal)
        left -= burst.run(size, max(_BURST, 0.8 * goal / size), left)
        passes.add_black(hierarchy.place, burst.x, size / hierarchy.unit, x)
        last = size


class _Burst:
    """Some steps on the black cells, from a residual of norm 1; search directions outlive a burst."""

    def __init__(self, hierarchy: Hierarchy, board: Board, error: _Error, watch: Watch) -> None:
        places = len(board.aggregate)
        self.board, self.stack = board, _own_work(hierarchy.stack)
        self._z, self._red = np.zeros((2, places), dtype=np.float32)
        self.r, self.x, self._p, self._s, self._w, self._double = np.zeros((6, places))
        self._energy = 0.0
        self._error, self._watch, self._unit = error, watch, hierarchy.unit
        self.left = 1.0

    def run(self, size: float, gain: float, most: int) -> int:
        """Reduce ``r``, of norm ``size``, by a factor ``gain``; ``size x`` corrects it; returns the steps taken."""
        self.x[:] = 0.0
        self.r /= size
        self._z[:] = self.board.black_inverse * self.r
        self.left, steps = 1.0, 0
        while self.left > gain and steps < most and not self._error.small:
            self._precondition()
            zr, zw, zs = passes.multiply(self.board, self._z, self.r, self._s, self._double, self._w)
            beta = -zs / self._energy if self._energy > 0.0 else 0.0
            self._energy = zw + beta * zs
            if not self._energy > 0.0:
                break
            work = (self._z, self._w, self._p, self._s, self.x, self.r)
            self.left = math.sqrt(passes.advance(self.board, *work, beta, zr / self._energy))
            power, step = zr * zr / self._energy * size * size, zr / self._energy * size / self._unit
            self._error.moved(self._p, step, power)
            self._watch.step(self.left * size)
            steps += 1
        return steps

    def _precondition(self) -> None:
        first = self.stack.first[1]
        passes.restrict(self.board, self._z, self._red, self.stack.b[:first])
        kernels.cycle(self.stack, _ENOUGH, 0 if len(self.board.faces) > 4 else 1)
        passes.prolong(self.board, self.stack.x[:first], self.r, self._red, self._z)


def _iterate_on_graph(
    system: NodalSystem,
    hierarchy: Hierarchy,
    b: NDArray[np.float64],
    rtol: float,
    guess: NDArray[np.float64] | None,
    watch: Watch,
) -> tuple[NDArray[np.float64], float]:
    matrix, stack = _rows(system), _own_work(hierarchy.stack)
    n = len(b)
    x, r, z = np.zeros(n), b.copy(), np.empty(n, dtype=np.float32)
    goal, left, error = rtol * kernels.norm(b), _MOST_ITERATIONS, _Error(guess, rtol)
    if guess is not None:
        x = guess.copy()
        kernels.subtract_product(*matrix, b, x, r)
    size = kernels.norm(r)
    watch.begin(size, goal)
    while size > goal and left > 0 and not error.small:
        p, s, w = np.zeros(n), np.zeros(n), np.empty(n)
        trial, recursive, energy = x.copy(), size, 0.0
        while recursive > 0.7 * goal and left > 0 and not error.small:
            kernels.apply(stack, r, recursive, z)
            zr, zw, zs = kernels.multiply(*matrix, z, r, s, w)
            beta = -zs / energy if energy > 0.0 else 0.0
            energy = zw + beta * zs
            if not energy > 0.0:
                break
            recursive = float(np.sqrt(kernels.advance(z, w, p, s, trial, r, beta, zr / energy)))
            error.moved(p, zr / energy, zr * zr / energy)
            watch.step(recursive)
            left -= 1
        true = kernels.subtract_product(*matrix, b, trial, r)
        if not true < _LEAST_GAIN * size:
            break
        error.small &= true <= max(_DRIFT * recursive, goal)
        x, size = trial, true
    return x, size


def _own_work(stack: Stack) -> Stack:
    """The same levels with work space of its own, so that one hierarchy can serve several solves at a time."""
    b, x, c, v, w, kept = np.zeros((6, len(stack.b)), dtype=np.float32)
    return stack._replace(b=b, x=x, c=c, v=v, w=w, kept=kept)


def _rows(
    system: NodalSystem,
) -> tuple[NDArray[np.uint32], NDArray[np.uint32], NDArray[np.float64], NDArray[np.float64]]:
    """The nodal matrix in compressed rows, with indices that need no sign."""
    coupling = system.coupling
    return coupling.indptr.view(np.uint32), coupling.indices.view(np.uint32), coupling.data, system.excess
