"""Sections: cells that become obstacles after a solve, and two right-hand sides at the same time."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmarks.layouts import boxes
from benchmarks.rows import Row, Scale
from benchmarks.timing import alternating
from resgrid.circuit.solve import factor, solve
from resgrid.compiler import compile_space
from resgrid.netlist import Netlist
from resgrid.solvers.factors.factor import Factor
from resgrid.solvers.monitor import Watch
from resgrid.space import Cell, ConfigurationSpace

RTOL = 1e-8
BOUNDARIES = ("dirichlet", "neumann")
_REACH, _CELLS = 16, 10


def update(scale: Scale) -> list[Row]:
    """Ten obstacle cells at most 16 cells from the goal: update and warm start, against starting from the space."""
    sizes = {"tiny": (48,), "quick": (1024,), "full": (1024, 2048)}[scale.name]
    return [
        _update_row(place, size, boundary, scale)
        for size in sizes
        for place in ("corner", "middle")
        for boundary in BOUNDARIES
    ]


def threads(scale: Scale) -> list[Row]:
    """A field behind stiff walls, whose drop and height are both needed, on one thread and on two."""
    size = {"tiny": 32, "quick": 512, "full": 1024}[scale.name]
    netlist = compile_space(boxes(size, 2, scale.seed + size), boundary="wall", wall_resistance=1e15)
    rows = []
    for method in ("direct", "multigrid"):
        one, two = (partial(solve, netlist, method=method, threads=count) for count in (1, 2))
        same = np.array_equal(one().voltage, two().voltage, equal_nan=True)
        seconds, _, ratio = alternating(one, two, scale.rounds)
        note = f"{method}, {'same digits' if same else 'DIGITS DIFFER'}"
        rows.append(Row(f"{size}^2 stiff walls: two threads", seconds.median, ratio, "x faster", note=note))
    return rows


def goal_in(place: str, size: int, seed: int) -> ConfigurationSpace:
    """Random rectangles with the goal in a corner, or alone in the middle of a free place."""
    space = boxes(size, 2, seed)
    if place == "corner":
        return space
    cell = space.cell.copy()
    middle = size // 2
    cell[cell == Cell.GOAL] = Cell.FREE
    cell[middle - 2 : middle + 3, middle - 2 : middle + 3] = Cell.FREE
    cell[middle, middle] = Cell.GOAL
    return ConfigurationSpace(space.axes, cell)


def near_goal(space: ConfigurationSpace, seed: int) -> NDArray[np.int64]:
    """Free cells near the goal."""
    away = np.abs(np.argwhere(space.goal_connected) - np.argwhere(space.cell == Cell.GOAL)[0]).max(axis=1)
    near = np.argwhere(space.goal_connected)[away <= _REACH]
    return np.random.default_rng(seed).permutation(near)[:_CELLS]


def _solution(factors: Factor, watch: Watch | None = None) -> NDArray[np.float64]:
    return factors.solve(factors.system.feed + factors.system.injected, rtol=RTOL, watch=watch)


def _fresh(cell: NDArray[np.uint8], space: ConfigurationSpace, boundary: str) -> tuple[Factor, NDArray[np.float64]]:
    netlist = compile_space(ConfigurationSpace(space.axes, cell), boundary=boundary)
    factors = factor(netlist, method="multigrid")
    return factors, _solution(factors)


def _update_row(place: str, size: int, boundary: str, scale: Scale) -> Row:
    space = goal_in(place, size, scale.seed + size)
    factors = factor(compile_space(space, boundary=boundary), method="multigrid")
    before = _solution(factors)
    cells = near_goal(space, scale.seed)
    after = space.cell.copy()
    after[tuple(cells.T)] = Cell.OBSTACLE
    watch = Watch()

    def updated() -> tuple[Factor, NDArray[np.float64]]:
        new = factors.update(cells)
        right = new.system.feed + new.system.injected
        return new, new.solve(right, rtol=RTOL, guess=before, watch=watch)

    fresh = partial(_fresh, after, space, boundary)
    new, x = updated()
    steps = watch.iterations
    error = _difference(new, x, *fresh())
    seconds, _, ratio = alternating(updated, fresh, scale.rounds)
    note = f"{steps} iterations, answers differ by {error:.0e}" + (f", {new.change.reason}" if new.change else "")
    return Row(
        f"{size}^2 {boundary}, goal in the {place}: update", seconds.median, ratio, "of a fresh solve", note=note
    )


def _difference(new: Factor, x: NDArray[np.float64], other: Factor, y: NDArray[np.float64]) -> float:
    """Largest difference of two solutions at the cells of both, as a share of the largest voltage."""
    first = _by_cell(new.system.netlist, new.system.unknown, x)
    second = _by_cell(other.system.netlist, other.system.unknown, y)
    both = np.isfinite(first) & np.isfinite(second)
    return float(np.abs(first - second)[both].max() / np.nanmax(np.abs(second)))


def _by_cell(netlist: Netlist, unknown: NDArray[np.int64], x: NDArray[np.float64]) -> NDArray[np.float64]:
    node = netlist.cells.node.ravel()
    row = np.where(node >= 0, unknown[node], -1)
    return np.where(row >= 0, x[row], np.nan)
