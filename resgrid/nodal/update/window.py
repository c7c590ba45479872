"""A guess made better where the circuit has changed: the equations of a window around the change, solved by themselves.

Outside the window voltages stay, but for a constant where no rail holds them: behind a new obstacle near the goal of
open obstacles, everything rises alike.  That is the Galerkin solution over the functions that are free inside the
window and constant outside (a coarse space of one function; Nicolaides 1987).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.nodal.multigrid.checkerboard_kernels import Board
from resgrid.nodal.multigrid.hierarchy import Hierarchy
from resgrid.nodal.multigrid.iteration import iterate
from resgrid.nodal.multigrid.levels import Graph, coarsen_down
from resgrid.nodal.multigrid.stack import stack_levels
from resgrid.nodal.system import NodalSystem
from resgrid.nodal.update.change import Change
from resgrid.nodal.update.levels import coordinates

_SHARE, _LEAST = 64, 2000
"""A window holds one row in so many, and at least so many."""

_ACCURACY = 1e-5


@dataclass(frozen=True, eq=False)
class Window:
    """Some rows, their equations with all others fixed, and the residual of a guess at them.

    Attributes
    ----------
    rows : ndarray of int64, shape (m,)
    system, hierarchy
        As of a circuit; its netlist is the whole circuit's.
    outward : ndarray of float64, shape (m,)
        Conductance from every row to those outside, in siemens.
    residual : ndarray of float64, shape (m,)
        In amperes.
    """

    rows: NDArray[np.int64]
    system: NodalSystem
    hierarchy: Hierarchy
    outward: NDArray[np.float64]
    residual: NDArray[np.float64]

    def solve(self, currents: NDArray[np.float64]) -> NDArray[np.float64]:
        """Voltages, to five digits."""
        return iterate(self.system, self.hierarchy, currents, _ACCURACY)[0]


def improve_guess(
    system: NodalSystem,
    hierarchy: Hierarchy,
    board: Board,
    change: Change,
    b: NDArray[np.float64],
    guess: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Solve a window around the last change.

    Parameters
    ----------
    system : NodalSystem
        After the change.
    hierarchy : Hierarchy
    board : Board
    change : Change
    b : ndarray of float64, shape (n,)
        Currents in amperes.
    guess : ndarray of float64, shape (n,)
        Voltages in volts, such as those before the change.

    Returns
    -------
    ndarray of float64, shape (n,)
    """
    x = guess.copy()
    x[change.pinned] = b[change.pinned] / system.degree[change.pinned]
    window = _open_window(system, hierarchy, board, change, b, x)
    if window is None:
        return x
    inside, shift = window.solve(window.residual), 0.0
    if window.outward.any() and _held_inside(system, change, window):
        follows = window.solve(window.outward)
        stiffness = window.outward.sum() - window.outward @ follows
        shift = float(window.outward @ inside / stiffness) if stiffness > 0 else 0.0
        inside += shift * follows
    inside += x[window.rows]
    if shift:
        x += shift
        x[change.pinned] = b[change.pinned] / system.degree[change.pinned]
    x[window.rows] = inside
    return x


def _held_inside(system: NodalSystem, change: Change, window: Window) -> bool:
    """Whether no rail holds anything outside the window."""
    tied = np.count_nonzero(system.excess) - len(change.pinned)
    return bool(tied == np.count_nonzero(system.excess[window.rows]))


def _open_window(
    system: NodalSystem,
    hierarchy: Hierarchy,
    board: Board,
    change: Change,
    b: NDArray[np.float64],
    x: NDArray[np.float64],
) -> Window | None:
    from resgrid.nodal.update import kernels

    layout = system.netlist.layout
    assert layout is not None
    coupling = system.coupling
    graph = (coupling.indptr, coupling.indices, coupling.data)
    seeds = np.setdiff1d(change.pairs, change.pinned)
    number = np.zeros(system.size, dtype=np.int32)
    rows = kernels.gather(*graph, seeds, max(_LEAST, system.size // _SHARE), number)
    if not len(rows):
        return None
    indptr, indices, data, outward, residual = kernels.cut_out(*graph, system.excess, rows, number, b, x)
    excess, unit = system.excess[rows] + outward, hierarchy.unit
    where = coordinates(hierarchy, board, rows, layout.space.shape)
    graphs, steps = coarsen_down(Graph(indptr, indices, data / unit, excess / unit, where))
    levels = Hierarchy(stack_levels(graphs, steps), None, np.empty(0, dtype=np.int64), 0, unit)
    inner = replace(system, derived=sparse.csr_array((data, indices, indptr), shape=(len(rows),) * 2), excess=excess)
    return Window(rows, inner, levels, outward, residual)
