"""From the values of nodes to voltages, potentials and currents that keep their last digits.

A current is a difference of two node values, both counted from the nearer rail; nothing is rounded before that.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.equations import Equations
from resgrid.circuit.node_values import NodeValues
from resgrid.circuit.operating_point import OperatingPoint, Readings
from resgrid.circuit.sources import source_currents
from resgrid.errors import CircuitError
from resgrid.netlist import GROUND, Netlist
from resgrid.solvers.extended import logarithm, power

OUT_OF_RANGE = (
    "a voltage exceeds 1.8e308 V, the range of double precision: the currents fed in are too large for the "
    "conductances that carry them; check their units"
)

DIRECTION_RESIDUAL = 1e-6
"""Largest KCL violation of a direction-safe field, relative to the current through the node."""

HARMLESS = 1e-7
"""Share of a node's through-current that may be dropped where float64 values of its ends are equal."""

_NONE = -(2**62)
_LEAST_EXPONENT = -2
_ORDINARY = 1e-60
"""Smallest current of a unit, in amperes, that leaves products of plain values in range; its inverse is the largest."""


@dataclass(frozen=True, eq=False)
class Balance:
    """Kirchhoff's current law at every node, in units of ``2**(256 exponent)`` amperes.

    `exponent` (nodes,); `through, net` (nodes,): half the sum of all magnitudes, and the net current into the node.
    """

    exponent: NDArray[np.int64]
    through: NDArray[np.float64]
    net: NDArray[np.float64]


def injected_currents(netlist: Netlist) -> NDArray[np.float64]:
    """Current that the current sources feed into every node, in amperes; shape (nodes,)."""
    count = netlist.node_count
    taken, fed = netlist.current_nodes.T
    amps = netlist.current_amps
    # Counts of nothing come as whole numbers, whatever their weights.
    return np.asarray(np.bincount(fed, amps, count) - np.bincount(taken, amps, count), dtype=np.float64)


def read_off(
    system: Equations, values: NodeValues, method: str, seconds: Mapping[str, float]
) -> tuple[OperatingPoint, NDArray[np.float64]]:
    """Read everything off the values of the nodes.  Returns `residual` (nodes,)."""
    netlist = system.netlist
    plain = _plain_where_possible(values, netlist)
    voltage = _voltage(system, values)
    log_drop, potential = _stored(system, values)
    amps, exponent, power_sum = _currents(netlist, values, plain)
    sums = _balance(netlist, amps, exponent, plain)
    stored, sign = (log_drop, -1.0) if log_drop is not None else (potential, 1.0)
    if stored is not None:
        _drop_unresolved(netlist, amps, exponent, sums, plain, stored, float(np.sign(values.volts)) * sign)
    residual = _relative_residual(system, values, amps, exponent, sums)
    scale = 1.0 if plain else power(sums.exponent)
    point = OperatingPoint(
        netlist=netlist,
        voltage=voltage,
        log_drop=log_drop,
        potential=potential,
        ammeters=Readings(
            resistor_current=amps if plain else amps * power(exponent),
            log_current=None if plain else partial(_log_current, amps, exponent),
            resistor_direction=np.sign(amps).astype(np.int8),
            source_current=source_currents(netlist, system.forest, -sums.net * scale),
            power=power_sum,
            kcl_residual=float(residual.max(initial=0.0)),
        ),
        floating=system.floating,
        undriven=system.undriven,
        method=method,
        seconds=seconds,
    )
    return point, residual


def _log_current(amps: NDArray[np.float64], exponent: NDArray[np.int64]) -> NDArray[np.float64]:
    return logarithm(np.abs(amps), exponent)


def _relative_residual(
    system: Equations, values: NodeValues, amps: NDArray[np.float64], exponent: NDArray[np.int64], sums: Balance
) -> NDArray[np.float64]:
    """Violation of KCL at every node that is solved for, relative to its through-current.

    Where differences of values cannot tell the currents at a node, KCL is asked of the whole plateau, and so it is of
    nodes that floating sources tie.
    """
    own = (system.unknown >= 0) & (sums.through > 0)
    own[system.forest.order] = False
    residual = np.zeros(len(own))
    np.divide(np.abs(sums.net), sums.through, out=residual, where=own)
    lifted = system.forest.order[system.forest.base != GROUND]
    doubtful = np.concatenate([np.flatnonzero(residual > DIRECTION_RESIDUAL), lifted])
    if doubtful.size:
        from resgrid.circuit.flat_clusters import plateau_residual

        injected = injected_currents(system.netlist)
        residual[doubtful] = plateau_residual(system, values, amps, exponent, injected)[doubtful]
    return residual


def _plain_where_possible(values: NodeValues, netlist: Netlist) -> bool:
    """Write the values as doubles, in place, if their currents stay far from the ends of the range."""
    value, g = values.value, netlist.conductance
    unit = abs(values.volts)
    if value.exponent.min(initial=0) < _LEAST_EXPONENT or value.exponent.max(initial=0) > 0:
        return False
    if not (unit * g.min(initial=1.0) > _ORDINARY and unit * g.max(initial=1.0) < 1.0 / _ORDINARY):
        return False
    if value.exponent.any():
        scale = power(value.exponent)
        value.hi[:] *= scale
        value.lo[:] *= scale
        value.exponent[:] = 0
    return True


def _currents(
    netlist: Netlist, values: NodeValues, plain: bool
) -> tuple[NDArray[np.float64], NDArray[np.int64], float]:
    """Currents as scaled numbers (without exponents where ``plain``), and the power."""
    from resgrid.circuit.readout_kernels import currents

    count, value = len(netlist.conductance), values.value
    amps, exponent = np.empty(count), np.zeros(0 if plain else count, dtype=np.int64)
    power_sum = currents(
        netlist.resistor_nodes, netlist.conductance, value.hi, value.lo, value.exponent, values.down,
        values.volts, values.noise, value.noise, plain, amps, exponent,
    )  # fmt: skip
    return amps, exponent, float(power_sum)


def _balance(netlist: Netlist, amps: NDArray[np.float64], exponent: NDArray[np.int64], plain: bool) -> Balance:
    """Sum the currents at every node, relative to the largest one there."""
    from resgrid.circuit.readout_kernels import add_currents, frames
    from resgrid.solvers.extended_kernels import canonical

    net = injected_currents(netlist)
    frame = np.zeros(len(net), dtype=np.int64)
    if not plain:
        own = frame.copy()
        canonical(net, own)
        frame[:] = np.where(net != 0, own, _NONE)
        frames(netlist.resistor_nodes, amps, exponent, frame)
        frame[frame == _NONE] = 0
        net *= power(np.where(net != 0, own - frame, 0))
    total = np.abs(net)
    add_currents(netlist.resistor_nodes, amps, exponent, frame, plain, net, total)
    total *= 0.5
    return Balance(frame, total, net)


def _drop_unresolved(
    netlist: Netlist,
    amps: NDArray[np.float64],
    exponent: NDArray[np.int64],
    sums: Balance,
    plain: bool,
    stored: NDArray[np.float64],
    sign: float,
) -> None:
    """Set currents to 0, in place, that run between nodes of equal stored value, where the balance does not notice.

    ``sign * stored`` falls along the current, up to rounding; after this it falls along every current that matters.
    """
    from resgrid.circuit.readout_kernels import drop_unresolved

    drop_unresolved(
        netlist.resistor_nodes, amps, exponent, sums.exponent, plain, sums.net, sums.through, stored, sign, HARMLESS
    )


def _stored(system: Equations, values: NodeValues) -> tuple[NDArray[np.float64] | None, NDArray[np.float64] | None]:
    """``log_drop`` and ``potential`` of every node, where they exist."""
    height = values.height
    if system.rails is None:
        top = height[system.unknown >= 0].max(initial=0.0)
        one_rail = not system.feed.any() and (np.all(system.injected >= 0) or np.all(system.injected <= 0))
        if not (one_rail and top > 0):
            return None, None
        height /= top
        height[system.floating] = np.nan
        return None, height
    height[(height < 0) | (height > 1)] = np.nan
    height[system.floating] = np.nan
    log_drop = values.value.log
    above = np.flatnonzero(~values.down)
    log_drop[above] = np.log1p(-height[above])
    log_drop[np.isnan(height)] = np.nan
    return log_drop, height


def _voltage(system: Equations, values: NodeValues) -> NDArray[np.float64]:
    plain = values.value.plain
    with np.errstate(over="ignore"):
        volts = values.zero + values.volts * plain
    if not np.isfinite(volts[system.unknown >= 0]).all():
        raise CircuitError(OUT_OF_RANGE)
    if system.rails is not None:
        volts = np.where(values.down, system.rails.high - values.volts * plain, volts)
    return np.where(system.unknown >= 0, volts, system.known)
