"""Flexible conjugate gradients (Notay 2000), preconditioned by one cycle of the hierarchy.

On a grid the iteration runs on the black cells alone, over conductances in single precision, in bursts: after each
the true residual is formed from the true conductances, and the next begins with it, search directions kept.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.nodal.multigrid import checkerboard_kernels as passes
from resgrid.nodal.multigrid import kernels
from resgrid.nodal.multigrid.checkerboard_kernels import Board
from resgrid.nodal.multigrid.hierarchy import Hierarchy
from resgrid.nodal.system import NodalSystem

_MOST_ITERATIONS = 200
_BURST = 1e-5
_LEAST_GAIN = 0.5
_ROUNDING = 2.0**-52
_ENOUGH = 0.25
"""Residual after the first step of a K-cycle that spares the second."""


def iterate(
    system: NodalSystem, hierarchy: Hierarchy, b: NDArray[np.float64], rtol: float
) -> tuple[NDArray[np.float64], float]:
    """Solve until the residual norm is ``rtol |b|``, or rounding forbids more.

    Parameters
    ----------
    system : NodalSystem
    hierarchy : Hierarchy
    b : ndarray of float64, shape (n,)
        Currents in amperes.
    rtol : float

    Returns
    -------
    x : ndarray of float64, shape (n,)
        Voltages in volts.
    residual : float
        Norm of the true residual, in amperes.
    """
    if hierarchy.board is None:
        return _iterate_on_graph(system, hierarchy, b, rtol)
    return _iterate_on_board(system, hierarchy, hierarchy.board, b, rtol)


def _iterate_on_board(
    system: NodalSystem, hierarchy: Hierarchy, board: Board, b: NDArray[np.float64], rtol: float
) -> tuple[NDArray[np.float64], float]:
    burst = _Burst(hierarchy, board)
    matrix = (*_rows(system), 1.0 / system.degree, hierarchy.place, hierarchy.reach)
    x, last, left = np.zeros(len(b)), np.inf, _MOST_ITERATIONS
    wanted, rounding = rtol * kernels.norm(b), _ROUNDING * float(system.degree.max(initial=0.0))
    while True:
        size = passes.black_residual(*matrix, b, x, burst.r)
        goal = max(wanted, rounding * kernels.norm(x))
        if not (size > goal and size < _LEAST_GAIN * last and left > 0):
            return x, size
        left -= burst.run(size, max(_BURST, 0.8 * goal / size), left)
        passes.add_black(hierarchy.place, burst.x, size / hierarchy.unit, x)
        last = size


class _Burst:
    """Some steps on the black cells, from a residual of norm 1; search directions outlive a burst."""

    def __init__(self, hierarchy: Hierarchy, board: Board) -> None:
        places = len(board.aggregate)
        self.board, self.stack = board, hierarchy.stack
        self._z, self._red = np.zeros((2, places), dtype=np.float32)
        self.r, self.x, self._p, self._s, self._w, self._double = np.zeros((6, places))
        self._energy = 0.0

    def run(self, size: float, gain: float, most: int) -> int:
        """Reduce ``r``, of norm ``size``, by a factor ``gain``; ``size x`` corrects it; returns the steps taken."""
        self.x[:] = 0.0
        self.r /= size
        self._z[:] = self.board.black_inverse * self.r
        left, steps = 1.0, 0
        while left > gain and steps < most:
            self._precondition()
            zr, zw, zs = passes.multiply(self.board, self._z, self.r, self._s, self._double, self._w)
            beta = -zs / self._energy if self._energy > 0.0 else 0.0
            self._energy = zw + beta * zs
            if not self._energy > 0.0:
                break
            work = (self._z, self._w, self._p, self._s, self.x, self.r)
            left = float(np.sqrt(passes.advance(self.board, *work, beta, zr / self._energy)))
            steps += 1
        return steps

    def _precondition(self) -> None:
        first = self.stack.first[1]
        passes.restrict(self.board, self._z, self._red, self.stack.b[:first])
        kernels.cycle(self.stack, _ENOUGH, 0 if len(self.board.faces) > 4 else 1)
        passes.prolong(self.board, self.stack.x[:first], self.r, self._red, self._z)


def _iterate_on_graph(
    system: NodalSystem, hierarchy: Hierarchy, b: NDArray[np.float64], rtol: float
) -> tuple[NDArray[np.float64], float]:
    matrix = _rows(system)
    n = len(b)
    x, r, z = np.zeros(n), b.copy(), np.empty(n, dtype=np.float32)
    size, left = kernels.norm(b), _MOST_ITERATIONS
    goal = rtol * size
    while size > goal and left > 0:
        p, s, w = np.zeros(n), np.zeros(n), np.empty(n)
        trial, recursive, energy = x.copy(), size, 0.0
        while recursive > 0.7 * goal and left > 0:
            kernels.apply(hierarchy.stack, r, recursive, z)
            zr, zw, zs = kernels.multiply(*matrix, z, r, s, w)
            beta = -zs / energy if energy > 0.0 else 0.0
            energy = zw + beta * zs
            if not energy > 0.0:
                break
            recursive = float(np.sqrt(kernels.advance(z, w, p, s, trial, r, beta, zr / energy)))
            left -= 1
        true = kernels.subtract_product(*matrix, b, trial, r)
        if not true < _LEAST_GAIN * size:
            break
        x, size = trial, true
    return x, size


def _rows(
    system: NodalSystem,
) -> tuple[NDArray[np.uint32], NDArray[np.uint32], NDArray[np.float64], NDArray[np.float64]]:
    """The nodal matrix in compressed rows, with indices that need no sign."""
    coupling = system.coupling
    return coupling.indptr.view(np.uint32), coupling.indices.view(np.uint32), coupling.data, system.excess
