"""Reader of Circuitscape configurations in advanced mode, of networks and of rasters of resistances.

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

import numpy as np
from numpy.typing import NDArray

from resgrid.core.regions import label_components
from resgrid.errors import InputError
from resgrid.spice.networks.ascii_grids import NODATA
from resgrid.spice.networks.configurations import CONNECTIVITY, Configuration, read_configuration
from resgrid.spice.networks.edges import Network, read_edges
from resgrid.spice.networks.raster_networks import (
    conductance_and_polygons,
    links_between,
    number_cells,
    siemens_of,
)
from resgrid.spice.networks.rasters import read_cells, read_raster

_POLICIES = {
    "keepall": (False, False),
    "not entered": (False, False),
    "rmvsrc": (True, False),
    "rmvgnd": (False, True),
    "rmvall": (True, True),
}
"""Pair (source is removed, ground is removed) for a node with both, by the value of ``remove_src_or_gnd``.

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
        hint = "; run it with 'resgrid resistance' (in Python: rg.spice.run_circuitscape)"
        raise InputError(
            f"{job.path}: the scenario {scenario!r} is not read; only 'advanced' is one circuit"
            + (hint if job.scenario in CONNECTIVITY else "; correct it")
        )
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
    """Return currents in A and conductances to ground in S after the keys that replace them are applied.

    ``use_unit_currents`` replaces nonzero currents by 1 A, ``use_direct_grounds`` positive conductances by infinity.
    `job`: the configuration; `amps`, `siemens`: values per cell or node, in A and S, of any shape; the results have the
    same shape.
    """
    if job.flag("use_unit_currents"):
        amps = (amps != 0).astype(np.float64)
    if job.flag("use_direct_grounds"):
        siemens = np.where(siemens > 0, np.inf, siemens)
    return amps, siemens


def _resolved(job: Configuration, network: Network) -> Network:
    """Return a network with the sources and grounds that take part in the solution.

    At a node with both, the key ``remove_src_or_gnd`` of the configuration `job` decides; a remaining positive source
    removes a direct ground (0 V). Sources in components without a ground are removed. Raises InputError if no ground
    remains, or for an unknown value of the key.
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
    """Return the network of a raster configuration `job`, and the node of every cell, (rows, columns), -1 for none."""
    habitat = read_raster(job.file("habitat_file"))
    conductance, polygon = conductance_and_polygons(job, habitat)
    node, names = number_cells(conductance, polygon)
    edges, value = links_between(
        conductance,
        node,
        mean_resistance=job.flag("connect_using_avg_resistances"),
        diagonals=not job.flag("connect_four_neighbors_only"),
    )
    ground = read_cells(job.file("ground_file"), habitat)
    if np.any(ground < 0):
        row, column = np.argwhere(ground < 0)[0].tolist()
        place = f"{job.file('ground_file')}: the ground in row {row}, column {column} (from 0)"
        found = f"{ground[row, column]:g}; write a positive value, or {NODATA:g} for a cell without a ground"
        raise InputError(f"{place} has a negative value of {found}")
    cells = _values_of_cells(
        job,
        siemens_of(read_cells(job.file("source_file"), habitat), "conductance"),
        siemens_of(ground, job.measure("ground_file_is_resistances")),
    )
    sums = (np.bincount(node[node >= 0], values[node >= 0], len(names)) for values in cells)
    amps, to_ground = (np.asarray(values, dtype=np.float64) for values in sums)
    return _resolved(job, Network(names, edges, value, amps, to_ground)), node
