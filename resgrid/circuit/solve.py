"""Public functions on netlists: solve, factor for many right-hand sides, scale the drive to the supply."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from resgrid._internal.numbers import check_whole
from resgrid._internal.validation import with_article
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
"""Name of the method of `resgrid.plan` for spaces on several processes; `resgrid.solve` rejects this method."""


class CircuitLike(Protocol):
    """A description of a circuit that can be converted to a netlist, such as the result of `resgrid.read_spice`."""

    def netlist(self) -> Netlist:
        """Return the circuit as a netlist."""
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
    """Compute the operating point of a netlist.

    Parameters
    ----------
    netlist : Netlist or Circuit
        Circuit of resistors and sources; capacitors are open.  The method ``netlist()`` of a circuit from a deck
        converts the circuit.  Circuits with nonlinear resistors are solved by Newton's method.
    accuracy : {"direction", "normwise"}
        ``"direction"``: at every node KCL holds to 1e-6 of the current through that node, however small this current
        is; otherwise `AccuracyError` is raised.  The direction of the current is then right everywhere.  Currents that
        cancel in voltage differences (at large conductances to a rail, in dead ends, between opposed sources) are
        recovered by a direct method, in the stage ``"balance"``.  In small circuits (meshes of up to about 800 nodes)
        every voltage and current is then accurate to the rounding of a double; values below 2**-1000 of the largest one
        may be set to zero, and currents between cells below 1e-28 of the largest current.  ``entry_error`` bounds the
        relative errors of the voltages.  In larger circuits this bound requires two rails, or one rail and currents of
        one sign (the bound is then about 1e-8), and that every component carries current.
        ``"normwise"``: only the normwise backward error is limited, to ``rtol``.
    method : {"auto", "direct", "multigrid"}
        Method for the linear systems; ``"auto"`` chooses by size and shape
        (`resgrid.solvers.method_choice.choose_method`).  The operating point reports the choice.
    rtol : float
        Largest normwise backward error for ``"normwise"``; unused for ``"direction"``.
    threads : int
        Largest number of threads; the result has the same digits for any number.  ``"multigrid"`` uses several on
        planes of at least 250,000 nodes and on volumes of at least 500,000: for sweeps over the finest levels, for
        kernels over rows and resistors, and for two right-hand sides at the same time (the drop and the voltage above
        the low rail if the conductances to the high rail are small, or the positive and the negative source currents).
        Smaller circuits, the direct method and circuits with nonlinear resistors are not faster with several threads
        and use one; `OperatingPoint.threads` is the number used.
    progress : callable, optional
        Called after every step of an iterative method with the number of steps, the residual relative to the start of
        the present refinement step, and an estimate of the remaining seconds of that refinement step (None while the
        residual does not fall).  With several threads, every thread calls the function.

    Returns
    -------
    OperatingPoint
        Node voltages, branch currents, power and residuals.

    Raises
    ------
    InputError
        If an option is unknown, or `netlist` is not a circuit.
    CircuitError
        If voltage sources contradict each other, no resistor or voltage source touches ground, the currents of current
        sources into a floating component do not add up to zero, or current sources exceed the capacity of nonlinear
        resistors.  Also if nothing drives a netlist that was compiled from a space (in other circuits all currents are
        then 0 A).
    AccuracyError
        If the accuracy is not reached; the exception carries the best solution.
    BudgetError
        If the factors do not fit in memory.

    Examples
    --------
    >>> netlist = rg.compile_space(rg.build_space(rg.read_scene("examples/scenes/lesson.toml")))
    >>> op = rg.solve(netlist)
    >>> node = netlist.cells.node[6, 2]
    >>> netlist.node_name(node), f"{op.voltage[node]:.6f} V"
    ('n_6_2', '0.573718 V')
    """
    _check_options(accuracy, method, rtol, threads, progress)
    netlist = netlist_of(netlist)
    if netlist.nonlinear_nodes.size:
        from resgrid.circuit.nonlinear import solve_nonlinear

        return solve_nonlinear(netlist, accuracy=accuracy, method=method, rtol=rtol, progress=progress)
    return solve_linear(netlist, accuracy=accuracy, method=method, rtol=rtol, threads=threads, progress=progress)


def factorize(netlist: Netlist | CircuitLike, *, method: str = "auto") -> CircuitFactor:
    """Factor the matrix of a netlist once, for many right-hand sides.

    Parameters
    ----------
    netlist : Netlist or Circuit
        The circuit, with linear resistors.
    method : {"auto", "direct", "multigrid"}
        Method for the linear systems; ``"auto"`` chooses by size and shape.

    Returns
    -------
    CircuitFactor
        Factors with the method ``solve(rhs)``; `rhs` contains the currents, in amperes, into the rows (unknown
        voltages) of ``CircuitFactor.system``.

    Raises
    ------
    InputError
        If the method is unknown, or the netlist has nonlinear resistors, or no unknown voltage.
    CircuitError
        If the circuit has no operating point, for example if voltage sources contradict each other.
    AccuracyError
        If a pivot vanishes in double precision.
    BudgetError
        If the factors do not fit in memory.

    Examples
    --------
    >>> ladder = rg.Netlist(
    ...     3, [[1, 0], [1, 2], [2, 0]], [1e-3, 1e-3, 1e-3], current_nodes=[[0, 1]], current_amps=[1e-3]
    ... )
    >>> factor = rg.factorize(ladder)
    >>> factor.solve([1e-3, 0.0]).round(6)
    array([0.666667, 0.333333])
    >>> factor.solve([0.0, 1e-3]).round(6)
    array([0.333333, 0.666667])
    """
    netlist = netlist_of(netlist)
    if netlist.nonlinear_nodes.size:
        raise InputError(
            "a netlist with nonlinear resistors cannot be factored; factor rg.circuit.linearize(op), its linearization "
            "around an operating point"
        )
    system = assemble(netlist)
    if not system.size:
        raise InputError("the circuit has no unknown voltage, so that there is no matrix to factor; use resgrid.solve")
    return factor_circuit(system, method)


def normalize_drive(netlist: Netlist, op: OperatingPoint) -> Netlist:
    """Return the netlist with the uniform drive scaled so that the highest node voltage equals the supply.

    The circuit is linear: voltages above the goal rail are proportional to the injected currents.

    Parameters
    ----------
    netlist : Netlist
        Netlist that was compiled with ``drive="uniform"``.
    op : OperatingPoint
        Operating point of the netlist.

    Returns
    -------
    Netlist
        The same circuit with scaled ``current_amps``, in amperes.

    Raises
    ------
    InputError
        If the netlist has no uniform drive, has nonlinear resistors, or the operating point is of another netlist.

    Examples
    --------
    >>> netlist = rg.compile_space(rg.build_space(rg.read_scene("examples/scenes/lesson.toml")), boundary="neumann")
    >>> op = rg.solve(netlist)
    >>> scaled = rg.normalize_drive(netlist, op)
    >>> round(float(op.voltage.max()), 6), round(float(rg.solve(scaled).voltage.max()), 6)
    (1.14067, 1.0)
    """
    space_map = netlist.space_map
    if space_map is None or space_map.wiring.drive != "uniform":
        raise InputError(
            "the netlist has no uniform drive to scale; compile the space with boundary = 'neumann', drive = 'uniform'"
        )
    if netlist.nonlinear_nodes.size:
        raise InputError(
            "the voltages of a circuit with nonlinear resistors do not scale with its drive; use linear resistors"
        )
    if not op.is_of(netlist):
        raise InputError("the operating point belongs to another netlist; solve this one first")
    height = (op.voltage - space_map.wiring.goal_voltage) * np.sign(space_map.wiring.supply)
    factor = abs(space_map.wiring.supply) / float(np.nanmax(height[space_map.free_node]))
    return netlist.replace(current_amps=netlist.current_amps * factor)


def netlist_of(circuit: Netlist | CircuitLike) -> Netlist:
    """Return `circuit`, or the result of its method ``netlist`` if it has one; raise InputError for other objects."""
    make = getattr(circuit, "netlist", None)
    netlist = make() if callable(make) else circuit
    if not isinstance(netlist, Netlist):
        raise InputError(
            f"the circuit is {with_article(type(circuit).__name__)}; give a Netlist (compile_space(space) returns one) "
            "or the result of read_spice"
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
