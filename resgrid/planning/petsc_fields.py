"""Fields of spaces too large for the memory of one process: PETSc processes solve them from memory-mapped files.

No netlist is compiled.  The equations are written, and the solution is read and checked, one slab at a time: a range of
indices along the first axis.  The arrays of the resulting field are memory-mapped files, too.

PETSc stops at a residual norm.  Afterwards every cell is tested for direction safety.  A streamline ends at a cell that
fails the test; in a Dirichlet field these are cells far from the goals.

The unknown of a circuit between two rails is the drop ``u`` from the high rail: 0 on that rail, 1 on the goals.  With
a uniform drive the unknown is the height above the goals.  Conductances are in units of ``1 / resistance``.
"""

from __future__ import annotations

import json
import os
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.format import open_memmap
from numpy.typing import DTypeLike, NDArray

from resgrid._internal.files import temporary_folder
from resgrid._internal.memory import require_disk, require_memory
from resgrid._internal.values import frozen
from resgrid.core.cell import Cell
from resgrid.core.compiler import CellRole, contacts_of_box
from resgrid.core.drive_checks import FLAT, NO_GOAL, WALLED_IN
from resgrid.core.regions import by_axis, cells_at_faces, face_counts, sides_of_cells, with_margin
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import Wiring
from resgrid.errors import CircuitError, InputError
from resgrid.planning.fields import Field
from resgrid.planning.kcl_check import face_currents, obeys_kcl
from resgrid.solvers.petsc import Report, find_petsc, run_ranks

RTOL = 1e-14
"""Requested norm of the residual, as a fraction of the norm of the right-hand side; close to float64 rounding error."""

_BYTES = {1: 400, 2: 500, 3: 1200, 4: 2500}
"""Peak memory of all PETSc processes (ranks) together, in bytes per cell, by the number of axes; measured on grids
without obstacles."""

_BYTES_OF_RANK = 8e7
"""Memory of a PETSc process (rank) without any cell, in bytes."""

_CELLS = 2**20
"""Approximate number of cells of a slab (a range of indices along the first axis), whose arrays take about 100 MB."""


@frozen
@dataclass(frozen=True, eq=False)
class Ranked:
    """A field solved by PETSc processes (ranks), with the statistics of the solve.

    `field`: field whose arrays are memory-mapped files; the system deletes the files when the arrays are deleted;
    `report`: statistics of the solve.
    """

    field: Field
    report: Report


def solve_ranked(space: ConfigurationSpace, wiring: Wiring, ranks: int | None, launcher: str | None = None) -> Ranked:
    """Return the field of the ideal circuit of a space with merged rails, solved by PETSc processes (ranks).

    Files for the exchange with PETSc are in the system's folder for temporary files (``TMPDIR``) and are deleted at the
    end.  `ranks`: number of processes on this computer, None with a launcher; `launcher`: command that starts the
    processes and sets their number.  A launcher may start processes on other computers, which must share the folder
    under the same path; their memory is not checked.

    Raises
    ------
    InputError
        If the wiring does not fit the space, PETSc rejects an option of ``PETSC_OPTIONS``, or the launcher belongs to
        another MPI than PETSc.
    ToolMissingError
        If PETSc or the launcher is not installed.
    BudgetError
        If the memory or the disk space is too small.
    CircuitError
        If no current flows, or obstacles enclose every goal.
    AccuracyError
        If a rank fails or dies.
    """
    wiring = wiring.on(space)
    if wiring.rails != "merged":
        raise InputError("method 'petsc' solves the ideal grid, whose rails are merged: choose rails = 'merged'")
    if not space.goal_count:
        raise InputError(NO_GOAL)
    if not space.goal_connected.any():
        raise CircuitError(WALLED_IN)
    petsc, cells = find_petsc(launcher), space.cell.size
    if launcher is None:
        assert ranks is not None
        _require_memory_of(space, ranks)
    with temporary_folder() as folder:
        require_disk(_disk(space), folder, f"{cells:,} cells in mapped files")
        seconds = dict[str, float]()
        start = time.perf_counter()
        write_equations(space, wiring, folder, RTOL)
        if launcher is not None:
            _write_through(folder)
        seconds["assemble"] = time.perf_counter() - start
        report = run_ranks(petsc, folder, ranks)
        start = time.perf_counter()
        field = _read(space, wiring, np.load(folder / "answer.npy", mmap_mode="r"), folder)
        seconds |= {**report.seconds, "read": time.perf_counter() - start}
    return Ranked(field, replace(report, seconds=seconds))


def _require_memory_of(space: ConfigurationSpace, ranks: int) -> None:
    """Raise BudgetError if this computer has too little memory for `ranks` processes; warn if it has fewer cores."""
    cores, cells = os.cpu_count() or 1, space.cell.size
    if ranks > cores:
        warnings.warn(f"more ranks ({ranks}) than cores ({cores}): they wait for one another", stacklevel=3)
    job, remedy = f"solving {cells:,} cells by method 'petsc' on {ranks} ranks", "take fewer ranks, or larger cells"
    require_memory(_BYTES[space.ndim] * cells + _BYTES_OF_RANK * ranks, job, remedy)


def _write_through(folder: Path) -> None:
    """Write cached pages of all arrays in `folder` to the disk, so that computers that share the folder read them."""
    for file in folder.glob("*.npy"):
        with file.open("r+b") as opened:
            os.fsync(opened.fileno())


def slabs(space: ConfigurationSpace) -> Iterator[tuple[int, int]]:
    """Return an iterator over the slabs of a space: index ranges (first, end) along the first axis.

    A slab has about `_CELLS` cells, or a single index of the first axis if the cells with one index are more.
    """
    size, step = space.shape[0], max(1, _CELLS // prod(space.shape[1:]))
    return ((first, min(first + step, size)) for first in range(0, size, step))


def write_equations(space: ConfigurationSpace, wiring: Wiring, folder: Path, rtol: float) -> None:
    """Write the equations of the circuit to files in `folder` for the PETSc processes, one slab of cells at a time.

    Arrays, all of the shape of the space, are written to files named as follows, conductances in units of ``1 /
    resistance``.  ``ahead_A``: conductance to the next cell along axis number ``A``; ``ground``: sum of the
    conductances to rails; ``drive``: right-hand side, the sum of the conductances to goals, or 1 with a uniform drive;
    ``answer``: space for the solution.  ``system.json`` contains the shape and `rtol`, the requested norm of the
    residual, relative to the norm of the right-hand side.

    Raises
    ------
    CircuitError
        If no goal-connected cell has a resistor to the high rail or an injected current.
    """
    driven = False
    names = [*(f"ahead_{axis}" for axis in range(space.ndim)), "ground", "drive", "answer"]
    *ahead, ground, drive, _ = (
        open_memmap(folder / f"{name}.npy", mode="w+", dtype=np.float64, shape=space.shape) for name in names
    )
    for first, last in slabs(space):
        contacts = contacts_of_box(space, wiring, [(first, last)])
        inner = contacts.kind[(slice(1, -1),) * space.ndim] == CellRole.NODE
        ties, fed = np.zeros(inner.shape), np.zeros(inner.shape)
        for axis, siemens in enumerate(contacts.conductance):
            lower, upper = cells_at_faces(contacts.kind, axis)
            g = siemens * wiring.resistance
            low, up = sides_of_cells(g, axis)
            for here, beside in ((low, sides_of_cells(lower, axis)[0]), (up, sides_of_cells(upper, axis)[1])):
                ties += np.where(beside != CellRole.NODE, here, 0.0)
                fed += np.where(beside == CellRole.LOW, here, 0.0)
            joined = np.where((lower == CellRole.NODE) & (upper == CellRole.NODE), g, 0.0)
            ahead[axis][first:last] = sides_of_cells(joined, axis)[1]
        if contacts.leak:  # from the high rail, which is at 0
            ties += np.where(space.cell[first:last] == Cell.FREE, contacts.leak * wiring.resistance, 0.0)
        ground[first:last] = np.where(inner, ties, 0.0)
        served = inner & space.goal_connected[first:last]
        driven |= bool(np.any(served if wiring.drive == "uniform" else served & (ties > fed)))
        drive[first:last] = inner if wiring.drive == "uniform" else np.where(inner, fed, 0.0)
    if not driven:
        raise CircuitError(FLAT)
    (folder / "system.json").write_text(json.dumps({"shape": space.shape, "rtol": rtol}))


@dataclass(frozen=True, eq=False)
class SlabReading:
    """Values, currents and direction safety of the cells of one slab (a range of indices along the first axis).

    `value` (shape of the slab): the unknown of every cell, NaN in cells without a node: the drop from the high rail as
    a fraction of the supply, or, with a uniform drive, the height above the goals in units of the injected current of a
    cell times the resistance; `current`: one array per axis, the currents through the faces across that axis
    (one more than cells along it), positive in the direction of the axis, in units of ``1 / resistance`` times the unit
    of `value`; `safe` (shape of the slab): mask of the cells out of which current flows, and in which the KCL residual,
    rounding errors included, is at most 1e-6 of the cell's through-current.
    """

    value: NDArray[np.float64]
    current: list[NDArray[np.float64]]
    safe: NDArray[np.bool_]


def read_rows(
    space: ConfigurationSpace, wiring: Wiring, answer: NDArray[np.float64], rows: tuple[int, int]
) -> SlabReading:
    """Return values, currents and direction safety of the cells of a slab (a range of cells along the first axis).

    `answer` (shape of the space): PETSc's solution: drops from the high rail as fractions of the supply, or with a
    uniform drive heights above the goals, in units of the injected current of a cell times the resistance; `rows`:
    first index of the slab along the first axis, and the index after the last.  The result has drops if `answer` has
    drops, else heights.
    """
    contacts = contacts_of_box(space, wiring, [rows])
    falls = wiring.drive != "uniform"  # a drop grows from the high rail to the goals
    value = np.where(contacts.kind == CellRole.NODE, with_margin(answer, space.periodic, [rows]), np.nan)
    value[contacts.kind == CellRole.LOW] = 1.0 if falls else 0.0
    value[contacts.kind == CellRole.HIGH] = 0.0
    conductance = [siemens * wiring.resistance for siemens in contacts.conductance]
    currents = face_currents(conductance, -value if falls else value)
    inside = (slice(1, -1),) * space.ndim
    own = contacts.kind[inside] == CellRole.NODE
    start = (contacts.kind[inside] == CellRole.HIGH) & (space.cell[slice(*rows)] == Cell.FREE)
    leaked = contacts.leak * wiring.resistance * np.where(own, value[inside], 0.0)
    injected = leaked if falls else np.ones_like(leaked)
    safe = (own | start) & obeys_kcl(conductance, value, currents, injected, held=~own, uncertain=np.abs(leaked))
    return SlabReading(value[inside], currents, safe)


def _disk(space: ConfigurationSpace) -> int:
    """Return the disk space, in bytes, of all files of equations, solution and field together."""
    return prod(space.shape) * 8 * (space.ndim + 3) + 9 * sum(face_counts(space.shape)) + 17 * prod(space.shape)


def _read(space: ConfigurationSpace, wiring: Wiring, answer: NDArray[np.float64], folder: Path) -> Field:
    """Return the field of PETSc's solution `answer` (shape of the space), with arrays in mapped files in `folder`."""

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
        k=0.0 if wiring.is_open else 1.0,
        safe=safe,
    )
