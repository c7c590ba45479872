"""Raster jobs of Circuitscape: cells, focal points, and the circuits in which regions are single nodes."""

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
    """Conductances of the cells and focal points of a raster job.

    `job`: the configuration; `conductance`, `polygon` (rows, columns): in S, and number of the short-circuit region, 0
    for none; `points`: the focal points.
    """

    job: Configuration
    conductance: NDArray[np.float64]
    polygon: NDArray[np.float64]
    points: FocalPoints

    def circuit(self, numbers: Iterable[int]) -> tuple[Netlist, NDArray[np.int64]]:
        """Return the circuit in which polygons and some focal regions are single nodes, and the node of every cell.

        `numbers`: indices of the focal points that are joined.  A region and the polygons that it overlaps are one
        node.
        """
        regions = [self.points.cells[number] for number in numbers if len(self.points.cells[number]) > 1]
        return self._joined(regions) if regions else self._without_regions

    @cached_property
    def _without_regions(self) -> tuple[Netlist, NDArray[np.int64]]:
        """Circuit in which only polygons are single nodes, and the node of every cell."""
        return self._joined([])

    def _joined(self, regions: list[NDArray[np.int64]]) -> tuple[Netlist, NDArray[np.int64]]:
        """Return the circuit in which polygons and `regions` (flat cell indices) are single nodes, and the node map."""
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
        """Return the node of a focal point, -1 without a conducting cell; `node`: node of every cell."""
        return int(node.ravel()[self.points.cells[number][0]])
