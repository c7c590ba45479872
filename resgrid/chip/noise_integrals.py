"""Effective resistances to the rails, and integrals of the resistive part of impedances over a band of frequencies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.chip.spectrum import slowest_modes
from resgrid.errors import AccuracyError
from resgrid.nodal.dynamics import Dynamics, charge_basis, factor_resolvent
from resgrid.nodal.selected.diagonal import estimate_diagonal, inverse_diagonal
from resgrid.nodal.selected.positive import positive_factors
from resgrid.nodal.superlu import symmetric_factors

_POINTS_PER_DECADE = 6
_FLAT = 1e-2
"""Share of the lowest corner frequency below which the density is a parabola, to 1e-8 of itself."""

_MOST_ROUNDING = 1e-3
"""Share of itself by which rounding may put a density within the band off."""

_MOST_ESTIMATED = 0.1
"""The same of estimates, which samples leave uncertain by about as much."""

_EPS = float(np.finfo(np.float64).eps)
_ITERATED = 1e-10
"""Backward error of iterated solutions."""


@dataclass(frozen=True, eq=False)
class Found:
    """Effective resistances and integrals of ``Re Z`` over a band, row by row.

    `resistance, resistance_error` (n,): in ohms; `area, area_error` (n,): in ohm hertz.
    """

    resistance: NDArray[np.float64]
    resistance_error: NDArray[np.float64]
    area: NDArray[np.float64]
    area_error: NDArray[np.float64]


def find_exactly(dynamics: Dynamics, band: tuple[float, float] | None) -> Found:
    """Find them from the factors."""
    none = np.zeros(dynamics.size)
    if not dynamics.size:
        return Found(none, none, none, none)
    factors = positive_factors(dynamics.conductance.coupling, dynamics.conductance.excess)
    resistance = factors.inverse_diagonal()
    if band is None:
        return Found(resistance, none, none, none)
    rounding = 2.0 * _EPS * factors.solve_nonnegative(_largest_currents(dynamics, band))
    _require_digits(dynamics, rounding, _MOST_ROUNDING)
    flat, frequency, weight = _quadrature(dynamics, band)
    area = flat * resistance
    for f, w in zip(frequency.tolist(), weight.tolist(), strict=True):
        area = area + w * inverse_diagonal(_admittance(dynamics, f)).real
    return Found(resistance, none, area, rounding * area)


def estimate(dynamics: Dynamics, band: tuple[float, float] | None, signs: NDArray[np.float64]) -> Found:
    """Estimate them from products with random signs.  Shapes: `signs` (n, samples)."""
    factors = factor_resolvent(dynamics, 0.0)
    currents = _largest_currents(dynamics, band or (0.0, 0.0))
    digits = _ITERATED if factors.name == "multigrid" else 2.0 * _EPS
    _require_digits(dynamics, digits * factors.solve_nonnegative(currents)[0].plain, _MOST_ESTIMATED)
    at_rest = np.stack([factors.solve(column) for column in signs.T], axis=1)
    resistance = estimate_diagonal(signs, at_rest)
    if band is None:
        return Found(*resistance, *np.zeros((2, dynamics.size)))
    flat, frequency, weight = _quadrature(dynamics, band)
    products = flat * at_rest
    for f, w in zip(frequency.tolist(), weight.tolist(), strict=True):
        products += w * symmetric_factors(_admittance(dynamics, f)).solve(signs.astype(np.complex128)).real
    return Found(*resistance, *estimate_diagonal(signs, products))


def _largest_currents(dynamics: Dynamics, band: tuple[float, float]) -> NDArray[np.float64]:
    """Currents at 1 V into every row, in amperes, at the lower end of the band.

    A change of ``G`` by a share ``eps`` of its entries changes ``R_i = (G^-1)_ii`` by at most
    ``2 eps (G^-1 D G^-1)_ii``, with the diagonal ``D`` of ``G``.  No entry of a row of ``G^-1`` exceeds ``R_i``: that
    is at most ``2 eps R_i (G^-1 d)_i``, ``d`` being these currents.
    """
    return dynamics.conductance.diagonal + 2.0 * np.pi * band[0] * dynamics.capacitance.diagonal


def _require_digits(dynamics: Dynamics, rounding: NDArray[np.float64], most: float) -> None:
    worst = int(np.argmax(rounding))
    if not rounding[worst] <= most:
        node = dynamics.netlist.node_name(int(np.argmax(dynamics.row == worst)))
        raise AccuracyError(
            f"rounding may be {rounding[worst]:.0e} of the noise of node {node}: the conductances around it span too "
            'many decades; without a band, method = "exact" still gives its effective resistance'
        )


def _quadrature(
    dynamics: Dynamics, band: tuple[float, float]
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Weight of the resistance at 0 Hz, then frequencies and weights (Gauss-Legendre in the logarithm).

    Below the corner the density is the parabola through its values at 0 Hz and at the upper end of that part.
    """
    low, high = band
    if not charge_basis(dynamics).charged.any():
        return high - low, np.empty(0), np.empty(0)
    tau, _ = slowest_modes(dynamics, 1)
    corner = _FLAT / (2.0 * np.pi * float(tau[0]))
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
    return sparse.csr_array(dynamics.conductance.matrix + 2j * np.pi * frequency * dynamics.capacitance.matrix)
