"""Flaws of the chip that the page shows: mismatch, and resistors that were broken one by one."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from resgrid.chip.passes import Mismatch
from resgrid.chip.passes.base import select_resistors, without_stranded_currents
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.netlist import Netlist, face_shape
from resgrid.page.drawing import Drawing
from resgrid.planning.road import Solver


def is_flawed(drawing: Drawing) -> bool:
    """Whether the page shows a chip that is not ideal."""
    return bool(drawing.broken or (drawing.chip or {}).get("mismatch"))


def flawed(solver: Solver, drawing: Drawing) -> Solver:
    """A solver of netlists that have the flaws of a drawing; the same solver where there are none."""
    chip = drawing.chip or {}
    sigma, seed = chip.get("mismatch", 0.0), chip.get("seed", 0)
    if not is_flawed(drawing):
        return solver
    mismatch = Mismatch(sigma=sigma, seed=seed) if sigma else None
    return partial(_solve_flawed, solver, mismatch, _face_numbers(drawing))


def _solve_flawed(
    solver: Solver, mismatch: Mismatch | None, broken: NDArray[np.int64], netlist: Netlist, **options: object
) -> OperatingPoint:
    if mismatch is not None:
        netlist = mismatch.apply(netlist)
    if broken.size:
        whole = ~np.isin(netlist.cells.resistor_face, broken)
        netlist = without_stranded_currents(select_resistors(netlist, whole))
    return solver(netlist, **options)


def _face_numbers(drawing: Drawing) -> NDArray[np.int64]:
    """Numbers of the faces that broken resistors cross, as in `CellMap`; on a seam both that stand for it."""
    shape, numbers = drawing.cell.shape, list[int]()
    first = [0, int(np.prod(face_shape(shape, 0)))]
    for i, j, axis in drawing.broken:
        seam = drawing.axes[axis].periodic and (i, j)[axis] in (0, shape[axis])
        for along in (0, shape[axis]) if seam else ((i, j)[axis],):
            cell = (along, j) if axis == 0 else (i, along)
            numbers.append(first[axis] + int(np.ravel_multi_index(cell, face_shape(shape, axis))))
    return np.array(numbers, dtype=np.int64)
