"""Netlists without a grid of cells: power grids, random geometric graphs, grids with missing resistors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.core.netlist import GROUND, Netlist


def power_grid(nodes: int, seed: int, layers: int = 4) -> Netlist:
    """Return the supply network of a chip: stacked meshes joined by vias, loads at the bottom, pads at the top.

    Layer ``k`` has half the nodes per side of the layer below and four times its conductance; a via of 2 S joins each
    of its nodes to the one underneath; every tenth node of the lowest layer draws a current, a hundredth of those of
    the topmost are pads at 1 V.
    """
    rng = np.random.default_rng(seed)
    side = int(np.sqrt(nodes / sum(0.25**k for k in range(layers)))) >> (layers - 1) << (layers - 1)
    ends, conductance, first, below = [], [], 1, np.empty((0, 0), dtype=np.int64)
    for layer in range(layers):
        mesh = first + np.arange((side >> layer) ** 2).reshape(side >> layer, side >> layer)
        pairs = mesh_pairs(mesh)
        ends.append(pairs)
        conductance.append(4.0**layer * rng.uniform(0.5, 1.5, len(pairs)))
        if layer:
            vias = np.stack([below[::2, ::2].ravel(), mesh.ravel()], axis=1)
            ends.append(vias)
            conductance.append(np.full(len(vias), 2.0))
        first, below = first + mesh.size, mesh
    loads = 1 + np.flatnonzero(rng.random(side * side) < 0.1)
    pads = rng.permutation(below.ravel())[: max(below.size // 100, 1)]
    return Netlist(
        node_count=first,
        resistor_nodes=np.concatenate(ends),
        conductance=np.concatenate(conductance),
        source_nodes=to_ground(pads),
        source_volts=np.ones(len(pads)),
        current_nodes=to_ground(loads),
        current_amps=rng.uniform(0.0, 1e-3, len(loads)),
    )


def geometric(nodes: int, seed: int) -> Netlist:
    """Return random points in a square, joined within a radius (about eight neighbours); conductance 1 / distance."""
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(seed)
    points = rng.random((nodes, 2))
    pairs = cKDTree(points).query_pairs(np.sqrt(8.0 / (np.pi * nodes)), output_type="ndarray")
    distance = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
    return between_edges(nodes, pairs + 1, np.mean(distance) / np.maximum(distance, 1e-6), points[:, 0])


def thinned(nodes: int, seed: int) -> Netlist:
    """Return a square mesh without a tenth of its resistors."""
    rng = np.random.default_rng(seed)
    side = round(np.sqrt(nodes))
    mesh = 1 + np.arange(side * side).reshape(side, side)
    pairs = mesh_pairs(mesh)
    pairs = pairs[rng.random(len(pairs)) >= 0.1]
    return between_edges(mesh.size, pairs, np.ones(len(pairs)), np.repeat(np.linspace(0.0, 1.0, side), side))


def between_edges(
    nodes: int, pairs: NDArray[np.int64], conductance: NDArray[np.float64], place: NDArray[np.float64]
) -> Netlist:
    """Return a sheet of nodes 1 ... n with the left edge (the first hundredth) at 1 V and the right edge at 0 V."""
    left, right = 1 + np.flatnonzero(place < 0.01), 1 + np.flatnonzero(place >= 0.99)
    return Netlist(
        node_count=nodes + 1,
        resistor_nodes=pairs,
        conductance=conductance,
        source_nodes=to_ground(np.concatenate([left, right])),
        source_volts=np.concatenate([np.ones(len(left)), np.zeros(len(right))]),
    )


def mesh_pairs(mesh: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return pairs of neighbours in a mesh of numbered nodes."""
    across = np.stack([mesh[:-1].ravel(), mesh[1:].ravel()], axis=1)
    along = np.stack([mesh[:, :-1].ravel(), mesh[:, 1:].ravel()], axis=1)
    return np.concatenate([across, along])


def to_ground(nodes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return pairs of each node with ground."""
    return np.stack([nodes, np.full(len(nodes), GROUND)], axis=1)
