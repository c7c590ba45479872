"""Solution of drawings: normwise previews during a mouse gesture, or direction-safe fields with certified paths."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.solve import solve
from resgrid.circuit.warm_start import WarmStart
from resgrid.core.cell import Cell
from resgrid.core.lattice import SQUARE
from resgrid.core.netlist import Netlist
from resgrid.errors import AccuracyError, CircuitError, InputError
from resgrid.live_page.drawing import Drawing
from resgrid.planning.any_field import AnyField, FieldPath
from resgrid.planning.certify import certify
from resgrid.planning.fields import Field, read_cells
from resgrid.planning.lattice_fields import LatticeField
from resgrid.planning.node_paths import follow_nodes
from resgrid.planning.pipeline import Problem, Solution, SolveOptions, Solver, solve_problem
from resgrid.planning.trace import follow, start_points

if TYPE_CHECKING:
    from resgrid.chip.effects import Effect

_TOLERANCE = 1e-6
"""Largest normwise relative backward error of the voltages of a preview (quick solution during a mouse gesture)."""


class WarmFields:
    """Solver of previews (quick solutions during a mouse gesture) of chips without imperfections.

    Each call starts its iteration from the fields of the previous call.
    """

    def __init__(self) -> None:
        self._starts: dict[str, WarmStart] = {}

    def solve(self, problem: Problem) -> Solution:
        """Return the fields of a problem with normwise accuracy, without operating points.

        Raises CircuitError if a circuit carries no current, AccuracyError if a circuit is too stiff; after an error,
        the next call starts without previous fields.
        """
        pure = dict[str, Field]()
        for name, wiring in problem.wirings.items():
            start = self._starts.pop(name, None)  # after an error, the next call starts without previous fields
            if start is None or start.wiring != wiring:
                start = WarmStart(wiring, rtol=_TOLERANCE)
            point = start.solve(problem.space)
            pure[name] = read_cells(point.space, point.wiring, point.voltage, check=False)
            self._starts[name] = start
        return Solution(problem, {}, pure)


@dataclass(frozen=True, eq=False)
class SolvedDrawing:
    """The solution of a drawing: direction-safe, or a preview (quick solution during a mouse gesture).

    `drawing`: the drawing; `solution`: circuits and fields of the drawing; `paths`: one per start, None where the field
    of a preview is too inaccurate for a path; `exact`: whether the field is direction-safe and the paths are certified
    (False for a preview); `seconds`: computing time in seconds.
    """

    drawing: Drawing
    solution: Solution
    paths: tuple[FieldPath | None, ...]
    exact: bool
    seconds: float

    @property
    def field(self) -> AnyField:
        """Field that the page displays: the blend with the weight k, or the field of the first start that drives."""
        return self.solution.fields[0]

    @property
    def volts_per_potential(self) -> float | None:
        """Voltage above the goal rail, in volts, where the potential is 1.

        This is the supply if the obstacle rail drives the circuit.  For a circuit that current sources drive, it is the
        highest voltage of a free node; it is None if there is no operating point with voltages, as in a preview (quick
        solution during a mouse gesture) that starts from the previous fields.  None also for a blend of two circuits.
        """
        if not self.field.wiring.is_driven:
            return None if 0.0 < self.drawing.k < 1.0 else float(self.field.wiring.supply)
        point = next(iter(self.solution.operating_points.values()), None)
        return None if point is None else potential_scale(point)


def potential_scale(op: OperatingPoint) -> float:
    """Return the voltage above the goal rail, in volts, where the potential is 1.

    The result is the supply where an obstacle rail drives the circuit; otherwise the voltage above the goal rail of the
    free node with the largest magnitude of this voltage, with its sign, or 1 V if this voltage is 0.
    """
    wiring, free = op.netlist.cells.wiring, op.netlist.cells.free_node
    if not wiring.is_driven:
        return float(wiring.supply)
    above = op.voltage[free] - wiring.goal_voltage
    return float(above[np.nanargmax(np.abs(above))]) or 1.0


def solve_drawing(drawing: Drawing, *, exact: bool, warm: WarmFields | None = None) -> SolvedDrawing:
    """Return the solution of a drawing, with a path for every start; raise InputError without a goal.

    `exact`: True for a direction-safe field and certified paths, False for a preview (quick solution with normwise
    accuracy, paths not certified); `warm`: solver of previews of ideal chips that starts from the previous fields, None
    to solve without previous fields.  Lattices other than "square" have no previews: their solutions are always
    direction-safe.
    """
    began = time.perf_counter()
    if not (drawing.cell == Cell.GOAL).any():
        raise InputError("there is no goal: set a goal with the goal tool")
    if drawing.driven and not len(drawing.starts):
        raise InputError("there is no start to drive the grid: set a start, or choose the uniform drive")
    if drawing.lattice != SQUARE:
        exact = True  # a path from node to node needs direction-safe currents
        if imperfections_of(drawing):
            raise InputError(
                "mismatch and open resistors need the lattice of face neighbours: choose the lattice square, or set "
                "the mismatch to none and repair the resistors"
            )
    solution = _solved(drawing, exact, warm)
    points = start_points(drawing.space, drawing.starts) if len(drawing.starts) else ()
    paths = tuple(_path(field, points[number], exact) for field, number in solution.tasks)
    return SolvedDrawing(drawing, solution, paths, exact, time.perf_counter() - began)


def _solved(drawing: Drawing, exact: bool, warm: WarmFields | None) -> Solution:
    imperfections = imperfections_of(drawing)
    if warm is not None and not exact and not drawing.driven and not imperfections:
        with suppress(CircuitError, AccuracyError):  # a field of the blend is zero, or the circuit is too stiff
            return warm.solve(drawing.problem)
    solver = solve if exact else partial(solve, accuracy="normwise", rtol=_TOLERANCE)
    return solve_problem(
        drawing.problem, work=SolveOptions(_with_imperfections(solver, imperfections) if imperfections else solver)
    )


def _path(field: AnyField, point: NDArray[np.float64], exact: bool) -> FieldPath | None:
    if isinstance(field, LatticeField):
        nodes = follow_nodes(field, point)
        certify(nodes)
        return nodes
    if not exact:
        field = replace(field, safe=None)
    try:
        path = follow(field, point)
    except AccuracyError:
        if exact:
            raise
        return None
    if exact:
        certify(path)
    return path


def imperfections_of(drawing: Drawing) -> list[Effect]:
    """Return the mismatch and the open resistors of a drawing's chip as a list of effects, empty for an ideal chip."""
    chip = drawing.chip or {}
    sigma = chip.get("mismatch", 0.0)
    if not sigma and not drawing.broken:
        return []
    from resgrid.chip.effects import Faults, Mismatch

    mismatch = [Mismatch(sigma=sigma, seed=chip.get("seed", 0))] if sigma else []
    return [*mismatch, *([Faults(open_at=drawing.broken)] if drawing.broken else [])]


def without_imperfections(drawing: Drawing) -> Drawing:
    """Return a copy of the drawing whose chip has no mismatch and no open resistors."""
    chip = {key: value for key, value in (drawing.chip or {}).items() if key not in ("mismatch", "seed")}
    return replace(drawing, chip=chip, broken=())


def _with_imperfections(solver: Solver, imperfections: list[Effect]) -> Solver:
    """Return a solver that applies effects of a chip to a netlist and then solves it.

    `solver`: solver of netlists; `imperfections`: effects in the order in which they are applied.
    """
    from resgrid.chip.build import build_chip

    def solve_imperfect(netlist: Netlist, **options: object) -> OperatingPoint:
        return solver(build_chip(netlist, imperfections), **options)

    return solve_imperfect
