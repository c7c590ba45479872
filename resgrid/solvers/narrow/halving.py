"""Half of a nodal system's rows, once the others are eliminated: those of one colour, where it is a grid's.

Rows that no conductance joins to each other are eliminated independently.  Of a grid they are every other cell; the
factors of what is left have half of the entries, and take half of the products.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.solvers.laplacian import Laplacian
from resgrid.solvers.refine import Numbers


@dataclass(frozen=True, eq=False)
class Halves:
    """A nodal system of which some rows have been eliminated, in positive numbers alone.

    `whole` (n, n): conductances between all rows, in siemens; `number` (n,): of the rows kept; -1 for the others;
    `pivot` (n,): all conductances at the rows eliminated, summed, in siemens; 0 for the others; `coupling` (kept,
    kept): conductances between the rows kept, in siemens, in any order; no diagonal; `excess` (kept,): conductances
    from the rows kept to the rails, in siemens.
    """

    whole: sparse.csr_array
    number: NDArray[np.int32]
    pivot: NDArray[np.float64]
    coupling: sparse.csr_array
    excess: NDArray[np.float64]

    def gather(self, m: NDArray[np.float64], e: NDArray[np.int64]) -> Numbers:
        """What is fed into the rows kept, of what is fed into all, in scaled numbers."""
        from resgrid.solvers.narrow import halving_kernels as kernels

        kept = np.empty(len(self.excess)), np.empty(len(self.excess), dtype=np.int64)
        kernels.gather(*self._rows, self.number, self.pivot, m, e, *kept)
        return kept

    def scatter(self, kept: Numbers, m: NDArray[np.float64], e: NDArray[np.int64]) -> Numbers:
        """All voltages, from those of the rows kept and from what is fed into all."""
        from resgrid.solvers.narrow import halving_kernels as kernels

        solution = m.copy(), e.copy()
        kernels.scatter(*self._rows, self.number, self.pivot, *kept, *solution)
        return solution

    @property
    def _rows(self) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float64]]:
        return self.whole.indptr, self.whole.indices, self.whole.data


def halve(laplacian: Laplacian, order: NDArray[np.int32]) -> Halves:
    """Eliminate every other row of a laplacian.  Shapes: `order` (n,)."""
    from resgrid.solvers.narrow import halving_kernels as kernels

    rows = laplacian.edges.indptr, laplacian.edges.indices
    number = np.empty(laplacian.size, dtype=np.int32)
    size = kernels.number_kept(*rows, order, number)
    most = kernels.most_entries(*rows, number)
    pivot, excess = np.zeros(laplacian.size), np.empty(size)
    indptr, indices, data = np.zeros(size + 1, dtype=np.int32), np.empty(most, dtype=np.int32), np.empty(most)
    kept = order[number[order] >= 0]
    kernels.join_kept(
        *rows, laplacian.edges.data, laplacian.ground, number, kept, pivot, indptr, indices, data, excess
    )  # fmt: skip
    coupling = sparse.csr_array((data[: indptr[-1]], indices[: indptr[-1]], indptr), shape=(size, size))
    return Halves(laplacian.edges, number, pivot, coupling, excess)
