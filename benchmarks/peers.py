"""External solvers with a common interface of three steps.

A peer is a function ``prepare(matrix) -> setup``; ``setup() -> solve``; ``solve(rhs, rtol) -> (x, iterations)``.
Preparation (conversion of the matrix to the library's format) is not timed; setup and solution are.  This module
imports only numpy, so that a peer can run in another Python (PETSc of Debian).  A peer whose library is missing raises
`ImportError` in ``prepare``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Solve = Callable[[NDArray[np.float64], float], tuple[NDArray[np.float64], int | None]]
Setup = Callable[[], Solve]

MOST_ITERATIONS = 1000


@dataclass(frozen=True, eq=False)
class Matrix:
    """A symmetric matrix in compressed rows, int32 indices sorted in each row."""

    indptr: NDArray[np.int32]
    indices: NDArray[np.int32]
    data: NDArray[np.float64]

    @property
    def size(self) -> int:
        """Return the number of rows."""
        return len(self.indptr) - 1

    def scipy(self, form: str = "csr") -> Any:
        """Return a scipy matrix in compressed columns; by symmetry the compressed rows are the columns."""
        from scipy import sparse

        made = sparse.csr_matrix if form == "csr" else sparse.csc_matrix
        return made((self.data, self.indices, self.indptr), shape=(self.size, self.size))


@dataclass(frozen=True)
class Peer:
    """An external contender.

    Attributes
    ----------
    title : str
        Name in the table.
    prepare : callable
        See the module docstring.
    direct : bool
        Whether it factors the whole matrix (omitted if the factors would not fit in memory).
    package : str
        Package whose version is reported.
    """

    title: str
    prepare: Callable[[Matrix], Setup]
    direct: bool
    package: str


def superlu(matrix: Matrix) -> Setup:
    """SuperLU in scipy, symmetric mode."""
    from scipy.sparse.linalg import splu

    columns = matrix.scipy("csc")

    def setup() -> Solve:
        options = {"SymmetricMode": True}
        factors = splu(columns, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
        return lambda rhs, _: (factors.solve(rhs), None)

    return setup


def cholmod(matrix: Matrix) -> Setup:
    """CHOLMOD through kvxopt: supernodal, AMD ordering."""
    import kvxopt
    from kvxopt import cholmod as library

    row = np.repeat(np.arange(matrix.size), np.diff(matrix.indptr))
    lower = row >= matrix.indices
    values, rows, columns = matrix.data[lower].tolist(), row[lower].tolist(), matrix.indices[lower].tolist()
    a = kvxopt.spmatrix(values, rows, columns, (matrix.size, matrix.size))

    def setup() -> Solve:
        factors = library.symbolic(a)
        library.numeric(a, factors)

        def solve(rhs: NDArray[np.float64], _: float) -> tuple[NDArray[np.float64], None]:
            x = kvxopt.matrix(rhs)
            library.solve(factors, x)
            return np.array(x).ravel(), None

        return solve

    return setup


def pardiso(matrix: Matrix) -> Setup:
    """MKL Pardiso, symmetric positive definite, on the upper triangle."""
    import pypardiso
    from scipy import sparse

    upper = sparse.csr_matrix(sparse.triu(matrix.scipy(), format="csr"))

    def setup() -> Solve:
        solver = pypardiso.PyPardisoSolver(mtype=2)
        solver.set_phase(12)
        solver._call_pardiso(upper, np.zeros((matrix.size, 1)))

        def solve(rhs: NDArray[np.float64], _: float) -> tuple[NDArray[np.float64], None]:
            solver.set_phase(33)
            x = solver._call_pardiso(upper, rhs.reshape(-1, 1)).ravel()
            solver.free_memory(everything=True)
            return x, None

        return solve

    return setup


def cholespy(matrix: Matrix) -> Setup:
    """Cholespy on the processor."""
    from cholespy import CholeskySolverD, MatrixType

    def setup() -> Solve:
        solver = CholeskySolverD(matrix.size, matrix.indptr, matrix.indices, matrix.data, MatrixType.CSR)

        def solve(rhs: NDArray[np.float64], _: float) -> tuple[NDArray[np.float64], None]:
            x = np.zeros_like(rhs)
            solver.solve(rhs, x)
            return x, None

        return solve

    return setup


def apxchol(matrix: Matrix) -> Setup:
    """Approximate Cholesky factors and conjugate gradients."""
    import apxchol as library

    columns = matrix.scipy("csc")

    def setup() -> Solve:
        solver = library.factorize(columns, keep_factor=False)

        def solve(rhs: NDArray[np.float64], rtol: float) -> tuple[NDArray[np.float64], int]:
            answer = solver.solve(rhs, rtol=rtol, maxiter=MOST_ITERATIONS)
            return answer.x, answer.iters

        return solve

    return setup


def ruge_stuben(matrix: Matrix) -> Setup:
    """Classical algebraic multigrid of pyamg and conjugate gradients."""
    import pyamg

    return _pyamg(matrix, pyamg.ruge_stuben_solver)


def smoothed_aggregation(matrix: Matrix) -> Setup:
    """Smoothed aggregation of pyamg and conjugate gradients."""
    import pyamg

    return _pyamg(matrix, pyamg.smoothed_aggregation_solver)


def _pyamg(matrix: Matrix, build: Callable[[Any], Any]) -> Setup:
    rows = matrix.scipy()

    def setup() -> Solve:
        levels = build(rows)

        def solve(rhs: NDArray[np.float64], rtol: float) -> tuple[NDArray[np.float64], int]:
            history: list[float] = []
            x = levels.solve(rhs, tol=rtol, accel="cg", maxiter=MOST_ITERATIONS, residuals=history)
            return x, len(history) - 1

        return solve

    return setup


def boomeramg(matrix: Matrix) -> Setup:
    """BoomerAMG of hypre through PETSc, and conjugate gradients."""
    return _petsc(matrix, {"pc_type": "hypre", "pc_hypre_type": "boomeramg"})


def gamg(matrix: Matrix) -> Setup:
    """Smoothed aggregation of PETSc, and conjugate gradients."""
    return _petsc(matrix, {"pc_type": "gamg"})


def _petsc(matrix: Matrix, options: dict[str, str]) -> Setup:
    import petsc4py

    petsc4py.init([])
    from petsc4py import PETSc

    a = PETSc.Mat().createAIJ((matrix.size,) * 2, csr=(matrix.indptr, matrix.indices, matrix.data))
    a.setOption(PETSc.Mat.Option.SPD, True)
    for key, value in options.items():
        PETSc.Options().setValue(key, value)

    def setup() -> Solve:
        solver = PETSc.KSP().create()
        solver.setOperators(a)
        solver.setType("cg")
        solver.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        solver.setFromOptions()
        solver.setUp()

        def solve(rhs: NDArray[np.float64], rtol: float) -> tuple[NDArray[np.float64], int]:
            solver.setTolerances(rtol=rtol, max_it=MOST_ITERATIONS)
            x, b = a.createVecs()
            b.setArray(rhs)
            solver.solve(b, x)
            answer, iterations = x.getArray().copy(), solver.getIterationNumber()
            solver.destroy()
            return answer, iterations

        return solve

    return setup


PEERS = {
    "cholmod": Peer("CHOLMOD (kvxopt)", cholmod, True, "kvxopt"),
    "pardiso": Peer("Pardiso SPD (MKL)", pardiso, True, "mkl"),
    "cholespy": Peer("cholespy", cholespy, True, "cholespy"),
    "superlu": Peer("SuperLU (scipy)", superlu, True, "scipy"),
    "ruge_stuben": Peer("pyamg Ruge-Stueben + CG", ruge_stuben, False, "pyamg"),
    "smoothed_aggregation": Peer("pyamg smoothed agg. + CG", smoothed_aggregation, False, "pyamg"),
    "apxchol": Peer("apxchol + CG", apxchol, False, "apxchol"),
    "boomeramg": Peer("hypre BoomerAMG + CG", boomeramg, False, "petsc4py"),
    "gamg": Peer("PETSc GAMG + CG", gamg, False, "petsc4py"),
}
