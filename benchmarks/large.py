"""Section: grids that almost fill the memory, by the engine and by PETSc, each in a separate process.

The value of a row is the peak memory of all processes in bytes per cell: netlist, solution, field and certified path.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from time import perf_counter

import numpy as np

import resgrid as rg
from benchmarks.contest import ROOT
from benchmarks.rows import Row, Scale, Spread

RANKS = 2

ENGINE, PETSC = "resgrid", f"PETSc, {RANKS} ranks"


def large(scale: Scale) -> list[Row]:
    """Section: time and memory of direction-safe fields and a path on planes of up to 8192^2 cells and a volume."""
    cases = {
        "tiny": [(64, 2, ENGINE)],
        "quick": [(2048, 2, ENGINE), (128, 3, ENGINE), (2048, 2, PETSC)],
        "full": [(4096, 2, ENGINE), (8192, 2, ENGINE), (256, 3, ENGINE), (4096, 2, PETSC), (128, 3, PETSC)],
    }[scale.name]
    return [_measured(*case, scale) for case in cases]


def _measured(size: int, dimensions: int, who: str, scale: Scale) -> Row:
    name = f"{size}^{dimensions}, neumann"
    words = [sys.executable, "-W", "ignore", "-m", "benchmarks.large", str(size), str(dimensions), who]
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=6 * scale.limit, cwd=ROOT, check=False)
    except subprocess.TimeoutExpired as error:
        return Row(name, None, None, "bytes/cell", who, f"not done after {error.timeout:g} s")
    if done.returncode:
        return Row(name, None, None, "bytes/cell", who, (done.stderr.strip().splitlines() or ["killed"])[-1])
    found = json.loads(done.stdout)
    each = found["peak"] / size**dimensions
    return Row(name, found["seconds"], Spread(each, each, each), "bytes/cell", who, found["note"])


def _space(size: int, dimensions: int) -> rg.ConfigurationSpace:
    """Return a space with sixty boxes, and a goal of four cells per side in the middle."""
    from benchmarks.layouts import as_space

    rng, cell = np.random.default_rng(0), np.zeros((size,) * dimensions, dtype=np.uint8)
    for _ in range(60):
        side, first = (
            rng.integers(size // 64 + 1, size // 12 + 2, dimensions),
            rng.integers(0, size - size // 12, dimensions),
        )
        cell[tuple(slice(a, a + b) for a, b in zip(first, side, strict=True))] = rg.Cell.OBSTACLE
    cell[(slice(size // 2, size // 2 + 4),) * dimensions] = rg.Cell.GOAL
    return as_space(cell)


def _solved(space: rg.ConfigurationSpace, who: str) -> tuple[rg.Field, int, str]:
    """Return a field, the peak memory of other processes in bytes, and the method."""
    if who == ENGINE:
        op = rg.solve(rg.compile_space(space, boundary="neumann"))
        return rg.field(op), 0, f"{op.method}, {op.iterations} iterations"
    from resgrid.core.wiring import Wiring
    from resgrid.planning.petsc_fields import solve_ranked

    found = solve_ranked(space, Wiring("neumann"), RANKS)
    share = np.count_nonzero(found.field.safe) / np.count_nonzero(space.goal_connected)
    return found.field, sum(found.report.peaks), f"{found.report.iterations} iterations, {share:.2%} of cells safe"


def _alone(size: int, dimensions: int, who: str) -> None:
    """Compile, solve, compute the field, trace and certify a path; print time and memory."""
    if who == ENGINE:
        _solved(_space(64 if dimensions == 2 else 16, dimensions), who)  # loads the compiled kernels
    space = _space(size, dimensions)
    begin = perf_counter()
    field, others, note = _solved(space, who)
    first = np.unravel_index(int(np.argmax(space.goal_connected.ravel())), space.shape)
    path = rg.streamline(field, cell=tuple(int(k) for k in first))
    rg.certify(path)
    seconds = perf_counter() - begin
    peak = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss + others
    note += f"; a path of {path.length:,.0f} cells, {path.outcome.name.lower()}, certified"
    print(json.dumps({"seconds": seconds, "peak": peak, "note": note}))


if __name__ == "__main__":
    _alone(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3])
