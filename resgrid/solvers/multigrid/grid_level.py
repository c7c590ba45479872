"""The equations of a grid laid out by colour: the level that grids and graphs are made from, and its kernels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.jit import inner, kernel
from resgrid.solvers.laplacian import MOST_NUMBERED
from resgrid.solvers.multigrid.graphs import Graph
from resgrid.solvers.multigrid.red_black import (
    Edges,
    Floats,
    Indices,
    Integers,
    Lattice,
    Stencil,
)

_TINY = 1e-300
"""Keeps what is nothing in all from being divided by."""

BLOCK = 2048
"""Slots a pass takes at a time: what it touches stays in the first caches."""

_STRETCH = 2**13
"""The same where passes allocate."""

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
    cells: NDArray[np.int32],
    excess: NDArray[np.float64],
    unit: float,
) -> tuple[Level, NDArray[np.int32]] | None:
    """Colour a grid and bring the conductances of its faces in order.

    Shapes: `pairs` (m, 2), `conductance` (m,), `row` (nodes,), `cells` (rows of cells) as the grid, `excess` (n,);
    returns `slot` (n,).  None where it has no two colours, or more slots than can be numbered.
    """
    if cells.ndim < 2:
        return None
    lattice = Lattice(cells.shape)
    if 2 * lattice.slots > MOST_NUMBERED:
        return None
    rows, slot = lattice.at_slots(cells + 1).ravel(), np.full(len(excess), -1, dtype=np.int32)
    used = np.flatnonzero(rows)
    slot[rows[used] - 1] = used
    if len(used) != len(slot) or slot.min(initial=0) < 0:
        return None
    faces, leak = np.zeros((2 * cells.ndim, lattice.slots)), np.zeros((2, lattice.slots))
    rings = np.empty(min(len(pairs), sum(cells.size // length for length in cells.shape)), dtype=np.int64)
    at_node = np.append(slot, np.int32(-1))[row]
    count = fill_faces(pairs, conductance, at_node, lattice.distance, 1.0 / unit, faces, rings)
    if count < 0:
        return None
    leak.ravel()[slot] = excess / unit
    off = _rings(at_node[pairs[rings[:count]]], conductance[rings[:count]] / unit, lattice)
    empty = np.empty(0, dtype=np.int64)
    return level_of(lattice, Edges(faces, lattice.distance, lattice.margin, *off), leak, (empty, empty)), slot


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
    lattice: Lattice, edges: Edges, leak: NDArray[np.float64], extra_cell: tuple[NDArray[np.int64], NDArray[np.int64]]
) -> Level:
    """A level with its degrees summed."""
    faces, degree = edges.faces, leak.copy()
    for here in _stretches(lattice.slots, edges.margin):
        for face, away in zip(faces[:, here], edges.distance.tolist(), strict=True):
            degree[0, here] += face
            degree[1, here.start + away : here.stop + away] += face
    for colour, slot in enumerate((edges.off_red, edges.off_black)):
        np.add.at(degree[colour], slot, edges.couplings)
    number = np.array([np.count_nonzero(face) for face in faces])
    mean = faces.sum(axis=1).reshape(-1, 2).sum(axis=1) / np.maximum(number.reshape(-1, 2).sum(axis=1), 1)
    uneven = bool(np.count_nonzero(faces < WEAK * faces.max()) > faces.size - number.sum())
    return Level(lattice, edges, leak, degree, mean, uneven, extra_cell, int(np.count_nonzero(degree)))


def _stretches(slots: int, margin: int) -> list[slice]:
    """Slots that are worked on at a time."""
    return [slice(k, min(k + _STRETCH, slots - margin)) for k in range(margin, slots - margin, _STRETCH)]


def stencil_of(level: Level) -> Stencil:
    """A level for the compiled passes, in double precision."""
    edges = level.edges
    red, black = (1.0 / np.where(degree > 0.0, degree, np.inf) for degree in level.degree)
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
    """The same in single precision, but for its black diagonal; see `compensated`."""
    names = ("faces", "couplings", "red_inverse", "black_inverse")
    return stencil._replace(**{name: getattr(stencil, name).astype(np.float32) for name in names})


def compensated(level: Level, single: Stencil) -> NDArray[np.float64]:
    """The black diagonal that makes up for the rounding of conductances and of the red diagonal's reciprocals.

    ``S = D - G R G^T`` then leaks at every black slot exactly what it would without that rounding: its rows' sums are
    those of the leaks, for red ones in the share ``leak / degree`` of the currents that pass them.  Products are right
    to a few roundings of every conductance then, however smooth the vector.  Returns shape (slots,).
    """
    leak, share = level.leak[0], np.zeros(level.lattice.slots)
    degree: NDArray[np.float64] = level.leak[1].copy()
    np.add.at(share, single.off_red, single.couplings)
    for here in _stretches(len(degree), single.margin):
        some, faces = share[here], single.faces[:, here].astype(np.float64)
        for face in faces:
            some += face
        # 1 but for the rounding of the reciprocal: what comes out of red cells, and leaks, of the current towards them.
        some[:] = single.red_inverse[here] * some + leak[here] / (some + leak[here] + _TINY)
        for face, away in zip(faces, single.distance.tolist(), strict=True):
            degree[here.start + away : here.stop + away] += face * some
    np.add.at(degree, single.off_black, single.couplings * share[single.off_red])
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
def fill_faces(
    pairs: Indices, conductance: Floats, at_node: Indices, distance: Integers, scale: float, faces: Floats,
    couplings: Integers,
) -> int:  # fmt: skip
    """Add every resistor between two unknowns to its red cell's face, and note those that lead elsewhere as couplings.

    Returns the number of couplings, -1 if a resistor joins two cells of one colour or the couplings are too many.

    Resistors come axis by axis: most cross the face of the one before, or the opposite one.
    """
    slots, count, face = faces.shape[1], 0, 0
    for k in range(len(pairs)):
        red, black = at_node[pairs[k, 0]], at_node[pairs[k, 1]]
        if red < 0 or black < 0 or red == black:
            continue
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
    """The face across which a black cell lies so far from a red one; -1 for none."""
    for q in range(len(distance)):
        if distance[q] == away:
            return q
    return -1
