"""The levels of a grid: boards while most of their nodes lie on a lattice, graphs below."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.multigrid.board_cycle import Boards, cycle_boards
from resgrid.solvers.multigrid.board_passes import Board
from resgrid.solvers.multigrid.boards import Level, compensated, in_double, in_single, to_graph
from resgrid.solvers.multigrid.coarsening import Coarsened, coarsen
from resgrid.solvers.multigrid.kernels import Stack, cycle
from resgrid.solvers.multigrid.levels import coarsen_down
from resgrid.solvers.multigrid.stack import stack_levels

_SMALL = 250
_SHRINKAGE = 0.6
"""Share of nodes above which a board has fallen apart, and a graph takes its place."""

UNGRADED = np.empty(0, dtype=np.float32)

_MOST_EXTRAS, _MOST_EXTRAS_KEPT = 0.1, 0.5
"""Share of nodes beside the lattice above which a graph serves better than a board."""


@dataclass(frozen=True, eq=False)
class GridLevels:
    """A grid's first level by colour, and all that preconditions it.

    `true, board, exact`: the first level in double precision, in single, and in single but for the black diagonal,
    which makes up for that (`resgrid.solvers.multigrid.boards.compensated`); `place` (n,): place of every unknown, red
    ones first, black ones behind; `aggregate` (places,): node of the next level that a black place belongs to;
    `boards`: the coarse boards; there may be none; `weight` (places,): what a black place takes from its node; empty
    where that is all (`resgrid.solvers.multigrid.graded`).
    """

    true: Board
    board: Board
    exact: Board
    place: NDArray[np.int32]
    aggregate: NDArray[np.int32]
    boards: Boards
    weight: NDArray[np.float32]

    @cached_property
    def largest_degree(self) -> float:
        """Largest diagonal entry of the first level."""
        red = float(self.true.red_inverse.min(initial=np.inf, where=self.true.red_inverse > 0))
        return max(float(self.true.black_degree.max()), 1.0 / red)


def coarsen_grid(level: Level, place: NDArray[np.int32]) -> tuple[GridLevels, Stack] | None:
    """Coarsen a grid's first level down to a graph whose matrix can be inverted.  Shapes: `place` (n,)."""
    return lay_levels(*coarsen_boards(level), place)


def coarsen_boards(
    level: Level, most: int = 64, small: int = _SMALL, *, keep: bool = False
) -> tuple[list[Level], list[Coarsened]]:
    """Coarsen a board by blocks until it falls apart or has less than ``small`` nodes, at most ``most`` times."""
    levels: list[Level] = [level]
    steps: list[Coarsened] = []
    while len(steps) < most:
        made = coarsen(levels[-1], split=level.uneven, keep=keep)
        if made is None or made.level.size > _SHRINKAGE * levels[-1].size:
            break
        coarse = made.level
        levels.append(coarse)
        steps.append(made)
        extras = sum(len(cell) for cell in coarse.extra_cell)
        if coarse.size < small or extras > (_MOST_EXTRAS_KEPT if keep else _MOST_EXTRAS) * coarse.size:
            break
    return levels, steps


def lay_levels(
    levels: list[Level], steps: list[Coarsened], place: NDArray[np.int32]
) -> tuple[GridLevels, Stack] | None:
    """Lay boards out for the compiled passes, and coarsen the last one as a graph; None where it does not shrink.

    Takes over the degrees of the first level.
    """
    level, targets = levels[0], [step.target for step in steps]
    graph, number = to_graph(levels[-1])
    graphs, shrinking = coarsen_down(graph)
    if targets:
        targets = [*targets[:-1], counted(number, targets[-1])]
    else:
        if not shrinking:
            return None
        number[number >= 0] = shrinking[0].target[number[number >= 0]]
        targets = [counted(number, np.arange(level.lattice.places, 2 * level.lattice.places))]
        graphs, shrinking = graphs[1:], shrinking[1:]
    boards = lay_behind([in_single(coarse) for coarse in levels[1:-1]], targets[1:], graphs[0].size, level)
    return GridLevels(*first_boards(level), place, targets[0], boards, UNGRADED), stack_levels(graphs, shrinking)


def first_boards(level: Level) -> tuple[Board, Board, Board]:
    """The first level in all three precisions; takes over its degrees."""
    board = in_single(level)._replace(black_degree=np.empty(0, dtype=np.float32))
    exact = compensated(level, board)
    return in_double(level), board, exact


def counted(number: NDArray[np.int32], place: NDArray[np.integer]) -> NDArray[np.int32]:
    """Numbers of a graph's nodes at some places, counted from 1; 0 for none, as at place 0."""
    return np.asarray(number[place] + 1, dtype=np.int32)


def lay_behind(
    boards: list[Board],
    targets: list[NDArray[np.int32]],
    nodes: int,
    level: Level,
    weights: list[NDArray[np.float32]] | None = None,
) -> Boards:
    """Lay boards one behind the other, without work space."""

    def joined(parts: list[NDArray[Any]], kind: type) -> NDArray[Any]:
        return np.concatenate([np.empty(0, dtype=kind), *(part.ravel() for part in parts)]).astype(kind, copy=False)

    places = np.cumsum([0, *(board.faces.shape[1] for board in boards)])
    distance = np.array([board.distance for board in boards]).reshape(len(boards), len(level.faces))
    return Boards(
        size=2 * int(places[1]) if boards else 1 + nodes,
        nodes=nodes,
        places=places,
        first_link=np.cumsum([0, *(len(board.links) for board in boards)]),
        margin=np.array([board.margin for board in boards], dtype=np.int64),
        block=np.array([board.block for board in boards], dtype=np.int64),
        distance=distance.astype(np.int64),
        faces=joined([board.faces for board in boards], np.float32),
        links=joined([board.links for board in boards], np.float32),
        link_red=joined([board.link_red for board in boards], np.int32),
        link_black=joined([board.link_black for board in boards], np.int32),
        red_inverse=joined([board.red_inverse for board in boards], np.float32),
        black_inverse=joined([board.black_inverse for board in boards], np.float32),
        black_degree=joined([board.black_degree for board in boards], np.float32),
        aggregate=joined(targets, np.int32),
        weight=joined(weights or [], np.float32),
        **dict.fromkeys(("b", "x", "f", "z", "v", "c", "red"), np.empty(0, dtype=np.float32)),
        visits=np.empty(0, dtype=np.int64),
        energy=np.empty(0),
        alpha=np.empty(0),
    )


def own_vectors(boards: Boards) -> Boards:
    """The same boards with work space of their own, so that one hierarchy can serve several solves at a time."""
    levels, places = len(boards.margin), int(boards.places[-1])
    b, x = np.zeros((2, 2 * places + 1 + boards.nodes), dtype=np.float32)
    f, z, v, c, red = np.zeros((5, places), dtype=np.float32)
    energy, alpha = np.zeros((2, levels + 1))
    visits = np.zeros(levels + 2, dtype=np.int64)
    return boards._replace(b=b, x=x, f=f, z=z, v=v, c=c, red=red, visits=visits, energy=energy, alpha=alpha)


def inverse_below(stack: Stack) -> NDArray[np.float32]:
    """The inverse of the matrix below the boards, where it is a graph's of one level; empty otherwise."""
    return stack.coarsest if len(stack.first) == 2 else np.empty((0, 0), dtype=np.float32)


def cycle_levels(boards: Boards, stack: Stack, stop: float) -> None:
    """Approximate ``x = A^-1 b`` on the first coarse level by K-cycles over the boards and the graphs below."""
    inverse = inverse_below(stack)
    while not cycle_boards(boards, inverse, stop, 0):
        nodes, end = int(stack.first[1]), len(boards.b)
        stack.b[:nodes] = boards.b[end - nodes :]
        cycle(stack, stop, 0)
        boards.x[end - nodes :] = stack.x[:nodes]
