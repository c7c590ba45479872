"""Solve one circuit for many sets of conductances: what is the same for all chips is done once."""

from __future__ import annotations

from concurrent.futures import Executor
from contextlib import closing
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.memory import require_memory
from resgrid._internal.parallel import JobPart, in_order
from resgrid.circuit.equations import Equations, assemble
from resgrid.circuit.linear import solve_linear
from resgrid.core.netlist import Netlist
from resgrid.errors import InputError
from resgrid.solvers.factors import check_rtol
from resgrid.solvers.hierarchy_reuse import Solver, solve_in_order, solver_by_levels
from resgrid.solvers.symbolic import order_rows

_SMALL = 1000
"""Rows up to which factors are quicker than multigrid."""

_MOST_CONTRAST = 1e3
"""Between the nominal chip's conductances, up to which its levels precondition others."""


class Batch(NamedTuple):
    """What all chips of a kind share.

    `system`: the nominal chip's equations; rows and entries stay where they are; `solver`: solves for chips.
    """

    system: Equations
    solver: Solver


def solve_many(
    netlist: Netlist, conductances: ArrayLike, *, rtol: float = 1e-10, executor: Executor | None = None
) -> NDArray[np.float64]:
    """Find the node voltages of many chips that differ in their conductances only.

    The equations are laid out once.  Chips of a grid are solved by conjugate gradients from the voltages of the nominal
    one, preconditioned by its coarse levels and their own finest one; other circuits, and small ones, by elimination in
    the nominal chip's order.  Chips for which that does not do, as with conductances many decades larger than any of
    the nominal one's, are solved one by one (`resgrid.solve`).  A chip's answer does not depend on which others are
    solved beside it.

    Parameters
    ----------
    netlist : Netlist
        The nominal chip; linear.
    conductances : array_like of float, shape (chips, resistors)
        In siemens; positive and finite.
    rtol : float
        Of grids by multigrid, a bound on the norm of the residual relative to that of the currents that the sources
        drive in, nodes that are tied more stiffly than any of the nominal chip's counting as those; of other circuits,
        on the error of voltages relative to the largest; or what rounding allows.
    executor : concurrent.futures.Executor, optional
        Chips are solved in its threads (the loops release the lock) or processes, instead of one after the other.

    Returns
    -------
    ndarray of float64, shape (chips, nodes)
        In volts; NaN where a node floats.

    Raises
    ------
    InputError
        If the netlist has nonlinear resistors, or the conductances do not fit.
    CircuitError
        If the nominal chip has no operating point.
    AccuracyError
        If a chip that is solved by itself has no answer that is right.
    BudgetError
        If the voltages of all chips would not fit in memory.

    Examples
    --------
    >>> divider = rg.Netlist(3, [[1, 2], [2, 0]], [1e-3, 1e-3], source_nodes=[[1, 0]], source_volts=[2.0])
    >>> rg.circuit.solve_many(divider, [[1e-3, 1e-3], [1e-3, 3e-3]]).round(9)
    array([[0. , 2. , 1. ],
           [0. , 2. , 0.5]])
    """
    wanted = _checked(netlist, conductances)
    require_memory(
        8.0 * len(wanted) * netlist.node_count,
        f"the voltages of {len(wanted):,} chips of {netlist.node_count:,} nodes each",
        "solve fewer chips at a time",
    )
    check_rtol(rtol)
    batch = prepare_batch(netlist)
    if batch is None:
        return np.tile(assemble(netlist).known_voltages(), (len(wanted), 1))
    voltage = np.empty((len(wanted), netlist.node_count))
    with closing(in_order([JobPart(partial(solve_batch, rtol=rtol), batch, wanted, "chips")], executor)) as results:
        for row, volts in zip(voltage, results, strict=True):
            row[:] = volts
    return voltage


def prepare_batch(netlist: Netlist) -> Batch | None:
    """Lay out what all chips of a kind share; None if the rails hold every node."""
    system = assemble(netlist)
    if not system.size:
        return None
    matrix = system.laplacian.with_rows()
    diagonal, edges = matrix.diagonal, matrix.as_rows().data
    contrast = float(diagonal.max()) / min(float(diagonal.min()), float(edges.min(initial=np.inf)))
    system = replace(system, laplacian=matrix)
    by_levels = system.size > _SMALL and contrast <= _MOST_CONTRAST
    solver = solver_by_levels(matrix, system.drive) if by_levels else None
    return Batch(system, solver or partial(solve_in_order, order_rows(matrix)))


def solve_batch(batch: Batch, conductance: NDArray[np.float64], *, rtol: float = 1e-10) -> NDArray[np.float64]:
    """Voltages of some chips, shape (chips, nodes); NaN where a node floats."""
    system, solver = batch
    voltage = np.empty((len(conductance), system.netlist.node_count))
    chips = ((matrix, feed + system.injected) for matrix, feed in map(system.with_conductance, conductance))
    for volts, siemens, x in zip(voltage, conductance, solver(chips, rtol), strict=True):
        if x is None:  # it has little to do with the nominal one
            alone = system.netlist.replace(conductance=siemens)
            volts[:] = solve_linear(alone, accuracy="direction", method="auto", rtol=1e-10).voltage
        else:
            volts[:] = system.voltages(x)
    return voltage


def _checked(netlist: Netlist, conductances: ArrayLike) -> NDArray[np.float64]:
    if netlist.nonlinear_nodes.size:
        raise InputError("nonlinear resistors have no conductances to exchange; solve such chips one by one")
    wanted = np.ascontiguousarray(conductances, dtype=np.float64)
    if wanted.ndim != 2 or wanted.shape[1] != len(netlist.conductance):
        raise InputError(
            f"conductances have shape {wanted.shape}, but the netlist has {len(netlist.conductance)} resistors; "
            "give one row a chip"
        )
    good = np.isfinite(wanted) & (wanted > 0)
    if not good.all():
        chip, resistor = np.argwhere(~good)[0].tolist()
        raise InputError(
            f"chip {chip}: resistor {resistor} has conductance {wanted[chip, resistor]}; it must be positive and finite"
        )
    return wanted
