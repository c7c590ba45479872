"""Compiled passes of conjugate gradients over a netlist's rows, in the order of the first level."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.jit import FAST
from resgrid.solvers.multigrid.kernels import Floats, Singles, Stack, Unsigned

Indices = NDArray[np.int32]


@njit(cache=True, nogil=True)
def put_scaled(r: Floats, size: float, b: Singles) -> None:
    """``b = r / size``, in single precision."""
    scale = 1.0 / size
    for i in range(len(r)):
        b[i] = np.float32(r[i] * scale)


@njit(cache=True, nogil=True, fastmath=FAST)
def multiply(stack: Stack, leak: Floats, r: Floats, s: Floats, w: Floats) -> tuple[float, float, float]:
    """``w = A z`` over single conductances in double precision, differences first; ``z.r``, ``z.w`` and ``z.s``."""
    row, g, j, z = stack.indptr, stack.conductance, stack.indices, stack.x
    zr, zw, zs = 0.0, 0.0, 0.0
    for i in range(len(r)):
        zi = np.float64(z[i])
        total = leak[i] * zi
        for k in range(row[i], row[i + 1]):
            total += np.float64(g[k]) * (zi - np.float64(z[j[k]]))
        w[i] = total
        zr += zi * r[i]
        zw += zi * total
        zs += zi * s[i]
    return zr, zw, zs


@njit(cache=True, nogil=True, fastmath=FAST)
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
def put_in_order(order: Indices, b: Floats, r: Floats) -> float:
    """``r = b`` in the order of the first level; returns ``|r|``."""
    total = 0.0
    for place in range(len(order)):
        r[place] = b[order[place]]
        total += r[place] * r[place]
    return math.sqrt(total)


@njit(cache=True, nogil=True)
def residual_in_order(
    indptr: Unsigned, indices: Unsigned, conductance: Floats, excess: Floats, rank: Indices, b: Floats, x: Floats,
    r: Floats,
) -> float:  # fmt: skip
    """``r = b - A x``, differences first, every row put at its rank; returns ``|r|``."""
    total = 0.0
    for i in range(len(rank)):
        v = b[i] - excess[i] * x[i]
        for k in range(indptr[i], indptr[i + 1]):
            v += conductance[k] * (x[indices[k]] - x[i])
        r[rank[i]] = v
        total += v * v
    return math.sqrt(total)
