"""Some equations solved directly, all other values as they are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.errors import AccuracyError
from resgrid.nodal.superlu import symmetric_factors

STEPS = 8
"""Steps around a node within which corrections die out."""


@dataclass(frozen=True, eq=False)
class Part:
    """The equations of some nodes.

    Attributes
    ----------
    nodes : ndarray of int64, shape (n,)
        In ascending order.
    row, outside : ndarray of int64, shape (edges,)
        Conductances that lead out: from which of the nodes, counted, to which one.
    conductance : ndarray of float64, shape (edges,)
    coupling : scipy.sparse.csr_array, shape (n, n)
        Conductances among the nodes.
    factors : scipy.sparse.linalg.SuperLU or None
        None where rounding forbids.
    """

    nodes: NDArray[np.int64]
    row: NDArray[np.int64]
    outside: NDArray[np.int64]
    conductance: NDArray[np.float64]
    coupling: sparse.csr_array
    factors: Any

    @classmethod
    def of(
        cls,
        nodes: NDArray[np.int64],
        degree: NDArray[np.float64],
        here: NDArray[np.integer],
        there: NDArray[np.integer],
        conductance: NDArray[np.float64],
    ) -> Part:
        """Factor the equations of some nodes.

        Parameters
        ----------
        nodes : ndarray of int64, shape (n,)
            In ascending order.
        degree : ndarray of float64, shape (n,)
            Their diagonal entries.
        here, there : ndarray of int, shape (m,)
            All conductances at these nodes: from which of them, counted, to which node.
        conductance : ndarray of float64, shape (m,)
        """
        n = len(nodes)
        column = np.searchsorted(nodes, there)
        inside = nodes[np.minimum(column, n - 1)] == there
        coupling = sparse.csr_array((conductance[inside], (here[inside], column[inside])), shape=(n, n))
        try:
            factors = symmetric_factors(sparse.diags_array(degree) - coupling)
        except AccuracyError:
            factors = None
        out = ~inside
        return cls(nodes, here[out], there[out], conductance[out], coupling, factors)

    def potential(self, currents: NDArray[np.float64], x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Potential at the nodes, fed by the others' and by currents; as it is, if there are no factors."""
        if self.factors is None:
            return np.asarray(x[self.nodes])
        drawn = np.bincount(self.row, self.conductance * x[self.outside], len(self.nodes))
        return np.asarray(self.factors.solve(currents[self.nodes] + drawn))


def surroundings(
    nodes: NDArray[np.int64],
    size: int,
    neighbours: Callable[[NDArray[np.int64]], NDArray[np.integer]],
    most: int,
    least: int = 0,
) -> NDArray[np.int64] | None:
    """Some of ``size`` nodes, and all that are few steps away; None for more than ``most``.

    Steps that lead to less than ``least`` nodes in all are followed by more.  ``neighbours`` tells those of some
    nodes, one of them as often as it likes.
    """
    seen, edge, count, steps = np.zeros(size, dtype=np.bool_), nodes, len(nodes), 0
    seen[nodes] = True
    while len(edge) and (steps < STEPS or count < least):
        steps += 1
        if count > most:
            return None
        around = neighbours(edge)
        around = around[~seen[around]]
        seen[around] = True
        edge = np.unique(around)
        count += len(edge)
    return np.flatnonzero(seen) if count <= most else None
