"""Flexible conjugate gradients (Notay 2000), preconditioned by one cycle of the hierarchy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.nodal.multigrid.board_iteration import iterate_on_board
from resgrid.nodal.multigrid.graph_iteration import iterate_on_graph
from resgrid.nodal.multigrid.hierarchy import Hierarchy
from resgrid.nodal.system import NodalSystem
from resgrid.nodal.watch import Watch


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
<<<<<<< HEAD
    if hierarchy.grid is None:
        return iterate_on_graph(system, hierarchy.stack, b, rtol, guess, watch)
    return iterate_on_board(hierarchy, hierarchy.grid, b, rtol, guess, watch)
=======
    if hierarchy.board is None:
        return iterate_on_graph(system, hierarchy.stack, hierarchy.unit, b, rtol, guess, watch)
    return _iterate_on_board(system, hierarchy, hierarchy.board, b, rtol, guess, watch)


def _iterate_on_board(
    system: NodalSystem,
    hierarchy: Hierarchy,
    board: Board,
    b: NDArray[np.float64],
    rtol: float,
    guess: NDArray[np.float64] | None,
    watch: Watch,
) -> tuple[NDArray[np.float64], float]:
    error = ErrorBound(guess, rtol)
    burst = _Burst(hierarchy, board, error, watch)
    matrix = (*matrix_rows(system), 1.0 / system.degree, hierarchy.place, hierarchy.reach)
    x, last, left = np.zeros(len(b)) if guess is None else guess.copy(), np.inf, MOST_ITERATIONS
    wanted, rounding = rtol * kernels.norm(b), _ROUNDING * float(system.degree.max(initial=0.0))
    while True:
        size = passes.black_residual(*matrix, b, x, burst.r)
        goal = max(wanted, rounding * kernels.norm(x))
        error.small &= size <= max(DRIFT * burst.left * last, goal)
        if error.small or not (size > goal and size < LEAST_GAIN * last and left > 0):
            return x, size
        if not math.isfinite(last):
            watch.begin(size, goal)
        left -= burst.run(size, max(_BURST, 0.8 * goal / size), left)
        passes.add_black(hierarchy.place, burst.x, size / hierarchy.unit, x)
        last = size


class _Burst:
    """Some steps on the black cells, from a residual of norm 1; search directions outlive a burst."""

    def __init__(self, hierarchy: Hierarchy, board: Board, error: ErrorBound, watch: Watch) -> None:
        places = len(board.aggregate)
        self.board, self.stack = board, own_work(hierarchy.stack)
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
>>>>>>> main
