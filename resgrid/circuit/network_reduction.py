"""Kron reduction: the network between terminals that is equivalent to a larger network.

The terminals are tied to rails, and the voltage of one rail at a time is 1 V.  With the voltages ``x`` of the inner
nodes for terminal ``i`` at 1 V, the conductance of the reduced network between terminals ``i`` and ``j`` is the current
into terminal ``j``, ``g_ij + sum_m g_jm x_m`` (Dorfler & Bullo 2013).  All terms are positive.  One factorization
serves all terminals.

Elimination without subtractions gives every voltage a small relative error (`resgrid.solvers.factors`).  Iterative
refinement reduces this error, but increases it if the conductances span more digits than double-doubles have: then the
voltages of the first substitution are used.

Products below the range of doubles underflow.  A lost product changes one conductance ``g_mn``, of the circuit or of
a partly eliminated one, by at most the smallest double ``e``.  This changes ``C_ij`` by at most ``e``, because
``dC_ij / dg_mn = (x_m - x_n) (y_m - y_n)`` with the voltages ``x`` and ``y`` for terminals ``i`` and ``j`` at 1 V,
which lie between 0 and 1 V.  Likewise, residual currents ``r`` change ``C_ij`` by ``sum_m r_m y_m``, at most the sum of
their magnitudes.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.memory import require_memory
from resgrid._internal.parallel import JobPart, in_order
from resgrid.circuit.equations import sum_by_row
from resgrid.circuit.terminals import Nodes
from resgrid.core.netlist import Netlist
from resgrid.solvers.factors import DirectFactor, Factor, factor_direct
from resgrid.solvers.laplacian import EdgeList, Grid, Laplacian, Rails
from resgrid.solvers.method_choice import check_method, direct_memory, factor_laplacian
from resgrid.solvers.progress import ProgressMonitor
from resgrid.solvers.threads import ThreadTeam

Count = Callable[[int, int], None]
"""Progress callback, called with the number of finished steps and the total number of steps."""

_EPS = float(np.finfo(np.float64).eps)

_ROUNDINGS = 8.0 * _EPS
"""Bound on the relative error that rounding adds to a conductance when a node is eliminated or currents are summed."""

_UNDERFLOW = 2.0**-1000
"""Bound on the sum of all products that underflow, as a fraction of the sum of the conductances (at least 1 S).

The bound holds for up to ``2**70`` products.
"""

_LEAST_USUAL = 1e-100
"""Smallest ratio of two conductances for which residuals of KCL do not underflow in double-double arithmetic."""

MOST_ERROR = 1e-6
"""Largest accepted bound on the relative error of a conductance or resistance."""

_MANY_SOLVES, _MOST_FILL = 8, 120.0
"""Limits for the direct method: smallest number of right-hand sides, and largest number of factor entries per row.

Method "auto" uses iterations for fewer right-hand sides or fuller factors.
"""


class Contacts(NamedTuple):
    """Resistors between inner nodes (nodes outside all terminals) and terminals.

    `row`, `terminal` (c,): matrix row of the inner node, and number of the terminal; `conductance` (c,): in siemens;
    `size`: number of matrix rows; `terminals`: number of terminals.
    """

    row: NDArray[np.int32]
    terminal: NDArray[np.int32]
    conductance: NDArray[np.float64]
    size: int
    terminals: int


@dataclass(frozen=True, eq=False)
class Reduction:
    """Conductances between terminals, and their accuracy.

    `conductance` (k, k): symmetric conductances in siemens, 0 on the diagonal; `relative`, `absolute`: the error of a
    conductance ``C`` is at most ``relative C + absolute``, in siemens; `method`: method of the linear solves,
    ``"none"`` if all nodes are terminals.
    """

    conductance: NDArray[np.float64]
    relative: float
    absolute: float
    method: str


class _Currents(NamedTuple):
    """Currents into the terminals while one terminal is at 1 V and the others at 0 V.

    `amps` (k,): currents through inner nodes, in amperes; the error of a current ``I`` is at most ``relative I +
    absolute``, without underflow and the rounding of the sum.
    """

    amps: NDArray[np.float64]
    relative: float
    absolute: float


def reduce_to_groups(
    netlist: Netlist,
    group: Nodes,
    terminals: NDArray[np.int64],
    *,
    method: str = "auto",
    threads: int = 1,
    executor: Executor | None = None,
    progress: Count | None = None,
) -> Reduction:
    """Return the conductances of the reduced network of a circuit between groups of joined nodes.

    `group` (nodes,): number of the group of joined nodes of every node; `terminals` (k,): different groups that are
    terminals; `method`: ``"auto"``, ``"direct"`` or ``"multigrid"``; `threads`: largest number of threads of one solve;
    `executor`: workers that share the terminals, None for this process; `progress`: called as ``progress(done, total)``
    after every terminal. The largest conductance must be between ``2**-100`` and ``2**100`` S. Raises AccuracyError if
    a pivot leaves the range of doubles.
    """
    check_method(method)
    count = len(terminals)
    require_memory(40.0 * count**2, f"the conductances between {count:,} terminals", "choose fewer terminals at a time")
    terminal_of = np.full(int(group.max()) + 1, -1, dtype=np.int32)
    terminal_of[terminals] = np.arange(count, dtype=np.int32)
    terminal = terminal_of[group]
    own = _between_terminals(netlist, terminal, count)
    laplacian, contacts = _inner_network(netlist, group, terminal, count)
    underflow = _UNDERFLOW * max(1.0, float(netlist.conductance.sum()))
    rounding = max(_ROUNDINGS, _EPS * _most_terms(netlist, terminal, contacts))
    if not contacts.size or not len(contacts.row):
        return Reduction(own + own.T, rounding, underflow, "none")
    with ThreadTeam(threads) as team:
        factor = _factor(laplacian, method, count - 1, team)
        del laplacian
        relative = absolute = 0.0
        part = JobPart(_currents_of, (factor, contacts), range(count - 1), "terminals")
        with closing(in_order([part], executor)) as results:
            for number, found in enumerate(results):
                own[number, number + 1 :] += found.amps[number + 1 :]
                relative, absolute = max(relative, found.relative), max(absolute, found.absolute)
                if progress is not None:
                    progress(number + 1, count - 1)
    upper = np.triu(own, 1)
    return Reduction(upper + upper.T, relative + rounding, absolute + underflow, factor.name)


def _most_terms(netlist: Netlist, terminal: NDArray[np.int32], contacts: Contacts) -> int:
    """Return the largest number of resistors whose currents are summed to one conductance between terminals.

    `terminal` (nodes,): terminal of every node, -1 for inner nodes; `contacts`: resistors between inner nodes and
    terminals.
    """
    low, high = np.sort(terminal[netlist.resistor_nodes], axis=1).T.astype(np.int64)
    direct = (low >= 0) & (low < high)
    between = np.bincount(low[direct] * contacts.terminals + high[direct], minlength=1).max()
    return int(between + np.bincount(contacts.terminal, minlength=1).max())


def _factor(laplacian: Laplacian, method: str, solves: int, team: ThreadTeam) -> Factor:
    """Return the factors of a matrix for several right-hand sides.

    `method`: ``"auto"``, ``"direct"`` or ``"multigrid"``; `solves`: number of right-hand sides; `team`: threads. For at
    least `_MANY_SOLVES` right-hand sides, "auto" chooses the direct method, which factorizes once, unless its factors
    have more than `_MOST_FILL` entries per row.
    """
    from resgrid.solvers.symbolic import order_by_fill

    if method == "auto" and solves >= _MANY_SOLVES:
        laplacian = laplacian.with_rows()
        order = order_by_fill(laplacian, _MOST_FILL * laplacian.size)
        if order is not None:
            require_memory(
                direct_memory(order), f"the factors for {laplacian.size:,} unknowns", "use method = 'multigrid'"
            )
            return factor_direct(laplacian, order)
    return factor_laplacian(laplacian, method, threads=team)


def _between_terminals(netlist: Netlist, terminal: NDArray[np.int32], count: int) -> NDArray[np.float64]:
    """Return the conductance between every two terminals by direct resistors, in siemens, upper triangle of (k, k).

    `terminal` (nodes,): terminal of every node, -1 for inner nodes; `count`: number k of terminals.
    """
    a, b = terminal[netlist.resistor_nodes.T]
    direct = (a >= 0) & (b >= 0) & (a != b)
    low, high = np.minimum(a, b)[direct].astype(np.int64), np.maximum(a, b)[direct]
    summed = np.bincount(low * count + high, netlist.conductance[direct], count**2)
    return np.asarray(summed, dtype=np.float64).reshape(count, count)


def _inner_network(
    netlist: Netlist, group: Nodes, terminal: NDArray[np.int32], count: int
) -> tuple[Laplacian, Contacts]:
    """Return the matrix of the inner nodes that are connected to a terminal, and their resistors to terminals.

    `group` (nodes,): number of the group of joined nodes of every node; `terminal` (nodes,): terminal of every node, -1
    for inner nodes; `count`: number of terminals. A group of joined inner nodes is one row of the matrix.
    """
    ends, conductance = netlist.resistor_nodes, netlist.conductance
    inner, reached = terminal < 0, _reached(netlist, group, terminal)
    representative = inner & reached
    numbers = np.full(int(group.max()) + 1, -1, dtype=np.int32)
    inside = np.unique(group[representative]) if _has_joined(group) else group[representative]
    numbers[inside] = np.arange(len(inside), dtype=np.int32)
    row = np.where(representative, numbers[group], np.int32(-1))
    a, b = (np.take(row, end) for end in ends.T)
    touching = np.flatnonzero((a < 0) != (b < 0))
    a, b = a[touching], b[touching]
    rails = np.where(a < 0, terminal[ends[touching, 0]], terminal[ends[touching, 1]])
    contacts = Contacts(np.maximum(a, b), rails, conductance[touching], len(inside), count)
    ground = sum_by_row(contacts.row, contacts.conductance, contacts.size)
    listed = EdgeList(ends, conductance, row)
    two_rails = None
    if count == 2:
        two_rails = Rails(1.0, 0.0, contacts.size, contacts.row, contacts.conductance, contacts.terminal == 0)
    if netlist.cell_map is None or (_has_joined(group) and len(inside) < np.count_nonzero(representative)):
        return Laplacian(ground, listed, rails=two_rails), contacts
    grid = Grid(netlist.cell_map.node, tuple(axis.periodic for axis in netlist.cell_map.space.axes))
    return Laplacian(ground, listed, grid=grid, dimensions=grid.dimensions, rails=two_rails), contacts


def _has_joined(group: Nodes) -> bool:
    """Return whether any two nodes have the same group; `group` (nodes,): group of every node, numbered from 0."""
    return int(group.max()) + 1 < len(group)


def _reached(netlist: Netlist, group: Nodes, terminal: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Return the mask (nodes,) of nodes whose connected component contains a terminal.

    `group` (nodes,): group of joined nodes of every node; `terminal` (nodes,): terminal of every node, -1 for inner
    nodes.
    """
    from resgrid.circuit.kernels import merge_components, number_components

    count = int(group.max()) + 1
    part, ends = np.arange(count, dtype=np.int32), netlist.resistor_nodes
    edges = group.astype(np.int32)[ends] if _has_joined(group) else ends
    merge_components(edges, part, np.empty(len(edges), dtype=np.int32))
    number_components(part)
    touched = np.zeros(count, dtype=np.bool_)
    touched[part[group[terminal >= 0]]] = True
    return np.asarray(touched[part[group]])


def _currents_of(shared: tuple[Factor, Contacts], numbers: range) -> list[_Currents]:
    """Return the currents into all terminals while one terminal is at 1 V and the others at 0 V.

    `shared`: factors of the matrix of the inner nodes, and contacts; `numbers`: numbers of the terminals that are at 1
    V one after another. The currents of a terminal without contacts are 0.
    """
    factor, contacts = shared
    is_usual, results = _is_usual(factor.laplacian), []
    for number in numbers:
        own = contacts.terminal == number
        if own.any():
            rhs = sum_by_row(contacts.row[own], contacts.conductance[own], contacts.size)
            results.append(_currents(factor, contacts, rhs, is_usual))
        else:
            results.append(_Currents(np.zeros(contacts.terminals), 0.0, 0.0))
    return results


def _currents(factor: Factor, contacts: Contacts, rhs: NDArray[np.float64], is_usual: bool) -> _Currents:
    """Return the currents into all terminals for the currents `rhs` (n,) into the inner nodes, in amperes.

    `factor`: factors of the matrix of the inner nodes; `contacts`: resistors between inner nodes and terminals;
    `is_usual`: result of `_is_usual` for this matrix.
    """

    def into_terminals(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return sum_by_row(contacts.terminal, contacts.conductance * x[contacts.row], contacts.terminals)

    watch = ProgressMonitor()
    x = factor.solve_nonnegative(rhs, watch=watch)[0].plain
    amps = into_terminals(x)
    limit = 2.0 * factor.rounding_bound if isinstance(factor, DirectFactor) else MOST_ERROR
    if watch.bound <= limit and is_usual:
        return _Currents(amps, watch.bound, 0.0)
    if isinstance(factor, DirectFactor):
        first = into_terminals(factor.factors.solve(rhs))
        refined = np.where(np.abs(amps - first) <= factor.rounding_bound * first, amps, first)
        return _Currents(refined, limit, 0.0)
    return _Currents(amps, 0.0, _residual_current(factor.laplacian, rhs, x, watch.error) if is_usual else np.inf)


def _is_usual(laplacian: Laplacian) -> bool:
    """Return whether residuals of the matrix do not underflow, so that bounds computed from residuals are valid."""
    _, _, conductance, leak = laplacian.graph
    least = min(conductance.min(initial=np.inf), leak.min(initial=np.inf, where=leak > 0.0))
    return bool(least > _LEAST_USUAL * max(conductance.max(initial=0.0), leak.max(initial=0.0)))


def _residual_current(laplacian: Laplacian, rhs: NDArray[np.float64], x: NDArray[np.float64], backward: float) -> float:
    """Return a bound on the sum of the magnitudes of the residual currents of a solution, in amperes.

    `rhs` (n,): currents into the rows in amperes; `x` (n,): solution in volts; `backward`: its componentwise backward
    error.  The rounding errors of the residuals are relative to the currents at each row.
    """
    indptr, indices, conductance, leak = laplacian.graph
    own, degree = np.repeat(x, np.diff(indptr)), np.diff(indptr).max(initial=0)
    size = float(rhs.sum() + leak @ np.abs(x) + conductance @ (np.abs(own) + np.abs(x[indices])))
    flow = float(rhs.sum() + leak @ np.abs(x) + conductance @ np.abs(own - x[indices]))
    return float(2.0 * (backward * size + _EPS * (8.0 + degree) * flow))
