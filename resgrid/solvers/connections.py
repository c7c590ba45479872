"""How the rows of a nodal system hang together: the few numbers that a method is chosen by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from resgrid.solvers.laplacian import EdgeList, Laplacian, once
from resgrid.solvers.team import ALONE, Team, pieces

_MOST_PARTS = 8
"""Of a list of edges, each with neighbours of its own."""

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
def count_connections(laplacian: Laplacian, team: Team = ALONE) -> Connections:
    """Count the neighbours of all rows, and compare their conductances.

    On a grid the resistors are counted one by one, so that no compressed rows are needed; there only the two across
    a ring of two cells are parallel.
    """
    from resgrid.solvers import row_kernels as kernels

    listed, grid = laplacian.listed, laplacian.grid
    if listed is not None and grid is not None and grid.simple:
        inner, smallest, largest, half, few = _count_edges(listed, laplacian.size, team)
        some = smallest < WEAK * largest
        weak = kernels.weak_pairs(*listed, laplacian.size, WEAK) / inner if some else 0.0
        entries, total = 2 * inner, 2.0 * half
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


def _count_edges(listed: EdgeList, size: int, team: Team) -> tuple[int, float, float, float, int]:
    """Conductances between rows: how many, the smallest, the largest, their sum; rows with at most two neighbours."""
    from resgrid.solvers.row_kernels import count_neighbours

    cut = pieces(0, len(listed.conductance)) or [slice(0, 0)]
    parts = min(team.size, len(cut), _MOST_PARTS)
    neighbours = np.zeros((parts, size), dtype=np.uint8)
    found: list[tuple[int, float, float, float]] = [(0, np.inf, 0.0, 0.0)] * len(cut)

    def count(part: int) -> None:
        for k in range(part * len(cut) // parts, (part + 1) * len(cut) // parts):
            some = listed.ends[cut[k]], listed.conductance[cut[k]], listed.row
            found[k] = count_neighbours(*some, neighbours[part])

    team.share(count, parts)
    few = team.over(size, lambda rows: int(np.count_nonzero(neighbours[:, rows].sum(axis=0, dtype=np.uint8) <= 2)))
    inner, smallest, largest, half = zip(*found, strict=True)
    return sum(inner), min(smallest), max(largest), sum(half), sum(few)
