"""The values of nodes, and voltages, potentials and currents read off them to their last digits.

Every node is counted from the nearer rail, and a current is a difference of two such values: nothing is rounded before
that.  Where a circuit hangs between two rails, the drop ``u`` from the high one is solved for; the height
``phi = 1 - u`` above the low one is what is left of it, or a solution of its own where that would be a small difference
somewhere.  Currents of both signs are solved for apart, and either solution is right entry by entry, which says little
of their difference.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.cancellation import Balanced
from resgrid.circuit.equations import Equations, injected_currents
from resgrid.circuit.operating_point import BranchCurrents, OperatingPoint
from resgrid.circuit.sources import SourceForest, source_currents
from resgrid.core.netlist import GROUND, Netlist
from resgrid.errors import CircuitError
from resgrid.solvers.factors import EXACT_ROWS, Factor
from resgrid.solvers.laplacian import Rails
from resgrid.solvers.progress import ProgressMonitor
from resgrid.solvers.refinement import minus, quotient
from resgrid.solvers.scaled import Scaled, canonical, power
from resgrid.solvers.threads import SINGLE_THREAD, ThreadTeam

OUT_OF_RANGE = (
    "a voltage exceeds 1.8e308 V, the range of double precision: the currents fed in are too large for the "
    "conductances that carry them; check their units"
)

DIRECTION_RESIDUAL = 1e-6
"""Largest KCL violation of a direction-safe field, relative to the current through the node."""

HARMLESS = 1e-7
"""Share of a node's through-current that may be dropped where float64 values of its ends are equal."""

_LEAST_REST = 1e-3
"""Smallest height above the low rail, as a share of both rails' distance, that is read off the drop."""

_FAINT, _FAINT_IN_FEW = 1e-20, 1e-10
"""Differences of values, relative to them, that have few digits left: half of a double-double's; in small circuits,
where it costs little, those that the rounding of summed contacts may change."""

_NONE = -(2**62)
_ORDINARY = 2
"""Largest exponent of currents, and the negative of the smallest, that leaves their sums in the range of doubles."""


@dataclass(frozen=True, eq=False)
class NodeValues:
    """A value for every node, counted from one rail, or from the nearer one of two.

    `value` (nodes,): 0 where the node floats; `down` (nodes,): whether the value is a drop from the high rail, 1 unit
    above the low one; `zero, volts`: voltage of the low (or only) rail, and volts of a unit; negative where values
    grow as voltages fall; `noise`: relative difference of two values counted upwards below which it is noise;
    ``value.noise`` is that of drops; `doubt`: by how much any value may be off at most, relative to the largest,
    where currents of both signs drive the circuit; of all others nothing is said here.
    """

    value: Scaled
    down: NDArray[np.bool_]
    zero: float
    volts: float
    noise: float
    doubt: float = 0.0

    @property
    def height(self) -> NDArray[np.float64]:
        """Plain heights above the low rail, in units."""
        plain = self.value.plain
        return np.where(self.down, 1.0 - plain, plain) if self.down.any() else plain


def node_values(system: Equations, factors: Factor | None, watch: ProgressMonitor, team: ThreadTeam) -> NodeValues:
    """Solve for all that the currents of a circuit are read off."""
    if system.rails is not None:
        return _between(system, system.rails, *_drop_and_height(system.rails, factors, watch, team))
    drive = system.drive
    if not (np.any(drive < 0.0) and np.any(drive > 0.0)):
        sign = -1.0 if np.any(drive < 0.0) else 1.0
        (height,) = _solved(factors, [drive if sign > 0.0 else -drive], watch, team)
        return _above(system, height, sign)
    rising, falling = _solved(factors, [np.maximum(drive, 0.0), np.maximum(-drive, 0.0)], watch, team)
    difference = minus(rising, falling)
    doubt = watch.bound * quotient([rising, falling], difference)
    return replace(_above(system, difference, 1.0), doubt=doubt)


def values_above(system: Equations, heights: NDArray[np.float64]) -> NodeValues:
    """Values of all nodes from their heights above the reference, in volts, (nodes,); no difference is noise."""
    plain, zero, volts = _in_units(system, heights)
    value = Scaled.of(np.nan_to_num(plain))
    return NodeValues(value._replace(noise=0.0), np.zeros(len(plain), np.bool_), zero, volts, 0.0)


def _in_units(system: Equations, heights: NDArray[np.float64]) -> tuple[NDArray[np.float64], float, float]:
    """Heights above the low (or only) rail, in units (nodes,), a new array; that rail's voltage, volts of a unit."""
    zero, volts = system.reference, 1.0 if np.any(heights > 0.0) else -1.0
    if system.rails is not None:
        zero, volts = system.rails.low, system.rails.high - system.rails.low
    return (heights + (system.reference - zero)) / volts, zero, volts


def _drop_and_height(
    rails: Rails, factors: Factor | None, watch: ProgressMonitor, team: ThreadTeam
) -> tuple[Scaled, Scaled | None]:
    """The drop from the high rail, and the height above the low one where it is no mere rest of the drop.

    All that flows into the low rail comes from the high one: ``to_low * height`` is at most the sum of ``to_high``.
    Where that says that both are needed, they are solved at once.
    """
    currents = [rails.to_low]
    if team.size > 1 and (to_high := rails.to_high).sum() < _LEAST_REST * currents[0].max(initial=0.0):
        currents.append(to_high)
    drop, *height = _solved(factors, currents, watch, team)
    if drop.plain.max(initial=0.0) < 1.0 - _LEAST_REST:  # the height ``1 - drop`` is nowhere a small difference
        return drop, None
    return drop, (height or _solved(factors, [rails.to_high], watch, team))[0]


def _solved(
    factors: Factor | None, currents: list[NDArray[np.float64]], watch: ProgressMonitor, team: ThreadTeam
) -> list[Scaled]:
    """Solve for right-hand sides of one sign each, side by side; an interrupt stops all."""

    def one(rhs: NDArray[np.float64]) -> Scaled:
        if factors is None or not rhs.any():
            return Scaled.of(np.zeros(len(rhs)))
        try:
            return factors.solve_nonnegative(rhs, watch=watch)[0]
        except KeyboardInterrupt:
            watch.stop()
            raise

    return team.together([partial(one, rhs) for rhs in currents])


def _between(system: Equations, rails: Rails, drop: Scaled, height: Scaled | None) -> NodeValues:
    """Spread drops, and heights where they were solved for, over the nodes: whichever of both is smaller."""
    far = np.flatnonzero((drop.exponent >= 0) & (drop.hi > 0.5))
    there = drop if height is None else height
    up = Scaled(there.hi[far], there.lo[far], there.exponent[far])
    if height is None:
        up = minus(Scaled.of(np.ones(len(far))), up)
    rows = Scaled(drop.hi.copy(), drop.lo.copy(), drop.exponent.copy())
    rows.hi[far], rows.lo[far], rows.exponent[far] = up[:3]
    near = np.ones(len(drop.hi) + 1, dtype=np.bool_)
    near[far] = False
    span, known = rails.high - rails.low, system.known_voltages()
    below, above = (rails.high - known) / span, (known - rails.low) / span
    with np.errstate(invalid="ignore"):
        down = np.abs(below) < np.abs(above)
    np.copyto(down, near[system.unknown], where=system.unknown >= 0)
    value = _spread(system, rows, np.where(down, below, above))
    noise = height.noise if height is not None else drop.noise / _LEAST_REST
    return NodeValues(value._replace(noise=drop.noise), down, rails.low, span, noise)


def _above(system: Equations, rows: Scaled, volts: float) -> NodeValues:
    """Spread heights above the reference over the nodes."""
    forest = system.forest
    out = _spread(system, rows, (system.known_voltages() - system.reference) / volts)
    lifted = (forest.height != 0) & (system.unknown[forest.order] >= 0)
    if lifted.any():
        # Floating sources occur only in circuits without two rails, whose values do not leave the range of a double.
        node = forest.order[lifted]
        out.hi[node] = out.hi[node] * power(out.exponent[node]) + forest.height[lifted] / volts
        out.lo[node] = out.exponent[node] = 0
    down = np.zeros(len(system.unknown), dtype=np.bool_)
    return NodeValues(out._replace(noise=rows.noise), down, system.reference, volts, rows.noise)


def _spread(system: Equations, rows: Scaled, known: NDArray[np.float64]) -> Scaled:
    """Values of all nodes: of their rows, or those that are ``known`` (nodes,), where NaN counts as 0."""
    solved, out = system.unknown >= 0, Scaled.of(np.nan_to_num(known))
    row = system.unknown[solved]
    for part, of_rows in zip(out[:3], rows[:3], strict=True):
        part[solved] = of_rows[row]
    return out


def read_normwise(system: Equations, x: NDArray[np.float64], **told: Any) -> OperatingPoint:
    """Spread a normwise solution (n,) over the nodes, with what is ``told`` of it; currents wait until asked for."""
    if not np.isfinite(x).all():
        raise CircuitError(OUT_OF_RANGE)
    heights = system.heights(x)
    potential = _potential(system, _in_units(system, heights)[0])
    point = OperatingPoint(
        system.netlist, system.above_ground(heights), None, potential, partial(_normwise_readings, system, heights),
        system.floating, system.undriven, **told,
    )  # fmt: skip
    if system.forest.loop.any():
        _ = point.readings  # warns of currents that are undetermined
    return point


def read_entrywise(
    system: Equations, values: NodeValues, team: ThreadTeam,
    found: Balanced | None = None, deep: BranchCurrents | None = None, **told: Any,
) -> tuple[OperatingPoint, NDArray[np.float64], bool]:  # fmt: skip
    """Read everything off the values of the nodes, with the voltages and currents that have been found by balancing.

    `deep`: readings of the values alone, for voltages and currents so small that balancing counts them as zero;
    `told`: what the point is to say of how it was solved.  Returns `residual` (nodes,), and whether currents that
    matter have few digits left.
    """
    voltage, (log_drop, potential) = team.together(
        [partial(_voltage, system, values), partial(_stored, system, values)]
    )
    upwards = np.sign(values.volts)
    falling = None if potential is None else upwards * potential if log_drop is None else -upwards * log_drop
    unknown = system.unknown
    if found is not None:
        unknown = np.where(found.excused, -1, unknown)
        if system.rails is None or np.isfinite(found.entry_error):
            lost = (
                (found.volts == 0.0) & (np.abs(voltage) <= _least(found.volts, found.floor))
                if deep is not None
                else False
            )
            voltage = np.where(lost, voltage, found.volts)
        if system.netlist.cell_map is None:  # falls tell voltages apart that are the same doubles
            falling = None
    readings, residual, faint = _read(system.netlist, system.forest, unknown, values, team, falling, found, deep)
    point = OperatingPoint(
        system.netlist, voltage, log_drop, potential, readings, system.floating, system.undriven, **told
    )
    return point, residual, faint


def _normwise_readings(system: Equations, heights: NDArray[np.float64]) -> BranchCurrents:
    return _read(system.netlist, system.forest, system.unknown, values_above(system, heights))[0]


def _read(
    netlist: Netlist, forest: SourceForest, unknown: NDArray[np.int32], values: NodeValues,
    team: ThreadTeam = SINGLE_THREAD, falling: NDArray[np.float64] | None = None, found: Balanced | None = None,
    deep: BranchCurrents | None = None,
) -> tuple[BranchCurrents, NDArray[np.float64], bool]:  # fmt: skip
    """Take currents that have been found, or differences of values, and sum them up at every node.

    What is ``falling`` (nodes,) falls along currents up to rounding, and along every one that matters after this:
    others are set to 0.  Nodes that floating sources join count as one.  Returns `residual` (nodes,), and whether
    differences have few digits left at currents that matter to either end's: between cells that mirror each other such
    a difference is rounding, beside others.
    """
    from resgrid.circuit.kernels import drop_unresolved

    ends, faint = netlist.resistor_nodes, np.zeros(0, dtype=np.int64)
    if found is None:
        amps, exponent, heat, faint = _differences(values, netlist, team)
    else:
        amps, exponent, heat = found.amps, np.zeros(len(ends), dtype=np.int64), found.power
        if deep is not None:
            amps, exponent = _deepened(amps, found.floor, *deep.scaled)
    plain = not exponent.any()
    frame, net, through = _sums(netlist, amps, exponent)
    if falling is not None:
        drop_unresolved(ends, amps, exponent, frame, net, through, falling, HARMLESS)
    value = values.value
    high, low = (part[ends[faint]] * power(value.exponent[ends[faint]]) for part in (value.hi, value.lo))
    apart = netlist.conductance[faint] * np.abs(values.volts * (np.diff(high)[:, 0] + np.diff(low)[:, 0]))
    matters = apart > HARMLESS * through[ends[faint]].min(axis=1)
    residual = np.zeros(len(unknown))
    net_amps, through_amps = (net, through) if plain else (net * power(frame), through * power(frame))
    if np.any(forest.base != GROUND):
        root = forest.root
        net, through = (
            np.asarray(np.bincount(root, part)[root], dtype=np.float64) for part in (net_amps, through_amps)
        )

    np.divide(np.abs(net), through, out=residual, where=(unknown >= 0) & (through > 0))
    readings = BranchCurrents(
        resistor_current=amps if plain else amps * power(exponent),
        scaled=(amps, np.broadcast_to(np.int64(0), len(amps)) if plain else exponent),
        source_current=(
            source_currents(netlist, forest, -net_amps, through_amps) if found is None else found.source_amps
        ),
        power=heat,
        kcl_residual=float(residual.max(initial=0.0)),
    )
    return readings, residual, plain and bool(matters.any())


def _differences(
    values: NodeValues, netlist: Netlist, team: ThreadTeam
) -> tuple[NDArray[np.float64], NDArray[np.int64], float, NDArray[np.int64]]:
    """Currents ``amps, exponent`` (resistors,), the latter 0 where doubles hold all; the power; which are faint."""
    from resgrid.circuit.kernels import currents

    ends, amps = netlist.resistor_nodes, np.empty(len(netlist.conductance))
    exponent, faint = np.empty(len(amps), dtype=np.int64), np.zeros(len(amps), dtype=np.bool_)
    few = _FAINT if netlist.node_count > EXACT_ROWS else _FAINT_IN_FEW

    def through(piece: slice) -> float:
        return currents(
            ends[piece], netlist.conductance[piece], values.value, values.down, values.volts, values.noise,
            amps[piece], exponent[piece], few, faint[piece],
        )  # fmt: skip

    heat = sum(team.over(len(amps), through))
    if exponent.any() and np.abs(exponent).max() <= _ORDINARY:
        amps *= power(exponent)
        exponent[:] = 0
    return amps, exponent, heat, np.flatnonzero(faint)


def _deepened(
    amps: NDArray[np.float64], floor: float, deep: NDArray[np.float64], exponent: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Replace currents that count as zero by ``deep * 2**(256 exponent)`` where that lies below the floor, too."""
    lost = (amps == 0.0) & (np.abs(deep * power(exponent)) <= _least(amps, floor))
    return np.where(lost, deep, amps), np.where(lost, exponent, 0)


def _least(values: NDArray[np.float64], floor: float) -> float:
    """Return the magnitude up to which values may have been counted as zero."""
    return float(np.nanmax(np.abs(values), initial=0.0)) * floor


def _sums(
    netlist: Netlist, amps: NDArray[np.float64], exponent: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Kirchhoff's current law at every node, in units of ``2**(256 frame)`` amperes, about the largest current there.

    Shapes: `amps, exponent` (resistors,); returns `frame`, `net` into the node, and `through`, half the sum of all
    magnitudes, (nodes,).
    """
    from resgrid.circuit.kernels import add_currents

    net, ends = injected_currents(netlist), netlist.resistor_nodes
    frame = np.zeros(len(net), dtype=np.int64)
    if exponent.any():
        own, flows = frame.copy(), amps != 0.0
        canonical(net, own)
        frame[:] = np.where(net != 0, own, _NONE)
        for end in ends.T:
            np.maximum.at(frame, end[flows], exponent[flows])
        frame[frame == _NONE] = 0
        net *= power(np.where(net != 0, own - frame, 0))
    through = np.abs(net)
    add_currents(ends, amps, exponent, frame, net, through)
    through *= 0.5
    return frame, net, through


def _stored(system: Equations, values: NodeValues) -> tuple[NDArray[np.float64] | None, NDArray[np.float64] | None]:
    """``log_drop`` and ``potential`` of every node, where they exist."""
    potential = _potential(system, values.height)
    if system.rails is None or potential is None:
        return None, potential
    log_drop, above = values.value.log, np.flatnonzero(~values.down)
    log_drop[above] = np.log1p(-potential[above])
    held = (system.unknown < 0) & (potential > 0.0) & (potential < 1.0)
    log_drop[held | np.isnan(potential)] = np.nan
    return log_drop, potential


def _potential(system: Equations, height: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """The ``height`` above the low of two rails, or above the only one if currents of one sign are all that drives.

    A new array (nodes,), which is made use of; None where there is no such potential.
    """
    solved = system.unknown >= 0
    if system.rails is not None:
        height[~solved & ((height < 0) | (height > 1))] = np.nan
    else:
        injected, top = system.injected, height.max(initial=0.0, where=solved)
        if system.feed.any() or (np.any(injected < 0) and np.any(injected > 0)) or not top > 0:
            return None
        height /= top
    height[system.floating] = np.nan
    return height


def _voltage(system: Equations, values: NodeValues) -> NDArray[np.float64]:
    plain = values.value.plain
    with np.errstate(over="ignore"):
        volts = values.zero + values.volts * plain
    if not np.isfinite(volts[system.unknown >= 0]).all():
        raise CircuitError(OUT_OF_RANGE)
    if system.rails is not None:
        volts = np.where(values.down, system.rails.high - values.volts * plain, volts)
    return np.where(system.unknown >= 0, volts, system.known_voltages())
