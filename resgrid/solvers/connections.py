"""How the rows of a nodal system hang together: the few numbers that a method is chosen by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from resgrid.solvers.laplacian import Laplacian, once

WEAK = 0.1
"""A conductance is weak below this share of the strongest one at either of its ends."""


@dataclass(frozen=True)
class Connections:
    """Counts over the conductances between rows.

    `entries`: twice their number: the entries of the `coupling`; `few`: number of rows with at most two neighbours;
    `weak`: share of conductances that are weak beside the strongest one at either of their ends; `mean`: mean
    conductance, in siemens; 0 where there is none; `smallest, largest`: the range of the conductances, those to rails
    included, in siemens.
    """

    entries: int
    few: int
    weak: float
    mean: float
    smallest: float
    largest: float


@once
def count_connections(laplacian: Laplacian) -> Connections:
    """Count the neighbours of all rows, and compare their conductances.

    On a grid the resistors are counted one by one, so that no compressed rows are needed; there only the two across
    a ring of two cells are parallel.
    """
    from resgrid.solvers import row_kernels as kernels

    listed, grid = laplacian.listed, laplacian.grid
    if listed is not None and grid is not None and grid.simple:
        neighbours = np.zeros(laplacian.size, dtype=np.int8)
        inner, smallest, largest, half = kernels.count_neighbours(*listed, neighbours)
        some = smallest < WEAK * largest
        weak = kernels.weak_pairs(*listed, laplacian.size, WEAK) / inner if some else 0.0
        entries, few = 2 * inner, int(np.count_nonzero(neighbours <= 2))
        total = 2.0 * half
    else:
        rows = laplacian.any_rows
        entries, few = len(rows.indices), int(np.count_nonzero(np.diff(rows.indptr) <= 2))
        weak = kernels.weak_share(rows.indptr, rows.indices, rows.data, WEAK)
        smallest, largest = rows.data.min(initial=np.inf), rows.data.max(initial=0.0)
        total = rows.data.sum()
    present = laplacian.ground[laplacian.ground > 0]
    return Connections(
        entries=entries,
        few=few,
        weak=float(weak),
        mean=float(total) / entries if entries else 0.0,
        smallest=float(min(smallest, present.min(initial=np.inf))),
        largest=float(max(largest, present.max(initial=0.0))),
    )
