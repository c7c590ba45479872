"""What charge decides, and what follows it at once: the two linear systems behind the state at 0+ and its slope.

In the coordinates ``x = E_c y + N z`` of `resgrid.circuit.dynamics.ChargeBasis` charges give ``y`` by ``C_cc y = q``,
and Kirchhoff's law for the parts that capacitors leave loose gives ``z`` by ``N^T G N z = N^T (b - G E_c y)``.  Both
are nodal matrices, assembled and solved as such: a part of strong conductances keeps its weak ties to what holds it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.circuit.cancellation import subtract
from resgrid.circuit.dynamics import ChargeBasis, Dynamics, charge_basis
from resgrid.errors import AccuracyError
from resgrid.netlist import GROUND
from resgrid.solvers.choose import factor_laplacian
from resgrid.solvers.factors.factor import Factor
from resgrid.solvers.monitor import Watch
from resgrid.solvers.refine import is_answer

_EPS = float(np.finfo(np.float64).eps)
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
            x[charged] = _entrywise(self._charged, charge[charged], self._lift(self._charged))
        return x

    def followed(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """The state with the charges of ``x`` at which Kirchhoff's law holds for every loose part, in volts."""
        groups = self.basis.spread
        if not groups.shape[1]:
            return x
        drive = groups.T @ self.dynamics.imbalance(x)
        netlist = self.dynamics.netlist
        nodes, amps = netlist.current_nodes.ravel().astype(np.int64), np.repeat(netlist.current_amps, 2)
        into = sparse.csr_array(groups.T)
        several = into @ self.dynamics.injection(nodes, np.ones(len(nodes))) > 1.0
        summed = np.where(several, into @ self.dynamics.injection(nodes, np.abs(amps)), 0.0)
        rounding = self._lift(self._loose) + _EPS * summed
        return np.asarray(x + groups @ _entrywise(self._loose, drive, rounding))

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

    def _lift(self, factors: Factor) -> NDArray[np.float64]:
        """What floating sources may round off the drive of every row of a matrix, shape (n,)."""
        forest = self.dynamics.forest
        height = float(np.abs(forest.height[forest.base != GROUND]).max(initial=0.0))
        return np.asarray(_EPS * height * factors.laplacian.diagonal)

    @property
    def _apart(self) -> bool:
        """Whether every capacitor goes to a rail."""
        return self.dynamics.capacitance.edges.nnz == 0

    @cached_property
    def _charged(self) -> Factor:
        return factor_laplacian(self.dynamics.capacitance.within(self.basis.charged), "auto")

    @cached_property
    def _loose(self) -> Factor:
        return factor_laplacian(self.dynamics.conductance.grouped(self.basis.spread), "auto")


def _entrywise(factors: Factor, drive: NDArray[np.float64], rounding: NDArray[np.float64]) -> NDArray[np.float64]:
    """Solve for a right-hand side of both signs, each entry right beside the largest one."""
    watch = Watch()
    parts = [np.maximum(drive, 0.0), np.maximum(-drive, 0.0)]
    found = [factors.solve_nonnegative(part, watch=watch)[0] if part.any() else None for part in parts]
    rising, falling = found
    doubt = 0.0
    if rising is not None and falling is not None:
        rising, doubt, _ = subtract(factors, drive, rounding, rising, falling, watch.bound)
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
