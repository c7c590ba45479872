"""Planners for a point robot on a grid: each one prepares a map and a goal, and returns a polyline for each start.

Points are in cells: cell (i, j) is the square from (i, j) to (i + 1, j + 1).  All planners receive only the map.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64] | None
Query = Callable[[tuple[int, int]], Points]
Contender = Callable[[NDArray[np.bool_], tuple[int, int]], Query]

STRAIGHT = ((1, 0), (-1, 0), (0, 1), (0, -1))
DIAGONAL = ((1, 1), (1, -1), (-1, 1), (-1, -1))
SECONDS, CHECKED = 1.0, 0.02
"""Seconds per query of a sampling planner, and its resolution of edge checks in cells."""


def resgrid(k: float) -> Contender:
    """Compute one field for the goal, and a streamline for each start."""
    import resgrid as rg

    def prepare(free: NDArray[np.bool_], goal: tuple[int, int]) -> Query:
        cell = np.where(free, rg.Cell.FREE, rg.Cell.OBSTACLE).astype(np.uint8)
        cell[goal] = rg.Cell.GOAL
        axes = [rg.Axis(name, 0, n, n, unit="cell") for name, n in zip("xy", cell.shape, strict=True)]
        planner = rg.plan(rg.ConfigurationSpace(axes, cell), k=k)

        def query(start: tuple[int, int]) -> Points:
            path = planner.path(cell=start)
            return np.vstack([path.points, np.add(goal, 0.5)]) if path.outcome == rg.Outcome.REACHED else None

        return query

    return prepare


def networkx_astar(free: NDArray[np.bool_], goal: tuple[int, int]) -> Query:
    """Run A* of networkx on the graph of free cells and their eight neighbours."""
    import networkx

    graph = networkx.Graph()
    for i, j in np.argwhere(free).tolist():
        for step, target in neighbours(free, i, j):
            graph.add_edge((i, j), target, weight=step)

    def query(start: tuple[int, int]) -> Points:
        try:
            found = networkx.astar_path(graph, start, goal, heuristic=_octile, weight="weight")
        except (networkx.NetworkXNoPath, networkx.NodeNotFound):
            return None
        return np.add(found, 0.5)

    return query


def pathfinding_astar(free: NDArray[np.bool_], goal: tuple[int, int]) -> Query:
    """Run A* of the package `pathfinding`, with diagonals only next to free cells."""
    from pathfinding.core.diagonal_movement import DiagonalMovement
    from pathfinding.core.grid import Grid
    from pathfinding.finder.a_star import AStarFinder

    grid = Grid(matrix=free.T.astype(int).tolist())
    finder = AStarFinder(diagonal_movement=DiagonalMovement.only_when_no_obstacle)

    def query(start: tuple[int, int]) -> Points:
        grid.cleanup()
        found, _ = finder.find_path(grid.node(*start), grid.node(*goal), grid)
        return np.array([(node.x + 0.5, node.y + 0.5) for node in found]) if found else None

    return query


def fast_marching(free: NDArray[np.bool_], goal: tuple[int, int]) -> Query:
    """Compute distances from the goal by scikit-fmm, and descend over eight neighbours."""
    import skfmm

    phi = np.ones(free.shape)
    phi[goal] = -1.0
    distance = np.ma.filled(skfmm.distance(np.ma.MaskedArray(phi, ~free)), np.inf)

    def query(start: tuple[int, int]) -> Points:
        cells = [start]
        while cells[-1] != goal:
            here = cells[-1]
            best = min(neighbours(free, *here), key=lambda n: (distance[n[1]] - distance[here]) / n[0], default=None)
            if best is None or not distance[best[1]] < distance[here]:
                return None
            cells.append(best[1])
        return np.add(cells, 0.5)

    return query


def ompl(planner: str, *, simplify: bool) -> Contender:
    """Run a planner of OMPL with a validity check in Python."""

    def prepare(free: NDArray[np.bool_], goal: tuple[int, int]) -> Query:
        from ompl import base, geometric, util

        util.setLogLevel(util.LOG_NONE)
        util.RNG.setSeed(1)  # has an effect only before the first random number
        space = base.RealVectorStateSpace(2)
        bounds = base.RealVectorBounds(2)
        for axis, n in enumerate(free.shape):
            bounds.setLow(axis, 0.0)
            bounds.setHigh(axis, n - 1e-9)
        space.setBounds(bounds)

        def query(start: tuple[int, int]) -> Points:
            setup = geometric.SimpleSetup(space)
            setup.setStateValidityChecker(lambda state: bool(free[int(state[0]), int(state[1])]))
            setup.getSpaceInformation().setStateValidityCheckingResolution(CHECKED / space.getMaximumExtent())
            ends = []
            for cell in (start, goal):
                state = space.allocState()
                state[0], state[1] = cell[0] + 0.5, cell[1] + 0.5
                ends.append(state)
            setup.setStartAndGoalStates(*ends)
            setup.setPlanner(getattr(geometric, planner)(setup.getSpaceInformation()))
            if not setup.solve(SECONDS) or not setup.haveExactSolutionPath():
                return None
            if simplify:
                setup.simplifySolution()
            return np.array([(state[0], state[1]) for state in setup.getSolutionPath().getStates()])

        return query

    return prepare


CONTENDERS: dict[str, tuple[Contender, int]] = {
    "resgrid, k = 1": (resgrid(1.0), 200),
    "resgrid, k = 0": (resgrid(0.0), 200),
    "networkx A*": (networkx_astar, 5),
    "pathfinding A*": (pathfinding_astar, 3),
    "scikit-fmm": (fast_marching, 50),
    "OMPL RRTConnect": (ompl("RRTConnect", simplify=True), 3),
    "OMPL BIT*": (ompl("BITstar", simplify=False), 1),
}
"""Contenders, and the number of further starts from which the time of a thousand is extrapolated."""


def neighbours(free: NDArray[np.bool_], i: int, j: int) -> list[tuple[float, tuple[int, int]]]:
    """Return lengths and cells of the free neighbours of a cell; diagonals must not cut a corner."""

    def open_at(a: int, b: int) -> bool:
        return 0 <= a < free.shape[0] and 0 <= b < free.shape[1] and bool(free[a, b])

    near = [(1.0, (i + a, j + b)) for a, b in STRAIGHT if open_at(i + a, j + b)]
    return near + [
        (2**0.5, (i + a, j + b))
        for a, b in DIAGONAL
        if open_at(i + a, j + b) and open_at(i + a, j) and open_at(i, j + b)
    ]


def _octile(a: tuple[int, int], b: tuple[int, int]) -> float:
    low, high = sorted((abs(a[0] - b[0]), abs(a[1] - b[1])))
    return high + (2**0.5 - 1) * low
