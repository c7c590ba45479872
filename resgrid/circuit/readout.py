"""From the values of nodes to voltages, potentials and currents that keep their last digits.

A current is a difference of two node values, both counted from the nearer rail; nothing is rounded before that.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.equations import Equations
from resgrid.circuit.node_values import NodeValues
from resgrid.circuit.operating_point import OperatingPoint, Readings
from resgrid.circuit.sources import SourceForest, source_currents
from resgrid.errors import CircuitError
from resgrid.netlist import GROUND, Netlist
from resgrid.solvers.extended import Scaled, canonical, power
from resgrid.solvers.team import ALONE, Team

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


def injected_currents(netlist: Netlist) -> NDArray[np.float64]:
    """Current that the current sources feed into every node, in amperes; shape (nodes,)."""
    from resgrid.circuit.kernels import add_injected

    injected, rest = np.zeros((2, netlist.node_count))
    add_injected(netlist.current_nodes, netlist.current_amps, np.arange(len(injected), dtype=np.int32), injected, rest)
    return injected


def read_normwise(system: Equations, x: NDArray[np.float64], **told: Any) -> OperatingPoint:
    """Spread a normwise solution over the nodes; currents wait until they are asked for.

    Shapes: `x` (n,); `told`: what the point is to say of how it was solved.
    """
    from resgrid.circuit.kernels import spread

    forest = system.forest
    height = system.known_voltages()
    spread(system.unknown, x, system.reference, height)
    lifted = (system.unknown[forest.order] >= 0) & (forest.height != 0)
    height[forest.order[lifted]] += forest.height[lifted]
    point = OperatingPoint(
        netlist=system.netlist,
        voltage=height if system.reference == 0.0 else system.reference + height,
        log_drop=None,
        potential=_share_of_span(system, height, x),
        ammeters=partial(_normwise_readings, system.netlist, forest, system.unknown, height),
        floating=system.floating,
        undriven=system.undriven,
        **told,
    )
    if forest.loop.any():
        _ = point.readings  # warns of currents that are undetermined
    return point


def read_entrywise(
    system: Equations,
    values: NodeValues,
    team: Team,
    falls: NDArray[np.float64] | None = None,
    **told: Any,
) -> tuple[OperatingPoint, NDArray[np.float64], bool]:
    """Read everything off the values of the nodes, or currents off falls across the resistors (resistors,), in volts.

    `told`: what the point is to say of how it was solved.  Returns `residual` (nodes,), and whether differences of
    values have few digits left.
    """
    netlist, faint = system.netlist, False
    voltage, (log_drop, potential) = team.together(
        [partial(_voltage, system, values), partial(_stored, system, values)]
    )
    sign = float(np.sign(values.volts))
    falling = (potential, sign) if log_drop is None else (log_drop, -sign)
    if falls is None:
        amps, exponent, heat, faint = _differences(values, netlist, team)
    else:
        amps, exponent = netlist.conductance * falls, np.zeros(0, dtype=np.int64)
        heat = float(amps @ falls)
    readings, residual = _read(netlist, system.forest, system.unknown, amps, exponent, heat, *falling, team)
    point = OperatingPoint(
        netlist=netlist,
        voltage=voltage,
        log_drop=log_drop,
        potential=potential,
        ammeters=readings,
        floating=system.floating,
        undriven=system.undriven,
        **told,
    )
    return point, residual, faint


def _normwise_readings(
    netlist: Netlist, forest: SourceForest, unknown: NDArray[np.int32], height: NDArray[np.float64]
) -> Readings:
    """As the readings of values that are what they are: no difference counts as noise."""
    values = NodeValues(
        Scaled.of(np.nan_to_num(height))._replace(noise=0.0), np.zeros(len(height), np.bool_), 0.0, 1.0, 0.0
    )
    amps, exponent, heat, _ = _differences(values, netlist, ALONE)
    return _read(netlist, forest, unknown, amps, exponent, heat, None, 0.0, ALONE)[0]


def _differences(
    values: NodeValues, netlist: Netlist, team: Team
) -> tuple[NDArray[np.float64], NDArray[np.int64], float, bool]:
    """Currents from differences of the values of all nodes.

    Returns `amps, exponent` (resistors,), the latter (0,) where all are 0; the power; and whether differences are
    faint.
    """
    from resgrid.circuit.kernels import currents

    value, plain = _plain_where_possible(values, netlist)
    ends, amps = netlist.resistor_nodes, np.empty(len(netlist.conductance))
    exponent = np.zeros(0 if plain else len(amps), dtype=np.int64)

    def through(piece: slice) -> tuple[float, bool]:
        return currents(
            ends[piece], netlist.conductance[piece], value, values.down, values.volts, values.noise, amps[piece],
            exponent[piece],
        )  # fmt: skip

    found = team.over(len(amps), through)
    return amps, exponent, sum(power for power, _ in found), any(faint for _, faint in found)


def _read(
    netlist: Netlist, forest: SourceForest, unknown: NDArray[np.int32], amps: NDArray[np.float64],
    exponent: NDArray[np.int64], heat: float, stored: NDArray[np.float64] | None, sign: float, team: Team,
) -> tuple[Readings, NDArray[np.float64]]:  # fmt: skip
    """Sum up the currents at every node; nodes that floating sources join count as one.

    What is ``stored``, times ``sign``, falls along currents up to rounding, and along every one that matters after
    this: others are set to 0.  Shapes: `amps, exponent` (resistors,), `stored` (nodes,); returns `residual` (nodes,).
    """
    from resgrid.circuit.kernels import drop_unresolved

    ends, plain = netlist.resistor_nodes, not exponent.size
    frame, net, through = _balance(netlist, amps, exponent)
    if stored is not None:
        drop_unresolved(ends, amps, exponent, frame, net, through, stored, sign, HARMLESS)
    residual, direction = np.zeros(len(unknown)), np.empty(len(amps), dtype=np.int8)
    net_amps, through_amps = (net, through) if plain else (net * power(frame), through * power(frame))
    if np.any(forest.base != GROUND):
        root = forest.root
        net, through = (
            np.asarray(np.bincount(root, part)[root], dtype=np.float64) for part in (net_amps, through_amps)
        )

    def violated(some: slice) -> None:
        held = (unknown[some] >= 0) & (through[some] > 0)
        np.divide(np.abs(net[some]), through[some], out=residual[some], where=held)

    team.over(len(unknown), violated)
    team.over(len(amps), lambda some: np.copyto(direction[some], np.sign(amps[some]), casting="unsafe"))
    readings = Readings(
        resistor_current=amps if plain else amps * power(exponent),
        scaled=None if plain else (amps, exponent),
        resistor_direction=direction,
        source_current=source_currents(netlist, forest, -net_amps, through_amps),
        power=heat,
        kcl_residual=float(residual.max(initial=0.0)),
    )
    return readings, residual


def _plain_where_possible(values: NodeValues, netlist: Netlist) -> tuple[Scaled, bool]:
    """The values as doubles, if their currents stay far from the ends of the range; and whether they do."""
    value, g = values.value, netlist.conductance
    unit = abs(values.volts)
    if value.exponent.min(initial=0) < _LEAST_EXPONENT or value.exponent.max(initial=0) > 0:
        return value, False
    if not (unit * g.min(initial=1.0) > _ORDINARY and unit * g.max(initial=1.0) < 1.0 / _ORDINARY):
        return value, False
    if not value.exponent.any():
        return value, True
    scale = power(value.exponent)
    return Scaled(value.hi * scale, value.lo * scale, np.zeros_like(value.exponent), value.noise), True


def _balance(
    netlist: Netlist, amps: NDArray[np.float64], exponent: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Kirchhoff's current law at every node, in units of ``2**(256 frame)`` amperes, about the largest current there.

    Shapes: `amps, exponent` (resistors,); returns `frame`, `net` into the node, and `through`, half the sum of all
    magnitudes, (nodes,).
    """
    from resgrid.circuit.kernels import add_currents, frames

    net = injected_currents(netlist)
    frame = np.zeros(len(net), dtype=np.int64)
    if exponent.size:
        own = frame.copy()
        canonical(net, own)
        frame[:] = np.where(net != 0, own, _NONE)
        frames(netlist.resistor_nodes, amps, exponent, frame)
        frame[frame == _NONE] = 0
        net *= power(np.where(net != 0, own - frame, 0))
    through = np.abs(net)
    add_currents(netlist.resistor_nodes, amps, exponent, frame, net, through)
    through *= 0.5
    return frame, net, through


def _share_of_span(
    system: Equations, height: NDArray[np.float64], x: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """Between two rails the share of their difference; above a single one the share of the highest node."""
    if system.rails is not None:
        shift, span = system.reference - system.rails.low, system.rails.high - system.rails.low
    elif _single_signed(system) and x.size:
        shift, span = 0.0, float(x.max() if np.all(system.injected >= 0) else x.min())
    else:
        return None
    if span == 0.0:
        return None
    if shift != 0.0:
        height = height + shift
    return height if span == 1.0 else height / span


def _single_signed(system: Equations) -> bool:
    """Whether a single rail and currents of one sign are all that drives the circuit."""
    return not system.feed.any() and bool(np.all(system.injected >= 0) or np.all(system.injected <= 0))


def _stored(system: Equations, values: NodeValues) -> tuple[NDArray[np.float64] | None, NDArray[np.float64] | None]:
    """``log_drop`` and ``potential`` of every node, where they exist."""
    height = values.height
    if system.rails is None:
        top = height[system.unknown >= 0].max(initial=0.0)
        if not (_single_signed(system) and top > 0):
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
    return np.where(system.unknown >= 0, volts, system.known_voltages())
