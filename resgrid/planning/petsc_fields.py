"""Fields of grids that do not fit: solved by PETSc's ranks from mapped files, checked slab by slab, kept mapped.

PETSc stops at a norm.  Which cells are direction-safe is found out afterwards, cell by cell, and streamlines end where
the answer no longer tells a direction; far from the goals of a Dirichlet field that is so.

In a circuit between two rails what is solved for is the drop ``u`` from the high one, 0 there and 1 on the goals; with
a uniform drive it is the height above the goals.  Conductances count in units of ``1 / resistance``.
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
from resgrid.core.compiler import FLAT, NO_GOAL, WALLED_IN, CellRole, contacts_of_box
from resgrid.core.regions import by_axis, cells_at_faces, face_counts, sides_of_cells, with_margin
from resgrid.core.space import Cell, ConfigurationSpace
from resgrid.core.wiring import Wiring
from resgrid.errors import CircuitError, InputError
from resgrid.planning.fields import Field
from resgrid.planning.kcl_check import face_currents, obeys_kcl
from resgrid.solvers.petsc import Report, find_petsc, run_ranks

RTOL = 1e-14
"""Residual relative to the right-hand side that the ranks are asked for: what rounding leaves, mostly."""

_BYTES = {1: 400, 2: 500, 3: 1200, 4: 2500}
"""Peak memory of all ranks together, in bytes a cell, by dimension; measured on open grids."""

_BYTES_OF_RANK = 8e7
"""What a rank takes without any cell."""


_CELLS = 2**20
"""Cells of a slab: what is computed of one at a time takes some 100 MB."""


@frozen
@dataclass(frozen=True, eq=False)
class Ranked:
    """A field that ranks solved, and how.

    `field`: its arrays are mapped files without names, gone with it; `report`: of the ranks.
    """

    field: Field
    report: Report


def solve_ranked(space: ConfigurationSpace, wiring: Wiring, ranks: int | None, launcher: str | None = None) -> Ranked:
    """Solve a circuit of a space, ideal and with merged rails, on some number of ranks.

    The files lie in the system's folder for temporary files (``TMPDIR``), and are removed at the end.
    With a `launcher`, a command that includes the number of ranks, `ranks` is None.  Its ranks may run on other
    computers: the folder must then be shared by all of them, under one path, and memory is checked on none of them.

    Raises
    ------
    InputError
        If the wiring does not fit, PETSc refuses an option of ``PETSC_OPTIONS``, or the launcher is of another MPI.
    ToolMissingError
        If there is no PETSc, or no such launcher.
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
    """Raise BudgetError if this computer lacks memory for some ranks; warn if it lacks cores."""
    cores, cells = os.cpu_count() or 1, space.cell.size
    if ranks > cores:
        warnings.warn(f"more ranks ({ranks}) than cores ({cores}): they wait for one another", stacklevel=3)
    job, remedy = f"solving {cells:,} cells by method 'petsc' on {ranks} ranks", "take fewer ranks, or larger cells"
    require_memory(_BYTES[space.ndim] * cells + _BYTES_OF_RANK * ranks, job, remedy)


def _write_through(folder: Path) -> None:
    """Write cached pages of all files to the disk, so that other computers that share the folder read them."""
    for file in folder.glob("*.npy"):
        with file.open("r+b") as opened:
            os.fsync(opened.fileno())


def slabs(space: ConfigurationSpace) -> Iterator[tuple[int, int]]:
    """Ranges of rows of the first axis, each of some `_CELLS` cells or a single row."""
    size, step = space.shape[0], max(1, _CELLS // prod(space.shape[1:]))
    return ((first, min(first + step, size)) for first in range(0, size, step))


def write_equations(space: ConfigurationSpace, wiring: Wiring, folder: Path, rtol: float) -> None:
    """Write the files that `resgrid.solvers.petsc_worker` reads, one slab in memory at a time.

    Raises
    ------
    CircuitError
        If no cell with a way to a goal is tied to the high rail or fed.
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
        ground[first:last] = np.where(inner, ties, 0.0)
        served = inner & space.goal_connected[first:last]
        driven |= bool(np.any(served if wiring.drive == "uniform" else served & (ties > fed)))
        drive[first:last] = inner if wiring.drive == "uniform" else np.where(inner, fed, 0.0)
    if not driven:
        raise CircuitError(FLAT)
    (folder / "system.json").write_text(json.dumps({"shape": space.shape, "rtol": rtol}))


@dataclass(frozen=True, eq=False)
class SlabReading:
    """What a slab of an answer shows.

    `value`: of every cell, 0 to 1 where the circuit is right, NaN where there is no node; `current`: per axis through
    the faces of the slab's cells, one more along that axis, in units of what a unit drives through the resistance,
    positive in the axis' direction; `safe`: cells in which KCL holds to 1e-6 of their own current, rounding included,
    and out of which current flows.
    """

    value: NDArray[np.float64]
    current: list[NDArray[np.float64]]
    safe: NDArray[np.bool_]


def read_rows(
    space: ConfigurationSpace, wiring: Wiring, answer: NDArray[np.float64], rows: tuple[int, int]
) -> SlabReading:
    """Read an answer off, and check it cell by cell.  Shapes: `answer` that of the space."""
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
    safe = (own | start) & obeys_kcl(conductance, value, currents, 0.0 if falls else 1.0, held=~own)
    return SlabReading(value[inside], currents, safe)


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
