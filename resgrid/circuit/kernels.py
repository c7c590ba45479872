"""Kernels over the elements of a netlist: components, resistors without current, branch currents, net currents."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.jit import inlined, kernel
from resgrid.solvers.csr_kernels import find
from resgrid.solvers.scaled import Floats, Indices, Integers, Scaled
from resgrid.solvers.scaled_kernels import _canonical, _shift, _sum, _two_product, _two_sum

Bools = NDArray[np.bool_]

_DOUBLE_DOUBLE_ROUNDING = 1e-30
"""Largest relative difference of two double-doubles that counts as a rounding error."""


@kernel
def merge_components(pairs: Indices, part: Indices, contacts: Indices) -> int:
    """Merge the components of the two ends of every edge in a union-find, in place; return the number of contacts.

    `pairs` (m, 2): nodes of the edges; `part` (nodes,): parents of the union-find, -1 for a node outside all
    components; `contacts` (at least m,): receives the indices of the contacts, the edges with one node outside all
    components.  With `number_components` this takes 18 to 52 ms for 1e6 edges, 4 to 17 times less than
    `scipy.sparse.csgraph.connected_components` (`resgrid.core.regions.label_components`).
    """
    count = 0
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        a, b = part[i], part[j]
        if a >= 0 and b >= 0:
            if a != b:
                # Inlined from `csr_kernels.join`: the call alone would double the time.
                a, b = find(part, a), find(part, b)
                part[max(a, b)] = part[i] = part[j] = min(a, b)
        elif a >= 0 or b >= 0:
            contacts[count] = k
            count += 1
    return count


@kernel
def number_components(part: Indices) -> int:
    """Replace the parents of a union-find by component numbers from 0 on, in place; return the number of components.

    `part` (nodes,): parents; -1 stays -1.  The parent of a node has a smaller number than the node, so that the
    component of the parent is known first.
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
def _close_component(last: int, edges: Integers, top: int, drives: Bools, currentless: Bools) -> int:
    """Pop the edges of a biconnected component from the stack, and return the new height of the stack.

    `last`: edge of the component that is deepest in the stack; `edges` (m,): the stack; `top`: number of edges on the
    stack; `drives` (m,): whether an edge is a source with a value other than 0; `currentless` (m,): set to True for the
    popped edges if none of them is such a source.
    """
    first, driven = top, False
    while first == top or edges[first] != last:
        first -= 1
        driven = driven or drives[edges[first]]
    for place in range(first, top):
        currentless[edges[place]] = not driven
    return first


@kernel
def mark_currentless(
    pairs: Indices, drives: Bools, start: Integers, edge: Integers, place: Integers, order: Integers, low: Integers,
    entry: Integers, path: Integers, edges: Integers, currentless: Bools,
) -> None:  # fmt: skip
    """Mark the elements that carry no current for any conductances, in place.

    `pairs` (m, 2): nodes of the elements, which are resistors and sources; `drives` (m,): whether an element is a
    source with a value other than 0; `start` (nodes + 1,), `edge` (2 m,): the elements at every node in compressed
    rows; `place` (nodes,): a copy of ``start[:-1]``; `order`, `low`, `entry`, `path` (nodes,): work arrays filled with
    -1; `edges` (m,): work array; `currentless` (m,): the result.  On return, `order` is the position of every node in a
    depth-first search from ground, and `entry` the element by which the search entered the node, -1 for none.

    An element carries current only in a biconnected component (Hopcroft and Tarjan, Commun. ACM 16, 1973, 372) that
    contains such a source.  Elements without a path to ground are not marked.
    """
    path[0], order[0], low[0] = 0, 0, 0
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
        elif depth == 1:
            depth = 0
        else:
            depth -= 1
            above = path[depth - 1]
            low[above] = min(low[above], low[v])
            if low[v] >= order[above]:
                top = _close_component(entry[v], edges, top, drives, currentless)


@kernel
def align_parts(
    joints: Integers, part: Integers, lift: Floats, lift_low: Floats, x: Floats, shift: Floats, shift_low: Floats
) -> None:
    """Compute shifts of the voltages of parts of a circuit for which no voltage lies across the joints of the parts.

    `joints` (k, 2): rows at the two ends of the resistor without current that joins a part to an earlier one, in the
    order of a search from ground; `part` (n + 1,): part of every row, and of the known voltages; `lift`, `lift_low`
    (k,): voltage of the first end above its row minus that of the second end, in volts, and its rounding error; `x`
    (n + 1,): voltages of the rows, and 0 for the known voltages, in volts; `shift`, `shift_low` (parts,): the result,
    in volts, and its rounding error; 0 on entry.
    """
    for k in range(len(joints)):
        i, j = joints[k, 0], joints[k, 1]
        a, e = _two_sum(x[i], shift[part[i]])
        b, f = _two_sum(a, lift[k])
        c, g = _two_sum(b, -x[j])
        rest = e + f + g + shift_low[part[i]] + lift_low[k]
        shift[part[j]], shift_low[part[j]] = _two_sum(c, rest)


@inlined
def _voltage_difference(
    a: float, a_low: float, a_is_drop: bool, b: float, b_low: float, b_is_drop: bool, rounding: float,
    drop_rounding: float,
) -> float:  # fmt: skip
    """Return the potential of node a minus that of node b, divided by the voltage between the rails; 0 within rounding.

    ``a + a_low`` is the drop of node a from the high rail if `a_is_drop`, else the voltage of node a above the low
    rail, both divided by the voltage between the rails; `b`, `b_low`, `b_is_drop`: likewise for node b. `rounding`,
    `drop_rounding`: relative rounding errors of voltages above the low rail and of drops.
    """
    if a_is_drop == b_is_drop:
        d = (a - b) + (a_low - b_low)
        if abs(d) <= (drop_rounding if a_is_drop else rounding) * max(abs(a), abs(b)):
            return 0.0
        return -d if a_is_drop else d
    # One node lies phi above the low rail, the other u below the high rail: the difference is (phi + u) - 1.
    s, t = _two_sum(a, b)
    d = (s - 1.0) + (t + (a_low + b_low))
    if abs(d) <= 0.5 * rounding:
        return 0.0
    return -d if a_is_drop else d


@kernel
def currents(
    pairs: Indices, conductance: Floats, value: Scaled, is_drop: Bools, volts: float, rounding: float, amps: Floats,
    exponent: Integers, threshold: float, imprecise: Bools,
) -> float:  # fmt: skip
    """Compute the currents of the resistors, and return the dissipated power in watts.

    `pairs` (m, 2): nodes of the resistors; `conductance` (m,): in siemens; `value`, `is_drop` (nodes,): node values in
    units of the voltage between the rails, and whether each is a drop from the high rail instead of a voltage above the
    low rail; `volts`: voltage between the rails, in volts; `rounding`: relative rounding error of voltages above the
    low rail; `amps`, `exponent` (m,): receive the currents ``amps * 2**(256 exponent)`` A, from the first to the second
    node; `threshold`: relative difference of two values below which their difference is imprecise; `imprecise` (m,):
    receives whether the voltage difference is imprecise or a rounding error, but not zero.
    """
    hi, lo, e, drop_rounding = value.hi, value.lo, value.exponent, value.noise
    power = 0.0
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        top = 0
        if is_drop[a] == is_drop[b]:
            top = max(e[a] if hi[a] != 0.0 else e[b], e[b] if hi[b] != 0.0 else e[a])
        near, near_low = _shift(hi[a], e[a] - top), _shift(lo[a], e[a] - top)
        far, far_low = _shift(hi[b], e[b] - top), _shift(lo[b], e[b] - top)
        fall = volts * _voltage_difference(
            near, near_low, is_drop[a], far, far_low, is_drop[b], rounding, drop_rounding
        )
        amps[k], exponent[k] = _canonical(conductance[k] * fall, top if fall != 0.0 else 0)
        power += _shift(_shift(conductance[k] * fall * fall, top), top)
        apart = abs((near - far) + (near_low - far_low))
        limit = max(threshold, rounding) * abs(near)
        imprecise[k] = is_drop[a] == is_drop[b] and _DOUBLE_DOUBLE_ROUNDING * abs(near) < apart <= limit
    return power


@kernel
def add_currents(pairs: Indices, amps: Floats, exponent: Integers, frame: Integers, net: Floats, total: Floats) -> None:
    """Add the resistor currents to the net current into every node, and their magnitudes to the totals, in place.

    `pairs` (m, 2): nodes; `amps`, `exponent` (m,): currents ``amps * 2**(256 exponent)`` A from the first to the second
    node; `frame` (nodes,): exponent of the unit ``2**(256 frame)`` A of a node; `net`, `total` (nodes,): net current
    and sum of magnitudes in this unit.
    """
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
    falling: Floats, negligible: float,
) -> None:  # fmt: skip
    """Set to zero the currents that do not flow downwards in `falling` and are negligible at both ends, in place.

    `pairs` (m, 2): nodes; `amps`, `exponent` (m,): currents ``amps * 2**(256 exponent)`` A from the first to the second
    node; `frame` (nodes,): exponent of the unit ``2**(256 frame)`` A of a node; `net`, `through` (nodes,): net current
    into the node and half the sum of the magnitudes, in this unit, updated in place; `falling` (nodes,): values that
    fall along currents, such as the potential; `negligible`: a current of at most ``negligible * through`` is
    negligible.  A node with NaN in `falling` (a voltage outside the rails) keeps its currents.
    """
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        if not np.sign(amps[k]) * (falling[a] - falling[b]) <= 0.0:
            continue
        out, into = _shift(amps[k], exponent[k] - frame[a]), _shift(amps[k], exponent[k] - frame[b])
        if abs(out) <= negligible * through[a] and abs(into) <= negligible * through[b]:
            net[a] += out
            net[b] -= into
            through[a] -= 0.5 * abs(out)
            through[b] -= 0.5 * abs(into)
            amps[k] = 0.0


@kernel
def add_flows(
    rows: Indices, conductance: Floats, falls: Floats, falls_low: Floats, net: Floats, net_low: Floats, total: Floats
) -> None:
    """Add branch currents ``conductance * falls`` to the net current into both rows, and their magnitudes to `total`.

    `rows` (m, 2): rows, -1 for nodes without a row; `conductance` (m,): in siemens; `falls`, `falls_low` (m,): voltages
    of the first node above the second in volts, and their rounding errors; `net`, `net_low` (n,): net currents in
    amperes, and their rounding errors; `total` (n,): sums of magnitudes in amperes.  `net`, `net_low` and `total`
    change in place.
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
