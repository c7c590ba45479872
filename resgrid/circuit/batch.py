"""Operating points of one circuit for many sets of conductances (Monte Carlo chips), with a common set-up."""

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
from resgrid.solvers.hierarchy_reuse import ChipSolver, solve_in_order, solver_by_levels
from resgrid.solvers.symbolic import order_rows

_SMALL = 1000
"""Largest number of rows (unknown voltages) for which every chip is factored; larger grids use multigrid."""

_MOST_CONTRAST = 1e3
"""Largest ratio of the largest diagonal entry of the nominal matrix to the smallest magnitude of its nonzero entries.

Up to this ratio, large grids share the coarse multigrid levels of the nominal chip.  Beyond it, every chip is factored.
"""


class BatchSetup(NamedTuple):
    """Common set-up of all chips with one circuit.

    `system`: equations of the nominal chip; the matrices of all chips have the same sparsity.  `solver`: function of
    the chips (pairs of a matrix and a right-hand side in amperes) and a relative tolerance; it yields the solution of
    each chip in volts, or None if the solution is not accurate.
    """

    system: Equations
    solver: ChipSolver


def solve_many(
    netlist: Netlist, conductances: ArrayLike, *, rtol: float = 1e-10, executor: Executor | None = None
) -> NDArray[np.float64]:
    """Compute the node voltages of many chips that differ only in their conductances.

    The sparsity of the equations is analysed once.  Large grids are solved by conjugate gradients, starting from the
    voltages of the nominal chip and preconditioned by a multigrid cycle with the chip's finest level and the nominal
    coarse levels.  Small circuits, and circuits without a grid, are factored in the elimination order of the nominal
    chip.  A chip for which this fails, such as one with conductances many orders of magnitude above the nominal ones,
    is solved by `resgrid.solve`.  The result of a chip does not depend on the other chips.

    Parameters
    ----------
    netlist : Netlist
        The nominal chip, with linear resistors.
    conductances : array_like of float, shape (chips, resistors)
        Conductances of every chip, in siemens; positive and finite.
    rtol : float
        For multigrid, bound on the norm of the residual relative to the norm of the currents that sources drive into
        the nodes of unknown voltage.  A node has a smaller weight in the latter norm if the sum of its conductances
        exceeds all such sums of the nominal chip.  For factorization, bound on the error of a voltage relative to the
        largest voltage.  Rounding errors may exceed these bounds.
    executor : concurrent.futures.Executor, optional
        Executor whose threads or processes solve chips in parallel (the kernels release the global interpreter lock);
        by default the chips are solved one after the other.

    Returns
    -------
    ndarray of float64, shape (chips, nodes)
        Node voltages above ground, in volts; NaN where a node floats.

    Raises
    ------
    InputError
        If the netlist has nonlinear resistors, or the conductances have the wrong shape or are not positive.
    CircuitError
        If the nominal chip has no operating point.
    AccuracyError
        If a chip that needs `resgrid.solve` does not reach its accuracy.
    BudgetError
        If the voltages of all chips do not fit in memory.

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


def prepare_batch(netlist: Netlist) -> BatchSetup | None:
    """Return equations and solver for all chips of a nominal netlist; None if the netlist has no unknown voltage."""
    system = assemble(netlist)
    if not system.size:
        return None
    matrix = system.laplacian.with_rows()
    diagonal, edges = matrix.diagonal, matrix.as_rows().data
    contrast = float(diagonal.max()) / min(float(diagonal.min()), float(edges.min(initial=np.inf)))
    system = replace(system, laplacian=matrix)
    by_levels = system.size > _SMALL and contrast <= _MOST_CONTRAST
    solver = solver_by_levels(matrix, system.drive) if by_levels else None
    return BatchSetup(system, solver or partial(solve_in_order, order_rows(matrix)))


def solve_batch(batch: BatchSetup, conductance: NDArray[np.float64], *, rtol: float = 1e-10) -> NDArray[np.float64]:
    """Return the node voltages of chips above ground, in volts, (chips, nodes); NaN where a node floats.

    `batch`: common set-up; `conductance` (chips, resistors): conductances in siemens; `rtol`: for multigrid, largest
    norm of the residual relative to the norm of the source currents; for factorization, largest error of a voltage
    relative to the largest voltage.
    """
    system, solver = batch
    voltage = np.empty((len(conductance), system.netlist.node_count))
    chips = ((matrix, feed + system.injected) for matrix, feed in map(system.with_conductance, conductance))
    for volts, siemens, x in zip(voltage, conductance, solver(chips, rtol), strict=True):
        if x is None:  # the chip differs too much from the nominal one
            chip = system.netlist.replace(conductance=siemens)
            volts[:] = solve_linear(chip, accuracy="direction", method="auto", rtol=1e-10).voltage
        else:
            volts[:] = system.voltages(x)
    return voltage


def _checked(netlist: Netlist, conductances: ArrayLike) -> NDArray[np.float64]:
    if netlist.nonlinear_nodes.size:
        raise InputError(
            "the netlist has nonlinear resistors, which have no conductance; solve each chip with resgrid.solve"
        )
    wanted = np.ascontiguousarray(conductances, dtype=np.float64)
    if wanted.ndim != 2 or wanted.shape[1] != len(netlist.conductance):
        raise InputError(
            f"conductances have shape {wanted.shape}, but the netlist has {len(netlist.conductance)} resistors; "
            "give one row per chip"
        )
    good = np.isfinite(wanted) & (wanted > 0)
    if not good.all():
        chip, resistor = np.argwhere(~good)[0].tolist()
        raise InputError(
            f"chip {chip}: resistor {resistor} has conductance {wanted[chip, resistor]}; it must be positive and finite"
        )
    return wanted
