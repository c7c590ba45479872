"""Equations of a red-black grid, by colour, as the level from which coarser grids and graphs are built.

The *slot* of a node is its index in an array (slots,) over the nodes of its colour; red and black slots both count from
0. The *position* of a node is its index in a flattened array (2, slots), whose row 0 holds red and row 1 black nodes:
it equals the slot of a red node, and the number of slots plus the slot of a black node. Slot 0 is unused.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.jit import inner, inner_fast, kernel
from resgrid.solvers.laplacian import MOST_NUMBERED, Graph
from resgrid.solvers.multigrid.red_black import Edges, RedBlackLayout, Stencil
from resgrid.solvers.scaled import Floats, Indices, Integers, Reals

_TINY = 1e-300
"""Number that is added to a divisor, a sum of conductances divided by ``hierarchy.unit``, to avoid division by zero."""

BLOCK = 2048
"""Number of cells of a colour that a kernel processes at a time, so that their data fit in the first-level cache."""


WEAK = 0.1
"""Fraction of a reference conductance below which a conductance is weak.

Coarsening of a block compares a conductance with the strongest one at its two ends, the choice of axes to coarsen the
mean conductance of an axis with that of the best axis, and `Level.uneven` the weakest with the strongest of a grid.
"""


@dataclass(frozen=True, eq=False)
class Level:
    """A red-black grid, with conductances between cells and to the rails, in units of ``hierarchy.unit`` siemens.

    A slot is the index of a node in the arrays of its colour, from 0 for red and for black nodes. An extra node is a
    connected component of a cell (a block of finer cells) except the first. `lattice`: memory layout; `edges`:
    conductances between cells; `leak` (2, slots): conductance to the rails, of red nodes in row 0 and of black ones in
    row 1; `degree` (2, slots): sum of all conductances at a node, 0 at an unused slot; `mean` (ndim,): mean conductance
    across the faces of every axis, 0 for an axis without conductances; `uneven`: whether the weakest conductance is
    below `WEAK` times the strongest; `extra_cell`: for red and for black extra nodes, the row-major index, in a grid of
    the shape ``lattice.shape``, of the cell to which each belongs; `size`: number of nodes.
    """

    lattice: RedBlackLayout
    edges: Edges
    leak: NDArray[np.float64]
    degree: NDArray[np.float64]
    mean: NDArray[np.float64]
    uneven: bool
    extra_cell: tuple[NDArray[np.int64], NDArray[np.int64]]
    size: int


def lay_out(
    pairs: NDArray[np.int32],
    conductance: NDArray[np.float64],
    row: NDArray[np.int32],
    cells: NDArray[np.int32],
    excess: NDArray[np.float64],
    unit: float,
) -> tuple[Level, NDArray[np.int32]] | None:
    """Return a grid as a `Level`, and the position of every row, shape (n,); None for an unsuitable grid.

    The position of a red cell is its index in an array (slots,) over the red cells; that of a black cell is the number
    of slots plus its index in an array (slots,) over the black cells. The result is None if the grid has fewer than two
    axes, if a resistor joins two cells of one colour, if more resistors cross no face than periodic axes explain, if
    cells and rows do not correspond one to one, or if the grid has more positions than 32-bit indices can number.

    `pairs` (m, 2): vertices at the ends of every resistor; `conductance` (m,): in siemens; `row` (vertices,): row of
    every vertex, negative where the voltage is known; `cells`, of the grid's shape: row of every cell, negative for
    none; `excess` (n,): conductance to known voltages, in siemens; `unit`: conductance in siemens by which all are
    divided.
    """
    if cells.ndim < 2:
        return None
    lattice = RedBlackLayout(cells.shape)
    if 2 * lattice.slots > MOST_NUMBERED:
        return None
    slot = np.full(len(excess), -1, dtype=np.int32)
    if place_rows(cells.reshape(-1, cells.shape[-1]), lattice.lines, lattice.slots, slot) != len(slot):
        return None
    faces, leak = np.zeros((2 * cells.ndim, lattice.slots)), np.zeros((2, lattice.slots))
    rings = np.empty(min(len(pairs), sum(cells.size // length for length in cells.shape)), dtype=np.int64)
    count = fill_faces(pairs, conductance, row, slot, lattice.distance, 1.0 / unit, faces, rings)
    if count < 0:
        return None
    tied = np.flatnonzero(excess)
    leak.ravel()[slot[tied]] = excess[tied] / unit
    off = _ring_couplings(slot[row[pairs[rings[:count]]]], conductance[rings[:count]] / unit, lattice)
    empty = np.empty(0, dtype=np.int64)
    return level_of(lattice, Edges(faces, lattice.distance, lattice.margin, *off), leak, (empty, empty)), slot


def _ring_couplings(
    slot: NDArray[np.int32], conductance: NDArray[np.float64], lattice: RedBlackLayout
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32], NDArray[np.float64]]:
    """Return red slots, black slots, axes and conductances, (m,) each, of the resistors that close periodic axes.

    A slot is the index of a cell in the arrays of its colour, from 0 for both colours. `slot` (m, 2): positions of the
    two cells that every resistor joins, in either order; a position is the slot of a red cell, or ``lattice.slots``
    plus the slot of a black cell; `conductance` (m,): of every resistor, divided by ``hierarchy.unit``; `lattice`:
    memory layout of the grid. The results are sorted by red, then black slot.
    """
    if not len(conductance):
        return *np.empty((3, 0), dtype=np.int32), conductance
    red, black = np.sort(slot, axis=1).T - np.array([[0], [lattice.slots]], dtype=np.int32)
    cells = (np.stack(lattice.cells_at(colour, ends)) for colour, ends in enumerate((red, black)))
    axis = np.argmax(np.not_equal(*cells), axis=0).astype(np.int32)
    order = np.lexsort((black, red))
    return red[order], black[order], axis[order], conductance[order]


def level_of(
    lattice: RedBlackLayout,
    edges: Edges,
    leak: NDArray[np.float64],
    extra_cell: tuple[NDArray[np.int64], NDArray[np.int64]],
) -> Level:
    """Return a `Level` with computed degrees and statistics.

    `lattice, edges`: memory layout, and conductances between cells; `leak` (2, slots): conductance to the rails, of red
    nodes in row 0 and of black ones in row 1; `extra_cell`: for red and for black extra nodes, the row-major index of
    the cell to which each belongs. An extra node is a connected component of a cell (a block of finer cells) except the
    first.
    """
    degree, statistics = leak.copy(), np.full((len(edges.faces), 4), [0.0, 0.0, np.inf, 0.0])
    sum_degrees(edges.faces, edges.distance, edges.margin, degree, statistics)
    for colour, slot in enumerate((edges.off_red, edges.off_black)):
        np.add.at(degree[colour], slot, edges.couplings)
    total, number = statistics[:, :2].reshape(-1, 2, 2).sum(axis=1).T
    uneven = bool(statistics[:, 2].min() < WEAK * statistics[:, 3].max())
    return Level(
        lattice, edges, leak, degree, total / np.maximum(number, 1.0), uneven, extra_cell, int(np.count_nonzero(degree))
    )


def stencil_of(level: Level) -> Stencil:
    """Return the conductances and reciprocal diagonals of a level, as arguments of kernels, in double precision."""
    edges = level.edges
    red, black = (np.empty_like(degree) for degree in level.degree)  # apart, for only one may stay
    for degree, inverse in zip(level.degree, (red, black), strict=True):
        invert(degree, inverse)
    return Stencil(
        faces=edges.faces,
        distance=edges.distance,
        margin=edges.margin,
        first_extra=level.lattice.first_extra,
        block=min(BLOCK, level.lattice.slots),
        off_red=edges.off_red,
        off_black=edges.off_black,
        couplings=edges.couplings,
        red_inverse=red,
        black_inverse=black,
        black_degree=level.degree[1].copy(),
    )


def in_single(stencil: Stencil) -> Stencil:
    """Return a stencil (conductances of a grid) in single precision; its black diagonal stays in double precision."""
    names = ("faces", "couplings", "red_inverse", "black_inverse")
    return stencil._replace(**{name: getattr(stencil, name).astype(np.float32) for name in names})


def compensated(level: Level, single: Stencil) -> NDArray[np.float64]:
    """Return the black diagonal (slots,) that compensates the rounding of conductances and of reciprocals at red cells.

    `level`: the grid in double precision; `single`: its conductances in single precision. All conductances are divided
    by ``hierarchy.unit``.

    Let ``S = D - G^T R G``, with the black diagonal ``D``, conductances ``G`` from black to red cells, and reciprocal
    red diagonal ``R``. With the returned ``D``, the row sums of ``S`` equal the exact leaks (conductances to the
    rails): leaks of black cells, and leaks of red cells multiplied by the fraction ``leak / degree`` of the currents
    through them. Products are therefore accurate to a few rounding errors of every conductance, even for smooth
    vectors.
    """
    fraction, degree = np.zeros(level.lattice.slots), np.array(level.leak[1])
    np.add.at(fraction, single.off_red, single.couplings)
    compensate(single, level.leak[0], fraction, degree)
    np.add.at(degree, single.off_black, single.couplings * fraction[single.off_red])
    return degree


def to_graph(level: Level) -> tuple[Graph, NDArray[np.int32]]:
    """Return a level as a graph of conductances, and the graph node of every position, shape (2 slots,).

    The first ``slots`` positions belong to the red nodes, the others to the black nodes. The graph nodes are the used
    positions, numbered from 0 in the same order; an unused position has -1.
    """
    from scipy import sparse

    lattice, slots = level.lattice, level.lattice.slots
    used = np.flatnonzero(level.degree.ravel())
    number = np.full(2 * slots, -1, dtype=np.int32)
    number[used] = np.arange(len(used), dtype=np.int32)
    edges = level.edges
    red = [np.flatnonzero(face) for face in edges.faces]
    black = [here + d for here, d in zip(red, lattice.distance.tolist(), strict=True)]
    here = number[np.concatenate([*red, edges.off_red])]
    there = number[slots + np.concatenate([*black, edges.off_black])]
    g = np.concatenate([*(face[k] for face, k in zip(edges.faces, red, strict=True)), edges.couplings])
    rows = sparse.csr_array(
        (np.concatenate([g, g]), (np.concatenate([here, there]), np.concatenate([there, here]))),
        shape=(len(used),) * 2,
    )
    rows.sum_duplicates()
    indptr, indices = rows.indptr.astype(np.int32), rows.indices.astype(np.int32)
    return Graph(indptr, indices, rows.data, level.leak.ravel()[used]), number


@kernel
def fill_faces(
    pairs: Indices, conductance: Floats, row: Indices, slot: Indices, distance: Integers, scale: float, faces: Floats,
    couplings: Integers,
) -> int:  # fmt: skip
    """Add every resistor between two unknowns to the face of its red cell; return the number of couplings.

    A coupling is a resistor that crosses no face. The result is -1 if a resistor joins two cells of one colour, or if
    there are more couplings than ``couplings`` holds. Resistors come axis by axis: most cross the same face as the
    previous resistor, or the opposite face.

    `pairs` (m, 2): vertices at the ends of every resistor; `conductance` (m,): in siemens; `row` (vertices,): row of
    every vertex, negative for a known voltage; `slot` (n,): position of every row: the index of a red cell in an array
    (slots,) over the red cells, or the number of slots plus the index of a black cell in an array over the black cells;
    `distance` (faces,): difference between these two array indices, black minus red, of the cells at every face;
    `scale`: 1 divided by ``hierarchy.unit``, in 1/siemens; `faces` (faces, slots): the conductances times ``scale`` are
    added here, in the column of the red cell; `couplings`: receives the index in `pairs` of every coupling.
    """
    slots, count, face = faces.shape[1], 0, 0
    for k in range(len(pairs)):
        here, there = row[pairs[k, 0]], row[pairs[k, 1]]
        if here < 0 or there < 0 or here == there:
            continue
        red, black = slot[here], slot[there]
        if red >= slots:
            red, black = black, red
        black -= slots
        if red >= slots or black < 0:
            return -1
        away = black - red
        if away == distance[face ^ 1]:
            face ^= 1
        elif away != distance[face]:
            other = _face_at(distance, away)
            if other < 0:
                if count == len(couplings):
                    return -1
                couplings[count] = k
                count += 1
                continue
            face = other
        faces[face, red] += conductance[k] * scale
    return count


@inner
def _face_at(distance: Integers, away: int) -> int:
    """Return the index of the face with ``distance[face] == away``; -1 if there is none.

    `distance` (faces,): index of the black cell across every face in an array over the black cells, minus the index of
    the red cell in an array over the red cells.
    """
    for q in range(len(distance)):
        if distance[q] == away:
            return q
    return -1


@kernel
def place_rows(cells: Indices, lines: Integers, slots: int, slot: Indices) -> int:
    """Compute the position of every row of the matrix; return the number of placed rows, or -1 if a row has two cells.

    The position of a red cell is its index in an array over the red cells; that of a black cell is `slots` plus its
    index in an array over the black cells. `cells` (lines, cells per line): row of every cell along the last axis,
    negative for none; `lines` (lines,): number of the first cell of every line (see `RedBlackLayout.lines`); `slots`:
    length of the arrays of one colour; `slot` (n,): receives the positions; all entries are negative on entry, and
    remain so for rows without a cell.
    """
    count = 0
    for line in range(len(lines)):
        for k in range(cells.shape[1]):
            row, number = cells[line, k], lines[line] + k
            if row >= 0:
                if slot[row] >= 0:
                    return -1
                slot[row] = (number >> 1) + (number & 1) * slots
                count += 1
    return count


@kernel
def sum_degrees(faces: Floats, distance: Integers, margin: int, degree: Floats, statistics: Floats) -> None:
    """Add the conductances of faces to ``degree`` (2, slots) at the red and the black cell that each face joins.

    Row 0 of ``degree`` belongs to the red cells, row 1 to the black ones. `faces` (faces, slots): conductance across
    every face of every red cell; `distance` (faces,): column of the black cell across the face in ``degree`` minus that
    of the red cell; `margin`: number of unused columns at either end; `statistics` (faces, 4): updated sum, number,
    minimum and maximum of the positive conductances.
    """
    end = faces.shape[1] - margin
    for begin in range(margin, end, BLOCK):
        count = min(BLOCK, end - begin)
        for q in range(len(distance)):
            add(faces, q, begin, count, degree[0], begin)
            add(faces, q, begin, count, degree[1], begin + distance[q])
            _compare(faces[q, begin : begin + count], statistics[q])


@inner_fast
def _compare(conductance: Floats, statistics: Floats) -> None:
    """Update sum, number, minimum and maximum, ``statistics`` (4,), by the positive entries of ``conductance``.

    Positive doubles are ordered like their bit patterns, which are compared as integers, several at a time.
    """
    bits, extreme, one = conductance.view(np.uint64), statistics.view(np.uint64), np.uint64(1)
    total, count, least, greatest = 0.0, 0.0, extreme[2] - one, extreme[3]
    for i in range(len(conductance)):
        total += conductance[i]
        count += conductance[i] > 0.0
        least, greatest = min(least, bits[i] - one), max(greatest, bits[i])  # 0 becomes the largest one
    statistics[0], statistics[1] = statistics[0] + total, statistics[1] + count
    extreme[2], extreme[3] = least + one, greatest


@inner_fast
def add(faces: Reals, q: int, begin: int, count: int, total: Floats, to: int) -> None:
    """Add ``faces[q, begin:begin + count]`` to ``total[to:to + count]``.

    `faces` (faces, slots): conductances of red cells; `q`: index of the face; `total` (slots,): sums over the cells of
    one colour; `begin, to`: first column of the conductances, and first index of the sums.
    """
    face, at, t_at = np.uint64(q), np.uint64(begin), np.uint64(to)
    for i in range(count):
        k = np.uint64(i)
        total[t_at + k] += faces[face, at + k]


@kernel
def compensate(stencil: Stencil, leak: Floats, fraction: Floats, degree: Floats) -> None:
    """Add the currents through red cells to the black diagonal, without off-stencil couplings (see `compensated`).

    Off-stencil couplings are edges that cross no face of the grid. `stencil`: conductances in single precision; `leak`
    (slots,): conductance of red cells to the rails; `fraction` (slots,): on entry the sum of the off-stencil couplings
    at red cells; on exit the fraction of the current into a red cell that leaves the cell, 1 except for rounding of the
    reciprocal; `degree` (slots,): black diagonal, updated.
    """
    faces, distance, end = stencil.faces, stencil.distance, len(fraction) - stencil.margin
    for begin in range(stencil.margin, end, BLOCK):
        count = min(BLOCK, end - begin)
        for q in range(len(distance)):
            add(faces, q, begin, count, fraction, begin)
        _to_fractions(fraction, leak, stencil.red_inverse, begin, count)
        for q in range(len(distance)):
            _add_weighted(faces, q, begin, count, fraction, degree, begin + distance[q])


@inner_fast
def _to_fractions(conductance: Floats, leak: Floats, inverse: Reals, begin: int, count: int) -> None:
    """Convert conductances at red cells, in place, to the fraction of the current into a cell that leaves the cell.

    The fraction is 1 except for rounding of the reciprocal diagonal. `conductance` (slots,): sum of conductances to
    black cells at a red cell, converted from index ``begin`` to ``begin + count - 1``; `leak` (slots,): conductance to
    the rails; `inverse` (slots,): reciprocal diagonal, in single or double precision.
    """
    at = np.uint64(begin)
    for i in range(count):
        k = at + np.uint64(i)
        conductance[k] = inverse[k] * conductance[k] + leak[k] / (conductance[k] + leak[k] + _TINY)


@inner_fast
def _add_weighted(faces: Reals, q: int, begin: int, count: int, fraction: Floats, total: Floats, to: int) -> None:
    """Add ``faces[q] * fraction`` at the red cells ``begin`` to ``begin + count - 1`` to ``total[to:to + count]``.

    `faces` (faces, slots): conductances of the faces of red cells; `q`: index of the face; `fraction` (slots,): factor
    at red cells; `total` (slots,): sum at black cells; the black cell ``to`` lies across the face of the red cell
    ``begin``.
    """
    face, at, t_at = np.uint64(q), np.uint64(begin), np.uint64(to)
    for i in range(count):
        k = np.uint64(i)
        total[t_at + k] += faces[face, at + k] * fraction[at + k]


@kernel
def invert(degree: Floats, inverse: Floats) -> None:
    """Set ``inverse`` to the reciprocals of the diagonal ``degree``, or to 0 where ``degree`` is 0 (no unknown)."""
    for k in range(len(degree)):
        inverse[k] = 1.0 / degree[k] if degree[k] > 0.0 else 0.0
