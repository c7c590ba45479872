"""The one matrix of all solvers: a graph of conductances, and what ties its rows to nodes of known voltage.

Beside it the few numbers that a method is chosen by.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial, wraps
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import BudgetError
from resgrid.solvers.team import ALONE, Team, pieces

if TYPE_CHECKING:
    from scipy import sparse

_Found = TypeVar("_Found")

MOST_NUMBERED = 2**31 - 1
"""Rows, entries of rows, and slots are numbered with 32 bits."""

_MOST_PARTS = 8
"""Of a list of edges, each with neighbours of its own."""

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


Ties = tuple[NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True, eq=False)
class Rails:
    """The two voltages that a circuit with two rails hangs between.

    `high, low`: voltages in volts; ``high`` is the obstacle rail (or the driven start) where there is a map of cells;
    `ties`: returns `to_high` and `to_low`.
    """

    high: float
    low: float
    ties: Callable[[], Ties]

    @cached_property
    def _tied(self) -> Ties:
        return self.ties()

    @property
    def to_high(self) -> NDArray[np.float64]:
        """Conductance from every row to the high rail, in siemens, shape (n,); found when first asked for."""
        return self._tied[0]

    @property
    def to_low(self) -> NDArray[np.float64]:
        """The same for the low rail."""
        return self._tied[1]

    def tied(self, to_high: NDArray[np.float64], to_low: NDArray[np.float64]) -> Rails:
        """Return the same rails, with other ties of the rows to them."""
        return Rails(self.high, self.low, partial(_pair, to_high, to_low))


def _pair(to_high: NDArray[np.float64], to_low: NDArray[np.float64]) -> Ties:
    return to_high, to_low


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


@dataclass(frozen=True, eq=False)
class Laplacian:
    """``(A x)_i = sum_j g_ij (x_i - x_j) + g_i x_i``: edge and ground conductances, never a summed diagonal.

    A symmetric positive definite M-matrix whenever every connected part holds a row of positive ground conductance.

    `ground` (n,): conductance from every row to nodes of known voltage, in siemens; `listed, compressed`: its edges,
    as a list or as rows, whichever there was; `grid`: where the vertices of the list lie (without one, the rows), if
    they are a grid's; `dimensions`: those that the graph fills: of its grid, also of what elimination leaves of one;
    2 for others; `rails`: how `ground` divides between two rails, where there are just two and nothing else drives.
    """

    ground: NDArray[np.float64]
    listed: EdgeList | None = None
    compressed: sparse.csr_array | Rows | None = None
    grid: Grid | None = None
    dimensions: int = 2
    rails: Rails | None = None

    @property
    def size(self) -> int:
        """Number of rows."""
        return len(self.ground)

    @cached_property
    def edges(self) -> sparse.csr_array:
        """The conductances ``g_ij``, in siemens, shape (n, n); symmetric, positive, sorted, no diagonal."""
        return self.sorted_rows.array

    @property
    def rows(self) -> sparse.csr_array:
        """The `edges` with the entries of every row in any order: half of the work, on a general graph."""
        return self.edges if self.any_rows.ordered else self.any_rows.array

    @cached_property
    def sorted_rows(self) -> Rows:
        """The `edges` as rows."""
        from resgrid.solvers.row_kernels import sort_rows

        rows = self.any_rows
        if rows.ordered:
            return rows
        rows = Rows(rows.indptr, rows.indices.copy(), rows.data.copy(), ordered=True)  # others may be reading those
        sort_rows(rows.indptr, rows.indices, rows.data)
        vars(self)["any_rows"] = rows  # one of them is enough
        return rows

    @cached_property
    def any_rows(self) -> Rows:
        """The same with the entries of every row in any order, as `rows` has them."""
        if self.compressed is not None:
            return self.compressed if isinstance(self.compressed, Rows) else Rows.of(self.compressed)
        from resgrid.solvers.row_kernels import conductances_by_row

        assert self.listed is not None
        entries = 2 * len(self.listed.conductance)
        if entries > MOST_NUMBERED:
            raise BudgetError(
                f"the matrix has up to {entries:,} entries, and its rows are numbered with 32 bits, up to "
                f"{MOST_NUMBERED:,}: choose larger cells, accuracy = 'normwise', or method = 'petsc'"
            )
        indptr, place = np.zeros(self.size + 1, dtype=np.int32), np.empty((2, self.size), dtype=np.int32)
        indices, data = np.empty(entries, dtype=np.int32), np.empty(entries)
        ordered = conductances_by_row(*self.listed, indptr, indices, data, place)
        return Rows(indptr, indices[: indptr[-1]], data[: indptr[-1]], ordered)

    @property
    def conductances(self) -> Conductances:
        """The whole matrix as loops take it, every row sorted by column."""
        rows = self.sorted_rows
        indptr, indices = (part.astype(np.int32, copy=False) for part in (rows.indptr, rows.indices))
        return Conductances(indptr, indices, rows.data, self.ground)

    @cached_property
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

    @cached_property
    def elements(self) -> tuple[sparse.csr_array, NDArray[np.float64]]:
        """What the matrix is made of: ``B^T diag(value) B``.  Returns `incidence` (m, n), `value` (m,)."""
        from scipy import sparse

        upper, tied = sparse.triu(self.edges, 1).tocoo(), np.flatnonzero(self.ground)
        m = upper.nnz
        ends = np.append(np.stack([upper.row, upper.col], axis=1).ravel(), tied)
        starts = np.append(np.arange(0, 2 * m + 1, 2), 2 * m + 1 + np.arange(len(tied)))
        sign = np.append(np.tile([1.0, -1.0], m), np.ones(len(tied)))
        incidence = sparse.csr_array((sign, ends, starts), shape=(m + len(tied), self.size))
        return incidence, np.append(upper.data, self.ground[tied])

    @cached_property
    def _branches(self) -> tuple[sparse.csr_array, sparse.csr_array]:
        """From rows to differences across what joins them, every pair once, and from those to what leaves every row."""
        from scipy import sparse

        incidence, value = self.elements
        inner = len(value) - int(np.count_nonzero(self.ground))
        across = incidence[:inner]
        return across, sparse.csr_array(across.T @ sparse.diags_array(value[:inner]))

    def between(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """What leaves every row for other rows, formed from differences: none of it is lost on the way."""
        across, leaving = self._branches
        return np.asarray(leaving @ (across @ x))

    def times(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """The matrix times ``x``, shape (n,)."""
        return self.ground * x + self.between(x)

    def within(self, rows: NDArray[np.bool_]) -> Laplacian:
        """Only some of the rows; the others count as nodes of known voltage."""
        from scipy import sparse

        kept = self.edges[rows]
        ground = self.ground[rows] + kept[:, ~rows].sum(axis=1)
        return Laplacian(ground, compressed=sparse.csr_array(kept[:, rows]), dimensions=self.dimensions)

    def grouped(self, groups: sparse.csr_array) -> Laplacian:
        """Groups of rows as one row each; rows of no group count as nodes of known voltage.

        Shapes: `groups` (n, m).
        """
        from scipy import sparse

        joined = sparse.coo_array(groups.T @ self.edges @ groups)
        apart = joined.row != joined.col
        entries = (joined.data[apart], (joined.row[apart], joined.col[apart]))
        outside = 1.0 - groups.sum(axis=1)
        return Laplacian(
            groups.T @ (self.ground + self.edges @ outside),
            compressed=sparse.coo_array(entries, shape=joined.shape).tocsr(),
            dimensions=self.dimensions,
        )


def once(find: Callable[..., _Found]) -> Callable[..., _Found]:
    """Find something out about a matrix once, and remember it as long as the matrix lives, whoever helped."""
    name = f"{find.__module__}.{find.__qualname__}"

    @wraps(find)
    def remembered(laplacian: Laplacian, *helpers: object) -> _Found:
        memory = vars(laplacian)
        if name not in memory:
            memory[name] = find(laplacian, *helpers)
        found: _Found = memory[name]
        return found

    return remembered


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
