"""Thermal noise of a chip: every resistor adds current noise of density ``4 k T / R`` (Johnson 1928; Nyquist 1928).

The spot density of a node's voltage is ``4 k T Re Z(f)``, ``Z`` being the impedance from the node to the rails: the
diagonal of ``(G + 2 pi j f C)^-1``.  At frequencies below the slowest time constant that is ``4 k T R_eff``.  Over all
frequencies it integrates to ``k T (C^-1)_ii`` whatever the resistors are, and to infinity at a node that no capacitor
ties to a rail.  All resistors have the temperature given; sources, switches' drivers and capacitors are silent.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from resgrid.device.reading import Reading, json_form
from resgrid.device.spectrum import slowest_modes
from resgrid.errors import InputError
from resgrid.netlist import Netlist
from resgrid.nodal.dynamics import Dynamics, charge_basis, dynamics_of, factor_resolvent, require_grounded
from resgrid.nodal.selected.diagonal import estimate_diagonal, inverse_diagonal, random_signs
from resgrid.nodal.superlu import symmetric_factors

BOLTZMANN = 1.380649e-23
"""In J/K, exact."""

ROOM = 300.15
"""27 degrees Celsius, in kelvin: the nominal temperature of SPICE."""

METHODS = ("auto", "exact", "estimate")
_EXACT_PLANE, _EXACT_VOLUME = 300_000, 15_000
_POINTS_PER_DECADE = 5
_FLAT = 1e-2
"""Share of the lowest corner frequency below which the density is taken as constant."""


@dataclass(frozen=True, eq=False)
class Noise:
    """Thermal noise of every node's voltage; 0 on rails, NaN where a node floats.

    Attributes
    ----------
    netlist : Netlist
        The chip.
    temperature : float
        Of all resistors, in kelvin.
    resistance : ndarray of float64, shape (nodes,)
        Effective resistance from every node to the rails at low frequency, in ohms.
    resistance_error : ndarray of float64, shape (nodes,)
        Its standard error, in ohms; 0 where it is exact.
    limit : ndarray of float64, shape (nodes,)
        Root mean square noise from 0 Hz to infinity, ``sqrt(k T (C^-1)_ii)``, in volts; infinite at a node that no
        capacitor ties to a rail.
    band : tuple of float, or None
        Limits of the integral, in hertz.
    total : ndarray of float64, shape (nodes,), or None
        Root mean square noise within the band, in volts.
    total_error : ndarray of float64, shape (nodes,), or None
        Its standard error, in volts; 0 where it is exact.
    exact : bool
        Whether nothing was estimated from samples.
    """

    netlist: Netlist
    temperature: float
    resistance: NDArray[np.float64]
    resistance_error: NDArray[np.float64]
    limit: NDArray[np.float64]
    band: tuple[float, float] | None
    total: NDArray[np.float64] | None
    total_error: NDArray[np.float64] | None
    exact: bool

    def __post_init__(self) -> None:
        for array in (self.resistance, self.resistance_error, self.limit, self.total, self.total_error):
            if array is not None:
                array.flags.writeable = False

    @property
    def density(self) -> NDArray[np.float64]:
        """Density ``4 k T R_eff`` at low frequency, shape (nodes,), in V^2/Hz."""
        return 4.0 * BOLTZMANN * self.temperature * self.resistance

    @property
    def readings(self) -> Mapping[str, Reading]:
        """The figures of the noisiest node, with units and definitions."""
        at = f"at {self.temperature:.6g} K"
        limit = float(np.nanmax(self.limit))
        result = {
            "largest_effective_resistance": Reading(
                float(np.nanmax(self.resistance)), "ohm", "largest resistance from a node to the rails at low frequency"
            ),
            "largest_noise_density": Reading(
                float(np.sqrt(np.nanmax(self.density))),
                "V/sqrt(Hz)",
                f"thermal noise of the noisiest node at low frequency, sqrt(4 k T R_eff), {at}",
            ),
            "largest_noise_limit": Reading(
                limit if np.isfinite(limit) else None,
                "V",
                f"rms thermal noise of the noisiest node from 0 Hz to infinity, sqrt(k T (C^-1)_ii), {at}; undefined "
                "where a node has no capacitance",
            ),
        }
        if self.band is not None and self.total is not None:
            result["largest_noise"] = Reading(
                float(np.nanmax(self.total)),
                "V",
                f"rms thermal noise of the noisiest node from {self.band[0]:g} Hz to {self.band[1]:g} Hz, {at}",
            )
        return result

    def to_json(self) -> dict[str, Any]:
        """The readings, the limits of the integral and how it was found, as plain values."""
        return {
            **json_form(self.readings),
            "temperature": self.temperature,
            "band": None if self.band is None else list(self.band),
            "exact": self.exact,
        }


def analyse_noise(
    netlist: Netlist,
    *,
    band: tuple[float, float] | None = None,
    temperature: float = ROOM,
    method: str = "auto",
    samples: int = 64,
    seed: int = 0,
) -> Noise:
    """Find the thermal noise of every node's voltage.

    Parameters
    ----------
    netlist : Netlist
    band : tuple of float, optional
        Lower and upper limit of the integral, in hertz: a read-out of noise bandwidth ``B`` takes ``(0, B)``.
    temperature : float
        In kelvin.
    method : {"auto", "exact", "estimate"}
        Exact: the diagonal of the inverse from the factors.  Estimate: from products with random signs, for grids of
        three or more dimensions whose factors are large.
    samples : int
        Of an estimate.
    seed : int
        Of its random signs.

    Returns
    -------
    Noise

    Raises
    ------
    InputError
        If an argument is not admissible.
    CircuitError
        If a node is tied to no rail by resistors.
    """
    _check(band, temperature, method, samples)
    dynamics = dynamics_of(netlist)
    exact = method == "exact" or (method == "auto" and _is_small(dynamics))
    signs = None if exact else random_signs(dynamics.size, samples, seed)
    resistance, resistance_error = _resistance(dynamics, signs)
    scale = BOLTZMANN * temperature
    total = total_error = None
    if band is not None:
        area, area_error = _integrated(dynamics, band, signs, resistance)
        total = np.sqrt(4.0 * scale * np.maximum(area, 0.0))
        with np.errstate(divide="ignore", invalid="ignore"):
            total_error = np.nan_to_num(2.0 * scale * area_error / total)
    return Noise(
        netlist=netlist,
        temperature=float(temperature),
        resistance=dynamics.at_nodes(resistance),
        resistance_error=dynamics.at_nodes(resistance_error),
        limit=dynamics.at_nodes(np.sqrt(scale * _elastance(dynamics))),
        band=None if band is None else (float(band[0]), float(band[1])),
        total=None if total is None else dynamics.at_nodes(total),
        total_error=None if total_error is None else dynamics.at_nodes(total_error),
        exact=exact,
    )


def noise_density(
    netlist: Netlist, nodes: ArrayLike, frequencies: ArrayLike, *, temperature: float = ROOM
) -> NDArray[np.float64]:
    """Spot density of thermal noise, ``4 k T Re Z(f)``.

    Parameters
    ----------
    netlist : Netlist
    nodes : array_like of int, shape (k,)
    frequencies : array_like of float, shape (f,)
        In hertz, at least 0.
    temperature : float
        In kelvin.

    Returns
    -------
    ndarray of float64, shape (f, k)
        In V^2/Hz; 0 on rails, NaN where a node floats.

    Raises
    ------
    InputError
        If an argument is not admissible.
    """
    wanted, when = np.atleast_1d(np.asarray(nodes)), np.atleast_1d(np.asarray(frequencies, dtype=np.float64))
    if wanted.dtype.kind not in "iu" or wanted.ndim != 1 or np.any((wanted < 0) | (wanted >= netlist.node_count)):
        raise InputError(f"nodes must be node numbers from 0 to {netlist.node_count - 1}")
    if not (np.isfinite(when).all() and (when >= 0).all()):
        raise InputError("frequencies must be finite and at least 0, in hertz")
    _check(None, temperature, "auto", 2)
    dynamics = dynamics_of(netlist)
    rows = dynamics.row[wanted]
    density = np.zeros((len(when), len(wanted)))
    density[:, np.isnan(dynamics.fixed[wanted])] = np.nan
    inside = np.flatnonzero(rows >= 0)
    unit = np.zeros((dynamics.size, len(inside)), dtype=np.complex128)
    unit[rows[inside], np.arange(len(inside))] = 1.0
    for number, frequency in enumerate(when.tolist()):
        if len(inside):
            impedance = symmetric_factors(_admittance(dynamics, frequency)).solve(unit)
            density[number, inside] = impedance[rows[inside], np.arange(len(inside))].real
    return 4.0 * BOLTZMANN * temperature * density


def noise_covariance(netlist: Netlist, nodes: ArrayLike, *, temperature: float = ROOM) -> NDArray[np.float64]:
    """Covariance ``k T C^-1`` of node voltages over all frequencies, 0 Hz to infinity.

    Parameters
    ----------
    netlist : Netlist
        With capacitance that ties each of the nodes to a rail.
    nodes : array_like of int, shape (k,)
    temperature : float
        In kelvin.

    Returns
    -------
    ndarray of float64, shape (k, k)
        In V^2; 0 for rails.

    Raises
    ------
    InputError
        If no capacitor ties a node to a rail: its noise is unbounded.
    """
    _check(None, temperature, "auto", 2)
    dynamics = dynamics_of(netlist)
    wanted = np.atleast_1d(np.asarray(nodes, dtype=np.int64))
    basis = charge_basis(dynamics)
    loose = np.diff(basis.spread.indptr) > 0
    rows = dynamics.row[wanted]
    inside = np.flatnonzero(rows >= 0)
    if loose[rows[inside]].any():
        node = netlist.node_name(int(wanted[inside[np.argmax(loose[rows[inside]])]]))
        raise InputError(f"no capacitor ties node {node} to a rail: its noise over all frequencies is unbounded")
    covariance = np.zeros((len(wanted), len(wanted)))
    if len(inside):
        place = np.cumsum(basis.charged) - 1
        columns = place[rows[inside]]
        unit = np.zeros((int(basis.charged.sum()), len(inside)))
        unit[columns, np.arange(len(inside))] = 1.0
        C = dynamics.capacitance.matrix[basis.charged][:, basis.charged]
        covariance[np.ix_(inside, inside)] = symmetric_factors(C).solve(unit)[columns]
    return BOLTZMANN * temperature * covariance


def _resistance(
    dynamics: Dynamics, signs: NDArray[np.float64] | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    if signs is None:
        require_grounded(dynamics)
        return inverse_diagonal(dynamics.conductance.matrix), np.zeros(dynamics.size)
    factors = factor_resolvent(dynamics, 0.0)
    return estimate_diagonal(signs, np.stack([factors.solve(column) for column in signs.T], axis=1))


def _integrated(
    dynamics: Dynamics, band: tuple[float, float], signs: NDArray[np.float64] | None, resistance: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Integral of ``Re Z`` over the band, in ohm hertz, and its standard error."""
    flat, frequency, weight = _quadrature(dynamics, band)
    if signs is None:
        area = flat * resistance
        for f, w in zip(frequency.tolist(), weight.tolist(), strict=True):
            area = area + w * inverse_diagonal(_admittance(dynamics, f)).real
        return area, np.zeros(dynamics.size)
    products = flat * symmetric_factors(dynamics.conductance.matrix).solve(signs) if flat else np.zeros_like(signs)
    for f, w in zip(frequency.tolist(), weight.tolist(), strict=True):
        products += w * symmetric_factors(_admittance(dynamics, f)).solve(signs.astype(np.complex128)).real
    return estimate_diagonal(signs, products)


def _quadrature(
    dynamics: Dynamics, band: tuple[float, float]
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Width of the flat part of the band, then frequencies and weights (Gauss-Legendre in the logarithm)."""
    low, high = band
    if not charge_basis(dynamics).charged.any():
        return high - low, np.empty(0), np.empty(0)
    tau, _ = slowest_modes(dynamics, 1)
    corner = _FLAT / (2.0 * np.pi * float(tau[0]))
    flat = max(min(high, corner) - low, 0.0)
    first = max(low, corner)
    if first >= high:
        return flat, np.empty(0), np.empty(0)
    length = float(np.log(high / first))
    point, weight = np.polynomial.legendre.leggauss(6 + int(_POINTS_PER_DECADE * length / np.log(10.0)))
    frequency = first * np.exp(0.5 * length * (point + 1.0))
    return flat, frequency, 0.5 * length * weight * frequency


def _admittance(dynamics: Dynamics, frequency: float) -> sparse.csr_array:
    return sparse.csr_array(dynamics.conductance.matrix + 2j * np.pi * frequency * dynamics.capacitance.matrix)


def _elastance(dynamics: Dynamics) -> NDArray[np.float64]:
    """Diagonal of ``C^-1`` in 1/F, infinite in parts that no capacitor ties to a rail."""
    basis = charge_basis(dynamics)
    elastance = np.full(dynamics.size, np.inf)
    C = dynamics.capacitance
    if C.coupling.nnz == 0:
        elastance[basis.charged] = 1.0 / C.diagonal[basis.charged]
    elif basis.charged.any():
        elastance[basis.charged] = inverse_diagonal(C.matrix[basis.charged][:, basis.charged])
    elastance[np.diff(basis.spread.indptr) > 0] = np.inf
    return elastance


def _is_small(dynamics: Dynamics) -> bool:
    coupling = dynamics.conductance.coupling
    plane = coupling.nnz <= 4.2 * max(dynamics.size, 1)
    return dynamics.size <= (_EXACT_PLANE if plane else _EXACT_VOLUME)


def _check(band: tuple[float, float] | None, temperature: float, method: str, samples: int) -> None:
    if method not in METHODS:
        raise InputError(f"method = {method!r} is unknown; it may be one of {', '.join(METHODS)}")
    if not (np.isfinite(temperature) and temperature > 0):
        raise InputError(f"temperature = {temperature} must be positive and finite, in kelvin")
    if samples < 2:
        raise InputError(f"samples = {samples}, but an error bar needs at least 2")
    if band is not None and not (len(band) == 2 and np.isfinite(band).all() and 0 <= band[0] < band[1]):
        raise InputError(f"band = {band} must be two frequencies in hertz, the lower first (for all of them see limit)")
