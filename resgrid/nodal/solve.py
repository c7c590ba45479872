"""Solve a netlist: assemble, factor, substitute, read off, and refuse what is not as accurate as promised."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import AccuracyError, InputError
from resgrid.netlist import Netlist
from resgrid.nodal import readout
from resgrid.nodal.factor import Factor
from resgrid.nodal.methods import factor_system
from resgrid.nodal.operating_point import OperatingPoint, Readings
from resgrid.nodal.plain import read_plain
from resgrid.nodal.readout import Balance, Levels
from resgrid.nodal.scaled import Scaled
from resgrid.nodal.side_by_side import side_by_side
from resgrid.nodal.sources import source_currents
from resgrid.nodal.system import NodalSystem, Rails, assemble
from resgrid.nodal.watch import Progress, Watch

ACCURACIES = ("direction", "normwise")

DIRECTION_RESIDUAL = 1e-6
"""Largest KCL violation of a direction-safe field, relative to the current through the node."""

CONVERGED = 1e-12
"""Componentwise backward error above which an entrywise answer is a failure."""

_FLAT = 1e-12

_LEAST_REST = 1e-3
"""Smallest height above the low rail, as a share of both rails' distance, that is read off the drop."""


def solve(
    netlist: Netlist,
    *,
    accuracy: str = "direction",
    method: str = "auto",
    rtol: float = 1e-10,
    threads: int = 1,
    progress: Progress | None = None,
) -> OperatingPoint:
    """Find the operating point of a netlist.

    Parameters
    ----------
    netlist : Netlist
        Resistors and sources; capacitors are open.  With nonlinear resistors the voltages come from Newton's method.
    accuracy : {"direction", "normwise"}
        ``"direction"``: at every driven node KCL holds to 1e-6 of the current through that same node, so that the way
        down is right everywhere; entrywise accurate where the circuit has two rails, or one and currents of one sign.
        ``"normwise"``: only the backward error is held below ``rtol``.
    method : {"auto", "direct", "multigrid"}
        How to solve; ``"auto"`` chooses by size and shape (`resgrid.nodal.methods.choose_method`); the operating point
        says what it chose.  Nodes with at most two neighbours are eliminated beforehand where that pays; where nothing
        is left, as in corridors of one or two cells, the method is reported as ``"elimination"``.
    rtol : float
        Backward error for ``"normwise"``.
    threads : int
        How many right-hand sides may be solved at the same time.  A field whose ties to the high rail are weak takes
        two (the drop from that rail, and the height above the other), and so do current sources of both signs; the
        digits are the same.
    progress : callable, optional
        Called after every step of an iterative method with the steps so far, the residual relative to where the
        present pass began, and about how many seconds that pass still takes (None where nothing is gained).  With
        several threads it is called from each.

    Returns
    -------
    OperatingPoint

    Raises
    ------
    InputError
        If an option is unknown.
    CircuitError
        If sources contradict each other, nothing is driven, or current sources exceed what nonlinear resistors carry.
    AccuracyError
        If the promised accuracy is not reached; it carries the best answer.
    BudgetError
        If the factors would not fit in memory.
    """
    _check_options(accuracy, rtol, threads)
    if netlist.nonlinear_nodes.size:
        from resgrid.nodal.secant import solve_nonlinear

        return solve_nonlinear(netlist, accuracy=accuracy, method=method, rtol=rtol, progress=progress)
    watch = Watch(progress)
    seconds: dict[str, float] = {}
    with _timed(seconds, "assemble"):
        system = assemble(netlist)
    with _timed(seconds, "factor"):
        factors = factor_system(system, method, accuracy=accuracy) if system.size else None
    name = factors.name if factors else "none"
    if accuracy == "normwise":
        with _timed(seconds, "substitute"):
            x = factors.solve(system.drive, rtol=rtol, watch=watch) if factors else np.zeros(0)
            del factors
        with _timed(seconds, "read"):
            point = read_plain(system, x, name, seconds)
        return replace(point, iterations=watch.iterations, backward_error=watch.error)
    with _timed(seconds, "substitute"):
        levels = _entrywise_levels(system, factors, watch, threads)
    with _timed(seconds, "read"):
        point, sums = _read_off(system, levels, name, seconds)
    point = replace(point, iterations=watch.iterations, backward_error=watch.error)
    _check_direction(system, levels, point, sums)
    return point


def factor(netlist: Netlist, *, method: str = "auto") -> Factor:
    """Factor a netlist once, for many right-hand sides.

    Parameters
    ----------
    netlist : Netlist
    method : {"auto", "direct", "multigrid"}

    Returns
    -------
    Factor
        With ``solve(rhs)`` for currents into the rows of its ``system``.

    Raises
    ------
    InputError
        If the netlist has nonlinear resistors, or no unknown voltage.
    """
    if netlist.nonlinear_nodes.size:
        raise InputError(
            "a netlist with nonlinear resistors has no factors; factor small_signal(point), the circuit around one of "
            "its operating points"
        )
    system = assemble(netlist)
    if not system.size:
        raise InputError("there is nothing to factor: the rails hold every node")
    return factor_system(system, method)


def _check_options(accuracy: str, rtol: float, threads: int) -> None:
    if accuracy not in ACCURACIES:
        raise InputError(f"accuracy = {accuracy!r} is unknown; it may be one of {', '.join(ACCURACIES)}")
    if not 0 < rtol < 1:
        raise InputError(f"rtol = {rtol} must lie between 0 and 1")
    if threads < 1:
        raise InputError(f"threads = {threads} must be at least 1")


@contextmanager
def _timed(seconds: dict[str, float], stage: str) -> Iterator[None]:
    start = time.perf_counter()
    yield
    seconds[stage] = time.perf_counter() - start


def _entrywise_levels(system: NodalSystem, factors: Factor | None, watch: Watch, threads: int) -> list[Levels]:
    """Node values in the representations that the circuit allows."""
    if system.rails is not None:
        rails = system.rails
        span = rails.high - rails.low
        drop, height = _drop_and_height(rails, factors, watch, threads)
        return [
            readout.at_nodes(system, height, rails.low, span),
            readout.at_nodes(system, drop, rails.high, -span),
        ]
    drive = system.drive
    rising, falling = _solved(factors, [np.maximum(drive, 0.0), np.maximum(-drive, 0.0)], watch, threads)
    if not np.any(drive < 0):
        return [readout.at_nodes(system, rising, system.reference, 1.0)]
    if not np.any(drive > 0):
        return [readout.at_nodes(system, falling, system.reference, -1.0)]
    return [readout.at_nodes(system, _minus(rising, falling), system.reference, 1.0)]


def _drop_and_height(rails: Rails, factors: Factor | None, watch: Watch, threads: int) -> tuple[Scaled, Scaled]:
    """The drop from the high rail and the height above the low one; at once, where both are sure to be needed.

    All that flows into the low rail comes from the high one: ``to_low * height`` is at most the sum of ``to_high``.
    """
    if threads > 1 and rails.to_high.sum() < _LEAST_REST * rails.to_low.max(initial=0.0):
        drop, height = _solved(factors, [rails.to_low, rails.to_high], watch, threads)
        return drop, _complement(drop) or height
    (drop,) = _solved(factors, [rails.to_low], watch, threads)
    return drop, _complement(drop) or _solved(factors, [rails.to_high], watch, threads)[0]


def _complement(drop: Scaled) -> Scaled | None:
    """The height above the low rail as what is left of the drop, where that is no small difference anywhere."""
    from resgrid.nodal.kernels import complement

    hi, lo = complement(drop.hi, drop.lo, drop.exponent)
    if not hi.min(initial=1.0) > _LEAST_REST:
        return None
    return Scaled(hi, lo, np.zeros(len(hi), dtype=np.int64), drop.noise / _LEAST_REST)


def _solved(factors: Factor | None, currents: list[NDArray[np.float64]], watch: Watch, threads: int) -> list[Scaled]:
    """Solve for right-hand sides of one sign each."""

    def one(rhs: NDArray[np.float64]) -> Scaled:
        if factors is None or not rhs.any():
            return Scaled.of(np.zeros(len(rhs)))
        return factors.solve_nonnegative(rhs, watch=watch)[0]

    return side_by_side([partial(one, rhs) for rhs in currents], threads, watch.stop)


def _minus(a: Scaled, b: Scaled) -> Scaled:
    from resgrid.nodal.refine_kernels import correct

    hi, lo, exponent = a.hi.copy(), a.lo.copy(), a.exponent.copy()
    correct(hi, lo, exponent, -b.hi, b.exponent)
    correct(hi, lo, exponent, -b.lo, b.exponent)
    return Scaled(hi, lo, exponent)


def _read_off(
    system: NodalSystem, levels: list[Levels], method: str, seconds: dict[str, float]
) -> tuple[OperatingPoint, Balance]:
    netlist = system.netlist
    log_drop, potential = _stored(system, levels)
    voltage = _voltage(system, levels)
    flow = readout.currents(netlist, levels)
    sums = readout.balance(netlist, flow)
    if len(levels) == 2 or potential is not None:
        flow = readout.drop_unresolved(netlist, flow, sums, _falling(_direction(system, levels), log_drop, potential))
        sums = readout.balance(netlist, flow)
    amps = flow.amps
    with np.errstate(under="ignore"):
        power = float(np.sum(amps * amps / netlist.conductance))
    point = OperatingPoint(
        netlist=netlist,
        voltage=voltage,
        log_drop=log_drop,
        potential=potential,
        ammeters=Readings(
            resistor_current=amps,
            resistor_log_current=flow.log_amps,
            resistor_direction=flow.direction,
            source_current=source_currents(netlist, system.forest, _outflow(netlist, amps)),
            power=power,
            kcl_residual=float(np.max(readout.relative_residual(system, sums), initial=0.0)),
        ),
        floating=system.floating,
        undriven=system.undriven,
        method=method,
        seconds=seconds,
    )
    return point, sums


def _stored(system: NodalSystem, levels: list[Levels]) -> tuple[NDArray[np.float64] | None, NDArray[np.float64] | None]:
    """``log_drop`` and ``potential`` of every node, where they exist."""
    undefined = np.zeros(system.netlist.node_count, dtype=np.bool_)
    undefined[system.floating] = True
    if len(levels) == 2:
        phi, u = levels[0].value.plain, levels[1].value.plain
        low = phi < 0.5
        with np.errstate(divide="ignore", invalid="ignore"):
            log_drop = np.where(low, np.log1p(-phi), levels[1].value.log)
        undefined |= (phi < 0) | (phi > 1)
        return np.where(undefined, np.nan, log_drop), np.where(undefined, np.nan, np.where(low, phi, 1.0 - u))
    height = levels[0].value.plain
    if system.rails is not None:
        rails = system.rails
        phi = (system.reference + height - rails.low) / (rails.high - rails.low)
        return None, np.where(undefined, np.nan, phi)
    top = height[system.unknown >= 0].max(initial=0.0)
    one_rail = not system.feed.any() and (np.all(system.injected >= 0) or np.all(system.injected <= 0))
    if not (one_rail and top > 0):
        return None, None
    return None, np.where(undefined, np.nan, height / top)


def _direction(system: NodalSystem, levels: list[Levels]) -> float:
    """Whether the voltage rises or falls with the potential."""
    return system.rails.high - system.rails.low if system.rails is not None else levels[0].volts


def _falling(
    volts: float, log_drop: NDArray[np.float64] | None, potential: NDArray[np.float64] | None
) -> NDArray[np.float64]:
    """A stored node value that falls along every current."""
    if log_drop is not None:
        return np.asarray(-np.sign(volts) * log_drop)
    assert potential is not None
    return np.asarray(np.sign(volts) * potential)


def _voltage(system: NodalSystem, levels: list[Levels]) -> NDArray[np.float64]:
    if system.rails is not None and len(levels) == 2:
        rails: Rails = system.rails
        phi, u = levels[0].value.plain, levels[1].value.plain
        span = rails.high - rails.low
        solved = np.where(phi < 0.5, rails.low + span * phi, rails.high - span * u)
    else:
        solved = system.reference + levels[0].volts * levels[0].value.plain
    return np.where(system.unknown >= 0, solved, system.known)


def _outflow(netlist: Netlist, amps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Current that leaves every node through resistors and current sources, in amperes."""
    count = netlist.node_count
    a, b = netlist.resistor_nodes.T
    flow = np.bincount(a, amps, count) - np.bincount(b, amps, count)
    return np.asarray(flow - readout.injected_currents(netlist))


def _check_direction(system: NodalSystem, levels: list[Levels], point: OperatingPoint, sums: Balance) -> None:
    """Refuse an answer that is not direction-safe."""
    netlist = system.netlist
    if not point.backward_error <= CONVERGED:
        raise AccuracyError(
            f"method {point.method!r} reached a componentwise backward error of {point.backward_error:.1e} only: the "
            "potential falls, or the conductances differ, by more decades than it can hold; the answer is not returned",
            point,
        )
    residual = readout.relative_residual(system, sums)
    residual[_flat(system, levels, sums)] = 0.0
    worst = int(np.argmax(residual)) if len(residual) else 0
    if len(residual) and residual[worst] > DIRECTION_RESIDUAL:
        raise AccuracyError(
            f"the field is not direction-safe: at node {netlist.node_name(worst)} KCL is violated by "
            f"{residual[worst]:.1e} of the current through it (at most {DIRECTION_RESIDUAL:g} is allowed)",
            point,
        )


def _flat(system: NodalSystem, levels: list[Levels], sums: Balance) -> NDArray[np.bool_]:
    """Nodes that no drive feeds and that carry less current than differences of their values can tell."""
    size = np.full(len(sums.through), np.inf)
    for level in levels:
        size = np.minimum(size, level.value.log + np.log(abs(level.volts)))
    degree = np.full(len(size), np.nan)
    solved = system.unknown >= 0
    rows = system.unknown[solved]
    degree[solved] = system.degree[rows]
    fed = np.zeros(len(size), dtype=np.bool_)
    fed[solved] = system.injected[rows] != 0
    with np.errstate(divide="ignore", invalid="ignore"):
        log_through = np.log(sums.through) + sums.log_largest
        return np.asarray(~fed & (log_through <= np.log(_FLAT) + np.log(degree) + size))
