"""Solve a netlist, factor it once for many right-hand sides, or scale its drive."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from resgrid._internal.validation import check_whole, with_article
from resgrid.circuit.equations import assemble
from resgrid.circuit.linear import CircuitFactor, factor_circuit, solve_linear
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.core.netlist import Netlist
from resgrid.errors import InputError
from resgrid.solvers.factors import check_rtol
from resgrid.solvers.method_choice import check_method
from resgrid.solvers.progress import Progress, ProgressMonitor

ACCURACIES = ("direction", "normwise")
PETSC = "petsc"
"""The method of `resgrid.plan` that takes a space to other processes, without a netlist."""


class CircuitLike(Protocol):
    """A circuit as somebody wrote it, such as `resgrid.read_spice` returns."""

    def netlist(self) -> Netlist:
        """Make a netlist of it."""
        ...


def solve(
    netlist: Netlist | CircuitLike,
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
    netlist : Netlist or Circuit
        Resistors and sources; capacitors are open.  With nonlinear resistors the voltages come from Newton's method.
        Of a deck it is what its ``netlist()`` makes.
    accuracy : {"direction", "normwise"}
        ``"direction"``: at every node KCL holds to 1e-6 of the current through that same node, however small that is
        beside others, or `AccuracyError` is raised; so the way down is right everywhere.  Where voltages tell no
        currents (stiff ties to a rail, flat dead ends, sources that oppose each other), these are found as differences
        by a direct method, a stage of its own (``"balance"``).  In small circuits (meshes of up to some 800 nodes)
        every voltage and current is then right to the rounding of a double; below 2**-1000 of the largest it may
        count as zero, in fields of cells below 1e-28 of the largest current.  ``entry_error`` bounds the relative
        errors of voltages; of larger circuits it does so where there are two rails, or one and currents of one sign
        (some 1e-8), unless parts carry no current.
        ``"normwise"``: only the backward error is held below ``rtol``.
    method : {"auto", "direct", "multigrid"}
        How to solve; ``"auto"`` chooses by size and shape (`resgrid.solvers.method_choice.choose_method`); the
        operating point reports the choice.
    rtol : float
        Backward error for ``"normwise"``.
    threads : int
        Largest number of threads; the digits are the same for any number.  Several are used by ``"multigrid"`` on
        planes of at least 250,000 nodes and on volumes of at least 500,000: for sweeps over the finest levels, for
        loops over rows and resistors, and for two right-hand sides at a time (the drop from the high rail and the
        height above the low one where ties to the high rail are weak; current sources of both signs).  Smaller
        circuits, the direct method and circuits with nonlinear resistors are not faster with several threads, and use
        one; the operating point reports the number.
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
        If an option is unknown, or this is no circuit.
    CircuitError
        If sources contradict each other, nothing drives the chip of a space (any other circuit is at rest then),
        nothing touches ground, currents of current sources into a floating part do not add up to zero, or current
        sources exceed what nonlinear resistors carry.
    AccuracyError
        If the promised accuracy is not reached; it carries the best answer.
    BudgetError
        If the factors would not fit in memory.

    Examples
    --------
    >>> netlist = rg.compile_space(rg.sample(rg.read_scene("examples/scenes/lesson.toml")))
    >>> op = rg.solve(netlist)
    >>> node = netlist.cells.node[6, 2]
    >>> netlist.node_name(node), f"{op.voltage[node]:.6f} V"
    ('n_6_2', '0.573718 V')
    """
    _check_options(accuracy, method, rtol, threads, progress)
    netlist = _netlist_of(netlist)
    if netlist.nonlinear_nodes.size:
        from resgrid.circuit.nonlinear import solve_nonlinear

        return solve_nonlinear(netlist, accuracy=accuracy, method=method, rtol=rtol, progress=progress)
    return solve_linear(netlist, accuracy=accuracy, method=method, rtol=rtol, threads=threads, progress=progress)


def factor(netlist: Netlist | CircuitLike, *, method: str = "auto") -> CircuitFactor:
    """Factor a netlist once, for many right-hand sides.

    Parameters
    ----------
    netlist : Netlist or Circuit
    method : {"auto", "direct", "multigrid"}

    Returns
    -------
    CircuitFactor
        With ``solve(rhs)`` for currents into the rows of its ``system``.

    Raises
    ------
    InputError
        If the method is unknown, or the netlist has nonlinear resistors, or no unknown voltage.
    CircuitError
        As `solve`.
    AccuracyError
        If a pivot vanishes in double precision.
    BudgetError
        If the factors would not fit in memory.

    Examples
    --------
    >>> ladder = rg.Netlist(
    ...     3, [[1, 0], [1, 2], [2, 0]], [1e-3, 1e-3, 1e-3], current_nodes=[[0, 1]], current_amps=[1e-3]
    ... )
    >>> factor = rg.factor(ladder)
    >>> factor.solve([1e-3, 0.0]).round(6)
    array([0.666667, 0.333333])
    >>> factor.solve([0.0, 1e-3]).round(6)
    array([0.333333, 0.666667])
    """
    netlist = _netlist_of(netlist)
    if netlist.nonlinear_nodes.size:
        raise InputError(
            "a netlist with nonlinear resistors has no factors; factor small_signal(point), the circuit around one of "
            "its operating points"
        )
    system = assemble(netlist)
    if not system.size:
        raise InputError("there is nothing to factor: the rails hold every node")
    return factor_circuit(system, method)


def scale_drive(netlist: Netlist, op: OperatingPoint) -> Netlist:
    """Scale the uniform drive so that the highest node sits at the supply.

    The circuit is linear: its voltages above the goal rail scale with the currents fed in.

    Parameters
    ----------
    netlist : Netlist
        Compiled with ``drive="uniform"``.
    op : OperatingPoint
        Its operating point.

    Returns
    -------
    Netlist
        The same circuit with other ``current_amps``.

    Raises
    ------
    InputError
        If the netlist has no uniform drive, has nonlinear resistors, or the operating point is of another netlist.

    Examples
    --------
    >>> netlist = rg.compile_space(rg.sample(rg.read_scene("examples/scenes/lesson.toml")), boundary="neumann")
    >>> op = rg.solve(netlist)
    >>> scaled = rg.scale_drive(netlist, op)
    >>> round(float(op.voltage.max()), 6), round(float(rg.solve(scaled).voltage.max()), 6)
    (1.14067, 1.0)
    """
    cell_map = netlist.cell_map
    if cell_map is None or cell_map.wiring.drive != "uniform":
        raise InputError("only a netlist compiled with drive = 'uniform' has a drive to scale")
    if netlist.nonlinear_nodes.size:
        raise InputError("the voltages of a circuit with nonlinear resistors do not scale with its drive")
    if not op.is_of(netlist):
        raise InputError("the operating point belongs to another netlist; solve this one first")
    height = (op.voltage - cell_map.wiring.goal_voltage) * np.sign(cell_map.wiring.supply)
    factor = abs(cell_map.wiring.supply) / float(np.nanmax(height[cell_map.free_node]))
    return netlist.replace(current_amps=netlist.current_amps * factor)


def _netlist_of(circuit: Netlist | CircuitLike) -> Netlist:
    make = getattr(circuit, "netlist", None)
    netlist = make() if callable(make) else circuit
    if not isinstance(netlist, Netlist):
        raise InputError(
            f"this is no circuit but {with_article(type(circuit).__name__)}: give a Netlist (compile_space makes one "
            "of a space) or what read_spice returns"
        )
    return netlist


def _check_options(accuracy: str, method: str, rtol: float, threads: int, progress: Progress | None) -> None:
    if accuracy not in ACCURACIES:
        raise InputError(f"accuracy = {accuracy!r} is unknown; it may be one of {', '.join(ACCURACIES)}")
    if method == PETSC:
        raise InputError("method = 'petsc' solves spaces, without a netlist: rg.plan(space, method='petsc', ranks=2)")
    check_method(method)
    check_rtol(rtol)
    check_whole("threads", threads, 1)
    ProgressMonitor(progress)
