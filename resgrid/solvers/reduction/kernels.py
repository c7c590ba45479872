"""Compiled loops of the exact reduction, in double-double and positive arithmetic only.

Rows live in the slots of the matrix they came from: row ``i`` owns ``start[i] ... start[i] + length[i] - 1``, and
``twin`` leads from a slot to the same conductance in the other row.  A row that gains a neighbour loses one at the same
time, so that no row ever needs more room, and every change takes constant time.

Numba takes seconds to import: only functions that are about to solve import this module.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.jit import inner
from resgrid.solvers.extended import BITS
from resgrid.solvers.extended_kernels import _canonical, _sum, _two_product

_INVERSE = 2.0**-BITS
_MOST_SEARCHED = 48
_LEAST_RATIO = 2.0**-200

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Indices = NDArray[np.int32]


class Web(NamedTuple):
    """A circuit that shrinks: conductances by rows, double-double, and what ties rows to rails.

    `start, length` (n,): first slot of every row, and how many of its slots are in use; `neighbour, twin` (slots,):
    the other row of a slot's conductance, and the slot there; `g, g_low` (slots,): conductances, in siemens; `excess,
    excess_low` (n,): conductance of every row to the rails, in siemens; `gone` (n,): rows that are eliminated.
    """

    start: Indices
    length: Indices
    neighbour: Indices
    twin: Indices
    g: Floats
    g_low: Floats
    excess: Floats
    excess_low: Floats
    gone: NDArray[np.bool_]


class Record(NamedTuple):
    """What elimination leaves behind, in the order of elimination.

    `rows` (n, 3): the eliminated row and its neighbours, -1 for none; `weights` (n, 6): ``g1 / d``, ``g2 / d`` and
    ``1 / d`` (1/S), double-double.
    """

    rows: Indices
    weights: Floats


@inner
def _plus(a: float, a_low: float, b: float, b_low: float) -> tuple[float, float]:
    return _sum(a, a_low, b, b_low)


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
    rest, _ = _plus(1.0, 0.0, -p, -q)
    return _plus(first, 0.0, rest / d, 0.0)


@njit(cache=True)
def find_twins(indptr: Indices, indices: Indices) -> Indices:
    """Slot of the transposed entry of every entry; the matrix is structurally symmetric, its rows sorted."""
    twin = np.empty(len(indices), np.int32)
    place = indptr[:-1].copy()
    for row in range(len(indptr) - 1):
        for k in range(indptr[row], indptr[row + 1]):
            twin[place[indices[k]]] = k
            place[indices[k]] += 1
    return twin


@inner
def _drop(web: Web, row: int, slot: int) -> None:
    """Take a slot out of a row: the row's last slot moves to its place."""
    last = web.start[row] + web.length[row] - 1
    if slot != last:
        web.neighbour[slot] = web.neighbour[last]
        web.twin[slot] = web.twin[last]
        web.g[slot] = web.g[last]
        web.g_low[slot] = web.g_low[last]
        web.twin[web.twin[slot]] = slot
    web.length[row] -= 1


@inner
def _find(web: Web, a: int, b: int) -> int:
    """Slot of a conductance between two rows, -1 for none, -2 if both rows are too long to be searched."""
    if web.length[a] > web.length[b]:
        a, b = b, a
    if web.length[a] > _MOST_SEARCHED:
        return -2
    for k in range(web.start[a], web.start[a] + web.length[a]):
        if web.neighbour[k] == b:
            return k
    return -1


@inner
def _assign(web: Web, slot: int, g: float, g_low: float) -> None:
    """Give a conductance its value, in both rows."""
    other = web.twin[slot]
    web.g[slot], web.g_low[slot] = g, g_low
    web.g[other], web.g_low[other] = g, g_low


@inner
def _join(web: Web, k: int, m: int, g: float, g_low: float) -> int:
    """Replace two conductances of a row, in slots ``k`` and ``m``, by one between their other ends.

    Returns how many slots either end has lost (0 or 1), or 2 if the two ends may now be joined twice.
    """
    a, b = web.neighbour[k], web.neighbour[m]
    there = _find(web, a, b)
    if there >= 0:
        s, t = _plus(web.g[there], web.g_low[there], g, g_low)
        _assign(web, there, s, t)
        _drop(web, a, web.twin[k])
        _drop(web, b, web.twin[m])
        return 1
    at_a, at_b = web.twin[k], web.twin[m]
    web.neighbour[at_a], web.neighbour[at_b] = b, a
    web.twin[at_a], web.twin[at_b] = at_b, at_a
    _assign(web, at_a, g, g_low)
    return 2 if there == -2 else 0


@inner
def _tie(web: Web, row: int, share: float, share_low: float, e: float, e_low: float) -> None:
    """Add a share of a conductance to the rails to a row."""
    t, t_low = _times(share, share_low, e, e_low)
    web.excess[row], web.excess_low[row] = _plus(web.excess[row], web.excess_low[row], t, t_low)


@inner
def _eliminate_row(web: Web, row: int, entry: Indices, weight: Floats) -> int:
    """Eliminate a row of at most two slots and record it.

    Returns -1 if it must stay, otherwise what `_join` says of its neighbours.
    """
    degree, k = web.length[row], web.start[row]
    a, b, m = -1, -1, k + 1
    g1, g1_low, g2, g2_low = 0.0, 0.0, 0.0, 0.0
    if degree > 0:
        a, g1, g1_low = web.neighbour[k], web.g[k], web.g_low[k]
    if degree > 1:
        b, g2, g2_low = web.neighbour[m], web.g[m], web.g_low[m]
    if degree > 1 and a == b:
        g1, g1_low = _plus(g1, g1_low, g2, g2_low)
        b, g2, g2_low = -1, 0.0, 0.0
    e, e_low = web.excess[row], web.excess_low[row]
    d, d_low = _plus(g1, g1_low, g2, g2_low)
    d, d_low = _plus(d, d_low, e, e_low)
    if (a >= 0 and g1 < _LEAST_RATIO * d) or (b >= 0 and g2 < _LEAST_RATIO * d) or not d > 0.0:
        return -1
    inverse, inverse_low = _reciprocal(d, d_low)
    w1, w1_low = _times(g1, g1_low, inverse, inverse_low)
    w2, w2_low = _times(g2, g2_low, inverse, inverse_low)
    entry[0], entry[1], entry[2] = row, a, b
    weight[0], weight[1], weight[2], weight[3], weight[4], weight[5] = w1, w1_low, w2, w2_low, inverse, inverse_low
    if e > 0.0 and a >= 0:
        _tie(web, a, w1, w1_low, e, e_low)
    if e > 0.0 and b >= 0:
        _tie(web, b, w2, w2_low, e, e_low)
    change = 1
    if b >= 0:
        g, g_low = _times(g1, g1_low, w2, w2_low)
        change = _join(web, k, m, g, g_low)
    else:
        for slot in range(k, k + degree):
            _drop(web, a, web.twin[slot])
    web.gone[row] = True
    web.length[row] = 0
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


@njit(cache=True)
def eliminate(web: Web, record: Record, count: int) -> tuple[int, int]:
    """Eliminate rows of at most two slots until none is left, leaves first; all in place.

    A row with conductances ``g1`` and ``g2`` to neighbours and excess ``e``, ``d = g1 + g2 + e``, leaves ``g1 g2 / d``
    between them and ties them to the rails by ``g1 e / d`` and ``g2 e / d`` (star-mesh transformation).  Every value is
    a sum, product or quotient of positive ones, so that each keeps its relative accuracy (Grassmann, Taksar &
    Heyman 1985; O'Cinneide 1993).  A row stays where ``g1 / d`` or ``g2 / d`` would fall below 2**-200.
    """
    n = len(web.start)
    leaves, pairs = np.empty(2 * n, np.int32), np.empty(n, np.int32)
    top, head, tail, doubled = 0, 0, 0, 0
    for row in range(n):
        if not web.gone[row]:
            top, tail = _queue(web.length[row], row, leaves, top, pairs, tail)
    while top > 0 or head < tail:
        if top > 0:
            top -= 1
            row = leaves[top]
        else:
            row = pairs[head]
            head += 1
        if web.gone[row] or web.length[row] > 2:
            continue
        change = _eliminate_row(web, row, record.rows[count], record.weights[count])
        if change < 0:
            continue
        if change == 2:
            doubled += 1
        for end in range(1, 3):
            other = record.rows[count, end]
            if other >= 0 and change == 1:
                top, tail = _queue(web.length[other], other, leaves, top, pairs, tail)
        count += 1
    return count, doubled


@njit(cache=True)
def merge_parallel(web: Web) -> None:
    """Merge conductances that join the same two rows, in place."""
    n = len(web.start)
    seen = np.full(n, -1, np.int32)
    for row in range(n):
        first = web.start[row]
        k = first
        while k < first + web.length[row]:
            other = web.neighbour[k]
            slot = seen[other]
            if first <= slot < k and web.neighbour[slot] == other:
                s, t = _plus(web.g[slot], web.g_low[slot], web.g[k], web.g_low[k])
                _assign(web, slot, s, t)
                _drop(web, other, web.twin[k])
                _drop(web, row, k)
                continue
            seen[other] = k
            k += 1


@njit(cache=True)
def pack(web: Web, number: Indices, indptr: Indices) -> tuple[Indices, Floats]:
    """Columns and conductances of the rows that are left, renumbered; ``number`` is -1 for the others."""
    indices = np.empty(indptr[-1], np.int32)
    conductance = np.empty(indptr[-1])
    for row in range(len(number)):
        if number[row] < 0:
            continue
        first = indptr[number[row]]
        for k in range(web.length[row]):
            slot = web.start[row] + k
            indices[first + k] = number[web.neighbour[slot]]
            conductance[first + k] = web.g[slot]
    return indices, conductance


@njit(cache=True, nogil=True)
def forward(record: Record, count: int, b: Floats) -> None:
    """Carry the currents of eliminated rows to their neighbours, in place; plain doubles."""
    for k in range(count):
        value = b[record.rows[k, 0]]
        for end in range(2):
            other = record.rows[k, 1 + end]
            if other >= 0:
                b[other] += record.weights[k, 2 * end] * value


@njit(cache=True, nogil=True)
def backward(record: Record, count: int, x: Floats) -> None:
    """Turn the currents of eliminated rows into their voltages, in place; plain doubles."""
    for k in range(count - 1, -1, -1):
        value = record.weights[k, 4] * x[record.rows[k, 0]]
        for end in range(2):
            other = record.rows[k, 1 + end]
            if other >= 0:
                value += record.weights[k, 2 * end] * x[other]
        x[record.rows[k, 0]] = value


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
    s, s_low = _plus(hi, lo, t, t_low)
    return _settle(s, s_low, e)


@njit(cache=True, nogil=True)
def forward_scaled(record: Record, count: int, hi: Floats, lo: Floats, e: Integers) -> None:
    """As `forward`, in scaled double-doubles (canonical on entry and on return)."""
    for k in range(count):
        row = record.rows[k, 0]
        if hi[row] == 0.0:
            continue
        for end in range(2):
            other = record.rows[k, 1 + end]
            if other >= 0:
                weight, low = record.weights[k, 2 * end], record.weights[k, 2 * end + 1]
                t, t_low, te = _scaled_times(hi[row], lo[row], e[row], weight, low)
                hi[other], lo[other], e[other] = _scaled_plus(hi[other], lo[other], e[other], t, t_low, te)


@njit(cache=True, nogil=True)
def backward_scaled(record: Record, count: int, hi: Floats, lo: Floats, e: Integers) -> None:
    """As `backward`, in scaled double-doubles (canonical on entry and on return)."""
    for k in range(count - 1, -1, -1):
        row = record.rows[k, 0]
        v, v_low, ve = _scaled_times(hi[row], lo[row], e[row], record.weights[k, 4], record.weights[k, 5])
        for end in range(2):
            other = record.rows[k, 1 + end]
            if other >= 0:
                weight, low = record.weights[k, 2 * end], record.weights[k, 2 * end + 1]
                t, t_low, te = _scaled_times(hi[other], lo[other], e[other], weight, low)
                v, v_low, ve = _scaled_plus(v, v_low, ve, t, t_low, te)
        hi[row], lo[row], e[row] = v, v_low, ve
