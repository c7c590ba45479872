"""Integer solves with exactly current-conserving factors, for networks with conductances of very different magnitude.

Elimination of a row distributes its current over its neighbours and the ground (all nodes of known voltage), in fixed
fractions. Each fraction is known to a few rounding errors (Grassmann, Taksar & Heyman 1985), so that the fractions of a
row sum to one only up to rounding. A current of 1e24 A would then lose 1e8 A, which may exceed the current from a group
of rows, joined by large conductances, to the ground. Therefore the largest fraction of each row is computed as one
minus all others, and currents and voltages are integers: the currents into and out of a group of rows are equal.

The result is exact for a network whose conductances differ from the given ones by a few rounding errors, whatever their
ratios. The energy of the error of a solution is at most some ``n**1.5`` rounding errors times the energy of the
solution. Iterative refinement with exact residuals therefore converges for every network.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from resgrid.solvers.supernodal_factors import SupernodalFactors

_MANTISSA = 53

Fixed = tuple[int, int]
"""A double as ``(m, p)``: the integer ``m`` and the number ``p`` of binary places, with the value ``m * 2**-p``."""


def fixed(value: float) -> Fixed:
    """Return ``(m, p)`` with ``value == m * 2**-p`` exactly; ``m`` is an integer of at most 53 bits."""
    fraction, exponent = math.frexp(value)
    return int(fraction * 2.0**_MANTISSA), _MANTISSA - exponent


def _inverse(value: float) -> Fixed:
    """Return the inverse of a positive double as ``(m, p)`` with the value ``m * 2**-p``, rounded to 53 bits.

    The inverse may exceed the range of doubles.
    """
    fraction, exponent = math.frexp(value)
    mantissa, places = fixed(1.0 / fraction)
    return mantissa, places + exponent


class Column(NamedTuple):
    """Elimination step of one row of the matrix: the fractions of the row's current that its neighbours receive.

    Neighbours are the rows that are joined to this one when it is eliminated. Fractions and the resistance are `Fixed`.

    `row`: index of the eliminated row; `fractions`: pairs of a neighbour's row index and its fraction, without the
    neighbour of the largest fraction; `largest`: row index of that neighbour, -1 if the ground (all nodes of known
    voltage) receives the largest fraction; `leak`: fraction that goes to the ground, None if it is the largest fraction
    or 0; `resistance`: inverse of the pivot, in ohms.
    """

    row: int
    fractions: list[tuple[int, Fixed]]
    largest: int
    leak: Fixed | None
    resistance: Fixed


def columns_of(factors: SupernodalFactors) -> list[Column]:
    """Return the elimination steps of all rows, in the order of elimination; `factors`: factors ``L D L^T``."""
    (order, place, nodes), (indptr, indices, edges, ground), values, pivot, _ = factors
    size, kept = len(order), int(nodes.first[-1])
    grounded, columns = ground[order].tolist(), []

    def distribute(k: int, rows: Sequence[int], parts: Sequence[float]) -> None:
        d, leak = float(pivot[k]), grounded[k] / float(pivot[k])
        for to, part in zip(rows, parts, strict=True):
            grounded[to] += part * grounded[k]
        given = [(part, int(order[to])) for part, to in zip(parts, rows, strict=True) if part > 0.0]
        largest = max(given, default=(0.0, -1))
        if leak > largest[0]:
            largest = leak, -1
        fractions = [(to, fixed(part)) for part, to in given if to != largest[1]]
        columns.append(
            Column(int(order[k]), fractions, largest[1], fixed(leak) if largest[1] >= 0 < leak else None, _inverse(d))
        )

    for k in range(kept, size):
        entries = slice(indptr[order[k]], indptr[order[k] + 1])
        distribute(k, place[indices[entries]].tolist(), (edges[entries] / pivot[k]).tolist())
    for node in range(len(nodes.first) - 1):
        rows, length = nodes.rows[nodes.start[node] : nodes.start[node + 1]].tolist(), nodes.start[node + 1]
        length -= nodes.start[node]
        for c, k in enumerate(range(nodes.first[node], nodes.first[node + 1])):
            begin = nodes.offset[node] + c * length
            distribute(k, rows[c + 1 :], values[begin + c + 1 : begin + length].tolist())
    return columns


def substitute(columns: list[Column], current: list[int], places: int) -> list[int]:
    """Return the voltages of all rows for the currents into them, both as integers in row order.

    `columns`: elimination steps of all rows; `current` (n,): current into every row, as integer multiples of one small
    unit; `places`: the unit of the voltages is ``2**-places`` times the voltage of one unit of current across one ohm.
    """
    current, voltage = current.copy(), [0] * len(current)
    for row, fractions, largest, leak, _ in columns:
        if amps := current[row]:
            remaining = amps
            for to, (mantissa, shift) in fractions:
                part = amps * mantissa >> shift
                current[to] += part
                remaining -= part
            if largest >= 0:
                if leak:
                    remaining -= amps * leak[0] >> leak[1]
                current[largest] += remaining
    for row, fractions, largest, leak, (ohms, digits) in reversed(columns):
        rise = scaled(current[row] * ohms, places - digits)
        base = voltage[largest] if largest >= 0 else 0
        for to, (mantissa, shift) in fractions:
            rise += (voltage[to] - base) * mantissa >> shift
        if leak:
            rise -= base * leak[0] >> leak[1]
        voltage[row] = base + rise
    return voltage


def scaled(value: int, exponent: int) -> int:
    """Return ``value * 2**exponent`` as an integer, rounded down."""
    return value << exponent if exponent >= 0 else value >> -exponent


def nearest(value: int, exponent: int) -> float:
    """Return ``value * 2**exponent`` rounded to the nearest double; infinite beyond the range of doubles."""
    excess = value.bit_length() - 64
    if excess > 0:
        lost = value & ((1 << excess) - 1)
        value, exponent = (value >> excess) | (lost != 0), exponent + excess
    try:
        return math.ldexp(float(value), exponent)
    except OverflowError:
        return math.copysign(np.inf, value)
