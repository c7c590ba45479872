"""Groups of obstacle cells, and how they lie between the regions of free cells."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from resgrid.errors import InputError
from resgrid.frozen import frozen
from resgrid.grids import label_regions
from resgrid.space import Cell, ConfigurationSpace


@frozen
@dataclass(frozen=True, eq=False)
class Barriers:
    """The obstacle cells of a space in groups that meet across faces, edges or corners.

    `label` as the space: group of every obstacle cell, numbered from 0 in C order of their first cell, real ones
    before virtual ones; -1 elsewhere; `virtual` (groups,): which groups are virtual obstacles.
    """

    space: ConfigurationSpace
    label: NDArray[np.int32]
    virtual: NDArray[np.bool_]

    @cached_property
    def sizes(self) -> NDArray[np.int64]:
        """Number of cells of every group, shape (groups,)."""
        return np.bincount(self.label[self.label >= 0], minlength=len(self.virtual))

    @cached_property
    def links(self) -> Links:
        """Which regions and groups touch."""
        return link(self)

    def mask(self, *groups: int) -> NDArray[np.bool_]:
        """Cells of some groups, shape of the space."""
        return np.isin(self.label, groups) & (self.label >= 0)


@dataclass(frozen=True, eq=False)
class Links:
    """Regions of free and goal cells, and groups of obstacle cells, as the nodes of a graph of who touches whom.

    `node` as the space: region or group of every cell: regions first; `regions`: number of regions; node ``regions +
    g`` is group ``g``; `graph` (nodes, nodes): symmetric; a path costs 1 for every group it goes through, and a
    little for every cell of it.
    """

    node: NDArray[np.int64]
    regions: int
    graph: sparse.csr_array

    def groups_beside(self, node: int) -> tuple[int, ...]:
        """Groups that share a face with a region or group."""
        beside = self.graph.indices[self.graph.indptr[node] : self.graph.indptr[node + 1]]
        return tuple(sorted(int(other) - self.regions for other in beside if other >= self.regions))

    def groups_between(self, first: int, last: int) -> tuple[int, ...]:
        """Groups on a cheapest path between two nodes, in its order, ends included."""
        from scipy.sparse.csgraph import dijkstra

        _, before = dijkstra(self.graph, directed=False, indices=np.array([first]), return_predecessors=True)
        way = [last]
        while way[-1] != first:
            way.append(int(before[0, way[-1]]))
        return tuple(node - self.regions for node in reversed(way) if node >= self.regions)


def group_obstacles(space: ConfigurationSpace, virtual: ArrayLike | None = None) -> Barriers:
    """Group the obstacle cells that meet across faces, edges or corners, periodic axes included.

    Shapes: `virtual` as the space.
    """
    obstacle = space.cell == Cell.OBSTACLE
    if virtual is None:
        label = label_groups(obstacle, space.periodic)
        return Barriers(space, label, np.zeros(int(label.max()) + 1, dtype=np.bool_))
    marked = np.asarray(virtual)
    if marked.shape != space.shape or marked.dtype.kind != "b":
        raise InputError(
            f"virtual must be a boolean array of shape {space.shape}, got {marked.dtype} of shape {marked.shape}"
        )
    real = label_groups(obstacle & ~marked, space.periodic)
    added = label_groups(obstacle & marked, space.periodic)
    first = int(real.max()) + 1
    label = np.where(added >= 0, added + np.int32(first), real)
    return Barriers(space, label, np.arange(first + int(added.max()) + 1) >= first)


def label_groups(mask: NDArray[np.bool_], periodic: ArrayLike) -> NDArray[np.int32]:
    """Number the cells of a mask by group, from 0 in C order of their first cell; -1 outside.

    A group is connected across faces, edges and corners: the dual of `label_regions`.

    Shapes: `periodic` (mask.ndim,); returns as the mask.
    """
    from scipy import ndimage
    from scipy.sparse.csgraph import connected_components

    rings = np.asarray(periodic, dtype=np.bool_)
    around = np.pad(mask, [(int(ring), int(ring)) for ring in rings], mode="wrap")
    out = np.full(mask.shape, -1, dtype=np.int32)
    if not mask.any():
        return out
    labels, count = ndimage.label(around, structure=np.ones((3,) * mask.ndim))
    index = [np.arange(-1, n + 1) % n + 1 if ring else np.arange(n) for n, ring in zip(mask.shape, rings, strict=True)]
    # The margin repeats the cells of the other end, and so says which labels are one group.
    pairs = np.stack([labels[around], labels[np.ix_(*index)][around]]) - 1
    graph = sparse.coo_array((np.ones(pairs.shape[1]), tuple(pairs)), shape=(count, count))
    _, group = connected_components(graph, directed=False)
    inner = labels[tuple(slice(1, -1) if ring else slice(None) for ring in rings)]
    found = group[inner[mask] - 1]
    _, first = np.unique(found, return_index=True)
    rank = np.zeros(count + 1, dtype=np.int32)
    rank[found[np.sort(first)]] = np.arange(len(first), dtype=np.int32)
    out[mask] = rank[found]
    return out


def link(barriers: Barriers, opened: tuple[int, ...] = ()) -> Links:
    """Find out which regions and groups touch, with some groups taken away."""
    space = barriers.space
    passable = (space.cell != Cell.OBSTACLE) | barriers.mask(*opened)
    region = label_regions(passable, space.periodic).astype(np.int64) - 1
    regions = int(region.max()) + 1
    node = np.where(passable, region, regions + barriers.label)
    cost = np.concatenate([np.zeros(regions), 1.0 + barriers.sizes / (1.0 + barriers.sizes.sum())])
    pairs = np.unique(np.concatenate([_touching(node, axis, space) for axis in range(space.ndim)]), axis=0)
    first, last = np.concatenate([pairs, pairs[:, ::-1]]).T
    # Half a group's cost on the way in, half on the way out.
    graph = sparse.coo_array((0.5 * (cost[first] + cost[last]), (first, last)), shape=(len(cost), len(cost)))
    return Links(node, regions, graph.tocsr())


def _touching(node: NDArray[np.int64], axis: int, space: ConfigurationSpace) -> NDArray[np.int64]:
    """Pairs of different nodes that share a face across one axis, the smaller first; shape (n, 2)."""
    along = np.moveaxis(node, axis, 0)
    here, there = (along, np.roll(along, -1, axis=0)) if space.axes[axis].periodic else (along[:-1], along[1:])
    differ = here != there
    return np.unique(np.sort(np.stack([here[differ], there[differ]], axis=1), axis=1), axis=0)
