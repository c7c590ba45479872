"""Factors of narrow circuits: eliminated along their corridors, from the far ends towards the rail.

Where a circuit is a maze, rows in the order of their distance from one of them fill little: a row that is eliminated is
joined to those across the corridor alone.  Fewer operations come of it than a general ordering takes to be found.
Every other row is eliminated beforehand (`resgrid.solvers.narrow.halving`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import AccuracyError
from resgrid.solvers.laplacian import Laplacian, once
from resgrid.solvers.narrow.halving import Halves, halve
from resgrid.solvers.refine import Numbers

if TYPE_CHECKING:
    from resgrid.solvers.narrow.panel_kernels import Panels

_MOST_FILL, _MOST_FILL_OF_VOLUMES = 150, 600
"""Entries a column above which a circuit is not narrow: other factors are sooner made, but of volumes much later."""

_LEAST_SHARED = 4
"""Entries of all panels for each of their rows, at least, where a circuit is narrow."""

_MOST_ENTRIES = 2**31 - 1
"""Keeps the places of their rows, a quarter as many, within 32 bits."""

_STRETCH = 2_000
"""Panels eliminated at a time."""


@dataclass(frozen=True, eq=False)
class NarrowOrder:
    """An order of half of the rows in which factors fill little.

    `halves`: what is left where the other half is eliminated; `order, rank` (kept,): row kept of every number, and
    number of every row kept; `panels`: columns of the factor that are kept together, and their rows.
    """

    halves: Halves
    order: NDArray[np.int32]
    rank: NDArray[np.int32]
    panels: Panels

    @property
    def entries(self) -> int:
        """Entries of all panels."""
        return int(self.panels.offset[-1])

    @property
    def products(self) -> float:
        """Products that elimination takes, about."""
        return float(0.5 * np.sum(self.widths * self.lengths.astype(np.float64) ** 2))

    @cached_property
    def widths(self) -> NDArray[np.int32]:
        """Columns of every panel."""
        return np.diff(self.panels.first)

    @cached_property
    def lengths(self) -> NDArray[np.int32]:
        """Rows of every panel."""
        return np.diff(self.panels.start)

    @cached_property
    def longest(self) -> int:
        """Most rows of a panel."""
        return int(self.lengths.max())


@dataclass(frozen=True, eq=False)
class NarrowFactors:
    """Factors ``L D L^T`` in such an order.

    `values`: the entries of ``-L`` below the diagonal, panel by panel; `pivot` (kept,): ``D``, in siemens.
    """

    narrow: NarrowOrder
    values: NDArray[np.float64]
    pivot: NDArray[np.float64]

    def substitute(self, m: NDArray[np.float64], e: NDArray[np.int64]) -> Numbers:
        """Both substitutions, in scaled numbers; ``m`` and ``e``, shape (n,), stay as they are."""
        from resgrid.solvers.narrow.substitution import substitute_panels

        halves, order, rank = self.narrow.halves, self.narrow.order, self.narrow.rank
        kept, scale = halves.gather(m, e)
        kept, scale = kept[order], scale[order]
        substitute_panels(self.narrow.panels, self.values, self.pivot, kept, scale, np.empty(self.narrow.longest))
        return halves.scatter((kept[rank], scale[rank]), m, e)


@once
def narrow_order(laplacian: Laplacian) -> NarrowOrder | None:
    """Order the rows of a system by their distance from a rail; None where it is not narrow."""
    from resgrid.solvers.narrow import order_kernels as kernels
    from resgrid.solvers.narrow.panel_kernels import Panels
    from resgrid.solvers.numbering_kernels import breadth_first

    tied = laplacian.ground if laplacian.rails is None else laplacian.rails.to_low
    outwards = breadth_first(laplacian.edges.indptr, laplacian.edges.indices, int(np.argmax(tied)))
    halves = halve(laplacian, np.ascontiguousarray(outwards[::-1]))
    graph, size = (halves.coupling.indptr, halves.coupling.indices), len(halves.excess)
    order = np.arange(size, dtype=np.int32)
    rank, parent = order.copy(), np.empty(size, dtype=np.int32)
    kernels.grow_tree(*graph, order, rank, parent)
    kernels.branch_by_branch(parent, order, rank)
    (first, start), rows = np.empty((2, size + 1), dtype=np.int32), np.empty(_rows(laplacian), dtype=np.int32)
    count = kernels.list_panels(*graph, order, rank, _room(laplacian), first, start, rows)
    if count < 0:
        return None
    first, start = first[: count + 1].copy(), start[: count + 1].copy()
    offset = np.zeros(count + 1, dtype=np.int64)
    np.cumsum(np.diff(first).astype(np.int64) * np.diff(start), out=offset[1:])
    return NarrowOrder(halves, order, rank, Panels(first, start, rows[: start[-1]].copy(), offset))


def _room(laplacian: Laplacian) -> int:
    """Entries that the factor of a narrow circuit may have."""
    most = _MOST_FILL_OF_VOLUMES if laplacian.dimensions > 2 else _MOST_FILL
    return min(most * laplacian.size, _MOST_ENTRIES - laplacian.size)


def _rows(laplacian: Laplacian) -> int:
    """Rows that its panels may have, with room for one more panel."""
    return _room(laplacian) // _LEAST_SHARED + 2 * laplacian.size


def narrow_memory(laplacian: Laplacian, narrow: NarrowOrder) -> float:
    """Estimate the peak memory of a solution in such an order, in bytes, the room for most entries included."""
    return 8.0 * narrow.entries + 8.0 * len(narrow.panels.rows) + 4.0 * _rows(laplacian) + 180.0 * laplacian.size


def factor_narrow(narrow: NarrowOrder) -> NarrowFactors:
    """Factor a system in such an order."""
    from resgrid.solvers.narrow.panel_kernels import Bench, Entries, Matrix, eliminate

    halves, count = narrow.halves, len(narrow.widths)
    n, coupling = len(halves.excess), halves.coupling
    matrix = Matrix(coupling.indptr, coupling.indices, coupling.data, halves.excess, narrow.order, narrow.rank)
    entries = Entries(np.empty(narrow.entries), np.empty(n), np.empty(n))
    bench = Bench(
        panel_of=np.repeat(np.arange(count, dtype=np.int32), narrow.widths),
        waiting=np.full(count, -1, dtype=np.int32),
        following=np.empty(count, dtype=np.int32),
        after=np.empty(count, dtype=np.int32),
        place=np.empty(n, dtype=np.int32),
        column=np.empty(narrow.longest),
        weight=np.empty(int(narrow.widths.max())),
        weights=np.empty((int(narrow.widths.max()), 4)),
    )
    in_range = bool(np.all(np.isfinite(halves.pivot)))
    # In stretches, so that it can be interrupted.
    for begin in range(0, count, _STRETCH):
        in_range = in_range and eliminate(matrix, narrow.panels, entries, bench, begin, min(begin + _STRETCH, count))
    if not in_range:
        raise AccuracyError(
            "a pivot left the range of doubles: the conductances span too many decades for a direct solution"
        )
    return NarrowFactors(narrow, entries.values, entries.pivot)
