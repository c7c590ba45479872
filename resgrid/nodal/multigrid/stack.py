"""The levels of a hierarchy, laid one behind the other for the compiled cycle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.nodal.multigrid.kernels import Stack
from resgrid.nodal.multigrid.levels import Graph, Step


def stack_levels(graphs: list[Graph], steps: list[Step]) -> Stack:
    """Lay graphs, and the steps between them, one behind the other; the last one is inverted."""
    sizes = [graph.size for graph in graphs]
    first = np.cumsum([0, *sizes])
    entries = np.cumsum([0, *(len(graph.indices) for graph in graphs)])
    degree = np.concatenate([_degree(graph) for graph in graphs])
    work = [np.zeros(first[-1], dtype=np.float32) for _ in range(6)]
    with np.errstate(divide="ignore"):
        inverse = np.where(degree > 0, 1.0 / degree, 0.0)
    starts = [graph.indptr[:-1] + entry for graph, entry in zip(graphs, entries, strict=False)]
    neighbours = [graph.indices + begin for graph, begin in zip(graphs, first, strict=False)]
    targets = [np.where(step.target < 0, 0, step.target + begin) for step, begin in zip(steps, first[1:], strict=False)]
    rows = [np.where(step.rows < 0, -1, step.rows + begin) for step, begin in zip(steps, first, strict=False)]
    return Stack(
        first.astype(np.int64),
        np.array([_red_end(graph, begin) for graph, begin in zip(graphs, first, strict=False)]),
        np.concatenate([*starts, entries[-1:]]).astype(np.uint32),
        np.concatenate(neighbours).astype(np.uint32),
        np.concatenate([graph.conductance for graph in graphs]).astype(np.float32),
        inverse.astype(np.float32),
        degree.astype(np.float32),
        np.concatenate([*targets, np.zeros(sizes[-1], dtype=np.int32)]).astype(np.uint32),
        np.cumsum([0, *(len(step.rows) for step in steps), 0]),
        np.concatenate([np.empty((0, 3), dtype=np.int64), *rows]),
        np.concatenate([np.empty((0, 3)), *(step.weights for step in steps)]).astype(np.float32),
        _inverse(graphs[-1]),
        *work,
    )


def _red_end(graph: Graph, begin: int) -> int:
    """Behind the last of the first nodes, where these and the others have no neighbours among themselves; else -1."""
    row = np.repeat(np.arange(graph.size), np.diff(graph.indptr))
    red = int(np.min(graph.indices[row < graph.indices], initial=graph.size))
    return int(begin) + red if not np.any((row < red) == (graph.indices < red)) else -1


def _degree(graph: Graph) -> NDArray[np.float64]:
    row = np.repeat(np.arange(graph.size), np.diff(graph.indptr))
    return np.asarray(np.bincount(row, graph.conductance, graph.size) + graph.leak, dtype=np.float64)


def _inverse(graph: Graph) -> NDArray[np.float32]:
    matrix = np.diag(_degree(graph) * (1.0 + 1e-7))
    row = np.repeat(np.arange(graph.size), np.diff(graph.indptr))
    matrix[row, graph.indices] -= graph.conductance
    return np.linalg.inv(matrix).astype(np.float32)


def own_work(stack: Stack) -> Stack:
    """The same levels with work space of its own, so that one hierarchy can serve several solves at a time."""
    b, x, c, v, w, kept = np.zeros((6, len(stack.b)), dtype=np.float32)
    return stack._replace(b=b, x=x, c=c, v=v, w=w, kept=kept)
