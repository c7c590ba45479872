"""The equations of a grid laid out by colour: the level that grids and graphs are made from, and its kernels."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from math import prod

import numpy as np
from numpy.typing import NDArray

from resgrid.jit import inner, inner_fast, kernel
from resgrid.solvers.laplacian import MOST_NUMBERED
from resgrid.solvers.multigrid.graphs import Graph
from resgrid.solvers.multigrid.krylov import scatter_rows
from resgrid.solvers.multigrid.red_black import (
    Edges,
    Floats,
    Indices,
    Integers,
    Lattice,
    Reals,
    Stencil,
    slot_of,
    spread,
)
from resgrid.solvers.team import ALONE, Team, pieces

_TINY = 1e-300
"""Keeps what is nothing in all from being divided by."""

BLOCK = 2048
"""Slots a pass takes at a time: what it touches stays in the first caches."""

WEAK = 0.1
"""Share of a conductance below which another one is weak beside it."""


@dataclass(frozen=True, eq=False)
class Level:
    """A grid by colour, with what ties it to the rails.

    `leak` (2, slots): conductance to the rails, of red and of black slots; `degree` (2, slots): all conductances at a
    slot, summed; `mean` (ndim,): mean conductance along every axis, 0 where there is none; `uneven`: whether some
    conductances are weak beside others; `extra_cell`: flat index of the cell of every extra node, red and black;
    `size`: number of nodes.
    """

    lattice: Lattice
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
    node: NDArray[np.int32],
    excess: NDArray[np.float64],
    unit: float,
    team: Team = ALONE,
) -> tuple[Level, NDArray[np.int32]] | None:
    """Colour a grid and bring the conductances of its faces in order.

    Shapes: `pairs` (m, 2), `conductance` (m,), `row` (nodes,), `node` as the grid, `excess` (n,); returns `slot`
    (n,).  None where it has no two colours, or more slots than can be numbered.
    """
    if node.ndim < 2:
        return None
    lattice = Lattice(node.shape)
    if 2 * lattice.slots > MOST_NUMBERED:
        return None
    slot = np.full(len(excess), -1, dtype=np.int32)
    at_node = np.full(len(row), -1, dtype=np.int32)
    cells = slot_cells(node.ravel(), row, lattice.rows, lattice.margin, lattice.slots, slot, at_node)
    if cells != len(excess):
        return None
    filled = _filled(pairs, conductance, at_node, lattice, unit, team)
    if filled is None:
        return None
    faces, rings = filled
    leak = np.zeros((2, lattice.slots))
    team.over(len(slot), lambda some: scatter_rows(slot[some], excess[some], 1.0 / unit, leak.ravel()))
    off = _rings(at_node[pairs[rings]], conductance[rings] / unit, lattice)
    empty = np.empty(0, dtype=np.int64)
    return level_of(lattice, Edges(faces, lattice.distance, lattice.margin, *off), leak, (empty, empty), team), slot


def _filled(
    pairs: NDArray[np.int32],
    conductance: NDArray[np.float64],
    at_node: NDArray[np.int32],
    lattice: Lattice,
    unit: float,
    team: Team,
) -> tuple[NDArray[np.float64], NDArray[np.int64]] | None:
    """Conductances of faces, shape (2 ndim, slots), and the resistors that cross none; None if there are too many.

    Threads would lose some where resistors are parallel, which leaves fewer faces that conduct than were filled: one
    thread fills them all then.
    """
    faces = np.zeros((2 * len(lattice.shape), lattice.slots))
    if not len(pairs):
        return faces, np.empty(0, dtype=np.int64)
    room = sum(prod(lattice.shape) // size for size in lattice.shape)

    def fill(some: slice) -> tuple[int, NDArray[np.int64] | None]:
        rings = np.empty(min(room, some.stop - some.start), dtype=np.int64)
        count = fill_faces(pairs[some], conductance[some], at_node, lattice.distance, 1.0 / unit, faces, rings)
        return count[1], None if count[0] < 0 else rings[: count[0]] + some.start

    counts, rings = zip(*team.over(len(pairs), fill), strict=True)
    if team.size > 1 and sum(counts) != sum(team.together([partial(np.count_nonzero, face) for face in faces])):
        return _filled(pairs, conductance, at_node, lattice, unit, ALONE)
    met = [some for some in rings if some is not None]
    if len(met) < len(rings) or sum(len(some) for some in met) > room:
        return None
    return faces, np.concatenate(met)


def _rings(
    slot: NDArray[np.int32], conductance: NDArray[np.float64], lattice: Lattice
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32], NDArray[np.float64]]:
    """Red and black slots, axes and conductances of the resistors that close periodic axes, from pairs of slots."""
    red, black = np.sort(slot, axis=1).T - np.array([[0], [lattice.slots]], dtype=np.int32)
    cells = (np.stack(lattice.cells_at(colour, ends)) for colour, ends in enumerate((red, black)))
    axis = np.argmax(np.not_equal(*cells), axis=0).astype(np.int32)
    order = np.lexsort((black, red))
    return red[order], black[order], axis[order], conductance[order]


def level_of(
    lattice: Lattice,
    edges: Edges,
    leak: NDArray[np.float64],
    extra_cell: tuple[NDArray[np.int64], NDArray[np.int64]],
    team: Team = ALONE,
) -> Level:
    """A level with its degrees summed."""
    degree = np.empty_like(leak)

    def summed(some: slice) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        total, extremes = np.zeros((2, len(lattice.shape))), np.array([np.inf, 0.0])
        sum_degrees(edges.faces, edges.distance, leak, some.start, some.stop, degree, total, extremes)
        return total, extremes

    inside = pieces(edges.margin, lattice.slots - edges.margin)
    totals, extremes = zip(*team.together([partial(summed, some) for some in inside]), strict=True)
    for outside in (slice(0, edges.margin), slice(lattice.slots - edges.margin, None)):
        degree[:, outside] = leak[:, outside]
    for colour, slot in enumerate((edges.off_red, edges.off_black)):
        np.add.at(degree[colour], slot, edges.couplings)
    total, least, greatest = sum(totals), min(e[0] for e in extremes), max(e[1] for e in extremes)
    mean, uneven = total[0] / np.maximum(total[1], 1.0), bool(least < WEAK * greatest)
    return Level(lattice, edges, leak, degree, mean, uneven, extra_cell, int(np.count_nonzero(degree)))


def in_double(level: Level) -> Stencil:
    """A level for the compiled passes, in double precision; takes over its degrees, and inverts the red ones."""
    red, black = level.degree
    invert(red, red)
    return stencil_of(level, level.edges.faces, level.edges.couplings, red, np.empty(0), black)


def in_single(level: Level) -> Stencil:
    """A level for the compiled passes, in single precision, without its black diagonal; see `compensated`."""
    single = np.float32
    inverse = np.empty(level.degree.shape, dtype=single)
    for degree, of_colour in zip(level.degree, inverse, strict=True):
        invert(degree, of_colour)
    faces, couplings = level.edges.faces.astype(single), level.edges.couplings.astype(single)
    return stencil_of(level, faces, couplings, inverse[0], inverse[1], np.empty(0, dtype=single))


def stencil_of(
    level: Level, faces: Reals, couplings: Reals, red_inverse: Reals, black_inverse: Reals, black_degree: Reals
) -> Stencil:
    """A level for the compiled passes."""
    edges = level.edges
    return Stencil(
        faces=faces,
        distance=edges.distance,
        margin=edges.margin,
        first_extra=level.lattice.first_extra,
        block=min(BLOCK, level.lattice.slots),
        off_red=edges.off_red,
        off_black=edges.off_black,
        couplings=couplings,
        red_inverse=red_inverse,
        black_inverse=black_inverse,
        black_degree=black_degree,
    )


def compensated(level: Level, single: Stencil) -> NDArray[np.float64]:
    """The black diagonal of a level in single precision that makes up for all rounding, shape (slots,).

    Products are right to a few roundings of every conductance then, however smooth the vector.
    """
    degree = np.empty(level.lattice.slots)
    compensate(single, level.leak, degree, np.zeros(level.lattice.slots))
    return degree


def to_graph(level: Level) -> tuple[Graph, NDArray[np.int32]]:
    """A level as a graph of conductances, red nodes first.  Returns `number` (2 slots,)."""
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
def slot_cells(
    node: Indices, row_of_node: Indices, rows: Integers, margin: int, slots: int, slot: Indices, at_node: Indices
) -> int:
    """Slot of every unknown, and that of every node; returns how many cells have one.

    ``node`` is the node of every cell in C order, -1 for none; ``rows`` the numbers of the first cells of all rows;
    both slots come -1 and stay so where an unknown has no cell.  Returns -1 if one has two.
    """
    count, columns = 0, len(node) // len(rows)
    for line in range(len(rows)):
        for column in range(columns):
            here = node[line * columns + column]
            if here < 0 or row_of_node[here] < 0:
                continue
            i, number = row_of_node[here], rows[line] + column
            if slot[i] >= 0:
                return -1
            slot[i] = at_node[here] = slot_of(number, margin, slots)
            count += 1
    return count


@kernel
def fill_faces(
    pairs: Indices, conductance: Floats, at_node: Indices, distance: Integers, scale: float, faces: Floats,
    couplings: Integers,
) -> tuple[int, int]:  # fmt: skip
    """Add every resistor between two unknowns to its red cell's face, and note those that lead elsewhere as couplings.

    Returns the number of couplings, -1 if a resistor joins two cells of one colour or the couplings are too many; and
    how many resistors were added.

    Resistors come axis by axis: most cross the face of the one before, or the opposite one.
    """
    slots, count, face, filled = faces.shape[1], 0, 0, 0
    for k in range(len(pairs)):
        red, black = at_node[pairs[k, 0]], at_node[pairs[k, 1]]
        if red < 0 or black < 0 or red == black:
            continue
        if red >= slots:
            red, black = black, red
        black -= slots
        if red >= slots or black < 0:
            return -1, filled
        away = black - red
        if away == distance[face ^ 1]:
            face ^= 1
        elif away != distance[face]:
            other = _face_at(distance, away)
            if other < 0:
                if count == len(couplings):
                    return -1, filled
                couplings[count] = k
                count += 1
                continue
            face = other
        faces[face, red] += conductance[k] * scale
        filled += 1
    return count, filled


@inner
def _face_at(distance: Integers, away: int) -> int:
    """The face across which a black cell lies so far from a red one; -1 for none."""
    for q in range(len(distance)):
        if distance[q] == away:
            return q
    return -1


@kernel
def sum_degrees(
    faces: Floats, distance: Integers, leak: Floats, first: int, last: int, degree: Floats, total: Floats,
    extremes: Floats,
) -> None:  # fmt: skip
    """Add the conductances of faces to the leaks of some slots of both colours; ``leak, degree`` of shape (2, slots).

    ``total`` (2, ndim) receives the sums and the numbers of faces that conduct along every axis; ``extremes`` (2,) the
    least and the greatest of their conductances.
    """
    for begin in range(first, last, BLOCK):
        length = min(BLOCK, last - begin)
        for k in range(begin, begin + length):
            degree[0, k], degree[1, k] = leak[0, k], leak[1, k]
        for q in range(len(distance)):
            _add(faces, q, begin, begin, length, degree[0])
            _add(faces, q, begin - distance[q], begin, length, degree[1])
            some, number = _compare(faces[q, begin : begin + length], extremes)
            total[0, q >> 1] += some
            total[1, q >> 1] += number


@kernel
def compensate(stencil: Stencil, leak: Floats, degree: Reals, share: Floats) -> None:
    """Diagonal at black slots that makes up for the rounding of conductances and of the red diagonal's reciprocals.

    ``S = D - G R G^T`` then leaks at every black slot exactly what it would without that rounding: its rows' sums are
    those of the leaks, for red ones in the share ``leak / degree`` of the currents that pass them.

    Shapes: `share` (slots,): room, comes as 0.
    """
    faces, distance, couplings = stencil.faces, stencil.distance, stencil.couplings
    margin, end = stencil.margin, faces.shape[1] - stencil.margin
    for k in range(len(degree)):
        degree[k] = leak[1, k]
    for k in range(len(couplings)):
        share[stencil.off_red[k]] += couplings[k]
    for begin in range(margin, end, BLOCK):
        count = min(BLOCK, end - begin)
        for q in range(len(distance)):
            _add(faces, q, begin, begin, count, share)
        _turn_into_shares(share, leak[0], stencil.red_inverse, begin, count)
        for q in range(len(distance)):
            spread(faces, q, begin, distance[q], count, share, degree)
    for k in range(len(couplings)):
        degree[stencil.off_black[k]] += couplings[k] * share[stencil.off_red[k]]


@inner_fast
def _turn_into_shares(conductance: Floats, leak: Floats, inverse: Reals, begin: int, count: int) -> None:
    """Share of the current towards red cells that comes out of them, and leaks, if all neighbours are at one voltage.

    It is 1 but for the rounding of the reciprocal of a diagonal entry.
    """
    at = np.uint64(begin)
    for i in range(count):
        k = at + np.uint64(i)
        conductance[k] = inverse[k] * conductance[k] + leak[k] / (conductance[k] + leak[k] + _TINY)


@inner_fast
def _add(faces: Reals, q: int, red: int, begin: int, count: int, total: Floats) -> None:
    """Add the conductances across a face of some red slots to as many slots of either colour."""
    face, from_, at = np.uint64(q), np.uint64(red), np.uint64(begin)
    for i in range(count):
        k = np.uint64(i)
        total[at + k] += faces[face, from_ + k]


@inner_fast
def _compare(conductance: Floats, extremes: Floats) -> tuple[float, float]:
    """Sum and number of the conductances that are not 0; widens their least and their greatest.

    What is positive compares as its bits do, in whole numbers, of which several at a time are compared.
    """
    bits, extreme = conductance.view(np.uint64), extremes.view(np.uint64)
    one, least, greatest = np.uint64(1), extreme[0] - np.uint64(1), extreme[1]
    total, count = 0.0, 0.0
    for i in range(len(conductance)):
        total += conductance[i]
        count += conductance[i] > 0.0
        least, greatest = min(least, bits[i] - one), max(greatest, bits[i])  # 0 becomes the largest one
    extreme[0], extreme[1] = least + one, greatest
    return total, count


@kernel
def invert(degree: Floats, inverse: Reals) -> None:
    """Reciprocals; 0 where there is no unknown."""
    for k in range(len(degree)):
        inverse[k] = 1.0 / degree[k] if degree[k] > 0.0 else 0.0
