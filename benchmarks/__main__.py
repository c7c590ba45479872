"""Time the pipeline in units of a sparse matrix-vector product of the same circuit."""

from __future__ import annotations

import json
import statistics
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from scipy import sparse

from resgrid.compiler import compile_space
from resgrid.netlist import Netlist
from resgrid.nodal.solve import solve
from resgrid.planning.field import field_of
from resgrid.planning.trace import streamlines
from resgrid.space import Axis, ConfigurationSpace

ROUNDS = 7
RESULTS = Path(__file__).parent / "results.json"


def scene(size: int, seed: int) -> ConfigurationSpace:
    """A square with a fifth of its cells under random rectangles, the goal in a corner."""
    rng = np.random.default_rng(seed)
    cell = np.zeros((size, size), dtype=np.uint8)
    while np.count_nonzero(cell) < 0.2 * cell.size:
        (x, y), (w, h) = rng.integers(0, size, 2), rng.integers(size // 64 + 1, size // 12 + 2, 2)
        cell[x : x + w, y : y + h] = 1
    cell[:3, :3] = 0
    cell[1, 1] = 2
    return ConfigurationSpace([Axis("x", 0, size, size), Axis("y", 0, size, size)], cell)


def compile_afresh(space: ConfigurationSpace, boundary: str) -> Netlist:
    """Compile without what a space remembers of itself."""
    return compile_space(ConfigurationSpace(space.axes, space.cell), boundary=boundary)


def matrix_product(netlist: Netlist) -> Callable[[], object]:
    """A product with the circuit's nodal matrix."""
    a, b = netlist.resistor_nodes.T
    g, n = netlist.conductance, netlist.node_count
    entries = (np.concatenate([-g, -g, np.full(n, 4.0)]), (np.r_[a, b, :n], np.r_[b, a, :n]))
    matrix = sparse.coo_array(entries, shape=(n, n)).tocsr()
    x = np.random.default_rng(0).random(n)
    return lambda: matrix @ x


def alternating(first: Callable[[], object], second: Callable[[], object]) -> tuple[float, float, float]:
    """Median seconds of both, and the median of their ratios pair by pair."""
    times = []
    for _ in range(ROUNDS):
        pair = []
        for job in (first, second):
            start = time.perf_counter()
            job()
            pair.append(time.perf_counter() - start)
        times.append(pair)
    ratios = [a / b for a, b in times]
    return statistics.median(t[0] for t in times), statistics.median(t[1] for t in times), statistics.median(ratios)


def main() -> None:
    """Run everything, print one table, keep it in results.json."""
    rows = []
    for size, boundary in ((2048, "dirichlet"), (2048, "neumann")):
        space = scene(size, seed=size)
        fresh = partial(compile_afresh, space, boundary)
        seconds, _, ratio = alternating(fresh, partial(repeat_ten, matrix_product(fresh())))
        rows.append((f"compile {size}^2 {boundary}", seconds, 10 * ratio, "matrix-vector products"))
    for size, boundary in ((512, "dirichlet"), (512, "neumann")):
        netlist = compile_space(scene(size, seed=size), boundary=boundary)
        solve(compile_space(scene(16, seed=1), boundary=boundary))
        ten = partial(repeat_ten, matrix_product(netlist))
        seconds, _, ratio = alternating(partial(solve, netlist), ten)
        rows.append((f"solve {size}^2 {boundary}, direction-safe", seconds, 10 * ratio, "matrix-vector products"))
    rows += volume_rows()
    space = scene(512, seed=512)
    field = field_of(solve(compile_space(space)))
    starts = space.centre(np.argwhere(space.goal_connected))
    streamlines(field, starts[:1])
    start = time.perf_counter()
    traces = streamlines(field, starts)
    seconds = time.perf_counter() - start
    rows.append((f"trace {len(starts):,} starts of 512^2", seconds, 1e9 * seconds / traces.steps.sum(), "ns a step"))
    report(rows)


def volume_rows() -> list[tuple[str, float, float, str]]:
    """Multigrid in a volume of 64^3 cells: nine digits normwise, and direction-safe."""
    rng = np.random.default_rng(64)
    cell = np.zeros((64, 64, 64), dtype=np.uint8)
    while np.count_nonzero(cell) < 0.2 * cell.size:
        low, size = rng.integers(0, 64, 3), rng.integers(2, 8, 3)
        cell[tuple(slice(a, a + b) for a, b in zip(low, size, strict=True))] = 1
    cell[:3, :3, :3] = 0
    cell[1, 1, 1] = 2
    space = ConfigurationSpace([Axis(name, 0, 64, 64) for name in "xyz"], cell)
    rows = []
    for boundary in ("dirichlet", "neumann"):
        netlist = compile_space(space, boundary=boundary)
        ten = partial(repeat_ten, matrix_product(netlist))
        for accuracy in ("normwise", "direction"):
            job = partial(solve, netlist, accuracy=accuracy, rtol=1e-8)
            job()
            seconds, _, ratio = alternating(job, ten)
            rows.append((f"solve 64^3 {boundary}, {accuracy}", seconds, 10 * ratio, "matrix-vector products"))
    return rows


def repeat_ten(job: Callable[[], object]) -> None:
    """Run a job ten times."""
    for _ in range(10):
        job()


def report(rows: list[tuple[str, float, float, str]]) -> None:
    """Print the table, write the file."""
    for name, seconds, value, unit in rows:
        sys.stdout.write(f"{name:40s} {seconds:8.3f} s {value:10.1f} {unit}\n")
    kept = [{"name": n, "seconds": round(s, 4), "value": round(v, 1), "unit": u} for n, s, v, u in rows]
    RESULTS.write_text(json.dumps({"schema": 1, "rounds": ROUNDS, "rows": kept}, indent=2) + "\n")


if __name__ == "__main__":
    main()
