"""Thermal noise of a chip: every resistor adds current noise of density ``4 k T / R`` (Johnson 1928; Nyquist 1928).

The power spectral density of a node voltage is ``4 k T Re Z(f)``, with the Boltzmann constant ``k``, the temperature
``T``, and the impedance ``Z`` from the node to the rails, the diagonal of ``(G + 2 pi j f C)^-1``.  Below the corner
frequency of the slowest time constant the density is ``4 k T R_eff``, with the effective resistance ``R_eff`` from the
node to the rails.  The integral of the density over all frequencies is ``k T (C^-1)_ii``, whatever the resistors, and
infinite at a node without a capacitive connection to a rail.  All resistors have the given temperature; sources,
drivers of switches and capacitors are noiseless.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.numbers import Natural, Positive
from resgrid.chip.figures_of_merit import Figure, Result, defined
from resgrid.chip.impedance import estimated_integrals, exact_integrals, inverse_columns, resistive_parts
from resgrid.circuit.dynamics import Dynamics, dynamics_of, require_grounded
from resgrid.core.netlist import Netlist
from resgrid.errors import InputError
from resgrid.solvers.selected_inverse import positive_inverse_diagonal, random_signs
from resgrid.solvers.supernodal import factor_supernodes
from resgrid.solvers.supernodal_factors import SupernodalFactors

BOLTZMANN = 1.380649e-23
"""Boltzmann constant, in J/K (exact)."""

NOMINAL_KELVIN = 300.15
"""Nominal temperature of SPICE (27 degrees Celsius), in kelvin."""

_HIGHEST = np.float64(1e300)
"""Upper limit of frequencies in arguments, in hertz; frequencies at or above this limit raise InputError."""
_EXACT_PLANE, _EXACT_VOLUME = 300_000, 15_000
"""Largest numbers of rows (unknown node voltages) for which the method "auto" computes exact results: for plane grids
(`_EXACT_PLANE`), and for all other circuits (`_EXACT_VOLUME`).
"""


@dataclass(frozen=True, eq=False, repr=False)
class Noise(Result):
    """Thermal noise of every node voltage; 0 on rails, NaN where a node floats.

    Returned by `resgrid.chip.Study.noise`.

    Attributes
    ----------
    netlist : Netlist
        The chip.
    temperature : float
        Temperature of all resistors, in kelvin.
    resistance : ndarray of float64, shape (nodes,)
        Effective resistance from every node to the rails at low frequency, in ohms.
    resistance_error : ndarray of float64, shape (nodes,)
        Standard error of an estimated `resistance`, in ohms; 0 for exact results, whose relative error is a few units
        of rounding.
    limit : ndarray of float64, shape (nodes,)
        Root mean square noise from 0 Hz to infinity, ``sqrt(k T (C^-1)_ii)``, in volts; infinite at a node without a
        capacitive connection to a rail.
    band : tuple of float, or None
        Lower and upper limit of the noise integral, in hertz; None without an integral.
    total : ndarray of float64, shape (nodes,), or None
        Root mean square noise within the band, in volts; None without a band.
    total_error : ndarray of float64, shape (nodes,), or None
        Standard error of an estimated `total`, in volts; for exact results, a bound on rounding errors; None without a
        band.
    exact : bool
        Whether the results are exact, not estimated from samples.
    density : ndarray of float64, shape (nodes,)
        Power spectral density ``4 k T R_eff`` at low frequency, in V^2/Hz, with the Boltzmann constant ``k``, the
        `temperature` ``T`` and the `resistance` ``R_eff``.
    figures : mapping of str to Figure
        Figures of the noisiest node by name.

    Examples
    --------
    >>> noise = rg.study(rg.read_scene("examples/scenes/lesson.toml"), rg.Chip(capacitance="100f")).noise()
    >>> print(noise.figures["largest_noise_density"], noise.figures["largest_noise_limit"])
    8.161 nV/√Hz 203.6 µV
    >>> node = noise.netlist.cells.node[6, 2]
    >>> f"{noise.resistance[node]:.5g} ohm", f"{noise.limit[node]:.4g} V"
    ('3467.4 ohm', '0.0002036 V')
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
        """Power spectral density ``4 k T R_eff`` at low frequency, shape (nodes,), in V^2/Hz."""
        return 4.0 * BOLTZMANN * self.temperature * self.resistance

    @property
    def figures(self) -> Mapping[str, Figure]:
        """Figures of merit of the noisiest node by name.

        ``largest_effective_resistance`` (ohms); ``largest_noise_density`` (V/sqrt(Hz)) at low frequency;
        ``largest_noise_limit``: rms noise in volts over all frequencies, None if some node has no capacitive
        connection to a rail; ``largest_noise``: rms noise in volts within the band, only if there is one.
        """
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
        """Return the result as a dictionary for JSON.

        Keys: the names of `figures`, each with a dictionary of ``value``, ``unit`` and ``definition``; ``temperature``
        in kelvin; ``band``: lower and upper limit in hertz, or None; ``exact``: False if random vectors estimated the
        results.
        """
        band = None if self.band is None else list(self.band)
        return {**super().to_json(), "temperature": self.temperature, "band": band, "exact": self.exact}


def analyse_noise(
    netlist: Netlist,
    *,
    band: tuple[float, float] | None = None,
    temperature: Positive = NOMINAL_KELVIN,
    method: Literal["auto", "exact", "estimate"] = "auto",
    samples: Annotated[int, Ge(2)] = 64,
    seed: Natural = 0,
) -> Noise:
    """Compute the thermal noise of every node voltage of a netlist; return it as a Noise.

    `band`: lower and upper limit of the noise integral in hertz, None for no integral; `temperature`: temperature of
    the resistors, in kelvin; `method`: ``"exact"``, ``"estimate"`` (from random vectors), or ``"auto"``, which is exact
    up to 300,000 unknown voltages in plane grids and up to 15,000 in other circuits; `samples`: number of random
    vectors of an estimate; `seed`: seed of these vectors.
    """
    if band is not None and not 0 <= band[0] < band[1] < _HIGHEST:
        raise InputError(f"band = {band} must be two frequencies in hertz, the lower first (for all of them see limit)")
    dynamics = dynamics_of(netlist)
    require_grounded(dynamics)
    exact = method == "exact" or (method == "auto" and _is_small(dynamics)) or not dynamics.size
    resistance, resistance_error, area, area_error = (
        exact_integrals(dynamics, band)
        if exact
        else estimated_integrals(dynamics, band, random_signs(dynamics.size, samples, seed))
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
    netlist: Netlist, nodes: ArrayLike, frequencies: ArrayLike, *, temperature: Positive = NOMINAL_KELVIN
) -> NDArray[np.float64]:
    """Return the power spectral density ``4 k T Re Z(f)`` of node voltages in V^2/Hz, shape (frequencies, nodes).

    `nodes` (nodes,): node numbers; `frequencies` (frequencies,): in hertz; `temperature`: temperature ``T`` of the
    resistors, in kelvin.  ``Z`` is the impedance from a node to the rails.  The density is 0 on rails, NaN where a node
    floats.
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


def noise_covariance(
    netlist: Netlist, nodes: ArrayLike, *, temperature: Positive = NOMINAL_KELVIN
) -> NDArray[np.float64]:
    """Return the covariance ``k T C^-1`` of node voltages over all frequencies in V^2, shape (nodes, nodes).

    `nodes` (nodes,): node numbers; `temperature`: temperature ``T`` of the resistors, in kelvin.  The covariance is 0
    on rails, NaN where a node floats.  Raises InputError for a node without a capacitive connection to a rail.
    """
    node = _checked_nodes(netlist, nodes)
    dynamics = dynamics_of(netlist)
    tied = _tied_by_capacitors(dynamics)
    rows = dynamics.row[node]
    inside = np.flatnonzero(rows >= 0)
    loose = inside[~tied[rows[inside]]]
    if len(loose):
        name = netlist.node_name(int(node[loose[0]]))
        raise InputError(
            f"no capacitance connects node {name} to a rail: its noise over all frequencies is unbounded; leave it out"
        )
    covariance = np.zeros((len(node), len(node)))
    if len(inside):
        place = (np.cumsum(tied) - 1)[rows[inside]]
        columns = inverse_columns(_elastance_factors(dynamics, tied), int(tied.sum()), place)
        covariance[np.ix_(inside, inside)] = columns[:, place]
    floating = np.isnan(dynamics.fixed[node])
    covariance[floating] = covariance[:, floating] = np.nan
    return BOLTZMANN * temperature * covariance


def _tied_by_capacitors(dynamics: Dynamics) -> NDArray[np.bool_]:
    """Return the mask of the rows (unknown voltages) with a capacitive connection to a rail, shape (n,)."""
    return np.asarray(np.diff(dynamics.null_space.indptr) == 0)


def _elastance_factors(dynamics: Dynamics, tied: NDArray[np.bool_]) -> SupernodalFactors:
    """Return the factors of the capacitance matrix, restricted to some rows; `tied` (n,): mask of these rows."""
    return factor_supernodes(dynamics.capacitance.within(tied))


def _elastance(dynamics: Dynamics) -> NDArray[np.float64]:
    """Return the diagonal of ``C^-1`` in 1/F, shape (n,); infinite in rows without capacitive connection to a rail."""
    tied = _tied_by_capacitors(dynamics)
    elastance = np.full(dynamics.size, np.inf)
    if tied.any():
        elastance[tied] = positive_inverse_diagonal(_elastance_factors(dynamics, tied))
    return elastance


def _is_small(dynamics: Dynamics) -> bool:
    """Return whether the circuit has few enough rows (unknown voltages) for exact results from matrix factors.

    The limit is 300,000 rows for circuits with at most 2.1 resistors between rows per row, as in a plane grid, and
    15,000 rows for others.
    """
    plane = dynamics.conductance.edges.nnz <= 4.2 * max(dynamics.size, 1)
    return dynamics.size <= (_EXACT_PLANE if plane else _EXACT_VOLUME)


def _checked_nodes(netlist: Netlist, nodes: ArrayLike) -> NDArray[np.int64]:
    """Return node numbers as an array, shape (k,); raise InputError unless all are nodes of the netlist."""
    listed = np.atleast_1d(np.asarray(nodes))
    if listed.dtype.kind not in "iu" or listed.ndim != 1 or np.any((listed < 0) | (listed >= netlist.node_count)):
        raise InputError(f"nodes must be node numbers from 0 to {netlist.node_count - 1}")
    return listed.astype(np.int64)


def _checked_frequencies(frequencies: ArrayLike) -> NDArray[np.float64]:
    """Return frequencies in hertz as an array (f,); raise InputError for negative, infinite or other invalid ones."""
    listed = np.atleast_1d(np.asarray(frequencies))
    hertz = listed.astype(np.float64) if listed.dtype.kind in "iuf" else np.full(1, np.nan)
    if hertz.ndim != 1 or not np.all((hertz >= 0) & (hertz < _HIGHEST)):
        raise InputError(f"frequencies must be finite (below {_HIGHEST:g}) and at least 0, in hertz")
    return hertz
