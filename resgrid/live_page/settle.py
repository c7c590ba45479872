"""Transients of a drawing's circuit after its rails are switched on, or after a change of its cells.

A level is the number that the page shows for a node: the normalised potential or, in a field with an obstacle rail, the
drop.  Both lie between 0 and 1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import islice, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.transients.linear import initial_voltages, transient_stepper
from resgrid.core.lattice import SQUARE
from resgrid.core.netlist import GROUND, Netlist
from resgrid.errors import BudgetError, InputError
from resgrid.live_page.drawing import Drawing
from resgrid.live_page.frames import NO_VALUE, picture_of, quantised
from resgrid.live_page.solving import SolvedDrawing, potential_scale, solve_drawing

MAX_CELLS = 1 << 15
"""Largest number of cells of a grid whose transient is computed; for a larger grid, BudgetError is raised."""

_FARADS = 1e-12
"""Capacitance of every node, in farads, if the drawing's chip states none."""

_FIRST = 0.25
"""Factor of the first time of a transient: this time is `_FIRST` times `_RATIO` times R C.

R and C are the nominal resistance between cells and the capacitance of a node.
"""

_RATIO = 1.4
"""Quotient of each time of a transient and the time before."""

_MAX_TIMES = 80
"""Largest number of times at which a transient is computed; the steady state follows as the last picture."""

_STEPS = ((0.3, 24), (0.1, 12), (0.02, 6), (0.0, 3))
"""Pairs of an error and the number of coarse time steps from one time of the transient to the next.

The first pair is used whose error is at most the error at the previous time, which is infinite at first.  The error at
a time is the largest difference, over all nodes, of the natural logarithms of a potential or drop computed with fine
and with coarse steps of backward Euler.  Fine steps are half as long as coarse steps.
"""

_VISIBLE = 0.004
"""Largest difference of a pixel from the steady-state picture, as a fraction of the range of pixel values, at which the
circuit counts as settled.
"""


def settle(
    drawing: Drawing, before: OperatingPoint | None, is_wanted: Callable[[], bool] = lambda: True
) -> tuple[dict[str, Any], list[bytes]]:
    """Return a transient: a head for JSON with the times in seconds, and two arrays as bytes.

    The arrays have shape (times, nx, ny): pictures (uint16) and voltages in volts (float32, NaN in cells without a path
    to a goal). A pixel value from 0 to 65534 is linear between the lowest and the highest value of the steady-state
    field (potential, or log10 of the drop); 65535 marks cells without a value, such as obstacles. The head has the keys
    ``times`` and ``from_rest`` (whether the initial state is zero voltage). The last picture is the steady state. The
    initial state is the operating point `before`, or zero voltage if `before` is None or hardly differs from the steady
    state. The function `is_wanted` is called before every time; InputError is raised if it returns False. `drawing`:
    drawing of one circuit, not of a blend.
    """
    if not drawing.driven and 0.0 < drawing.k < 1.0:
        raise InputError("a blend consists of two chips: choose k = 0 or k = 1 for the transient of one chip")
    if drawing.lattice != SQUARE:
        raise InputError("transients need the lattice of face neighbours: choose the lattice square")
    if drawing.cell.size > MAX_CELLS:
        raise BudgetError(
            f"transients are only computed for up to {MAX_CELLS:,} cells; this drawing has {drawing.cell.size:,}: "
            "open a smaller grid"
        )
    frame = solve_drawing(drawing, exact=True)
    op = next(iter(frame.solution.operating_points.values()), None)
    if op is None:
        raise InputError("this grid has no transient, because it is not driven: add an obstacle, or an obstacle border")
    farads = float((drawing.chip or {}).get("capacitance", _FARADS))
    if not 0.0 < farads < 1.0:
        raise InputError(f"chip.capacitance = {farads:g} must lie between 0 and 1 F, both excluded, for a transient")
    first = _RATIO * _FIRST * op.netlist.cells.wiring.resistance * farads
    transient = None if before is None else _transient(frame, op, before, farads, is_wanted)
    if transient is None:
        transient = _transient(frame, op, None, farads, is_wanted)
        before = None
    if transient is None:
        raise InputError("this grid has no transient, because no voltage changes: add an obstacle or a free cell")
    pictures, volts = transient
    times = first * _RATIO ** np.arange(len(pictures))
    head = {"times": times.tolist(), "from_rest": before is None}
    return head, [pictures.tobytes(), volts.astype("<f4").tobytes()]


def _transient(
    frame: SolvedDrawing,
    op: OperatingPoint,
    before: OperatingPoint | None,
    farads: float,
    is_wanted: Callable[[], bool],
) -> tuple[NDArray[np.uint16], NDArray[np.float64]] | None:
    """Return pictures uint16 and volts float64, both (times, nx, ny), until the circuit has settled.

    The times form a geometric series, counted from the switching of the rails or the change of the drawing; the last
    entry is the steady state. A pixel value from 0 to 65534 is linear between the lowest and the highest value of the
    steady-state picture: the normalised potential or, with an obstacle rail, log10 of the drop. Cells other than free
    cells with a path to a goal keep the pixel value of the steady state (65535 in obstacles: no value) and have NaN
    volts.

    The circuit counts as settled when no pixel differs from the steady state by more than 0.4 % of the range of pixel
    values. The result is None if the initial picture is already settled. `frame`: solved drawing; `op`: steady state;
    `before`: initial operating point, None for zero voltage; `farads`: capacitance of every node; `is_wanted`: function
    that is called before every time, and returns False to stop the computation by InputError.
    """
    cells, wiring = op.netlist.cells, frame.field.wiring
    scale, steady = picture_of(frame)
    shown = frame.field.space.goal_connected & (cells.node >= 0) & (steady != NO_VALUE)
    is_drop = scale["kind"] == "decades"
    low, high = scale["low"], scale["high"]
    unit, goal = potential_scale(op), wiring.goal_voltage
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
    for level in islice(_levels(netlist, start, wiring.resistance * farads), _MAX_TIMES):
        if not is_wanted():
            raise InputError("the drawing has changed during the computation of its transient")
        at_cells = level[cells.node]
        pictures.append(picture(at_cells))
        volts.append(goal + unit * (1.0 - at_cells if is_drop else at_cells))
        if not differs(pictures[-1]):
            break
    pictures.append(steady)
    volts.append(op.voltage[cells.node])
    return np.stack(pictures), np.where(shown, np.stack(volts), np.nan)


def _in_levels(netlist: Netlist, unit: float, goal: float, farads: float, is_drop: bool) -> Netlist:
    """Return the circuit whose voltages are potentials, or drops if `is_drop`, with a capacitor at every free cell.

    `netlist`: circuit in volts; `unit`: voltage of a potential or drop of 1, in volts; `goal`: voltage of the goal
    rail, in volts; `farads`: capacitance of every free node.  Backward Euler keeps the relative accuracy of drops and
    potentials over many orders of magnitude, because they are not negative.
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
    """Return the potential, or the drop if `is_drop`, of every node at time 0, shape (nodes,).

    `op`: steady state; `before`: initial operating point, None for zero voltage; `unit`: voltage of a potential or drop
    of 1, in volts.
    """
    goal = op.netlist.cells.wiring.goal_voltage
    if before is None:
        level = np.full(op.netlist.node_count, -goal / unit)
    else:
        was = before.netlist.cells.wiring
        level = (initial_voltages(op.netlist, before) - was.goal_voltage) / potential_scale(before)
    level = 1.0 - level if is_drop else level
    level[GROUND] = 0.0
    return level


def _levels(netlist: Netlist, start: NDArray[np.float64], unit: float) -> Iterator[NDArray[np.float64]]:
    """Yield the potentials or drops (nodes,) of all nodes at the times ``0.25 * 1.4**k * unit``, ``k = 1, ..., 80``.

    The values are extrapolated from coarse and fine steps of backward Euler.  The geometric extrapolation ``fine**2 /
    coarse`` has second order and keeps all values positive.  `netlist`: circuit whose node voltages are potentials or
    drops; `start` (nodes,): values at time 0, which are not yielded; `unit`: time constant R C, in seconds.
    """
    times = unit * _FIRST * np.array([0.0, *_RATIO ** np.arange(1, _MAX_TIMES + 1)])
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
    """Return the potentials or drops (nodes,) after `steps` equal steps of backward Euler in total time `seconds`.

    `netlist`: circuit whose node voltages are potentials or drops; `level` (nodes,): values before the steps.
    """
    stepper = transient_stepper(netlist, seconds / steps, method="backward_euler")
    level = stepper.start(level)
    for _ in range(steps):
        level = stepper.advance(level)
    return level
