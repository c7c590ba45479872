"""Compiled loops of the read-off: from scaled node values to currents and their balance.

Where ``plain``, all exponents are 0: they are not looked at, and arrays of resistors' exponents may be empty.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.jit import inlined
from resgrid.solvers.extended_kernels import Floats, Integers, _canonical, _shift, _sum, _two_sum

Indices = NDArray[np.int32]
Bools = NDArray[np.bool_]


@njit(cache=True)
def from_one_rail(
    row: Indices, known: Floats, zero: float, volts: float,
    hi: Floats, lo: Floats, e: Integers,
    out: Floats, out_low: Floats, out_e: Integers,
) -> None:  # fmt: skip
    """Spread the values of rows over nodes; known voltages are converted to ``volts`` above ``zero``, NaN to 0."""
    for node in range(len(row)):
        i = row[node]
        if i >= 0:
            out[node], out_low[node], out_e[node] = hi[i], lo[i], e[i]
        elif not math.isnan(known[node]):
            out[node] = (known[node] - zero) / volts


@njit(cache=True)
def from_nearer_rail(
    row: Indices, known: Floats, low: float, high: float,
    drop: Floats, drop_low: Floats, drop_e: Integers,
    height: Floats, height_low: Floats, height_e: Integers,
    out: Floats, out_low: Floats, out_e: Integers, down: Bools,
) -> None:  # fmt: skip
    """Spread the values of rows over nodes, each counted from the nearer rail: ``down`` from the high one, or up.

    Without heights (an empty array) they are what is left of the drops.
    """
    for node in range(len(row)):
        i = row[node]
        if i >= 0:
            if drop_e[i] < 0 or drop[i] <= 0.5:
                out[node], out_low[node], out_e[node], down[node] = drop[i], drop_low[i], drop_e[i], True
            elif len(height):
                out[node], out_low[node], out_e[node] = height[i], height_low[i], height_e[i]
            else:
                out[node], out_low[node] = _sum(1.0, 0.0, -drop[i], -drop_low[i])
        elif not math.isnan(known[node]):
            above, below = (known[node] - low) / (high - low), (high - known[node]) / (high - low)
            down[node] = abs(below) < abs(above)
            out[node] = below if down[node] else above


@inlined
def _fall(
    a: float, a_low: float, a_down: bool, b: float, b_low: float, b_down: bool, noise: float, noise_down: float
) -> float:
    """How far the potential falls from one node to the other; 0 where that is noise."""
    if a_down == b_down:
        d = (a - b) + (a_low - b_low)
        if abs(d) <= (noise_down if a_down else noise) * max(abs(a), abs(b)):
            return 0.0
        return -d if a_down else d
    # The one lies phi above the low rail, the other u below the high one: (phi + u) - 1.
    s, t = _two_sum(a, b)
    d = (s - 1.0) + (t + (a_low + b_low))
    if abs(d) <= 0.5 * noise:
        return 0.0
    return -d if a_down else d


@njit(cache=True)
def currents(
    pairs: Indices, conductance: Floats,
    hi: Floats, lo: Floats, e: Integers, down: Bools,
    volts: float, noise: float, noise_down: float, plain: bool,
    amps: Floats, exponent: Integers,
) -> float:  # fmt: skip
    """Currents of resistors, scaled; returns the power in doubles."""
    power = 0.0
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        if plain:
            fall = _fall(hi[a], lo[a], down[a], hi[b], lo[b], down[b], noise, noise_down) * volts
            amps[k] = conductance[k] * fall
            power += amps[k] * fall
            continue
        top = _pair_exponent(hi[a], e[a], hi[b], e[b]) if down[a] == down[b] else 0
        near, near_low = _shift(hi[a], e[a] - top), _shift(lo[a], e[a] - top)
        far, far_low = _shift(hi[b], e[b] - top), _shift(lo[b], e[b] - top)
        fall = _fall(near, near_low, down[a], far, far_low, down[b], noise, noise_down) * volts
        amps[k], exponent[k] = _canonical(conductance[k] * fall, top)
        power += _shift(_shift(conductance[k] * fall * fall, top), top)
    return power


@inlined
def _pair_exponent(a: float, a_e: int, b: float, b_e: int) -> int:
    if a == 0.0:
        return b_e
    return a_e if b == 0.0 else max(a_e, b_e)


@njit(cache=True)
def frames(pairs: Indices, amps: Floats, exponent: Integers, frame: Integers) -> None:
    """Raise every node's exponent to that of the largest current there, in place."""
    for k in range(len(pairs)):
        if amps[k] != 0.0:
            for end in range(2):
                node = pairs[k, end]
                frame[node] = max(frame[node], exponent[k])


@njit(cache=True)
def add_currents(
    pairs: Indices, amps: Floats, exponent: Integers, frame: Integers, plain: bool, net: Floats, total: Floats
) -> None:
    """Add resistors' currents to the net current into every node, and their magnitudes to the total, in place."""
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        out = amps[k] if plain else _shift(amps[k], exponent[k] - frame[a])
        into = amps[k] if plain else _shift(amps[k], exponent[k] - frame[b])
        net[a] -= out
        net[b] += into
        total[a] += abs(out)
        total[b] += abs(into)


@njit(cache=True)
def drop_unresolved(
    pairs: Indices, amps: Floats, exponent: Integers, frame: Integers, plain: bool, net: Floats, through: Floats,
    stored: Floats, sign: float, harmless: float,
) -> None:  # fmt: skip
    """Set currents to 0 along which ``sign * stored`` does not fall, and that are small at both ends, in place.

    Where nothing is stored, as beyond both rails, nothing is said of currents.

    ``through`` is half the sum of magnitudes at a node, of which ``harmless`` is small.
    """
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        falls = sign * (stored[a] - stored[b])
        if amps[k] == 0.0 or math.isnan(falls) or (amps[k] > 0.0 and falls > 0.0) or (amps[k] < 0.0 and falls < 0.0):
            continue
        out = amps[k] if plain else _shift(amps[k], exponent[k] - frame[a])
        into = amps[k] if plain else _shift(amps[k], exponent[k] - frame[b])
        if abs(out) <= harmless * through[a] and abs(into) <= harmless * through[b]:
            net[a] += out
            net[b] -= into
            through[a] -= 0.5 * abs(out)
            through[b] -= 0.5 * abs(into)
            amps[k] = 0.0
