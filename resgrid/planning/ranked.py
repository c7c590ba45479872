"""Fields of grids that do not fit: solved by PETSc's ranks from mapped files, checked slab by slab, kept mapped.

PETSc stops at a norm.  Which cells are direction-safe is found out afterwards, cell by cell, and streamlines end where
the answer no longer tells a direction; far from the goals of a Dirichlet field that is so.
"""

from __future__ import annotations

import os
import tempfile
import time
import warnings
from dataclasses import dataclass, replace
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.format import open_memmap
from numpy.typing import DTypeLike, NDArray

from resgrid.budget import require_disk, require_memory
from resgrid.circuit.slabs import read_rows, slabs, write_equations
from resgrid.compiler import WALLED_IN
from resgrid.errors import CircuitError, InputError
from resgrid.frozen import frozen
from resgrid.grids import by_axis, face_counts
from resgrid.planning.fields import Field
from resgrid.solvers.petsc import Report, find_petsc, run_ranks
from resgrid.space import ConfigurationSpace
from resgrid.wiring import Wiring

RTOL = 1e-14
"""Residual relative to the right-hand side that the ranks are asked for: what rounding leaves, mostly."""

_BYTES = {1: 400, 2: 500, 3: 1200, 4: 2500}
"""Peak memory of all ranks together, in bytes a cell, by dimension; measured on open grids."""

_BYTES_OF_RANK = 8e7
"""What a rank takes without any cell."""


@frozen
@dataclass(frozen=True, eq=False)
class Ranked:
    """A field that ranks solved, and how.

    `field`: its arrays are mapped files without names, gone with it; `report`: of the ranks.
    """

    field: Field
    report: Report


def solve_ranked(space: ConfigurationSpace, wiring: Wiring, ranks: int) -> Ranked:
    """Solve a circuit of a space, ideal and with merged rails, on so many ranks.

    Files lie in the system's folder for temporary ones (``TMPDIR``) and are gone at the end, whatever happens.

    Raises
    ------
    InputError
        If the wiring does not fit, or PETSc refuses an option of ``PETSC_OPTIONS``.
    ToolMissingError
        If there is no PETSc.
    BudgetError
        If memory or the disk has no room.
    CircuitError
        If nothing is driven, or every goal is walled in.
    AccuracyError
        If a rank fails or dies.
    """
    wiring = wiring.on(space)
    if wiring.rails != "merged":
        raise InputError("method 'petsc' solves the ideal grid, whose rails are merged: choose rails = 'merged'")
    if not space.goal_count:
        raise InputError("the space has no goal cell: add a goal, or make it at least one cell large")
    if not space.goal_connected.any():
        raise CircuitError(WALLED_IN)
    cores = os.cpu_count() or 1
    if ranks > cores:
        warnings.warn(f"more ranks ({ranks}) than cores ({cores}): they wait for one another", stacklevel=2)
    petsc = find_petsc()
    cells = space.cell.size
    job, remedy = f"solving {cells:,} cells by method 'petsc' on {ranks} ranks", "take fewer ranks, or larger cells"
    require_memory(_BYTES[space.ndim] * cells + _BYTES_OF_RANK * ranks, job, remedy)
    with tempfile.TemporaryDirectory(prefix="resgrid-") as name:
        folder = Path(name)
        require_disk(_disk(space), folder, f"{cells:,} cells in mapped files")
        seconds = dict[str, float]()
        start = time.perf_counter()
        write_equations(space, wiring, folder, RTOL)
        seconds["assemble"] = time.perf_counter() - start
        report = run_ranks(petsc, folder, ranks)
        start = time.perf_counter()
        field = _read(space, wiring, np.load(folder / "answer.npy", mmap_mode="r"), folder)
        seconds |= {**report.seconds, "read": time.perf_counter() - start}
    return Ranked(field, replace(report, seconds=seconds))


def _disk(space: ConfigurationSpace) -> int:
    """Bytes of all files together."""
    return prod(space.shape) * 8 * (space.ndim + 3) + 9 * sum(face_counts(space.shape)) + 17 * prod(space.shape)


def _read(space: ConfigurationSpace, wiring: Wiring, answer: NDArray[np.float64], folder: Path) -> Field:
    """The field of an answer, in mapped files; shape of `answer` as the space."""

    def mapped(name: str, dtype: DTypeLike, shape: tuple[int, ...]) -> Any:
        return open_memmap(folder / f"{name}.npy", mode="w+", dtype=dtype, shape=shape)

    faces = (sum(face_counts(space.shape)),)
    directions = by_axis(mapped("direction", np.int8, faces), space.shape)
    logs = by_axis(mapped("log_current", np.float64, faces), space.shape)
    potential = mapped("potential", np.float64, space.shape)
    safe = mapped("safe", np.bool_, space.shape)
    uniform = wiring.drive == "uniform"
    log_drop = None if uniform else mapped("log_drop", np.float64, space.shape)
    top = max(float(np.max(answer[first:last])) for first, last in slabs(space)) if uniform else 1.0
    for first, last in slabs(space):
        reading = read_rows(space, wiring, answer, (first, last))
        safe[first:last] = reading.safe & (reading.value >= 0.0)  # else current would enter an obstacle
        potential[first:last] = reading.value / top if uniform else 1.0 - reading.value
        with np.errstate(divide="ignore"):
            if log_drop is not None:
                log_drop[first:last] = np.log(np.maximum(reading.value, 0.0))
            for axis, current in enumerate(reading.current):
                rows = slice(first, last + (axis == 0))
                directions[axis][rows] = np.sign(current)
                logs[axis][rows] = np.log(np.abs(current) / top)
    return Field(
        space=space,
        wiring=wiring,
        potential=potential,
        log_drop=log_drop,
        face_direction=directions,
        face_log_current=logs,
        k=0.0 if wiring.is_driven else 1.0,
        safe=safe,
    )
