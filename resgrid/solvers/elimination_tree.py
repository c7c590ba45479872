"""Nested dissection of grids with two axes: elimination is repeated only where equations have changed.

A plane of cells is divided by lines of cells again and again (George 1973).  The cells of small rectangles are
eliminated first, then the lines between them, up to the line through the whole plane.  The elimination of a node
depends on the equations of its rectangle alone.  After a change, only the nodes whose rectangles contain changed cells
are eliminated again, and the results are equal, to the last bit, to those of an elimination of all nodes.  Pivots are
sums, never differences, so that every entry of a solution has a small relative error
(`resgrid.solvers.elimination_kernels`).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.elimination_arrays import Fronts, Planes, Tree
from resgrid.solvers.scaled import Numbers

_LEAF = 9
"""Largest number of cells of a rectangle of the grid that nested dissection does not divide."""

_STRETCH = 2_000
"""Number of nodes that one call of the elimination kernel eliminates; Ctrl-C is handled between two calls."""


_LEAST = 1e-200
"""Smallest entry of a solution in doubles; a solution with a smaller entry is computed again with scaled numbers.

The limit applies to the number itself, whatever the unit of the solution. A scaled number has an integer exponent of
its own. In an entry above this limit, terms that underflow are negligible.
"""


class PlaneElimination:
    """Elimination of the equations of a plane of cells, repeated in part when equations change.

    Parameters
    ----------
    shape : tuple of int
        Numbers of cells ``(nx, ny)`` along both axes.

    Attributes
    ----------
    tree : Tree
        Nested dissection of the plane.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self.tree = tree = dissected(shape)
        cells, nodes, rows = shape[0] * shape[1], len(tree.parent), int(tree.first_row[-1])
        self._planes = Planes(
            np.zeros(cells, dtype=np.bool_), np.zeros((cells, 4)), np.zeros(cells), np.ones(nodes, dtype=np.bool_)
        )
        self._fronts = Fronts(
            np.zeros(nodes, dtype=np.int64), np.zeros(nodes, dtype=np.int64), np.empty(rows, dtype=np.int32),
            np.empty(int(tree.offset[-1])), np.empty(rows), int(np.diff(tree.first_row).max(initial=0)),
        )  # fmt: skip

    def update(
        self,
        across: NDArray[np.float64],
        along: NDArray[np.float64],
        ground: NDArray[np.float64],
        is_active: NDArray[np.bool_],
    ) -> float | None:
        """Eliminate the nodes of the tree whose equations have changed; return the fraction of nodes eliminated.

        The result is None if a pivot is not finite or at most 1e-300.  `across` (nx + 1, ny): conductances of the faces
        across the first axis, `along` (nx, ny + 1): across the second axis, 0 next to a cell without an equation; index
        ``(i, j)`` is the lower face of cell ``(i, j)``. `ground` (nx, ny): conductance to nodes of known voltage;
        `is_active` (nx, ny): whether a cell has an equation. Conductances have any common unit.
        """
        from resgrid.solvers.elimination_kernels import eliminate, load

        nodes = len(self.tree.parent)
        marked: int = load(self.tree, self._planes, across, along, ground, is_active)
        for begin in range(0, nodes, _STRETCH):
            if not eliminate(self.tree, self._planes, self._fronts, begin, min(begin + _STRETCH, nodes)):
                return None
        return marked / nodes

    def solve(self, currents: NDArray[np.float64]) -> Numbers:
        """Return the solution ``m * 2**(256 e)`` of the latest equations as mantissas and exponents, (nx, ny) each.

        It is 0 in cells without an equation, and in the unit of the currents divided by that of the conductances.
        `currents` (nx, ny): nonnegative current into every cell, 0 in cells without an equation.
        """
        from resgrid.solvers.substitution_kernels import substitute, substitute_plainly

        m, e, rank = np.empty(currents.size), np.zeros(currents.size, dtype=np.int64), self.tree.rank
        m[rank] = currents
        if not substitute_plainly(self.tree, self._fronts, m) >= _LEAST:
            m[rank] = currents
            substitute(self.tree, self._fronts, m, e)
        return m.take(rank), e.take(rank)


@lru_cache(maxsize=4)
def dissected(shape: tuple[int, int]) -> Tree:
    """Return the nested dissection of a plane, with read-only arrays; `shape`: numbers of cells along both axes."""
    rank = np.empty(shape, dtype=np.int32)
    nodes: list[tuple[int, int, int, int, int]] = []  # first and last rank, children, rows

    def divide(box: tuple[int, int, int, int]) -> int:
        """Append the nodes of the subtree of a rectangle, children first, and return the index of the subtree's root.

        `box`: begin and end (exclusive) of the rectangle along the first axis, then along the second.
        """
        x, x_end, y, y_end = box
        width, height = x_end - x, y_end - y
        around = height * ((x > 0) + (x_end < shape[0])) + width * ((y > 0) + (y_end < shape[1]))
        left = right = -1
        own = rank[x:x_end, y:y_end]
        if width * height > _LEAF and max(width, height) > 2:
            if width >= height:
                line = (x + x_end) // 2
                left, right = divide((x, line, y, y_end)), divide((line + 1, x_end, y, y_end))
                own = rank[line : line + 1, y:y_end]
            else:
                line = (y + y_end) // 2
                left, right = divide((x, x_end, y, line)), divide((x, x_end, line + 1, y_end))
                own = rank[x:x_end, line : line + 1]
        begin = nodes[-1][1] if nodes else 0
        own[...] = np.arange(begin, begin + own.size).reshape(own.shape)
        nodes.append((begin, begin + own.size, left, right, own.size + around))
        return len(nodes) - 1

    divide((0, shape[0], 0, shape[1]))
    first, last, left, right, rows = np.array(nodes, dtype=np.int64).T.copy()
    parent = np.full(len(nodes), -1, dtype=np.int64)
    for children in (left, right):
        parent[children[children >= 0]] = np.flatnonzero(children >= 0)
    wide = np.pad(rank, 1, constant_values=-1)
    neighbour = np.empty((rank.size, 4), dtype=np.int32)
    for side, beside in enumerate((wide[:-2, 1:-1], wide[2:, 1:-1], wide[1:-1, :-2], wide[1:-1, 2:])):
        neighbour[rank, side] = beside
    tree = Tree(
        rank, neighbour, np.repeat(np.arange(len(nodes), dtype=np.int32), last - first), first, last, left, right,
        parent, np.cumsum([0, *(rows * (rows + 1) // 2)]), np.cumsum([0, *rows]),
    )  # fmt: skip
    for array in tree:
        array.flags.writeable = False
    return tree
