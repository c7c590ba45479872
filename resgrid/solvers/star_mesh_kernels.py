"""Compiled loops of star-mesh elimination, in double-double and positive arithmetic only.

Rows live in the slots of the matrix they came from: row ``i`` owns ``start[i] ... start[i] + length[i] - 1``, and
``twin`` leads from a slot to the same conductance in the other row.  A row that gains a neighbour loses one at the same
time, so that no row ever needs more room, and every change takes constant time.

Numba takes seconds to import: only functions that are about to solve import this module.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.jit import inner, kernel
from resgrid.solvers.extended import BITS
from resgrid.solvers.extended_kernels import _canonical, _sum, _two_product

_INVERSE = 2.0**-BITS
_MOST_SEARCHED = 48
_LEAST_RATIO = 2.0**-200

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Indices = NDArray[np.int32]


class QuotientGraph(NamedTuple):
    """The matrix that is left: conductances by rows, double-double, and ground conductances.

    `start, length` (n,): first slot of every row, and how many of its slots are in use; `neighbour, twin` (slots,):
    the other row of a slot's conductance, and the slot there; `g, g_low` (slots,): conductances, in siemens; `ground,
    ground_low` (n,): conductance of every row to the ground, in siemens; `gone` (n,): rows that are eliminated.
    """

    start: Indices
    length: Indices
    neighbour: Indices
    twin: Indices
    g: Floats
    g_low: Floats
    ground: Floats
    ground_low: Floats
    gone: NDArray[np.bool_]


class Log(NamedTuple):
    """How rows were eliminated, in order.

    `rows` (n, 3): the eliminated row and its neighbours, -1 for none; `weights` (n, 6): ``g1 / d``, ``g2 / d`` and
    ``1 / d`` (1/S), double-double.
    """

    rows: Indices
    weights: Floats


@inner
def _times(a: float, a_low: float, b: float, b_low: float) -> tuple[float, float]:
    p, q = _two_product(a, b)
    q += a * b_low + a_low * b
    s = p + q
    return s, q - (s - p)


@inner
def _reciprocal(d: float, d_low: float) -> tuple[float, float]:
    first = 1.0 / d
    p, q = _times(d, d_low, first, 0.0)
    rest, _ = _sum(1.0, 0.0, -p, -q)
    return _sum(first, 0.0, rest / d, 0.0)


@kernel
def find_twins(indptr: Indices, indices: Indices, twin: Indices) -> None:
    """Slot of the transposed entry of every entry; the matrix is structurally symmetric, its rows sorted."""
    place = indptr[:-1].copy()
    for row in range(len(indptr) - 1):
        for k in range(indptr[row], indptr[row + 1]):
            twin[place[indices[k]]] = k
            place[indices[k]] += 1


@inner
def _drop(graph: QuotientGraph, row: int, slot: int) -> None:
    """Take a slot out of a row: the row's last slot moves to its place."""
    last = graph.start[row] + graph.length[row] - 1
    if slot != last:
        graph.neighbour[slot] = graph.neighbour[last]
        graph.twin[slot] = graph.twin[last]
        graph.g[slot] = graph.g[last]
        graph.g_low[slot] = graph.g_low[last]
        graph.twin[graph.twin[slot]] = slot
    graph.length[row] -= 1


@inner
def _find(graph: QuotientGraph, a: int, b: int) -> int:
    """Slot of a conductance between two rows, -1 for none, -2 if both rows are too long to be searched."""
    if graph.length[a] > graph.length[b]:
        a, b = b, a
    if graph.length[a] > _MOST_SEARCHED:
        return -2
    for k in range(graph.start[a], graph.start[a] + graph.length[a]):
        if graph.neighbour[k] == b:
            return k
    return -1


@inner
def _assign(graph: QuotientGraph, slot: int, g: float, g_low: float) -> None:
    """Give a conductance its value, in both rows."""
    other = graph.twin[slot]
    graph.g[slot], graph.g_low[slot] = g, g_low
    graph.g[other], graph.g_low[other] = g, g_low


@inner
def _join(graph: QuotientGraph, k: int, m: int, g: float, g_low: float) -> int:
    """Replace two conductances of a row, in slots ``k`` and ``m``, by one between their other ends.

    Returns how many slots either end has lost (0 or 1), or 2 if the two ends may now be joined twice.
    """
    a, b = graph.neighbour[k], graph.neighbour[m]
    there = _find(graph, a, b)
    if there >= 0:
        s, t = _sum(graph.g[there], graph.g_low[there], g, g_low)
        _assign(graph, there, s, t)
        _drop(graph, a, graph.twin[k])
        _drop(graph, b, graph.twin[m])
        return 1
    at_a, at_b = graph.twin[k], graph.twin[m]
    graph.neighbour[at_a], graph.neighbour[at_b] = b, a
    graph.twin[at_a], graph.twin[at_b] = at_b, at_a
    _assign(graph, at_a, g, g_low)
    return 2 if there == -2 else 0


@inner
def _add_ground(graph: QuotientGraph, row: int, share: float, share_low: float, e: float, e_low: float) -> None:
    """Add a share of a conductance to the ground to a row."""
    t, t_low = _times(share, share_low, e, e_low)
    graph.ground[row], graph.ground_low[row] = _sum(graph.ground[row], graph.ground_low[row], t, t_low)


@inner
def _eliminate_row(graph: QuotientGraph, row: int, entry: Indices, weight: Floats) -> int:
    """Eliminate a row of at most two slots and record it.

    Returns -1 if it must stay, otherwise what `_join` says of its neighbours.
    """
    degree, k = graph.length[row], graph.start[row]
    a, b, m = -1, -1, k + 1
    g1, g1_low, g2, g2_low = 0.0, 0.0, 0.0, 0.0
    if degree > 0:
        a, g1, g1_low = graph.neighbour[k], graph.g[k], graph.g_low[k]
    if degree > 1:
        b, g2, g2_low = graph.neighbour[m], graph.g[m], graph.g_low[m]
    if degree > 1 and a == b:
        g1, g1_low = _sum(g1, g1_low, g2, g2_low)
        b, g2, g2_low = -1, 0.0, 0.0
    e, e_low = graph.ground[row], graph.ground_low[row]
    d, d_low = _sum(g1, g1_low, g2, g2_low)
    d, d_low = _sum(d, d_low, e, e_low)
    if (a >= 0 and g1 < _LEAST_RATIO * d) or (b >= 0 and g2 < _LEAST_RATIO * d) or not d > 0.0:
        return -1
    inverse, inverse_low = _reciprocal(d, d_low)
    w1, w1_low = _times(g1, g1_low, inverse, inverse_low)
    w2, w2_low = _times(g2, g2_low, inverse, inverse_low)
    entry[0], entry[1], entry[2] = row, a, b
    weight[0], weight[1], weight[2], weight[3], weight[4], weight[5] = w1, w1_low, w2, w2_low, inverse, inverse_low
    if e > 0.0 and a >= 0:
        _add_ground(graph, a, w1, w1_low, e, e_low)
    if e > 0.0 and b >= 0:
        _add_ground(graph, b, w2, w2_low, e, e_low)
    change = 1
    if b >= 0:
        g, g_low = _times(g1, g1_low, w2, w2_low)
        change = _join(graph, k, m, g, g_low)
    else:
        for slot in range(k, k + degree):
            _drop(graph, a, graph.twin[slot])
    graph.gone[row] = True
    graph.length[row] = 0
    return change


@inner
def _queue(length: int, row: int, leaves: Indices, top: int, pairs: Indices, tail: int) -> tuple[int, int]:
    """Put a row of at most two slots on the stack of leaves or into the queue of pairs."""
    if length <= 1:
        leaves[top] = row
        return top + 1, tail
    if length == 2:
        pairs[tail] = row
        return top, tail + 1
    return top, tail


@kernel
def eliminate(graph: QuotientGraph, log: Log, count: int) -> tuple[int, int]:
    """Eliminate rows of at most two slots until none is left, leaves first; all in place.

    A row with conductances ``g1`` and ``g2`` to neighbours and ground ``e``, ``d = g1 + g2 + e``, leaves ``g1 g2 / d``
    between them and ties them to the ground by ``g1 e / d`` and ``g2 e / d`` (star-mesh transformation).  Every
    value is a sum, product or quotient of positive ones, so that each keeps its relative accuracy (Grassmann, Taksar &
    Heyman 1985; O'Cinneide 1993).  A row stays where ``g1 / d`` or ``g2 / d`` would fall below 2**-200.
    """
    n = len(graph.start)
    leaves, pairs = np.empty(2 * n, np.int32), np.empty(n, np.int32)
    top, head, tail, doubled = 0, 0, 0, 0
    for row in range(n):
        if not graph.gone[row]:
            top, tail = _queue(graph.length[row], row, leaves, top, pairs, tail)
    while top > 0 or head < tail:
        if top > 0:
            top -= 1
            row = leaves[top]
        else:
            row = pairs[head]
            head += 1
        if graph.gone[row] or graph.length[row] > 2:
            continue
        change = _eliminate_row(graph, row, log.rows[count], log.weights[count])
        if change < 0:
            continue
        if change == 2:
            doubled += 1
        for end in range(1, 3):
            other = log.rows[count, end]
            if other >= 0 and change == 1:
                top, tail = _queue(graph.length[other], other, leaves, top, pairs, tail)
        count += 1
    return count, doubled


@kernel
def merge_parallel(graph: QuotientGraph) -> None:
    """Merge conductances that join the same two rows, in place."""
    n = len(graph.start)
    seen = np.full(n, -1, np.int32)
    for row in range(n):
        first = graph.start[row]
        k = first
        while k < first + graph.length[row]:
            other = graph.neighbour[k]
            slot = seen[other]
            if first <= slot < k and graph.neighbour[slot] == other:
                s, t = _sum(graph.g[slot], graph.g_low[slot], graph.g[k], graph.g_low[k])
                _assign(graph, slot, s, t)
                _drop(graph, other, graph.twin[k])
                _drop(graph, row, k)
                continue
            seen[other] = k
            k += 1


@kernel
def pack(graph: QuotientGraph, number: Indices, indptr: Indices, indices: Indices, conductance: Floats) -> None:
    """Columns and conductances of the rows that are left, renumbered; ``number`` is -1 for the others."""
    for row in range(len(number)):
        if number[row] < 0:
            continue
        first = indptr[number[row]]
        for k in range(graph.length[row]):
            slot = graph.start[row] + k
            indices[first + k] = number[graph.neighbour[slot]]
            conductance[first + k] = graph.g[slot]


@kernel
def forward(log: Log, b: Floats) -> None:
    """Carry the currents of eliminated rows to their neighbours, in place; plain doubles."""
    for k in range(len(log.rows)):
        value = b[log.rows[k, 0]]
        for end in range(2):
            other = log.rows[k, 1 + end]
            if other >= 0:
                b[other] += log.weights[k, 2 * end] * value


@kernel
def backward(log: Log, x: Floats) -> None:
    """Turn the currents of eliminated rows into their voltages, in place; plain doubles."""
    for k in range(len(log.rows) - 1, -1, -1):
        value = log.weights[k, 4] * x[log.rows[k, 0]]
        for end in range(2):
            other = log.rows[k, 1 + end]
            if other >= 0:
                value += log.weights[k, 2 * end] * x[other]
        x[log.rows[k, 0]] = value


@inner
def _settle(hi: float, lo: float, e: int) -> tuple[float, float, int]:
    """A scaled double-double made canonical."""
    m, exponent = _canonical(hi, e)
    if exponent != e:
        lo *= 2.0 ** (float(BITS) * (e - exponent))
    return m, lo, exponent


@inner
def _scaled_times(hi: float, lo: float, e: int, factor: float, factor_low: float) -> tuple[float, float, int]:
    p, q = _times(hi, lo, factor, factor_low)
    return _settle(p, q, e)


@inner
def _scaled_plus(hi: float, lo: float, e: int, t: float, t_low: float, te: int) -> tuple[float, float, int]:
    """Sum of two canonical scaled double-doubles, canonical; what lies 2**256 below the other is dropped."""
    if t == 0.0 or (hi != 0.0 and te < e - 1):
        return hi, lo, e
    if hi == 0.0 or te > e + 1:
        return t, t_low, te
    if te > e:
        hi, lo, e = hi * _INVERSE, lo * _INVERSE, te
    elif te < e:
        t, t_low = t * _INVERSE, t_low * _INVERSE
    s, s_low = _sum(hi, lo, t, t_low)
    return _settle(s, s_low, e)


@kernel
def forward_scaled(log: Log, hi: Floats, lo: Floats, e: Integers) -> None:
    """As `forward`, in scaled double-doubles (canonical on entry and on return)."""
    for k in range(len(log.rows)):
        row = log.rows[k, 0]
        if hi[row] == 0.0:
            continue
        for end in range(2):
            other = log.rows[k, 1 + end]
            if other >= 0:
                weight, low = log.weights[k, 2 * end], log.weights[k, 2 * end + 1]
                t, t_low, te = _scaled_times(hi[row], lo[row], e[row], weight, low)
                hi[other], lo[other], e[other] = _scaled_plus(hi[other], lo[other], e[other], t, t_low, te)


@kernel
def backward_scaled(log: Log, hi: Floats, lo: Floats, e: Integers) -> None:
    """As `backward`, in scaled double-doubles (canonical on entry and on return)."""
    for k in range(len(log.rows) - 1, -1, -1):
        row = log.rows[k, 0]
        v, v_low, ve = _scaled_times(hi[row], lo[row], e[row], log.weights[k, 4], log.weights[k, 5])
        for end in range(2):
            other = log.rows[k, 1 + end]
            if other >= 0:
                weight, low = log.weights[k, 2 * end], log.weights[k, 2 * end + 1]
                t, t_low, te = _scaled_times(hi[other], lo[other], e[other], weight, low)
                v, v_low, ve = _scaled_plus(v, v_low, ve, t, t_low, te)
        hi[row], lo[row], e[row] = v, v_low, ve
