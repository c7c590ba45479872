"""Compiled loops over a netlist: connected parts, then currents and their balance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.jit import inlined, kernel
from resgrid.solvers.csr_kernels import find
from resgrid.solvers.scaled import Floats, Indices, Integers, Scaled
from resgrid.solvers.scaled_kernels import _canonical, _shift, _sum, _two_product, _two_sum

Bools = NDArray[np.bool_]

_NOTHING = 1e-30
"""Difference of two double-doubles, relative to them, that is rounding."""


@kernel
def join_parts(pairs: Indices, part: Indices, contacts: Indices) -> int:
    """Join the nodes that resistors or floating sources connect, in place; nodes marked -1 join nothing.

    Pairs with just one node marked are noted as ``contacts``, for which there is room; returns how many there are.
    """
    count = 0
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        a, b = part[i], part[j]
        if a >= 0 and b >= 0:
            if a != b:
                # As `join`, a call of which takes as long as all of this.
                a, b = find(part, a), find(part, b)
                part[max(a, b)] = part[i] = part[j] = min(a, b)
        elif a >= 0 or b >= 0:
            contacts[count] = k
            count += 1
    return count


@kernel
def number_parts(part: Indices) -> int:
    """Turn a union-find into the number of every node's part, in place; returns how many parts there are.

    A node's parent comes before it, and has its number by then.
    """
    number = 0
    for node in range(len(part)):
        if part[node] == node:
            part[node] = number
            number += 1
        elif part[node] >= 0:
            part[node] = part[part[node]]
    return number


@inlined
def _close_component(pairs: Indices, last: int, root: int, edges: Integers, top: int, currentless: Bools) -> int:
    """Mark a component, the topmost edges down to the last one, unless it touches the root twice; return the rest."""
    first, contacts = top, 0
    while first == top or edges[first] != last:
        first -= 1
        k = edges[first]
        contacts += pairs[k, 0] == root or pairs[k, 1] == root
    for place in range(first, top):
        currentless[edges[place]] = contacts < 2
    return first


@kernel
def mark_currentless(
    pairs: Indices, start: Integers, edge: Integers, place: Integers, order: Integers, low: Integers, entry: Integers,
    path: Integers, edges: Integers, currentless: Bools,
) -> None:  # fmt: skip
    """Mark the resistors that lie on no path between two places that drive current, in place.

    A resistor carries current only in a biconnected component (Hopcroft and Tarjan, Commun. ACM 16, 1973, 372) of the
    vertex that stands for all these places, and only if two resistors join the component to that vertex.  Resistors
    without a path to that vertex are not marked.
    Shapes: `pairs` (m, 2): rows, and n for that vertex; `start` (n + 2,), `edge` (2 m,): the resistors at every vertex;
    `place` (n + 1,): a copy of ``start``; `order, low, entry, path` (n + 1,): -1; `edges` (m,): memory.
    """
    root = len(start) - 2
    path[0], order[root], low[root] = root, 0, 0
    depth, top, found = 1, 0, 1
    while depth:
        v = path[depth - 1]
        if place[v] < start[v + 1]:
            k = edge[place[v]]
            place[v] += 1
            w = pairs[k, 0] + pairs[k, 1] - v
            new = order[w] < 0
            if k == entry[v] or not (new or order[w] < order[v]):
                continue
            edges[top] = k
            top += 1
            if new:
                order[w], low[w], entry[w], path[depth] = found, found, k, w
                found, depth = found + 1, depth + 1
            else:
                low[v] = min(low[v], order[w])
        elif v == root:
            depth = 0
        else:
            depth -= 1
            above = path[depth - 1]
            low[above] = min(low[above], low[v])
            if low[v] >= order[above]:
                top = _close_component(pairs, entry[v], root, edges, top, currentless)


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


@kernel
def currents(
    pairs: Indices, conductance: Floats, value: Scaled, down: Bools, volts: float, noise: float, amps: Floats,
    exponent: Integers, few: float, faint: Bools,
) -> float:  # fmt: skip
    """Currents of resistors, scaled; returns the power in doubles.

    ``faint``: whether a difference is at most a share ``few`` of the values, or noise, but not nothing.
    """
    hi, lo, e, noise_down = value.hi, value.lo, value.exponent, value.noise
    power = 0.0
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        top = 0
        if down[a] == down[b]:
            top = max(e[a] if hi[a] != 0.0 else e[b], e[b] if hi[b] != 0.0 else e[a])
        near, near_low = _shift(hi[a], e[a] - top), _shift(lo[a], e[a] - top)
        far, far_low = _shift(hi[b], e[b] - top), _shift(lo[b], e[b] - top)
        fall = _fall(near, near_low, down[a], far, far_low, down[b], noise, noise_down) * volts
        amps[k], exponent[k] = _canonical(conductance[k] * fall, top if fall != 0.0 else 0)
        power += _shift(_shift(conductance[k] * fall * fall, top), top)
        apart = abs((near - far) + (near_low - far_low))
        faint[k] = down[a] == down[b] and _NOTHING * abs(near) < apart <= max(few, noise) * abs(near)
    return power


@kernel
def add_currents(pairs: Indices, amps: Floats, exponent: Integers, frame: Integers, net: Floats, total: Floats) -> None:
    """Add resistors' currents to the net current into every node, and their magnitudes to the total, in place."""
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        out, into = _shift(amps[k], exponent[k] - frame[a]), _shift(amps[k], exponent[k] - frame[b])
        net[a] -= out
        net[b] += into
        total[a] += abs(out)
        total[b] += abs(into)


@kernel
def drop_unresolved(
    pairs: Indices, amps: Floats, exponent: Integers, frame: Integers, net: Floats, through: Floats,
    falling: Floats, harmless: float,
) -> None:  # fmt: skip
    """Set currents to 0 along which nothing falls, and that are small at both ends, in place.

    Where what is ``falling`` is NaN, as beyond both rails, nothing is said of currents.  ``through`` is half the sum of
    magnitudes at a node, of which ``harmless`` is small.
    """
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        if not np.sign(amps[k]) * (falling[a] - falling[b]) <= 0.0:
            continue
        out, into = _shift(amps[k], exponent[k] - frame[a]), _shift(amps[k], exponent[k] - frame[b])
        if abs(out) <= harmless * through[a] and abs(into) <= harmless * through[b]:
            net[a] += out
            net[b] -= into
            through[a] -= 0.5 * abs(out)
            through[b] -= 0.5 * abs(into)
            amps[k] = 0.0


@kernel
def add_flows(
    rows: Indices, conductance: Floats, falls: Floats, falls_low: Floats, net: Floats, net_low: Floats, total: Floats
) -> None:
    """Add what flows from one row to another to the net current into both, in double-double, and to their totals.

    Shapes: `rows` (m, 2), -1 for nodes without one; `conductance, falls` (m,).
    """
    for k in range(len(rows)):
        a, b = rows[k, 0], rows[k, 1]
        if a == b:
            continue
        p, q = _two_product(conductance[k], falls[k])
        q += conductance[k] * falls_low[k]
        if a >= 0:
            net[a], net_low[a] = _sum(net[a], net_low[a], -p, -q)
            total[a] += abs(p)
        if b >= 0:
            net[b], net_low[b] = _sum(net[b], net_low[b], p, q)
            total[b] += abs(p)
