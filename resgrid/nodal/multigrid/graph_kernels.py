"""Compiled passes of conjugate gradients over a netlist's rows, in the order of the first level."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.nodal.multigrid.kernels import Floats, Singles, Stack, Unsigned, cycle, descend

Indices = NDArray[np.int32]

_FAST = {"contract", "reassoc", "nsz", "arcp"}
_ENOUGH = 0.25
"""Residual after the first step of a K-cycle that spares the second."""


@njit(cache=True, nogil=True)
def row_degrees(stack: Stack, leak: Floats) -> Floats:
    """Diagonal of the first level, as its single conductances and true leaks make it."""
    row, g = stack.indptr, stack.conductance
    degree = np.empty(len(leak))
    for i in range(len(leak)):
        total = leak[i]
        for k in range(row[i], row[i + 1]):
            total += np.float64(g[k])
        degree[i] = total
    return degree


@njit(cache=True, nogil=True)
def precondition(
    stack: Stack, leak: Floats, degree: Floats, r: Floats, size: float, s: Floats, w: Floats, change: Floats
) -> tuple[float, float, float]:
    """``z = cycle(r / size)`` into ``stack.x``, and ``w = A z``; returns ``z.r``, ``z.w`` and ``z.s``.

    The first level's way up is done in double precision, differences first.  What it leaves over of a row is due to
    the rows behind it alone, which makes ``A z`` half a product (after Eisenstat 1981).
    """
    n = len(r)
    b, scale = stack.b[:n], 1.0 / size
    for i in range(n):
        b[i] = np.float32(r[i] * scale)
    if len(stack.first) == 2:
        cycle(stack, _ENOUGH, 1, 0)
        change[:] = 0.0
        _multiply(stack, leak, w)
    else:
        descend(stack, 0)
        cycle(stack, _ENOUGH, 1, 1)
        _ascend_in_double(stack, leak, degree, w, change)
    return _finish_product(stack, change, r, s, w)


@njit(cache=True)
def _ascend_in_double(stack: Stack, leak: Floats, degree: Floats, w: Floats, change: Floats) -> None:
    """Add the next level's answer, then Gauss-Seidel backward; ``w`` is ``A x`` but for what ``change`` makes later."""
    n = len(leak)
    g, j, x = stack.conductance, stack.indices, stack.x
    own, b, inverse, aggregate = x[:n], stack.b[:n], stack.inverse[:n], stack.aggregate[:n]
    row, after = stack.indptr[:n], stack.indptr[1 : n + 1]
    for i in range(n):
        own[i] += x[aggregate[i]]
    for back in range(n):
        at = np.uint32(n - 1 - back)
        before = np.float64(own[at])
        left = np.float64(b[at]) - leak[at] * before
        for k in range(row[at], after[at]):
            left += np.float64(g[k]) * (np.float64(x[j[k]]) - before)
        own[at] = np.float32(before + left * np.float64(inverse[at]))
        change[at] = np.float64(own[at]) - before
        w[at] = np.float64(b[at]) - left + degree[at] * change[at]


@njit(cache=True)
def _multiply(stack: Stack, leak: Floats, w: Floats) -> None:
    row, g, j, z = stack.indptr, stack.conductance, stack.indices, stack.x
    for i in range(len(leak)):
        zi = np.float64(z[i])
        total = leak[i] * zi
        for k in range(row[i], row[i + 1]):
            total += np.float64(g[k]) * (zi - np.float64(z[j[k]]))
        w[i] = total


@njit(cache=True, fastmath=_FAST)
def _finish_product(stack: Stack, change: Floats, r: Floats, s: Floats, w: Floats) -> tuple[float, float, float]:
    """Take what later changes of earlier rows add; returns ``z.r``, ``z.w`` and ``z.s``."""
    row, middle, g, j, z = stack.indptr, stack.middle, stack.conductance, stack.indices, stack.x
    zr, zw, zs = 0.0, 0.0, 0.0
    for i in range(len(w)):
        total = w[i]
        for k in range(row[i], middle[i]):
            total -= np.float64(g[k]) * change[j[k]]
        w[i] = total
        zi = np.float64(z[i])
        zr += zi * r[i]
        zw += zi * total
        zs += zi * s[i]
    return zr, zw, zs


@njit(cache=True, nogil=True, fastmath=_FAST)
def advance(z: Singles, w: Floats, p: Floats, s: Floats, x: Floats, r: Floats, beta: float, alpha: float) -> float:
    """One step of flexible conjugate gradients: ``p = z + beta p``, ``x += alpha p``, ``r -= alpha A p``; ``|r|^2``."""
    total = 0.0
    for i in range(len(r)):
        p[i] = z[i] + beta * p[i]
        s[i] = w[i] + beta * s[i]
        x[i] += alpha * p[i]
        r[i] -= alpha * s[i]
        total += r[i] * r[i]
    return total


@njit(cache=True, nogil=True)
def add_in_order(order: Indices, correction: Floats, scale: float, x: Floats) -> None:
    """Add ``scale`` times a correction, which stands in the order of the first level."""
    for place in range(len(order)):
        x[order[place]] += scale * correction[place]


@njit(cache=True, nogil=True)
def residual_in_order(
    indptr: Unsigned, indices: Unsigned, conductance: Floats, excess: Floats, order: Indices, b: Floats, x: Floats,
    r: Floats,
) -> float:  # fmt: skip
    """``r = b - A x`` in the order of the first level, differences first; returns ``|r|``."""
    total = 0.0
    for place in range(len(order)):
        i = order[place]
        v = b[i] - excess[i] * x[i]
        for k in range(indptr[i], indptr[i + 1]):
            v += conductance[k] * (x[indices[k]] - x[i])
        r[place] = v
        total += v * v
    return math.sqrt(total)
