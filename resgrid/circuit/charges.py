"""What charge decides, and what follows it at once: the two linear systems behind the state at 0+ and its slope.

In the coordinates ``x = E_c y + N z`` of `resgrid.circuit.dynamics.ChargeBasis` charges give ``y`` by ``C_cc y = q``,
and Kirchhoff's law for the parts that capacitors leave loose gives ``z`` by ``N^T G N z = N^T (b - G E_c y)``.  Both
are nodal matrices, assembled and solved as such: a part of strong conductances keeps its weak ties to what holds it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.cancellation import subtract
from resgrid.circuit.dynamics import ChargeBasis, Dynamics, Laplacian, charge_basis, nodal_system
from resgrid.errors import AccuracyError
from resgrid.solvers.choose import factor_system
from resgrid.solvers.factors.factor import Factor
from resgrid.solvers.monitor import Watch
from resgrid.solvers.refine import is_answer

_DOUBT = 1e-6
"""Largest share of the largest voltage by which any may be off at 0+."""

_ROUGH = 1e-3
"""Backward error that is enough of slopes."""


@dataclass(frozen=True, eq=False)
class Charges:
    """A circuit's charges, and the voltages that belong to them."""

    dynamics: Dynamics

    @cached_property
    def basis(self) -> ChargeBasis:
        """Coordinates that hold charge, and those that follow."""
        return charge_basis(self.dynamics)

    def voltages(self, charge: NDArray[np.float64]) -> NDArray[np.float64]:
        """What charges make of a circuit at 0 V, in volts, shape (n,); 0 in coordinates that hold none."""
        charged, x = self.basis.charged, np.zeros(self.dynamics.size)
        if self._apart:
            x[charged] = charge[charged] / self.dynamics.capacitance.diagonal[charged]
        elif charge[charged].any():
            x[charged] = _entrywise(self._charged, charge[charged])
        return x

    def followed(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """The state with the charges of ``x`` at which Kirchhoff's law holds for every loose part, in volts."""
        groups = self.basis.spread
        if not groups.shape[1]:
            return x
        return np.asarray(x + groups @ _entrywise(self._loose, groups.T @ self.dynamics.imbalance(x)))

    def slope(self, current: NDArray[np.float64]) -> NDArray[np.float64]:
        """How fast voltages rise when currents charge the rows, in V/s, shape (n,); to some 0.1 %."""
        charged, groups, v = self.basis.charged, self.basis.spread, np.zeros(self.dynamics.size)
        if self._apart:
            v[charged] = current[charged] / self.dynamics.capacitance.diagonal[charged]
        elif charged.any():
            v[charged] = self._charged.solve(current[charged], rtol=_ROUGH)
        if groups.shape[1]:
            v += groups @ self._loose.solve(-(groups.T @ self.dynamics.conductance.times(v)), rtol=_ROUGH)
        return v

    @property
    def _apart(self) -> bool:
        """Whether every capacitor goes to a rail."""
        return self.dynamics.capacitance.coupling.nnz == 0

    @cached_property
    def _charged(self) -> Factor:
        none = np.full(self.dynamics.size, -1, dtype=np.int64)  # for no current source feeds charges
        return self._factors(self.dynamics.capacitance.within(self.basis.charged), none)

    @cached_property
    def _loose(self) -> Factor:
        groups = self.basis.spread
        group = np.full(self.dynamics.size, -1, dtype=np.int64)
        group[np.diff(groups.indptr) > 0] = groups.indices
        return self._factors(self.dynamics.conductance.grouped(groups), group)

    def _factors(self, matrix: Laplacian, number: NDArray[np.int64]) -> Factor:
        """Factors of a matrix whose row ``number[i]`` stands for row ``i`` of the dynamics."""
        row = self.dynamics.row
        own = np.where(row >= 0, number[row], -1) if len(number) else row
        system = nodal_system(self.dynamics, matrix, own, np.zeros(len(matrix.excess)))
        return factor_system(replace(system, netlist=system.netlist.replace(cell_map=None)), "auto")


def _entrywise(factors: Factor, drive: NDArray[np.float64]) -> NDArray[np.float64]:
    """Solve for a right-hand side of both signs, each entry right beside the largest one."""
    watch = Watch()
    parts = [np.maximum(drive, 0.0), np.maximum(-drive, 0.0)]
    found = [factors.solve_nonnegative(part, watch=watch)[0] if part.any() else None for part in parts]
    rising, falling = found
    doubt = 0.0
    if rising is not None and falling is not None:
        rising, doubt, _ = subtract(factors, drive, rising, falling, watch.bound)
        falling = None
    if doubt > _DOUBT or not is_answer(watch.error, watch.bound):
        raise AccuracyError(
            "the voltages at 0+ cannot be told: currents of both signs nearly cancel, or conductances and capacitances "
            f"span too many decades (voltages may be off by {max(doubt, watch.error):.1e} of the largest); check what "
            "ties the circuit to its rails"
        )
    if rising is not None:
        return rising.plain
    return np.zeros_like(drive) if falling is None else -falling.plain
