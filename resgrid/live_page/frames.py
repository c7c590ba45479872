"""Results of a solved drawing for the page: field, paths, properties of cells and, for small grids, the circuit.

A preview is a quick solution during a mouse gesture, with normwise accuracy and without certificates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.operating_point import OperatingPoint
from resgrid.core.cell import Cell
from resgrid.core.regions import crossed_faces, sides_of_cells
from resgrid.errors import InputError
from resgrid.live_page.drawing import Drawing
from resgrid.live_page.lattice_frames import at_cells, flows, segments, step_currents
from resgrid.live_page.messages import in_page_words
from resgrid.live_page.solving import SolvedDrawing, solve_drawing, without_imperfections
from resgrid.planning.any_field import AnyField, FieldPath
from resgrid.planning.lattice_fields import LatticeField
from resgrid.planning.streamline import Outcome

MAX_CIRCUIT_SIDE = 10
"""Largest number of cells per axis of a grid whose circuit the page draws."""

NO_VALUE = 65535
"""Pixel value that marks cells without a value in 16-bit pictures; all other pixel values are smaller."""

_SPEED_DECADES = 6.0
"""Decrease of the current, in orders of magnitude, over which the speed of the moving dots falls linearly from the
largest speed to 0; the smallest speed is 0.2 of the largest one.
"""

_SMALLEST_DROP = 1e-7
"""Smallest drop, as a fraction of the supply, that the page shows in a preview, also where the drop is smaller.

The solution of a preview has normwise accuracy and does not resolve smaller drops.
"""


def describe(frame: SolvedDrawing) -> tuple[dict[str, Any], list[bytes]]:
    """Return the description of a solved drawing for the page: a dictionary for JSON, and four arrays as bytes.

    Keys: ``exact`` (whether the solution is direction-safe), ``paths`` (dictionary for each path, with ``outcome``,
    number of ``points``, and ``length`` and ``clearance`` in axis units or the reason as ``message``; the outcome is
    None where a preview, a quick solution during a mouse gesture, is too inaccurate for a path), ``seconds`` (computing
    time), ``methods`` (names of the solvers), ``cells`` and ``cut_off`` (numbers of free cells, and of free cells
    without a path to a goal), ``flat`` (list with the name of that circuit of a blend that carries no current, empty if
    both do), ``scale`` (``kind``, ``low`` and ``high``: quantity, lowest and highest value of the picture), and
    ``circuit`` (resistors and supplies; None for more than 10 cells per axis), which is absent unless the solution has
    exactly one operating point.

    The arrays are the points of all paths, a picture, face currents and speeds of dots that show the flow.  Points:
    float32 (points, 2), measured from the lower corner of the grid in cell widths, continuous across the seams of
    periodic axes.  Picture: uint16 (nx, ny), `NO_VALUE` for cells without a value.  Currents: int8 (nx, ny, 4), through
    the lower and the upper face across each axis, positive along the axis, ±127 for the largest current of the cell.
    Speeds: uint8 (nx, ny), 255 for the fastest dots.
    """
    field = frame.field
    lines = [_line(path) for path in frame.paths]
    head: dict[str, Any] = {
        "exact": frame.exact,
        "paths": [_path_head(path, len(line)) for path, line in zip(frame.paths, lines, strict=True)],
        "seconds": frame.seconds,
        "methods": sorted({op.method for op in frame.solution.operating_points.values()}) or ["warm start"],
        "cells": int((frame.drawing.cell == Cell.FREE).sum()),
        "cut_off": int(((frame.drawing.cell == Cell.FREE) & ~field.space.goal_connected).sum()),
        "flat": list(frame.solution.flat),
    }
    points = list(frame.solution.operating_points.values())
    if len(points) == 1:
        head["circuit"] = _circuit(points[0])
    scale, picture = picture_of(frame)
    currents, speed = _currents(field)
    body = [np.concatenate(lines or [np.empty((0, 2))]).astype("<f4"), picture, currents, speed]
    return head | {"scale": scale}, [part.tobytes() for part in body]


def describe_others(drawing: Drawing, names: Sequence[str]) -> tuple[dict[str, Any], list[bytes]]:
    """Return certified paths in fields other than that of a drawing: a dictionary for JSON, and the points as bytes.

    The key ``points`` holds, for every name, a list of the numbers of points of its paths, 0 if the start or the goal
    is blocked or no path exists.  The bytes of the paths are in the same order: float32 (points, 2), measured from the
    lower corner of the grid in cell widths, continuous across the seams of periodic axes.  `names`: ``"ideal"`` for the
    field of the chip without imperfections, ``"k = 0"`` and ``"k = 1"`` for the Neumann and the Dirichlet field of the
    blend.
    """
    others = {"ideal": without_imperfections(drawing)}
    if not drawing.driven:
        others |= {"k = 0": replace(drawing, k=0.0), "k = 1": replace(drawing, k=1.0)}
    missing = [name for name in names if name not in others]
    if missing:
        raise InputError(f"a grid that is driven by the start has no {missing[0]}: choose the uniform drive")
    lines = [[_line(path) for path in solve_drawing(others[name], exact=True).paths] for name in names]
    body = [line.astype("<f4").tobytes() for other in lines for line in other]
    return {"points": [[len(line) for line in other] for other in lines]}, body


def _line(path: FieldPath | None) -> NDArray[np.float64]:
    if path is None or path.outcome not in {Outcome.REACHED, Outcome.NO_CURRENT}:
        return np.empty((0, 2))
    return (path.line - path.space.lower) / path.space.spacing


def _path_head(path: FieldPath | None, points: int) -> dict[str, Any]:
    if path is None:
        return {
            "outcome": None,
            "points": 0,
            "message": "the preview is too inaccurate here: the path appears after release",
        }
    head = {"outcome": str(path.outcome), "points": points, "goal": path.goal, "cells": len(path.cells)}
    if path.outcome is Outcome.REACHED:
        return head | {"length": path.length, "clearance": path.clearance}
    return head | {"message": in_page_words(path.reason or "")}


def picture_of(frame: SolvedDrawing) -> tuple[dict[str, Any], NDArray[np.uint16]]:
    """Return the scale and the picture uint16 (nx, ny) of a field.

    The picture shows log10 of the drop if the field has an obstacle rail, otherwise the normalised potential.  The
    scale is a dictionary with the keys ``kind`` (``"decades"`` for log10 of the drop, ``"height"`` for the potential),
    ``low`` and ``high`` (lowest and highest of these values).  Pixel values from 0 to 65534 are linear between low and
    high; 65535 marks cells without a finite value, and cells that are neither goal cells nor connected to a goal.
    `frame`: solved drawing.
    """
    field = frame.field
    goal, log_drop = field.space.cell == Cell.GOAL, _log_drop(frame)
    if log_drop is not None:
        kind, value = "decades", np.where(goal, 0.0, log_drop / np.log(10.0))
    else:
        kind, value = "height", np.where(goal, 0.0, at_cells(field, field.potential))
    shown = (goal | field.space.goal_connected) & np.isfinite(value)
    low, high = (float(value[shown].min()), float(value[shown].max())) if shown.any() else (0.0, 0.0)
    return {"kind": kind, "low": low, "high": high}, quantised(value, shown, low, high)


def quantised(value: NDArray[np.float64], shown: NDArray[np.bool_], low: float, high: float) -> NDArray[np.uint16]:
    """Return values scaled linearly from [low, high] to [0, 65534] as uint16, in the shape of `value`.

    `value`: values, inside the mask between low and high; `shown`: mask of the same shape; entries outside the mask
    become `NO_VALUE` (65535).
    """
    fraction = np.where(shown, (value - low) / (high - low), 0.0) if high > low else np.zeros_like(value)
    return np.where(shown, np.rint(fraction * (NO_VALUE - 1)), NO_VALUE).astype("<u2")


def _log_drop(frame: SolvedDrawing) -> NDArray[np.float64] | None:
    """Return the natural logarithm of the drop, shape of the space; None if the circuit has no obstacle rail.

    The drop is a fraction of the supply.  The drop of a blend is ``k u_D + (1 - k) (1 - phi_N)``, with the Dirichlet
    drop u_D and the Neumann potential phi_N.
    """
    field = frame.field
    if not 0.0 < field.k < 1.0:
        return _log_drop_of(field)
    obstacle, opened = frame.solution.halves
    log_drop = _log_drop_of(obstacle)
    if log_drop is None:
        return None
    with np.errstate(divide="ignore", invalid="ignore"):  # cells without a path to a goal
        other = np.log(np.maximum(1.0 - at_cells(opened, opened.potential), 0.0))
        if opened.log_drop is not None:
            other = at_cells(opened, opened.log_drop)
        rest = np.log1p(-field.k) + other
        return np.asarray(np.logaddexp(np.log(field.k) + log_drop, rest))


def _log_drop_of(field: AnyField) -> NDArray[np.float64] | None:
    """Return the natural logarithm of the drop of one circuit, shape of the space; None without an obstacle rail.

    The drop is a fraction of the supply.  `field`: field of one circuit, for a blend its Dirichlet part.  In a preview
    (quick solution during a mouse gesture), drops below 1e-7 are replaced by 1e-7, because normwise accuracy does not
    resolve them.
    """
    if field.log_drop is not None:
        return at_cells(field, field.log_drop)
    if field.wiring.is_driven:
        return None
    return np.asarray(np.log(np.maximum(1.0 - at_cells(field, field.potential), _SMALLEST_DROP)))


def _currents(field: AnyField) -> tuple[NDArray[np.int8], NDArray[np.uint8]]:
    """Return the relative face currents int8 (nx, ny, 4) and the speeds of the moving dots uint8 (nx, ny).

    Currents flow through the lower and the upper face across each axis, positive along the axis; the largest current of
    each cell is ±127.  Only free cells have currents.  The speed is 255 at large currents, falls with their logarithm
    to at least 51, and is 0 in cells without a current.
    """
    if isinstance(field, LatticeField):
        flow, largest = flows(field)
        flowing = np.isfinite(largest) & (field.space.cell == Cell.FREE)
        size = np.abs(flow).max(axis=-1, keepdims=True)
        both = np.rint(127.0 * np.divide(flow, size, out=np.zeros_like(flow), where=size > 0)).astype(np.int8)
        return np.where(flowing[..., np.newaxis], np.repeat(both, 2, axis=-1), np.int8(0)), _speed(largest, flowing)
    log_current, direction = (
        [part for axis in range(2) for part in sides_of_cells(values[axis], axis)]
        for values in (field.face_log_current, field.face_direction)
    )
    largest = reduce(np.maximum, log_current)
    flowing = np.isfinite(largest) & (field.space.cell == Cell.FREE)
    base = np.where(flowing, largest, np.inf)
    currents = np.empty((*largest.shape, 4), dtype=np.int8)
    for side in range(4):
        fraction = np.exp((log_current[side] - base).astype(np.float32))
        currents[..., side] = np.rint(np.float32(127.0) * direction[side] * fraction)
    return currents, _speed(largest, flowing)


def _speed(largest: NDArray[np.float64], flowing: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return the speeds of the moving dots, uint8 (nx, ny).

    The speed is 255 for currents above their 98th percentile, and falls linearly with the logarithm of smaller currents
    to at least 51; in cells without a current it is 0.  `largest` (nx, ny): natural logarithm of the largest current of
    each cell; `flowing` (nx, ny): mask of the cells with a current.
    """
    decades = largest / np.log(10.0)
    top = np.quantile(decades[flowing], 0.98) if flowing.any() else 0.0
    speed = np.clip(1.0 + (np.where(flowing, decades, top) - top) / _SPEED_DECADES, 0.2, 1.0)
    return np.where(flowing, np.rint(255.0 * speed), 0).astype(np.uint8)


def probe(frame: SolvedDrawing, cell: Sequence[int]) -> dict[str, Any]:
    """Return the properties of a cell as a dictionary for JSON.

    Keys: `cell`: index along each axis; `centre`: centre of the cell, in axis units; `kind`: ``"free"``, ``"obstacle"``
    or ``"goal"``; `conductivity`: relative conductivity; `potential`: normalised potential, 0 to 1, NaN in a cell
    without a node; `volts`: voltage of the node, None for a blend, and for a preview (quick solution during a mouse
    gesture) of a circuit that current sources drive; `drop_decades`: log10 of the drop as a fraction of the supply,
    None without an obstacle rail; `amperes`: currents through the lower and the upper face across the first axis, then
    across the second, positive along the axis, or, for other lattices than "square", `steps`: lists of an arrow
    (character such as "↗"), the current along a step to a neighbour, positive outwards, and whether paths take this
    step; `bits`: bits of an analogue-to-digital converter that resolve the voltage step to the neighbour with the
    lowest potential, None if unknown; `exact`: whether the solution is direction-safe; `proved`: sentences on proved
    properties.  Where `volts` is None, the currents are those of a circuit in which the potential 1 is the supply.

    `frame`: the solved drawing; `cell`: index along each axis.  Raises InputError for a cell outside the grid.
    """
    space, drawing = frame.field.space, frame.drawing
    index = (int(cell[0]), int(cell[1]))
    if not all(0 <= part < size for part, size in zip(index, space.shape, strict=True)):
        raise InputError(f"there is no cell {list(index)} in the grid of {' x '.join(map(str, space.shape))} cells")
    wiring = frame.field.wiring
    scale = frame.volts_per_potential
    unit = (wiring.supply if scale is None else scale) / wiring.resistance
    phi = float(at_cells(frame.field, frame.field.potential)[index])
    log_drop = _log_drop(frame)
    drop = None if log_drop is None else float(log_drop[index]) / np.log(10.0)
    return {
        "cell": list(index),
        "centre": space.axis_centre(index).tolist(),
        "kind": Cell(int(drawing.cell[index])).name.lower(),
        "conductivity": drawing.palette[int(drawing.level[index])],
        "potential": phi,
        "volts": None if scale is None else wiring.goal_voltage + phi * scale,
        "drop_decades": drop,
        **_currents_of(frame.field, index, unit),
        "bits": _bits(frame, index),
        "exact": frame.exact,
        "proved": _proved(frame, index),
    }


def _currents_of(field: AnyField, index: tuple[int, int], unit: float) -> dict[str, Any]:
    """Return the currents of a cell as a dictionary for JSON, with the key ``amperes`` or ``steps``.

    ``amperes``: currents through the lower and the upper face across the first axis, then across the second, positive
    along the axis; ``steps`` (lattices other than "square"): lists of an arrow, the outward current along a step to a
    neighbour in amperes, and whether paths take this step. `index`: index of the cell along each axis; `unit`: unit of
    the field's currents, in amperes.
    """
    if isinstance(field, LatticeField):
        return {"steps": [[arrow, unit * amperes, leads] for arrow, amperes, leads in step_currents(field, index)]}
    direction, log_current = field.faces_of(np.array([index]))
    return {"amperes": (unit * direction[:, 0].T * np.exp(log_current[:, 0].T)).ravel().tolist()}


def _proved(frame: SolvedDrawing, index: tuple[int, int]) -> list[str]:
    """Return statements about a cell that are proved for this solution, as sentences, for the display.

    The list is empty for cells that are not free or not connected to a goal.  For a preview (quick solution during a
    mouse gesture), the only sentence states that nothing is certified.  `index`: index of the cell along each axis.
    """
    if not frame.exact:
        return ["preview: not certified"]
    if frame.drawing.cell[index] != Cell.FREE or not frame.field.space.goal_connected[index]:
        return []
    proved = ["current leaves to lower potential", "Kirchhoff's law holds to 1e-6"]
    if isinstance(frame.field, LatticeField):
        proved = ["the largest current density leads to a lower potential"]
    for number, path in enumerate(frame.paths, 1):
        if path is not None and path.outcome is Outcome.REACHED and (path.cells == index).all(axis=1).any():
            proved.append(f"path {number} passes here, certified to goal {path.goal}")
    return proved


def _bits(frame: SolvedDrawing, index: tuple[int, ...]) -> float | None:
    """Return the bits of an analogue-to-digital converter that resolve the voltage step from a cell to a neighbour.

    The neighbour is the one with the lowest potential.  The result is None for cells that are not free, for blends of
    two circuits, for previews (quick solutions during a mouse gesture) without an operating point, and for lattices
    other than "square".  `index`: index of the cell along each axis.
    """
    from resgrid.chip.adc_resolution import analyse_adc_resolution

    points = frame.solution.operating_points
    if len(points) != 1 or frame.drawing.cell[index] != Cell.FREE or isinstance(frame.field, LatticeField):
        return None
    return float(analyse_adc_resolution(next(iter(points.values()))).cell_bits[index])


def _circuit(op: OperatingPoint) -> dict[str, Any] | None:
    """Return resistors, supplies and injected currents as a dictionary for JSON; None for more than 10 cells per axis.

    `resistors`: lists of axis, i, j (the resistor at the lower face of cell (i, j) across this axis), ohms, and volts
    and amperes from the lower to the upper side; `supplies`: name of the rail, volts and delivered amperes of every
    voltage source; `fed`: amperes injected into every driven node, None without injected currents; `leak`: median ohms
    of the leaks of the nodes, None without leaks.  For other lattices than "square", `resistors` is empty and `leak`
    None; the keys ``segments``, ``contacts`` and ``nodes`` describe the resistors by the places of their ends.
    """
    netlist, found = op.netlist, op.netlist.space_map
    assert found is not None
    if max(found.space.shape) > MAX_CIRCUIT_SIDE:
        return None
    supplies = [
        {"rail": _rail(op, int(plus)), "volts": volts, "amperes": -amps}
        for plus, volts, amps in zip(
            netlist.source_nodes[:, 0], netlist.source_volts.tolist(), op.source_current.tolist(), strict=True
        )
    ]
    fed = float(netlist.current_amps.max()) if len(netlist.current_amps) else None
    if netlist.lattice_map is not None:
        return {"resistors": [], "supplies": supplies, "fed": fed, "leak": None, **segments(op)}
    leaks = 1.0 / netlist.conductance[netlist.cells.leak_cell >= 0]
    leak = float(np.median(leaks)) if leaks.size else None
    return {"resistors": _resistors(op), "supplies": supplies, "fed": fed, "leak": leak}


def _resistors(op: OperatingPoint) -> list[list[float]]:
    """Return a list of axis, i, j, ohms, volts and amperes for each resistor that crosses a face between cells.

    The face is the lower face of cell (i, j) across the axis; volts and amperes are from its lower to its upper side.
    """
    cells = op.netlist.cells
    ohms = 1.0 / op.netlist.conductance
    amperes = np.where(cells.resistor_upward, 1.0, -1.0) * op.resistor_current
    across, index = crossed_faces(cells.resistor_face, cells.space.shape)
    columns = [column[across >= 0] for column in (across, *index.T, ohms, ohms * amperes, amperes)]
    return [list(row) for row in zip(*(column.tolist() for column in columns), strict=True)]


def _rail(op: OperatingPoint, node: int) -> str:
    cells = op.netlist.space_map
    assert cells is not None
    if node == cells.obstacle_node:
        return "obstacles"
    return f"goal {cells.goal_nodes.index(node)}" if node in cells.goal_nodes else "start"
