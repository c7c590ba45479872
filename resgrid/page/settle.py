"""Settling: how the potential of a drawing's circuit comes about after its rails are switched on."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.transient import transient
from resgrid.errors import BudgetError, InputError
from resgrid.netlist import GROUND, Netlist
from resgrid.page.drawing import Drawing
from resgrid.page.frames import quantised
from resgrid.page.solving import Frame, solve_drawing

MOST_CELLS = 1 << 15
_MOMENTS = 30
_TOLERANCE = 1e-3
_DECADES = 2.0
_FARADS = 1e-12


def settle(drawing: Drawing, before: OperatingPoint | None) -> tuple[dict[str, Any], list[bytes]]:
    """Times in seconds, and pictures, uint16 (times, nx, ny); from rest, or from another operating point."""
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
    unit = op.netlist.cells.wiring.resistance * farads
    times = unit * np.geomspace(0.25, 4.0 * drawing.cell.size, _MOMENTS)
    motion = transient(_with_capacitors(op.netlist, farads), times, initial=before, tolerance=_TOLERANCE)
    settled = _moment_of_rest(motion.voltage)
    scale, pictures = _pictures(frame, op, motion.voltage[: settled + 1])
    return {"times": times[: settled + 1].tolist(), "scale": scale, "from_rest": before is None}, [pictures.tobytes()]


def _with_capacitors(netlist: Netlist, farads: float) -> Netlist:
    """A capacitor to ground at the node of every free cell; rails hold the others."""
    nodes = netlist.cells.free_node
    pairs = np.stack([nodes, np.full_like(nodes, GROUND)], axis=1)
    return netlist.replace(capacitor_nodes=pairs, capacitance=np.full(len(nodes), farads))


def _moment_of_rest(voltage: NDArray[np.float64]) -> int:
    """The first moment from which nothing moves any more that could be seen; voltage (times, nodes)."""
    span = np.nanmax(np.abs(voltage[-1])) or 1.0
    moves = np.nanmax(np.abs(voltage - voltage[-1]), axis=1) > 1e-3 * span
    return min(len(voltage) - 1, int(np.flatnonzero(moves)[-1]) + 2 if moves.any() else 0)


def _pictures(
    frame: Frame, op: OperatingPoint, voltage: NDArray[np.float64]
) -> tuple[dict[str, Any], NDArray[np.uint16]]:
    """Pictures (times, nx, ny) of decades of the drop, or of the height, and their common scale."""
    cells, field = op.netlist.cells, frame.field
    wiring, shown = cells.wiring, field.space.goal_connected & (cells.node >= 0)
    own = voltage[:, cells.node]
    if field.log_drop is None:
        final = np.nanmax(np.abs(op.voltage[cells.free_node] - wiring.goal_voltage))
        kind, value, low, high = "height", (own - wiring.goal_voltage) / final, 0.0, 1.0
    else:
        drop = np.clip(1.0 - (own - wiring.goal_voltage) / wiring.supply, 10.0**-_DECADES, 1.0)
        kind, value, low, high = "decades", np.log10(drop), -_DECADES, 0.0
    every = np.broadcast_to(shown, value.shape) & np.isfinite(value)
    return {"kind": kind, "low": low, "high": high}, quantised(np.clip(value, low, high), every, low, high)
