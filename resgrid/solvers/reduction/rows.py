"""Eliminate the rows of a matrix of conductances that have, or come to have, at most two neighbours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

if TYPE_CHECKING:
    from resgrid.solvers.reduction.kernels import Record, Web

_MOST_ROUNDS = 20


@dataclass(frozen=True, eq=False)
class Elimination:
    """What is left of a matrix, and how the rest was eliminated.

    `record`: how rows were eliminated, one entry each; `kept` (core rows,): rows that are left; `number` (n,): their
    number among these, -1 for the others; `coupling`: the conductances between rows that are left, in siemens;
    `excess` (core rows,): conductance from them to the rails, in siemens.
    """

    record: Record
    kept: NDArray[np.int64]
    number: NDArray[np.int32]
    coupling: sparse.csr_array
    excess: NDArray[np.float64]


def eliminate_rows(coupling: sparse.csr_array, excess: NDArray[np.float64]) -> Elimination:
    """Eliminate rows of at most two neighbours until there are none.

    Time and memory are linear in the number of conductances.  Conductances that come to join the same two rows are
    merged at once where one of the rows is short; between two hubs they wait for a pass over all rows.

    Shapes: `coupling` (n, n), `excess` (n,).
    """
    from resgrid.solvers.reduction import kernels

    n = len(excess)
    web = _web(coupling, excess)
    record = kernels.Record(np.empty((n, 3), dtype=np.int32), np.empty((n, 6)))
    count, doubled = kernels.eliminate(web, record, 0)
    rounds = 1
    while doubled and count < n and rounds < _MOST_ROUNDS:
        kernels.merge_parallel(web)
        count, doubled = kernels.eliminate(web, record, count)
        rounds += 1
    if doubled:
        kernels.merge_parallel(web)
    kept = np.flatnonzero(~web.gone)
    number = np.full(n, -1, dtype=np.int32)
    number[kept] = np.arange(len(kept), dtype=np.int32)
    indptr = np.concatenate([np.zeros(1, dtype=np.int32), np.cumsum(web.length[kept], dtype=np.int32)])
    indices, conductance = kernels.pack(web, number, indptr)
    core = sparse.csr_array((conductance, indices, indptr), shape=(len(kept), len(kept)))
    core.sort_indices()
    record = kernels.Record(record.rows[:count], record.weights[:count])
    return Elimination(record, kept, number, core, web.excess[kept])


def _web(coupling: sparse.csr_array, excess: NDArray[np.float64]) -> Web:
    from resgrid.solvers.reduction import kernels

    if not coupling.has_sorted_indices:
        coupling = coupling.sorted_indices()
    indptr, indices = coupling.indptr.astype(np.int32), coupling.indices.astype(np.int32)
    n = len(excess)
    return kernels.Web(
        start=indptr[:-1].copy(),
        length=np.diff(indptr),
        neighbour=indices,
        twin=kernels.find_twins(indptr, indices),
        g=coupling.data.astype(np.float64),
        g_low=np.zeros(len(indices)),
        excess=excess.astype(np.float64),
        excess_low=np.zeros(n),
        gone=np.zeros(n, dtype=np.bool_),
    )
