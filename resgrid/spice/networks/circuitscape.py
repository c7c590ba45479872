"""Circuitscape configurations in advanced mode: networks, and rasters of resistances.

McRae, Shah & Edelman (2016), *Circuitscape: modeling landscape connectivity to promote conservation and human health*,
the user guide of Circuitscape 5, and the source of Circuitscape.jl.  The resistor between neighbouring cells has the
mean of their resistances, or the mean of their conductances; the distance of diagonal neighbours is sqrt(2).

The steps have the order of Circuitscape, which changes the result:

1. The mask makes cells empty: they get no node.
2. Cells get their nodes.  All cells of a polygon get the polygon's node, also its empty cells.
3. Unit currents and direct grounds replace the values of single cells.
4. Sources and conductances to ground are summed per node; in the lists of a network the last line of a node counts.
5. ``remove_src_or_gnd`` removes sources or grounds of nodes with both.
6. A positive source removes a direct ground.
"""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.core.regions import label_components
from resgrid.errors import InputError
from resgrid.spice.networks.configurations import Configuration, read_configuration
from resgrid.spice.networks.edges import Measure, Network, read_edges
from resgrid.spice.networks.rasters import read_raster

_POLICIES = {
    "keepall": (False, False),
    "not entered": (False, False),
    "rmvsrc": (True, False),
    "rmvgnd": (False, True),
    "rmvall": (True, True),
}
"""Whether the source, and whether the ground, is removed at a node with both, by the value of ``remove_src_or_gnd``.

Circuitscape 3.5 wrote ``not entered`` for the default, which removes neither.
"""


def read_circuitscape(
    path: str | os.PathLike[str], *, root: str | os.PathLike[str] | None = None
) -> tuple[Network, NDArray[np.int64] | None]:
    """Return the network of a Circuitscape configuration in advanced mode, and the node of every cell.

    `path`: the configuration file; `root`: folder that must contain all files named in the configuration, by default
    the folder of `path`.  The nodes have the shape (rows, columns), top row first, with -1 for a cell without a node;
    they are None unless the data are rasters.
    """
    job = read_configuration(path, root)
    scenario = job.text("scenario")
    if scenario not in ("advanced", "Advanced"):
        raise InputError(f"{job.path}: the scenario {scenario!r} is not read; only 'advanced' is one circuit")
    if job.flag("use_reclass_table"):
        raise InputError(f"{job.path}: use_reclass_table is not applied; reclassify the habitat file first")
    kind = job.text("data_type")
    if kind in ("raster", "Raster"):
        return _read_rasters(job)
    if kind not in ("network", "Network"):
        raise InputError(f"{job.path}: data_type = {kind!r} is neither 'network' nor 'raster'")
    network = read_edges(
        job.file("habitat_file"),
        job.file("source_file"),
        job.file("ground_file"),
        measure=job.measure("habitat_map_is_resistances"),
        ground_measure=job.measure("ground_file_is_resistances"),
        last_counts=True,
        absent_edges=True,
    )
    amps, to_ground = _values_of_cells(job, network.amps, network.to_ground)
    return _resolved(job, replace(network, amps=amps, to_ground=to_ground)), None


def _values_of_cells(
    job: Configuration, amps: NDArray[np.float64], siemens: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return currents and conductances to ground after ``use_unit_currents`` and ``use_direct_grounds`` are applied.

    The first key replaces nonzero currents by 1 A, the second replaces positive conductances by infinity.  `job`: the
    configuration; `amps, siemens`: values per cell or node, in A and S, of any shape; the results have the same shape.
    """
    if job.flag("use_unit_currents"):
        amps = (amps != 0).astype(np.float64)
    if job.flag("use_direct_grounds"):
        siemens = np.where(siemens > 0, np.inf, siemens)
    return amps, siemens


def _resolved(job: Configuration, network: Network) -> Network:
    """Return `network` with ``remove_src_or_gnd`` applied, and without sources in components without a ground.

    `job`: the configuration.  Raises InputError if no ground remains, or for an unknown value of the key.
    """
    policy = job.text("remove_src_or_gnd")
    if policy not in _POLICIES:
        words = ", ".join(word for word in _POLICIES if " " not in word)
        raise InputError(f"{job.path}: remove_src_or_gnd = {policy!r} is not one of {words}")
    without_source, without_ground = _POLICIES[policy]
    both = (network.amps != 0) & (network.to_ground > 0)
    amps = np.where(both & without_source, 0.0, network.amps)
    to_ground = np.where(both & without_ground, 0.0, network.to_ground)
    to_ground = np.where(np.isinf(to_ground) & (amps > 0), 0.0, to_ground)
    if not to_ground.any():
        reason = "they lie outside all nodes, or have a conductance of 0 S"
        if network.to_ground.any():
            reason = f"each has a source at its node (remove_src_or_gnd = {policy})"
        raise InputError(f"{job.path}: none of the grounds of {job.text('ground_file')!r} remains: {reason}")
    count = len(network.names)
    component = label_components(network.edges, count)
    grounded = np.bincount(component, to_ground > 0) > 0
    grounded[component[0]] = True
    return replace(network, amps=np.where(grounded[component], amps, 0.0), to_ground=to_ground)


def _read_rasters(job: Configuration) -> tuple[Network, NDArray[np.int64]]:
    """Return the network of a raster configuration, and the node of every cell, shape (rows, columns), -1 for none.

    `job`: the configuration.
    """
    conductance = _habitat(job)

    def raster_of(key: str) -> NDArray[np.float64]:
        """Return the cells of the raster that the key `key` names, shape (rows, columns).

        Raises InputError unless the raster has the shape of the habitat file.
        """
        other = read_raster(job.file(key))
        if other.shape != conductance.shape:
            sizes = (f"{rows} x {columns} cells" for rows, columns in (other.shape, conductance.shape))
            raise InputError(f"{job.file(key)} has {next(sizes)}, but the habitat has {next(sizes)}")
        return other

    if job.flag("use_mask"):
        conductance = np.where(raster_of("mask_file") > 0, conductance, 0.0)
        if not conductance.any():
            raise InputError(f"{job.file('mask_file')} removes all cells of the habitat; only cells above 0 are kept")
    polygon = np.zeros(conductance.shape)
    if job.flag("use_polygons"):
        polygon = np.nan_to_num(raster_of("polygon_file"))
        if np.any(polygon != np.rint(polygon)):
            raise InputError(f"{job.file('polygon_file')}: the number of a polygon is not a whole number")
    node, names = _number_cells(conductance, polygon)
    edges, value = _links(
        conductance,
        node,
        mean_resistance=job.flag("connect_using_avg_resistances"),
        diagonals=not job.flag("connect_four_neighbors_only"),
    )
    ground = raster_of("ground_file")
    if np.any(ground < 0):
        row, column = np.argwhere(ground < 0)[0].tolist()
        place = f"{job.file('ground_file')}: the ground in row {row}, column {column} (from 0)"
        raise InputError(f"{place} has a negative value of {ground[row, column]:g}")
    cells = _values_of_cells(
        job,
        _siemens(raster_of("source_file"), "conductance"),
        _siemens(ground, job.measure("ground_file_is_resistances")),
    )
    sums = (np.bincount(node[node >= 0], values[node >= 0], len(names)) for values in cells)
    amps, to_ground = (np.asarray(values, dtype=np.float64) for values in sums)
    return _resolved(job, Network(names, edges, value, amps, to_ground)), node


def _habitat(job: Configuration) -> NDArray[np.float64]:
    """Return the conductance of every cell of the habitat file in S, shape (rows, columns), 0 for an empty cell.

    `job`: the configuration.  Raises InputError for a negative value and for 0 ohm.
    """
    path = job.file("habitat_file")
    habitat, measure = read_raster(path), job.measure("habitat_map_is_resistances")
    wrong = (habitat < 0) | ((habitat == 0) & (measure == "resistance"))
    if wrong.any():
        row, column = np.argwhere(wrong)[0].tolist()
        raise InputError(
            f"{path}: the cell in row {row}, column {column} (from 0) has a {measure} of {habitat[row, column]:g}; "
            "define regions without resistance as short-circuit polygons"
        )
    return _siemens(habitat, measure)


def _siemens(cells: NDArray[np.float64], measure: Measure) -> NDArray[np.float64]:
    """Return the conductance of every cell in S, shape (rows, columns); 0 for an empty cell, which is NaN in `cells`.

    `cells` (rows, columns): values of the raster; `measure`: their quantity, "resistance" (in ohms) or "conductance"
    (S).
    """
    with np.errstate(divide="ignore"):
        return np.where(np.isnan(cells), 0.0, cells if measure == "conductance" else 1.0 / cells)


def _number_cells(
    conductance: NDArray[np.float64], polygon: NDArray[np.float64]
) -> tuple[NDArray[np.int64], list[str]]:
    """Return the node number of every cell, (rows, columns), -1 for none, and the names of the nodes, ground first.

    A polygon with a conducting cell is one node, which its empty cells belong to.  `conductance` (rows, columns): in S,
    0 for an empty cell; `polygon` (rows, columns): number of the cell's polygon, 0 for none.
    """
    conducts = conductance > 0
    cell = np.arange(conductance.size).reshape(conductance.shape)
    leader = np.where(conducts, cell, -1)
    for region in np.unique(polygon[(polygon != 0) & conducts]).tolist():
        members = polygon == region
        leader[members] = cell[members & conducts].min()
    leaders, node = np.unique(leader[leader >= 0], return_inverse=True)
    numbers = np.full(conductance.shape, -1, dtype=np.int64)
    numbers[leader >= 0] = node + 1
    columns = conductance.shape[1]
    return numbers, ["ground", *(f"r{one // columns}_c{one % columns}" for one in leaders.tolist())]


def _links(
    conductance: NDArray[np.float64], node: NDArray[np.int64], *, mean_resistance: bool, diagonals: bool
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Return the resistors between neighbouring cells: nodes, shape (n, 2), and conductances in S, shape (n,).

    `conductance` (rows, columns): of the cells, in S; `node` (rows, columns): node numbers, -1 for none;
    `mean_resistance`: whether the mean of the resistances is used instead of the mean of the conductances; `diagonals`:
    whether diagonal neighbours are joined.  An empty cell of a polygon has 0 S; it is joined to a conducting neighbour
    with the mean of the conductances, but not with the mean of the resistances, which would be infinite.
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
