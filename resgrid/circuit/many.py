"""Solve one circuit for many sets of conductances: what is the same for all chips is done once."""

from __future__ import annotations

from concurrent.futures import Executor
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.budget import require_memory
from resgrid.circuit.equations import Contacts, Equations, assemble
from resgrid.circuit.linear import solve_linear
from resgrid.errors import InputError
from resgrid.executors import Part, in_order
from resgrid.netlist import Netlist
from resgrid.solvers.factor import check_rtol
from resgrid.solvers.laplacian import EdgeList, Laplacian
from resgrid.solvers.reuse import Chip, FactoredBatch, GridBatch, grid_batch
from resgrid.solvers.symbolic import order_rows

_SMALL = 1000
"""Rows up to which factors are quicker than multigrid."""

_FEW = 1000
"""Resistors that tell in which unit a chip is solved."""

_MOST_CONTRAST = 1e3
"""Between the nominal chip's conductances, up to which its levels precondition others."""


@dataclass(frozen=True, eq=False)
class Batch:
    """What all chips of a kind share.

    `system`: the nominal chip's equations; rows and entries stay where they are; `source` (entries,): the resistor
    behind every entry of its matrix's edges; None where resistors are in parallel; `contacts`: what drives its
    rows; `solver`: solves for chips.
    """

    system: Equations
    source: NDArray[np.int64] | None
    contacts: Contacts
    solver: GridBatch | FactoredBatch

    @property
    def name(self) -> str:
        """The method."""
        return self.solver.name

    def chip(self, conductance: NDArray[np.float64]) -> Chip:
        """The equations of a chip of other conductances, shape (resistors,), in siemens."""
        system = self.system
        matrix, feed = system.with_conductance(conductance, self.contacts)
        entries = matrix.as_rows().data if self.source is None else conductance[self.source]
        few = slice(None, None, max(1, len(conductance) // _FEW))
        with np.errstate(over="ignore"):
            times = np.median(conductance[few] / system.netlist.conductance[few])
        return Chip(entries, matrix.ground, feed + system.injected, float(2.0 ** np.round(np.log2(times))))

    def voltages(self, solution: NDArray[np.float64]) -> NDArray[np.float64]:
        """Voltages of all nodes, shape (chips, nodes), from those of the rows, (chips, n); NaN where a node floats."""
        return np.stack([self.system.voltages(x) for x in solution])


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
    >>> rg.solve_many(divider, [[1e-3, 1e-3], [1e-3, 3e-3]]).round(9)
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
    with closing(in_order([Part(_solve_some, (batch, rtol), wanted, "chips")], executor)) as results:
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
    source = _sources_of_entries(system)
    if system.size > _SMALL and contrast <= _MOST_CONTRAST:
        solver = grid_batch(matrix, system.drive)
        if solver is not None:
            return Batch(system, source, system.found_contacts(), solver)
    return Batch(system, source, system.found_contacts(), FactoredBatch(matrix.conductances, order_rows(matrix)))


def _solve_some(shared: tuple[Batch, float], conductance: NDArray[np.float64]) -> NDArray[np.float64]:
    batch, rtol = shared
    return solve_batch(batch, conductance, rtol=rtol)


def solve_batch(batch: Batch, conductance: NDArray[np.float64], *, rtol: float = 1e-10) -> NDArray[np.float64]:
    """Voltages of some chips, shape (chips, nodes)."""
    count = len(conductance)
    solution, reached = np.zeros((count, batch.system.size)), np.zeros(count, dtype=np.bool_)
    batch.solver.solve(map(batch.chip, conductance), rtol, solution, reached)
    voltage = batch.voltages(solution)
    for chip in np.flatnonzero(~reached):
        voltage[chip] = _alone(batch.system.netlist, conductance[chip])
    return voltage


def _sources_of_entries(system: Equations) -> NDArray[np.int64] | None:
    """The resistor behind every entry of the edges, where each has one: conductances tell, if they are its number."""
    ends, entries = system.netlist.resistor_nodes, len(system.laplacian.as_rows().indices)
    number = np.arange(1.0, len(ends) + 1.0)
    rows = system.unknown[ends]
    inner = np.count_nonzero((rows >= 0).all(axis=1) & (rows[:, 0] != rows[:, 1]))
    if entries != 2 * inner:
        return None
    numbered = Laplacian(system.laplacian.ground, EdgeList(ends, number, system.unknown))
    return numbered.as_rows().data.astype(np.int64) - 1


def _alone(netlist: Netlist, conductance: NDArray[np.float64]) -> NDArray[np.float64]:
    """The voltages of one chip that has little to do with the nominal one."""
    chip = netlist.replace(conductance=conductance)
    return solve_linear(chip, accuracy="direction", method="auto", rtol=1e-10).voltage


def _checked(netlist: Netlist, conductances: ArrayLike) -> NDArray[np.float64]:
    if netlist.nonlinear_nodes.size:
        raise InputError("nonlinear resistors have no conductances to exchange; solve such chips one by one")
    try:
        wanted = np.ascontiguousarray(conductances, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError("conductances must be one number per chip and resistor") from error
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
