"""Random walks that correspond to a resistor network: hitting and collision probabilities, expected times.

From a node, the walk jumps along one of its resistors, with probability proportional to the conductance, until it is
absorbed on a rail (Doyle & Snell 1984, section 1.3; Connolly 1997).  In continuous time, it jumps along a resistor of
conductance ``g`` at the rate ``g / C``, where ``C`` is the capacitance of a node.

A leak kills the walk: in every cell it ends on the obstacle rail at the rate ``leak D``, where ``D = h_ref**2 / (R C)``
is the diffusivity.  The drop is then the probability of a goal before an obstacle and before this end.  It is also the
Laplace transform ``u = E[exp(-leak D T)]`` of the time ``T`` to the goal in the circuit without the leak, where walks
that hit an obstacle first count as 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid._internal.memory import require_memory
from resgrid._internal.values import frozen
from resgrid.circuit.linear import CircuitFactor
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.solve import factorize
from resgrid.core.cell import Cell
from resgrid.core.cell_map import CellMap
from resgrid.core.netlist import GROUND, Netlist
from resgrid.errors import AccuracyError, InputError
from resgrid.planning.walk_equations import factor_cut_off, to_goal_conductance
from resgrid.solvers.progress import ProgressMonitor
from resgrid.solvers.refinement import is_answer
from resgrid.solvers.scaled import Scaled, power


@frozen
@dataclass(frozen=True, eq=False)
class RandomWalk:
    """Random walk on the free cells of a space, with a factorization that all probabilities and times share.

    Returned by `resgrid.planning.random_walk`.

    Attributes
    ----------
    cells : CellMap
        Map between nodes and cells.
    factors : CircuitFactor or None
        Factorization of the nodal equations of all free nodes; None if no free cell has a node.
    row : ndarray of int32, shape of the space
        Matrix row of every free cell; -1 for other cells, and for free cells without a node.
    to_goal : scipy.sparse.csr_array of float64, shape (goals, rows)
        Conductance from every row to every goal region, in siemens.

    Examples
    --------
    >>> walk = rg.planning.random_walk(rg.compile_space(rg.build_space(rg.read_scene("examples/scenes/lesson.toml"))))
    >>> walk.to_goal.shape, int(walk.row[6, 2])
    ((1, 56), 43)
    >>> round(float(rg.planning.collision_probability(walk).collision[6, 2]), 6)
    0.573718
    >>> round(float(rg.planning.hitting_probability(walk).probability[0, 6, 2]), 6)
    0.426282
    """

    cells: CellMap
    factors: CircuitFactor | None
    row: NDArray[np.int32]
    to_goal: sparse.csr_array

    def solve(self, rhs: NDArray[np.float64] | Scaled) -> Scaled:
        """Solve ``G x = rhs`` with componentwise accuracy, where ``G`` is the conductance matrix in siemens.

        Parameters
        ----------
        rhs : ndarray of float64, shape (rows,), or Scaled
            Right-hand side without negative entries.

        Returns
        -------
        Scaled
            Solution, shape (rows,), with a separate exponent for every row, so that small entries do not underflow.

        Raises
        ------
        AccuracyError
            If the conductances differ by more orders of magnitude than the factors can represent.
        """
        if self.factors is None:
            return rhs if isinstance(rhs, Scaled) else Scaled.of(rhs)
        watch = ProgressMonitor()
        answer, error = self.factors.factors.solve_nonnegative(rhs, watch=watch)
        if not is_answer(error, watch.bound):
            raise AccuracyError(
                f"the direct solver reached a componentwise backward error of only {error:.1e}: the conductances "
                "differ by more orders of magnitude than its factors can represent; reduce their ratio",
                answer,
            )
        return answer

    def per_cell(
        self, values: NDArray[np.float64], *, obstacle: float, goal: float, cut_off: float
    ) -> NDArray[np.float64]:
        """Return the values of rows as an array over the cells.

        Parameters
        ----------
        values : ndarray of float64, shape (rows,)
            Value of every row.
        obstacle, goal, cut_off : float
            Values for obstacle cells, goal cells, and free cells without a row.

        Returns
        -------
        ndarray of float64, shape of the space
            Value of every cell.
        """
        cell = self.cells.space.cell
        out = np.full(cell.shape, cut_off)
        out[cell == Cell.OBSTACLE], out[cell == Cell.GOAL] = obstacle, goal
        solved = self.row >= 0
        out[solved] = values[self.row[solved]]
        return out


def random_walk(circuit: Netlist | OperatingPoint | RandomWalk, *, method: str = "auto") -> RandomWalk:
    """Factorize the random walk of a compiled circuit, for `collision_probability` and `hitting_probability`.

    Parameters
    ----------
    circuit : Netlist, OperatingPoint or RandomWalk
        Circuit compiled from a space, with ideal sources on each rail.  Obstacles are on a rail, behind wall
        resistances, or open with a uniform drive or a leak.  A `RandomWalk` is returned unchanged.
    method : {"auto", "direct", "multigrid"}
        Solution method of `resgrid.solve`.

    Returns
    -------
    RandomWalk
        The walk with the factorization of the nodal equations.

    Raises
    ------
    InputError
        If the netlist was not compiled from a space, has drive = 'start', or has a goal cell without an ideal source.
    BudgetError
        If the factors would not fit in memory.

    Examples
    --------
    >>> walk = rg.planning.random_walk(rg.compile_space(rg.build_space(rg.read_scene("examples/scenes/lesson.toml"))))
    >>> round(float(rg.planning.collision_probability(walk).success[6, 2]), 6)
    0.426282
    >>> round(float(rg.planning.hitting_probability(walk).probability[0, 6, 2]), 6)
    0.426282
    """
    if isinstance(circuit, RandomWalk):
        return circuit
    netlist = circuit.netlist if isinstance(circuit, OperatingPoint) else circuit
    cells, space = netlist.cells, netlist.cells.space
    if cells.wiring.drive == "start":
        raise InputError("a start-driven circuit absorbs walks at its start: compile it with drive = 'uniform'")
    if not np.any(space.cell == Cell.FREE):
        raise InputError("the space has no free cell in which a walk could start; remove obstacles or refine the grid")
    if not (free := cells.free_node).size:
        return RandomWalk(cells, None, np.full(space.shape, -1, np.int32), sparse.csr_array((space.goal_count, 0)))
    # A current into every free node: otherwise components without currents would be left out of the factorization.
    sources = np.stack([np.full(free.size, GROUND), free], axis=1)
    driven = netlist.replace(current_nodes=sources, current_amps=np.full(free.size, 1.0 / cells.wiring.resistance))
    factors = factorize(driven, method=method)
    system = factors.system
    node_goal = np.full(netlist.node_count, -1, dtype=np.int64)
    goals = space.cell == Cell.GOAL
    node_goal[cells.node[goals]] = space.goal_region[goals]
    if np.any(np.isnan(system.known_voltages()[node_goal >= 0])):
        raise InputError(
            "a goal cell is connected to its rail through a resistance, so that no walk ends there: use the ideal "
            "netlist of rg.compile_space"
        )
    row = np.where((space.cell == Cell.FREE) & (cells.node >= 0), system.unknown[cells.node], -1)
    return RandomWalk(cells, factors, row, to_goal_conductance(netlist, node_goal, system.unknown, system.size))


@frozen
@dataclass(frozen=True, eq=False)
class CollisionProbability:
    """Hitting probabilities and expected times of random walks that start in each cell.

    Returned by `resgrid.planning.collision_probability`.  Times are in units of ``R C``, where R is the resistance
    between nearest cells at conductivity 1 and C the capacitance of a cell.  A Brownian motion with diffusivity
    ``h_ref**2 / (R C)`` has approximately the same times.  Steps are jumps of the walk, including the last jump onto a
    rail.

    Attributes
    ----------
    success : ndarray of float64, shape of the space
        Probability ``u`` of hitting a goal before an obstacle (and before the end by a leak), 0 on underflow.
    log_success : ndarray of float64, shape of the space
        Natural logarithm of `success`, accurate even on underflow.
    time, steps : ndarray of float64, shape of the space
        Expected time in units of ``R C`` and expected number of jumps until a goal or obstacle is hit, or a leak ends
        the walk (``G t = C``, ``G n = D 1`` with the diagonal ``D`` of ``G``).  0 on goals and obstacles; infinite in
        cells that are connected to neither, unless there is a leak.
    time_given_success, steps_given_success : ndarray of float64, shape of the space
        Expectations over the walks that hit a goal (``s / u`` with ``G s = C u`` or ``G s = D u``); NaN where
        ``u`` is 0.
    collision : ndarray of float64, shape of the space
        Probability ``1 - u`` of hitting an obstacle first, of the end by a leak, or of never hitting a goal.

    Examples
    --------
    >>> space = rg.ConfigurationSpace([rg.Axis("x", 0.0, 5.0, 5)], [2, 0, 0, 0, 1])
    >>> walk = rg.planning.collision_probability(rg.compile_space(space))
    >>> walk.collision[1:].round(6)
    array([0.25, 0.5 , 0.75, 1.  ])
    >>> walk.time.round(6), walk.steps_given_success.round(6)
    (array([0. , 1.5, 2. , 1.5, 0. ]), array([0.      , 2.333333, 4.      , 5.      ,      nan]))
    """

    success: NDArray[np.float64]
    log_success: NDArray[np.float64]
    time: NDArray[np.float64]
    steps: NDArray[np.float64]
    time_given_success: NDArray[np.float64]
    steps_given_success: NDArray[np.float64]

    @property
    def collision(self) -> NDArray[np.float64]:
        """Probability ``1 - u`` of hitting an obstacle before a goal, or no goal at all, shape of the space."""
        return np.asarray(-np.expm1(self.log_success))


def collision_probability(circuit: Netlist | OperatingPoint | RandomWalk) -> CollisionProbability:
    """Compute the probability that a random walk hits an obstacle before a goal, and the expected times.

    The walk jumps along a resistor with probability proportional to its conductance.  The drop ``u`` of the potential
    is the probability that the walk hits a goal before an obstacle (C. I. Connolly, Harmonic functions and collision
    probabilities, Int. J. Robotics Research 16(4), 1997).  With open obstacles and no leak ``u`` is 1, and the
    expected time is proportional to the uniformly driven potential.

    Parameters
    ----------
    circuit : Netlist, OperatingPoint or RandomWalk
        Circuit compiled from a space, with ideal sources on each rail, or a factorized walk (`random_walk`).

    Returns
    -------
    CollisionProbability
        Probabilities, times and numbers of steps for every cell, from one factorization.

    Raises
    ------
    InputError
        If the netlist was not compiled from a space, has drive = 'start', or has a goal cell without an ideal source.
    AccuracyError
        If the conductances differ by more orders of magnitude than the factors can represent.

    Examples
    --------
    >>> space = rg.ConfigurationSpace([rg.Axis("x", 0.0, 5.0, 5)], [2, 0, 0, 0, 1])
    >>> walk = rg.planning.collision_probability(rg.compile_space(space))
    >>> walk.success.round(6), walk.steps.round(6)
    (array([1.  , 0.75, 0.5 , 0.25, 0.  ]), array([0., 3., 4., 3., 0.]))
    """
    walk = random_walk(circuit)
    degree = walk.factors.system.laplacian.diagonal if walk.factors is not None else np.zeros(0)
    capacitance = np.full(len(degree), 1.0 / walk.cells.wiring.resistance)  # in units in which R C is 1
    u = walk.solve(walk.to_goal.T @ np.ones(walk.to_goal.shape[0]))
    log_u = np.minimum(u.log, 0.0)

    def given(rates: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return ``x / u`` of every cell, shape of the space: the expectation over the walks that hit a goal first.

        ``G x = rates * u``, with the conductance matrix ``G`` and the probability ``u`` of hitting a goal before an
        obstacle; NaN where ``u`` is 0.  `rates` (rows,): capacitance of each node for expected times, or sum of its
        conductances for expected numbers of jumps.
        """
        x = walk.solve(Scaled(u.hi * rates, u.lo * rates, u.exponent, u.noise))
        with np.errstate(invalid="ignore", divide="ignore"):
            quotient = x.hi / u.hi
        values = quotient * power(np.where(u.hi > 0, x.exponent - u.exponent, 0))
        return walk.per_cell(np.asarray(values, np.float64), obstacle=np.nan, goal=0.0, cut_off=np.nan)

    time = walk.per_cell(walk.solve(capacitance).plain, obstacle=0.0, goal=0.0, cut_off=np.inf)
    steps = walk.per_cell(walk.solve(degree).plain, obstacle=0.0, goal=0.0, cut_off=np.inf)
    _fill_cut_off(walk, time, steps)
    return CollisionProbability(
        success=walk.per_cell(np.exp(log_u), obstacle=0.0, goal=1.0, cut_off=0.0),
        log_success=walk.per_cell(log_u, obstacle=-np.inf, goal=0.0, cut_off=-np.inf),
        time=time,
        steps=steps,
        time_given_success=given(capacitance),
        steps_given_success=given(degree),
    )


def _fill_cut_off(walk: RandomWalk, time: NDArray[np.float64], steps: NDArray[np.float64]) -> None:
    """Set the expected times and numbers of jumps until a leak ends the walk in cells without a node, in place.

    `time`, `steps` (shape of the space): expectations; unchanged without a leak.
    """
    found = factor_cut_off(walk.cells)
    if found is None:
        return
    factors, row = found
    own = RandomWalk(walk.cells, factors, row, sparse.csr_array((walk.to_goal.shape[0], factors.system.size)))
    degree = factors.system.laplacian.diagonal
    time[row >= 0] = own.solve(np.full(len(degree), 1.0 / walk.cells.wiring.resistance)).plain[row[row >= 0]]
    steps[row >= 0] = own.solve(degree).plain[row[row >= 0]]


@frozen
@dataclass(frozen=True, eq=False)
class HittingProbability:
    """Hitting probabilities of every goal region, for random walks that start in each cell.

    Returned by `resgrid.planning.hitting_probability`.

    Attributes
    ----------
    probability : ndarray of float64, shape (goals,) + shape of the space
        Probability of absorption at each goal region, before any obstacle; 0 on underflow.
    log_probability : ndarray of float64, shape (goals,) + shape of the space
        Natural logarithm of `probability`; -inf where the goal cannot be hit.
    likeliest : ndarray of int32, shape of the space
        Goal region with the largest probability, the lower index of ties; -1 where no goal can be hit.

    Examples
    --------
    >>> space = rg.ConfigurationSpace([rg.Axis("x", 0.0, 6.0, 6)], [2, 0, 0, 1, 0, 2])
    >>> hits = rg.planning.hitting_probability(rg.compile_space(space))
    >>> hits.probability[:, 1:3].round(6)
    array([[0.666667, 0.333333],
           [0.      , 0.      ]])
    >>> hits.likeliest
    array([ 0,  0,  0, -1,  1,  1], dtype=int32)
    """

    probability: NDArray[np.float64]
    log_probability: NDArray[np.float64]

    @property
    def likeliest(self) -> NDArray[np.int32]:
        """Index of the goal region with the largest probability, shape of the space; -1 where no goal can be hit.

        Of goal regions with equal probabilities, the one with the lowest index is chosen.
        """
        best = np.argmax(self.log_probability, axis=0).astype(np.int32)
        return np.where(np.isneginf(self.log_probability.max(axis=0)), np.int32(-1), best)


def hitting_probability(circuit: Netlist | OperatingPoint | RandomWalk) -> HittingProbability:
    """Compute the probability that a random walk ends at each goal region.

    One factorization serves all goals, with one solve per goal.  The sum over the goals is the probability ``success``
    of `collision_probability`.

    Parameters
    ----------
    circuit : Netlist, OperatingPoint or RandomWalk
        Circuit compiled from a space, with ideal sources on each rail, or a factorized walk (`random_walk`).

    Returns
    -------
    HittingProbability
        Probabilities for every cell and goal region, and the most probable goal.

    Raises
    ------
    InputError
        If the netlist was not compiled from a space, has drive = 'start', or has a goal cell without an ideal source.
    AccuracyError
        If the conductances differ by more orders of magnitude than the factors can represent.
    BudgetError
        If the result would not fit in memory.

    Examples
    --------
    >>> space = rg.ConfigurationSpace([rg.Axis("x", 0.0, 5.0, 5)], [2, 0, 0, 0, 2])
    >>> hits = rg.planning.hitting_probability(rg.compile_space(space))
    >>> hits.probability.round(6)
    array([[1.  , 0.75, 0.5 , 0.25, 0.  ],
           [0.  , 0.25, 0.5 , 0.75, 1.  ]])
    >>> hits.likeliest
    array([0, 0, 0, 1, 1], dtype=int32)
    """
    walk = random_walk(circuit)
    space = walk.cells.space
    require_memory(
        16.0 * space.goal_count * space.cell.size,
        f"a probability for each of {space.goal_count:,} goals in every cell",
        "merge goals, or use a coarser grid",
    )
    log_probability = np.full((space.goal_count, *space.shape), -np.inf)
    for goal in range(space.goal_count):
        contact = walk.to_goal[[goal]].toarray().ravel()
        if contact.any():
            logs = np.minimum(walk.solve(contact).log, 0.0)
            log_probability[goal] = walk.per_cell(logs, obstacle=-np.inf, goal=-np.inf, cut_off=-np.inf)
        log_probability[goal][space.goal_region == goal] = 0.0
    return HittingProbability(np.exp(log_probability), log_probability)
