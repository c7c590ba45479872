"""Circuits of grids too large for a netlist: equations written slab by slab to mapped files, and answers checked so.

In a circuit between two rails what is solved for is the drop ``u`` from the high one, 0 there and 1 on the goals; with
a uniform drive it is the height above the goals.  Conductances count in units of ``1 / resistance``.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import prod
from pathlib import Path

import numpy as np
from numpy.lib.format import open_memmap
from numpy.typing import NDArray

from resgrid.circuit.readout import DIRECTION_RESIDUAL
from resgrid.compiler import Kind, contacts_of_box
from resgrid.errors import CircuitError
from resgrid.grids import before_and_behind, sides_of_cells, with_margin
from resgrid.space import Cell, ConfigurationSpace
from resgrid.wiring import Wiring

_CELLS = 2**20
"""Cells of a slab: what is computed of one at a time takes some 100 MB."""

ROUNDING = 8 * np.finfo(np.float64).eps
"""What a sum of currents may be off by, relative to conductances times values."""


def slabs(space: ConfigurationSpace) -> Iterator[tuple[int, int]]:
    """Ranges of rows of the first axis, each of some `_CELLS` cells or a single row."""
    size, step = space.shape[0], max(1, _CELLS // prod(space.shape[1:]))
    return ((first, min(first + step, size)) for first in range(0, size, step))


def write_equations(space: ConfigurationSpace, wiring: Wiring, folder: Path, rtol: float) -> None:
    """Write the files that `resgrid.solvers.petsc_worker` reads, one slab in memory at a time.

    Raises
    ------
    CircuitError
        If no cell is tied to the high rail or fed.
    """
    driven = False
    names = [*(f"ahead_{axis}" for axis in range(space.ndim)), "ground", "drive", "answer"]
    *ahead, ground, drive, _ = (
        open_memmap(folder / f"{name}.npy", mode="w+", dtype=np.float64, shape=space.shape) for name in names
    )
    for first, last in slabs(space):
        contacts = contacts_of_box(space, wiring, [(first, last)])
        inner = contacts.kind[(slice(1, -1),) * space.ndim] == Kind.NODE
        ties, fed = np.zeros(inner.shape), np.zeros(inner.shape)
        for axis, siemens in enumerate(contacts.conductance):
            lower, upper = before_and_behind(contacts.kind, axis)
            g = siemens * wiring.resistance
            low, up = sides_of_cells(g, axis)
            for here, beside in ((low, sides_of_cells(lower, axis)[0]), (up, sides_of_cells(upper, axis)[1])):
                ties += np.where(beside != Kind.NODE, here, 0.0)
                fed += np.where(beside == Kind.LOW, here, 0.0)
            joined = np.where((lower == Kind.NODE) & (upper == Kind.NODE), g, 0.0)
            ahead[axis][first:last] = sides_of_cells(joined, axis)[1]
        ground[first:last] = np.where(inner, ties, 0.0)
        driven |= bool(np.any(inner if wiring.drive == "uniform" else inner & (ties > fed)))
        drive[first:last] = inner if wiring.drive == "uniform" else np.where(inner, fed, 0.0)
    if not driven:
        raise CircuitError(
            "nothing is driven: no free cell touches an obstacle, or an edge that counts as one; add what drives the "
            "grid, or choose boundary = 'neumann'"
        )
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
    current: tuple[NDArray[np.float64], ...]
    safe: NDArray[np.bool_]


def read_rows(
    space: ConfigurationSpace, wiring: Wiring, answer: NDArray[np.float64], rows: tuple[int, int]
) -> SlabReading:
    """Read an answer off, and check it cell by cell.  Shapes: `answer` that of the space."""
    contacts = contacts_of_box(space, wiring, [rows])
    falls = wiring.drive != "uniform"  # a drop grows from the high rail to the goals
    value = np.where(contacts.kind == Kind.NODE, with_margin(answer, space.periodic, [rows]), np.nan)
    value[contacts.kind == Kind.LOW] = 1.0 if falls else 0.0
    value[contacts.kind == Kind.HIGH] = 0.0
    filled = np.nan_to_num(value)
    inside = (slice(1, -1),) * space.ndim
    own = contacts.kind[inside] == Kind.NODE
    currents, magnitudes = [], []
    for axis, siemens in enumerate(contacts.conductance):
        g, (lower, upper) = siemens * wiring.resistance, before_and_behind(filled, axis)
        currents.append(g * (upper - lower if falls else lower - upper))
        magnitudes.append(g * (np.abs(lower) + np.abs(upper)))
    start = (contacts.kind[inside] == Kind.HIGH) & (space.cell[slice(*rows)] == Cell.FREE)
    safe = (own | start) & obeys_kcl(currents, magnitudes, 0.0 if falls else 1.0, held=~own)
    return SlabReading(value[inside], tuple(currents), safe)


def obeys_kcl(
    currents: Sequence[NDArray[np.float64]],
    magnitudes: Sequence[NDArray[np.float64]],
    injected: float,
    *,
    held: NDArray[np.bool_] | bool = False,
) -> NDArray[np.bool_]:
    """Cells in which KCL holds to 1e-6 of their own current, rounding included, and out of which current flows.

    Shapes: per axis `currents` through faces, in the axis' direction and down the potential, and `magnitudes`,
    conductances times the values on both sides; `injected` into every cell; `held` by sources, whatever they give.
    """
    shape = sides_of_cells(currents[0], 0)[0].shape
    net, total, rounding = (np.full(shape, start) for start in (injected, abs(injected), 0.0))
    leaves = np.zeros(shape, dtype=np.bool_)
    for axis, (amps, magnitude) in enumerate(zip(currents, magnitudes, strict=True)):
        below, above = sides_of_cells(amps, axis)
        net += below - above
        total += np.abs(below) + np.abs(above)
        rounding += sum(sides_of_cells(magnitude, axis))
        leaves |= (below < 0) | (above > 0)
    off = np.where(held, 0.0, np.abs(net)) + ROUNDING * rounding
    return np.asarray(leaves & (off <= DIRECTION_RESIDUAL * 0.5 * total))
