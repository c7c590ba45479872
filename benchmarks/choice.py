"""Time of ``method="auto"`` relative to the best method, for circuits of many kinds.

The constants in `resgrid.solvers.method_choice` were fitted to these runs.
"""

from __future__ import annotations

from collections.abc import Callable
from time import process_time

import numpy as np

from benchmarks.irregular import geometric, thinned
from benchmarks.layouts import as_space, boxes, maze
from benchmarks.rows import Row, Scale
from benchmarks.timing import spread
from resgrid.circuit.solve import solve
from resgrid.core.cell import Cell
from resgrid.core.compiler import compile_space
from resgrid.core.netlist import Netlist
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import ResgridError

METHODS = ("auto", "direct", "multigrid")


def choice(scale: Scale) -> list[Row]:
    """Section: processor time of ``auto`` divided by that of the better method; 1 if the choice is right."""
    rows = []
    for name, make in _circuits(scale).items():
        netlist, seconds = make(), {method: [] for method in METHODS}
        failed: set[str] = set()
        for _ in range(scale.rounds):
            for method in METHODS:
                if method not in failed and not _run(netlist, method, seconds[method], scale.limit):
                    failed.add(method)
        best = min(np.median(seconds[method]) for method in METHODS[1:] if method not in failed)
        ratio = spread([each / best for each in seconds["auto"]])
        rows.append(
            Row(f"{name}: auto against the better method", float(np.median(seconds["auto"])), ratio, "x best method")
        )
    return rows


def _run(netlist: Netlist, method: str, seconds: list[float], limit: float) -> bool:
    """Time one solution, and check that it succeeds within the limit."""
    begin = process_time()
    try:
        solve(netlist, method=method)
    except ResgridError:
        return False
    seconds.append(process_time() - begin)
    return seconds[-1] <= limit


def _circuits(scale: Scale) -> dict[str, Callable[[], Netlist]]:
    """Return the circuits by name."""
    seed = scale.seed + 7001
    planes, volumes, widths, nodes = {
        "tiny": ((40,), (8,), (1,), (300,)),
        "quick": ((100, 220, 512), (16, 28, 48), (3, 8, 16, 32, 64), (5_000, 50_000)),
        "full": ((50, 100, 150, 220, 320, 512, 800), (16, 22, 28, 36, 48), (1, 3, 8, 16, 32, 64), (5_000, 50_000)),
    }[scale.name]
    found: dict[str, Callable[[], Netlist]] = {}
    for boundary in ("dirichlet", "neumann"):
        for n in planes:
            found[f"plane {n}^2, {boundary}"] = lambda n=n, b=boundary: compile_space(boxes(n, 2, seed), boundary=b)
        for n in volumes:
            found[f"volume {n}^3, {boundary}"] = lambda n=n, b=boundary: compile_space(boxes(n, 3, seed), boundary=b)
        for w in widths:
            found[f"maze of width {w}, {boundary}"] = lambda w=w, b=boundary: compile_space(
                maze(33 if scale.name == "tiny" else 512, w, seed), boundary=b
            )
    for n in nodes:
        found[f"geometric graph, {n:,} nodes"] = lambda n=n: geometric(n, seed)
        found[f"thinned grid, {n:,} nodes"] = lambda n=n: thinned(n, seed)
    found["single obstacles, 30 %"] = lambda: compile_space(_strewn(40 if scale.name == "tiny" else 300, seed))
    return found


def _strewn(size: int, seed: int) -> ConfigurationSpace:
    """Return a space with obstacles in three cells of ten, and the goal in the middle."""
    cell = (np.random.default_rng(seed).random((size, size)) < 0.3).astype(np.uint8)
    cell[size // 2, size // 2] = Cell.GOAL
    return as_space(cell)
