"""Odd-even reduction: of rows in layers, every other layer's rows are eliminated, where they are independent.

Of a grid these are the cells of one colour.  Factors of what is left have half of the entries, and take half of the
products.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.laplacian import Laplacian
from resgrid.solvers.refine import Numbers

if TYPE_CHECKING:
    from resgrid.solvers.odd_even_kernels import Rows


@dataclass(frozen=True, eq=False)
class OddEven:
    """A matrix of which some rows have been eliminated, in positive numbers alone.

    `whole`: all rows (n,); `left`: the rows kept (kept,), entries in any order; `number` (n,): of the rows kept; -1 for
    the others; `pivot` (n,): of the rows eliminated, in siemens; 0 for the others.
    """

    whole: Rows
    left: Rows
    number: NDArray[np.int32]
    pivot: NDArray[np.float64]

    @property
    def size(self) -> int:
        """Number of rows kept."""
        return len(self.left.ground)

    def feed_kept(self, m: NDArray[np.float64], e: NDArray[np.int64]) -> Numbers:
        """What is fed into the rows kept, (kept,), of what is fed into all, (n,), in scaled numbers."""
        from resgrid.solvers import odd_even_kernels as kernels

        kept = np.empty(self.size), np.empty(self.size, dtype=np.int64)
        kernels.feed_kept(self.whole, self.number, self.pivot, m, e, *kept)
        return kept

    def put_back(self, kept: Numbers, m: NDArray[np.float64], e: NDArray[np.int64]) -> Numbers:
        """All voltages, (n,), from those of the rows kept and from what is fed into all."""
        from resgrid.solvers import odd_even_kernels as kernels

        solution = m.copy(), e.copy()
        kernels.put_back(self.whole, self.number, self.pivot, *kept, *solution)
        return solution


def reduce_odd_even(laplacian: Laplacian, order: NDArray[np.int32]) -> OddEven:
    """Eliminate every other layer of an order (n,), breadth first and backwards."""
    from resgrid.solvers import odd_even_kernels as kernels

    edges, n = laplacian.sorted_rows, laplacian.size
    indptr, indices = edges.indptr.astype(np.int32, copy=False), edges.indices.astype(np.int32, copy=False)
    whole = kernels.Rows(indptr, indices, edges.data, laplacian.ground)
    number, pivot = np.empty(n, dtype=np.int32), np.zeros(n)
    size = kernels.number_kept(indptr, indices, order, number)
    most = kernels.most_entries(indptr, indices, number)
    left = kernels.Rows(
        np.empty(size + 1, dtype=np.int32), np.empty(most, dtype=np.int32), np.empty(most), np.empty(size)
    )
    kernels.join_kept(whole, number, order[number[order] >= 0], pivot, left)
    return OddEven(whole, left, number, pivot)
