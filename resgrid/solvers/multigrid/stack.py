"""The levels of a hierarchy, laid one behind the other for the compiled cycle.

A level that is no grid is renumbered by colour, so that neighbouring rows of a sweep do not wait for one another, and
within a colour by length in windows: the ends of its loops can then be foreseen, which is half of the time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers import numbering_kernels as numbering
from resgrid.solvers.multigrid import ordering
from resgrid.solvers.multigrid.kernels import Stack
from resgrid.solvers.multigrid.levels import Graph, Step, coarsen_down

_FAR, _LARGE = 0.5, 250_000
"""Share of neighbours numbered far apart above which a graph of so many nodes is renumbered before anything else."""

_WINDOW = 4096
_LARGEST_INVERSE = 2000


def stack_graph(graph: Graph) -> Stack:
    """Coarsen a graph that is no grid, and lay out its levels."""
    rows = (graph.indptr, graph.indices, graph.conductance, graph.leak)
    if graph.size < _LARGE or not numbering.far_share(*rows[:2]) > _FAR:
        return stack_levels(*coarsen_down(graph), free=True)
    order = numbering.breadth_first(*rows[:2], 0)
    stack = stack_levels(*coarsen_down(Graph(*numbering.renumber(*rows, order), None)), free=True)
    return stack._replace(order=order[stack.order])


def stack_levels(graphs: list[Graph], steps: list[Step], *, free: bool = False) -> Stack:
    """Lay graphs, and the steps between them, one behind the other; the last one is inverted."""
    first = np.cumsum([0, *(graph.size for graph in graphs)])
    entry = np.cumsum([0, *(len(graph.indices) for graph in graphs)])
    red = np.array([_red_end(graph) for graph in graphs])
    keep = [len(step.rows) > 0 for step in steps] + [True]
    keep[0] |= not free
    if free:
        red[0] = -1
    order = [_order(graph, kept or end >= 0) for graph, kept, end in zip(graphs, keep, red, strict=True)]
    rank = [ordering.inverse_of(places) for places in order]
    indptr, middle = np.empty(first[-1] + 1, dtype=np.uint32), np.empty(first[-1], dtype=np.uint32)
    indices, conductance = np.empty(entry[-1], dtype=np.uint32), np.empty(entry[-1], dtype=np.float32)
    inverse, diagonal = np.empty((2, first[-1]), dtype=np.float32)
    aggregate = np.zeros(first[-1], dtype=np.uint32)
    for level, graph in enumerate(graphs):
        rows = (graph.indptr, graph.indices, graph.conductance, graph.leak, order[level], rank[level])
        ordering.lay_rows(
            *rows, first[level], entry[level], indptr, middle, indices, conductance, inverse, diagonal
        )  # fmt: skip
    for level, step in enumerate(steps):
        own = aggregate[first[level] : first[level + 1]]
        ordering.lay_aggregates(step.target, order[level], rank[level + 1], first[level + 1], own)
    return Stack(
        first,
        np.where(red >= 0, red + first[:-1], -1),
        indptr,
        middle,
        indices,
        conductance,
        inverse,
        diagonal,
        aggregate,
        np.cumsum([0, *(len(step.rows) for step in steps), 0]),
        np.concatenate([np.empty((0, 3), dtype=np.int64), *_removed(steps, first)]),
        np.concatenate([np.empty((0, 3)), *(step.weights for step in steps)]).astype(np.float32),
        _inverse(graphs[-1]),
        order[0],
        *np.zeros((6, first[-1]), dtype=np.float32),
    )


def own_work(stack: Stack) -> Stack:
    """The same levels with work space of its own, so that one hierarchy can serve several solves at a time."""
    b, x, c, v, w, kept = np.zeros((6, len(stack.b)), dtype=np.float32)
    return stack._replace(b=b, x=x, c=c, v=v, w=w, kept=kept)


def _order(graph: Graph, kept: bool) -> NDArray[np.int32]:
    if kept:
        return np.arange(graph.size, dtype=np.int32)
    return ordering.order_by_colour(graph.indptr, graph.indices, _WINDOW)


def _removed(steps: list[Step], first: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Eliminated nodes and their neighbours, counted in all levels; their levels keep their numbering."""
    return [np.where(step.rows < 0, -1, step.rows + begin) for step, begin in zip(steps, first, strict=False)]


def _red_end(graph: Graph) -> int:
    """Behind the last of the first nodes, where these and the others have no neighbours among themselves; else -1."""
    return -1 if graph.coordinate is None else int(ordering.red_end(graph.indptr, graph.indices))


def _inverse(graph: Graph) -> NDArray[np.float32]:
    """Inverse of the last level's matrix; empty where it did not shrink, as nodes without neighbours do not."""
    if graph.size > _LARGEST_INVERSE:
        return np.empty((0, 0), dtype=np.float32)
    return ordering.inverse_matrix(graph.indptr, graph.indices, graph.conductance, graph.leak)
