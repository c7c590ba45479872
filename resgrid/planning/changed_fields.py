"""Fields of a plane whose cells change: elimination is repeated only around the changes.

The field of a changed plane is a function of the changed plane alone: earlier planes save time, but change no digit.
Every field passes the check of a direction-safe field before it is returned.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.postprocess import DIRECTION_RESIDUAL
from resgrid.core.compiler import CellRole, GridContacts, contacts_of_box
from resgrid.core.lattice import SQUARE
from resgrid.core.regions import by_axis
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import Wiring
from resgrid.planning.fields import Field
from resgrid.solvers.elimination_tree import PlaneElimination
from resgrid.solvers.scaled import Numbers, unscaled

if TYPE_CHECKING:
    from resgrid.planning.replanning_kernels import Values

_LEAST_COMPLEMENT = 1e-3
"""Smallest height above the goal rail, as a fraction of the supply, that is computed as one minus the drop.

If the height of any cell is smaller, the difference would cancel, and all heights are solutions of a second system.
"""

_MOST_CELLS = 500_000
"""Largest number of cells of a plane whose eliminated equations are kept between updates, about 1.1 kB per cell.

Larger planes are solved without reuse.
"""

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


class NotSolvedError(Exception):
    """Elimination does not give a direction-safe field; the message is the reason."""


def why_not_kept(space: ConfigurationSpace, wiring: Wiring) -> str | None:
    """Return the reason why the equations of a space cannot be kept between updates; None for a suitable space."""
    cells = space.cell.size
    reasons = (
        (wiring.lattice != SQUARE, f"lattice = {wiring.lattice!r}, not 'square'"),
        (space.ndim != 2, f"a space with {space.ndim} axes, not 2"),
        (bool(space.periodic.any()), "a periodic axis"),
        (wiring.rails != "merged", f"rails = {wiring.rails!r}, not 'merged'"),
        (wiring.drive == "start", "drive = 'start', not 'uniform'"),
        (cells > _MOST_CELLS, f"{cells:,} cells, more than {_MOST_CELLS:,}"),
    )
    return next((reason for holds, reason in reasons if holds), None)


class KeptCircuit:
    """Eliminated equations of one circuit of a plane, kept between updates.

    Parameters
    ----------
    shape : tuple of int
        Numbers of cells along both axes.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.shape = shape
        nx, ny = shape
        self._elimination = PlaneElimination((nx, ny))

    def field(self, space: ConfigurationSpace, wiring: Wiring) -> tuple[Field, float]:
        """Return the field of a space, and the fraction of the nodes of the elimination tree that this call eliminates.

        Nodes far from cells that changed since the last call keep their equations.  `space`: space of this object's
        shape, in whose circuit current flows; `wiring`: rules of the circuit.  Raise NotSolvedError if the field is not
        direction-safe.
        """
        from resgrid.planning.replanning_kernels import split_contacts, write_heights, write_values

        wiring = wiring.on(space)
        contacts, own = contacts_of_box(space, wiring), space.goal_connected
        inner = np.empty((self.shape[0] + 1, self.shape[1])), np.empty((self.shape[0], self.shape[1] + 1))
        low, high = np.empty(self.shape), np.empty(self.shape)
        across, along = contacts.conductance
        split_contacts(contacts.kind, own, (across, along), wiring.resistance, inner, low, high)
        leak = contacts.leak * wiring.resistance
        if leak:
            high[own] += leak
        fraction = self._elimination.update(*inner, low + high, own)
        if fraction is None:
            raise NotSolvedError("a pivot of the elimination left the range of doubles")
        values, potential = _empty_values(self.shape), np.empty(self.shape)
        log_drop, injected = None, 0.0
        if wiring.is_driven:
            height, injected = self._driven(own)
            write_heights(contacts.kind, own, height, values, potential)
        else:
            log_drop = np.empty(self.shape)
            write_values(contacts.kind, own, *self._between(own, low, high), values, potential, log_drop)
            if wiring.is_open:  # open obstacles and unconnected cells have no node
                potential[contacts.kind[1:-1, 1:-1] == CellRole.NONE] = np.nan
                log_drop[contacts.kind[1:-1, 1:-1] == CellRole.NONE] = np.nan
        direction, log_current = _safe_currents(contacts, values, wiring.resistance, (injected, leak))
        currents = by_axis(direction, self.shape), by_axis(log_current, self.shape)
        return Field(space, wiring, potential, log_drop, *currents, 0.0 if wiring.is_open else 1.0), fraction

    def _driven(self, own: Bools) -> tuple[Floats, float]:
        """Return heights above the goal rail as fractions of the largest height, and the current injected per cell.

        `own` (nx, ny): mask of the cells with an equation; the same current is injected into each of them.  The current
        is the one for which the largest height equals the supply, in units of supply / resistance.
        """
        height = unscaled(*self._elimination.solve(own.astype(np.float64)))
        top = float(height.max(initial=0.0))
        if not 0.0 < top < np.inf:
            raise NotSolvedError("the heights above the goal left the range of doubles")
        return height / top, 1.0 / top

    def _between(self, own: Bools, low: Floats, high: Floats) -> tuple[Numbers, Numbers]:
        """Return drops from the high rail and heights above the low rail, as fractions of the supply.

        Each is a pair of mantissas and exponents (nx, ny) of numbers ``mantissa * 2**(256 exponent)``.  The heights are
        solutions of a second system if ``1 - drop`` would cancel in some cell.  `own` (nx, ny): mask of the cells with
        an equation; `low`, `high` (nx, ny): conductances to the low and the high rail, in units of 1 / resistance.
        """
        drop = self._elimination.solve(low)
        if not drop[0].min(where=own, initial=np.inf) > 0.0:
            raise NotSolvedError("the potential falls below the range that elimination represents")
        plain = unscaled(*drop)
        if plain.max(initial=0.0) < 1.0 - _LEAST_COMPLEMENT:
            return drop, (1.0 - plain, np.zeros(self.shape, dtype=np.int64))
        return drop, self._elimination.solve(high)


def _empty_values(shape: tuple[int, ...]) -> Values:
    """Return uninitialized `Values` (mantissa and exponent of the drop or height of every cell) of a plane.

    The arrays have a margin of one cell on every side.  `shape`: number of cells along each axis.
    """
    from resgrid.planning.replanning_kernels import Values

    wide = tuple(size + 2 for size in shape)
    return Values(
        own=np.empty(wide, dtype=np.bool_),
        mantissa=np.empty(wide),
        exponent=np.empty(wide, dtype=np.int64),
        is_drop=np.empty(wide, dtype=np.bool_),
    )


def _safe_currents(
    contacts: GridContacts, values: Values, resistance: float, source: tuple[float, float]
) -> tuple[NDArray[np.int8], Floats]:
    """Return signs and natural logarithms of all face currents, in units of supply / resistance, (faces,) each.

    Currents are positive along the axis.  Faces are in C order, first those across the first axis, then those across
    the second one.  `contacts`: conductances of all faces, in siemens; `values`: drop or height of every cell, as a
    fraction of the supply or, with a uniform drive, of the largest height; `resistance`: resistance between neighbours,
    in ohms, by which conductances are multiplied; `source`: current into every cell from a source, in units of supply /
    resistance, and conductance of the leak of every cell to the high rail, in units of 1 / resistance.  Raise
    NotSolvedError if the field is not direction-safe.
    """
    from resgrid.planning import replanning_kernels as kernels

    conductance = np.concatenate([faces.ravel() for faces in contacts.conductance])
    shape = tuple(size - 2 for size in values.own.shape)
    amps, exponent = np.empty(len(conductance)), np.empty(len(conductance), dtype=np.int64)
    is_uncertain = np.empty(len(conductance), dtype=np.bool_)
    kernels.face_currents(values, conductance, resistance, amps, exponent, is_uncertain)
    through, scale = np.empty(shape), np.empty(shape, dtype=np.int64)
    worst, stuck = kernels.check_cells(values, source, amps, exponent, through, scale)
    if kernels.drop_uncertain(amps, exponent, is_uncertain, through, scale):
        worst, stuck = kernels.check_cells(values, source, amps, exponent, through, scale)
    if not worst <= DIRECTION_RESIDUAL or stuck:
        raise NotSolvedError(f"KCL is violated by {worst:.1e} of the current through a cell")
    direction, log_current = np.empty(len(amps), dtype=np.int8), np.empty(len(amps))
    kernels.write_currents(amps, exponent, direction, log_current)
    return direction, log_current
