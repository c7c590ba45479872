"""Circuitscape's configurations in advanced mode: networks, and rasters of resistances.

McRae, Shah & Edelman (2016), *Circuitscape: modeling landscape connectivity to promote conservation and human health*,
and the user guide of Circuitscape 5.  Between neighbouring cells lies the mean of their resistances (or the
conductance that is the mean of their conductances); diagonal neighbours are sqrt(2) further apart.  Rasters are ESRI
ASCII grids.
"""

from __future__ import annotations

import configparser
import os
import re
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.spice.networks.edges import Measure, Network, read_edges
from resgrid.spice.read.files import deck_bytes, decode, normalise, read_text

_FLAGS = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
_CONFLICTS = ("keepall", "rmvsrc", "rmvgnd", "rmvall")
_UNSUPPORTED = ("use_mask", "use_reclass_table", "use_variable_source_strengths", "use_included_pairs")
_KEYS = frozenset({"ncols", "nrows", "xllcorner", "yllcorner", "xllcenter", "yllcenter", "cellsize", "nodata_value"})
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_LIST = re.compile(r"\s*([-+.\deE]+[ \t,]+){2}[-+.\deE]+[ \t]*\n")


@dataclass(frozen=True, eq=False)
class _Configuration:
    path: str
    folder: Path
    root: Path
    values: dict[str, str]

    def text(self, key: str, default: str | None = None) -> str:
        value = self.values.get(key, default)
        if value is None:
            raise InputError(f"{self.path}: the key {key!r} is missing")
        return value.strip()

    def flag(self, key: str) -> bool:
        word = self.text(key, "False").lower()
        if word not in _FLAGS:
            raise InputError(f"{self.path}: {key} = {word!r} is neither True nor False")
        return _FLAGS[word]

    def measure(self, key: str) -> Measure:
        return "resistance" if self.flag(key) else "conductance"

    def file(self, key: str) -> Path:
        """A file that the configuration names: as it says, or beside it."""
        name = self.text(key)
        for candidate in (self.folder / name, self.folder / Path(name.replace("\\", "/")).name):
            try:
                path = candidate.resolve()
                if path.is_relative_to(self.root) and path.is_file():
                    return path
            except (OSError, ValueError, RuntimeError):
                continue
        raise InputError(f"{self.path}: {key} = {name!r} is no file at or below {str(self.root)!r}")


def read_circuitscape(
    path: str | os.PathLike[str], *, root: str | os.PathLike[str] | None = None
) -> tuple[Network, NDArray[np.int64] | None]:
    """Read a Circuitscape configuration in advanced mode, and the files it names.

    Of a raster also the node of every cell, shape (rows, columns), top row first, -1 where there is none.
    """
    name = os.fspath(path)
    parser = configparser.ConfigParser(interpolation=None, strict=False)
    try:
        parser.read_string(read_text(path), source=name)
    except configparser.Error as error:
        raise InputError(f"{name} is no configuration: {str(error).splitlines()[0]}") from None
    values = {key: value for section in parser.sections() for key, value in parser.items(section)}
    folder = Path(name).resolve().parent
    configuration = _Configuration(name, folder, folder if root is None else Path(root).resolve(), values)
    scenario = configuration.text("scenario").lower()
    if scenario != "advanced":
        raise InputError(f"{configuration.path}: the scenario {scenario!r} is not read; only 'advanced' is one circuit")
    for key in _UNSUPPORTED:
        if configuration.flag(key):
            raise InputError(f"{configuration.path}: {key} is not understood; apply it to the files first")
    kind = configuration.text("data_type", "raster").lower()
    if kind == "raster":
        return _read_rasters(configuration)
    if kind != "network":
        raise InputError(f"{configuration.path}: data_type = {kind!r} is neither 'network' nor 'raster'")
    network = read_edges(
        configuration.file("habitat_file"),
        configuration.file("source_file"),
        configuration.file("ground_file"),
        measure=configuration.measure("habitat_map_is_resistances"),
        ground_measure=configuration.measure("ground_file_is_resistances"),
    )
    return _settled(configuration, network), None


def _settled(configuration: _Configuration, network: Network) -> Network:
    """What the options of the advanced mode make of sources and grounds."""
    amps, to_ground = network.amps, network.to_ground
    if configuration.flag("use_unit_currents"):
        amps = (amps != 0).astype(np.float64)
    if configuration.flag("use_direct_grounds"):
        to_ground = np.where(to_ground > 0, np.inf, to_ground)
    policy = configuration.text("remove_src_or_gnd", "keepall").lower()
    if policy not in _CONFLICTS:
        raise InputError(f"{configuration.path}: remove_src_or_gnd = {policy!r} is none of {', '.join(_CONFLICTS)}")
    both = (amps != 0) & (to_ground > 0)
    return replace(
        network,
        amps=np.where(both, 0.0, amps) if policy in ("rmvsrc", "rmvall") else amps,
        to_ground=np.where(both, 0.0, to_ground) if policy in ("rmvgnd", "rmvall") else to_ground,
    )


def _read_rasters(configuration: _Configuration) -> tuple[Network, NDArray[np.int64]]:
    path = configuration.file("habitat_file")
    habitat, measure = _read_raster(path), configuration.measure("habitat_map_is_resistances")
    wrong = (habitat < 0) | ((habitat == 0) & (measure == "resistance"))
    if wrong.any():
        row, column = np.argwhere(wrong)[0].tolist()
        raise InputError(
            f"{path}: the cell in row {row}, column {column} (from 0) has a {measure} of {habitat[row, column]:g}; "
            "regions without resistance are short-circuit polygons"
        )

    def raster_of(key: str) -> NDArray[np.float64]:
        other = _read_raster(configuration.file(key))
        if other.shape != habitat.shape:
            sizes = (f"{rows} x {columns} cells" for rows, columns in (other.shape, habitat.shape))
            raise InputError(f"{configuration.file(key)} has {next(sizes)}, but the habitat has {next(sizes)}")
        return other

    conductance = _siemens(habitat, measure)
    polygon = raster_of("polygon_file") if configuration.flag("use_polygons") else np.zeros(habitat.shape)
    node, names = _number_cells(conductance, polygon)
    edges, value = _links(
        conductance,
        node,
        mean_resistance=configuration.flag("connect_using_avg_resistances"),
        diagonals=not configuration.flag("connect_four_neighbors_only"),
    )
    ground = raster_of("ground_file")
    if np.any(ground < 0):
        raise InputError(f"{configuration.file('ground_file')}: a ground has a negative value")
    tied = _siemens(ground, configuration.measure("ground_file_is_resistances"))
    amps, to_ground = (
        np.asarray(np.bincount(node[node >= 0], cells[node >= 0], len(names)), dtype=np.float64)
        for cells in (_siemens(raster_of("source_file"), "conductance"), tied)
    )
    return _settled(configuration, Network(names, edges, value, amps, to_ground)), node


def _siemens(cells: NDArray[np.float64], measure: Measure) -> NDArray[np.float64]:
    """Conductance of every cell, 0 where there is nothing."""
    with np.errstate(divide="ignore"):
        return np.where(np.isnan(cells), 0.0, cells if measure == "conductance" else 1.0 / cells)


def _number_cells(
    conductance: NDArray[np.float64], polygon: NDArray[np.float64]
) -> tuple[NDArray[np.int64], list[str]]:
    """Node of every conducting cell, one for all cells of a polygon, and the names of the nodes, ground first."""
    conducts = conductance > 0
    cell = np.arange(conductance.size).reshape(conductance.shape)
    leader = cell.copy()
    for region in np.unique(polygon[(polygon > 0) & conducts]).tolist():
        members = (polygon == region) & conducts
        leader[members] = cell[members].min()
    leaders, node = np.unique(leader[conducts], return_inverse=True)
    numbers = np.full(conductance.shape, -1, dtype=np.int64)
    numbers[conducts] = node + 1
    columns = conductance.shape[1]
    return numbers, ["ground", *(f"r{one // columns}_c{one % columns}" for one in leaders.tolist())]


def _links(
    conductance: NDArray[np.float64], node: NDArray[np.int64], *, mean_resistance: bool, diagonals: bool
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Resistors between neighbouring cells: their nodes, and siemens."""
    steps: list[tuple[Any, Any, float]] = [(np.s_[:, :-1], np.s_[:, 1:], 1.0), (np.s_[:-1], np.s_[1:], 1.0)]
    if diagonals:
        far = float(np.sqrt(2.0))
        steps += [(np.s_[:-1, :-1], np.s_[1:, 1:], far), (np.s_[1:, :-1], np.s_[:-1, 1:], far)]
    pairs: list[NDArray[np.int64]] = []
    values: list[NDArray[np.float64]] = []
    for here, there, distance in steps:
        a, b = node[here].ravel(), node[there].ravel()
        joins = (a > 0) & (b > 0) & (a != b)
        x, y = conductance[here].ravel()[joins], conductance[there].ravel()[joins]
        pairs.append(np.stack([a[joins], b[joins]], axis=1))
        values.append((2.0 * x * y / (x + y) if mean_resistance else (x + y) / 2.0) / distance)
    return np.concatenate(pairs).astype(np.int32), np.concatenate(values)


def _read_raster(path: Path) -> NDArray[np.float64]:
    """Read an ESRI ASCII grid: cells (rows, columns), top row first, NaN where there is nothing."""
    data = deck_bytes(path, str(path))
    if data.startswith(_TIFF):
        raise InputError(f"{path} is a GeoTIFF, which is not read here; write it as an ESRI ASCII grid (.asc)")
    text = decode(normalise(data, str(path)))
    if _LIST.match(text):
        raise InputError(f"{path} is a list of points, which is not read here; write it as an ESRI ASCII grid (.asc)")
    words = text.split()
    keys = [key.lower() for key in takewhile(lambda word: word.lower() in _KEYS, words[::2])]
    try:
        numbers = np.array(words[1 : 2 * len(keys) : 2] + words[2 * len(keys) :], dtype=np.float64)
    except ValueError as error:
        raise InputError(f"{path}: cells and what the header says are numbers ({error})") from None
    header = dict(zip(keys, numbers.tolist(), strict=False))
    rows, columns = (header.get(key, 0.0) for key in ("nrows", "ncols"))
    if not (rows >= 1 and columns >= 1 and rows.is_integer() and columns.is_integer()):
        raise InputError(f"{path}: the header must say nrows and ncols, whole numbers of at least 1")
    cells = numbers[len(keys) :]
    if len(cells) != rows * columns:
        raise InputError(f"{path}: it holds {len(cells)} cells, but its header says {rows:g} x {columns:g}")
    if np.isinf(cells).any():
        raise InputError(f"{path}: a cell is infinite")
    cells[cells == header.get("nodata_value", -9999.0)] = np.nan
    return cells.reshape(int(rows), int(columns))
