"""Flaws of the chip that the page shows: mismatch, and resistors that were broken one by one."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from resgrid.circuit.operating_point import OperatingPoint
from resgrid.netlist import Netlist
from resgrid.page.drawing import Drawing
from resgrid.planning.road import Solver

if TYPE_CHECKING:
    from resgrid.chip.passes import Pass


def flaws_of(drawing: Drawing) -> list[Pass]:
    """Passes that make a drawing's chip of an ideal one; none where it has no flaws."""
    chip = drawing.chip or {}
    sigma = chip.get("mismatch", 0.0)
    if not sigma and not drawing.broken:
        return []
    from resgrid.chip.passes import Faults, Mismatch

    mismatch = [Mismatch(sigma=sigma, seed=chip.get("seed", 0))] if sigma else []
    return [*mismatch, *([Faults(open_at=drawing.broken)] if drawing.broken else [])]


def flawed(solver: Solver, drawing: Drawing) -> Solver:
    """A solver of netlists that have the flaws of a drawing; the same solver where there are none."""
    flaws = flaws_of(drawing)
    return partial(_solve_flawed, solver, flaws) if flaws else solver


def _solve_flawed(solver: Solver, flaws: list[Pass], netlist: Netlist, **options: object) -> OperatingPoint:
    from resgrid.chip.build import build_chip

    return solver(build_chip(netlist, flaws), **options)
