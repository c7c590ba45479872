"""The resistive part of impedances to the rails: what thermal noise comes from.

With ``z`` the voltages that 1 A (a phasor) at a node raises, the resistors take ``Re Z = sum g |z_a - z_b|^2``, a sum
of positive terms, whereas the diagonal entry of ``(G + 2 pi j f C)^-1`` is almost all imaginary where capacitors tie a
node to its rail.  Parts that resistors tie to rails weakly, or not at all, swing as a whole by far more than what lies
across their resistors.  So one node of such a part counts from the rail, and all others from that node.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from resgrid.errors import AccuracyError
from resgrid.nodal.dynamics import Dynamics, Laplacian
from resgrid.nodal.selected.positive import positive_factors
from resgrid.nodal.superlu import symmetric_factors

_WEAK = 1e-3
"""Share of a part's largest conductance, below which what ties it to rails, summed, is weak."""

_ALLOWED = 1e-6
"""Share of itself by which a resistive part may be off."""

_ROUNDING = 8.0 * float(np.finfo(np.float64).eps)
"""Backward error of a solution, entry by entry of the factors."""


@dataclass(frozen=True, eq=False)
class _Elements:
    """Conductances, or capacitances: what lies between rows, then what lies between a row and the rails.

    `incidence` (m, n): takes unknowns to the voltages across them; `value` (m,).
    """

    incidence: sparse.csr_array
    value: NDArray[np.float64]

    @cached_property
    def matrix(self) -> sparse.csr_array:
        """Shape (n, n)."""
        return sparse.csr_array(self.incidence.T @ (sparse.diags_array(self.value) @ self.incidence))

    def taken(self, y: NDArray[np.complex128]) -> NDArray[np.float64]:
        """Sum of ``value |across|^2`` for every column of unknowns."""
        across = self.incidence @ y
        return np.asarray(self.value @ (across.real**2 + across.imag**2))


@dataclass(frozen=True, eq=False)
class Impedance:
    """The impedances of a circuit with capacitors.

    `basis` (n, n): takes unknowns to the voltages of rows; `conductance, capacitance`: in siemens and farads;
    `at_rest`: the conductances between rows.
    """

    basis: sparse.csr_array
    conductance: _Elements
    capacitance: _Elements
    at_rest: Laplacian

    def resistive(self, rows: NDArray[np.int64], frequency: float) -> NDArray[np.float64]:
        """Resistive part of the impedance from rows to the rails.  Shapes: `rows` (k,); returns (k,)."""
        if frequency == 0.0:
            return _at_rest(self.at_rest, rows)
        G, w = self.conductance.matrix, 2.0 * np.pi * frequency
        Y = sparse.csr_array(G + 1j * w * self.capacitance.matrix)
        factors = symmetric_factors(Y)
        own = self.basis[rows].T.toarray()
        y = factors.solve(own.astype(np.complex128))
        resistive = self.conductance.taken(y)
        # Tellegen: what 1 A delivers, the elements take.
        amiss = np.abs(np.sum(own * y, axis=0) - (resistive - 1j * w * self.capacitance.taken(y)))
        # An error dY of the factors changes the sum by 2 Re q . dY y.
        q = factors.solve(G @ y.conj())
        doubt = 2.0 * _ROUNDING * np.sum(np.abs(q) * (abs(Y) @ np.abs(y)), axis=0)
        whole = amiss <= _ALLOWED * np.abs(np.sum(own * y, axis=0))
        if not np.all(whole & (doubt <= np.maximum(_ALLOWED * resistive, np.finfo(np.float64).tiny))):
            raise AccuracyError(
                f"impedances at {frequency:g} Hz cannot be told to {_ALLOWED:g} of their resistive part: conductances "
                "and capacitances span too many decades",
                resistive,
            )
        return resistive


def impedance_of(dynamics: Dynamics) -> Impedance:
    """Set up the impedances of a circuit."""
    basis = _swinging(dynamics.conductance)
    G, C = dynamics.conductance, dynamics.capacitance
    return Impedance(basis, _elements(G, basis), _elements(C, basis), G)


def _at_rest(G: Laplacian, rows: NDArray[np.int64]) -> NDArray[np.float64]:
    """Effective resistances, without capacitors."""
    factors = positive_factors(G.coupling, G.excess)
    unit = np.zeros(len(G.excess))
    resistance = np.empty(len(rows))
    for number, row in enumerate(rows.tolist()):
        unit[row] = 1.0
        resistance[number] = factors.solve_nonnegative(unit)[row]
        unit[row] = 0.0
    return resistance


def _swinging(G: Laplacian) -> sparse.csr_array:
    """The basis: rows of weakly tied parts count from the first of them."""
    n = len(G.excess)
    number, part = connected_components(G.coupling, directed=False)
    tied = np.bincount(part, G.excess, number)
    stiffest = np.zeros(number)
    np.maximum.at(stiffest, part, G.coupling.max(axis=1).toarray().ravel() if n else np.zeros(0))
    _, first = np.unique(part, return_index=True)
    others = np.flatnonzero((tied < _WEAK * stiffest)[part])
    others = others[first[part[others]] != others]
    entries = np.ones(n + len(others)), np.append(np.arange(n), others), np.append(np.arange(n), first[part[others]])
    return sparse.coo_array((entries[0], entries[1:]), shape=(n, n)).tocsr()


def _elements(laplacian: Laplacian, basis: sparse.csr_array) -> _Elements:
    incidence, value = laplacian.elements
    across = sparse.csr_array(incidence @ basis)
    across.eliminate_zeros()
    return _Elements(across, value)
