"""The compiled steps of conjugate gradients, and what leads from rows to the slots where they stand and back.

Indices without a sign need not be asked whether they count from the end.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.jit import inner, inner_fast
from resgrid.solvers.multigrid.cycle import Finest, Levels, precondition

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Indices = NDArray[np.int32]
Unsigned = NDArray[np.uint32]

_BURST = 1e-5
"""Gain of a burst from its largest residual on: vectors in single precision allow no more."""

_ENOUGH = 0.07
"""Residual after the first step of a K-cycle on the first coarse level that spares the second."""


class Vectors(NamedTuple):
    """The vectors of a burst: its residual has the norm ``lift`` when it begins.

    `inverse` (slots,): of the diagonal; `r, s, w` (slots,): residual, ``A p`` and ``A z``; `z` (depth, slots):
    preconditioned residuals that are not yet part of the answer; `p` (slots,): direction before them; `on_x, on_p`
    (depth + 1,): their shares in the answer and in the direction, and, last, those of ``p``; `scalars` (6,): number of
    the ``z``; ``p . A p``; norms of the residual, now and at most, in units of what the burst began with; the last
    step's length, and ``z . r`` times that.
    """

    inverse: Singles
    r: Singles
    s: Singles
    w: Singles
    z: Singles
    p: Floats
    on_x: Floats
    on_p: Floats
    scalars: Floats


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
def begin_burst(v: Vectors, one: float, residual: Floats) -> None:
    """``r = residual / one``, and ``z = inverse r``; ``residual`` may lie where the last ``z`` will stand."""
    _begin(v, one, residual)


@inner
def _begin(v: Vectors, one: float, residual: Floats) -> None:
    for k in range(len(v.r)):
        v.r[k] = residual[k] / one
        v.z[0, k] = v.inverse[k] * v.r[k]
    v.scalars[2], v.scalars[3] = 1.0, 1.0


@njit(cache=True, nogil=True)
def step(
    finest: Finest, levels: Levels, v: Vectors, x: Floats, residual: Floats, unit: tuple[float, float], gain: float,
    most: int,
) -> int:  # fmt: skip
    """``p = z + beta p``, ``x += alpha p``, ``r -= alpha A p``, ``z`` about ``A^-1 r``; returns how often.

    At most so many steps are taken, until the residual has gained.  ``unit``: what the vectors' one stands for, and
    the norm of ``r`` in the beginning; ``residual``: as of `begin_burst`, where a whole burst is taken; else empty.
    """
    one, lift = unit
    if len(residual) > 0:
        _begin(v, one, residual)
    energy, peak, steps = v.scalars[1], v.scalars[3], 0
    while v.scalars[2] > max(gain, _BURST * peak) and steps < most:
        count = int(v.scalars[0])
        zr, zw, zs = precondition(finest, levels, _ENOUGH, v.r, v.s, v.z[count], v.w)
        beta = -zs / energy if energy > 0.0 else 0.0
        energy = zw + beta * zs
        v.scalars[1] = energy
        if not energy > 0.0:
            break
        alpha = zr / energy
        for k in range(len(v.on_p)):
            v.on_p[k] *= beta
        v.on_p[count] = 1.0
        for k in range(len(v.on_p)):
            v.on_x[k] += alpha * v.on_p[k]
        v.scalars[0] = count + 1
        if count + 1 == len(v.z):
            _gather(v, x, one)
        v.scalars[2] = math.sqrt(_advance(v.inverse, v.w, v.s, v.r, v.z[int(v.scalars[0])], beta, alpha)) / lift
        peak = max(peak, v.scalars[2])
        v.scalars[3], v.scalars[4], v.scalars[5] = peak, alpha, alpha * zr
        steps += 1
    if len(residual) > 0:
        _gather(v, x, one)
    return steps


@inner_fast
def _advance(inverse: Singles, w: Singles, s: Singles, r: Singles, z: Singles, beta: float, alpha: float) -> float:
    """``s = w + beta s``, ``r -= alpha s``, ``z = inverse r``; returns ``|r|^2``."""
    total = 0.0
    for k in range(len(r)):
        product = w[k] + beta * s[k]
        s[k] = product
        new = np.float32(r[k] - alpha * product)
        r[k] = new
        z[k] = inverse[k] * new
        total += np.float64(new) * np.float64(new)
    return total


@njit(cache=True, nogil=True)
def gather_steps(v: Vectors, x: Floats, one: float) -> None:
    """Go the steps noted: they become part of ``x``, in units of ``one``."""
    _gather(v, x, one)


@inner
def _gather(v: Vectors, x: Floats, one: float) -> None:
    count = int(v.scalars[0])
    _add_steps(v.z[:count], v.on_x, v.on_x[-1], v.on_p, v.on_p[-1], one, v.p, x)
    v.on_x[:], v.on_p[:] = 0.0, 0.0
    v.on_p[-1] = 1.0
    v.scalars[0] = 0.0


@inner_fast
def _add_steps(
    z: Singles, on_x: Floats, before_x: float, on_p: Floats, before_p: float, one: float, p: Floats, x: Floats
) -> None:
    """``x += one (before_x p + sum_j on_x_j z_j)``, then ``p = before_p p + sum_j on_p_j z_j``; ``z`` (steps, n)."""
    for k in range(len(x)):
        ahead, far = before_p * p[k], before_x * p[k]
        for j in range(len(z)):
            value = np.float64(z[j, k])
            ahead += on_p[j] * value
            far += on_x[j] * value
        p[k] = ahead
        x[k] += one * far


@njit(cache=True, nogil=True)
def largest_step(v: Vectors) -> float:
    """Largest entry of the last direction."""
    most, count = 0.0, int(v.scalars[0])
    for k in range(len(v.p)):
        ahead = v.on_p[-1] * v.p[k]
        for j in range(count):
            ahead += v.on_p[j] * v.z[j, k]
        most = max(most, abs(ahead))
    return most
