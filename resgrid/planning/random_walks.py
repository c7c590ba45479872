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

from resgrid._internal.memory import require_memory
from resgrid._internal.values import frozen
from resgrid.circuit.linear import CircuitFactor
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.solve import factorize
from resgrid.core.netlist import GROUND, CellMap, Netlist
from resgrid.core.space import Cell
from resgrid.errors import AccuracyError, InputError
from resgrid.solvers.progress import ProgressMonitor
from resgrid.solvers.refinement import is_answer
from resgrid.solvers.scaled import Scaled, power


@frozen
@dataclass(frozen=True, eq=False)
class RandomWalk:
    """A random walk on the free cells of a space: one factorisation, for many questions.

    `cells`: of the netlist; `factors`: of the nodal equations of every free node; `row` as the space: row of every free
    cell, -1 elsewhere; `to_goal` (goals, rows): conductance from every row to every goal region, in siemens.
    """

    cells: CellMap
    factors: CircuitFactor
    row: NDArray[np.int64]
    to_goal: sparse.csr_array

    def solve(self, rhs: NDArray[np.float64] | Scaled) -> Scaled:
        """Solve ``G x = rhs >= 0`` entry by entry as accurately as can be.  Shapes: `rhs` (rows,); returns (rows,)."""
        watch = ProgressMonitor()
        answer, error = self.factors.factors.solve_nonnegative(rhs, watch=watch)
        if not is_answer(error, watch.bound):
            raise AccuracyError(
                f"the direct solver reached a componentwise backward error of {error:.1e} only: the conductances "
                "differ by more decades than its factors can hold",
                answer,
            )
        return answer

    def per_cell(
        self, values: NDArray[np.float64], *, obstacle: float, goal: float, cut_off: float
    ) -> NDArray[np.float64]:
        """Values of rows (rows,) on cells, with those of obstacles, of goals, and of free cells without a node."""
        cell = self.cells.space.cell
        out = np.full(cell.shape, cut_off)
        out[cell == Cell.OBSTACLE], out[cell == Cell.GOAL] = obstacle, goal
        solved = self.row >= 0
        out[solved] = values[self.row[solved]]
        return out


def random_walk(circuit: Netlist | OperatingPoint | RandomWalk, *, method: str = "auto") -> RandomWalk:
    """Set up the random walk of a compiled circuit, for `collision_probability` and `hitting_probability`.

    Parameters
    ----------
    circuit : Netlist, OperatingPoint or RandomWalk
        Compiled from a space, each rail held by ideal sources; with obstacles on a rail, behind walls, or open under
        a uniform drive.  A walk is returned as it is.
    method : {"auto", "direct", "multigrid"}
        How to solve; see `resgrid.solve`.

    Returns
    -------
    RandomWalk

    Raises
    ------
    InputError
        If the netlist was not compiled from a space, a start drives it, or a goal cell floats.
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
    cells = netlist.cells
    if cells.wiring.drive == "start":
        raise InputError("a start-driven circuit absorbs walks at its start: compile it with drive = 'uniform'")
    free = cells.free_node
    if not free.size:
        raise InputError("the space has no free cell that a walk could start from")
    # With one current into every free node no part of the circuit is flat, so that all of it is factored.
    feeds = np.stack([np.full(free.size, GROUND), free], axis=1)
    fed = netlist.replace(current_nodes=feeds, current_amps=np.full(free.size, 1.0 / cells.wiring.resistance))
    factors = factorize(fed, method=method)
    system, space = factors.system, cells.space
    node_goal = np.full(netlist.node_count, -1, dtype=np.int64)
    goals = space.cell == Cell.GOAL
    node_goal[cells.node[goals]] = space.goal_region[goals]
    if np.any(np.isnan(system.known_voltages()[node_goal >= 0])):
        raise InputError("a goal cell is tied to its rail by more than an ideal source, so that no walk ends there")
    row = np.where((space.cell == Cell.FREE) & (cells.node >= 0), system.unknown[cells.node], -1)
    return RandomWalk(cells, factors, row, _to_goal(netlist, node_goal, system.unknown, system.size))


@frozen
@dataclass(frozen=True, eq=False)
class CollisionProbability:
    """What happens to a random walk from the centre of every cell.  All arrays have the shape of the space.

    Times are in units of ``R C``: the resistance between the cells that lie closest together, at conductivity 1, times
    the capacitance of a cell; a Brownian motion of diffusivity ``h_ref**2 / (R C)`` takes about as long.  Steps are
    jumps of the walk, the last one onto a rail included.

    `success`: probability ``u`` of meeting a goal before an obstacle, 0 where it underflows; `log_success`: its natural
    logarithm, right to the last digits; `time, steps`: expected time and number of jumps until either is met (``G t =
    C``, ``G n = D 1`` with ``D`` the diagonal of ``G``), 0 on goals and obstacles, infinite where neither is;
    `time_given_success, steps_given_success`: of those walks only that meet a goal (``s / u`` with ``G s = C u``, or
    ``G s = D u``), NaN where none can be met.
    """

    success: NDArray[np.float64]
    log_success: NDArray[np.float64]
    time: NDArray[np.float64]
    steps: NDArray[np.float64]
    time_given_success: NDArray[np.float64]
    steps_given_success: NDArray[np.float64]

    @property
    def collision(self) -> NDArray[np.float64]:
        """Probability ``1 - u`` of meeting an obstacle first, or no goal ever."""
        return np.asarray(-np.expm1(self.log_success))


def collision_probability(circuit: Netlist | OperatingPoint | RandomWalk) -> CollisionProbability:
    """Find whether, and when, a robot that wanders at random meets a goal before an obstacle.

    The drop ``u`` of the potential is the probability that a random walk, which jumps along a resistor with probability
    proportional to its conductance, meets a goal before an obstacle (C. I. Connolly, Harmonic functions and collision
    probabilities, Int. J. Robotics Research 16(4), 1997).  With open obstacles it is 1 and the expected time is
    proportional to the uniformly driven potential.

    Parameters
    ----------
    circuit : Netlist, OperatingPoint or RandomWalk
        As `random_walk` takes it.

    Returns
    -------
    CollisionProbability
        Of every cell, from one factorisation: ``collision``, ``success``, ``log_success``, ``time``, ``steps``, and
        the last two of successful walks alone.

    Raises
    ------
    InputError
        As `random_walk`.
    AccuracyError
        If the conductances differ by more decades than the factors can hold.

    Examples
    --------
    >>> space = rg.ConfigurationSpace([rg.Axis("x", 0.0, 5.0, 5)], [2, 0, 0, 0, 1])
    >>> walk = rg.planning.collision_probability(rg.compile_space(space))
    >>> walk.success.round(6), walk.steps.round(6)
    (array([1.  , 0.75, 0.5 , 0.25, 0.  ]), array([0., 3., 4., 3., 0.]))
    """
    walk = random_walk(circuit)
    degree = walk.factors.system.laplacian.diagonal
    clock = np.full(len(degree), 1.0 / walk.cells.wiring.resistance)
    u = walk.solve(walk.to_goal.T @ np.ones(walk.to_goal.shape[0]))
    log_u = np.minimum(u.log, 0.0)

    def given(rates: NDArray[np.float64]) -> NDArray[np.float64]:
        """``x / u`` with ``G x = rates u``; NaN where u is 0."""
        x = walk.solve(Scaled(u.hi * rates, u.lo * rates, u.exponent, u.noise))
        with np.errstate(invalid="ignore", divide="ignore"):
            quotient = x.hi / u.hi
        values = quotient * power(np.where(u.hi > 0, x.exponent - u.exponent, 0))
        return walk.per_cell(np.asarray(values, np.float64), obstacle=np.nan, goal=0.0, cut_off=np.nan)

    return CollisionProbability(
        success=walk.per_cell(np.exp(log_u), obstacle=0.0, goal=1.0, cut_off=0.0),
        log_success=walk.per_cell(log_u, obstacle=-np.inf, goal=0.0, cut_off=-np.inf),
        time=walk.per_cell(walk.solve(clock).plain, obstacle=0.0, goal=0.0, cut_off=np.inf),
        steps=walk.per_cell(walk.solve(degree).plain, obstacle=0.0, goal=0.0, cut_off=np.inf),
        time_given_success=given(clock),
        steps_given_success=given(degree),
    )


@frozen
@dataclass(frozen=True, eq=False)
class HittingProbability:
    """Where a random walk from the centre of every cell ends.

    `probability` (goals, ...), the rest as the space: of being absorbed at each goal region, before any obstacle; 0
    where it underflows; `log_probability`: its natural logarithm, -inf where that goal cannot be met.
    """

    probability: NDArray[np.float64]
    log_probability: NDArray[np.float64]

    @property
    def likeliest(self) -> NDArray[np.int32]:
        """The goal region each cell's walk most probably ends at, -1 for none; the lower number of two equals."""
        best = np.argmax(self.log_probability, axis=0).astype(np.int32)
        return np.where(np.isneginf(self.log_probability.max(axis=0)), np.int32(-1), best)


def hitting_probability(circuit: Netlist | OperatingPoint | RandomWalk) -> HittingProbability:
    """Find the probability that a random walk ends at each goal: one solve a goal, one factorisation for all.

    Summed over the goals it is the ``success`` of `collision_probability`.

    Parameters
    ----------
    circuit : Netlist, OperatingPoint or RandomWalk
        As `random_walk` takes it.

    Returns
    -------
    HittingProbability
        Of every cell and goal: ``probability``, ``log_probability``, and the ``likeliest`` goal.

    Raises
    ------
    InputError
        As `random_walk`.
    AccuracyError
        If the conductances differ by more decades than the factors can hold.
    BudgetError
        If the answer would not fit in memory.

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
