"""Lay the nodal equations of a grid out by colour: the levels from which boards and graphs are made."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.multigrid import board_setup
from resgrid.solvers.multigrid.board_passes import Board, Reals
from resgrid.solvers.multigrid.cg_kernels import put_at_places
from resgrid.solvers.multigrid.graphs import Graph
from resgrid.solvers.multigrid.lattice import Lattice

WEAK = 0.1
"""Share of a conductance below which another one is weak beside it."""


@dataclass(frozen=True, eq=False)
class Level:
    """A board on the way from one level to the next, with leaks and with the links' axes.

    `faces` (2 ndim, places); `leak` (2, places): conductance to the rails, of red and of black places; `degree` (2,
    places): all conductances at a place, summed; `mean` (ndim,): mean conductance along every axis, 0 where there is
    none; `uneven`: whether some conductances are weak beside others; `ends` (2, links): red and black places of the
    links, in the order of both; `axis` (links,); `links` (links,); `extra_cell`: flat index of the cell that an extra
    red or black node belongs to.
    """

    lattice: Lattice
    faces: NDArray[np.float64]
    leak: NDArray[np.float64]
    degree: NDArray[np.float64]
    mean: NDArray[np.float64]
    uneven: bool
    ends: NDArray[np.int32]
    axis: NDArray[np.int32]
    links: NDArray[np.float64]
    extra_cell: tuple[NDArray[np.int64], NDArray[np.int64]]

    @cached_property
    def size(self) -> int:
        """Number of nodes."""
        return int(np.count_nonzero(self.degree))


def lay_out(
    pairs: NDArray[np.int32],
    conductance: NDArray[np.float64],
    row: NDArray[np.int32],
    node: NDArray[np.int32],
    excess: NDArray[np.float64],
    unit: float,
) -> tuple[Level, NDArray[np.int32]] | None:
    """Colour a grid and bring the conductances of its faces in order.

    Shapes: `pairs` (m, 2), `conductance` (m,), `row` (nodes,), `node` as the grid, `excess` (n,); returns `place`
    (n,).
    """
    if node.ndim < 2:
        return None
    lattice = Lattice(node.shape)
    place = np.full(len(excess), -1, dtype=np.int32)
    at_node = np.full(len(row), -1, dtype=np.int32)
    cells = board_setup.place_cells(node.ravel(), row, lattice.rows, lattice.margin, lattice.places, place, at_node)
    if cells != len(excess):
        return None
    faces = np.zeros((2 * node.ndim, lattice.places))
    rings = np.empty(sum(node.size // size for size in node.shape), dtype=np.int64)
    count = board_setup.fill_faces(pairs, conductance, at_node, lattice.distance, 1.0 / unit, faces, rings)
    if count < 0:
        return None
    leak = np.zeros((2, lattice.places))
    put_at_places(place, excess, 1.0 / unit, leak.ravel())
    ends, axis, links = _rings(at_node[pairs[rings[:count]]], conductance[rings[:count]] / unit, lattice)
    empty = np.empty(0, dtype=np.int64)
    return level_of(lattice, faces, leak, ends, axis, links, (empty, empty)), place


def _rings(
    place: NDArray[np.int32], conductance: NDArray[np.float64], lattice: Lattice
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float64]]:
    """Red and black places, axes and conductances of the resistors that close periodic axes, from pairs of places."""
    ends = np.sort(place, axis=1).T - np.array([[0], [lattice.places]], dtype=np.int32)
    red, black = (np.stack(lattice.cells_at(colour, ends[colour])) for colour in range(2))
    axis = np.argmax(red != black, axis=0).astype(np.int32)
    order = np.lexsort((ends[1], ends[0]))
    return np.ascontiguousarray(ends[:, order], dtype=np.int32), axis[order], conductance[order]


def level_of(
    lattice: Lattice,
    faces: NDArray[np.float64],
    leak: NDArray[np.float64],
    ends: NDArray[np.int32],
    axis: NDArray[np.int32],
    links: NDArray[np.float64],
    extra_cell: tuple[NDArray[np.int64], NDArray[np.int64]],
) -> Level:
    """A level with its degrees summed."""
    degree = leak.copy()
    mean, extremes = board_setup.sum_degrees(faces, *frame(lattice), ends[0], ends[1], links, degree)
    least, greatest = extremes.tolist()
    return Level(lattice, faces, leak, degree, mean, least < WEAK * greatest, ends, axis, links, extra_cell)


def frame(lattice: Lattice) -> tuple[NDArray[np.int64], int]:
    """What tells the neighbours of places."""
    return lattice.distance, lattice.margin


def in_double(level: Level) -> Board:
    """A level for the compiled passes, in double precision; takes over its degrees, and inverts the red ones."""
    red, black = level.degree
    board_setup.invert(red, red)
    return board_of(level, level.faces, level.links, red, np.empty(0), black)


def in_single(level: Level) -> Board:
    """A level for the compiled passes, in single precision; see `compensated` for its products."""
    single = np.float32
    inverse = np.empty(level.degree.shape, dtype=single)
    for degree, of_colour in zip(level.degree, inverse, strict=True):
        board_setup.invert(degree, of_colour)
    faces, links = level.faces.astype(single), level.links.astype(single)
    return board_of(level, faces, links, inverse[0], inverse[1], level.degree[1].astype(single))


def board_of(
    level: Level, faces: Reals, links: Reals, red_inverse: Reals, black_inverse: Reals, black_degree: Reals
) -> Board:
    """A level for the compiled passes."""
    lattice, (red, black) = level.lattice, level.ends
    return Board(
        faces=faces,
        distance=lattice.distance,
        margin=lattice.margin,
        block=min(board_setup.BLOCK, lattice.places),
        link_red=red,
        link_black=black,
        links=links,
        red_inverse=red_inverse,
        black_inverse=black_inverse,
        black_degree=black_degree,
    )


def compensated(level: Level, single: Board) -> Board:
    """A level in single precision but for its black diagonal, which is in double precision.

    It makes up for all rounding, so that products are right to a few roundings of every conductance, however smooth the
    vector.
    """
    degree, (red, black) = np.empty(level.lattice.places), level.ends
    board_setup.compensate(
        single.faces, *frame(level.lattice), red, black, single.links, single.red_inverse, level.leak, degree
    )
    return single._replace(black_inverse=np.empty(0, dtype=np.float32), black_degree=degree)


def to_graph(level: Level) -> tuple[Graph, NDArray[np.int32]]:
    """A level as a graph of conductances, red nodes first.  Returns `number` (2 places,)."""
    from scipy import sparse

    lattice, places = level.lattice, level.lattice.places
    used = np.flatnonzero(level.degree.ravel())
    number = np.full(2 * places, -1, dtype=np.int32)
    number[used] = np.arange(len(used), dtype=np.int32)
    red = [np.flatnonzero(face) for face in level.faces]
    black = [here + d for here, d in zip(red, lattice.distance.tolist(), strict=True)]
    here = number[np.concatenate([*red, level.ends[0]])]
    there = number[places + np.concatenate([*black, level.ends[1]])]
    g = np.concatenate([*(face[k] for face, k in zip(level.faces, red, strict=True)), level.links])
    rows = sparse.csr_array(
        (np.concatenate([g, g]), (np.concatenate([here, there]), np.concatenate([there, here]))),
        shape=(len(used),) * 2,
    )
    rows.sum_duplicates()
    indptr, indices = rows.indptr.astype(np.int32), rows.indices.astype(np.int32)
    return Graph(indptr, indices, rows.data, level.leak.ravel()[used]), number
