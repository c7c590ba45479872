"""The type `Landscape`: cells and focal points of a Circuitscape raster job, from which its circuits are made."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from resgrid.core.netlist import Netlist
from resgrid.spice.networks.configurations import Configuration
from resgrid.spice.networks.focal_points import FocalPoints
from resgrid.spice.networks.raster_networks import links_between, number_cells


@dataclass(frozen=True, eq=False)
class Landscape:
    """Conductances of the cells of a raster job, and its focal points.

    `job`: the configuration; `conductance` (rows, columns): in S, 0 for cells that do not conduct; `polygon` (rows,
    columns): number of the short-circuit region of each cell, 0 for none; `points`: the focal points.
    """

    job: Configuration
    conductance: NDArray[np.float64]
    polygon: NDArray[np.float64]
    points: FocalPoints

    def circuit(self, numbers: Iterable[int]) -> tuple[Netlist, NDArray[np.int64]]:
        """Return the circuit of the cells, and the node of every cell, (rows, columns), -1 for none.

        Each short-circuit region and each given focal region is a single node; regions that overlap are one node
        together. `numbers`: indices of the focal points whose regions are single nodes.
        """
        regions = [self.points.cells[number] for number in numbers if len(self.points.cells[number]) > 1]
        return self._joined(regions) if regions else self._without_regions

    @cached_property
    def _without_regions(self) -> tuple[Netlist, NDArray[np.int64]]:
        """Circuit in which only short-circuit regions are single nodes, and the node of every cell, -1 for none.

        The nodes of the cells have the shape (rows, columns).
        """
        return self._joined([])

    def _joined(self, regions: list[NDArray[np.int64]]) -> tuple[Netlist, NDArray[np.int64]]:
        """Return the circuit of the cells, and the node of every cell, (rows, columns), -1 for none.

        Short-circuit regions and `regions` are single nodes; regions that overlap are one node together. `regions`:
        flat cell indices (row times number of columns plus column) of each region.
        """
        labels = self.polygon.ravel().copy()
        for cells in regions:
            label, touched = labels.max() + 1.0, np.unique(labels[cells])
            labels[np.isin(labels, touched[touched != 0])] = label
            labels[cells] = label
        node, names = number_cells(self.conductance, labels.reshape(self.polygon.shape))
        edges, siemens = links_between(
            self.conductance,
            node,
            mean_resistance=self.job.flag("connect_using_avg_resistances"),
            diagonals=not self.job.flag("connect_four_neighbors_only"),
        )
        return Netlist(len(names), edges, siemens), node

    def node_of(self, node: NDArray[np.int64], number: int) -> int:
        """Return the node of a focal point, -1 if its first cell does not conduct.

        `node` (rows, columns): node of every cell; `number`: index of the focal point.
        """
        return int(node.ravel()[self.points.cells[number][0]])
