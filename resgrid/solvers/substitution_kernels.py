"""Compiled loops of substitution in scaled numbers, supernode by supernode.

Numba takes seconds to import: only functions that are about to solve import this module.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.jit import ZERO, inlined, inner_fast, kernel
from resgrid.solvers.extended_kernels import _add_product, _canonical, _shift
from resgrid.solvers.supernodal_kernels import Supernodes

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Indices = NDArray[np.int32]

_LEAST, _MOST = 2.0**-700, 2.0**700
"""Range in which a sum of doubles has lost nothing that counts to underflow, and overflows nowhere."""


@kernel
def substitute(nodes: Supernodes, values: Floats, pivot: Floats, m: Floats, e: Integers, column: Floats) -> None:
    """Solve ``L D L^T x = b`` in place, in scaled numbers.

    Within a supernode numbers have one exponent in common, the largest; where a sum leaves the range of doubles so, the
    supernode is gone through again number by number.

    Shapes: `m, e` (n,).
    """
    for i in range(len(m)):
        m[i], e[i] = _canonical(m[i], e[i])
    for node in range(len(nodes.first) - 1):
        _forward(nodes, values, m, e, column, node)
    for node in range(len(nodes.first) - 2, -1, -1):
        _backward(nodes, values, pivot, m, e, column, node)


@inlined
def _forward(nodes: Supernodes, values: Floats, m: Floats, e: Integers, column: Floats, node: int) -> None:
    """Spread what is fed into the columns of a supernode over its rows."""
    begin, base = nodes.start[node], nodes.offset[node]
    length, columns = nodes.start[node + 1] - begin, nodes.first[node + 1] - nodes.first[node]
    fed = 0
    while fed < columns and m[nodes.rows[begin + fed]] == 0.0:
        fed += 1
    if fed == columns:
        return
    common = _align(nodes.rows, begin, fed, length, m, e, column)
    for c in range(fed, columns):
        _add_times(column, values, base + c * length, c + 1, length, column[c])
    if _smallest(column, fed, length) >= _LEAST:
        for r in range(fed, length):
            row = nodes.rows[begin + r]
            m[row], e[row] = _canonical(column[r], common)
        return
    for c in range(fed, columns):
        value, scale = m[nodes.rows[begin + c]], e[nodes.rows[begin + c]]
        for r in range(c + 1, length):
            row = nodes.rows[begin + r]
            t, te = _add_product(m[row], e[row], values[base + c * length + r], value, scale)
            m[row], e[row] = _canonical(t, te)


@inlined
def _backward(
    nodes: Supernodes, values: Floats, pivot: Floats, m: Floats, e: Integers, column: Floats, node: int
) -> None:
    """Solve for the rows of a supernode's columns, from those of the later ones."""
    begin, base, first = nodes.start[node], nodes.offset[node], nodes.first[node]
    length, columns = nodes.start[node + 1] - begin, nodes.first[node + 1] - first
    common = _align(nodes.rows, begin, ZERO, length, m, e, column)
    plain = True
    for c in range(columns - 1, -1, -1):
        column[c] = column[c] / pivot[first + c] + _product(column, values, base + c * length, c + 1, length)
        plain = plain and _LEAST <= abs(column[c]) <= _MOST
    if plain:
        for c in range(columns):
            m[first + c], e[first + c] = _canonical(column[c], common)
        return
    for c in range(columns - 1, -1, -1):
        value, scale = _canonical(m[first + c] / pivot[first + c], e[first + c])
        for r in range(c + 1, length):
            row = nodes.rows[begin + r]
            value, scale = _add_product(value, scale, values[base + c * length + r], m[row], e[row])
        m[first + c], e[first + c] = _canonical(value, scale)


@inlined
def _align(rows: Indices, begin: int, skipped: int, length: int, m: Floats, e: Integers, column: Floats) -> int:
    """Write some rows as doubles; returns the largest of their exponents, which is common to all then."""
    common, found = int(e[rows[begin + skipped]]), m[rows[begin + skipped]] != 0.0
    for r in range(skipped + 1, length):
        row = rows[begin + r]
        if m[row] != 0.0 and (not found or e[row] > common):
            common, found = int(e[row]), True
    for r in range(skipped, length):
        row = rows[begin + r]
        column[r] = _shift(m[row], e[row] - common)
    return common


@inner_fast
def _smallest(column: Floats, begin: int, end: int) -> float:
    least = np.inf
    for i in range(begin, end):
        least = min(least, abs(column[np.uint64(i)]))
    return least


@inner_fast
def _add_times(column: Floats, values: Floats, base: int, begin: int, end: int, value: float) -> None:
    b = np.uint64(base)
    for each in range(begin, end):
        i = np.uint64(each)
        column[i] += value * values[b + i]


@inner_fast
def _product(column: Floats, values: Floats, base: int, begin: int, end: int) -> float:
    total, b = 0.0, np.uint64(base)
    for each in range(begin, end):
        i = np.uint64(each)
        total += column[i] * values[b + i]
    return total
