"""Compiled loops over a netlist: parts and what drives rows, then values of nodes, currents and their balance.

Of the read-off: where exponents of currents are an empty array, all exponents are 0, and those of nodes are not looked
at.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from resgrid.jit import inlined, kernel
from resgrid.solvers.extended import Scaled
from resgrid.solvers.extended_kernels import (
    Floats,
    Indices,
    Integers,
    _canonical,
    _shift,
    _sum,
    _two_product,
    _two_sum,
)
from resgrid.solvers.row_kernels import find

Bools = NDArray[np.bool_]

_FAINT = 1e-20
"""Difference of two double-doubles, relative to them, that has half of its digits left."""


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


@kernel
def known_range(contacts: Indices, known: Floats, part: Indices, lowest: Floats, highest: Floats) -> None:
    """Widen every part's range of known voltages that its contacts (c, 2) reach, in place."""
    for k in range(len(contacts)):
        a, b = contacts[k, 0], contacts[k, 1]
        if part[b] >= 0:
            a, b = b, a
        lowest[part[a]] = min(lowest[part[a]], known[b])
        highest[part[a]] = max(highest[part[a]], known[b])


@kernel
def mark_fed(pairs: Indices, amps: Floats, part: Indices, fed: NDArray[np.bool_]) -> None:
    """Mark the parts that current sources feed, in place."""
    for k in range(len(pairs)):
        a, b = part[pairs[k, 0]], part[pairs[k, 1]]
        if amps[k] != 0.0:
            if a >= 0:
                fed[a] = True
            if b >= 0:
                fed[b] = True


@kernel
def number_rows(part: Indices, solved: NDArray[np.bool_], root: Integers) -> int:
    """Turn the number of every node's part into its row in the equations, in place; -1 where it has none.

    Nodes of one ``root``, which comes before them, share its row; empty where every node is its own.  Returns the
    number of rows.
    """
    rows = 0
    for node in range(len(part)):
        if part[node] < 0:
            continue
        if not solved[part[node]]:
            part[node] = -1
        elif len(root) > 0 and root[node] != node:
            part[node] = part[root[node]]
        else:
            part[node] = rows
            rows += 1
    return rows


@kernel
def add_contacts(
    pairs: Indices, conductance: Floats, row: Indices, offset: Floats, low: float, ground: Floats, feed: Floats,
    tied: Indices, siemens: Floats, volts: Floats,
) -> int:  # fmt: skip
    """Add what ties rows to nodes of known voltage, and the current that these, and offsets, drive from ``low`` up.

    Notes the row, the conductance and the voltage (as seen from the row) of every such tie; returns their number.
    """
    count = 0
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        i, j = row[a], row[b]
        if i == j:
            continue
        if i >= 0 and j >= 0:
            feed[i] -= conductance[k] * (offset[a] - offset[b])
            feed[j] += conductance[k] * (offset[a] - offset[b])
            continue
        if i < 0:
            i, a, b = j, b, a
        tied[count], siemens[count], volts[count] = i, conductance[k], offset[b] - offset[a]
        count += 1
        ground[i] += conductance[k]
        if offset[b] != low or offset[a] != 0.0:
            feed[i] += conductance[k] * ((offset[b] - low) - offset[a])
    return count


@kernel
def add_injected(pairs: Indices, amps: Floats, row: Indices, injected: Floats, rest: Floats) -> None:
    """Add the currents of current sources to the rows they lead to, and take them from those they come from.

    The sum of a row is rounded once: several sources may nearly cancel.  Shapes: `injected, rest` (rows,): both come
    as 0.
    """
    several = False
    for k in range(len(pairs)):
        i, j = row[pairs[k, 0]], row[pairs[k, 1]]
        if i >= 0:
            several |= injected[i] != 0.0
            injected[i] -= amps[k]
        if j >= 0:
            several |= injected[j] != 0.0
            injected[j] += amps[k]
    if not several:
        return
    for k in range(len(injected)):
        injected[k] = 0.0
    for k in range(len(pairs)):
        i, j = row[pairs[k, 0]], row[pairs[k, 1]]
        if i >= 0:
            injected[i], rest[i] = _sum(injected[i], rest[i], -amps[k], 0.0)
        if j >= 0:
            injected[j], rest[j] = _sum(injected[j], rest[j], amps[k], 0.0)


@kernel
def spread(row: Indices, x: Floats, reference: float, volts: Floats) -> None:
    """Turn known voltages into heights of all nodes above the reference, with those of the rows, in place."""
    for node in range(len(row)):
        volts[node] = x[row[node]] if row[node] >= 0 else volts[node] - reference


@kernel
def from_one_rail(row: Indices, known: Floats, zero: float, volts: float, x: Scaled, out: Scaled) -> None:
    """Spread the values of rows over nodes; known voltages are converted to ``volts`` above ``zero``, NaN to 0."""
    hi, lo, e = x.hi, x.lo, x.exponent
    out_hi, out_lo, out_e = out.hi, out.lo, out.exponent
    for node in range(len(row)):
        i = row[node]
        if i >= 0:
            out_hi[node], out_lo[node], out_e[node] = hi[i], lo[i], e[i]
        elif not math.isnan(known[node]):
            out_hi[node] = (known[node] - zero) / volts


@kernel
def from_nearer_rail(
    row: Indices, known: Floats, low: float, high: float, drop: Scaled, height: Scaled, out: Scaled, down: Bools
) -> None:
    """Spread the values of rows over nodes, each counted from the nearer rail: ``down`` from the high one, or up.

    Without heights (empty arrays) they are what is left of the drops.
    """
    u, u_low, u_e = drop.hi, drop.lo, drop.exponent
    phi, phi_low, phi_e = height.hi, height.lo, height.exponent
    out_hi, out_lo, out_e = out.hi, out.lo, out.exponent
    for node in range(len(row)):
        i = row[node]
        if i >= 0:
            if u_e[i] < 0 or u[i] <= 0.5:
                out_hi[node], out_lo[node], out_e[node], down[node] = u[i], u_low[i], u_e[i], True
            elif len(phi):
                out_hi[node], out_lo[node], out_e[node] = phi[i], phi_low[i], phi_e[i]
            else:
                out_hi[node], out_lo[node] = _sum(1.0, 0.0, -u[i], -u_low[i])
        elif not math.isnan(known[node]):
            above, below = (known[node] - low) / (high - low), (high - known[node]) / (high - low)
            down[node] = abs(below) < abs(above)
            out_hi[node] = below if down[node] else above


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
    exponent: Integers,
) -> tuple[float, bool]:  # fmt: skip
    """Currents of resistors, scaled; returns the power in doubles, and whether any difference has few digits left."""
    hi, lo, e, noise_down = value.hi, value.lo, value.exponent, value.noise
    power, plain, faint = 0.0, len(exponent) == 0, False
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        if plain:
            fall = _fall(hi[a], lo[a], down[a], hi[b], lo[b], down[b], noise, noise_down) * volts
            amps[k] = conductance[k] * fall
            power += amps[k] * fall
            faint |= 0.0 < abs(fall) <= _FAINT * abs(volts * hi[a])
            continue
        top = _pair_exponent(hi[a], e[a], hi[b], e[b]) if down[a] == down[b] else 0
        near, near_low = _shift(hi[a], e[a] - top), _shift(lo[a], e[a] - top)
        far, far_low = _shift(hi[b], e[b] - top), _shift(lo[b], e[b] - top)
        fall = _fall(near, near_low, down[a], far, far_low, down[b], noise, noise_down) * volts
        amps[k], exponent[k] = _canonical(conductance[k] * fall, top)
        power += _shift(_shift(conductance[k] * fall * fall, top), top)
        faint |= 0.0 < abs(fall) <= _FAINT * abs(volts * near)
    return power, faint


@inlined
def _pair_exponent(a: float, a_e: int, b: float, b_e: int) -> int:
    if a == 0.0:
        return b_e
    return a_e if b == 0.0 else max(a_e, b_e)


@kernel
def frames(pairs: Indices, amps: Floats, exponent: Integers, frame: Integers) -> None:
    """Raise every node's exponent to that of the largest current there, in place."""
    for k in range(len(pairs)):
        if amps[k] != 0.0:
            for end in range(2):
                node = pairs[k, end]
                frame[node] = max(frame[node], exponent[k])


@kernel
def add_currents(pairs: Indices, amps: Floats, exponent: Integers, frame: Integers, net: Floats, total: Floats) -> None:
    """Add resistors' currents to the net current into every node, and their magnitudes to the total, in place."""
    plain = len(exponent) == 0
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        out = amps[k] if plain else _shift(amps[k], exponent[k] - frame[a])
        into = amps[k] if plain else _shift(amps[k], exponent[k] - frame[b])
        net[a] -= out
        net[b] += into
        total[a] += abs(out)
        total[b] += abs(into)


@kernel
def drop_unresolved(
    pairs: Indices, amps: Floats, exponent: Integers, frame: Integers, net: Floats, through: Floats,
    stored: Floats, sign: float, harmless: float,
) -> None:  # fmt: skip
    """Set currents to 0 along which ``sign * stored`` does not fall, and that are small at both ends, in place.

    Where nothing is stored, as beyond both rails, nothing is said of currents.

    ``through`` is half the sum of magnitudes at a node, of which ``harmless`` is small.
    """
    plain = len(exponent) == 0
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
