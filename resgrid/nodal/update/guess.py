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

_ACCURACY = 1e-8
_FOLLOWING = 1e-6


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
    inside = [window.solve(b[window.rows] + window.drawn(x), _ACCURACY, x[window.rows]) for window in windows]
    shift, follows = _shift_outside(system, change, windows, b, x, inside)
    if shift:
        x += shift
        x[change.pinned] = at_rail
        inside = [voltage + shift * more for voltage, more in zip(inside, follows, strict=True)]
    for window, voltage in zip(windows, inside, strict=True):
        x[window.rows] = voltage
    return x


def _shift_outside(
    system: NodalSystem,
    change: Change,
    windows: tuple[Window, ...],
    b: NDArray[np.float64],
    x: NDArray[np.float64],
    inside: list[NDArray[np.float64]],
) -> tuple[float, list[NDArray[np.float64]]]:
    """By how much all voltages outside rise, and how those inside follow where they rise by 1 V."""
    tied = system.excess.sum() - system.excess[change.pinned].sum()
    tied -= sum(system.excess[window.rows].sum() for window in windows)
    leads_out = sum(window.conductance.sum() for window in windows)
    if not leads_out > 0.0 or tied > 0.1 * leads_out:
        return 0.0, []
    ones = np.ones(len(x))
    follows = [window.solve(window.drawn(ones), _FOLLOWING) for window in windows]
    current = b.sum() - b[change.pinned].sum() - sum(b[window.rows].sum() for window in windows)
    stiffness = max(tied, 0.0)
    for window, voltage, more in zip(windows, inside, follows, strict=True):
        current += window.conductance @ (voltage[window.inner] - x[window.outer])
        stiffness += window.conductance @ (1.0 - more[window.inner])
    return (float(current / stiffness) if stiffness > 0.0 else 0.0), follows
