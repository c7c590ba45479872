"""Program of PETSc's ranks: each rank reads its rows of a Laplacian from mapped files; does not import resgrid.

``mpiexec -n N python3 petsc_worker.py FOLDER [shared]`` reads ``system.json`` (shape of the grid, and ``rtol``, the
relative residual norm), ``ahead_0.npy`` ... (conductance in siemens from every cell to the next one along axis 0 ...),
``ground.npy`` (conductance to nodes of known voltage) and ``drive.npy`` (currents in amperes). It fills the existing
``answer.npy`` (volts), and writes ``report.json``. The next cell of the last one is the first, with the conductance 0
unless the axis is periodic. Cells are numbered in C order; a cell without any conductance is not solved for. The
program needs numpy and petsc4py only, and runs in the Python that has them. All ranks need access to FOLDER; their
number is the size of PETSc's communicator.
"""

from __future__ import annotations

import json
import os
import resource
import sys
import time
import traceback
from pathlib import Path
from typing import Any

import numpy as np

GAMG = {"pc_type": "gamg", "pc_gamg_agg_nsmooths": "1", "pc_gamg_threshold": "0.02", "mg_levels_pc_type": "jacobi"}
"""PETSc options of the preconditioner GAMG.

GAMG is algebraic multigrid; a geometric interpolation would cross barriers of obstacle cells.
"""
BOOMERAMG = {"pc_type": "hypre", "pc_hypre_type": "boomeramg"}
"""PETSc options of the preconditioner BoomerAMG.

BoomerAMG takes longer than GAMG and less memory, and is accurate in a far larger part of a potential that falls by many
orders of magnitude.
"""
BOOMERAMG_3D = {
    **BOOMERAMG,
    "pc_hypre_boomeramg_coarsen_type": "HMIS",
    "pc_hypre_boomeramg_interp_type": "ext+i",
    "pc_hypre_boomeramg_strong_threshold": "0.5",
}
"""PETSc options of the preconditioner BoomerAMG for grids with three or more axes."""

PASS, MOST_PASSES, MOST_STEPS = 1e-8, 5, 1000
"""Limits on the repeated solves for the remaining residual (iterative refinement).

The first is the smallest tolerance, relative to the norm of the remaining residual, that is requested of one PETSc
solve; the second is the maximum number of solves, the third the maximum number of iterations of each. The residual that
conjugate gradients update drifts from the true one, from which the next solve starts.
"""


def rows_of(rank: int, ranks: int, cells: int) -> tuple[int, int]:
    """Return the first row of a rank, and the first row of the next rank.

    `rank, ranks`: number of the rank from 0 on, and number of ranks; `cells`: number of rows of the matrix, one per
    cell.
    """
    return cells * rank // ranks, cells * (rank + 1) // ranks


def mapped(folder: Path, name: str, mode: Any = "r") -> Any:
    """Return the file ``name.npy`` of the folder as a memory-mapped array (cells,), in C order of cells.

    `mode`: numpy's mode of the mapping, "r" or "r+".
    """
    return np.load(folder / f"{name}.npy", mmap_mode=mode).reshape(-1)


def neighbours(cell: Any, axis: int, shape: list[int]) -> tuple[Any, Any]:
    """Return the numbers of the next and of the previous cell along an axis, shape (n,) each.

    The cell after the last one is the first. `cell` (n,): numbers of cells in C order, int64; `axis`: index of the
    axis; `shape`: number of cells along every axis.
    """
    stride = int(np.prod(shape[axis + 1 :], dtype=np.int64))
    place, turn = cell // stride % shape[axis], stride * shape[axis]
    after = cell + stride - turn * (place == shape[axis] - 1)
    before = cell - stride + turn * (place == 0)
    return after, before


def local_rows(folder: Path, shape: list[int], first: int, last: int, index: Any) -> tuple[Any, Any, Any]:
    """Return rows `first` to `last - 1` of the matrix as CSR arrays: begins of rows, columns and values in siemens.

    `folder`: folder of the system of equations; `shape`: number of cells along every axis; `index`: integer type of
    PETSc, as a numpy data type. A cell without an unknown has 1 on the diagonal. Raises OverflowError for more entries
    than `index` can number.
    """
    count, axes = last - first, len(shape)
    cell = np.arange(first, last, dtype=np.int64)
    column = np.empty((count, 2 * axes + 1), dtype=index)
    value = np.empty((count, 2 * axes + 1))
    value[:, 0] = mapped(folder, "ground")[first:last]
    column[:, 0] = cell
    for axis in range(axes):
        ahead = mapped(folder, f"ahead_{axis}")
        after, before = neighbours(cell, axis, shape)
        column[:, 2 * axis + 1], value[:, 2 * axis + 1] = after, ahead[first:last]
        column[:, 2 * axis + 2], value[:, 2 * axis + 2] = before, ahead[before]
        if shape[axis] == 2:  # both neighbours are one cell, and an entry must be unique
            value[:, 2 * axis + 1] += value[:, 2 * axis + 2]
            value[:, 2 * axis + 2] = 0.0
    np.sum(value, axis=1, out=value[:, 0])
    np.negative(value[:, 1:], out=value[:, 1:])
    value[:, 0] += value[:, 0] == 0.0
    kept = value != 0.0
    begins = np.zeros(count + 1, dtype=np.int64)
    np.cumsum(np.count_nonzero(kept, axis=1), out=begins[1:])
    if begins[-1] > np.iinfo(index).max:
        raise OverflowError(f"{begins[-1]:,} entries in one rank exceed PETSc's {np.dtype(index).name}: use more ranks")
    return begins.astype(index), column[kept], value[kept]


def configured(petsc: Any, matrix: Any, axes: int) -> Any:
    """Return PETSc's solver: conjugate gradients with algebraic multigrid, changed by the variable PETSC_OPTIONS.

    `petsc`: the module petsc4py.PETSc; `matrix`: PETSc's matrix; `axes`: number of axes of the grid. Raises SystemExit
    with the name and value of an option that PETSc refuses.
    """
    options = petsc.Options()
    options.setValue("options_left", "")
    given = options.getAll()
    if not options.hasName("pc_type"):
        boomeramg = BOOMERAMG if axes < 3 else BOOMERAMG_3D
        for key, text in (boomeramg if petsc.Sys.hasExternalPackage("hypre") else GAMG).items():
            options.setValue(key, text)
    solver = petsc.KSP().create(matrix.comm)
    solver.setOperators(matrix)
    solver.setType("cg")
    solver.setNormType(petsc.KSP.NormType.UNPRECONDITIONED)
    try:
        solver.setFromOptions()
    except petsc.Error as error:
        why = str(error).splitlines()[-1]
        name, value = max(given.items(), key=lambda item: (item[0] in why, bool(item[1]) and item[1] in why))
        raise SystemExit(f"-{name} {value}: {why.partition('] ')[2]}") from error
    return solver


def solve(petsc: Any, solver: Any, matrix: Any, b: Any, rtol: float) -> tuple[Any, int, float]:
    """Return the solution, the number of iterations, and the residual norm relative to that of ``b``.

    PETSc solves for the remaining residual up to five times, and the corrections are summed; a solve that does not
    halve the residual is the last one. `petsc`: the module petsc4py.PETSc; `solver, matrix, b`: PETSc's solver, matrix
    and right-hand side; `rtol`: relative residual norm at which the solution is accepted, unless the limit of rounding
    is larger. Raises ArithmeticError if the solver diverges.
    """
    x, correction, r = b.duplicate(), b.duplicate(), b.copy()
    x.set(0.0)
    grain = np.finfo(np.float64).eps * matrix.norm(petsc.NormType.INFINITY)
    size = b.norm() or 1.0
    error, steps = 1.0, 0
    for _ in range(MOST_PASSES):
        solver.setTolerances(rtol=max(PASS, 0.5 * rtol / error), max_it=MOST_STEPS)
        solver.solve(r, correction)
        steps += solver.getIterationNumber()
        x.axpy(1.0, correction)
        matrix.mult(x, r)
        r.aypx(-1.0, b)
        before, error = error, float(r.norm() / size)
        if not error < 1.0:
            raise ArithmeticError(f"PETSc does not converge: KSPConvergedReason {solver.getConvergedReason()}")
        if error <= max(rtol, grain * x.norm() / size) or error > 0.5 * before:
            break
    return x, steps, error


def claim_rank(folder: Path, rank: int, ranks: int) -> None:
    """Raise RuntimeError if another process has the same rank, which happens if the launcher belongs to another MPI.

    A foreign launcher gives every process the rank 0 of 1. `folder`: folder of the system of equations; `rank,
    ranks`: number of this rank, and number of ranks.
    """
    try:
        (folder / f"rank_{rank}").open("x").close()
    except FileExistsError as error:
        problem = f"two of its processes are rank {rank} of {ranks}"
        (folder / "foreign").write_text(problem)
        raise RuntimeError(problem) from error


def main(folder: Path, *, shared: bool = False) -> None:
    """Solve the system of equations in `folder`; write the solution, statistics and peak memory there.

    `shared`: whether several computers share the folder, so that the solution is written to disk at once. Raises
    SystemExit with the name of an option that PETSc refuses.
    """
    try:
        from petsc4py import PETSc
    except Exception as fault:
        raise SystemExit(f"{os.environ.get('PETSC_OPTIONS')}: {fault}") from fault
    started = time.perf_counter()
    system = json.loads((folder / "system.json").read_text())
    shape, comm = system["shape"], PETSc.COMM_WORLD
    claim_rank(folder, comm.rank, comm.size)
    cells = int(np.prod(shape, dtype=np.int64))
    if cells > np.iinfo(PETSc.IntType).max:
        raise OverflowError(f"{cells:,} cells exceed this PETSc's {np.dtype(PETSc.IntType).name}: use its 64-bit build")
    first, last = rows_of(comm.rank, comm.size, cells)
    rows = local_rows(folder, shape, first, last, PETSc.IntType)
    size = (last - first, cells)
    matrix = PETSc.Mat().createAIJ((size, size), csr=rows, comm=comm)
    del rows
    matrix.setOption(PETSc.Mat.Option.SPD, True)
    b = PETSc.Vec().createMPI(size, comm=comm)
    b.setArray(mapped(folder, "drive")[first:last])
    assembled = time.perf_counter()
    solver = configured(PETSc, matrix, len(shape))
    solver.setUp()
    ready = time.perf_counter()
    x, iterations, error = solve(PETSc, solver, matrix, b, system["rtol"])
    answer = mapped(folder, "answer", "r+")
    answer[first:last] = x.getArray(readonly=True)
    if shared:
        answer.flush()
    solved = time.perf_counter()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    (folder / f"peak_{comm.rank}.json").write_text(json.dumps(peak))
    if comm.rank == 0:
        seconds = {"load": assembled - started, "factor": ready - assembled, "substitute": solved - ready}
        report = {"iterations": iterations, "error": error, "seconds": seconds, "ranks": comm.size}
        report["preconditioner"] = solver.getPC().getType()
        (folder / "report.json").write_text(json.dumps(report))


if __name__ == "__main__":
    try:
        main(Path(sys.argv[1]), shared=sys.argv[2:] == ["shared"])
    except BaseException as failure:
        if isinstance(failure, SystemExit):
            Path(sys.argv[1], "refused").write_text(str(failure))
        traceback.print_exc()
        sys.stderr.flush()
        os._exit(1)  # the other ranks wait for this one: mpiexec ends them after this exit
