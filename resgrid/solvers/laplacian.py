"""The one matrix of all solvers: a graph of conductances, and what ties its rows to nodes of known voltage.

Beside it the few numbers that a method is chosen by.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import BudgetError
from resgrid.solvers.team import ALONE, Team

if TYPE_CHECKING:
    from scipy import sparse

MOST_NUMBERED = 2**31 - 1
"""Rows, entries of rows, and slots are numbered with 32 bits."""

WEAK = 0.1
"""A conductance is weak below this share of the strongest one at either of its ends."""


class EdgeList(NamedTuple):
    """Edges as a list: edge ``k`` joins the rows ``row[ends[k]]`` by ``conductance[k]``, in siemens.

    `ends` (m, 2): vertices; `conductance` (m,); `row` (vertices,): row of every vertex, -1 where its voltage is known.
    Edges within a row, or with an end at a known voltage, are no entries of the matrix.
    """

    ends: NDArray[np.int32]
    conductance: NDArray[np.float64]
    row: NDArray[np.int32]


class Rows(NamedTuple):
    """Edges as compressed rows, symmetric and without a diagonal; as loops take them; scipy takes long to import.

    `indptr` (n + 1,); `indices, data` (entries,): columns, and conductances in siemens; `ordered`: whether every row is
    sorted by column.
    """

    indptr: NDArray[np.int32]
    indices: NDArray[np.int32]
    data: NDArray[np.float64]
    ordered: bool

    @classmethod
    def of(cls, array: sparse.csr_array) -> Rows:
        """The rows of an array, in the same memory."""
        return cls(array.indptr, array.indices, array.data, bool(array.has_sorted_indices))

    @property
    def array(self) -> sparse.csr_array:
        """The same as an array (n, n), in the same memory."""
        from scipy import sparse

        size = len(self.indptr) - 1
        array = sparse.csr_array((self.data, self.indices, self.indptr), shape=(size, size))
        if self.ordered:
            array.has_sorted_indices = array.has_canonical_format = True
        return array

    @property
    def pairs(self) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        """Every pair of rows once, (m, 2), the lower one first, and its conductance (m,)."""
        row = np.repeat(np.arange(len(self.indptr) - 1, dtype=np.int32), np.diff(self.indptr))
        upper = self.indices > row
        return np.stack([row[upper], self.indices[upper]], axis=1), self.data[upper]


class Conductances(NamedTuple):
    """A matrix as loops take it, in siemens: `indptr` (n + 1,), `indices, edges` (entries,), `ground` (n,)."""

    indptr: NDArray[np.int32]
    indices: NDArray[np.int32]
    edges: NDArray[np.float64]
    ground: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Grid:
    """Where the vertices of a grid lie: `vertex`, of the grid's shape, -1 for none; `periodic`: axes that are rings."""

    vertex: NDArray[np.int32]
    periodic: tuple[bool, ...]

    @property
    def simple(self) -> bool:
        """Whether no two edges join the same cells: only the two across a ring of two cells do."""
        return not any(ring and cells == 2 for ring, cells in zip(self.periodic, self.vertex.shape, strict=True))

    @property
    def dimensions(self) -> int:
        """Axes along which there are more than two cells."""
        return sum(cells > 2 for cells in self.vertex.shape)

    def of_rows(self, row: NDArray[np.int32]) -> Grid:
        """The same grid with rows for vertices.  Shapes: `row` (vertices,)."""
        rows = np.where(self.vertex >= 0, np.append(row, -1)[self.vertex], -1).astype(np.int32)
        return Grid(rows, self.periodic)


@dataclass(frozen=True, eq=False)
class Rails:
    """The two voltages that a circuit with two rails hangs between.

    `high, low`: voltages in volts; ``high`` is the obstacle rail (or the driven start) where there is a map of cells;
    `size`: number of rows; `row, conductance, at_high` (ties,): which row hangs on a rail, by how much, in siemens, and
    whether that is the high one; the same row may do so several times.
    """

    high: float
    low: float
    size: int
    row: NDArray[np.int32]
    conductance: NDArray[np.float64]
    at_high: NDArray[np.bool_]

    @property
    def to_high(self) -> NDArray[np.float64]:
        """Conductance from every row to the high rail, in siemens, shape (n,); summed anew."""
        return self._summed(self.at_high)

    @property
    def to_low(self) -> NDArray[np.float64]:
        """The same for the low rail."""
        return self._summed(~self.at_high)

    def _summed(self, some: NDArray[np.bool_]) -> NDArray[np.float64]:
        return np.asarray(np.bincount(self.row[some], self.conductance[some], self.size), dtype=np.float64)


@dataclass(frozen=True)
class Connections:
    """Counts over the conductances between rows.

    `entries`: twice their number: the entries of the `coupling`; `weak`: share of conductances that are weak beside the
    strongest one at either of their ends; `mean`: mean conductance, in siemens; 0 where there is none; `smallest,
    largest`: the range of the conductances, those to rails included, in siemens.
    """

    entries: int
    weak: float
    mean: float
    smallest: float
    largest: float


class Branches(NamedTuple):
    """Products with a matrix that are formed from differences, of which nothing is lost on the way.

    `across` (m, n): from rows to the differences across what joins them, every pair once; `leaving` (n, m): from those
    to what leaves every row; `ground` (n,): in siemens.
    """

    across: sparse.csr_array
    leaving: sparse.csc_array
    ground: NDArray[np.float64]

    def between(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """What leaves every row for other rows, shape (n,)."""
        return np.asarray(self.leaving @ (self.across @ x))

    def times(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """The matrix times ``x``, shape (n,)."""
        return self.ground * x + self.between(x)


@dataclass(frozen=True, eq=False)
class Laplacian:
    """``(A x)_i = sum_j g_ij (x_i - x_j) + g_i x_i``: edge and ground conductances, never a summed diagonal.

    A symmetric positive definite M-matrix whenever every connected part holds a row of positive ground conductance.

    `ground` (n,): conductance from every row to nodes of known voltage, in siemens; `listed, compressed`: its edges,
    as a list, as rows, or both (`with_rows`); `grid`: where the vertices of the list lie (without one, the rows), if
    they are a grid's; `dimensions`: those that the graph fills: of its grid; 2 for others; `rails`: how `ground`
    divides between two rails, where there are just two and nothing else drives.
    """

    ground: NDArray[np.float64]
    listed: EdgeList | None = None
    compressed: Rows | None = None
    grid: Grid | None = None
    dimensions: int = 2
    rails: Rails | None = None

    @property
    def size(self) -> int:
        """Number of rows."""
        return len(self.ground)

    def as_rows(self, *, ordered: bool = True) -> Rows:
        """The edges as rows, sorted unless any order does."""
        from resgrid.solvers.row_kernels import transpose

        rows = self.compressed or _compress(self.listed, self.size)
        if rows.ordered or not ordered:
            return rows
        columns, values = np.empty_like(rows.indices), np.empty_like(rows.data)
        transpose(rows.indptr, rows.indices, rows.data, rows.indptr[:-1].copy(), columns, values)
        return Rows(rows.indptr, columns, values, ordered=True)

    def with_rows(self, *, ordered: bool = True) -> Laplacian:
        """The same, with its rows at hand for whoever asks for them more than once."""
        rows = self.as_rows(ordered=ordered)
        return self if rows is self.compressed else replace(self, compressed=rows)

    @property
    def edges(self) -> sparse.csr_array:
        """The conductances ``g_ij``, in siemens, shape (n, n); symmetric, positive, sorted, no diagonal."""
        return self.as_rows().array

    @property
    def rows(self) -> sparse.csr_array:
        """The `edges` with the entries of every row in any order."""
        return self.as_rows(ordered=False).array

    @property
    def conductances(self) -> Conductances:
        """The whole matrix as loops take it, every row sorted by column."""
        rows = self.as_rows()
        indptr, indices = (part.astype(np.int32, copy=False) for part in (rows.indptr, rows.indices))
        return Conductances(indptr, indices, rows.data, self.ground)

    @property
    def diagonal(self) -> NDArray[np.float64]:
        """Diagonal of the matrix, in siemens, shape (n,): all conductances at a row, summed."""
        if self.listed is None:
            return np.asarray(self.edges.sum(axis=1) + self.ground, dtype=np.float64)
        from resgrid.solvers.row_kernels import add_conductances

        diagonal = self.ground.copy()
        add_conductances(*self.listed, diagonal)
        return diagonal

    @property
    def matrix(self) -> sparse.csr_array:
        """The whole matrix, in siemens, shape (n, n): for factors, whose pivots are differences anyway."""
        from scipy import sparse

        return sparse.csr_array(sparse.diags_array(self.diagonal, format="csr") - self.edges)

    @property
    def elements(self) -> tuple[sparse.csr_array, NDArray[np.float64]]:
        """What the matrix is made of: ``B^T diag(value) B``.  Returns `incidence` (m, n), `value` (m,)."""
        from scipy import sparse

        (pairs, value), tied = self.as_rows().pairs, np.flatnonzero(self.ground)
        m = len(value)
        ends = np.append(pairs.ravel(), tied)
        starts = np.append(np.arange(0, 2 * m + 1, 2), 2 * m + 1 + np.arange(len(tied)))
        sign = np.append(np.tile([1.0, -1.0], m), np.ones(len(tied)))
        incidence = sparse.csr_array((sign, ends, starts), shape=(m + len(tied), self.size))
        return incidence, np.append(value, self.ground[tied])

    @property
    def branches(self) -> Branches:
        """What joins the rows to each other, every pair once, for products formed from differences."""
        from scipy import sparse

        pairs, value = self.as_rows().pairs
        m, ends = len(value), pairs.ravel()
        starts, sign = np.arange(0, 2 * m + 1, 2, dtype=np.int32), np.tile([1.0, -1.0], m)
        across = sparse.csr_array((sign, ends, starts), shape=(m, self.size))
        leaving = sparse.csc_array((sign * np.repeat(value, 2), ends, starts), shape=(self.size, m))
        return Branches(across, leaving, self.ground)

    def within(self, rows: NDArray[np.bool_]) -> Laplacian:
        """Only some of the rows; the others count as nodes of known voltage."""
        kept, number, count = self.edges[np.flatnonzero(rows)], np.cumsum(rows, dtype=np.int32) - 1, int(rows.sum())
        row, inside = np.repeat(np.arange(count, dtype=np.int32), np.diff(kept.indptr)), rows[kept.indices]
        ground = self.ground[rows] + np.bincount(row[~inside], kept.data[~inside], count)
        indptr = np.append(0, np.cumsum(np.bincount(row[inside], minlength=count))).astype(np.int32)
        compressed = Rows(indptr, number[kept.indices[inside]], kept.data[inside], ordered=True)
        return Laplacian(ground, compressed=compressed, dimensions=self.dimensions)

    def grouped(self, groups: sparse.csr_array) -> Laplacian:
        """Groups of rows as one row each; rows of no group count as nodes of known voltage.

        Shapes: `groups` (n, m).
        """
        from scipy import sparse

        edges = self.edges
        joined = sparse.coo_array(groups.T @ edges @ groups)
        apart = joined.row != joined.col
        entries = (joined.data[apart], (joined.row[apart], joined.col[apart]))
        outside = 1.0 - groups.sum(axis=1)
        return Laplacian(
            groups.T @ (self.ground + edges @ outside),
            compressed=Rows.of(sparse.coo_array(entries, shape=joined.shape).tocsr()),
            dimensions=self.dimensions,
        )


def _compress(listed: EdgeList | None, size: int) -> Rows:
    """Rows of a list of edges, their entries in any order."""
    from resgrid.solvers.row_kernels import conductances_by_row

    assert listed is not None
    entries = 2 * len(listed.conductance)
    if entries > MOST_NUMBERED:
        raise BudgetError(
            f"the matrix has up to {entries:,} entries, and its rows are numbered with 32 bits, up to "
            f"{MOST_NUMBERED:,}: choose larger cells, accuracy = 'normwise', or method = 'petsc'"
        )
    indptr, place = np.zeros(size + 1, dtype=np.int32), np.empty((2, size), dtype=np.int32)
    indices, data = np.empty(entries, dtype=np.int32), np.empty(entries)
    ordered = conductances_by_row(*listed, indptr, indices, data, place)
    indices, data = indices[: indptr[-1]], data[: indptr[-1]]
    if len(data) < entries // 2:  # scipy would copy them whenever an array is made of these rows
        indices, data = indices.copy(), data.copy()
    return Rows(indptr, indices, data, ordered)


def count_connections(laplacian: Laplacian, team: Team = ALONE) -> Connections:
    """Count and compare the conductances between rows.

    On a grid the resistors are counted one by one, so that no compressed rows are needed; there only the two across
    a ring of two cells are parallel.
    """
    from resgrid.solvers.row_kernels import weak_entries, weak_pairs

    edges, grid, n = laplacian.listed, laplacian.grid, laplacian.size
    if edges is None or grid is None or not grid.simple:
        indptr, indices, data, _ = laplacian.as_rows(ordered=False)
        inner, total = len(data) // 2, data.sum() / 2
        smallest, largest = data.min(initial=np.inf), data.max(initial=0.0)
        weak = weak_entries(indptr, indices, data, WEAK) // 2 if smallest < WEAK * largest else 0
    else:
        inner, smallest, largest, total = _count_edges(edges, team)
        weak = weak_pairs(*edges, np.zeros(n), WEAK) if smallest < WEAK * largest else 0
    present = laplacian.ground[laplacian.ground > 0]
    return Connections(
        entries=2 * inner,
        weak=weak / inner if inner else 0.0,
        mean=float(total) / inner if inner else 0.0,
        smallest=float(min(smallest, present.min(initial=np.inf))),
        largest=float(max(largest, present.max(initial=0.0))),
    )


def _count_edges(listed: EdgeList, team: Team) -> tuple[int, float, float, float]:
    """Conductances between rows: how many, the smallest, the largest, and their sum."""
    from resgrid.solvers.row_kernels import count_edges

    ends, conductance, row = listed
    found = team.over(len(conductance), lambda some: count_edges(ends[some], conductance[some], row))
    inner, smallest, largest, total = zip(*found or [(0, np.inf, 0.0, 0.0)], strict=True)
    return sum(inner), min(smallest), max(largest), sum(total)
