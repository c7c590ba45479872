"""Face-connected regions of cells."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def box_around(mask: NDArray[np.bool_]) -> tuple[slice, ...]:
    """The smallest box that holds all of a mask."""
    axes = range(mask.ndim)
    lines = [np.flatnonzero(mask.any(axis=tuple(other for other in axes if other != axis))) for axis in axes]
    return tuple(slice(int(line[0]), int(line[-1]) + 1) if len(line) else slice(0, 0) for line in lines)


def label_regions(mask: NDArray[np.bool_], periodic: ArrayLike) -> NDArray[np.int32]:
    """Face-connected components of a mask, numbered from 1 in C order of their first cell; 0 outside.

    Shapes: `periodic` (mask.ndim,); returns of mask.
    """
    from scipy import ndimage

    labels = np.empty(mask.shape, dtype=np.int32)
    count = ndimage.label(mask, output=labels)
    wrapped = [axis for axis, ring in enumerate(np.asarray(periodic)) if ring]
    if not wrapped or count < 2:
        return labels
    return _join_across_seams(labels, count, wrapped)


def _join_across_seams(labels: NDArray[np.int32], count: int, wrapped: list[int]) -> NDArray[np.int32]:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    pairs = [np.stack([labels.take(0, axis).ravel(), labels.take(-1, axis).ravel()]) for axis in wrapped]
    first, last = np.concatenate(pairs, axis=1)
    both = (first > 0) & (last > 0)
    graph = coo_array((np.ones(both.sum()), (first[both], last[both])), shape=(count + 1, count + 1))
    _, group = connected_components(graph, directed=False)
    # Old labels come in C order of first cells, so a group's smallest label orders the groups.
    _, order = np.unique(group[1:], return_index=True)
    rank = np.zeros(group.max() + 1, dtype=np.int32)
    rank[group[1:][np.sort(order)]] = np.arange(1, len(order) + 1, dtype=np.int32)
    new_label = rank[group]
    new_label[0] = 0
    return np.asarray(new_label[labels])
