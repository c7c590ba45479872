"""Weighted sums of node voltages and of log drops: weights of places, log drops, and derivatives by node voltages.

Gradients of these sums are computed elsewhere, by the adjoint method.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.numbers import real_numbers
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.terminals import TerminalReader
from resgrid.core.netlist import Netlist
from resgrid.errors import InputError
from resgrid.solvers.refinement import corrected
from resgrid.solvers.scaled import BITS, Numbers, Scaled

_LOG_UNIT = BITS * float(np.log(2.0))
"""Natural logarithm of ``2**256``, the factor that a separate exponent of 1 stands for."""


class DotProduct(NamedTuple):
    """Dot product of two vectors, and the binary logarithm of the sum of the magnitudes of its terms, -inf for 0."""

    value: float
    log_size: float


def dot_product(first: NDArray[np.float64], second: NDArray[np.float64]) -> DotProduct:
    """Return the dot product of two vectors (k,), in which no term overflows or underflows.

    The error is at most a rounding error of every term and of the result.
    """
    (one, e_one), (two, e_two) = np.frexp(first), np.frexp(second)
    terms, exponent = one * two, e_one.astype(np.int64) + e_two
    if not terms.any():
        return DotProduct(0.0, -np.inf)
    unit = int(exponent[terms != 0.0].max())
    scaled = np.ldexp(terms, np.maximum(exponent - unit, -4000).astype(np.int32)).tolist()
    with np.errstate(over="ignore"):
        value = float(np.ldexp(math.fsum(scaled), unit))
    return DotProduct(value, unit + math.log2(math.fsum(map(abs, scaled))))


def place_weights(netlist: Netlist, at: Any, weights: ArrayLike | None, cells: bool) -> NDArray[np.float64]:
    """Return the weight of every node, (nodes,): the sum of the weights of the places at the node, else 0.

    `at`: one place, a list of places, or a mask; a place is a node number, a node name, or with `cells` a cell of the
    compiled space (a tuple of indices); all nodes of a mask are one place with one weight; `weights` (places,): weight
    of every place, None for 1; `cells`: whether places are cells.
    """
    if at is None:
        raise InputError("at is missing: give a node, such as at=5, or a cell, such as at=(3, 4), cells=True")
    read, seed = TerminalReader(netlist, cells, voltages=True), np.zeros(netlist.node_count)
    single = isinstance(at, str) or (cells and isinstance(at, tuple)) or not isinstance(at, Sequence | np.ndarray)
    if not single and getattr(at, "dtype", None) != np.bool_:
        places = [read.nodes(tuple(each) if np.iterable(each) and not isinstance(each, str) else each) for each in at]
    elif cells and getattr(at, "dtype", None) == np.bool_:
        read.nodes(at)
        inside = netlist.cells.node[at]
        places = [inside[inside >= 0]]  # a rail node counts once per cell, as in a list of cells
    else:
        places = [read.nodes(at)]
    factors = np.ones(len(places)) if weights is None else np.atleast_1d(real_numbers("weights", weights))
    if factors.shape != (len(places),):
        raise InputError(f"weights has shape {factors.shape}; give one number for each of the {len(places)} places")
    if not places:
        raise InputError(f"at = {at!r} names no place; name at least one node or cell")
    if not np.isfinite(factors).all():
        raise InputError(f"weights = {factors.tolist()} must be finite numbers, one per place")
    for nodes, factor in zip(places, factors.tolist(), strict=True):
        np.add.at(seed, nodes, factor)
    return seed


def checked_seeds(op: OperatingPoint, name: str, seed: ArrayLike | None) -> NDArray[np.float64]:
    """Return a new array (nodes,) of the weights of the node voltages or log drops in a sum; zeros for None.

    `seed` (nodes,): the weights; `name`: name of the argument in messages.  Raise InputError for a wrong shape, and for
    a weight other than 0 at a floating node.
    """
    count = op.netlist.node_count
    if seed is None:
        return np.zeros(count)
    seeds = np.array(real_numbers(name, seed), dtype=np.float64)
    if seeds.shape != (count,) or not np.isfinite(seeds).all():
        raise InputError(f"{name} of shape {seeds.shape} must be {count:,} finite numbers, one per node")
    floating = op.floating[seeds[op.floating] != 0.0]
    if floating.size:
        raise InputError(
            f"node {op.netlist.node_name(int(floating[0]))} floats, so that its voltage is undetermined; leave it out "
            "(weight 0), or connect it to ground by a resistor"
        )
    return seeds


def log_drops(op: OperatingPoint, weights: NDArray[np.float64], beyond: float = np.nan) -> NDArray[np.float64]:
    """Return the log drops of the k nodes with a weight other than 0, in the order of the nodes, (k,).

    A log drop is the natural logarithm of the drop from the high rail.  `weights` (nodes,): weights; `beyond`: an
    infinite log drop that is accepted, such as -inf on the high rail; NaN to accept none.  Raise InputError if another
    log drop is not finite, or if the circuit has no log drops.
    """
    if op.log_drop is None:
        raise InputError(
            "the circuit has no log_drop: exactly two known voltages must drive it, and the operating point must have "
            "accuracy = 'direction'; with open obstacles choose of = 'voltage' or 'path_cost'"
        )
    drops = op.log_drop[weights != 0.0]
    undefined = ~np.isfinite(drops) & (drops != beyond)
    if undefined.any():
        node = int(np.flatnonzero(weights)[undefined][0])
        raise InputError(
            f"node {op.netlist.node_name(node)} has the log_drop {op.log_drop[node]}: it is on the high rail, carries "
            "no current, or is held by a source; choose a node between the rails"
        )
    return np.asarray(drops)


def rail_voltages(op: OperatingPoint) -> tuple[float, float]:
    """Return the voltages of the high and the low rail, in volts, of an operating point with log drops."""
    assert op.log_drop is not None
    high = op.voltage[np.isneginf(op.log_drop)]
    low = op.voltage[op.log_drop == 0.0]
    return float(high[0]), float(low[0])


def with_log_seeds(op: OperatingPoint, seeds: Numbers, weights: NDArray[np.float64]) -> Numbers:
    """Return the derivatives of a sum of voltages and log drops with respect to the node voltages, in 1/V, (nodes,).

    The derivative of a log drop is ``d log u / dV = -1 / (u (V_high - V_low))``.  `seeds` (nodes,): weights of the
    voltages; `weights` (nodes,): weights of the log drops.  Result and `seeds` are mantissas and exponents of
    ``2**256``.
    """
    high, low = rail_voltages(op)
    total = corrected(Scaled(seeds[0], 0.0 * weights, seeds[1]), *times_drops(op, -weights / (high - low), -1))
    return total.hi, total.exponent


def times_drops(op: OperatingPoint, values: NDArray[np.float64], degree: int) -> Numbers:
    """Return ``values * u**degree`` with the drops ``u`` of the nodes, (nodes,), as numbers with separate exponents.

    The result is a pair of mantissas and exponents of ``2**256``.  `values` (nodes,): factors; `degree`: 1 or -1.  The
    result is 0 where a value is 0 or the log drop is not finite.
    """
    assert op.log_drop is not None
    mantissa, exponent = np.zeros(len(values)), np.zeros(len(values), dtype=np.int64)
    chosen = (values != 0.0) & np.isfinite(op.log_drop)
    logs = degree * op.log_drop[chosen]
    exponent[chosen] = np.floor(logs / _LOG_UNIT).astype(np.int64)
    mantissa[chosen] = values[chosen] * np.exp(logs - exponent[chosen] * _LOG_UNIT)
    return mantissa, exponent


def above_obstacles(op: OperatingPoint) -> Numbers:
    """Return the voltages of the nodes above the obstacle rail of the compiled space, in volts, (nodes,).

    The result is a pair of mantissas and exponents of ``2**256``, 0 for floating nodes.  For a netlist that was not
    compiled from a space, the voltages are those above ground.
    """
    cells = op.netlist.cell_map
    height = np.nan_to_num(op.voltage if cells is None else op.voltage - cells.wiring.high)
    if cells is None or op.log_drop is None:
        return height, np.zeros(len(height), dtype=np.int64)
    mantissa, exponent = times_drops(op, np.full(len(height), -cells.wiring.supply), 1)
    return np.where(np.isfinite(op.log_drop), mantissa, height), exponent
