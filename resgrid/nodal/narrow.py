"""Factors of narrow circuits: eliminated along their corridors, from the far ends towards the rail.

Where a circuit is a maze, rows in the order of their distance from one of them fill little: a row that is eliminated is
joined to those across the corridor alone.  Fewer operations come of it than a general ordering takes to be found.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.errors import AccuracyError

if TYPE_CHECKING:
    from resgrid.nodal.system import NodalSystem

_MOST_FILL, _MOST_FILL_OF_VOLUMES = 60, 200
"""Entries a column above which a circuit is not narrow: other factors are sooner made, but of volumes much later."""

_MOST_ENTRIES = 2**31 - 1

_STRETCH = 20_000
"""Rows eliminated at a time."""


@dataclass(frozen=True, eq=False)
class NarrowOrder:
    """An order of the rows in which factors fill little.

    Attributes
    ----------
    order, rank : ndarray of int32, shape (n,)
        Row of every number, and number of every row.
    end, columns : ndarray of int32, shapes (n,) and (entries,)
        Columns left of the diagonal that the rows of the factor have entries in, and where the list of every row ends.
    """

    order: NDArray[np.int32]
    rank: NDArray[np.int32]
    end: NDArray[np.int32]
    columns: NDArray[np.int32]


def narrow_order(system: NodalSystem) -> NarrowOrder | None:
    """Order the rows of a system by their distance from a rail; None where it is not narrow."""
    from resgrid.nodal import narrow_kernels as kernels
    from resgrid.nodal.multigrid.clusters import breadth_first
    from resgrid.nodal.multigrid.ordering import inverse_of

    graph = system.coupling.indptr, system.coupling.indices
    parent, end = np.empty((2, system.size), dtype=np.int32)
    columns = np.empty(_room(system), dtype=np.int32)
    tied = system.excess if system.rails is None else system.rails.to_low
    order = np.ascontiguousarray(breadth_first(*graph, int(np.argmax(tied)))[::-1])
    rank = inverse_of(order)
    kernels.grow_tree(*graph, order, rank, parent)
    kernels.branch_by_branch(parent, order, rank)
    if not kernels.list_rows(*graph, order, rank, parent, end, columns):
        return None
    return NarrowOrder(order, rank, end, columns[: end[-1]].copy())


def _room(system: NodalSystem) -> int:
    """Entries that the factor of a narrow circuit may have."""
    most = _MOST_FILL_OF_VOLUMES if system.dimensions > 2 else _MOST_FILL
    return min(most * system.size, _MOST_ENTRIES - system.size)


def narrow_memory(system: NodalSystem, narrow: NarrowOrder) -> float:
    """Estimate the peak memory of a solution in such an order, in bytes, the room for most entries included."""
    return 24.0 * len(narrow.columns) + 4.0 * _room(system) + 120.0 * system.size


def factor_narrow(system: NodalSystem, narrow: NarrowOrder) -> tuple[sparse.csc_array, NDArray[np.float64]]:
    """Factor a system in such an order.

    Parameters
    ----------
    system : NodalSystem
    narrow : NarrowOrder

    Returns
    -------
    lower : scipy.sparse.csc_array, shape (n, n)
        Unit lower triangular, the diagonal entry first in every column.
    pivot : ndarray of float64, shape (n,)

    Raises
    ------
    AccuracyError
        If a pivot leaves the range of doubles.
    """
    from resgrid.nodal.narrow_kernels import eliminate, list_columns

    n, coupling = system.size, system.coupling
    start = np.zeros(n + 1, dtype=np.int32)
    np.cumsum(1 + np.bincount(narrow.columns, minlength=n), out=start[1:])
    below, lower = np.empty(start[-1], dtype=np.int32), np.empty(start[-1])
    list_columns(narrow.end, narrow.columns, start, below)
    after, pivot, held, joined = start[:-1].copy(), np.empty(n), np.empty(n), np.zeros(n)
    # In stretches, so that it can be interrupted.
    for begin in range(0, n, _STRETCH):
        if not eliminate(
            coupling.indptr, coupling.indices, coupling.data, system.excess, narrow.order, narrow.rank, narrow.end,
            narrow.columns, start, after, below, lower, pivot, held, joined, begin, min(begin + _STRETCH, n),
        ):  # fmt: skip
            raise AccuracyError(
                "a pivot left the range of doubles: the conductances span too many decades for a direct solution"
            )
    return sparse.csc_array((lower, below, start), shape=(n, n)), pivot
