"""The type `Laplacian`, the matrix of all solvers: conductances between rows, and to nodes of known voltage.

The module also contains the types of its parts (edges, compressed rows, grid, rails), and computes the statistics of
the conductances from which a solution method is chosen.
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
"""Largest number of rows or matrix entries that 32-bit indices can number; beyond it BudgetError is raised."""

VOLUME = 4.2
"""Mean number of neighbours of a row above which a matrix counts as a volume.

A corridor is then taken to have two dimensions across, instead of one.
"""

WEAK = 0.1
"""A conductance is weak if it is below this fraction of the strongest of all conductances at its two ends."""

_STIFF = 1e-9
"""Ratio of the smallest to the largest conductance of a matrix below which the matrix is stiff.

Errors of large currents may then exceed small currents.
"""


class EdgeList(NamedTuple):
    """List of edges between vertices: edge ``k`` joins the rows ``row[ends[k]]`` of the matrix.

    `ends` (m, 2): vertices at both ends of every edge; `conductance` (m,): in siemens; `row` (vertices,): row of every
    vertex, -1 where the voltage is known. Edges with both ends in one row, or with an end at a known voltage, are not
    entries of the matrix.
    """

    ends: Indices
    conductance: Floats
    row: Indices


class Rows(NamedTuple):
    """Compressed rows (CSR) of the symmetric conductances between rows, without a diagonal, as arguments of kernels.

    `indptr` (n + 1,): begin of every row; `indices, data` (entries,): columns, sorted in every row, and conductances in
    siemens. Only the property `array` imports scipy.
    """

    indptr: Indices
    indices: Indices
    data: Floats

    @classmethod
    def of(cls, array: sparse.csr_array) -> Rows:
        """Return the arrays of a symmetric CSR array (n, n) as `Rows`; columns of `array` are sorted in place."""
        array.sort_indices()
        return cls(array.indptr.astype(np.int32, copy=False), array.indices.astype(np.int32, copy=False), array.data)

    @property
    def array(self) -> sparse.csr_array:
        """View of the rows as a scipy CSR array (n, n)."""
        from scipy import sparse

        size = len(self.indptr) - 1
        array = sparse.csr_array((self.data, self.indices, self.indptr), shape=(size, size))
        array.has_sorted_indices = array.has_canonical_format = True
        return array

    @property
    def listed(self) -> EdgeList:
        """The conductances as a list of edges, each edge once, with its lower row first; vertices are rows."""
        each = np.arange(len(self.indptr) - 1, dtype=np.int32)
        row = np.repeat(each, np.diff(self.indptr))
        upper = self.indices > row
        return EdgeList(np.stack([row[upper], self.indices[upper]], axis=1), self.data[upper], each)


class Graph(NamedTuple):
    """A graph as argument of kernels: conductances in compressed rows, and leaks to nodes of known voltage.

    `indptr` (n + 1,): begin of every row; `indices, conductance` (entries,): columns, in any order within a row, and
    conductances; `leak` (n,): conductance of every row to nodes of known voltage. Conductances are in siemens, or
    divided by a unit in siemens.
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
    """Positions of the vertices of a graph in a grid, and the periodic axes of the grid.

    `vertex`, of the grid's shape: index of the vertex in every cell, -1 for none; `periodic` (ndim,): whether the last
    cell of each axis is a neighbour of the first.
    """

    vertex: Indices
    periodic: tuple[bool, ...]

    @property
    def simple(self) -> bool:
        """Whether no two edges join the same two cells; two edges do so along a periodic axis of two cells."""
        return not any(ring and cells == 2 for ring, cells in zip(self.periodic, self.vertex.shape, strict=True))

    @property
    def dimensions(self) -> int:
        """Number of axes with more than two cells."""
        return sum(cells > 2 for cells in self.vertex.shape)

    def of_rows(self, row: Indices) -> Grid:
        """Return the grid with rows instead of vertices in `vertex`, -1 in cells without a row.

        `row` (vertices,): row of every vertex, -1 where the voltage is known.
        """
        return Grid(np.append(row, np.int32(-1))[self.vertex], self.periodic)


@dataclass(frozen=True, eq=False)
class Rails:
    """The two supply voltages of a circuit with two rails, and the conductances to the rails (ties).

    `high, low`: voltages of the rails, in volts; obstacles (or the driven start cell) are at `high`, goals at `low`;
    `size`: number of rows of the matrix; `row, conductance, at_high` (ties,): the row of each tie, its conductance in
    siemens, and whether the tie leads to the high rail. A row may have several ties; `leak`: conductance, in siemens,
    of the leak, a tie to the high rail that every row has; 0 if some rows have no leak. Leaks are listed among the
    ties.
    """

    high: float
    low: float
    size: int
    row: Indices
    conductance: Floats
    at_high: NDArray[np.bool_]
    leak: float = 0.0

    @property
    def to_high(self) -> Floats:
        """Conductance from every row to the high rail, `leak` included, in siemens, shape (n,); a new array."""
        return self._summed(self.at_high)

    @property
    def to_low(self) -> Floats:
        """Conductance from every row to the low rail, in siemens, shape (n,); a new array."""
        return self._summed(~self.at_high)

    def _summed(self, some: NDArray[np.bool_]) -> Floats:
        """Return the conductance (n,) of selected ties of every row, in siemens; `some` (ties,): mask of these ties."""
        return np.asarray(np.bincount(self.row[some], self.conductance[some], self.size), dtype=np.float64)


@dataclass(frozen=True)
class ConductanceStatistics:
    """Statistics of the conductances between rows of a matrix.

    `entries`: number of off-diagonal entries, twice the number of conductances; `weak`: fraction of conductances that
    are below a tenth (`WEAK`) of the strongest conductance at their two ends; `mean`: mean conductance in siemens, 0
    without conductances; `decades`: decimal logarithm of the ratio of the largest to the smallest conductance between
    rows, 0 without conductances; `smallest, largest`: range of all conductances, those to nodes of known voltage
    included, in siemens.
    """

    entries: int
    weak: float
    mean: float
    decades: float
    smallest: float
    largest: float

    @property
    def is_stiff(self) -> bool:
        """Whether errors of currents in large conductances may exceed currents in small ones.

        This is assumed if the smallest conductance is below 1e-9 times the largest.
        """
        return self.smallest < _STIFF * self.largest


@dataclass(frozen=True, eq=False)
class Laplacian:
    """The matrix ``(A x)_i = sum_j g_ij (x_i - x_j) + g_i x_i`` of edge conductances and ground conductances.

    The diagonal is never stored as a sum. ``A`` is a symmetric positive definite M-matrix if every connected component
    has a row with a positive ground conductance.

    `ground` (n,): conductance ``g_i`` from every row to nodes of known voltage, in siemens; `listed, compressed`: the
    edges ``g_ij`` as a list, as compressed rows, or both; None for an absent form. Edges of `listed` join vertices, the
    nodes of a circuit; a vertex of known voltage has no row, and several vertices may share a row. `grid`: position in
    a grid of every vertex of `listed`, or of every row if `listed` is None; None for other graphs; `dimensions`: number
    of dimensions of the grid, 2 for other graphs; `rails`: the two supply voltages, and the single conductances from
    rows to each of them, whose sums are `ground`; None unless there are exactly two rails and no current sources.
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
        """Return the edges as compressed rows (CSR); raise BudgetError if 32-bit indices cannot number the entries."""
        return self.compressed or _compress(self.listed, self.size)

    def with_rows(self) -> Laplacian:
        """Return a copy with cached compressed rows, or the matrix itself if they are cached already."""
        return self if self.compressed else replace(self, compressed=self.as_rows())

    @property
    def edges(self) -> sparse.csr_array:
        """The conductances ``g_ij`` between rows, in siemens, as a symmetric sorted CSR array (n, n); no diagonal."""
        return self.as_rows().array

    @property
    def graph(self) -> Graph:
        """Conductances between rows and to nodes of known voltage as a `Graph`, for kernels, in siemens."""
        return Graph(*self.as_rows(), self.ground)

    @property
    def diagonal(self) -> Floats:
        """Diagonal of the matrix, in siemens, shape (n,): the sum of all conductances at each row."""
        return np.asarray(self.edges.sum(axis=1) + self.ground, dtype=np.float64)

    @property
    def matrix(self) -> sparse.csr_array:
        """The matrix as a CSR array with rounded diagonal, in siemens, shape (n, n).

        It is meant for factorizations with subtractions; the other methods never form the diagonal.
        """
        from scipy import sparse

        return sparse.csr_array(sparse.diags_array(self.diagonal, format="csr") - self.edges)

    @property
    def branches(self) -> tuple[sparse.csr_array, Floats]:
        """The edges as ``B^T diag(value) B``, each edge once: incidence matrix ``B`` and conductances ``value``.

        ``B`` has shape (m, n), with 1 and -1 at the two rows of every edge; ``value`` (m,) is in siemens.
        """
        from scipy import sparse

        pairs, value, _ = self.as_rows().listed
        m = len(value)
        starts, sign = np.arange(0, 2 * m + 1, 2, dtype=np.int32), np.tile([1.0, -1.0], m)
        return sparse.csr_array((sign, pairs.ravel(), starts), shape=(m, self.size)), value

    @property
    def elements(self) -> tuple[sparse.csr_array, Floats]:
        """The incidence matrix (m, n) and the conductances (m,), in siemens, of the whole matrix.

        The `branches` between rows are followed by the conductances from rows to nodes of known voltage, whose
        incidence has a single entry 1.
        """
        from scipy import sparse

        (incidence, value), tied = self.branches, self.ground > 0
        ties = sparse.eye_array(self.size, format="csr")[tied]
        return sparse.csr_array(sparse.vstack([incidence, ties])), np.append(value, self.ground[tied])

    def within(self, rows: NDArray[np.bool_]) -> Laplacian:
        """Return the matrix of the rows in the mask `rows` (n,); the other rows count as nodes of known voltage.

        The result has compressed rows, but no grid and no rails.
        """
        from scipy import sparse

        return self.grouped(sparse.csr_array(sparse.eye_array(self.size, format="csr")[rows]))

    def grouped(self, groups: sparse.csr_array) -> Laplacian:
        """Return the matrix after groups of rows are merged into one row each, without grid and rails.

        `groups` (m, n): entry 1 for every row of each of the m groups; groups are disjoint. Rows outside all groups
        count as nodes of known voltage.
        """
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
    """Return the compressed rows of a list of edges; raise BudgetError for more entries than 32-bit indices can number.

    `listed`: the edges, never None; `size`: number of rows.
    """
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
    """Return statistics of the conductances of a matrix: number, fraction of weak ones, mean and range.

    Only `smallest` and `largest` include the conductances to nodes of known voltage. Resistors are counted one by one,
    unless some are parallel; parallel ones are summed. On a grid only resistors along a periodic axis of two cells are
    parallel, so that other grids need no compressed rows.
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
