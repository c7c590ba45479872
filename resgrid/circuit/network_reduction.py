"""Kron reduction: the network between terminals that is equivalent to a larger network.

The terminals are tied to rails, and the voltage of one rail at a time is 1 V.  With the voltages ``x`` of the inner
nodes for terminal ``i`` at 1 V, the conductance of the reduced network between terminals ``i`` and ``j`` is the current
into terminal ``j``, ``g_ij + sum_m g_jm x_m`` (Dorfler & Bullo 2013).  All terms are positive and all voltages have a
small relative error (`resgrid.solvers.factors`), so that every conductance has a small relative error, whatever its
size.  One factorization serves all terminals.

A relative error of at most ``e`` in every conductance changes an effective resistance by at most ``e``, because
effective resistances are monotone in conductances (Rayleigh 1871) and have degree -1.  The elimination of a node from
the reduced network (`resgrid.circuit.resistance_kernels`) only rounds the remaining conductances, and these errors add
up to at most a few roundings per eliminated node.
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
from resgrid.errors import AccuracyError
from resgrid.solvers.factors import EXACT_ROWS, Factor, factor_direct
from resgrid.solvers.laplacian import EdgeList, Grid, Laplacian, Rails
from resgrid.solvers.method_choice import check_method, direct_memory, factor_laplacian
from resgrid.solvers.progress import ProgressMonitor
from resgrid.solvers.refinement import is_answer
from resgrid.solvers.threads import ThreadTeam

Count = Callable[[int, int], None]
"""Progress callback, called with the number of finished steps and the total number of steps."""

_ROUNDINGS = 8.0 * np.finfo(np.float64).eps
"""Bound on the relative error that rounding adds to a conductance when a node is eliminated or currents are summed."""

_MANY_SOLVES, _MOST_FILL = 8, 120.0
"""Limits for the direct method: smallest number of right-hand sides, and largest number of factor entries per row.

Method "auto" uses iterations for fewer right-hand sides or fuller factors.
"""

_LEAF = 16
"""Largest number of nodes of a network whose resistances are computed by a separate elimination for every pair."""


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

    `conductance` (k, k): symmetric conductances in siemens, 0 on the diagonal; `error`: bound on their relative error,
    infinite if the solver gives no bound; `method`: method of the linear solves, ``"none"`` if all nodes are terminals.
    """

    conductance: NDArray[np.float64]
    error: float
    method: str


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
    after every terminal. Raises AccuracyError if the accuracy is not reached.
    """
    check_method(method)
    count = len(terminals)
    require_memory(40.0 * count**2, f"the conductances between {count:,} terminals", "choose fewer terminals at a time")
    terminal_of = np.full(int(group.max()) + 1, -1, dtype=np.int32)
    terminal_of[terminals] = np.arange(count, dtype=np.int32)
    terminal = terminal_of[group]
    own = _between_terminals(netlist, terminal, count)
    laplacian, contacts = _inner_network(netlist, group, terminal, count)
    if not contacts.size or not len(contacts.row):
        return Reduction(own + own.T, 2.0 * float(np.finfo(np.float64).eps), "none")
    with ThreadTeam(threads) as team:
        factor = _factor(laplacian, method, count - 1, team)
        del laplacian
        shared, error, backward = (factor, contacts), 0.0, 0.0
        part = JobPart(_currents_of, shared, range(count - 1), "terminals")
        with closing(in_order([part], executor)) as results:
            for number, (amps, bound, residual) in enumerate(results):
                own[number, number + 1 :] += amps[number + 1 :]
                error, backward = max(error, bound), max(backward, residual)
                if progress is not None:
                    progress(number + 1, count - 1)
    if not is_answer(backward, error):
        raise AccuracyError(
            f"method {factor.name!r} reached a componentwise backward error of only {backward:.1e}: the conductances "
            "span more orders of magnitude than it can represent; use another method"
        )
    upper = np.triu(own, 1)
    return Reduction(upper + upper.T, error + _ROUNDINGS, factor.name)


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


def _currents_of(shared: tuple[Factor, Contacts], numbers: range) -> list[tuple[NDArray[np.float64], float, float]]:
    """Return the currents into all terminals while one terminal is at 1 V and the others at 0 V.

    `shared`: factors of the matrix of the inner nodes, and contacts; `numbers`: numbers of the terminals that are at 1
    V one after another. The result for each number consists of the currents through inner nodes in amperes, (k,), the
    bound on the relative error of the inner voltages, and the componentwise backward error of these voltages; for a
    terminal without contacts all are 0.
    """
    factor, contacts = shared
    results = []
    for number in numbers:
        own = contacts.terminal == number
        if not own.any():
            results.append((np.zeros(contacts.terminals), 0.0, 0.0))
            continue
        watch = ProgressMonitor()
        rhs = sum_by_row(contacts.row[own], contacts.conductance[own], contacts.size)
        x, _ = factor.solve_nonnegative(rhs, watch=watch)
        amps = sum_by_row(contacts.terminal, contacts.conductance * x.plain[contacts.row], contacts.terminals)
        bound = watch.bound
        if contacts.size <= EXACT_ROWS:  # refinement never moves entries by more than this bound
            bound = min(bound, 4.0 * factor.substitution_bound())
        results.append((amps, bound, watch.error))
    return results


def resistances_between(conductance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the effective resistance between every two nodes of a dense network, in ohms, (k, k).

    The resistance between nodes that are not connected is infinite. `conductance` (k, k): symmetric conductances in
    siemens. Nodes are eliminated without subtractions. Divide and conquer (the nodes of one half are eliminated once
    for all pairs of the other half) takes about ``3 k**3`` operations.
    """
    count = len(conductance)
    resistance = np.zeros((count, count))
    largest = float(conductance.max(initial=0.0))
    if count < 2 or not largest:
        resistance[~np.eye(count, dtype=np.bool_)] = np.inf
        return resistance
    unit = 2.0 ** np.floor(np.log2(largest))
    _within(conductance / unit, np.arange(count), resistance)
    with np.errstate(over="ignore"):
        return np.asarray(resistance / unit)


def _within(network: NDArray[np.float64], nodes: NDArray[np.int64], out: NDArray[np.float64]) -> None:
    """Compute the effective resistances between all nodes of a network, and write them to `out`.

    `network` (k, k): conductances; `nodes` (k,): index in `out` of every node; `out` (n, n): resistances, in units of 1
    / conductance.
    """
    from resgrid.circuit.resistance_kernels import without_nodes

    count = len(nodes)
    if count <= _LEAF:
        _write_small(network, 0, nodes, out)
        return
    half, order = count // 2, np.arange(count)
    _within(without_nodes(network, order, half), nodes[:half], out)
    _within(without_nodes(network, np.roll(order, -half), count - half), nodes[half:], out)
    _across(network, half, nodes, out)


def _across(network: NDArray[np.float64], half: int, nodes: NDArray[np.int64], out: NDArray[np.float64]) -> None:
    """Compute the effective resistances between the first `half` nodes of a network and its other nodes.

    `network` (k, k): conductances; `nodes` (k,): index in `out` of every node; `out` (n, n): array to which the
    resistances are written. The larger set of nodes is halved, and each half is eliminated in turn.
    """
    from resgrid.circuit.resistance_kernels import without_nodes

    count = len(nodes)
    if count <= _LEAF:
        _write_small(network, half, nodes, out)
        return
    order, splits_first = np.arange(count), 2 * half > count
    begin, end = (0, half) if splits_first else (half, count)
    middle = (begin + end) // 2
    for left_out in (slice(middle, end), slice(begin, middle)):
        kept = np.delete(order, left_out)
        reduced = without_nodes(network, np.concatenate([kept, order[left_out]]), len(kept))
        _across(reduced, half - (left_out.stop - left_out.start) * splits_first, nodes[kept], out)


def _write_small(network: NDArray[np.float64], half: int, nodes: NDArray[np.int64], out: NDArray[np.float64]) -> None:
    """Compute the effective resistances in a network of at most `_LEAF` nodes, and write them to `out`.

    `network` (k, k): conductances; `half`: number k1 for the resistances between the first k1 nodes and the others;
    0 for all pairs; `nodes` (k,): index in `out` of every node; `out` (n, n): resistances.
    """
    from resgrid.circuit.resistance_kernels import small_network_resistances

    found = np.zeros_like(network)
    small_network_resistances(network, half, np.empty_like(network), found)
    if not half:
        out[np.ix_(nodes, nodes)] = found
        return
    out[np.ix_(nodes[:half], nodes[half:])] = found[:half, half:]
    out[np.ix_(nodes[half:], nodes[:half])] = found[half:, :half]


def elimination_error(count: int) -> float:
    """Return the bound on the relative rounding error of resistances by elimination in a network of `count` nodes."""
    return _ROUNDINGS * count
