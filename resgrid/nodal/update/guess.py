"""A guess made better where the circuit has changed: the equations of windows around the change, solved by themselves.

Outside, voltages follow in one of two ways.  Where rails hardly hold them, as behind a new obstacle near the goal of
open obstacles, all rise alike.  Where the rail of obstacles holds them, what leaves the windows dies away as it did
before: all of the drop below that rail becomes so many times what it was.  That is the Galerkin solution over the
functions that are free inside the windows and such a one outside (a coarse space of one function; Nicolaides 1987).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.nodal.system import NodalSystem
from resgrid.nodal.update.change import Change
from resgrid.nodal.update.window import Window

_ACCURACY, _FOLLOWING = 1e-9, 1e-7
"""Of the voltages in a window, and of how they follow those outside."""

_HARDLY = 0.1
"""Share that rails have in what holds the voltages outside, up to which they hardly do."""

_ALONE = 1e-9
"""Share of the span between rails by which the voltage that holds the outside may differ from the high one."""

_MOST_TIMES = 10.0
"""How many times itself the drop outside may become, at most."""


def improve_guess(
    system: NodalSystem,
    change: Change,
    windows: tuple[Window, ...],
    b: NDArray[np.float64],
    guess: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Solve windows around the last change.  Shapes: `b` (n,), `guess` (n,); returns (n,)."""
    x = np.multiply(guess, change.gain)
    x[change.pinned] = 0.0
    tied, fed = (_sum_outside(values, change, windows) for values in (system.excess, b))
    hardly = tied <= _HARDLY * sum(window.conductance.sum() for window in windows)
    if hardly and (shift := _rise(system, change, windows, b, x, tied, fed)):
        x += shift
        x[change.pinned] = 0.0
    inside = [window.solve(b[window.rows] + window.drawn(x), _ACCURACY, x[window.rows]) for window in windows]
    if not hardly and (rail := _holding_rail(system, tied, fed)) is not None:
        inside = _scale_drop(windows, x, inside, rail)
        x[change.pinned] = 0.0
    for window, voltages in zip(windows, inside, strict=True):
        x[window.rows] = voltages
    return x


def _sum_outside(values: NDArray[np.float64], change: Change, windows: tuple[Window, ...]) -> float:
    """Sum over all rows but those of windows, and those that no longer take part."""
    total = values.sum() - values[change.pinned].sum()
    return float(total - sum(values[window.rows].sum() for window in windows))


def _rise(
    system: NodalSystem,
    change: Change,
    windows: tuple[Window, ...],
    b: NDArray[np.float64],
    x: NDArray[np.float64],
    tied: float,
    fed: float,
) -> float:
    """By how much all voltages outside rise.

    Where they rise by 1 V, those inside follow; the residual is made orthogonal to that rise, in which what the
    windows hold themselves has no part.
    """
    ones = np.broadcast_to(1.0, len(x))
    current, stiffness = fed - _sum_outside(system.excess * x, change, windows), max(tied, 0.0)
    for window in windows:
        follows = window.solve(window.drawn(ones), _FOLLOWING, ones[window.rows])
        pull = window.conductance * (1.0 - follows[window.inner])
        current += float((follows * b[window.rows]).sum() - (pull * x[window.outer]).sum())
        stiffness += float(pull.sum())
    return current / stiffness if stiffness > 0.0 else 0.0


def _holding_rail(system: NodalSystem, tied: float, fed: float) -> float | None:
    """The high rail's voltage above the reference, if no other one holds the rows outside."""
    rails = system.rails
    if rails is None:
        return None
    high = rails.high - system.reference
    return high if abs(fed - tied * high) <= _ALONE * tied * abs(rails.high - rails.low) else None


def _scale_drop(
    windows: tuple[Window, ...], x: NDArray[np.float64], inside: list[NDArray[np.float64]], rail: float
) -> list[NDArray[np.float64]]:
    """Make the drop below a rail so many times what it was, in place outside; returns the voltages inside.

    Outside, the drop before the change balances by itself.  So does what remains of it but at the windows' edges, where
    the voltages inside are no longer those before.
    """
    followed, current, stiffness = [], 0.0, 0.0
    for window, now in zip(windows, inside, strict=True):
        before = x[window.rows] - rail
        follows = window.solve(window.drawn(x, rail), _FOLLOWING, before)
        pull = window.conductance * (x[window.outer] - rail)
        current += float((pull * (now - rail - before)[window.inner]).sum())
        stiffness += float((pull * (before - follows)[window.inner]).sum())
        followed.append(follows)
    more = current / stiffness if stiffness > 0.0 else 0.0
    if not -1.0 < more < _MOST_TIMES:
        return inside
    x *= 1.0 + more
    x -= more * rail
    return [now + more * follows for now, follows in zip(inside, followed, strict=True)]
