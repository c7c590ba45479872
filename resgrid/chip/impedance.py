"""Resistive parts of the impedances from nodes to the rails, at given frequencies and integrated over a band.

They determine the thermal noise of node voltages.

Let ``z`` be the voltages caused by a current of 1 A (a phasor) into a node.  The real part of the node's impedance
``Z`` is the power in the resistors, ``Re Z = sum g |z_a - z_b|^2`` over all conductances ``g`` between nodes ``a`` and
``b``, a sum of positive terms.  The diagonal entry of ``(G + 2 pi j f C)^-1`` is almost purely imaginary where
capacitors connect a node to its rail, so that its real part would be lost to rounding.  Parts of the circuit with weak
or no resistive connections to the rails have voltages much larger than the voltages across their resistors.  Therefore
one unknown of such a part is the voltage of one node above the rail, and the others are the differences of the other
nodes from this node.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.chip.time_constants import slowest_modes
from resgrid.circuit.dynamics import Dynamics, factor_resolvent
from resgrid.core.regions import label_components
from resgrid.errors import AccuracyError
from resgrid.solvers.laplacian import Laplacian
from resgrid.solvers.selected_inverse import (
    estimate_diagonal,
    inverse_diagonal,
    positive_inverse_diagonal,
    symmetric_factors,
)
from resgrid.solvers.supernodal import factor_supernodes
from resgrid.solvers.supernodal_factors import SupernodalFactors

_WEAK = 1e-3
"""Limit, without unit, on the ratio of two conductances of a connected part of the circuit.

The ratio is the total conductance from the part to the rails over the largest conductance within the part.  Below the
limit the part is weakly connected to the rails, and its unknowns are differences of voltages.
"""

_ALLOWED = 1e-6
"""Largest accepted relative error of the real part of an impedance; beyond it, AccuracyError is raised."""

_ROUNDING = 8.0 * float(np.finfo(np.float64).eps)
"""Assumed relative error of the entries of the admittance matrix that has the same effect as all rounding errors of a
solution (backward error).
"""

_POINTS_PER_DECADE = 6
"""Number of quadrature points per decade of frequency."""
_FLAT = 1e-2
"""Fraction of the lowest corner frequency below which the noise density is taken as a parabola in the frequency; the
relative error of the density is 1e-8.
"""

_MOST_ROUNDING = 1e-3
"""Largest accepted relative effect of rounding on an exact noise density within the band; beyond it, AccuracyError is
raised.
"""

_MOST_ESTIMATED = 0.1
"""Largest accepted relative effect of rounding on an estimated noise density, about the sampling error of the estimate;
beyond it, AccuracyError is raised.
"""

_EPS = float(np.finfo(np.float64).eps)
_ITERATED = 1e-10
"""Assumed normwise relative backward error of solutions by multigrid iterations."""


def resistive_parts(
    dynamics: Dynamics, rows: NDArray[np.int64], frequencies: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the real parts of the impedances from rows to the rails, shape (frequencies, rows), in ohms.

    `dynamics`: circuit equations; `rows`: numbers of the rows (unknown node voltages) of the equations; `frequencies`:
    in hertz, at least 0.  Raises AccuracyError if a relative error may exceed 1e-6.
    """
    basis = _weak_part_basis(dynamics.conductance)
    (G, conductors), (C, capacitors) = (_elements(part, basis) for part in (dynamics.conductance, dynamics.capacitance))
    own = basis[rows].T.toarray()
    result = np.empty((len(frequencies), len(rows)))
    for number, frequency in enumerate(frequencies.tolist()):
        if frequency == 0.0:
            still = factor_supernodes(dynamics.conductance)
            result[number] = inverse_columns(still, dynamics.size, rows)[np.arange(len(rows)), rows]
            continue
        w = 2.0 * np.pi * frequency
        Y = sparse.csr_array(G + 1j * w * C)
        factors = symmetric_factors(Y)
        y = factors.solve(own.astype(np.complex128))
        result[number] = resistive = _dissipated(conductors, y)
        # Tellegen's theorem: the power that 1 A delivers equals the power in the elements.
        imbalance = np.abs(np.sum(own * y, axis=0) - (resistive - 1j * w * _dissipated(capacitors, y)))
        # An error dY of the factors changes the sum by 2 Re q . dY y.
        q = factors.solve(G @ y.conj())
        error = 2.0 * _ROUNDING * np.sum(np.abs(q) * (abs(Y) @ np.abs(y)), axis=0)
        balanced = imbalance <= _ALLOWED * np.abs(np.sum(own * y, axis=0))
        if not np.all(balanced & (error <= np.maximum(_ALLOWED * resistive, np.finfo(np.float64).tiny))):
            raise AccuracyError(
                f"resistive parts of impedances at {frequency:g} Hz have errors above {_ALLOWED:g}: conductances "
                "and capacitances span too many orders of magnitude",
                resistive,
            )
    return result


_Elements = tuple[sparse.csr_array, NDArray[np.float64]]
"""Incidence matrix (m, n) that maps the unknowns to the voltages across elements, and the element values (m,):
conductances in siemens or capacitances in farads.
"""


def _elements(laplacian: Laplacian, basis: sparse.csr_array) -> tuple[sparse.csr_array, _Elements]:
    """Return a matrix of conductances or capacitances for given unknowns, shape (n, n), and its elements.

    The elements are an incidence matrix and values (`_Elements`).

    `laplacian`: the matrix for row voltages; `basis` (n, n): matrix that maps the unknowns to row voltages.
    """
    incidence, value = laplacian.elements
    across = sparse.csr_array(incidence @ basis)
    across.eliminate_zeros()
    return sparse.csr_array(across.T @ (sparse.diags_array(value) @ across)), (across, value)


def _dissipated(elements: _Elements, y: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Return the sum of ``value |across|^2`` over all elements, for every column of unknowns, shape (k,).

    ``value`` is the conductance or capacitance of an element, ``across`` the voltage across it.  `elements`: incidence
    matrix and element values; `y` (n, k): complex unknowns, in volts.
    """
    incidence, value = elements
    across = incidence @ y
    return np.asarray(value @ (across.real**2 + across.imag**2))


def inverse_columns(factors: SupernodalFactors, size: int, rows: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return columns of the inverse of a positive definite matrix, each as a row of the result, shape (rows, size).

    `factors`: factors of the matrix; `size`: dimension of the matrix; `rows`: numbers of the columns to compute.
    """
    columns = np.empty((len(rows), size))
    for column, row in zip(columns, rows.tolist(), strict=True):
        unit = np.zeros(size)
        unit[row] = 1.0
        column[:] = factors.solve(unit)
    return columns


def _weak_part_basis(G: Laplacian) -> sparse.csr_array:
    """Return the matrix, shape (n, n), that maps the unknowns of the noise computation to row (node) voltages.

    In a connected part of the circuit whose total conductance to the rails is below `_WEAK` times its largest
    conductance, the first unknown is the voltage of the first row of the part.  The other unknowns of this part are the
    voltages of its other rows minus that of the first row.  In all other parts the unknowns are the row voltages.  `G`:
    conductance matrix.
    """
    n = len(G.ground)
    part = label_components(G.edges)
    tied = np.bincount(part, G.ground)
    stiffest = np.zeros(len(tied))
    np.maximum.at(stiffest, part, G.edges.max(axis=1).toarray().ravel() if n else np.zeros(0))
    _, first = np.unique(part, return_index=True)
    others = np.flatnonzero((tied < _WEAK * stiffest)[part])
    others = others[first[part[others]] != others]
    entries = np.ones(n + len(others)), np.append(np.arange(n), others), np.append(np.arange(n), first[part[others]])
    return sparse.coo_array((entries[0], entries[1:]), shape=(n, n)).tocsr()


Integrals = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
"""Four arrays (n,): effective resistances to the rails, in ohms; errors of these; integrals of ``Re Z`` over a
frequency band, in ohm hertz; errors of these.

Errors have the unit of the values.  Of estimates they are standard errors.  Of exact results they are 0 for the
resistances, and bounds on rounding errors for the integrals.
"""


def exact_integrals(dynamics: Dynamics, band: tuple[float, float] | None) -> Integrals:
    """Compute effective resistances to the rails, and integrals of ``Re Z`` over a band, from factors of the matrices.

    ``Re Z`` is the real part of the impedance from a row to the rails.  `dynamics`: circuit equations; `band`: lower
    and upper limit in hertz, None for integrals of 0.  Returns `Integrals`: resistances in ohms, 0 as their
    errors, integrals in ohm hertz, and bounds on their rounding errors in ohm hertz, each of shape (n,).
    """
    none = np.zeros(dynamics.size)
    if not dynamics.size:
        return none, none, none, none
    factors = factor_supernodes(dynamics.conductance)
    resistance = positive_inverse_diagonal(factors)
    if band is None:
        return resistance, none, none, none
    rounding = 2.0 * _EPS * factors.solve(_largest_currents(dynamics, band))
    _require_digits(dynamics, rounding, _MOST_ROUNDING)
    flat, frequency, weight = _quadrature(dynamics, band)
    area = flat * resistance
    for f, w in zip(frequency.tolist(), weight.tolist(), strict=True):
        area = area + w * inverse_diagonal(_admittance(dynamics, f)).real
    return resistance, none, area, rounding * area


def estimated_integrals(dynamics: Dynamics, band: tuple[float, float] | None, signs: NDArray[np.float64]) -> Integrals:
    """Estimate effective resistances to the rails, and integrals of ``Re Z`` over a band, from random sign vectors.

    ``Re Z`` is the real part of the impedance from a row to the rails.  `dynamics`: circuit equations; `band`: lower
    and upper limit in hertz, None for integrals of 0; `signs` (n, samples): random entries 1 and -1.  Returns
    `Integrals`: resistances in ohms, their standard errors, integrals in ohm hertz, and their standard errors, each of
    shape (n,).
    """
    factors = factor_resolvent(dynamics, 0.0)
    currents = _largest_currents(dynamics, band or (0.0, 0.0))
    digits = _ITERATED if factors.name == "multigrid" else 2.0 * _EPS
    _require_digits(dynamics, digits * factors.solve_nonnegative(currents)[0].plain, _MOST_ESTIMATED)
    at_rest = np.stack([factors.solve(column) for column in signs.T], axis=1)
    products = np.zeros_like(at_rest)
    if band is not None:
        flat, frequency, weight = _quadrature(dynamics, band)
        products = flat * at_rest
        for f, w in zip(frequency.tolist(), weight.tolist(), strict=True):
            products += w * symmetric_factors(_admittance(dynamics, f)).solve(signs.astype(np.complex128)).real
    return *estimate_diagonal(signs, at_rest), *estimate_diagonal(signs, products)


def _largest_currents(dynamics: Dynamics, band: tuple[float, float]) -> NDArray[np.float64]:
    """Return the currents into every row with 1 V at this row and 0 V at all others, in amperes, shape (n,).

    A current is the conductive current plus the magnitude of the capacitive one at the lower end of `band` (lower and
    upper limit, in hertz).

    These currents ``d`` bound rounding errors.  A change of ``G`` by a fraction ``eps`` of its entries changes ``R_i =
    (G^-1)_ii`` by at most ``2 eps (G^-1 D G^-1)_ii``, with the diagonal ``D`` of ``G``.  No entry of a row of ``G^-1``
    exceeds ``R_i``, so that this change is at most ``2 eps R_i (G^-1 d)_i``.
    """
    return dynamics.conductance.diagonal + 2.0 * np.pi * band[0] * dynamics.capacitance.diagonal


def _require_digits(dynamics: Dynamics, rounding: NDArray[np.float64], most: float) -> None:
    """Raise AccuracyError if the relative effect of rounding on the noise of any row exceeds `most`.

    `dynamics`: circuit equations, for the name of the node; `rounding` (n,): relative effect of rounding on every row.
    """
    worst = int(np.argmax(rounding))
    if not rounding[worst] <= most:
        node = dynamics.netlist.node_name(int(np.argmax(dynamics.row == worst)))
        raise AccuracyError(
            f"rounding may change the noise of node {node} by a fraction {rounding[worst]:.0e}: conductances span too "
            'many orders of magnitude; without a band, method = "exact" still gives its effective resistance'
        )


def _quadrature(
    dynamics: Dynamics, band: tuple[float, float]
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Return the quadrature of a noise density over a band: weight of 0 Hz, further frequencies, and their weights.

    The integral is the sum of all weights times the densities at their frequencies. Below `_FLAT` times the lowest
    corner frequency the density is a parabola, which its values at 0 Hz and one further frequency determine.
    `dynamics`: circuit equations; `band`: lower and upper limit, in hertz.  Further frequencies and their weights have
    shape (k,); all are in hertz.
    """
    low, high = band
    if not dynamics.charged.any():
        return high - low, np.empty(0), np.empty(0)
    corner = _FLAT / (2.0 * np.pi * float(slowest_modes(dynamics, 1).tau[0]))
    flat, frequency, weight = 0.0, np.empty(0), np.empty(0)
    if low < corner:
        end = min(high, corner)
        bent = end * (1.0 - (low / end) ** 3) / 3.0
        flat, frequency, weight = end - low - bent, np.array([end]), np.array([bent])
    first = max(low, corner)
    if first >= high:
        return flat, frequency, weight
    length = float(np.log(high / first))
    point, share = np.polynomial.legendre.leggauss(6 + int(_POINTS_PER_DECADE * length / np.log(10.0)))
    beyond = first * np.exp(0.5 * length * (point + 1.0))
    return flat, np.append(frequency, beyond), np.append(weight, 0.5 * length * share * beyond)


def _admittance(dynamics: Dynamics, frequency: float) -> sparse.csr_array:
    """Return the admittance matrix ``G + 2 pi j f C`` at a frequency ``f`` in hertz, shape (n, n), in siemens."""
    return sparse.csr_array(dynamics.conductance.matrix + 2j * np.pi * frequency * dynamics.capacitance.matrix)
