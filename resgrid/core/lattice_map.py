"""The map from nodes and resistors of a netlist to the sites and steps of its lattice over a space."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.values import frozen
from resgrid.core.cell import Cell
from resgrid.core.lattice import Lattice
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import Wiring


@frozen
@dataclass(frozen=True, eq=False)
class LatticeMap:
    """Map between the nodes and resistors of a netlist and the sites and steps of a lattice.

    A site is a possible position of a node; a step leads from a site to a neighbouring site.

    Attributes
    ----------
    space : ConfigurationSpace
        The space that was compiled.
    wiring : Wiring
        Boundary conditions, drive and element values, with an edge rule for every axis.
    lattice : Lattice
        Sites and steps of the lattice.
    node : ndarray of int32, shape of the lattice
        Node of every site, -1 for a site without a node.  A site in a rail cell has the node of its rail.
    resistor_site : ndarray of int64, shape (resistors,)
        Flat index of the site at the first end of every resistor.
    resistor_step : ndarray of int8, shape (resistors,)
        Index, in the steps of the lattice, of the step from the first to the second end of every resistor; -1 for
        contacts with the obstacle rail.
    free_node : ndarray of int32, shape (free nodes,)
        Nodes of the sites in free cells, in C order of the sites, without sites that have no node.
    obstacle_node : int
        Node of the obstacle rail, -1 without one.
    goal_nodes : tuple of int
        Node of the rail of every goal region.
    """

    space: ConfigurationSpace
    wiring: Wiring
    lattice: Lattice
    node: NDArray[np.int32]
    resistor_site: NDArray[np.int64]
    resistor_step: NDArray[np.int8]
    free_node: NDArray[np.int32]
    obstacle_node: int
    goal_nodes: tuple[int, ...]

    @cached_property
    def site_of_node(self) -> NDArray[np.int64]:
        """Flat index of the site of every node, -1 for rails and ground; (nodes,)."""
        own = np.flatnonzero((self.node.ravel() >= 0) & (self.lattice.at_sites(self.space.cell).ravel() == Cell.FREE))
        last = max(int(self.node.max(initial=0)), self.obstacle_node, *self.goal_nodes)
        site = np.full(last + 1, -1, dtype=np.int64)
        site[self.node.ravel()[own]] = own
        return site

    def cell_of_node(self, node_count: int) -> NDArray[np.int64]:
        """Return the flat index of the cell that contains the site of every node, -1 for other nodes; (node_count,)."""
        cell = np.full(node_count, -1, dtype=np.int64)
        own = np.flatnonzero(self.site_of_node >= 0)
        cells = np.ravel_multi_index(self.lattice.site_cells, self.space.shape).ravel()
        cell[own] = cells[self.site_of_node[own]]
        return cell

    def names(self, nodes: NDArray[np.int64]) -> list[str]:
        """Return the names of nodes (n,): ``0``, ``obstacle``, ``goal_0``, ``n_3_4`` (a site) or ``node_5``."""
        rails = {0: "0", self.obstacle_node: "obstacle"}
        rails |= {node: f"goal_{region}" for region, node in enumerate(self.goal_nodes)}
        known = nodes < len(self.site_of_node)
        site = np.where(known, self.site_of_node[np.where(known, nodes, 0)], -1)
        index = np.transpose(np.unravel_index(np.maximum(site, 0), self.lattice.shape)).tolist()
        return [
            "_".join(map(str, ("n", *place))) if own >= 0 else rails.get(node, f"node_{node}")
            for node, own, place in zip(nodes.tolist(), site.tolist(), index, strict=True)
        ]
