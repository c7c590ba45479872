"""Resistances and conductances between terminals, with proved bounds on their relative errors.

The conductances ``C_ij`` of the reduced network are computed in doubles, with a bound on their errors
(`resgrid.circuit.network_reduction`).  Where the bound is too large, a circuit of at most 2,000 nodes is reduced in
decimals with unbounded exponents, and a larger circuit is refused.

A change of ``C_ij`` by ``e`` changes the conductance ``1 / R`` between two terminals by at most ``e``, because
``d(1 / R) / dC_ij`` is the square of the voltage between ``i`` and ``j`` with 1 V between the two terminals.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.circuit.decimal_elimination import (
    ROUNDING,
    fits_decimals,
    reduce_in_decimals,
    resistances_in_decimals,
)
from resgrid.circuit.network_reduction import MOST_ERROR, reduce_to_groups
from resgrid.circuit.pairwise_resistances import elimination_error, resistances_between
from resgrid.circuit.terminals import Nodes
from resgrid.core.netlist import Netlist
from resgrid.core.regions import label_components
from resgrid.errors import AccuracyError, CircuitError

_USUAL_PLACES = 100
"""Magnitude of the binary logarithm of the largest conductance, in siemens, up to which conductances are not scaled."""

_LEAST = 5e-324
"""Smallest positive double."""


class Bounded(NamedTuple):
    """Resistances in ohms or conductances in siemens, the bound on their relative errors, and the method."""

    values: NDArray[np.float64]
    error: float
    method: str


def bounded_resistances(
    netlist: Netlist, group: Nodes, groups: NDArray[np.int64], pairs: NDArray[np.int64], **options: Any
) -> Bounded:
    """Return the effective resistances of pairs of terminals in ohms, (p,), with a bound on their relative errors.

    `group` (nodes,): number of the group of joined nodes of every node; `groups` (k,): different groups that are
    terminals; `pairs` (p, 2): both terminals of every pair, as indices into `groups`; `options`: of `reduce_to_groups`.
    Raise AccuracyError if no bound is known, CircuitError if a resistance exceeds the range of doubles.
    """
    scaled, places = _scaled(netlist)
    component = label_components(group[netlist.resistor_nodes], int(group.max()) + 1)[groups[pairs]]
    connected = component[:, 0] == component[:, 1]

    def in_doubles() -> Bounded:
        found = reduce_to_groups(scaled, group, groups, **options)
        ohms = resistances_between(found.conductance)[tuple(pairs.T)]
        added = 0.5 * len(groups) ** 2 * found.absolute * float(ohms[connected].max(initial=0.0))
        error = _of_quotient(found.relative + elimination_error(len(groups)) + added)
        return Bounded(np.ldexp(ohms, -places), error, found.method)

    def in_decimals() -> Bounded:
        return Bounded(resistances_in_decimals(netlist, group, groups[pairs]), ROUNDING, "direct")

    found = _first_proved(netlist, len(groups), in_doubles, in_decimals)
    beyond = np.flatnonzero(connected & np.isinf(found.values))
    if beyond.size:
        names = [netlist.node_name(int(np.flatnonzero(group == end)[0])) for end in groups[pairs[beyond[0]]]]
        raise CircuitError(
            f"the effective resistance between the nodes {names[0]} and {names[1]} exceeds 1.8e308 ohm, the range of "
            "double precision; check the unit of the smallest conductances, or leave out this pair"
        )
    return _with_rounding(found)


def bounded_conductances(netlist: Netlist, group: Nodes, groups: NDArray[np.int64], **options: Any) -> Bounded:
    """Return the conductances of the reduced network in siemens, (k, k), with a bound on their relative errors.

    `group` (nodes,): number of the group of joined nodes of every node; `groups` (k,): different groups that are
    terminals; `options`: of `reduce_to_groups`. Conductances below the range of doubles are 0. Raise AccuracyError if
    no bound is known, CircuitError if a conductance exceeds the range of doubles.
    """
    scaled, places = _scaled(netlist)
    joined = _joined_terminals(netlist, group, groups)

    def in_doubles() -> Bounded:
        found = reduce_to_groups(scaled, group, groups, **options)
        least = float(found.conductance[joined].min(initial=np.inf))
        added = found.absolute / least if least > 0.0 else np.inf
        return Bounded(np.ldexp(found.conductance, places), _of_quotient(found.relative + added), found.method)

    def in_decimals() -> Bounded:
        return Bounded(reduce_in_decimals(netlist, group, groups), ROUNDING, "direct")

    found = _first_proved(netlist, len(groups), in_doubles, in_decimals)
    if np.isinf(found.values).any():
        raise CircuitError(
            "a conductance of the reduced network exceeds 1.8e308 S, the range of double precision; check the unit of "
            "the largest conductances"
        )
    return _with_rounding(found)


def _first_proved(
    netlist: Netlist, terminals: int, in_doubles: Callable[[], Bounded], in_decimals: Callable[[], Bounded]
) -> Bounded:
    """Return the results in doubles if their bound is at most `MOST_ERROR`, else those in decimals.

    `terminals`: number of terminals. Raise AccuracyError if the circuit is too large for decimals.
    """
    bound, method = np.inf, ""
    try:
        with np.errstate(all="ignore"):
            found = in_doubles()
        if found.error <= MOST_ERROR:
            return found
        bound, method = found.error, found.method
    except AccuracyError:
        pass
    if fits_decimals(netlist, terminals):
        return in_decimals()
    span = float(np.subtract(*np.log10([netlist.conductance.max(), netlist.conductance.min()])))
    remedy = "use method = 'direct', or " if method == "multigrid" else ""
    reached = "no accuracy" if not np.isfinite(bound) else f"a relative error of only {bound:.1e}"
    raise AccuracyError(
        f"the conductances span {span:.0f} orders of magnitude, so that doubles guarantee {reached} (1e-6 is allowed); "
        f"{remedy}leave out the smallest conductances or replace the largest ones by voltage sources of 0 V; circuits "
        "of at most 2,000 nodes and 200 terminals have no such limit"
    )


def _scaled(netlist: Netlist) -> tuple[Netlist, int]:
    """Return the circuit with conductances divided by ``2**p``, and ``p``: 0 if the largest conductance is usual.

    Otherwise the largest conductance becomes a number between 0.5 and 1 S; conductances that underflow become the
    smallest double.
    """
    places = int(np.frexp(netlist.conductance.max(initial=1.0 if not netlist.conductance.size else 0.0))[1])
    if abs(places) <= _USUAL_PLACES:
        return netlist, 0
    siemens = np.maximum(np.ldexp(np.ldexp(netlist.conductance, -places // 2), -places - -places // 2), _LEAST)
    return netlist.replace(conductance=siemens), places


def _of_quotient(error: float) -> float:
    """Return the bound on the relative error of ``1 / x`` and of ``x`` as a fraction of its computed value.

    `error`: bound on the relative error of ``x``.
    """
    return float(error / (1.0 - error)) if error < 1.0 else np.inf


def _with_rounding(found: Bounded) -> Bounded:
    """Return the results with the rounding of subnormal numbers added to their bound."""
    least = float(found.values.min(initial=np.inf, where=found.values > 0.0))
    return found._replace(error=found.error + _LEAST / least) if least < 1e-290 else found


def _joined_terminals(
    netlist: Netlist, group: Nodes, groups: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the pairs of different terminals with a conductance in the reduced network, as two arrays of indices.

    A resistor, or a path through inner nodes, joins the two terminals of a pair. `group` (nodes,): number of the group
    of joined nodes of every node; `groups` (k,): different groups that are terminals.
    """
    count = int(group.max()) + 1
    number = np.full(count, -1)
    number[groups] = np.arange(len(groups))
    ends = group[netlist.resistor_nodes]
    first, second = number[ends.T]
    part = label_components(ends[(first < 0) & (second < 0)], count)
    touching = (first < 0) != (second < 0)
    inner, terminal = np.where(first < 0, *ends.T)[touching], np.maximum(first, second)[touching]
    touches = sparse.csr_array((np.ones(len(inner)), (terminal, part[inner])), shape=(len(groups), count))
    direct = (first >= 0) & (second >= 0)
    low, high = np.triu_indices(0) if not len(inner) else (touches @ touches.T).nonzero()
    low, high = np.append(low, first[direct]), np.append(high, second[direct])
    different = low != high
    return low[different], high[different]
