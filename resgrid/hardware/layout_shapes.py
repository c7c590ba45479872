"""All rectangles of a layout, with its placed cells expanded (flattened), for pictures."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from resgrid.hardware.layout import Layout
from resgrid.hardware.layout_rules import DrawnCell, Layer

Window = tuple[float, float, float, float]
"""A rectangle: lower left corner x0, y0 and upper right corner x1, y1, in nanometres."""


def expanded_shapes(
    layout: Layout, window: Window | None = None, layers: set[Layer] | None = None
) -> dict[Layer, NDArray[np.float64]]:
    """Return the rectangles of a layout by layer, shape (rectangles, 4).

    A rectangle is x0, y0 (lower left corner), x1, y1 (upper right corner), in nanometres from the node of cell (0, 0).
    `window`: rectangle of the same form, outside which rectangles are left out, None for all; rectangles that touch the
    window are returned whole. `layers`: layers to return, None for all.
    """
    cells = {cell.name: cell for cell in layout.cells}
    found: dict[Layer, list[NDArray[np.float64]]] = {}
    _expand(cells, layout.cells[-1], np.zeros((1, 2)), window, layers, found)
    return {layer: np.concatenate(boxes) for layer, boxes in found.items()}


def _expand(
    cells: Mapping[str, DrawnCell],
    cell: DrawnCell,
    origins: NDArray[np.float64],
    window: Window | None,
    layers: set[Layer] | None,
    found: dict[Layer, list[NDArray[np.float64]]],
) -> None:
    """Add the rectangles of a cell at several origins, with those of the cells that it contains, to `found`.

    `cells`: all cells by name; `cell`: the cell to add; `origins` (copies, 2): x and y of the cell's origin for each
    copy, in nanometres; `window`: only rectangles that touch this rectangle are added, None for all; `layers`: only
    these layers are added, None for all; `found`: by layer a list of arrays (rectangles, 4) with x0, y0, x1, y1.
    """
    for layer, *corners in cell.boxes:
        if layers is None or layer in layers:
            boxes = np.tile(origins, 2) + np.array(corners, dtype=np.float64)
            if window is not None:
                x0, y0, x1, y1 = window
                boxes = boxes[(boxes[:, 2] >= x0) & (boxes[:, 0] <= x1) & (boxes[:, 3] >= y0) & (boxes[:, 1] <= y1)]
            if len(boxes):
                found.setdefault(layer, []).append(boxes)
    for placed in cell.placements:
        columns, rows = np.meshgrid(np.arange(placed.columns), np.arange(placed.rows), indexing="ij")
        steps = np.stack((placed.x + columns.ravel() * placed.dx, placed.y + rows.ravel() * placed.dy), axis=1)
        places = (origins[:, np.newaxis] + steps).reshape(-1, 2)
        _expand(cells, cells[placed.cell], places, window, layers, found)
