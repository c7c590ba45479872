"""Lay the nodal equations of a grid out by colour, and coarsen the board by blocks of two cells a side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.nodal.multigrid import board_setup
from resgrid.nodal.multigrid.board_passes import Board
from resgrid.nodal.multigrid.levels import Graph

LEAST_WIDTH = 4
_BLOCK = 2048
"""Places a pass takes at a time: what it touches stays in the first cache."""

_PADDING = 16
WEAK = 0.1
"""Share of a conductance below which another one is weak beside it."""

_SAMPLE = 20_000
_MOST_EXTRAS = 0.1
"""Share of nodes beside the grid from which a graph serves better than a board."""


@dataclass(frozen=True, eq=False)
class Lattice:
    """Where the cells of a grid lie on a board.

    Attributes
    ----------
    shape : tuple of int
        Of the grid.
    extra_rows : int
        Rows behind the last one for nodes beside the grid.
    """

    shape: tuple[int, ...]
    extra_rows: int = 0

    @property
    def width(self) -> int:
        """Places a row; one is left empty between rows."""
        return (self.shape[-1] + 1) // 2 + 1

    @property
    def grid_rows(self) -> int:
        """Rows of cells."""
        return int(np.prod(self.shape[:-1]))

    @property
    def rows(self) -> int:
        """All rows."""
        return self.grid_rows + self.extra_rows

    @property
    def strides(self) -> list[int]:
        """Places from one cell to the next along every axis but the last."""
        return [self.width * int(np.prod(self.shape[a + 1 : -1])) for a in range(len(self.shape) - 1)]

    @property
    def margin(self) -> int:
        """Places before the first row."""
        return max(self.strides) + _PADDING

    @property
    def places(self) -> int:
        """Places of a colour, margins included."""
        return 2 * self.margin + self.width * self.rows

    @property
    def first_extra(self) -> int:
        """First place behind the grid."""
        return self.margin + self.width * self.grid_rows

    @property
    def distance(self) -> NDArray[np.int64]:
        """From a red place to the black one across each face but the last."""
        return np.array([*(d for stride in self.strides for d in (-stride, stride)), 0], dtype=np.int64)

    @property
    def colour(self) -> NDArray[np.int64]:
        """Parity of every row of cells."""
        return (np.indices(self.shape[:-1]).sum(axis=0).ravel() % 2).astype(np.int64)

    @property
    def aside(self) -> NDArray[np.int64]:
        """From a red place to the black one across the last face, for every row."""
        return np.concatenate([np.where(self.colour == 0, -1, 1), np.ones(self.extra_rows, dtype=np.int64)])


@dataclass(frozen=True, eq=False)
class Level:
    """A board on the way from one level to the next, with leaks and with the links' axes.

    Attributes
    ----------
    lattice : Lattice
    faces : ndarray of float64, shape (2 ndim, places)
    leak : ndarray of float64, shape (2, places)
        Conductance to the rails, of red and of black places.
    degree : ndarray of float64, shape (2, places)
        All conductances at a place, summed.
    mean : ndarray of float64, shape (ndim,)
        Mean conductance along every axis, 0 where there is none.
    uneven : bool
        Whether some conductances are weak beside others.
    ends : ndarray of int32, shape (links, 2)
        Red and black places of the links, in the order of both.
    axis : ndarray of int32, shape (links,)
    links : ndarray of float64, shape (links,)
    extra_cell : tuple of two ndarrays of int64
        Flat index of the cell that an extra red or black node belongs to.
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

    @property
    def size(self) -> int:
        """Number of nodes."""
        return int(np.count_nonzero(self.degree))


def lay_out(
    pairs: NDArray[np.int64],
    conductance: NDArray[np.float64],
    row: NDArray[np.int64],
    node: NDArray[np.int64],
    excess: NDArray[np.float64],
    unit: float,
) -> tuple[Level, NDArray[np.int32]] | None:
    """Colour a grid and bring the conductances of its faces in order.

    Parameters
    ----------
    pairs : ndarray of int64, shape (m, 2)
        Nodes that conductances join.
    conductance : ndarray of float64, shape (m,)
        In siemens.
    row : ndarray of int64, shape (nodes,)
        Number of the unknown at every node; -1 for none.
    node : ndarray of int64, shape of the grid
        Node of every cell, -1 for none.
    excess : ndarray of float64, shape (n,)
        Conductance from every unknown to the rails, in siemens.
    unit : float
        Conductance that counts as 1, in siemens.

    Returns
    -------
    level : Level
    place : ndarray of int32, shape (n,)
        Place of every unknown, red ones first, black ones behind.
    None
        Where unknowns are not the cells of a grid of two colours, or its rows are too short to be worth it.
    """
    if node.ndim < 2 or (node.shape[-1] + 1) // 2 + 1 < LEAST_WIDTH:
        return None
    lattice = Lattice(node.shape)
    width, margin, places = lattice.width, lattice.margin, lattice.places
    place = np.full(len(excess), -1, dtype=np.int32)
    cells = board_setup.place_cells(node.ravel(), row, node.shape[-1], lattice.colour, width, margin, places, place)
    if cells != len(excess):
        return None
    faces = np.zeros((2 * node.ndim, places))
    rings = np.empty(sum(node.size // size for size in node.shape), dtype=np.int64)
    count = board_setup.fill_faces(
        pairs, conductance, row, place, lattice.distance, lattice.aside, width, margin, 1.0 / unit, faces, rings
    )
    if count < 0:
        return None
    leak = np.zeros((2, places))
    leak.ravel()[place] = excess / unit
    ends, axis, links = _rings(pairs[rings[:count]], conductance[rings[:count]] / unit, row, place, lattice)
    empty = np.empty(0, dtype=np.int64)
    return _level(lattice, faces, leak, ends, axis, links, (empty, empty)), place


def _rings(
    pairs: NDArray[np.int64],
    conductance: NDArray[np.float64],
    row: NDArray[np.int64],
    place: NDArray[np.int32],
    lattice: Lattice,
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float64]]:
    """Red and black places, axes and conductances of the resistors that close periodic axes."""
    ends = np.sort(place[row[pairs]], axis=1) - np.array([0, lattice.places], dtype=np.int32)
    red, black = (np.stack(cells_at(lattice, colour, ends[:, colour])) for colour in range(2))
    axis = np.argmax(red != black, axis=0).astype(np.int32)
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    return np.ascontiguousarray(ends[order], dtype=np.int32), axis[order], conductance[order]


def cells_at(lattice: Lattice, colour: int, place: NDArray[np.integer]) -> tuple[NDArray[np.int64], ...]:
    """Indices of the cells at some places of a colour, one array for each axis."""
    line, along = np.divmod(place.astype(np.int64) - lattice.margin, lattice.width)
    column = 2 * along + ((lattice.colour[line] == 1) != (colour == 1))
    return (*np.unravel_index(line, lattice.shape[:-1]), column)


def _level(
    lattice: Lattice,
    faces: NDArray[np.float64],
    leak: NDArray[np.float64],
    ends: NDArray[np.int32],
    axis: NDArray[np.int32],
    links: NDArray[np.float64],
    extra_cell: tuple[NDArray[np.int64], NDArray[np.int64]],
) -> Level:
    degree = leak.copy()
    mean, least, greatest = board_setup.sum_degrees(faces, *_frame(lattice), ends[:, 0], ends[:, 1], links, degree)
    return Level(lattice, faces, leak, degree, mean, least < WEAK * greatest, ends, axis, links, extra_cell)


def _frame(lattice: Lattice) -> tuple[NDArray[np.int64], NDArray[np.int64], int, int]:
    return lattice.distance, lattice.aside, lattice.width, lattice.margin


def to_boards(level: Level) -> tuple[Board, Board]:
    """A level for the compiled passes, in double and in single precision."""
    lattice, degree, ends = level.lattice, level.degree, level.ends
    inverse, singles = np.empty(degree.shape[1]), np.empty(degree.shape, dtype=np.float32)
    board_setup.invert_degrees(degree, inverse, singles)
    double = Board(
        faces=level.faces,
        distance=lattice.distance,
        aside=lattice.aside,
        width=lattice.width,
        margin=lattice.margin,
        block=max(1, _BLOCK // lattice.width),
        link_red=np.ascontiguousarray(ends[:, 0]),
        link_black=np.ascontiguousarray(ends[:, 1]),
        links=level.links,
        red_inverse=inverse,
        black_inverse=np.empty(0),
        black_degree=degree[1],
    )
    single = double._replace(
        faces=level.faces.astype(np.float32),
        links=level.links.astype(np.float32),
        red_inverse=singles[0],
        black_inverse=singles[1],
        black_degree=degree[1].astype(np.float32),
    )
    return double, single


def coarsen(level: Level, *, split: bool) -> tuple[Level, NDArray[np.int32]] | None:
    """Make the next level: blocks of two cells along every axis but those that conduct badly.

    A block that falls apart, without its weak conductances, keeps one part on the grid; the others become extra nodes
    beside it, reached by links.

    Parameters
    ----------
    level : Level
    split : bool
        Whether weak conductances beside strong ones do not join.

    Returns
    -------
    coarse : Level
    target : ndarray of int32, shape (2, places)
        Place there of the aggregate that every place belongs to, red ones first; 0 for unused places.
    None
        If parts of one block are joined by weak conductances: they have one colour.
    """
    shift = (level.mean > WEAK * level.mean.max()).astype(np.int64)
    lattice = Lattice(tuple((n - 1 >> s) + 1 for n, s in zip(level.lattice.shape, shift.tolist(), strict=True)))
    target = _blocks(level, lattice, shift)
    home = _split(level, lattice, target, WEAK if split else 0.0)
    before, colour = lattice.places, (home >= lattice.places).astype(np.int64)
    if len(home):
        most = int(np.bincount(colour).max())
        lattice = Lattice(lattice.shape, -(-most // lattice.width))
        rank = np.where(colour == 0, np.cumsum(colour == 0), np.cumsum(colour == 1)) - 1
        number = (colour * lattice.places + lattice.first_extra + rank).astype(np.int32)
        board_setup.renumber(target, before, number, lattice.places - before)
    cells = [cells_at(lattice, c, home[colour == c] - c * before) for c in range(2)]
    extra_cell = tuple(np.ravel_multi_index(cell, lattice.shape).astype(np.int64) for cell in cells)
    return _summed(level, lattice, target, extra_cell)


def _blocks(level: Level, lattice: Lattice, shift: NDArray[np.int64]) -> NDArray[np.int32]:
    """The place on the next lattice, red ones first, that every place's block takes."""
    fine, exists = level.lattice, level.degree > 0.0
    rows = [index.ravel() >> s for index, s in zip(np.indices(fine.shape[:-1]), shift[:-1].tolist(), strict=True)]
    row_block = np.ravel_multi_index(rows, lattice.shape[:-1]).astype(np.int64)
    target = np.zeros(exists.shape, dtype=np.int32)
    board_setup.block_of_places(
        exists, fine.aside, fine.width, fine.margin, int(shift[-1]), row_block, sum(rows) & 1,
        lattice.width, lattice.margin, lattice.places, target,
    )  # fmt: skip
    for colour, cell in enumerate(level.extra_cell):
        block = [index >> s for index, s in zip(np.unravel_index(cell, fine.shape), shift.tolist(), strict=True)]
        line = np.ravel_multi_index(block[:-1], lattice.shape[:-1])
        black = sum(block) & 1
        place = black * lattice.places + lattice.margin + line * lattice.width + (block[-1] >> 1)
        target[colour, fine.first_extra : fine.first_extra + len(cell)] = place
    return target


def _split(level: Level, lattice: Lattice, target: NDArray[np.int32], weak: float) -> NDArray[np.int64]:
    """Number the parts of blocks that fall apart, in place; returns the block that every extra node comes from."""
    graph = (level.faces, *_frame(level.lattice), level.ends[:, 0], level.ends[:, 1], level.links)
    strongest = np.zeros(level.degree.shape if weak else (2, 1), dtype=np.float32)
    if weak:
        board_setup.strongest_at(*graph, strongest)
    members, inner = np.zeros((2, 2 * lattice.places), dtype=np.int32)
    board_setup.count_inside(*graph, target, weak, strongest, members, inner)
    # A part of a hypercube with n corners has at most as many edges as there are ones in the numbers below n.
    most = np.cumsum([0, 0, *(k.bit_count() for k in range(1, 64))])
    doubtful = (members > 1) & (inner <= most[np.clip(members - 1, 0, 63)])
    for colour, cell in enumerate(level.extra_cell):
        first = level.lattice.first_extra
        doubtful[target[colour, first : first + len(cell)]] = True
    doubtful[0] = False
    if not doubtful.any():
        return np.empty(0, dtype=np.int64)
    parent = np.arange(target.size, dtype=np.int32)
    board_setup.join_inside(*graph, target, weak, strongest, doubtful, parent)
    home = np.empty(int(members[doubtful].sum()), dtype=np.int64)
    return home[: board_setup.split_blocks(doubtful, parent, target, lattice.places, home)]


def _summed(
    level: Level, lattice: Lattice, target: NDArray[np.int32], extra_cell: tuple[NDArray[np.int64], NDArray[np.int64]]
) -> tuple[Level, NDArray[np.int32]] | None:
    extras, sides = sum(len(cell) for cell in extra_cell), len(level.faces)
    room = len(level.links) + extras * sides * 2 ** (sides // 2)
    faces, leak = np.zeros((sides, lattice.places)), np.zeros((2, lattice.places))
    inner = np.zeros((sides // 2, 2 * lattice.places), dtype=np.float32)
    ends, axis, links = np.empty((room, 2), dtype=np.int32), np.empty(room, dtype=np.int32), np.empty(room)
    count = board_setup.sum_blocks(
        level.faces, level.leak, *_frame(level.lattice), level.ends[:, 0], level.ends[:, 1], level.axis, level.links,
        target, lattice.places, lattice.distance, lattice.first_extra, faces, leak.ravel(), inner, ends, axis, links,
    )  # fmt: skip
    if count < 0:
        return None
    ends, axis, links = _united(ends[:count], axis[:count], links[:count])
    board_setup.lengthen_faces(faces, leak, *_frame(lattice), ends[:, 0], ends[:, 1], axis, links, inner)
    return _level(lattice, faces, leak, ends, axis, links, extra_cell), target


def _united(
    ends: NDArray[np.int32], axis: NDArray[np.int32], links: NDArray[np.float64]
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float64]]:
    """Links by red places, those between the same two nodes summed."""
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    ends, axis, links = ends[order], axis[order], links[order]
    new = np.any(np.diff(ends, axis=0, prepend=np.full((1, 2), -1, dtype=np.int32)) != 0, axis=1)
    first = np.flatnonzero(new)
    return ends[first], axis[first], np.add.reduceat(links, first) if len(first) else links


def to_graph(level: Level) -> tuple[Graph, NDArray[np.int32]]:
    """A level as a graph of conductances, red nodes first.

    Parameters
    ----------
    level : Level

    Returns
    -------
    graph : Graph
    number : ndarray of int32, shape (2 places,)
        Number of the node at every place, red ones first; -1 for none.
    """
    from scipy import sparse

    lattice, places = level.lattice, level.lattice.places
    used = np.flatnonzero(level.degree.ravel())
    number = np.full(2 * places, -1, dtype=np.int32)
    number[used] = np.arange(len(used), dtype=np.int32)
    aside = np.zeros(places, dtype=np.int64)
    aside[lattice.margin : lattice.margin + lattice.rows * lattice.width] = np.repeat(lattice.aside, lattice.width)
    red = [np.flatnonzero(face) for face in level.faces]
    black = [here + d for here, d in zip(red, lattice.distance.tolist(), strict=False)]
    black.append(red[-1] + aside[red[-1]])
    here = number[np.concatenate([*red, level.ends[:, 0]])]
    there = number[places + np.concatenate([*black, level.ends[:, 1]])]
    g = np.concatenate([*(face[k] for face, k in zip(level.faces, red, strict=True)), level.links])
    rows = sparse.csr_array(
        (np.concatenate([g, g]), (np.concatenate([here, there]), np.concatenate([there, here]))),
        shape=(len(used),) * 2,
    )
    rows.sum_duplicates()
    coordinate = _coordinates(level, used)
    indptr, indices = rows.indptr.astype(np.int32), rows.indices.astype(np.int32)
    return Graph(indptr, indices, rows.data, level.leak.ravel()[used], coordinate), number


def _coordinates(level: Level, used: NDArray[np.int64]) -> NDArray[np.int32]:
    lattice = level.lattice
    parts = []
    for colour in range(2):
        place = used[(used >= lattice.places) == (colour == 1)] - colour * lattice.places
        on_grid = place[place < lattice.first_extra]
        extra = np.unravel_index(level.extra_cell[colour], lattice.shape)
        cells = zip(cells_at(lattice, colour, on_grid), extra, strict=True)
        parts.append(np.stack([np.concatenate(pair) for pair in cells], axis=1))
    return np.ascontiguousarray(np.concatenate(parts), dtype=np.int32)
