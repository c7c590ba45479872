"""A guess made better where the circuit has changed: the equations of windows around the change, solved by themselves.

Outside the windows voltages stay, but for a constant where rails hardly hold them: behind a new obstacle near the goal
of open obstacles, everything rises alike.  That is the Galerkin solution over the functions that are free inside the
windows and constant outside (a coarse space of one function; Nicolaides 1987).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.nodal.system import NodalSystem
from resgrid.nodal.update.change import Change
from resgrid.nodal.update.window import Window

_ACCURACY, _FOLLOWING = 1e-6, 1e-7
"""Of the voltages in a window, and of how they follow those outside."""

_HARDLY = 0.1
"""Share that rails have in what holds the voltages outside, up to which they hardly do."""


def improve_guess(
    system: NodalSystem,
    change: Change,
    windows: tuple[Window, ...],
    b: NDArray[np.float64],
    guess: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Solve windows around the last change.

    Parameters
    ----------
    system : NodalSystem
        After the change.
    change : Change
    windows : tuple of Window
    b : ndarray of float64, shape (n,)
        Currents in amperes.
    guess : ndarray of float64, shape (n,)
        Voltages in volts, such as those before the change.

    Returns
    -------
    ndarray of float64, shape (n,)
    """
    x = np.multiply(guess, change.gain)
    at_rail = b[change.pinned] / system.degree[change.pinned]
    x[change.pinned] = at_rail
    shift = _shift_outside(system, change, windows, b, x)
    if shift:
        x += shift
        x[change.pinned] = at_rail
    for window in windows:
        x[window.rows] = window.solve(b[window.rows] + window.drawn(x), _ACCURACY, x[window.rows])
    return x


def _shift_outside(
    system: NodalSystem,
    change: Change,
    windows: tuple[Window, ...],
    b: NDArray[np.float64],
    x: NDArray[np.float64],
) -> float:
    """By how much all voltages outside rise.

    Where they rise by 1 V, those inside follow; the residual is made orthogonal to that rise, in which what the
    windows hold themselves has no part.
    """
    tied = system.excess.sum() - system.excess[change.pinned].sum()
    tied -= sum(system.excess[window.rows].sum() for window in windows)
    leads_out = sum(window.conductance.sum() for window in windows)
    if not leads_out > 0.0 or tied > _HARDLY * leads_out:
        return 0.0
    ones = np.ones(len(x))
    held = np.flatnonzero(system.excess)
    current = b.sum() - b[change.pinned].sum() - (system.excess[held] * x[held]).sum()
    current += (system.excess[change.pinned] * x[change.pinned]).sum()
    stiffness = max(float(tied), 0.0)
    for window in windows:
        rows = window.rows
        follows = window.solve(window.drawn(ones), _FOLLOWING, ones[rows])
        pull = window.conductance * (1.0 - follows[window.inner])
        current += ((follows - 1.0) * b[rows] + system.excess[rows] * x[rows]).sum() - (pull * x[window.outer]).sum()
        stiffness += float(pull.sum())
    return float(current / stiffness) if stiffness > 0.0 else 0.0
