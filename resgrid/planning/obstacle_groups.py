"""Groups of obstacle cells (all connected components), and the adjacency graph of groups and regions of free cells.

Free and goal cells are connected across faces, obstacle cells across faces, edges or corners: the two connectivities
of the digital Jordan curve theorem (Rosenfeld 1970).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from resgrid._internal.values import frozen
from resgrid.core.cell import Cell
from resgrid.core.regions import cells_at_faces, label_regions, with_margin
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError


@frozen
@dataclass(frozen=True, eq=False)
class Barriers:
    """Groups of obstacle cells that are connected across faces, edges or corners.

    `space`: the space of the cells; `label` (shape of the space): group of every obstacle cell, -1 elsewhere; groups
    are numbered from 0 in C order of their first cell, real groups before virtual ones; `virtual` (groups,): mask of
    groups of virtual obstacle cells, which have no body.
    """

    space: ConfigurationSpace
    label: NDArray[np.int32]
    virtual: NDArray[np.bool_]

    @cached_property
    def sizes(self) -> NDArray[np.int64]:
        """Number of cells of every group, shape (groups,)."""
        return np.bincount(self.label[self.label >= 0], minlength=len(self.virtual))

    @cached_property
    def links(self) -> RegionGraph:
        """Adjacency graph of regions (of free and goal cells) and groups (of obstacle cells)."""
        return adjacency(self)

    def mask(self, *groups: int) -> NDArray[np.bool_]:
        """Return the mask of the cells of the groups with indices `groups`, shape of the space."""
        return np.isin(self.label, groups) & (self.label >= 0)


@dataclass(frozen=True, eq=False)
class RegionGraph:
    """Adjacency graph of regions (of free and goal cells) and groups (of obstacle cells).

    `node` (shape of the space): graph node of every cell; `regions`: number of regions, which are the first nodes; node
    ``regions + g`` is group ``g``; `graph` (nodes, nodes): symmetric matrix of the costs of steps between adjacent
    nodes, whose cells share a face.  The cost of a path between two regions is the number of groups on it, plus a
    number below 1 that grows with the number of cells in these groups.
    """

    node: NDArray[np.int64]
    regions: int
    graph: sparse.csr_array

    def adjacent_groups(self, node: int) -> tuple[int, ...]:
        """Return the indices of the groups that share a face with the region or group of a graph node, ascending."""
        neighbours = self.graph.indices[self.graph.indptr[node] : self.graph.indptr[node + 1]]
        return tuple(sorted(int(other) - self.regions for other in neighbours if other >= self.regions))

    def groups_between(self, first: int, last: int) -> tuple[int, ...]:
        """Return the indices of the groups on a shortest path between two graph nodes, in path order, ends included.

        `first`, `last`: indices of the graph nodes; a node is a region (of free and goal cells) or a group of obstacle
        cells.
        """
        from scipy.sparse.csgraph import dijkstra

        _, before = dijkstra(self.graph, directed=False, indices=np.array([first]), return_predecessors=True)
        nodes = [last]
        while nodes[-1] != first:
            nodes.append(int(before[0, nodes[-1]]))
        return tuple(node - self.regions for node in reversed(nodes) if node >= self.regions)


def group_obstacles(space: ConfigurationSpace, virtual: ArrayLike | None = None) -> Barriers:
    """Return the groups of obstacle cells that are connected across faces, edges or corners.

    `virtual`: mask of virtual obstacle cells, shape of the space, which form separate groups; None for no such cells.
    """
    obstacle = space.cell == Cell.OBSTACLE
    marked = np.zeros(space.shape, dtype=np.bool_) if virtual is None else np.asarray(virtual)
    if marked.shape != space.shape or marked.dtype.kind != "b":
        raise InputError(
            f"virtual must be a boolean array of shape {space.shape}, got {marked.dtype} of shape {marked.shape}"
        )
    real, added = (label_regions(obstacle & kind, space.periodic, corners=True) - 1 for kind in (~marked, marked))
    first = int(real.max()) + 1
    label = np.where(added >= 0, added + np.int32(first), real)
    return Barriers(space, label, np.arange(first + int(added.max()) + 1) >= first)


def adjacency(barriers: Barriers, opened: tuple[int, ...] = ()) -> RegionGraph:
    """Return the adjacency graph of regions and groups if the cells of the groups with indices `opened` are free.

    These groups become parts of regions, and have graph nodes without edges.
    """
    space = barriers.space
    passable = (space.cell != Cell.OBSTACLE) | barriers.mask(*opened)
    region = label_regions(passable, space.periodic).astype(np.int64) - 1
    regions = int(region.max()) + 1
    node = np.where(passable, region, regions + barriers.label)
    cost = np.concatenate([np.zeros(regions), 1.0 + barriers.sizes / (1.0 + barriers.sizes.sum())])
    wide = with_margin(node, space.periodic)
    faces = [np.stack([side.ravel() for side in cells_at_faces(wide, axis)], axis=1) for axis in range(space.ndim)]
    pairs = np.unique(np.sort(np.concatenate([pair[pair[:, 0] != pair[:, 1]] for pair in faces]), axis=1), axis=0)
    first, last = np.concatenate([pairs, pairs[:, ::-1]]).T
    # An edge carries half the cost of each end, so that a path through a group pays its full cost.
    graph = sparse.coo_array((0.5 * (cost[first] + cost[last]), (first, last)), shape=(len(cost), len(cost)))
    return RegionGraph(node, regions, graph.tocsr())
