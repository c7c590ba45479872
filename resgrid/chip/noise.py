"""Thermal noise of a chip: every resistor adds current noise of density ``4 k T / R`` (Johnson 1928; Nyquist 1928).

The spot density of a node's voltage is ``4 k T Re Z(f)``, ``Z`` being the impedance from the node to the rails: the
diagonal of ``(G + 2 pi j f C)^-1``.  At frequencies below the slowest time constant that is ``4 k T R_eff``.  Over all
frequencies it integrates to ``k T (C^-1)_ii`` whatever the resistors are, and to infinity at a node that no capacitor
ties to a rail.  All resistors have the temperature given; sources, switches' drivers and capacitors are silent.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.validation import Natural, Positive
from resgrid.chip.figures_of_merit import Figure, Result, defined
from resgrid.chip.impedance import estimate, find_exactly, inverse_columns, resistive_parts
from resgrid.circuit.dynamics import Dynamics, dynamics_of, require_grounded
from resgrid.core.netlist import Netlist
from resgrid.errors import InputError
from resgrid.solvers.selected_inverse import positive_inverse_diagonal, random_signs
from resgrid.solvers.supernodal import SupernodalFactors, factor_supernodes

BOLTZMANN = 1.380649e-23
"""In J/K, exact."""

ROOM = 300.15
"""27 degrees Celsius, in kelvin: the nominal temperature of SPICE."""

_HIGHEST = np.float64(1e300)
_EXACT_PLANE, _EXACT_VOLUME = 300_000, 15_000


@dataclass(frozen=True, eq=False, repr=False)
class Noise(Result):
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
        Its standard error, in ohms; 0 where nothing was estimated: every digit but the last few is then right.
    limit : ndarray of float64, shape (nodes,)
        Root mean square noise from 0 Hz to infinity, ``sqrt(k T (C^-1)_ii)``, in volts; infinite at a node that no
        capacitor ties to a rail.
    band : tuple of float, or None
        Limits of the integral, in hertz.
    total : ndarray of float64, shape (nodes,), or None
        Root mean square noise within the band, in volts.
    total_error : ndarray of float64, shape (nodes,), or None
        Its standard error, in volts; where nothing was estimated, what rounding may have done to it.
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

    @property
    def density(self) -> NDArray[np.float64]:
        """Density ``4 k T R_eff`` at low frequency, shape (nodes,), in V^2/Hz."""
        return 4.0 * BOLTZMANN * self.temperature * self.resistance

    @property
    def figures(self) -> Mapping[str, Figure]:
        """The figures of the noisiest node, with units and definitions."""
        at = f"at {self.temperature:.6g} K"
        result = {
            "largest_effective_resistance": Figure(
                float(np.nanmax(self.resistance)), "ohm", "largest resistance from a node to the rails at low frequency"
            ),
            "largest_noise_density": Figure(
                float(np.sqrt(np.nanmax(self.density))),
                "V/sqrt(Hz)",
                f"thermal noise of the noisiest node at low frequency, sqrt(4 k T R_eff), {at}",
            ),
            "largest_noise_limit": Figure(
                defined(np.nanmax(self.limit)),
                "V",
                f"rms thermal noise of the noisiest node from 0 Hz to infinity, sqrt(k T (C^-1)_ii), {at}; undefined "
                "where a node has no capacitance",
            ),
        }
        if self.band is not None and self.total is not None:
            result["largest_noise"] = Figure(
                float(np.nanmax(self.total)),
                "V",
                f"rms thermal noise of the noisiest node from {self.band[0]:g} Hz to {self.band[1]:g} Hz, {at}",
            )
        return result

    def to_json(self) -> dict[str, Any]:
        """The figures, the limits of the integral and how it was found, as plain values."""
        band = None if self.band is None else list(self.band)
        return {**super().to_json(), "temperature": self.temperature, "band": band, "exact": self.exact}


def analyse_noise(
    netlist: Netlist,
    *,
    band: tuple[float, float] | None = None,
    temperature: Positive = ROOM,
    method: Literal["auto", "exact", "estimate"] = "auto",
    samples: Annotated[int, Ge(2)] = 64,
    seed: Natural = 0,
) -> Noise:
    """Thermal noise of every node's voltage.

    `band`: limits of the integral, in hertz (a read-out of noise bandwidth ``B`` takes ``(0, B)``); by default that of
    the read-out, else all that capacitances let through; none without a chip's description; `temperature`: in kelvin,
    by default the die's; `method`: "exact", the diagonal of the inverse from the factors, or "estimate", from products
    with so many `samples` of random signs of a `seed`, for grids of three or more dimensions whose factors are large.

    A node that resistors tie to no rail is a CircuitError; conductances that span so many decades that rounding may be
    more than 1e-3 of a density within the band, or a tenth of what is estimated, are an AccuracyError.
    """
    if band is not None and not 0 <= band[0] < band[1] < _HIGHEST:
        raise InputError(f"band = {band} must be two frequencies in hertz, the lower first (for all of them see limit)")
    dynamics = dynamics_of(netlist)
    require_grounded(dynamics)
    exact = method == "exact" or (method == "auto" and _is_small(dynamics)) or not dynamics.size
    resistance, resistance_error, area, area_error = (
        find_exactly(dynamics, band) if exact else estimate(dynamics, band, random_signs(dynamics.size, samples, seed))
    )
    scale = BOLTZMANN * temperature
    total = total_error = None
    if band is not None:
        root = np.sqrt(4.0 * scale * np.maximum(area, 0.0))
        with np.errstate(divide="ignore", invalid="ignore"):
            total_error = dynamics.at_nodes(np.nan_to_num(2.0 * scale * area_error / root))
        total = dynamics.at_nodes(root)
    return Noise(
        netlist=netlist,
        temperature=float(temperature),
        resistance=dynamics.at_nodes(resistance),
        resistance_error=dynamics.at_nodes(resistance_error),
        limit=dynamics.at_nodes(np.sqrt(scale * _elastance(dynamics))),
        band=None if band is None else (float(band[0]), float(band[1])),
        total=total,
        total_error=total_error,
        exact=exact,
    )


def noise_density(
    netlist: Netlist, nodes: ArrayLike, frequencies: ArrayLike, *, temperature: Positive = ROOM
) -> NDArray[np.float64]:
    """Spot density of thermal noise, ``4 k T Re Z(f)``, in V^2/Hz; 0 on rails, NaN where a node floats.

    `nodes` (k,); `frequencies` (f,): in hertz, at least 0; `temperature`: in kelvin, by default the die's; returns (f,
    k).

    It is a CircuitError where a frequency is 0, and resistors tie some part to no rail, and an AccuracyError where a
    density may be off by more than 1e-6 of itself.
    """
    node = _checked_nodes(netlist, nodes)
    when = _checked_frequencies(frequencies)
    dynamics = dynamics_of(netlist)
    rows = dynamics.row[node].astype(np.int64)
    density = np.zeros((len(when), len(node)))
    density[:, np.isnan(dynamics.fixed[node])] = np.nan
    inside = np.flatnonzero(rows >= 0)
    if len(inside) and len(when):
        if not when.all():
            require_grounded(dynamics)
        density[:, inside] = resistive_parts(dynamics, rows[inside], when)
    return 4.0 * BOLTZMANN * temperature * density


def noise_covariance(netlist: Netlist, nodes: ArrayLike, *, temperature: Positive = ROOM) -> NDArray[np.float64]:
    """Covariance ``k T C^-1`` of node voltages from 0 Hz to infinity, in V^2; 0 on rails, NaN where a node floats.

    `nodes` (k,): each tied to a rail by capacitances, for the noise of others is unbounded; `temperature`: in kelvin,
    by default the die's; returns (k, k).
    """
    node = _checked_nodes(netlist, nodes)
    dynamics = dynamics_of(netlist)
    tied = _tied_by_capacitors(dynamics)
    rows = dynamics.row[node]
    inside = np.flatnonzero(rows >= 0)
    loose = inside[~tied[rows[inside]]]
    if len(loose):
        name = netlist.node_name(int(node[loose[0]]))
        raise InputError(f"no capacitor ties node {name} to a rail: its noise over all frequencies is unbounded")
    covariance = np.zeros((len(node), len(node)))
    if len(inside):
        place = (np.cumsum(tied) - 1)[rows[inside]]
        columns = inverse_columns(_elastance_factors(dynamics, tied), int(tied.sum()), place)
        covariance[np.ix_(inside, inside)] = columns[:, place]
    floating = np.isnan(dynamics.fixed[node])
    covariance[floating] = covariance[:, floating] = np.nan
    return BOLTZMANN * temperature * covariance


def _tied_by_capacitors(dynamics: Dynamics) -> NDArray[np.bool_]:
    return np.asarray(np.diff(dynamics.null_space.indptr) == 0)


def _elastance_factors(dynamics: Dynamics, tied: NDArray[np.bool_]) -> SupernodalFactors:
    return factor_supernodes(dynamics.capacitance.within(tied))


def _elastance(dynamics: Dynamics) -> NDArray[np.float64]:
    """Diagonal of ``C^-1`` in 1/F, infinite in parts that no capacitor ties to a rail."""
    tied = _tied_by_capacitors(dynamics)
    elastance = np.full(dynamics.size, np.inf)
    if tied.any():
        elastance[tied] = positive_inverse_diagonal(_elastance_factors(dynamics, tied))
    return elastance


def _is_small(dynamics: Dynamics) -> bool:
    plane = dynamics.conductance.edges.nnz <= 4.2 * max(dynamics.size, 1)
    return dynamics.size <= (_EXACT_PLANE if plane else _EXACT_VOLUME)


def _checked_nodes(netlist: Netlist, nodes: ArrayLike) -> NDArray[np.int64]:
    listed = np.atleast_1d(np.asarray(nodes))
    if listed.dtype.kind not in "iu" or listed.ndim != 1 or np.any((listed < 0) | (listed >= netlist.node_count)):
        raise InputError(f"nodes must be node numbers from 0 to {netlist.node_count - 1}")
    return listed.astype(np.int64)


def _checked_frequencies(frequencies: ArrayLike) -> NDArray[np.float64]:
    listed = np.atleast_1d(np.asarray(frequencies))
    hertz = listed.astype(np.float64) if listed.dtype.kind in "iuf" else np.full(1, np.nan)
    if hertz.ndim != 1 or not np.all((hertz >= 0) & (hertz < _HIGHEST)):
        raise InputError(f"frequencies must be finite (below {_HIGHEST:g}) and at least 0, in hertz")
    return hertz
