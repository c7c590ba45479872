"""From solutions of the nodal equations to operating points: node voltages, branch currents, power, residuals.

The value of a node is its voltage difference from the nearer rail.  A branch current is computed from the difference of
two values before any rounding.  With two rails, the system is solved for the drop ``u`` from the high rail, and again
for the voltage above the low rail if ``1 - u`` cancels.  Source currents of both signs are two right-hand sides.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.cancellation import RecoveredCurrents, floor_of, with_tiny_values
from resgrid.circuit.equations import Equations, injected_currents
from resgrid.circuit.operating_point import OUT_OF_RANGE, BranchCurrents, OperatingPoint
from resgrid.circuit.sources import SourceForest, source_currents
from resgrid.core.netlist import GROUND, Netlist
from resgrid.errors import CircuitError
from resgrid.solvers.factors import EXACT_ROWS, Factor
from resgrid.solvers.laplacian import Rails
from resgrid.solvers.progress import ProgressMonitor
from resgrid.solvers.refinement import minus, quotient
from resgrid.solvers.scaled import BITS, Scaled, canonical, divided, power, unscaled
from resgrid.solvers.threads import SINGLE_THREAD, ThreadTeam

DIRECTION_RESIDUAL = 1e-6
"""Largest KCL violation at a node of a direction-safe field, as a fraction of the current through the node."""

HARMLESS = 1e-7
"""Largest current up the potential that is set to 0, as a fraction of the smaller current through its end nodes."""

_LEAST_COMPLEMENT = 1e-3
"""Smallest voltage above the low rail, over the voltage between the rails, that is computed as one minus the drop."""

_IMPRECISE, _IMPRECISE_IN_SMALL = 1e-20, 1e-10
"""Relative difference of two node values up to which a current is imprecise: above 20,000 nodes, else the second."""

_LEAST_VOLTS = 2.0**-400
"""Smallest voltage between the rails, in volts, without scaling; a smaller one is multiplied by a power of two."""

_NO_EXPONENT = -(2**62)
_PLAIN_EXPONENT = 2
"""Largest magnitude of the exponents of ``2**256`` for which sums of currents stay in the range of doubles."""


@dataclass(frozen=True, eq=False)
class NodeValues:
    """Voltage difference of every node from the nearer of two rails, or from the only one, in units of `volts`.

    `value` (nodes,): 0 where the node floats; `is_drop` (nodes,): whether the value is the drop from the high rail,
    1 unit above the low one, and not the voltage above the low rail; `zero`: voltage of the low (or only) rail in V;
    `volts`: size of a unit in volts, negative if values grow as voltages fall; `rounding`: relative difference of two
    voltages above the low rail up to which it is a rounding error (``value.noise`` for drops); `error_bound`: bound on
    the error of a value relative to the largest value, for source currents of both signs, else 0 (not computed).
    """

    value: Scaled
    is_drop: NDArray[np.bool_]
    zero: float
    volts: float
    rounding: float
    error_bound: float = 0.0

    @property
    def height(self) -> NDArray[np.float64]:
        """Voltages of all nodes above the low rail as doubles, in units of ``self.volts`` volts, shape (nodes,)."""
        plain = self.value.plain
        return np.where(self.is_drop, 1.0 - plain, plain) if self.is_drop.any() else plain


def node_values(system: Equations, factors: Factor | None, watch: ProgressMonitor, team: ThreadTeam) -> NodeValues:
    """Return the voltage of every node from the nearer rail; `factors`: factors of the matrix, None without rows."""
    if system.rails is not None:
        return _between(system, system.rails, *_drop_and_height(system.rails, factors, watch, team))
    drive = system.drive
    if not (np.any(drive < 0.0) and np.any(drive > 0.0)):
        sign = -1.0 if np.any(drive < 0.0) else 1.0
        (height,) = _solved(factors, [drive if sign > 0.0 else -drive], watch, team)
        return _above(system, height, sign)
    rising, falling = _solved(factors, [np.maximum(drive, 0.0), np.maximum(-drive, 0.0)], watch, team)
    difference = minus(rising, falling)
    error_bound = watch.bound * quotient([rising, falling], difference)
    return replace(_above(system, difference, 1.0), error_bound=error_bound)


def values_above(system: Equations, heights: NDArray[np.float64]) -> NodeValues:
    """Return node values without rounding errors; `heights` (nodes,): exact volts above the lowest known voltage."""
    above, zero, volts = _above_low_rail(system, heights)
    value = divided(above, volts)
    value = value._replace(hi=np.nan_to_num(value.hi), noise=0.0)
    return NodeValues(value, np.zeros(len(heights), np.bool_), zero, volts, 0.0)


def _above_low_rail(system: Equations, heights: NDArray[np.float64]) -> tuple[NDArray[np.float64], float, float]:
    """Return voltages above the low (or only) rail (nodes,), the rail's voltage, and the unit of values, all in volts.

    `heights` (nodes,): voltages above ``system.reference``, in volts.  Unit: voltage between the rails, else 1 or -1 V.
    """
    zero, volts = system.reference, 1.0 if np.any(heights > 0.0) else -1.0
    if system.rails is not None:
        zero, volts = system.rails.low, system.rails.high - system.rails.low
    return heights + (system.reference - zero), zero, volts


def _drop_and_height(
    rails: Rails, factors: Factor | None, watch: ProgressMonitor, team: ThreadTeam
) -> tuple[Scaled, Scaled | None]:
    """Return drops (n,) from the high rail, and voltages (n,) above the low rail, over the voltage between the rails.

    The voltages ``h`` are None if ``1 - drop`` is accurate.  With several threads both systems are solved together if
    some ``h`` must be small: ``to_low h <= sum(to_high)`` for the conductances from each row to the rails.
    """
    currents = [rails.to_low]
    if team.size > 1 and (to_high := rails.to_high).sum() < _LEAST_COMPLEMENT * currents[0].max(initial=0.0):
        currents.append(to_high)
    drop, *height = _solved(factors, currents, watch, team)
    if drop.plain.max(initial=0.0) < 1.0 - _LEAST_COMPLEMENT:  # the height ``1 - drop`` cancels at no node
        return drop, None
    return drop, (height or _solved(factors, [rails.to_high], watch, team))[0]


def _solved(
    factors: Factor | None, currents: list[NDArray[np.float64]], watch: ProgressMonitor, team: ThreadTeam
) -> list[Scaled]:
    """Return the solutions (n,) for several non-negative right-hand sides (n,), in amperes, computed in parallel."""

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
    """Return values of all nodes, in units of the voltage between the rails.

    `drop`, `height` (n,): drops of the rows from the high rail, and voltages of the rows above the low rail (None: use
    ``1 - drop``), in this unit, in double-double.  A value is the drop up to 0.5, else the voltage above the low rail.
    """
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
    below, above = rails.high - known, known - rails.low
    with np.errstate(invalid="ignore"):
        is_drop = np.abs(below) < np.abs(above)
    np.copyto(is_drop, near[system.unknown], where=system.unknown >= 0)
    value = rows_to_nodes(system, rows, divided(np.where(is_drop, below, above), span))
    rounding = height.noise if height is not None else drop.noise / _LEAST_COMPLEMENT
    return NodeValues(value._replace(noise=drop.noise), is_drop, rails.low, span, rounding)


def _above(system: Equations, rows: Scaled, volts: float) -> NodeValues:
    """Return node values in units of `volts` V above the lowest known voltage; `rows` (n,): values of the rows."""
    forest = system.forest
    out = rows_to_nodes(system, rows, divided(system.known_voltages() - system.reference, volts))
    lifted = (forest.height != 0) & (system.unknown[forest.order] >= 0)
    if lifted.any():
        # Circuits with floating sources do not have two rails, and their values stay in the range of doubles.
        node = forest.order[lifted]
        out.hi[node] = out.hi[node] * power(out.exponent[node]) + forest.height[lifted] / volts
        out.lo[node] = out.exponent[node] = 0
    is_drop = np.zeros(len(system.unknown), dtype=np.bool_)
    return NodeValues(out._replace(noise=rows.noise), is_drop, system.reference, volts, rows.noise)


def rows_to_nodes(system: Equations, rows: Scaled, known: Scaled) -> Scaled:
    """Return values of all nodes (nodes,): `rows` (n,) where a node has a row, else `known` (nodes,) with 0 for NaN."""
    solved, out = system.unknown >= 0, known._replace(hi=np.nan_to_num(known.hi))
    row = system.unknown[solved]
    for part, of_rows in zip(out[:3], rows[:3], strict=True):
        part[solved] = of_rows[row]
    return out


def read_normwise(system: Equations, x: NDArray[np.float64], **details: Any) -> OperatingPoint:
    """Return the operating point of a normwise solution; branch currents are computed at the first access.

    `x` (n,): voltages of the rows above the lowest known voltage, in volts; `details`: further fields of the operating
    point, by name.
    """
    if not np.isfinite(x).all():
        raise CircuitError(OUT_OF_RANGE)
    heights = system.heights(x)
    above, _, volts = _above_low_rail(system, heights)
    with np.errstate(over="ignore"):  # the voltage of a held node may exceed a subnormal unit by any factor
        potential = _potential(system, above / volts)
    point = OperatingPoint(
        system.netlist, system.above_ground(heights), None, potential, partial(_normwise_currents, system, heights),
        system.floating, system.undriven, **details,
    )  # fmt: skip
    if system.forest.loop.any():
        _ = point.readings  # warn now that the currents of source loops are undetermined
    return point


def read_entrywise(
    system: Equations, values: NodeValues, team: ThreadTeam,
    recovered: RecoveredCurrents | None = None, tiny: BranchCurrents | None = None, **details: Any,
) -> tuple[OperatingPoint, NDArray[np.float64], bool]:  # fmt: skip
    """Return operating point, relative KCL residuals (nodes,), whether currents above `HARMLESS` lack correct digits.

    A residual is divided by the through-current.  `values`: node values; `recovered`: voltages and currents from
    `resgrid.circuit.current_recovery`, or None; `tiny`: currents from the node values, which replace recovered currents
    that were set to zero, or None; `details`: further fields of the operating point.
    """
    voltage, (log_drop, potential) = team.together(
        [partial(_voltage, system, values), partial(_log_drop_and_potential, system, values)]
    )
    upwards = np.sign(values.volts)
    falling = None if potential is None else upwards * potential if log_drop is None else -upwards * log_drop
    unknown = system.unknown
    if recovered is not None:
        unknown = np.where(recovered.unchecked, -1, unknown)
        if system.rails is None or np.isfinite(recovered.entry_error):
            lost = (recovered.volts == 0.0) & (np.abs(voltage) <= floor_of(recovered.volts, recovered.floor))
            voltage = np.where(lost & (tiny is not None), voltage, recovered.volts)
        if system.netlist.space_map is None:  # recovered currents may flow between voltages that round to equal doubles
            falling = None
    netlist = system.netlist
    parts = _branch_currents(netlist, system.forest, unknown, values, team, falling, recovered, tiny)
    point = OperatingPoint(netlist, voltage, log_drop, potential, parts[0], system.floating, system.undriven, **details)
    return point, *parts[1:]


def _normwise_currents(system: Equations, heights: NDArray[np.float64]) -> BranchCurrents:
    return _branch_currents(system.netlist, system.forest, system.unknown, values_above(system, heights))[0]


def _branch_currents(
    netlist: Netlist, forest: SourceForest, unknown: NDArray[np.int32], values: NodeValues,
    team: ThreadTeam = SINGLE_THREAD, falling: NDArray[np.float64] | None = None,
    recovered: RecoveredCurrents | None = None, tiny: BranchCurrents | None = None,
) -> tuple[BranchCurrents, NDArray[np.float64], bool]:  # fmt: skip
    """Return branch currents, relative KCL residuals (nodes,), whether currents above `HARMLESS` lack correct digits.

    `unknown` (nodes,): row of a node, -1 where KCL is not checked; `falling` (nodes,): values that fall along currents;
    negligible currents against them, as between mirror-symmetric cells, are rounding errors and are set to 0 (if None,
    all currents stay); `recovered`: recovered currents, or None; `tiny`: currents that replace recovered currents of 0,
    or None.  Nodes joined by floating sources count as one node.
    """
    from resgrid.circuit.kernels import drop_unresolved

    ends, imprecise = netlist.resistor_nodes, np.zeros(0, dtype=np.int64)
    if recovered is None:
        amps, exponent, heat, imprecise = differences(values, netlist, team)
    else:
        amps, exponent, heat = recovered.amps, np.zeros(len(ends), dtype=np.int64), recovered.power
        if tiny is not None:
            amps, exponent = with_tiny_values(amps, recovered.floor, *tiny.scaled)
    plain = not exponent.any()
    frame, net, through = node_sums(netlist, amps, exponent)
    if falling is not None:
        drop_unresolved(ends, amps, exponent, frame, net, through, falling, HARMLESS)
    value = values.value
    pairs = ends[imprecise]
    high, low = (unscaled(part[pairs], value.exponent[pairs]) for part in (value.hi, value.lo))
    size = netlist.conductance[imprecise] * np.abs(values.volts * (np.diff(high)[:, 0] + np.diff(low)[:, 0]))
    is_significant = size > HARMLESS * through[pairs].min(axis=1)
    residual = np.zeros(len(unknown))
    net_amps, through_amps = (net, through) if plain else (unscaled(net, frame), unscaled(through, frame))
    if np.any(forest.base != GROUND):
        root = forest.root
        net, through = (
            np.asarray(np.bincount(root, part)[root], dtype=np.float64) for part in (net_amps, through_amps)
        )

    np.divide(np.abs(net), through, out=residual, where=(unknown >= 0) & (through > 0))
    currents = BranchCurrents(
        resistor_current=amps if plain else unscaled(amps, exponent),
        scaled=(amps, np.broadcast_to(np.int64(0), len(amps)) if plain else exponent),
        source_current=(
            source_currents(netlist, forest, -net_amps, through_amps) if recovered is None else recovered.source_amps
        ),
        power=heat,
        kcl_residual=float(residual.max(initial=0.0)),
    )
    return currents, residual, plain and bool(is_significant.any())


def differences(
    values: NodeValues, netlist: Netlist, team: ThreadTeam
) -> tuple[NDArray[np.float64], NDArray[np.int64], float, NDArray[np.int64]]:
    """Return branch currents (first to second node), exponents, total power in watts, indices of imprecise currents.

    The currents are ``amps * 2**(256 exponent)`` A, (resistors,); the exponents are all 0 if doubles are sufficient.
    The power is that of all resistors.  A current is imprecise if the values at its ends differ, but by at most 1e-10
    of a value (1e-20 above 20,000 nodes) or by at most the rounding error of the values.
    """
    from resgrid.circuit.kernels import currents

    ends, amps = netlist.resistor_nodes, np.empty(len(netlist.conductance))
    exponent, imprecise = np.empty(len(amps), dtype=np.int64), np.zeros(len(amps), dtype=np.bool_)
    threshold = _IMPRECISE if netlist.node_count > EXACT_ROWS else _IMPRECISE_IN_SMALL
    steps = max(-(int(np.frexp(values.volts)[1]) // BITS), 0) if abs(values.volts) < _LEAST_VOLTS else 0
    volts = float(np.ldexp(values.volts, BITS * steps))

    def power_of(piece: slice) -> float:
        return currents(
            ends[piece], netlist.conductance[piece], values.value, values.is_drop, volts, values.rounding,
            amps[piece], exponent[piece], threshold, imprecise[piece],
        )  # fmt: skip

    heat = sum(team.over(len(amps), power_of))
    if steps:
        exponent[amps != 0.0] -= steps
        plain = unscaled(amps, exponent)
        heat = float(np.sum(plain * (plain / netlist.conductance)))
    if exponent.any() and np.abs(exponent).max() <= _PLAIN_EXPONENT:
        amps *= power(exponent)
        exponent[:] = 0
    return amps, exponent, heat, np.flatnonzero(imprecise)


def node_sums(
    netlist: Netlist, amps: NDArray[np.float64], exponent: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Return exponents ``f``, net currents and through-currents of all nodes, (nodes,) each.

    Through-currents are half the sums of the magnitudes.  The currents of a node are in units of ``2**(256 f)`` A, with
    the largest exponent ``f`` at the node.  `amps`, `exponent` (resistors,): currents ``amps * 2**(256 exponent)`` A.
    """
    from resgrid.circuit.kernels import add_currents

    net, ends = injected_currents(netlist), netlist.resistor_nodes
    frame = np.zeros(len(net), dtype=np.int64)
    if exponent.any():
        own, flows = frame.copy(), amps != 0.0
        canonical(net, own)
        frame[:] = np.where(net != 0, own, _NO_EXPONENT)
        for end in ends.T:
            np.maximum.at(frame, end[flows], exponent[flows])
        frame[frame == _NO_EXPONENT] = 0
        net *= power(np.where(net != 0, own - frame, 0))
    through = np.abs(net)
    add_currents(ends, amps, exponent, frame, net, through)
    through *= 0.5
    return frame, net, through


def _log_drop_and_potential(
    system: Equations, values: NodeValues
) -> tuple[NDArray[np.float64] | None, NDArray[np.float64] | None]:
    """Return log drops (two rails) and potentials (or one rail and currents of one sign), (nodes,) each; else None."""
    potential = _potential(system, values.height)
    if system.rails is None or potential is None:
        return None, potential
    log_drop, above = values.value.log, np.flatnonzero(~values.is_drop)
    with np.errstate(divide="ignore", invalid="ignore"):  # before the recovery of currents, a potential may exceed 1
        log_drop[above] = np.log1p(-potential[above])
    held = (system.unknown < 0) & (potential > 0.0) & (potential < 1.0)
    log_drop[held | np.isnan(potential)] = np.nan
    return log_drop, potential


def _potential(system: Equations, height: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return potentials (nodes,), 0 at the low or only rail and 1 at the other rail or at the highest node.

    None unless two rails, or one rail and injected currents of one sign, drive the rows.  `height` (nodes,): voltages
    above the low rail in units of the voltage between the rails (with one rail: in any unit), overwritten.
    """
    solved = system.unknown >= 0
    if system.rails is not None:
        height[~solved & ((height < 0) | (height > 1))] = np.nan
    else:
        injected, top = system.injected, height.max(initial=0.0, where=solved)
        if system.feed.any() or (np.any(injected < 0) and np.any(injected > 0)) or not top > 0:
            return None
        with np.errstate(over="ignore"):  # a held node apart from the rows may exceed a subnormal `top` by any factor
            height /= top
    height[system.floating] = np.nan
    return height


def _voltage(system: Equations, values: NodeValues) -> NDArray[np.float64]:
    """Return the node voltages above ground, in volts, (nodes,); raise CircuitError if one overflows."""
    plain = values.value.plain
    with np.errstate(over="ignore"):
        volts = values.zero + values.volts * plain
    if not np.isfinite(volts[system.unknown >= 0]).all():
        raise CircuitError(OUT_OF_RANGE)
    if system.rails is not None:
        volts = np.where(values.is_drop, system.rails.high - values.volts * plain, volts)
    return np.where(system.unknown >= 0, volts, system.known_voltages())
