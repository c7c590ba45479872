"""Compiled loops of the multigrid solver: smoothing, the K-cycle, and the products of conjugate gradients.

A level is a graph of conductances in compressed rows (no diagonal) with a leak to the rails at every node.  All
levels stand one behind the other in flat arrays (`Stack`), so that the cycle can recurse in compiled code.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.jit import ZERO, inner, inner_fast

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Unsigned = NDArray[np.uint32]
"""Indices without a sign: compiled code need not ask whether one counts from the end."""

Integers = NDArray[np.int64]

_ONE, _TWO, _THREE, _FOUR, _FIVE = (np.uint32(k) for k in range(1, 6))


class Stack(NamedTuple):
    """All levels of a hierarchy; nodes of level ``l`` stand at ``first[l] ... first[l + 1]``.

    `first` (levels + 1,); `red` (levels,): where a level's first nodes and its others have no neighbours among
    themselves: behind the last of the first; elsewhere -1; `indptr` (nodes + 1,): row starts, in the entries of all
    levels; `middle` (nodes,): where in a row the nodes begin that come after it; `indices`: neighbours, counted in
    all levels; `conductance, inverse, diagonal`: of entries, and of the diagonal with its reciprocal; `aggregate`
    (nodes,): node of the next level that a node belongs to, counted in all levels; `eliminated` (levels + 1,): where
    a level's entries in ``removed`` begin; a level that has some is left by elimination, not aggregation; `removed`
    (eliminated, 3): eliminated nodes in their order, and their neighbours, counted in all levels; -1 for none;
    `share` (eliminated, 3): shares of the two neighbours, and the reciprocal of the diagonal; `coarsest`: inverse of
    the last level's matrix; empty where its diagonal must do; `order` (first[1],): node of the given graph that
    stands at each place of the first level; `b, x, c, v, w, kept` (nodes,): work space.
    """

    first: Integers
    red: Integers
    indptr: Unsigned
    middle: Unsigned
    indices: Unsigned
    conductance: Singles
    inverse: Singles
    diagonal: Singles
    aggregate: Unsigned
    eliminated: Integers
    removed: Integers
    share: Singles
    coarsest: Singles
    order: NDArray[np.int32]
    b: Singles
    x: Singles
    c: Singles
    v: Singles
    w: Singles
    kept: Singles


@inner
def _drawn(stack: Stack, x: Singles, i: int) -> Any:
    """``sum_j g_ij x_j``; most rows of a plane and of a volume have four and six neighbours, and need no loop."""
    g, j = stack.conductance, stack.indices
    k, end = stack.indptr[i], stack.indptr[i + 1]
    if end - k == 4:
        return _four(g, j, x, k)
    if end - k == 6:
        return _four(g, j, x, k) + (g[k + _FOUR] * x[j[k + _FOUR]] + g[k + _FIVE] * x[j[k + _FIVE]])
    s = np.float32(0.0)
    for m in range(k, end):
        s += g[m] * x[j[m]]
    return s


@inner
def _four(g: Singles, j: Unsigned, x: Singles, k: np.uint32) -> Any:
    return (g[k] * x[j[k]] + g[k + _ONE] * x[j[k + _ONE]]) + (
        g[k + _TWO] * x[j[k + _TWO]] + g[k + _THREE] * x[j[k + _THREE]]
    )


@inner
def _descend(stack: Stack, level: int) -> None:
    """Gauss-Seidel from zero, and the residual summed into the next level's right-hand side."""
    end = stack.first[level + 1]
    for node in range(end, stack.first[level + 2]):
        stack.b[node] = 0.0
    if stack.red[level] >= 0:
        _descend_by_colour(stack, stack.first[level], stack.red[level], end)
    else:
        _descend_in_order(stack, stack.first[level], end)


@inner_fast
def _descend_by_colour(stack: Stack, begin: int, red: int, end: int) -> None:
    """Red, then black: what is left is at red nodes, and due to black ones."""
    b, x = stack.b, stack.x
    for i in range(begin, red):
        x[i] = b[i] * stack.inverse[i]
    for i in range(red, end):
        x[i] = (b[i] + _drawn(stack, x, i)) * stack.inverse[i]
    for i in range(begin, red):
        b[stack.aggregate[i]] += _drawn(stack, x, i)


@inner
def _descend_in_order(stack: Stack, begin: int, end: int) -> None:
    """Forward: after the sweep row ``i`` lacks only its later neighbours, its residual is ``sum_{j > i} g_ij x_j``.

    Loops run over parts of arrays from zero on: a counter that is never negative needs no check.
    """
    g, j, b, x = stack.conductance, stack.indices, stack.b, stack.x
    row, middle = stack.indptr[begin : end + 1], stack.middle[begin:end]
    own, mine, inverse, aggregate = x[begin:end], b[begin:end], stack.inverse[begin:end], stack.aggregate[begin:end]
    for i in range(len(own)):
        s = np.float32(0.0)
        for k in range(row[i], middle[i]):
            s += g[k] * x[j[k]]
        own[i] = (mine[i] + s) * inverse[i]
    for i in range(len(own)):
        s = np.float32(0.0)
        for k in range(middle[i], row[i + 1]):
            s += g[k] * x[j[k]]
        b[aggregate[i]] += s


@inner
def _ascend(stack: Stack, level: int) -> None:
    """Add the next level's answer, then Gauss-Seidel in the reverse order."""
    begin, end = stack.first[level], stack.first[level + 1]
    if stack.red[level] >= 0:
        _ascend_by_colour(stack, begin, stack.red[level], end)
    else:
        _ascend_in_order(stack, begin, end)


@inner_fast
def _ascend_by_colour(stack: Stack, begin: int, red: int, end: int) -> None:
    b, x = stack.b, stack.x
    for i in range(begin, red):
        x[i] += x[stack.aggregate[i]]
    for i in range(red, end):
        x[i] = (b[i] + _drawn(stack, x, i)) * stack.inverse[i]
    for i in range(begin, red):
        x[i] = (b[i] + _drawn(stack, x, i)) * stack.inverse[i]


@inner
def _ascend_in_order(stack: Stack, begin: int, end: int) -> None:
    """Backward; ``w`` keeps the changes."""
    g, j, x = stack.conductance, stack.indices, stack.x
    own, mine, inverse, change = x[begin:end], stack.b[begin:end], stack.inverse[begin:end], stack.w[begin:end]
    aggregate, row, after = stack.aggregate[begin:end], stack.indptr[begin:end], stack.indptr[begin + 1 : end + 1]
    n = len(own)
    for i in range(n):
        own[i] += x[aggregate[i]]
    for back in range(n):
        at = np.uint32(n - 1 - back)
        s = np.float32(0.0)
        for k in range(row[at], after[at]):
            s += g[k] * x[j[k]]
        new = (mine[at] + s) * inverse[at]
        change[at] = new - own[at]
        own[at] = new


@inner
def _multiply_after(stack: Stack, begin: int, end: int, y: Singles) -> float:
    """``y = A x`` behind the way up; returns ``x . y``.

    What the backward sweep leaves over of a row is due to the changes of earlier rows, which came after it.
    """
    g, j, change = stack.conductance, stack.indices, stack.w
    own, mine, out = stack.x[begin:end], stack.b[begin:end], y[begin:end]
    row, middle = stack.indptr[begin:end], stack.middle[begin:end]
    n, total = len(own), 0.0
    for back in range(n):
        at = np.uint32(n - 1 - back)
        s = np.float32(0.0)
        for k in range(row[at], middle[at]):
            s += g[k] * change[j[k]]
        out[at] = mine[at] - s
        total += np.float64(own[at]) * np.float64(out[at])
    return total


@inner_fast
def _multiply(stack: Stack, level: int, y: Singles) -> float:
    """``y = A x`` on one level, behind the way up; returns ``x . y``."""
    begin, end = stack.first[level], stack.first[level + 1]
    if stack.red[level] < 0:
        return _multiply_after(stack, begin, end, y)
    for i in range(begin, end):
        y[i] = stack.diagonal[i] * stack.x[i] - _drawn(stack, stack.x, i)
    return _dot(stack.x, y, begin, end)


@inner_fast
def _dot(a: Singles, b: Singles, begin: int, end: int) -> float:
    total = 0.0
    for i in range(begin, end):
        total += np.float64(a[i]) * np.float64(b[i])
    return total


@inner
def _solve_coarsest(stack: Stack, level: int) -> None:
    """The inverse times the right-hand side, row after row of the symmetric inverse; without one, of the diagonal."""
    begin, end = stack.first[level], stack.first[level + 1]
    b, x = stack.b[begin:end], stack.x[begin:end]
    inverse, whole = stack.inverse[begin:end], len(stack.coarsest) > 0
    for i in range(len(x)):
        x[i] = 0.0 if whole else b[i] * inverse[i]
    for j in range(len(stack.coarsest)):
        row, value = stack.coarsest[j], b[j]
        for i in range(len(x)):
            x[i] += row[i] * value


@inner_fast
def _first_step(stack: Stack, level: int, stop: float, energy: Floats, alpha: Floats) -> bool:
    """First step of the K-cycle along ``c = x``; returns whether it suffices (``x`` is then the answer)."""
    begin, end = stack.first[level], stack.first[level + 1]
    b, x, c = stack.b[begin:end], stack.x[begin:end], stack.c[begin:end]
    v, kept = stack.v[begin:end], stack.kept[begin:end]
    energy[level] = _multiply(stack, level, stack.v)
    size, along = 0.0, 0.0
    for i in range(len(b)):
        c[i] = x[i]
        kept[i] = b[i]
        along += np.float64(x[i]) * np.float64(b[i])
        size += np.float64(b[i]) * np.float64(b[i])
    alpha[level] = along
    if not energy[level] > 0.0:
        return True
    step, rest = np.float32(along / energy[level]), 0.0
    for i in range(len(b)):
        b[i] -= step * v[i]
        rest += np.float64(b[i]) * np.float64(b[i])
    if rest > stop * stop * size:
        return False
    for i in range(len(b)):
        x[i] = step * c[i]
        b[i] = kept[i]
    return True


@inner_fast
def _second_step(stack: Stack, level: int, energy: float, alpha: float) -> None:
    """Second step of the K-cycle along ``x``, made conjugate to the first direction ``c``."""
    begin, end = stack.first[level], stack.first[level + 1]
    b, x, c = stack.b[begin:end], stack.x[begin:end], stack.c[begin:end]
    v, kept = stack.v[begin:end], stack.kept[begin:end]
    beta, gamma, rest = _multiply(stack, level, stack.w), 0.0, 0.0
    for i in range(len(b)):
        gamma += np.float64(x[i]) * np.float64(v[i])
        rest += np.float64(x[i]) * np.float64(b[i])
    second = beta - gamma * gamma / energy
    on_c, on_x = np.float32(alpha / energy), np.float32(0.0)
    if second > 0.0:
        on_c = np.float32(alpha / energy - gamma * rest / (energy * second))
        on_x = np.float32(rest / second)
    for i in range(len(b)):
        x[i] = on_c * c[i] + on_x * x[i]
        b[i] = kept[i]


@inner
def _carry(stack: Stack, level: int) -> None:
    """Carry the currents of eliminated nodes to their neighbours, and those of the others to the next level."""
    b, x = stack.b, stack.x
    for i in range(stack.first[level], stack.first[level + 1]):
        x[i] = b[i]
    for k in range(stack.eliminated[level], stack.eliminated[level + 1]):
        for end in range(2):
            if stack.removed[k, 1 + end] >= 0:
                x[stack.removed[k, 1 + end]] += stack.share[k, end] * x[stack.removed[k, 0]]
    for i in range(stack.first[level], stack.first[level + 1]):
        if stack.aggregate[i] > i:
            b[stack.aggregate[i]] = x[i]


@inner
def _put_back(stack: Stack, level: int) -> None:
    """Voltages of the nodes that stayed, then of those that were eliminated."""
    x = stack.x
    for i in range(stack.first[level], stack.first[level + 1]):
        if stack.aggregate[i] > i:
            x[i] = x[stack.aggregate[i]]
    for k in range(stack.eliminated[level + 1] - 1, stack.eliminated[level] - 1, -1):
        value = stack.share[k, 2] * x[stack.removed[k, 0]]
        for end in range(2):
            if stack.removed[k, 1 + end] >= 0:
                value += stack.share[k, end] * x[stack.removed[k, 1 + end]]
        x[stack.removed[k, 0]] = value


@njit(cache=True, nogil=True)
def cycle(stack: Stack, stop: float, first: int) -> None:
    """Approximate ``x = A^-1 b`` on the first level, by K-cycles from level ``first`` on (Notay & Vassilevski 2008).

    The K-cycle takes one or two steps of flexible conjugate gradients, each preconditioned by the cycle below; the
    second is spared where the first has brought the residual under ``stop`` times the right-hand side.  The recursion
    is written as a loop, since compiled recursive functions cannot be kept on disk.
    """
    last = len(stack.first) - 2
    visits = np.zeros(last + 1, np.int64)
    energy, alpha = np.zeros(last + 1), np.zeros(last + 1)
    level = ZERO
    while level >= 0:
        if level == last:
            _solve_coarsest(stack, level)
            level -= 1
            continue
        if stack.eliminated[level + 1] > stack.eliminated[level]:
            if visits[level] == 0:
                _carry(stack, level)
                visits[level] = 1
                level += 1
            else:
                _put_back(stack, level)
                visits[level] = 0
                level -= 1
            continue
        if visits[level] > 0:
            _ascend(stack, level)
        done = False
        if visits[level] == 1:
            done = level < first or _first_step(stack, level, stop, energy, alpha)
        elif visits[level] == 2:
            _second_step(stack, level, energy[level], alpha[level])
            done = True
        if done:
            visits[level] = 0
            level -= 1
        else:
            visits[level] += 1
            _descend(stack, level)
            level += 1


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"})
def norm(x: Floats) -> float:
    """Euclidean norm, on one thread."""
    total = 0.0
    for i in range(len(x)):
        total += x[i] * x[i]
    return math.sqrt(total)
