"""The matrix of all solvers: a graph of conductances, and conductances from its rows to nodes of known voltage.

Also the statistics from which a method is chosen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import BudgetError
from resgrid.solvers.scaled import Floats, Indices, Reals

if TYPE_CHECKING:
    from scipy import sparse

MOST_NUMBERED = 2**31 - 1
"""Largest number of rows, entries or slots, which have 32-bit indices."""

VOLUME = 4.2
"""Mean number of neighbours of a row above which corridors are treated as three-dimensional (two dimensions across)."""

WEAK = 0.1
"""A conductance is weak if it is below this fraction of the strongest one at either of its ends."""


class EdgeList(NamedTuple):
    """List of edges: edge ``k`` joins the rows ``row[ends[k]]`` by ``conductance[k]``, in siemens.

    `ends` (m, 2): vertices; `conductance` (m,); `row` (vertices,): row of every vertex, -1 where its voltage is known.
    Edges within a row, or with an end at a known voltage, are not entries of the matrix.
    """

    ends: Indices
    conductance: Floats
    row: Indices


class Rows(NamedTuple):
    """Symmetric CSR arrays of the edges, without a diagonal, as arguments of kernels and without an import of scipy.

    `indptr` (n + 1,); `indices, data` (entries,): columns, sorted in every row, and conductances in siemens.
    """

    indptr: Indices
    indices: Indices
    data: Floats

    @classmethod
    def of(cls, array: sparse.csr_array) -> Rows:
        """Return a view of a CSR array, which is sorted in place."""
        array.sort_indices()
        return cls(array.indptr.astype(np.int32, copy=False), array.indices.astype(np.int32, copy=False), array.data)

    @property
    def array(self) -> sparse.csr_array:
        """View as a scipy array (n, n)."""
        from scipy import sparse

        size = len(self.indptr) - 1
        array = sparse.csr_array((self.data, self.indices, self.indptr), shape=(size, size))
        array.has_sorted_indices = array.has_canonical_format = True
        return array

    @property
    def listed(self) -> EdgeList:
        """The edges as a list, each one once, lower row first."""
        each = np.arange(len(self.indptr) - 1, dtype=np.int32)
        row = np.repeat(each, np.diff(self.indptr))
        upper = self.indices > row
        return EdgeList(np.stack([row[upper], self.indices[upper]], axis=1), self.data[upper], each)


class Graph(NamedTuple):
    """A graph as argument of kernels: conductances by rows, in any order, and leaks to nodes of known voltage.

    `indptr` (n + 1,), `indices, conductance` (entries,), `leak` (n,); in siemens, or in a unit.
    """

    indptr: Indices
    indices: Indices
    conductance: Reals
    leak: Floats

    @property
    def size(self) -> int:
        """Number of rows."""
        return len(self.leak)


@dataclass(frozen=True, eq=False)
class Grid:
    """Positions of vertices in a grid: `vertex`, of the grid's shape, -1 for none; `periodic`: axes that are rings."""

    vertex: Indices
    periodic: tuple[bool, ...]

    @property
    def simple(self) -> bool:
        """Whether no two edges join the same cells, as they do across a ring of two cells."""
        return not any(ring and cells == 2 for ring, cells in zip(self.periodic, self.vertex.shape, strict=True))

    @property
    def dimensions(self) -> int:
        """Number of axes with more than two cells."""
        return sum(cells > 2 for cells in self.vertex.shape)

    def of_rows(self, row: Indices) -> Grid:
        """Return the grid with rows in place of vertices. Shapes: `row` (vertices,)."""
        return Grid(np.append(row, np.int32(-1))[self.vertex], self.periodic)


@dataclass(frozen=True, eq=False)
class Rails:
    """The two supply voltages of a circuit with two rails.

    `high, low`: voltages in volts; for a map of cells ``high`` is the obstacle rail (or the driven start); `size`:
    number of rows; `row, conductance, at_high` (ties,): the row of each tie to a rail, its conductance in siemens, and
    whether the rail is the high one. A row may have several ties.
    """

    high: float
    low: float
    size: int
    row: Indices
    conductance: Floats
    at_high: NDArray[np.bool_]

    @property
    def to_high(self) -> Floats:
        """Conductance from every row to the high rail, in siemens, shape (n,); a new array."""
        return self._summed(self.at_high)

    @property
    def to_low(self) -> Floats:
        """Conductance from every row to the low rail, in siemens, shape (n,); a new array."""
        return self._summed(~self.at_high)

    def _summed(self, some: NDArray[np.bool_]) -> Floats:
        """Sum the conductances of some ties by row, shape (n,)."""
        return np.asarray(np.bincount(self.row[some], self.conductance[some], self.size), dtype=np.float64)


@dataclass(frozen=True)
class ConductanceStatistics:
    """Statistics of the conductances between rows.

    `entries`: number of off-diagonal entries, twice the number of conductances; `weak`: fraction of conductances that
    are weak relative to the strongest one at either end; `mean`: mean conductance, in siemens, 0 without any;
    `decades`: ratio of the largest to the smallest one, in orders of magnitude; `smallest, largest`: range of all
    conductances, including those to rails, in siemens.
    """

    entries: int
    weak: float
    mean: float
    decades: float
    smallest: float
    largest: float


@dataclass(frozen=True, eq=False)
class Laplacian:
    """``(A x)_i = sum_j g_ij (x_i - x_j) + g_i x_i``: edge and ground conductances, never a summed diagonal.

    A symmetric positive definite M-matrix if every connected component has a row of positive ground conductance.

    `ground` (n,): conductance from every row to nodes of known voltage, in siemens; `listed, compressed`: its edges as
    a list, as rows, or both (`with_rows`); `grid`: positions of the vertices of the list (without a list, of the rows)
    if they form a grid; `dimensions`: dimensions of its grid; 2 for other graphs; `rails`: how `ground` divides between
    two rails, if there are exactly two and no other drive.
    """

    ground: Floats
    listed: EdgeList | None = None
    compressed: Rows | None = None
    grid: Grid | None = None
    dimensions: int = 2
    rails: Rails | None = None

    @property
    def size(self) -> int:
        """Number of rows."""
        return len(self.ground)

    def as_rows(self) -> Rows:
        """Return the edges as compressed rows."""
        return self.compressed or _compress(self.listed, self.size)

    def with_rows(self) -> Laplacian:
        """Return a copy with cached compressed rows."""
        return self if self.compressed else replace(self, compressed=self.as_rows())

    @property
    def edges(self) -> sparse.csr_array:
        """The conductances ``g_ij``, in siemens, shape (n, n); symmetric, positive, sorted, no diagonal."""
        return self.as_rows().array

    @property
    def graph(self) -> Graph:
        """The whole matrix as argument of kernels."""
        return Graph(*self.as_rows(), self.ground)

    @property
    def diagonal(self) -> Floats:
        """Diagonal of the matrix, in siemens, shape (n,): the sum of all conductances at each row."""
        return np.asarray(self.edges.sum(axis=1) + self.ground, dtype=np.float64)

    @property
    def matrix(self) -> sparse.csr_array:
        """The whole matrix, in siemens, shape (n, n): for factorizations with rounded pivots only."""
        from scipy import sparse

        return sparse.csr_array(sparse.diags_array(self.diagonal, format="csr") - self.edges)

    @property
    def branches(self) -> tuple[sparse.csr_array, Floats]:
        """The edges as ``B^T diag(value) B``, each one once.

        Returns the incidence matrix (m, n) and `value` (m,), in siemens.
        """
        from scipy import sparse

        pairs, value, _ = self.as_rows().listed
        m = len(value)
        starts, sign = np.arange(0, 2 * m + 1, 2, dtype=np.int32), np.tile([1.0, -1.0], m)
        return sparse.csr_array((sign, pairs.ravel(), starts), shape=(m, self.size)), value

    @property
    def elements(self) -> tuple[sparse.csr_array, Floats]:
        """The `branches`, followed by the conductances from rows to nodes of known voltage: the whole matrix.

        Returns the incidence matrix (m, n) and the conductances (m,), in siemens.
        """
        from scipy import sparse

        (incidence, value), tied = self.branches, self.ground > 0
        ties = sparse.eye_array(self.size, format="csr")[tied]
        return sparse.csr_array(sparse.vstack([incidence, ties])), np.append(value, self.ground[tied])

    def within(self, rows: NDArray[np.bool_]) -> Laplacian:
        """Restrict the matrix to some rows; the others count as nodes of known voltage."""
        from scipy import sparse

        return self.grouped(sparse.csr_array(sparse.eye_array(self.size, format="csr")[rows]))

    def grouped(self, groups: sparse.csr_array) -> Laplacian:
        """Merge groups of rows, `groups` (m, n), into one row each; other rows count as nodes of known voltage."""
        from scipy import sparse

        own = groups @ self.edges
        joined = sparse.coo_array(own @ groups.T)
        apart = joined.row != joined.col
        entries = (joined.data[apart], (joined.row[apart], joined.col[apart]))
        return Laplacian(
            groups @ self.ground + own @ (1.0 - groups.sum(axis=0)),
            compressed=Rows.of(sparse.coo_array(entries, shape=joined.shape).tocsr()),
            dimensions=self.dimensions,
        )


def _compress(listed: EdgeList | None, size: int) -> Rows:
    """Return the CSR arrays of a list of edges; BudgetError for more entries than 32-bit indices can number."""
    from resgrid.solvers.csr_kernels import conductances_by_row

    assert listed is not None
    entries = 2 * len(listed.conductance)
    if entries > MOST_NUMBERED:
        raise BudgetError(
            f"the matrix has up to {entries:,} entries, and its rows are numbered with 32 bits, up to "
            f"{MOST_NUMBERED:,}: choose larger cells, accuracy = 'normwise', or method = 'petsc'"
        )
    return Rows(*conductances_by_row(*listed, size))


def conductance_statistics(laplacian: Laplacian) -> ConductanceStatistics:
    """Compute statistics of the conductances between rows.

    Resistors are counted one by one, unless some are parallel. On a grid only resistors across a ring of two cells are
    parallel, so that no compressed rows are needed.
    """
    from resgrid.solvers.csr_kernels import compare_edges

    grid, strongest = laplacian.grid, np.zeros(laplacian.size)
    found = compare_edges(*(laplacian.listed or laplacian.as_rows().listed), strongest, WEAK)
    if (grid is None or not grid.simple) and 2 * found[0] > len((rows := laplacian.as_rows()).data):
        found = compare_edges(*rows.listed, np.zeros_like(strongest), WEAK)
    inner, smallest, largest, total, weak = found
    present = laplacian.ground[laplacian.ground > 0]
    return ConductanceStatistics(
        entries=2 * inner,
        weak=weak / inner if inner else 0.0,
        mean=total / inner if inner else 0.0,
        decades=math.log10(largest / smallest) if inner else 0.0,
        smallest=float(min(smallest, present.min(initial=np.inf))),
        largest=float(max(largest, present.max(initial=0.0))),
    )
