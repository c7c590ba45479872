"""Modified nodal analysis in exact fractions; voltages and currents are None if the equations do not determine them."""

from __future__ import annotations

from fractions import Fraction
from typing import NamedTuple

import resgrid as rg

Value = Fraction | None


class ExactPoint(NamedTuple):
    """Exact values; None if a value is not unique."""

    voltage: list[Value]
    resistor_current: list[Value]
    source_current: list[Value]


def solve_exactly(netlist: rg.Netlist) -> ExactPoint | None:
    """Solve by Gauss-Jordan elimination for voltages and source currents; return None for inconsistent equations."""
    rows, rhs = _equations(netlist)
    pivot, left = {}, set(range(len(rhs)))
    for column in range(len(rhs)):
        usable = [row for row in left if column in rows[row]]
        if usable:
            row = min(usable, key=lambda k: len(rows[k]))
            left.discard(row)
            pivot[column] = row
            _eliminate(rows, rhs, row, column)
    if any(rhs[row] for row in left):
        return None
    nodes = netlist.node_count - 1
    # Every unknown is a constant and a combination of the free unknowns.
    parts: list[tuple[dict[int, Fraction], Fraction]] = [({}, Fraction(0))]
    for column in range(len(rhs)):
        if column in pivot:
            row = pivot[column]
            parts.append(({k: -x for k, x in rows[row].items() if k != column}, rhs[row]))
        else:
            parts.append(({column: Fraction(1)}, Fraction(0)))
    values = [None if free else constant for free, constant in parts]
    currents: list[Value] = []
    for (i, j), g in zip(netlist.resistor_nodes.tolist(), netlist.conductance.tolist(), strict=True):
        (free_i, at_i), (free_j, at_j) = parts[i], parts[j]
        currents.append(Fraction(g) * (at_i - at_j) if free_i == free_j else None)
    return ExactPoint(values[: nodes + 1], currents, values[nodes + 1 :])


def _equations(netlist: rg.Netlist) -> tuple[list[dict[int, Fraction]], list[Fraction]]:
    """Return sparse rows and right-hand side; the unknowns are all voltages except ground, then source currents."""
    nodes = netlist.node_count - 1
    size = nodes + len(netlist.source_volts)
    rows: list[dict[int, Fraction]] = [{} for _ in range(size)]
    rhs = [Fraction(0)] * size

    def add(row: int, column: int, value: Fraction) -> None:
        if row >= 0 and column >= 0:
            rows[row][column] = rows[row].get(column, Fraction(0)) + value

    for (i, j), g in zip(netlist.resistor_nodes.tolist(), netlist.conductance.tolist(), strict=True):
        for here, there in ((i - 1, j - 1), (j - 1, i - 1)):
            add(here, here, Fraction(g))
            add(here, there, -Fraction(g))
    for (i, j), amps in zip(netlist.current_nodes.tolist(), netlist.current_amps.tolist(), strict=True):
        for node, sign in ((i, -1), (j, 1)):
            if node:
                rhs[node - 1] += sign * Fraction(amps)
    for k, (i, j) in enumerate(netlist.source_nodes.tolist()):
        for node, sign in ((i - 1, Fraction(1)), (j - 1, Fraction(-1))):
            add(node, nodes + k, sign)
            add(nodes + k, node, sign)
        rhs[nodes + k] = Fraction(float(netlist.source_volts[k]))
    return [{k: x for k, x in row.items() if x} for row in rows], rhs


def _eliminate(rows: list[dict[int, Fraction]], rhs: list[Fraction], row: int, column: int) -> None:
    """Normalize a row and subtract it from all others, in place."""
    scale = rows[row][column]
    rows[row] = {k: x / scale for k, x in rows[row].items()}
    rhs[row] /= scale
    for other, entries in enumerate(rows):
        if other != row and (factor := entries.get(column)):
            for k, x in rows[row].items():
                entries[k] = entries.get(k, Fraction(0)) - factor * x
                if not entries[k]:
                    del entries[k]
            rhs[other] -= factor * rhs[row]
