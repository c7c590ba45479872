"""Networks of rasters by Circuitscape's rules: conductances of cells, nodes, and resistors between neighbours.

McRae, Shah & Edelman (2016) and the source of Circuitscape.jl.  The resistor between neighbouring cells has the mean of
their resistances, or the mean of their conductances; the distance of diagonal neighbours is sqrt(2).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.spice.networks.ascii_grids import NODATA, Raster
from resgrid.spice.networks.configurations import Configuration
from resgrid.spice.networks.edges import Measure
from resgrid.spice.networks.focal_points import whole_numbers
from resgrid.spice.networks.rasters import read_cells


def conductance_and_polygons(job: Configuration, habitat: Raster) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the conductance of every cell in S, and the number of its short-circuit region, (rows, columns) each.

    The conductance is 0 in empty cells and in cells that the mask of the configuration removes; the number is 0 outside
    the regions. `job`: the configuration; `habitat`: raster of its key ``habitat_file``. Raises InputError if no cell
    remains, or for a short-circuit region (polygon) whose number is not whole.
    """
    conductance = _habitat_conductance(job, habitat.cells)
    if job.flag("use_mask"):
        conductance = np.where(read_cells(job.file("mask_file"), habitat) > 0, conductance, 0.0)
        if not conductance.any():
            raise InputError(f"{job.file('mask_file')} removes all cells of the habitat; only cells above 0 are kept")
    polygon = np.zeros(conductance.shape)
    if job.flag("use_polygons"):
        polygon = np.nan_to_num(read_cells(job.file("polygon_file"), habitat))
        whole_numbers(job.file("polygon_file"), polygon, "polygon")
    return conductance, polygon


def _habitat_conductance(job: Configuration, habitat: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the conductance of every cell of the habitat file in S, shape (rows, columns), 0 for an empty cell.

    `job`: the configuration; `habitat` (rows, columns): values of the file.  Raises InputError for a negative value and
    for 0 ohm.
    """
    measure = job.measure("habitat_map_is_resistances")
    wrong = (habitat < 0) | ((habitat == 0) & (measure == "resistance"))
    if wrong.any():
        row, column = np.argwhere(wrong)[0].tolist()
        path = job.file("habitat_file")
        value = habitat[row, column]
        remedy = "define regions without resistance as short-circuit polygons"
        if value < 0:
            remedy = f"write a positive {measure}, or {NODATA:g} for an empty cell"
        raise InputError(
            f"{path}: the cell in row {row}, column {column} (from 0) has a {measure} of {value:g}; {remedy}"
        )
    return siemens_of(habitat, measure)


def siemens_of(cells: NDArray[np.float64], measure: Measure) -> NDArray[np.float64]:
    """Return the conductance of every cell in S, shape (rows, columns); 0 for an empty cell, which is NaN in `cells`.

    `cells` (rows, columns): values of the raster; `measure`: their quantity, "resistance" (in ohms) or "conductance"
    (S).
    """
    with np.errstate(divide="ignore"):
        return np.where(np.isnan(cells), 0.0, cells if measure == "conductance" else 1.0 / cells)


def number_cells(conductance: NDArray[np.float64], polygon: NDArray[np.float64]) -> tuple[NDArray[np.int64], list[str]]:
    """Return the node number of every cell, (rows, columns), -1 for none, and the names of the nodes, ground first.

    A polygon (short-circuit region) with a conducting cell is one node, to which its empty cells also belong.  A node
    is called ``r<row>_c<column>`` by its first conducting cell, counted from 0 in the order of rows.
    `conductance` (rows, columns): in S, 0 for an empty cell; `polygon` (rows, columns): number of the cell's polygon, 0
    for none.
    """
    conducts = conductance > 0
    cell = np.arange(conductance.size).reshape(conductance.shape)
    leader = np.where(conducts, cell, -1)
    inside = polygon != 0
    regions, region = np.unique(polygon[inside], return_inverse=True)
    first = np.full(len(regions), conductance.size)
    np.minimum.at(first, region, np.where(conducts, cell, conductance.size)[inside])
    leader[inside] = np.where(first < conductance.size, first, -1)[region]
    leaders, node = np.unique(leader[leader >= 0], return_inverse=True)
    numbers = np.full(conductance.shape, -1, dtype=np.int64)
    numbers[leader >= 0] = node + 1
    columns = conductance.shape[1]
    return numbers, ["ground", *(f"r{one // columns}_c{one % columns}" for one in leaders.tolist())]


def links_between(
    conductance: NDArray[np.float64], node: NDArray[np.int64], *, mean_resistance: bool, diagonals: bool
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Return the resistors between neighbouring cells: nodes, shape (n, 2), and conductances in S, shape (n,).

    `conductance` (rows, columns): of the cells, in S; `node` (rows, columns): node numbers, -1 for none;
    `mean_resistance`: whether the mean of the resistances is used instead of the mean of the conductances; `diagonals`:
    whether diagonal neighbours are joined, by resistances that are larger by the factor sqrt(2).  An empty cell of a
    polygon has 0 S; it is joined to a conducting neighbour with the mean of the conductances, but not with the mean of
    the resistances, which would be infinite.
    """
    steps: list[tuple[Any, Any, float]] = [(np.s_[:, :-1], np.s_[:, 1:], 1.0), (np.s_[:-1], np.s_[1:], 1.0)]
    if diagonals:
        far = float(np.sqrt(2.0))
        steps += [(np.s_[:-1, :-1], np.s_[1:, 1:], far), (np.s_[1:, :-1], np.s_[:-1, 1:], far)]
    pairs: list[NDArray[np.int64]] = []
    values: list[NDArray[np.float64]] = []
    for here, there, distance in steps:
        a, b = node[here].ravel(), node[there].ravel()
        x, y = conductance[here].ravel(), conductance[there].ravel()
        joins = (a > 0) & (b > 0) & (a != b) & ((x > 0) & (y > 0) if mean_resistance else (x > 0) | (y > 0))
        x, y = x[joins], y[joins]
        pairs.append(np.stack([a[joins], b[joins]], axis=1))
        values.append((2.0 / (1.0 / x + 1.0 / y) if mean_resistance else (x + y) / 2.0) / distance)
    return np.concatenate(pairs).astype(np.int32), np.concatenate(values)
