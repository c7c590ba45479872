"""Compiled loops over a netlist's resistors: connected parts, conductances by rows, plain currents."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.solvers.row_kernels import find

Floats = NDArray[np.float64]
Indices = NDArray[np.int32]
Integers = NDArray[np.int64]


@njit(cache=True)
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


@njit(cache=True)
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


@njit(cache=True)
def known_range(pairs: Indices, known: Floats, part: Indices, lowest: Floats, highest: Floats) -> None:
    """Widen every part's range of known voltages that its resistors reach, in place; contacts alone do."""
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        if (part[a] >= 0) == (part[b] >= 0):
            continue
        if part[b] >= 0:
            a, b = b, a
        lowest[part[a]] = min(lowest[part[a]], known[b])
        highest[part[a]] = max(highest[part[a]], known[b])


@njit(cache=True)
def mark_fed(pairs: Indices, amps: Floats, part: Indices, fed: NDArray[np.bool_]) -> None:
    """Mark the parts that current sources feed, in place."""
    for k in range(len(pairs)):
        a, b = part[pairs[k, 0]], part[pairs[k, 1]]
        if amps[k] != 0.0:
            if a >= 0:
                fed[a] = True
            if b >= 0:
                fed[b] = True


@njit(cache=True)
def number_rows(
    part: Indices, driven: NDArray[np.bool_], lowest: Floats, root: Integers
) -> tuple[int, Integers, Floats, Integers]:
    """Turn the number of every node's part into its row in the equations, in place; -1 where it has none.

    A node of a part that is not driven has the lowest known voltage there, the only one, and floats where that is
    infinite.  Nodes of one ``root``, which comes before them, share its row; empty where every node is its own.
    Returns the number of rows, the nodes that are not driven, their voltages, and the nodes that float.
    """
    flat = floating = 0
    for node in range(len(part)):
        if part[node] >= 0 and not driven[part[node]]:
            if lowest[part[node]] < np.inf:
                flat += 1
            else:
                floating += 1
    undriven, volts, loose = np.empty(flat, np.int64), np.empty(flat), np.empty(floating, np.int64)
    rows = flat = floating = 0
    for node in range(len(part)):
        own = part[node]
        if own < 0:
            continue
        if driven[own]:
            if len(root) > 0 and root[node] != node:
                part[node] = part[root[node]]
            else:
                part[node] = rows
                rows += 1
            continue
        part[node] = -1
        if lowest[own] < np.inf:
            undriven[flat], volts[flat] = node, lowest[own]
            flat += 1
        else:
            loose[floating] = node
            floating += 1
    return rows, undriven, volts, loose


@njit(cache=True)
def add_contacts(
    pairs: Indices, conductance: Floats, row: Indices, offset: Floats, low: float, high: float, ground: Floats,
    feed: Floats,
) -> bool:  # fmt: skip
    """Add what ties rows to nodes of known voltage, and the current that these, and offsets, drive from ``low`` up.

    Returns whether all known voltages there are ``low`` or ``high``.
    """
    two = True
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
        ground[i] += conductance[k]
        if offset[b] != low or offset[a] != 0.0:
            feed[i] += conductance[k] * ((offset[b] - low) - offset[a])
            two &= offset[b] == low or offset[b] == high
    return two


@njit(cache=True)
def rail_contacts(
    pairs: Indices, conductance: Floats, row: Indices, known: Floats, high: float, to_high: Floats, to_low: Floats
) -> None:
    """Add the conductances of contacts between rows and two rails."""
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        i = row[a]
        if (i >= 0) == (row[b] >= 0):
            continue
        if i < 0:
            i, b = row[b], a
        if known[b] == high:
            to_high[i] += conductance[k]
        else:
            to_low[i] += conductance[k]


@njit(cache=True)
def add_injected(pairs: Indices, amps: Floats, row: Indices, injected: Floats) -> None:
    """Add the currents of current sources to the rows they lead to, and take them from those they come from."""
    for k in range(len(pairs)):
        i, j = row[pairs[k, 0]], row[pairs[k, 1]]
        if i >= 0:
            injected[i] -= amps[k]
        if j >= 0:
            injected[j] += amps[k]


@njit(cache=True)
def spread(row: Indices, x: Floats, reference: float, volts: Floats) -> None:
    """Turn known voltages into heights of all nodes above the reference, with those of the rows, in place."""
    for node in range(len(row)):
        volts[node] = x[row[node]] if row[node] >= 0 else volts[node] - reference


@njit(cache=True)
def plain_currents(
    pairs: Indices, conductance: Floats, height: Floats, amps: Floats, outflow: Floats, through: Floats
) -> float:
    """Currents into ``amps``, added to the nodes' outflow and through-current; returns the power.

    Nothing flows from or to a node whose height is NaN.
    """
    power = 0.0
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        drop = height[a] - height[b]
        if math.isnan(drop):
            drop = 0.0
        flow = conductance[k] * drop
        amps[k] = flow
        outflow[a] += flow
        outflow[b] -= flow
        through[a] += abs(flow)
        through[b] += abs(flow)
        power += flow * drop
    return power
