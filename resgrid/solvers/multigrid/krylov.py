"""The compiled parts of a step of conjugate gradients, and what leads from rows to the slots where they stand and back.

Indices without a sign need not be asked whether they count from the end.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.jit import FAST

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Indices = NDArray[np.int32]
Unsigned = NDArray[np.uint32]


@njit(cache=True, nogil=True)
def scatter_rows(slot: Indices, values: Floats, factor: float, at_slots: Floats) -> None:
    """Write ``factor`` times the values of all rows to their slots."""
    for k in range(len(values)):
        at_slots[np.uint32(slot[k])] = factor * values[k]


@njit(cache=True, nogil=True)
def gather_rows(slot: Indices, at_slots: Floats) -> Floats:
    """The values of all rows."""
    values = np.empty(len(slot))
    for k in range(len(values)):
        values[k] = at_slots[np.uint32(slot[k])]
    return values


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"})
def norm(x: Floats) -> float:
    """Euclidean norm, on one thread."""
    total = 0.0
    for i in range(len(x)):
        total += x[i] * x[i]
    return math.sqrt(total)


@njit(cache=True, nogil=True)
def row_residual(
    indptr: Unsigned, indices: Unsigned, conductance: Floats, ground: Floats, slot: Indices, b: Floats, x: Floats,
    r: Floats,
) -> float:  # fmt: skip
    """``r = b - A x``, differences first, every row put at its slot; ``b, x`` (n,) by rows; returns ``|r|``."""
    total = 0.0
    for i in range(len(slot)):
        v = b[i] - ground[i] * x[i]
        for k in range(indptr[i], indptr[i + 1]):
            v += conductance[k] * (x[indices[k]] - x[i])
        r[slot[i]] = v
        total += v * v
    return math.sqrt(total)


@njit(cache=True, nogil=True)
def begin(residual: Floats, one: float, inverse: Singles, r: Singles, z: Singles) -> None:
    """``r = residual / one``, and ``z = inverse r``; ``residual`` may lie where later ``z`` will stand."""
    for k in range(len(r)):
        r[k] = residual[k] / one
        z[k] = inverse[k] * r[k]


@njit(cache=True, nogil=True, fastmath=FAST)
def advance(inverse: Singles, w: Singles, s: Singles, r: Singles, z: Singles, beta: float, alpha: float) -> float:
    """``s = w + beta s``, ``r -= alpha s``, ``z = inverse r``; returns ``|r|``."""
    total = 0.0
    for k in range(len(r)):
        product = w[k] + beta * s[k]
        s[k] = product
        new = np.float32(r[k] - alpha * product)
        r[k] = new
        z[k] = inverse[k] * new
        total += np.float64(new) * np.float64(new)
    return math.sqrt(total)


@njit(cache=True, nogil=True, fastmath=FAST)
def add_steps(z: Singles, on_x: Floats, on_p: Floats, one: float, p: Floats, x: Floats) -> None:
    """``x += one (before_x p + sum_j on_x_j z_j)``, then ``p`` the same with ``on_p``; ``z`` (steps, n).

    The shares of what was before, ``p``, stand last in ``on_x`` and ``on_p``.
    """
    before_x, before_p = on_x[-1], on_p[-1]
    for k in range(len(x)):
        ahead, far = before_p * p[k], before_x * p[k]
        for j in range(len(z)):
            value = np.float64(z[j, k])
            ahead += on_p[j] * value
            far += on_x[j] * value
        p[k] = ahead
        x[k] += one * far


@njit(cache=True, nogil=True)
def largest_step(z: Singles, on_p: Floats, p: Floats) -> float:
    """Largest entry of the direction, as of `add_steps`."""
    most = 0.0
    for k in range(len(p)):
        ahead = on_p[-1] * p[k]
        for j in range(len(z)):
            ahead += on_p[j] * z[j, k]
        most = max(most, abs(ahead))
    return most
