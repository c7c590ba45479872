"""Settling: the potential of a drawing's circuit over time, after its rails are switched on or its cells change."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import islice, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.transients import initial_voltages, transient_stepper
from resgrid.core.netlist import GROUND, Netlist
from resgrid.errors import BudgetError, InputError
from resgrid.live_page.drawing import Drawing
from resgrid.live_page.frames import NOTHING, picture_of, quantised
from resgrid.live_page.solving import SolvedDrawing, solve_drawing

MOST_CELLS = 1 << 15
_FARADS = 1e-12
_FIRST = 0.25
_RATIO = 1.4
"""Ratio of successive times."""

_MOST_MOMENTS = 80
_STEPS = ((0.3, 24), (0.1, 12), (0.02, 6), (0.0, 3))
"""Coarse steps of backward Euler to the next moment, by the largest logarithm of fine over coarse levels so far.

Fine steps are half as long.
"""

_VISIBLE = 0.004
"""Difference to the steady picture, as a fraction of its scale, below which the circuit rests."""


def settle(
    drawing: Drawing, before: OperatingPoint | None, is_wanted: Callable[[], bool] = lambda: True
) -> tuple[dict[str, Any], list[bytes]]:
    """Return times in seconds, pictures uint16 (times, nx, ny) and volts float32 (times, nx, ny).

    The pictures have the scale of the steady field, and the last one is the steady field.  The circuit starts from the
    operating point `before`, or from rest without one, or where the change since then cannot be seen.  `is_wanted` is
    called before every moment; InputError if it returns False.
    """
    if not drawing.driven and 0.0 < drawing.k < 1.0:
        raise InputError("a blend is two chips: choose k = 0 or k = 1 to see one settle")
    if drawing.cell.size > MOST_CELLS:
        raise BudgetError(f"settling is shown of up to {MOST_CELLS:,} cells; this drawing has {drawing.cell.size:,}")
    frame = solve_drawing(drawing, exact=True)
    op = next(iter(frame.solution.operating_points.values()), None)
    if op is None:
        raise InputError("nothing settles here: nothing drives this grid")
    farads = float((drawing.chip or {}).get("capacitance", _FARADS))
    if not 0.0 < farads < 1.0:
        raise InputError("chip.capacitance: settling needs one, in farads")
    first = _RATIO * _FIRST * op.netlist.cells.wiring.resistance * farads
    film = None if before is None else _film(frame, op, before, farads, is_wanted)
    if film is None:
        film = _film(frame, op, None, farads, is_wanted)
        before = None
    if film is None:
        raise InputError("nothing settles here: no voltage changes")
    pictures, volts = film
    times = first * _RATIO ** np.arange(len(pictures))
    head = {"times": times.tolist(), "from_rest": before is None}
    return head, [pictures.tobytes(), volts.astype("<f4").tobytes()]


def _film(
    frame: SolvedDrawing,
    op: OperatingPoint,
    before: OperatingPoint | None,
    farads: float,
    is_wanted: Callable[[], bool],
) -> tuple[NDArray[np.uint16], NDArray[np.float64]] | None:
    """Return pictures and volts (times, nx, ny) until the circuit rests; None where it rests from the start."""
    cells, wiring = op.netlist.cells, frame.field.wiring
    scale, steady = picture_of(frame)
    shown = frame.field.space.goal_connected & (cells.node >= 0) & (steady != NOTHING)
    is_drop = scale["kind"] == "decades"
    low, high = scale["low"], scale["high"]
    unit, goal = _unit(op, is_drop), wiring.goal_voltage
    netlist = _in_levels(op.netlist, unit, goal, farads, is_drop)

    def picture(level: NDArray[np.float64]) -> NDArray[np.uint16]:
        with np.errstate(divide="ignore"):
            value = np.log10(level) if is_drop else level
        return np.where(shown, quantised(np.clip(value, low, high), shown, low, high), steady).astype("<u2")

    def differs(one: NDArray[np.uint16]) -> bool:
        difference = np.abs(one.astype(np.int64) - steady.astype(np.int64))[shown]
        return bool(difference.size) and float(difference.max()) > _VISIBLE * np.iinfo(np.uint16).max

    start = _first_levels(op, before, unit, is_drop)
    if not differs(picture(start[cells.node])):
        return None
    pictures, volts = [], []
    for level in islice(_levels(netlist, start, wiring.resistance * farads), _MOST_MOMENTS):
        if not is_wanted():
            raise InputError("the drawing has changed: this film is of the drawing before")
        at_cells = level[cells.node]
        pictures.append(picture(at_cells))
        volts.append(goal + wiring.supply * (1.0 - at_cells if is_drop else at_cells))
        if not differs(pictures[-1]):
            break
    pictures.append(steady)
    volts.append(goal + wiring.supply * frame.field.potential)
    return np.stack(pictures), np.where(shown, np.stack(volts), np.nan)


def _unit(op: OperatingPoint, is_drop: bool) -> float:
    """Volts of the circuit that the page shows as a potential of 1."""
    wiring, free = op.netlist.cells.wiring, op.netlist.cells.free_node
    if is_drop:
        return float(wiring.supply)
    return float(np.nanmax(np.abs(op.voltage[free] - wiring.goal_voltage))) or 1.0


def _in_levels(netlist: Netlist, unit: float, goal: float, farads: float, is_drop: bool) -> Netlist:
    """Return the circuit in potentials, or in drops, with a capacitor at the node of every free cell.

    Drops and potentials are at least 0, so that backward Euler keeps their relative accuracy over many decades.
    """
    nodes = netlist.cells.free_node
    pairs = np.stack([nodes, np.full_like(nodes, GROUND)], axis=1)
    level = (netlist.source_volts - goal) / unit
    return netlist.replace(
        source_volts=1.0 - level if is_drop else level,
        current_amps=netlist.current_amps / (-unit if is_drop else unit),
        capacitor_nodes=pairs,
        capacitance=np.full(len(nodes), farads),
    )


def _first_levels(op: OperatingPoint, before: OperatingPoint | None, unit: float, is_drop: bool) -> NDArray[np.float64]:
    """Return the potential, or the drop, of every node at time 0: at rest, or as the page showed `before`."""
    goal = op.netlist.cells.wiring.goal_voltage
    if before is None:
        level = np.full(op.netlist.node_count, -goal / unit)
    else:
        was = before.netlist.cells.wiring
        level = (initial_voltages(op.netlist, before) - was.goal_voltage) / _unit(before, not was.is_driven)
    level = 1.0 - level if is_drop else level
    level[GROUND] = 0.0
    return level


def _levels(netlist: Netlist, start: NDArray[np.float64], unit: float) -> Iterator[NDArray[np.float64]]:
    """Yield the levels of all nodes at geometric times, by two runs of backward Euler, extrapolated.

    The geometric extrapolation ``fine**2 / coarse`` is of second order and keeps every level positive.
    """
    times = unit * _FIRST * np.array([0.0, *_RATIO ** np.arange(1, _MOST_MOMENTS + 1)])
    coarse = fine = start
    highest = np.inf if len(netlist.current_amps) else max(1.0, float(start.max()))  # the maximum principle
    error = np.inf
    for begin, end in pairwise(times):
        steps = next(count for least, count in _STEPS if error >= least)
        coarse = _advanced(netlist, coarse, end - begin, steps)
        fine = _advanced(netlist, fine, end - begin, 2 * steps)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            ratio = fine / coarse
            error = float(np.abs(np.log(ratio[np.isfinite(ratio) & (ratio > 0.0)])).max(initial=0.0))
        level = np.where(np.isfinite(ratio) & (ratio > 0.5) & (ratio < 2.0), fine * ratio, fine)
        yield np.minimum(level, highest)


def _advanced(netlist: Netlist, level: NDArray[np.float64], seconds: float, steps: int) -> NDArray[np.float64]:
    """Return the levels after some steps of equal length."""
    stepper = transient_stepper(netlist, seconds / steps, method="backward_euler")
    level = stepper.start(level)
    for _ in range(steps):
        level = stepper.advance(level)
    return level
