"""Solve a netlist: assemble, factor, substitute, read off, and refuse what is not as accurate as promised."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from resgrid.errors import AccuracyError, InputError
from resgrid.netlist import Netlist
from resgrid.nodal import readout
from resgrid.nodal.entrywise import NodeValues, node_values
from resgrid.nodal.factor import Factor
from resgrid.nodal.methods import factor_system
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.nodal.plain import read_plain
from resgrid.nodal.readout import Balance
from resgrid.nodal.refine import is_answer
from resgrid.nodal.system import NodalSystem, assemble
from resgrid.nodal.watch import Progress, Watch

ACCURACIES = ("direction", "normwise")

DIRECTION_RESIDUAL = 1e-6
"""Largest KCL violation of a direction-safe field, relative to the current through the node."""


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
        down is right everywhere; where the circuit has two rails, or one and currents of one sign, every entry is
        right to ``entry_error``, some 1e-8 of itself.
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
        later = accuracy == "direction"
        factors = factor_system(system, method, accuracy=accuracy, later=later) if system.size else None
    name = factors.name if factors else "none"
    if accuracy == "normwise":
        with _timed(seconds, "substitute"):
            x = factors.solve(system.drive, rtol=rtol, watch=watch) if factors else np.zeros(0)
            del factors
        with _timed(seconds, "read"):
            point = read_plain(system, x, name, seconds)
        return replace(point, iterations=watch.iterations, backward_error=watch.error)
    with _timed(seconds, "substitute"):
        values = node_values(system, factors, watch, threads)
        del factors
    with _timed(seconds, "read"):
        point, sums = readout.read_off(system, values, name, seconds)
    signed = point.log_drop is None and point.potential is None
    bound = np.inf if signed else watch.bound + np.finfo(np.float64).eps
    point = replace(point, iterations=watch.iterations, backward_error=watch.error, entry_error=bound)
    _check_direction(system, values, point, sums)
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


def _check_direction(system: NodalSystem, values: NodeValues, point: OperatingPoint, sums: Balance) -> None:
    """Refuse an answer that is not direction-safe."""
    if not is_answer(point.backward_error, point.entry_error):
        raise AccuracyError(
            f"method {point.method!r} reached a componentwise backward error of {point.backward_error:.1e} only: the "
            "potential falls, or the conductances differ, by more decades than it can hold; the answer is not returned",
            point,
        )
    if point.kcl_residual <= DIRECTION_RESIDUAL:
        return
    residual = readout.relative_residual(system, sums)
    wrong = np.flatnonzero(residual > DIRECTION_RESIDUAL)
    wrong = wrong[~readout.flat(system, values, sums, wrong)]
    if wrong.size:
        worst = int(wrong[np.argmax(residual[wrong])])
        raise AccuracyError(
            f"the field is not direction-safe: at node {system.netlist.node_name(worst)} KCL is violated by "
            f"{residual[worst]:.1e} of the current through it (at most {DIRECTION_RESIDUAL:g} is allowed)",
            point,
        )
