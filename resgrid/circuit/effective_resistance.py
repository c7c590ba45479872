"""Effective resistances between nodes, cells or regions of a circuit, and the equivalent network between them."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from annotated_types import Ge
from numpy.typing import NDArray

from resgrid._internal.parallel import JobPart, in_order
from resgrid._internal.values import frozen
from resgrid.circuit.network_reduction import Count
from resgrid.circuit.resistance_bounds import bounded_conductances, bounded_resistances
from resgrid.circuit.solve import CircuitLike, netlist_of
from resgrid.circuit.terminals import Nodes, TerminalReader, joined_nodes, pairs_of, require_linear
from resgrid.core.netlist import Netlist
from resgrid.errors import InputError

Joined = Literal["pair", "all"]
"""Regions whose nodes an ideal wire joins while a pair is measured.

``"pair"``: the two regions of the pair; ``"all"``: the regions of all terminals.
"""


@frozen
@dataclass(frozen=True, eq=False)
class EffectiveResistance:
    """Effective resistances of pairs of terminals.

    Returned by `resgrid.effective_resistance`.

    Attributes
    ----------
    netlist : Netlist
        The circuit.
    terminals : tuple of ndarray of int64
        Nodes of every terminal, in increasing order.
    pairs : ndarray of int64, shape (pairs, 2)
        Both terminals of every pair, as indices into `terminals`.
    resistance : ndarray of float64, shape (pairs,)
        Effective resistance of every pair in ohms: 0 for joined terminals, infinite between different components.
    error : float
        Bound on the relative error of every finite resistance, at most 1e-6.
    method : str
        Method of the linear solves: ``"direct"``, ``"multigrid"``, or ``"none"`` if all nodes are terminals.
    matrix : ndarray of float64, shape (terminals, terminals)
        Effective resistances of all pairs in ohms, symmetric, 0 on the diagonal; NaN for pairs that were not asked for.

    Examples
    --------
    >>> ladder = rg.Netlist(4, [[0, 1], [1, 2], [2, 3], [0, 3]], [1.0, 1.0, 1.0, 1.0])
    >>> found = rg.effective_resistance(ladder, terminals=[0, 1, 2])
    >>> found
    <EffectiveResistance of 3 terminals: 3 pairs, 0.75 to 1 ohm>
    >>> found.matrix.round(9)
    array([[0.  , 0.75, 1.  ],
           [0.75, 0.  , 0.75],
           [1.  , 0.75, 0.  ]])
    >>> bool(found.error < 1e-13)
    True
    """

    netlist: Netlist
    terminals: tuple[NDArray[np.int64], ...]
    pairs: NDArray[np.int64]
    resistance: NDArray[np.float64]
    error: float
    method: str

    def __repr__(self) -> str:
        text = f"<EffectiveResistance of {len(self.terminals):,} terminals: {len(self.pairs):,} pairs"
        if not len(self.pairs):
            return text + ">"
        return f"{text}, {self.resistance.min():.4g} to {self.resistance.max():.4g} ohm>"

    @property
    def matrix(self) -> NDArray[np.float64]:
        """Effective resistances in ohms, symmetric, shape (terminals, terminals); NaN for pairs not asked for."""
        count = len(self.terminals)
        matrix = np.full((count, count), np.nan)
        matrix[tuple(self.pairs.T)] = matrix[tuple(self.pairs.T[::-1])] = self.resistance
        np.fill_diagonal(matrix, 0.0)
        return matrix


@frozen
@dataclass(frozen=True, eq=False)
class ReducedNetwork:
    """The network between terminals that is equivalent to a larger circuit (Kron reduction).

    Returned by `resgrid.circuit.reduce_network`.

    Attributes
    ----------
    terminals : tuple of ndarray of int64
        Nodes of the original circuit that each terminal joins.
    netlist : Netlist
        The reduced circuit: node ``i + 1`` is terminal ``i``, named after its first node; ground has no element.
    conductance : ndarray of float64, shape (terminals, terminals)
        Conductance between every two terminals in siemens, symmetric, 0 on the diagonal.  Conductances below 5e-324 S
        are 0.
    error : float
        Bound on the relative error of every conductance other than 0: at most 1e-6, or larger if the smallest
        conductance is below 1e-317 S, where doubles have few digits.
    method : str
        Method of the linear solves: ``"direct"``, ``"multigrid"``, or ``"none"`` if all nodes are terminals.

    Examples
    --------
    >>> star = rg.Netlist(4, [[0, 1], [0, 2], [0, 3]], [1.0, 1.0, 1.0])
    >>> triangle = rg.circuit.reduce_network(star, [1, 2, 3])
    >>> triangle
    <ReducedNetwork of 3 terminals: 3 resistors>
    >>> triangle.conductance.round(9)
    array([[0.        , 0.33333333, 0.33333333],
           [0.33333333, 0.        , 0.33333333],
           [0.33333333, 0.33333333, 0.        ]])
    """

    terminals: tuple[NDArray[np.int64], ...]
    netlist: Netlist
    conductance: NDArray[np.float64]
    error: float
    method: str

    def __repr__(self) -> str:
        count = len(self.netlist.conductance)
        return f"<ReducedNetwork of {len(self.terminals):,} terminals: {count:,} resistor{'s' * (count != 1)}>"


class _Options(NamedTuple):
    """Options of the linear solves.

    `method`: ``"auto"``, ``"direct"`` or ``"multigrid"``; `threads`: largest number of threads of one solve;
    `executor`: workers that share terminals or pairs, None for this process; `progress`: called as ``progress(done,
    total)`` after every solve, or None.
    """

    method: str
    threads: int
    executor: Executor | None
    progress: Count | None


def effective_resistance(
    netlist: Netlist | CircuitLike,
    pairs: Collection[Any] | None = None,
    *,
    terminals: Collection[Any] | None = None,
    cells: bool = False,
    joined: Joined = "pair",
    method: str = "auto",
    threads: Annotated[int, Ge(1)] = 1,
    executor: Executor | None = None,
    progress: Count | None = None,
) -> EffectiveResistance:
    """Compute effective resistances between nodes, cells or regions of a circuit.

    The effective resistance of a pair is the voltage between both terminals when a current of 1 A flows through the
    circuit from one to the other.  Independent sources are set to zero: a voltage source is a wire, a current source is
    open.  Capacitors are open.  The circuit needs no ground, and node 0 is a node like others.  Compile a space with
    ``drive="none"`` (`resgrid.Wiring`): every free cell is then part of the circuit, no driven start is a wire, and the
    space needs no goal.

    Parameters
    ----------
    netlist : Netlist or Circuit
        Circuit of linear resistors.
    pairs : sequence of (first, second), optional
        The pairs.  A terminal is a node number, a node name, a list of both, or a mask of nodes.  A list or mask is a
        region, whose nodes are joined by an ideal wire.  An empty list gives an empty result.
    terminals : sequence, optional
        At least two terminals, whose pairs are all computed, in the order (0, 1), (0, 2), ..., (1, 2), ...; instead of
        `pairs`.
    cells : bool
        Whether terminals are cells of the compiled space (a tuple of indices, a list of tuples, or a mask of cells)
        instead of nodes.
    joined : {"pair", "all"}
        Regions that are wires while a pair is measured: those of this pair only, or all.  ``"all"`` needs a single
        factorization for any number of regions.
    method : {"auto", "direct", "multigrid"}
        Method for the linear systems; ``"auto"`` chooses by size and shape.
    threads : int
        Largest number of threads of one linear solve in one process.
    executor : concurrent.futures.Executor, optional
        Workers that share the right-hand sides (and the pairs with regions); None for this process.
    progress : callable, optional
        Called as ``progress(done, total)`` after every linear system.

    Returns
    -------
    EffectiveResistance
        Resistances in ohms, with a bound on their relative error.

    Raises
    ------
    InputError
        If a node or cell does not exist, both or neither of `pairs` and `terminals` are given, there are fewer than two
        terminals, or the circuit has nonlinear resistors.
    CircuitError
        If a result exceeds the range of doubles.
    AccuracyError
        If no relative error of 1e-6 is proved, because the conductances span too many orders of magnitude.
    BudgetError
        If the factors, or the matrix of the terminals, do not fit in memory.

    Notes
    -----
    All single nodes among the terminals share one factorization.  One right-hand side per terminal but the last gives
    the conductances of the equivalent network between the terminals (`resgrid.circuit.reduce_network`), and elimination
    without subtractions gives the resistances of all pairs.  Each resistance is accurate relative to itself, whatever
    the ratio of conductances; the difference ``Z_ii + Z_jj - 2 Z_ij`` of a pseudo-inverse loses digits by cancellation.
    If products of conductances leave the range of doubles, circuits of at most 2,000 nodes and 200 terminals are solved
    in decimals with unbounded exponents, and larger circuits raise AccuracyError.

    Examples
    --------
    >>> space = rg.build_space(rg.read_scene("examples/scenes/lesson.toml"))
    >>> grid = rg.compile_space(space, boundary="neumann", drive="none")
    >>> found = rg.effective_resistance(grid, [((6, 2), (7, 2)), ((6, 2), (1, 1))], cells=True)
    >>> found.resistance.round(3)
    array([ 5509.741, 20054.162])
    >>> triangle = rg.Netlist(3, [[0, 1], [1, 2], [2, 0]], [1e-3, 1e-3, 1e-3])
    >>> rg.effective_resistance(triangle, [(0, 1), (0, [1, 2])]).resistance.round(6)
    array([666.666667, 500.      ])
    """
    circuit = netlist_of(netlist)
    require_linear(circuit)
    read = TerminalReader(circuit, cells)
    ends, chosen = pairs_of(read, pairs, terminals)
    options = _Options(method, threads, executor, progress)
    if not len(chosen):
        return EffectiveResistance(circuit, ends, chosen, np.zeros(0), 0.0, "none")
    if joined == "all" or all(len(nodes) == 1 for nodes in ends):
        resistance, error, used = _share_factors(circuit, ends, chosen, options)
    else:
        resistance, error, used = _pair_by_pair(circuit, ends, chosen, options)
    return EffectiveResistance(circuit, ends, chosen, resistance, error, used)


def reduce_network(
    netlist: Netlist | CircuitLike,
    terminals: Collection[Any],
    *,
    cells: bool = False,
    method: str = "auto",
    threads: Annotated[int, Ge(1)] = 1,
    executor: Executor | None = None,
    progress: Count | None = None,
) -> ReducedNetwork:
    """Return the network of resistors between some terminals that is equivalent to a circuit (Kron reduction).

    The currents into the terminals are the same functions of the terminal voltages in both circuits.  Independent
    sources are set to zero: a voltage source is a wire, a current source is open.

    Parameters
    ----------
    netlist : Netlist or Circuit
        Circuit of linear resistors.
    terminals : sequence
        Node numbers, node names, or regions: lists or masks of nodes.  Ideal wires join the nodes of a region.
    cells : bool
        Whether terminals are cells of the compiled space (index tuples, lists of these, or masks) instead of nodes.
    method : {"auto", "direct", "multigrid"}
        Method for the linear systems; ``"auto"`` chooses by size and shape.
    threads : int
        Largest number of threads of one solve.
    executor : concurrent.futures.Executor, optional
        Workers that share the right-hand sides; None for this process.
    progress : callable, optional
        Called as ``progress(done, total)`` after every linear system.

    Returns
    -------
    ReducedNetwork
        Conductances between the terminals in siemens, each with a small relative error.

    Raises
    ------
    InputError
        If a node does not exist, two terminals are joined by voltage sources or share a node, or the circuit has
        nonlinear resistors.
    CircuitError
        If a result exceeds the range of doubles.
    AccuracyError
        If no relative error of 1e-6 is proved, because the conductances span too many orders of magnitude.
    BudgetError
        If the factors, or the matrix of the terminals, do not fit in memory.

    Examples
    --------
    >>> path = rg.Netlist(4, [[0, 1], [1, 2], [2, 3]], [1.0, 0.5, 0.5])
    >>> rg.circuit.reduce_network(path, [0, 3]).conductance.round(9)
    array([[0. , 0.2],
           [0.2, 0. ]])
    """
    circuit = netlist_of(netlist)
    require_linear(circuit)
    read = TerminalReader(circuit, cells)
    ends = tuple(read.nodes(terminal) for terminal in terminals)
    group = joined_nodes(circuit, ends)
    groups = np.array([group[nodes[0]] for nodes in ends], dtype=np.int64)
    first_of: dict[int, int] = {}
    for other, number in enumerate(groups.tolist()):
        one = first_of.setdefault(number, other)
        if one != other:
            raise InputError(
                f"terminals {one} and {other} are joined by a voltage source or share a node; leave one of them out"
            )
    found = bounded_conductances(
        circuit, group, groups, method=method, threads=threads, executor=executor, progress=progress
    )
    low, high = np.nonzero(np.triu(found.values))
    names, spare = circuit.names_of([nodes[0] for nodes in ends]), "ground"
    while spare in names:
        spare += "_0"
    names = [spare if name == "0" else name for name in names]  # the new node 0 has the name "0"
    reduced = Netlist(
        len(ends) + 1, np.stack([low + 1, high + 1], axis=1), found.values[low, high], node_names=("0", *names)
    )
    return ReducedNetwork(ends, reduced, found.values, found.error, found.method)


def _share_factors(
    netlist: Netlist, ends: tuple[Nodes, ...], pairs: NDArray[np.int64], options: _Options
) -> tuple[NDArray[np.float64], float, str]:
    """Return resistances (p,) in ohms, the bound on their relative error and the method, from a single factorization.

    `ends`: nodes of every terminal, joined by ideal wires; `pairs` (p, 2): indices of both terminals of every pair.
    """
    group = joined_nodes(netlist, ends)
    groups, number = np.unique([group[nodes[0]] for nodes in ends], return_inverse=True)
    found = bounded_resistances(netlist, group, groups, number[pairs], **options._asdict())
    return found.values, found.error, found.method


def _pair_by_pair(
    netlist: Netlist, ends: tuple[Nodes, ...], pairs: NDArray[np.int64], options: _Options
) -> tuple[NDArray[np.float64], float, str]:
    """Return resistances (p,) in ohms, a bound on their relative error and the method, with one pair joined at a time.

    `ends`: nodes of every terminal; `pairs` (p, 2): indices of both terminals of every pair. The pairs of single nodes
    share one factorization.
    """
    single = np.array([len(nodes) == 1 for nodes in ends])
    simple = single[pairs].all(axis=1)
    others = [(ends[first], ends[second]) for first, second in pairs[~simple].tolist()]
    resistance, error, method = np.zeros(len(pairs)), 0.0, "none"
    if simple.any():
        used, numbers = np.unique(pairs[simple], return_inverse=True)
        resistance[simple], error, method = _share_factors(
            netlist, tuple(ends[number] for number in used), numbers.reshape(-1, 2), options
        )
    found = []
    alone = options._replace(threads=options.threads if options.executor is None else 1, executor=None, progress=None)
    part = JobPart(partial(_resistances_of, alone), netlist, others, "pairs")
    with closing(in_order([part], options.executor)) as results:
        for done, (ohms, bound, name) in enumerate(results, 1):
            found.append(ohms)
            error, method = max(error, bound), name if method == "none" else method
            if options.progress is not None:
                options.progress(done, len(others))
    resistance[~simple] = found
    return resistance, error, method


def _resistances_of(
    options: _Options, netlist: Netlist, pairs: Sequence[tuple[Nodes, Nodes]]
) -> list[tuple[float, float, str]]:
    """Return the resistance in ohms, the bound on its relative error and the method, for each of some pairs.

    `pairs`: node numbers of both terminals of each pair; ideal wires join the nodes of a terminal.
    """
    results = []
    for pair in pairs:
        (ohms,), error, name = _share_factors(netlist, pair, np.array([[0, 1]]), options)
        results.append((float(ohms), error, name))
    return results
