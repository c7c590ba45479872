"""Compare many chips of one grid with a loop of SuperLU.  ``python -m benchmarks.chips [chips [side]]``.

Both solve the same matrices on one thread, alternating by block; results for all cores are reported separately.
SuperLU receives assembled matrices; resgrid is timed from the conductances, and also from the seeds.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from benchmarks.rows import Row, Scale, Spread
from resgrid.chip.study_analyses import study
from resgrid.circuit.batch import solve_many
from resgrid.circuit.equations import assemble
from resgrid.circuit.solve import solve
from resgrid.core.axis import Axis
from resgrid.core.netlist import Netlist
from resgrid.core.space import ConfigurationSpace
from resgrid.scene.chip import Chip

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
_BLOCKS = 10
_RTOL = 1e-10


def grid(side: int) -> ConfigurationSpace:
    """Return a square with a few walls and a goal."""
    cell = np.zeros((side, side), dtype=np.uint8)
    cell[side // 6 : side // 2, side // 3] = cell[2 * side // 3, side // 4 : 3 * side // 4] = 1
    cell[side // 12, 6 * side // 7] = 2
    return ConfigurationSpace([Axis(name, 0.0, 1.0, side, False, "m") for name in "xy"], cell)


def timed(function: Callable[[], Any]) -> tuple[Any, float, float]:
    """Return the result of a function, its wall-clock time and its processor time in seconds."""
    wall, busy = time.perf_counter(), time.process_time()
    value = function()
    return value, time.perf_counter() - wall, time.process_time() - busy


def matrices(netlist: Netlist, conductance: np.ndarray) -> list[tuple[Any, np.ndarray, np.ndarray]]:
    """Return nodal matrices, right-hand sides and the unknown nodes."""
    ready = []
    for chip in conductance:
        system = assemble(netlist.replace(conductance=chip))
        matrix = sparse.csc_matrix(sparse.diags_array(system.laplacian.diagonal) - system.laplacian.edges)
        ready.append((matrix, system.feed + system.injected, np.flatnonzero(system.unknown >= 0)))
    return ready


@dataclass(frozen=True)
class Throughput:
    """Milliseconds per chip (wall clock and processor), and the largest difference from spsolve in volts."""

    drawn: tuple[float, float]
    ours: tuple[float, float]
    theirs: tuple[float, float]
    cores: tuple[float, float]
    alone: float
    error: float

    @property
    def ratio(self) -> float:
        """Throughput relative to a loop of spsolve on one thread."""
        return self.theirs[1] / self.ours[1]


def measure(count: int, side: int) -> Throughput:
    """Solve mismatched chips, and the same matrices by spsolve, alternating by block."""
    kind = Chip(mismatch=0.02)
    ideal = study(grid(side), kind).ideal
    solve_many(ideal, np.tile(ideal.conductance, (2, 1)))  # compiled
    seconds = np.zeros((4, 2))
    error, size = 0.0, max(count // _BLOCKS, 1)
    for begin in range(0, count, size):
        seeds = [(0, k) for k in range(begin, min(begin + size, count))]
        (circuit, conductance), *seconds_drawn = timed(lambda seeds=seeds: study(ideal, kind).conductances(seeds))
        found, *ours = timed(lambda c=circuit, g=conductance: solve_many(c, g, rtol=_RTOL))
        ready = matrices(circuit, conductance)
        theirs_found, *theirs = timed(lambda ready=ready: [spsolve(matrix, rhs) for matrix, rhs, _ in ready])
        with ThreadPoolExecutor() as threads:
            _, *cores = timed(lambda c=circuit, g=conductance, t=threads: solve_many(c, g, rtol=_RTOL, executor=t))
        for volts, x, (_, _, nodes) in zip(found, theirs_found, ready, strict=True):
            error = max(error, float(np.abs(volts[nodes] - x).max()))
        seconds += [seconds_drawn, ours, theirs, cores]
    alone = timed(lambda: [solve(circuit.replace(conductance=g)) for g in conductance[:5]])
    drawn, ours, theirs, cores = (tuple(pair) for pair in (1e3 * seconds / count).tolist())
    return Throughput(drawn, ours, theirs, cores, 200 * alone[1], error)


def chips(scale: Scale) -> list[Row]:
    """Section: mismatched chips of one circuit relative to a loop of spsolve on the same matrices, processor time."""
    count, side = {"tiny": (4, 16), "quick": (200, 128), "full": (1000, 128)}[scale.name]
    found = measure(count, side)
    name, unit = f"{count:,} chips of {side}^2", "x spsolve's throughput"
    drawing = found.theirs[1] / (found.ours[1] + found.drawn[1])
    return [
        Row(name, 1e-3 * count * found.ours[0], Spread(found.ratio, found.ratio, found.ratio), unit),
        Row(f"{name}, drawing included", None, Spread(drawing, drawing, drawing), unit),
    ]


def main(count: int = 1000, side: int = 128) -> None:
    """Print throughputs and their ratios."""
    found = measure(count, side)
    rows = {
        "draw the chips": found.drawn,
        "resgrid.circuit.solve_many": found.ours,
        "scipy spsolve": found.theirs,
        f"solve_many, {os.cpu_count()} threads": found.cores,
    }
    for name, (wall, busy) in rows.items():
        sys.stdout.write(f"{name:28} {wall:8.3f} ms a chip on the clock, {busy:8.3f} on the processor\n")
    sys.stdout.write(f"{'a loop of resgrid.solve':28} {found.alone:8.3f} ms a chip\n")
    sys.stdout.write(
        f"{count} chips of {side} x {side}: {found.ratio:.1f} times the throughput of spsolve on one thread "
        f"({found.theirs[1] / (found.ours[1] + found.drawn[1]):.1f} with drawing the chips); on the clock "
        f"{found.theirs[0] / found.ours[0]:.1f}, with all cores {found.theirs[0] / found.cores[0]:.1f}; residual at "
        f"most {_RTOL:g} of the right-hand side, largest difference {found.error:.1e} V of 1 V\n"
    )


if __name__ == "__main__":
    if os.environ.get("OMP_NUM_THREADS") != "1":  # the libraries read it when they are loaded
        words = [sys.executable, "-m", "benchmarks.chips", *sys.argv[1:]]
        os.execve(words[0], words, {**os.environ, **dict.fromkeys(_THREADS, "1")})
    main(*map(int, sys.argv[1:]))
