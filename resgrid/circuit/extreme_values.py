"""Operating points of circuits of at most 2,000 nodes with values far outside the usual range, such as 1e-310 S.

Products and quotients of such values leave the range of doubles, so that factors in doubles lose their digits.  Here
the elimination uses decimal numbers with unbounded exponents.  Voltages and currents are integers
(`resgrid.circuit.cancellation`), and every result is rounded to a double once.
"""

from __future__ import annotations

import decimal
import math
from decimal import Decimal
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.cancellation import NEAR_FLOOR, IntegerState, Pairs, refine_in_integers
from resgrid.circuit.decimal_elimination import ARITHMETIC, MOST_NODES, eliminations, network_of
from resgrid.circuit.equations import Equations
from resgrid.circuit.operating_point import BranchCurrents, OperatingPoint
from resgrid.circuit.sources import without_loops
from resgrid.core.netlist import Netlist
from resgrid.errors import AccuracyError
from resgrid.solvers.conservative_factors import Column, Fixed, nearest
from resgrid.solvers.scaled import BITS, Numbers

_USUAL = 2.0**126
"""Largest magnitude of usual values in SI units, and the inverse of the smallest; about the range of single precision.

In tests, factors in doubles keep their digits for conductances between 1e-40 and 1e40 S, and lose them from 1e-60 to
1e60 S.
"""

_PLAIN = 900
"""Largest magnitude of the binary logarithm of a current, in amperes, that is stored without a separate exponent."""

_DEPTH, _GUARD = 2200, 2500
"""Numbers of binary digits of the integers between the largest value and the floor, and below the floor.

Values below the floor are set to zero.  The range of doubles, from ``2**-1074`` to ``2**1024``, has fewer digits.
"""

_MANTISSA = 64
"""Number of binary digits of the fractions of the elimination."""


class ExtremeResponse(NamedTuple):
    """Voltages and currents as mantissas and exponents of ``2**256``.

    `voltage` (nodes,): node voltages in volts; `fall` (pairs,): voltages between the nodes of pairs, first minus
    second; `resistor` (resistors,): currents from the first to the second node in amperes; `source` (sources,):
    currents into the plus terminals, NaN in loops of sources.
    """

    voltage: Numbers
    fall: Numbers
    resistor: Numbers
    source: Numbers


def is_small(netlist: Netlist) -> bool:
    """Return whether decimal arithmetic is possible: for a circuit of at most 2,000 nodes, without a space."""
    return netlist.space_map is None and netlist.node_count <= MOST_NODES


def is_extreme(netlist: Netlist) -> bool:
    """Return whether a circuit of at most 2,000 nodes, without a space, has values outside ``2**-126`` to ``2**126``.

    The values are conductances, source voltages and source currents other than 0, in SI units.
    """
    if not is_small(netlist):
        return False
    values = np.abs(np.concatenate([netlist.conductance, netlist.source_volts, netlist.current_amps]))
    return bool(np.any((values > _USUAL) | ((values > 0.0) & (values < 1.0 / _USUAL))))


def solve_extreme(system: Equations) -> OperatingPoint:
    """Return the operating point of the equations, without the currents of floating components and without times.

    Every voltage and current is rounded once; voltages beyond the range of doubles are infinite.  Raise AccuracyError
    if the refinement diverges.
    """
    state = _refined(system)
    found = state.rounded()
    amps, exponent = _scaled_currents(state)
    log_drop, potential = _log_drops(state), _potentials(state)
    currents = BranchCurrents(found.amps, (amps, exponent), found.source_amps, found.power, _residual(state))
    return OperatingPoint(
        system.netlist, found.volts, log_drop, potential, currents, system.floating, system.undriven,
        method="direct" if system.size else "none", seconds={}, entry_error=found.entry_error,
    )  # fmt: skip


def _refined(system: Equations, pairs: Pairs = ()) -> IntegerState:
    """Return the solution of the equations in integers; raise AccuracyError if the refinement diverges.

    `pairs`: pairs of nodes whose voltage differences must be accurate.
    """
    rows = np.where(system.unknown < 0, system.size, system.unknown)  # the last node of the network is the ground
    with decimal.localcontext(ARITHMETIC):
        steps = eliminations(network_of(system.netlist, rows), (system.size,))
        columns = [_column(row, star, system.size) for row, star in steps]
    state = refine_in_integers(system, columns, _DEPTH, _GUARD, pairs)
    if state is None:
        raise AccuracyError(
            "the conductances span too many orders of magnitude; check the smallest and the largest one"
        )
    return state


def _column(row: int, star: dict[int, Decimal], ground: int) -> Column:
    """Return the elimination step of a row; `star`: conductances to its neighbours in S; `ground`: number of ground."""
    pivot = sum(star.values(), Decimal(0))
    parts = {other: siemens / pivot for other, siemens in star.items()}
    leak = parts.pop(ground, Decimal(0))
    largest = max(parts, key=parts.__getitem__, default=-1)
    if largest < 0 or leak > parts[largest]:
        largest = -1
    fractions = [(other, _fixed(part)) for other, part in parts.items() if other != largest]
    return Column(row, fractions, largest, _fixed(leak) if largest >= 0 < leak else None, _fixed(1 / pivot))


def _fixed(value: Decimal) -> Fixed:
    """Return a positive number as an integer of 64 or 65 bits and its number of binary places, rounded down."""
    above, below = value.as_integer_ratio()
    places = _MANTISSA - above.bit_length() + below.bit_length()
    return (above << places if places >= 0 else above >> -places) // below, places


def respond_extreme(system: Equations, pairs: Pairs) -> ExtremeResponse:
    """Return voltages and currents of the equations with separate exponents; `pairs`: pairs of nodes for the falls.

    The known voltages of `system` must be 0 V.  Raise AccuracyError if the refinement diverges.
    """
    state = _refined(system, pairs)
    least, source = max(map(int.bit_length, state.volts)) - state.depth, state.source_currents()
    floor = _floor(state, max(map(int.bit_length, source), default=0) + state.unit_amps) - state.unit_amps
    amps, exponent = _scaled(source, state.unit_amps, floor)
    volts, falls = (_scaled(values, state.unit_volts, least) for values in (state.volts, state.falls()))
    return ExtremeResponse(volts, falls, _scaled_currents(state), (without_loops(system.forest, amps), exponent))


def _scaled(values: list[int], unit: int, least: int) -> Numbers:
    """Return integers in units of ``2**unit`` as mantissas and exponents of ``2**256``.

    Integers of at most `least` binary digits become 0.
    """
    numbers, exponent = np.zeros(len(values)), np.zeros(len(values), dtype=np.int64)
    for k, value in enumerate(values):
        if value.bit_length() > least:
            steps = round((value.bit_length() + unit) / BITS)
            steps = steps if abs(value.bit_length() + unit) > _PLAIN else 0
            numbers[k], exponent[k] = nearest(value, unit - BITS * steps), steps
    return numbers, exponent


def _scaled_currents(state: IntegerState) -> Numbers:
    """Return the resistor currents as ``mantissa * 2**(256 exponent)`` A, (resistors,) each; 0 below the floor."""
    amps, exponent = np.zeros(count := len(state.system.netlist.conductance)), np.zeros(count, dtype=np.int64)
    digits = max((each.places for each in state.resistors), default=0)
    values = [
        (state.volts[each.nodes[0]] - state.volts[each.nodes[1]]) * each.siemens << digits - each.places
        for each in state.resistors
    ]
    unit = state.unit_volts - digits
    floor = _floor(state, max((value.bit_length() + unit for value in values), default=0))
    flows = [each.number for each in state.resistors]
    amps[flows], exponent[flows] = _scaled(values, unit, floor - unit)
    return amps, exponent


def _floor(state: IntegerState, largest: int) -> int:
    """Return the binary logarithm of the current, in amperes, up to which currents are set to zero.

    `largest`: binary logarithm of the largest current in amperes.
    """
    return max(largest - state.depth - 1, state.floor + state.unit_amps)


def _residual(state: IntegerState) -> float:
    """Return the largest net current into a row, as a fraction of the current through the row.

    The current through a row is half the sum of the magnitudes of its resistor currents.  Rows with currents near the
    floor, below which currents are set to zero, are not checked.
    """
    through = [0] * len(state.net)
    for each in state.resistors:
        amps = abs(state.current(each, state.volts[each.nodes[0]] - state.volts[each.nodes[1]]))
        for row in set(each.rows):
            through[row] += amps
    floor = _floor(state, max(through, default=0).bit_length() + state.unit_amps) + NEAR_FLOOR - state.unit_amps
    rows = zip(state.net[:-1], through[:-1], strict=True)
    return max((2 * abs(net) / amps for net, amps in rows if amps.bit_length() > floor), default=0.0)


def _log_drops(state: IntegerState) -> NDArray[np.float64] | None:
    """Return the natural logarithms of the drops from the high rail, (nodes,); None without two rails.

    A drop is a fraction of the voltage between the rails.  The result is -inf on the high rail, and NaN at floating
    nodes and at nodes that sources hold at other voltages.
    """
    rails, volts = state.system.rails, state.volts
    if rails is None:
        return None
    high, low = state.units(rails.high), state.units(rails.low)
    log_drops = np.full(len(volts), np.nan)
    for node, held in enumerate((state.system.unknown < 0).tolist()):
        drop = high - volts[node]
        if drop == 0:
            log_drops[node] = -np.inf
        elif drop > 0 and not (held and volts[node] != low):
            log_drops[node] = _log_ratio(drop, high - low)
    log_drops[state.system.floating] = np.nan
    return log_drops


def _log_ratio(above: int, below: int) -> float:
    """Return the natural logarithm of the quotient of two positive integers."""
    if 2 * above > below:
        return math.log1p((above - below) / below)
    bits = below.bit_length() - above.bit_length()
    return math.log((above << bits) / below) - bits * math.log(2.0)


def _potentials(state: IntegerState) -> NDArray[np.float64] | None:
    """Return the potentials, (nodes,): 0 at the low or only rail, 1 at the high rail or at the extreme node.

    With one rail, the extreme node is the row with the largest voltage difference from the rail.  NaN where a node
    floats or a source holds it outside the rails.  None unless two rails, or one rail and injected currents of one
    sign, drive the rows.
    """
    system, volts = state.system, state.volts
    base, solved = state.units(system.reference), system.unknown >= 0
    if system.rails is not None:
        base = state.units(system.rails.low)
        span = state.units(system.rails.high) - base
    else:
        injected = system.injected
        if system.feed.any() or (np.any(injected < 0.0) and np.any(injected > 0.0)) or not injected.any():
            return None
        span = max((volts[node] - base for node in np.flatnonzero(solved).tolist()), key=abs, default=0)
    if not span:
        return None
    potential = np.array([_quotient(level - base, span) for level in volts])
    if system.rails is not None:
        potential[~solved & ((potential < 0.0) | (potential > 1.0))] = np.nan
    potential[system.floating] = np.nan
    return potential


def _quotient(above: int, below: int) -> float:
    """Return the quotient of two integers as a double, infinite if it overflows."""
    try:
        return above / below
    except OverflowError:
        return np.inf if (above > 0) == (below > 0) else -np.inf
