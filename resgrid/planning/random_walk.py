"""The random walk that a resistor network stands for.

From a node the walk jumps along one of its resistors, with probability proportional to the conductance, until it is
absorbed on a rail (Doyle & Snell 1984, section 1.3; Connolly 1997).  In continuous time every resistor of conductance
``g`` is taken at the rate ``g / C``, ``C`` being the capacitance of a node.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.budget import require_memory
from resgrid.errors import AccuracyError, InputError
from resgrid.frozen import frozen
from resgrid.netlist import GROUND, CellMap, Netlist
from resgrid.nodal.factors.factor import Factor
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.nodal.refine import is_answer
from resgrid.nodal.scaled import Scaled, power
from resgrid.nodal.solve import factor
from resgrid.nodal.watch import Watch
from resgrid.space import Cell


@frozen
@dataclass(frozen=True, eq=False)
class Walk:
    """A random walk on the free cells of a space: one factorisation, for many questions.

    Attributes
    ----------
    cell_map : CellMap
        Of the netlist.
    factors : Factor
        Of the nodal equations of every free node.
    row : ndarray of int64, shape of the space
        Row of every free cell, -1 elsewhere.
    to_goal : scipy.sparse.csr_array of float64, shape (goals, rows)
        Conductance from every row to every goal region, in siemens.
    """

    cell_map: CellMap
    factors: Factor
    row: NDArray[np.int64]
    to_goal: sparse.csr_array

    @property
    def degree(self) -> NDArray[np.float64]:
        """Sum of the conductances at every row, in siemens; shape (rows,)."""
        return self.factors.system.degree

    def solve(self, rhs: NDArray[np.float64] | Scaled) -> Scaled:
        """Solve ``G x = rhs`` entry by entry as accurately as can be.

        Parameters
        ----------
        rhs : ndarray of float64 or Scaled, shape (rows,)
            None negative.

        Returns
        -------
        Scaled, shape (rows,)

        Raises
        ------
        AccuracyError
            If the conductances differ by more decades than the factors can hold.
        """
        watch = Watch()
        answer, error = self.factors.solve_nonnegative(rhs, watch=watch)
        if not is_answer(error, watch.bound):
            raise AccuracyError(
                f"the direct solver reached a componentwise backward error of {error:.1e} only: the conductances "
                "differ by more decades than its factors can hold",
                answer,
            )
        return answer

    def per_cell(self, values: NDArray[np.float64], *, obstacle: float, goal: float) -> NDArray[np.float64]:
        """Spread the values of rows over the cells of the space.

        Parameters
        ----------
        values : ndarray of float64, shape (rows,)
        obstacle, goal : float
            Values of obstacle and goal cells.

        Returns
        -------
        ndarray of float64, shape of the space
            NaN in free cells without a node.
        """
        cell = self.cell_map.space.cell
        out = np.full(cell.shape, np.nan)
        out[cell == Cell.OBSTACLE], out[cell == Cell.GOAL] = obstacle, goal
        solved = self.row >= 0
        out[solved] = values[self.row[solved]]
        return out


def random_walk(circuit: Netlist | OperatingPoint | Walk, *, method: str = "auto") -> Walk:
    """Set up the random walk of a compiled circuit.

    Parameters
    ----------
    circuit : Netlist, OperatingPoint or Walk
        Compiled from a space, each rail held by ideal sources; with obstacles on a rail, behind walls, or open under
        a uniform drive.  A walk is returned as it is.
    method : {"auto", "direct", "multigrid"}
        How to solve; see `resgrid.solve`.

    Returns
    -------
    Walk

    Raises
    ------
    InputError
        If the netlist was not compiled from a space, a start drives it, or a goal cell floats.
    BudgetError
        If the factors would not fit in memory.
    """
    if isinstance(circuit, Walk):
        return circuit
    netlist = circuit.netlist if isinstance(circuit, OperatingPoint) else circuit
    cell_map = netlist.cell_map
    if cell_map is None:
        raise InputError("this netlist was not compiled from a space, so there is no walk on its cells")
    if cell_map.wiring.drive == "start":
        raise InputError("a start-driven circuit absorbs walks at its start: compile it with drive = 'uniform'")
    factors = factor(_clocked(netlist, cell_map), method=method)
    system = factors.system
    node_goal = _goal_of_node(netlist, cell_map)
    if np.any(np.isnan(system.known[node_goal >= 0])):
        raise InputError("a goal cell is tied to its rail by more than an ideal source, so that no walk ends there")
    row = np.where(cell_map.space.cell == Cell.FREE, system.unknown[cell_map.node], -1)
    row[cell_map.node < 0] = -1
    return Walk(cell_map, factors, row, _to_goal(netlist, node_goal, system.unknown, system.size))


def _clocked(netlist: Netlist, cell_map: CellMap) -> Netlist:
    """The circuit with one current into every free node: no part of it is flat, so that all of it is factored."""
    free = cell_map.free_node
    if not free.size:
        raise InputError("the space has no free cell that a walk could start from")
    amps = np.full(free.size, 1.0 / cell_map.wiring.resistance)
    return netlist.replace(current_nodes=np.stack([np.full(free.size, GROUND), free], axis=1), current_amps=amps)


def _goal_of_node(netlist: Netlist, cell_map: CellMap) -> NDArray[np.int64]:
    goal = np.full(netlist.node_count, -1, dtype=np.int64)
    cells = cell_map.space.cell == Cell.GOAL
    goal[cell_map.node[cells]] = cell_map.space.goal_region[cells]
    return goal


def _to_goal(netlist: Netlist, node_goal: NDArray[np.int64], unknown: NDArray[np.int32], size: int) -> sparse.csr_array:
    entries: list[NDArray[np.float64]] = []
    for here, there in ((0, 1), (1, 0)):
        row = unknown[netlist.resistor_nodes[:, here]]
        goal = node_goal[netlist.resistor_nodes[:, there]]
        touches = (row >= 0) & (goal >= 0)
        entries.append(np.stack([netlist.conductance[touches], goal[touches], row[touches]]))
    conductance, goal, row = np.concatenate(entries, axis=1)
    shape = (int(node_goal.max()) + 1, size)
    return sparse.coo_array((conductance, (goal.astype(np.int64), row.astype(np.int64))), shape=shape).tocsr()


@frozen
@dataclass(frozen=True, eq=False)
class Risk:
    """What happens to a random walk from the centre of every cell.  All arrays have the shape of the space.

    Times are in units of ``R C``: the resistance between the cells that lie closest together, at conductivity 1, times
    the capacitance of a cell; a Brownian motion of diffusivity ``h_ref**2 / (R C)`` takes about as long.  Steps are
    jumps of the walk, the last one onto a rail included.

    Attributes
    ----------
    success : ndarray of float64
        Probability ``u`` of meeting a goal before an obstacle; 0 where it underflows.
    log_success : ndarray of float64
        Its natural logarithm, right to the last digits where ``u`` underflows; -inf where no goal can be met.
    time, steps : ndarray of float64
        Expected time, in ``R C``, and number of jumps until either is met: ``G t = C``, ``G n = D 1`` with ``D`` the
        diagonal of ``G``.  0 on goals and obstacles; infinite where the walk meets neither.
    time_given_success, steps_given_success : ndarray of float64
        The same, of those walks only that meet a goal: ``s / u`` with ``G s = C u``, or ``G s = D u``.  NaN where no
        goal can be met.
    """

    success: NDArray[np.float64]
    log_success: NDArray[np.float64]
    time: NDArray[np.float64]
    steps: NDArray[np.float64]
    time_given_success: NDArray[np.float64]
    steps_given_success: NDArray[np.float64]


def risk(circuit: Netlist | OperatingPoint | Walk) -> Risk:
    """Read the risk of every cell off one factorisation.

    The drop ``u`` of the potential is the probability that a random walk, which jumps along a resistor with probability
    proportional to its conductance, meets a goal before an obstacle (C. I. Connolly, Harmonic functions and collision
    probabilities, Int. J. Robotics Research 16(4), 1997).  With open obstacles it is 1 and the expected time is
    proportional to the uniformly driven potential.

    Parameters
    ----------
    circuit : Netlist, OperatingPoint or Walk
        As `random_walk` takes it.

    Returns
    -------
    Risk

    Raises
    ------
    InputError
        As `random_walk`.
    AccuracyError
        If the conductances differ by more decades than the factors can hold.
    """
    walk = random_walk(circuit)
    second = 1.0 / walk.cell_map.wiring.resistance
    degree = walk.degree
    u = walk.solve(walk.to_goal.T @ np.ones(walk.to_goal.shape[0]))
    log_u = np.minimum(u.log, 0.0)
    ones = np.ones(len(degree))
    return Risk(
        success=_placed(walk, np.exp(log_u), 0.0, 1.0, 0.0),
        log_success=_placed(walk, log_u, -np.inf, 0.0, -np.inf),
        time=_placed(walk, walk.solve(second * ones).plain, 0.0, 0.0, np.inf),
        steps=_placed(walk, walk.solve(degree).plain, 0.0, 0.0, np.inf),
        time_given_success=_placed(walk, _ratio(walk.solve(_times(u, second * ones)), u), np.nan, 0.0, np.nan),
        steps_given_success=_placed(walk, _ratio(walk.solve(_times(u, degree)), u), np.nan, 0.0, np.nan),
    )


def _placed(
    walk: Walk, values: NDArray[np.float64], obstacle: float, goal: float, cut_off: float
) -> NDArray[np.float64]:
    """Values on cells; ``cut_off`` is that of free cells without a node, from where a walk never ends."""
    out = walk.per_cell(values, obstacle=obstacle, goal=goal)
    out[(walk.row < 0) & (walk.cell_map.space.cell == 0)] = cut_off
    return out


def _times(value: Scaled, by: NDArray[np.float64]) -> Scaled:
    return Scaled(value.hi * by, value.lo * by, value.exponent, value.noise)


def _ratio(numerator: Scaled, denominator: Scaled) -> NDArray[np.float64]:
    """Quotient of scaled numbers; NaN where the denominator is 0."""
    with np.errstate(invalid="ignore", divide="ignore"):
        quotient = numerator.hi / denominator.hi
    exponent = np.where(denominator.hi > 0, numerator.exponent - denominator.exponent, 0)
    return np.asarray(quotient * power(exponent), dtype=np.float64)


@frozen
@dataclass(frozen=True, eq=False)
class Absorption:
    """Where a random walk from the centre of every cell ends.

    Attributes
    ----------
    probability : ndarray of float64, shape (goals, ...), the rest of the space
        Probability of being absorbed at each goal region, before any obstacle; 0 where it underflows.
    log_probability : ndarray of float64, same shape
        Its natural logarithm; -inf where that goal cannot be met.
    """

    probability: NDArray[np.float64]
    log_probability: NDArray[np.float64]

    @property
    def likeliest(self) -> NDArray[np.int32]:
        """The goal region each cell's walk most probably ends at, -1 for none; shape of the space, int32.

        The lower number where two are equally likely.
        """
        best = np.argmax(self.log_probability, axis=0).astype(np.int32)
        return np.where(np.isneginf(self.log_probability.max(axis=0)), np.int32(-1), best)


def absorption(circuit: Netlist | OperatingPoint | Walk) -> Absorption:
    """Find the probability to be absorbed at each goal: one solve a goal, one factorisation for all.

    Summed over the goals it is `Risk.success`.

    Parameters
    ----------
    circuit : Netlist, OperatingPoint or Walk
        As `random_walk` takes it.

    Returns
    -------
    Absorption

    Raises
    ------
    InputError
        As `random_walk`.
    AccuracyError
        If the conductances differ by more decades than the factors can hold.
    BudgetError
        If the answer would not fit in memory.
    """
    walk = random_walk(circuit)
    space = walk.cell_map.space
    require_memory(
        16.0 * space.goal_count * space.cell.size,
        f"a probability for each of {space.goal_count:,} goals in every cell",
        "merge goals, or use a coarser grid",
    )
    log_probability = np.full((space.goal_count, *space.shape), -np.inf)
    for goal in range(space.goal_count):
        contact = walk.to_goal[[goal]].toarray().ravel()
        if contact.any():
            at = walk.solve(contact)
            values = np.minimum(at.log, 0.0)
            log_probability[goal] = walk.per_cell(values, obstacle=-np.inf, goal=-np.inf)
        log_probability[goal][space.goal_region == goal] = 0.0
    log_probability[:, (walk.row < 0) & (space.cell == Cell.FREE)] = -np.inf
    return Absorption(np.exp(log_probability), log_probability)
