"""Sections: warm starts after changed cells, and solutions on several threads."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmarks.layouts import boxes
from benchmarks.problems import Problem
from benchmarks.rows import Row, Scale
from benchmarks.timing import alternating, spread, timed
from resgrid.circuit.solve import factorize, solve
from resgrid.circuit.warm_start import WarmPoint, WarmStart
from resgrid.core.cell import Cell
from resgrid.core.compiler import compile_space
from resgrid.core.space import ConfigurationSpace
from resgrid.solvers.threads import ThreadTeam

RTOL = 1e-8
BOUNDARIES = ("dirichlet", "neumann")
_REACH, _CELLS = 16, 10
_WHO = ("one thread", "two threads")


def update(scale: Scale) -> list[Row]:
    """Section: ten cells near the goal become obstacles or free; warm start relative to a solution from the space."""
    sizes = {"tiny": (48,), "quick": (256, 1024), "full": (256, 1024, 2048)}[scale.name]
    return [
        _update_row(place, size, boundary, scale, to=to)
        for size in sizes
        for place in ("corner", "middle")
        for boundary in BOUNDARIES
        for to in (Cell.OBSTACLE, Cell.FREE)
    ]


def threads(scale: Scale) -> list[Row]:
    """Section: fields on one thread and on two, with stiff walls (which need drop and height) and without."""
    size = {"tiny": 32, "quick": 512, "full": 1024}[scale.name]
    netlist = compile_space(boxes(size, 2, scale.seed + size), boundary="wall", wall_resistance=1e15)
    rows = []
    for method in ("direct", "multigrid"):
        one, two = (partial(solve, netlist, method=method, threads=count) for count in (1, 2))
        same = np.array_equal(one().voltage, two().voltage, equal_nan=True)
        seconds, _, ratio = alternating(one, two, scale.rounds)
        note = f"{method}, {'same digits' if same else 'DIGITS DIFFER'}"
        rows.append(Row(f"{size}^2 stiff walls: two threads", seconds.median, ratio, "x faster", note=note))
    plane, volume = {"tiny": (32, 8), "quick": (1024, 64), "full": (2048, 128)}[scale.name]
    for kind, size in (("rectangles", plane), ("boxes", volume)):
        for boundary, accuracy in (("neumann", "normwise"), ("dirichlet", "direction")):
            rows += _threads_rows(Problem(kind, size, boundary, scale.seed + size), accuracy, scale)
    return rows + _stream_rows(scale)


def _threads_rows(problem: Problem, accuracy: str, scale: Scale) -> list[Row]:
    """Return rows of one solve on one thread and on two: seconds of stages, and time per iteration."""
    netlist = problem.netlist()
    jobs = [partial(solve, netlist, accuracy=accuracy, method="multigrid", rtol=RTOL, threads=n) for n in (1, 2)]
    points = [job() for job in jobs]
    same = np.array_equal(points[0].voltage, points[1].voltage, equal_nan=True)
    seconds, _, ratio = alternating(*jobs, scale.rounds)
    points = [job() for job in jobs]
    stages = ", ".join(
        f"{name} {' -> '.join(f'{point.seconds[name]:.2f}' for point in points)}" for name in points[0].seconds
    )
    note = f"{accuracy}, {'same digits' if same else 'DIGITS DIFFER'}; {stages} s"
    rows = [Row(f"{problem.name}: two threads", seconds.median, ratio, "x faster", note=note)]
    if accuracy == "normwise":
        cells = netlist.cells.space.cell.size
        for who, point in zip(_WHO, points, strict=True):
            each = 1e9 * point.seconds["substitute"] / (point.iterations * cells)
            rows.append(Row(f"{problem.name}: a step", None, spread([each]), "ns/cell", who))
    return rows


def _stream_rows(scale: Scale) -> list[Row]:
    """Measure the memory bandwidth as McCalpin's STREAM (1995): two arrays read and one written, in chunks."""
    size = {"tiny": 2**12, "quick": 2**23, "full": 2**25}[scale.name]
    a, b, c = np.ones((3, size))
    rows = []
    for count, who in enumerate(_WHO, 1):
        with ThreadTeam(count) as team:
            job = partial(team.over, size, lambda piece: np.add(a[piece], b[piece], out=c[piece]))
            rates = [1e-9 * 3 * a.nbytes / timed(job) for _ in range(1 + scale.rounds)][1:]
        rows.append(Row("stream", None, spread(rates), "GB/s", who))
    return rows


def goal_in(place: str, size: int, seed: int) -> ConfigurationSpace:
    """Return random rectangles with the goal in a corner or in a free centre; draw again if the goal is enclosed."""
    space = boxes(size, 2, seed)
    if place == "corner":
        return space
    cell = space.cell.copy()
    middle = size // 2
    cell[cell == Cell.GOAL] = Cell.FREE
    cell[middle - 2 : middle + 3, middle - 2 : middle + 3] = Cell.FREE
    cell[middle, middle] = Cell.GOAL
    made = ConfigurationSpace(space.axes, cell)
    reached = np.count_nonzero(made.goal_connected)
    return made if 2 * reached > np.count_nonzero(cell == Cell.FREE) else goal_in(place, size, seed + 1)


def near_goal(space: ConfigurationSpace, seed: int, to: Cell) -> NDArray[np.int64]:
    """Return ten free or obstacle cells near the goal, shape (10, ndim)."""
    some = np.argwhere(space.goal_connected if to == Cell.OBSTACLE else space.cell == Cell.OBSTACLE)
    away = np.abs(some - np.argwhere(space.cell == Cell.GOAL)[0]).max(axis=1)
    near = some[away <= max(_REACH, np.sort(away)[3 * _CELLS])]
    return np.random.default_rng(seed).permutation(near)[:_CELLS]


def _fresh(space: ConfigurationSpace, boundary: str) -> NDArray[np.float64]:
    """Return the voltages of all cells, NaN in cells without a node."""
    factors = factorize(compile_space(space, boundary=boundary), method="multigrid")
    x = factors.solve(factors.system.drive, rtol=RTOL)
    node = factors.system.netlist.cells.node
    row = np.where(node >= 0, factors.system.unknown[node], -1)
    return np.where(row >= 0, np.append(x, np.nan)[row], np.nan)


def _update_row(place: str, size: int, boundary: str, scale: Scale, to: Cell) -> Row:
    before = goal_in(place, size, scale.seed + size)
    cell = before.cell.copy()
    cell[tuple(near_goal(before, scale.seed, to).T)] = to
    after = before.with_cells(cell)
    warm = WarmStart(boundary=boundary, rtol=RTOL)
    warm.solve(before)
    spaces, points = [after, before], list[WarmPoint]()

    def updated() -> None:
        points.append(warm.solve(spaces[len(points) % 2]))

    fresh = partial(_fresh, after, boundary)
    updated()
    voltage, expected = points[0].voltage, fresh()
    error = np.nanmax(np.abs(voltage - expected)) / np.nanmax(np.abs(expected))
    seconds, _, ratio = alternating(updated, fresh, scale.rounds)
    steps = sorted({point.iterations for point in points})
    fresh_ones = sum(point.fresh for point in points)
    note = f"{steps} iterations, {fresh_ones} of {len(points)} from nothing, answers differ by {error:.0e}"
    kind = "obstacles" if to == Cell.OBSTACLE else "freed cells"
    name = f"{size}^2 {boundary}, goal in the {place}: ten {kind}"
    return Row(name, seconds.median, ratio, "of a fresh solve", note=note)
