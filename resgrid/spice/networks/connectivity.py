"""Circuitscape's pairwise, one-to-all and all-to-one modes: resistances between focal points, and output files.

McRae (2006), *Isolation by resistance*; McRae, Dickson, Keitt & Shah (2008), *Using circuit theory to model
connectivity in ecology, evolution, and conservation*; the source of Circuitscape.jl.

- **pairwise**: 1 A flows from the second point of a pair to the first; a region is one node while its pair is measured.
- **one-to-all**: the strength of one point (a current, 1 A by default) flows to all other points, which are at 0 V.
- **all-to-one**: the strengths of all other points flow to one point, which is at 0 V.

The current of a cell is the larger of the currents into its node and out of it.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.parallel import JobPart, in_order
from resgrid._internal.values import frozen
from resgrid.circuit.effective_resistance import effective_resistance
from resgrid.circuit.network_reduction import Count
from resgrid.core.netlist import Netlist
from resgrid.errors import InputError
from resgrid.spice.networks.circuitscape_files import OutputFiles, output_files
from resgrid.spice.networks.configurations import CONNECTIVITY, Configuration, read_configuration
from resgrid.spice.networks.edges import read_edges
from resgrid.spice.networks.focal_points import (
    allowed_pairs,
    numbers_of,
    read_points,
    strengths_of,
    whole_numbers,
)
from resgrid.spice.networks.landscapes import Landscape
from resgrid.spice.networks.measurements import UNCONNECTED, JobSolution, Measurement, solve_measurement
from resgrid.spice.networks.raster_networks import conductance_and_polygons
from resgrid.spice.networks.rasters import read_raster

_REFUSED = ("use_reclass_table", "compress_grids", "set_focal_node_currents_to_zero", "write_as_tif")
"""Keys of a configuration for options that are not supported: a job in which one is true raises InputError."""

_Solved = tuple[JobSolution | None, NDArray[np.int64] | None]
"""Solution of a circuit of a job, None if no current can flow, and the node of every cell, None in a network job."""


@frozen
@dataclass(frozen=True, eq=False)
class ConnectivityResult:
    r"""Resistances and currents of a Circuitscape job.

    Returned by `resgrid.spice.run_circuitscape`.

    Attributes
    ----------
    scenario : str
        ``"pairwise"``, ``"one-to-all"`` or ``"all-to-one"``.
    points : ndarray of int64, shape (points,)
        Numbers of the focal points or regions; in a network, of the focal nodes.
    resistance : ndarray of float64, shape (points, points) or (points,)
        Effective resistances in ohms, of pairs or (one-to-all) from a point to all others together; all-to-one: zeros,
        as in Circuitscape.  The entry is -1 for a pair or point that is not connected or was left out.
    cumulative_current : ndarray of float64, or None
        Sum over all solutions of the current through every cell or node (the larger of the currents into and out of
        it), in amperes, shape (rows, columns) or (nodes,); None if the configuration requests no maps.
    maximum_current : ndarray of float64, or None
        Largest current through every cell or node in any solution, in amperes, in the shape of `cumulative_current`;
        None without maps.
    files : tuple of pathlib.Path
        The written files.

    Examples
    --------
    >>> with open("habitat.asc", "w") as file:
    ...     _ = file.write("ncols 3\nnrows 1\nxllcorner 0\nyllcorner 0\ncellsize 1\n1 1 3\n")
    >>> with open("points.txt", "w") as file:
    ...     _ = file.write("1 0.5 0.5\n2 2.5 0.5\n")
    >>> with open("job.ini", "w") as file:
    ...     _ = file.write(
    ...         "scenario = pairwise\nhabitat_file = habitat.asc\nhabitat_map_is_resistances = True\n"
    ...         "connect_using_avg_resistances = True\npoint_file = points.txt\noutput_file = job.out\n"
    ...     )
    >>> rg.spice.run_circuitscape("job.ini").resistance.round(9)
    array([[0., 3.],
           [3., 0.]])
    """

    scenario: str
    points: NDArray[Any]
    resistance: NDArray[np.float64]
    cumulative_current: NDArray[np.float64] | None
    maximum_current: NDArray[np.float64] | None
    files: tuple[Path, ...] = ()


def run_circuitscape(
    path: str | os.PathLike[str],
    output: str | os.PathLike[str] | None = None,
    *,
    root: str | os.PathLike[str] | None = None,
    executor: Executor | None = None,
    progress: Count | None = None,
) -> ConnectivityResult:
    r"""Run a Circuitscape job in pairwise, one-to-all or all-to-one mode, and write its output files.

    Parameters
    ----------
    path : path-like
        Configuration file (``.ini``) of a raster job (ESRI ASCII grids, or GeoTIFF with the extra ``geotiff``) or of a
        pairwise network job.
    output : path-like, optional
        Folder of the output files, created if necessary; by default that of the key ``output_file``, which must lie
        below `root`.
    root : path-like, optional
        Folder that must contain all files named in the configuration, by default the folder of `path`.
    executor : concurrent.futures.Executor, optional
        Workers that share the solutions; by default, this process computes all of them.
    progress : callable, optional
        Called as ``progress(done, total)`` after every solution.

    Returns
    -------
    ConnectivityResult
        Resistances, cumulative and maximum currents, and the names of the files.

    Raises
    ------
    InputError
        If a file is missing or wrong, or for an option of Circuitscape that is not supported.
    ToolMissingError
        If a file is a GeoTIFF and rasterio is not installed.

    Notes
    -----
    Defaults are those of Circuitscape 5.  Files of the resistances are always written; the other files depend on the
    keys ``write_cur_maps``, ``write_volt_maps``, ``write_cum_cur_map_only`` and ``write_max_cur_maps``.  All files
    appear together when the job is finished; other files in the folder are kept.

    Examples
    --------
    >>> with open("graph.txt", "w") as file:
    ...     _ = file.write("0 1 2.0\n1 2 4.0\n")
    >>> with open("nodes.txt", "w") as file:
    ...     _ = file.write("0\n2\n")
    >>> with open("net.ini", "w") as file:
    ...     _ = file.write(
    ...         "data_type = network\nscenario = pairwise\nhabitat_file = graph.txt\npoint_file = nodes.txt\n"
    ...         "output_file = net.out\n"
    ...     )
    >>> job = rg.spice.run_circuitscape("net.ini")
    >>> float(job.resistance[0, 1]), [file.name for file in job.files]
    (6.0, ['net_resistances.out', 'net_resistances_3columns.out'])
    """
    job = read_configuration(path, root)
    if job.scenario not in CONNECTIVITY:
        hint = (
            "read it with rg.read_spice" if job.scenario == "advanced" else f"choose one of {', '.join(CONNECTIVITY)}"
        )
        raise InputError(f"{job.path}: the scenario {job.text('scenario')!r} has no focal points; {hint}")
    for key in _REFUSED:
        if job.flag(key):
            raise InputError(f"{job.path}: {key} = {job.text(key)} is not supported; remove the line")
    kind = job.text("data_type").lower()
    if kind == "network" and job.scenario != "pairwise":
        raise InputError(f"{job.path}: Circuitscape has no scenario {job.scenario!r} for networks; use pairwise")
    if kind not in ("raster", "network"):
        raise InputError(f"{job.path}: data_type = {job.text('data_type')!r} is neither 'network' nor 'raster'")
    if kind == "network":
        return _run_network(job, output, executor, progress)
    return _run_raster(job, output, executor, progress)


def _run_raster(
    job: Configuration, output: str | os.PathLike[str] | None, executor: Executor | None, progress: Count | None
) -> ConnectivityResult:
    """Run a raster job, write its output files, and return its result.

    `job`: the configuration; `output`: folder of the files, None for that of the configuration; `executor`: workers
    that share the solutions, or None; `progress`: called as ``progress(done, total)`` after every solution, or None.
    """
    habitat = read_raster(job.file("habitat_file"))
    points = read_points(job.file("point_file"), habitat)
    named, allowed = allowed_pairs(job, points.ids)
    land = Landscape(job, *conductance_and_polygons(job, habitat), points.only(named))
    with output_files(job, output, habitat, land.conductance > 0, land.conductance.shape) as files:
        return _solve_raster(land, allowed, files, executor, progress)


def _solve_raster(
    land: Landscape, allowed: NDArray[np.bool_], files: OutputFiles, executor: Executor | None,
    progress: Count | None,
) -> ConnectivityResult:  # fmt: skip
    """Solve a raster job, write its files, and return its result.

    `land`: cells and k focal points; `allowed` (k, k): mask of the pairs of focal points that are measured; `files`:
    writer of the files; `executor`: workers, None for this process; `progress`: called as ``progress(done, total)``
    after every solution, or None.
    """
    job, points, count = land.job, land.points, len(land.points.ids)
    if job.scenario == "pairwise":
        pairs = _pairs_of(allowed)
        if points.has_regions or files.wants_maps:
            names = [f"_{points.ids[i]}_{points.ids[j]}" for i, j in pairs]
            ohms = list(_solutions(land, pairs, _pair_measurement, names, files, executor, progress))
        else:
            netlist, node = land.circuit(())
            nodes = [land.node_of(node, number) for number in range(count)]
            ohms = _resistances_of(netlist, [(nodes[i], nodes[j]) for i, j in pairs], executor, progress)
        return _finished(job, points.ids, _matrix_of(count, pairs, ohms), files)
    amps = strengths_of(job, points.ids)
    jobs = [(i, *np.flatnonzero(allowed[i]).tolist()) for i in range(count)]
    make = partial(_one_to_all if job.scenario == "one-to-all" else _all_to_one, amps)
    names = [f"_{number}" for number in points.ids]
    found = np.array(list(_solutions(land, jobs, make, names, files, executor, progress)))
    if job.scenario == "all-to-one":
        found = np.where(found == UNCONNECTED, UNCONNECTED, 0.0)
    return _finished(job, points.ids, found, files)


def _finished(
    job: Configuration, points: NDArray[Any], resistance: NDArray[np.float64], files: OutputFiles
) -> ConnectivityResult:
    """Write the files of resistances and of summed currents of a job, and return its result.

    `points` (k,): numbers of the focal points; `resistance` (k, k) or (k,): in ohms, -1 if missing; `files`: writer.
    """
    files.write_resistances(points, resistance)
    files.write_sums()
    total, largest = (None, None) if files.sums is None else files.sums
    return ConnectivityResult(job.scenario, points, resistance, total, largest, tuple(files.written))


def _pairs_of(allowed: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the pairs of indices of focal points that are measured, the smaller index first.

    `allowed` (k, k): symmetric mask of pairs.
    """
    first, second = np.nonzero(np.triu(allowed, 1))
    return list(zip(first.tolist(), second.tolist(), strict=True))


def _matrix_of(count: int, pairs: list[tuple[int, int]], ohms: list[float]) -> NDArray[np.float64]:
    """Return the symmetric matrix (count, count) of resistances in ohms, with -1 for pairs without a value.

    `count`: number of focal points; `pairs`: measured pairs of indices; `ohms`: resistance of each pair. The diagonal
    is 0.
    """
    matrix = np.where(np.eye(count, dtype=np.bool_), 0.0, UNCONNECTED)
    for (i, j), value in zip(pairs, ohms, strict=True):
        matrix[i, j] = matrix[j, i] = value
    return matrix


def _resistances_of(
    netlist: Netlist, pairs: list[tuple[int, int]], executor: Executor | None, progress: Count | None
) -> list[float]:
    """Return the resistance in ohms of every pair of nodes, from one factorization.

    The value is -1 for nodes that are not connected, and for a pair with the node -1 (a focal point in a cell that does
    not conduct).  `executor`: workers, None for this process; `progress`: called as ``progress(done, total)``, or None.
    """
    within = [pair for pair in pairs if min(pair) >= 0]
    found = effective_resistance(netlist, within, executor=executor, progress=progress).resistance
    ohms = dict(zip(within, np.where(np.isfinite(found), found, UNCONNECTED).tolist(), strict=True))
    return [ohms.get(pair, UNCONNECTED) for pair in pairs]


def _solutions(
    land: Landscape, items: list[Any], make: Any, names: list[str], files: OutputFiles, executor: Executor | None,
    progress: Count | None,
) -> Iterator[float]:  # fmt: skip
    """Solve one circuit per item, write its maps, and yield its resistance in ohms, -1 if no current can flow.

    `items`: tuples of indices of focal points, a pair or one point and its partners; `make`: function that returns the
    `Measurement` (circuit, sources, grounds) of `land` and an item; `names`: for each item the end of the names of its
    maps; `executor`: workers, None for this process; `progress`: called as ``progress(done, total)``, or None.
    """
    for name, (flow, node) in zip(names, _flows(land, make, items, executor, progress), strict=True):
        assert node is not None
        if flow is not None:
            files.write_maps(name, _on_cells(flow.node_current, node), _on_cells(flow.voltage, node))
        elif land.job.scenario != "pairwise":  # as Circuitscape
            files.write_maps(name, np.zeros(node.shape), np.zeros(node.shape))
        yield UNCONNECTED if flow is None else flow.resistance


def _flows(
    shared: Any, make: Any, items: Sequence[Any], executor: Executor | None, progress: Count | None
) -> Iterator[_Solved]:
    """Yield for each item the solution of its circuit, None if no current can flow, and the node of every cell.

    `shared`: landscape or netlist; `make`: function that returns the `Measurement` (circuit, sources, grounds) of
    `shared` and an item; `items`: tuples of indices of focal points or of nodes; `executor`: workers, or None;
    `progress`: called as ``progress(done, total)``, or None.
    """
    part = JobPart(_solve_items, (shared, make), items, "solutions")
    with closing(in_order([part], executor)) as results:
        for number, result in enumerate(results, 1):
            if progress is not None:
                progress(number, len(items))
            yield result


def _on_cells(values: NDArray[np.float64], node: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the value of every cell, (rows, columns), 0 in cells without a node.

    `values` (nodes,): values of the nodes; `node` (rows, columns): node of every cell, -1 for none.
    """
    return np.where(node >= 0, values[node], 0.0)


def _solve_items(shared: tuple[Any, Any], items: Sequence[Any]) -> list[_Solved]:
    """Return the solutions of the items; `shared`: landscape or netlist, and function to the circuit of an item."""
    place, make = shared
    return [(solve_measurement(measured), measured.node) for measured in (make(place, item) for item in items)]


def _pair_measurement(land: Landscape, pair: tuple[int, int]) -> Measurement:
    """Return the circuit, source and ground of a pair of focal points: 1 A flows from the second to the first.

    `pair`: indices of the focal points.
    """
    netlist, node = land.circuit(pair)
    first, second = (land.node_of(node, number) for number in pair)
    return Measurement(netlist, (second,), (1.0,), (first,), node)


def _one_to_all(amps: NDArray[np.float64], land: Landscape, item: tuple[int, ...]) -> Measurement:
    """Return the circuit in which one focal point injects a current that flows to other points, which are at 0 V.

    `amps` (k,): current that each point injects as a source, in A; `item`: index of that point, then those of the other
    points.
    """
    netlist, node = land.circuit(item)
    ends = [land.node_of(node, number) for number in item]
    grounds = tuple(sorted({end for end in ends[1:] if end >= 0 and end != ends[0]}))
    return Measurement(netlist, (ends[0],), (float(amps[item[0]]),), grounds, node)


def _all_to_one(amps: NDArray[np.float64], land: Landscape, item: tuple[int, ...]) -> Measurement:
    """Return the circuit in which other focal points inject currents that flow to one point, which is at 0 V.

    `amps` (k,): current that each point injects, in A; `item`: index of the point at 0 V, then those of the others.
    """
    netlist, node = land.circuit(item)
    ground = land.node_of(node, item[0])
    ends = [(land.node_of(node, number), float(amps[number])) for number in item[1:]]
    sources = [(end, strength) for end, strength in ends if end >= 0 and end != ground]
    return Measurement(
        netlist, tuple(end for end, _ in sources), tuple(strength for _, strength in sources), (ground,), node
    )


def _run_network(
    job: Configuration, output: str | os.PathLike[str] | None, executor: Executor | None, progress: Count | None
) -> ConnectivityResult:
    """Run a pairwise network job, write its output files, and return its result.

    `job`: the configuration; `output`: folder of the files, None for that of the configuration; `executor`: workers
    that share the solutions, or None; `progress`: called as ``progress(done, total)`` after every solution, or None.
    """
    network = read_edges(job.file("habitat_file"), measure=job.measure("habitat_map_is_resistances"), absent_edges=True)
    netlist = Netlist(len(network.names), network.edges, network.conductance, node_names=tuple(network.names))
    ids = whole_numbers(job.file("point_file"), numbers_of(job.file("point_file"), 1).ravel())
    names = [str(number) for number in ids.tolist()]
    number_of = {name: node for node, name in enumerate(network.names)}
    missing = [name for name in names if name not in number_of]
    if missing or len(set(names)) < 2:
        words = f"its node {missing[0]} is not in the network" if missing else "a job needs two different focal nodes"
        raise InputError(f"{job.file('point_file')}: {words}")
    points, allowed = allowed_pairs(job, np.unique(ids))
    nodes = [number_of[str(number)] for number in points.tolist()]
    pairs = _pairs_of(allowed)
    wanted = [(nodes[i], nodes[j]) for i, j in pairs]
    with output_files(job, output, None, None, (netlist.node_count,)) as files:
        if not files.wants_maps:
            ohms = _resistances_of(netlist, wanted, executor, progress)
            return _finished(job, points, _matrix_of(len(points), pairs, ohms), files)
        ohms = []
        for (i, j), (flow, _) in zip(pairs, _flows(netlist, _between_nodes, wanted, executor, progress), strict=True):
            ohms.append(UNCONNECTED if flow is None else flow.resistance)
            if flow is not None:
                files.write_tables(f"_{points[i]}_{points[j]}", netlist, flow.voltage, flow.node_current,
                                   flow.resistor_current)  # fmt: skip
        return _finished(job, points, _matrix_of(len(points), pairs, ohms), files)


def _between_nodes(netlist: Netlist, pair: tuple[int, int]) -> Measurement:
    """Return the circuit, source and ground of a pair of node numbers: 1 A flows from the second to the first."""
    return Measurement(netlist, (pair[1],), (1.0,), (pair[0],), None)
