"""Output files of Circuitscape jobs: matrices of resistances, maps of currents and voltages, tables of networks.

Names, columns and numbers are those of Circuitscape.jl 5, except for two: nodes of a network have the numbers of the
user's files (Circuitscape 5 adds 1), and the one-column results of one-to-all and all-to-one mode have a file, as in
Circuitscape 4.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.files import files_together, write_text
from resgrid.core.netlist import Netlist
from resgrid.errors import InputError
from resgrid.spice.networks.ascii_grids import NODATA, Raster
from resgrid.spice.networks.configurations import Configuration
from resgrid.spice.networks.geotiff import write_geotiff

_DECIMALS = 8
"""Number of decimal places to which the cell values of a written ASCII grid are rounded."""


@contextmanager
def output_files(
    job: Configuration,
    output: str | os.PathLike[str] | None,
    habitat: Raster | None,
    conducting: NDArray[np.bool_] | None,
    shape: tuple[int, ...],
) -> Iterator[OutputFiles]:
    """Yield the writer of the output files of a Circuitscape job; all files appear at the end of the ``with`` block.

    After an error no file appears. `output`: folder of the files, None for that of the key ``output_file``; `habitat`:
    raster whose format and georeference the maps get, None for a network; `conducting` (rows, columns): whether a cell
    conducts, None for a network; `shape`: shape of the currents, (rows, columns) or (nodes,). Raises InputError if the
    key names a file outside the folder `Configuration.root`, or in a folder that does not exist.
    """
    base = Path(job.base().replace("\\", "/"))
    place = job.folder / base if output is None else Path(output) / base.name
    if output is None and not place.resolve().is_relative_to(job.root):
        raise InputError(
            f"{job.path}: output_file = {job.text('output_file')!r} lies outside {str(job.root)!r}; name a folder for "
            "the output files by -o FOLDER (in Python: output=)"
        )
    if output is None and not place.parent.is_dir():
        raise InputError(
            f"{job.path}: output_file = {job.text('output_file')!r} is in no existing folder; make "
            f"{str(place.parent)!r} first"
        )
    with files_together(place.parent) as folder:
        files = OutputFiles(job, place, folder, habitat, conducting)
        if files.wants_maps:
            files.sums = np.zeros((2, *shape))
        yield files


@dataclass(eq=False)
class OutputFiles:
    """Writer of the output files of a Circuitscape job, which also sums the currents of all solutions.

    `job`: the configuration; `place`: path with which the final names of the files begin; `folder`: temporary folder of
    the files; `habitat`: raster whose format and georeference the maps get, None for a network; `conducting` (rows,
    columns): whether a cell conducts, None for a network; `written`: final names of the files written so far; `sums`
    (2, rows, columns) or (2, nodes): sum and maximum, over the solutions so far, of the current of every cell or node
    (the larger of its inflow and outflow), in amperes; None if the configuration requests no maps.
    """

    job: Configuration
    place: Path
    folder: Path
    habitat: Raster | None
    conducting: NDArray[np.bool_] | None
    written: list[Path] = field(default_factory=list)
    sums: NDArray[np.float64] | None = None

    @property
    def wants_maps(self) -> bool:
        """Whether the job needs the voltages or currents of the solutions, and not only resistances."""
        keys = ("write_cur_maps", "write_volt_maps", "write_cum_cur_map_only", "write_max_cur_maps")
        return any(self.job.flag(key) for key in keys)

    def _new(self, end: str) -> Path:
        """Record a file whose name ends with `end` as written, and return its path in the temporary folder."""
        self.written.append(self.place.with_name(f"{self.place.name}_{end}"))
        return self.folder / self.written[-1].name

    def _file(self, end: str, text: str) -> None:
        """Write a text file; `end`: end of its name."""
        write_text(self._new(end), text)

    def write_resistances(self, points: NDArray[Any], resistance: NDArray[np.float64]) -> None:
        """Write the file of resistances, and for a matrix a second file with one pair of focal points per line.

        `points` (k,): numbers of the focal points; `resistance` (k, k): of pairs of points, or (k,): one value per
        point, in ohms, -1 for a missing value.
        """
        ids = points.astype(np.float64)
        if resistance.ndim == 1:
            self._file("resistances.out", table_text(np.stack([ids, resistance], axis=1), " "))
            return
        first, second = np.triu_indices(len(ids), 1)
        matrix = np.block([[np.zeros((1, 1)), ids[None]], [ids[:, None], resistance]])
        self._file("resistances.out", table_text(matrix, " "))
        columns = np.stack([ids[first], ids[second], resistance[first, second]], axis=1)
        self._file("resistances_3columns.out", table_text(columns, " "))

    def _add(self, current: NDArray[np.float64]) -> None:
        """Update the sum and the maximum in `sums` with the currents of one solution, if maps are requested.

        `current` (rows, columns) or (nodes,): in amperes.
        """
        if self.sums is not None:
            self.sums[0] += current
            np.maximum(self.sums[1], current, out=self.sums[1])

    def write_maps(self, name: str, current: NDArray[np.float64], voltage: NDArray[np.float64]) -> None:
        """Write the maps of one solution that the configuration requests, and add the currents to `sums`.

        `name`: end of the file names, such as ``_1_2``; `current`, `voltage` (rows, columns): in A and V.
        """
        self._add(current)
        if self.job.flag("write_cur_maps") and not self.job.flag("write_cum_cur_map_only"):
            self._grid(f"curmap{name}", current, of_current=True)
        if self.job.flag("write_volt_maps"):
            self._grid(f"voltmap{name}", voltage, of_current=False)

    def write_sums(self) -> None:
        """Write the maps of the sum and of the maximum of the currents over all solutions, if the job requests them.

        A network has no maps, so that nothing is written.
        """
        if self.sums is None or self.habitat is None:
            return
        total, largest = self.sums
        if self.job.flag("write_cur_maps") or self.job.flag("write_cum_cur_map_only"):
            self._grid("cum_curmap", total, of_current=True)
        if self.job.flag("write_max_cur_maps"):
            self._grid("max_curmap", largest, of_current=True)

    def _grid(self, end: str, cells: NDArray[np.float64], *, of_current: bool) -> None:
        """Write a map in the format of the habitat raster, ASCII grid or GeoTIFF.

        `end`: end of the file name; `cells` (rows, columns): values, in A or V; `of_current`: whether the values are
        currents or voltages.  With ``log_transform_maps`` currents become log10, and a current of 0 becomes NODATA.
        With ``set_null_currents_to_nodata`` or ``set_null_voltages_to_nodata``, cells that do not conduct become
        NODATA.
        """
        assert self.habitat is not None and self.conducting is not None
        if of_current and self.job.flag("log_transform_maps"):
            with np.errstate(divide="ignore"):
                cells = np.where(cells > 0, np.log10(cells), NODATA)
        key = "set_null_currents_to_nodata" if of_current else "set_null_voltages_to_nodata"
        if self.job.flag(key):
            cells = np.where(self.conducting, cells, NODATA)
        if self.habitat.profile is None:
            self._file(f"{end}.asc", grid_text(cells, self.habitat))
            return
        write_geotiff(self._new(f"{end}.tif"), cells, self.habitat)

    def write_tables(
        self, name: str, netlist: Netlist, voltage: NDArray[np.float64], node_current: NDArray[np.float64],
        resistor_current: NDArray[np.float64],
    ) -> None:  # fmt: skip
        """Write the requested tables of one solution of a network: node voltages, and node and branch currents.

        The tables omit nodes without resistors, such as node 0 (``ground``) of most networks.  The node currents are
        added to `sums`.  `name`: end of the file names; `voltage`, `node_current` (nodes,), `resistor_current`
        (resistors,): in V and A.
        """
        self._add(node_current)
        used = np.unique(netlist.resistor_nodes)
        ids = np.full(netlist.node_count, -1.0)
        ids[used] = [float(word) for word in netlist.names_of(used)]
        order = used[np.argsort(ids[used])]
        if self.job.flag("write_volt_maps"):
            self._file(f"voltages{name}.txt", table_text(np.stack([ids[order], voltage[order]], axis=1)))
        if self.job.flag("write_cur_maps") and not self.job.flag("write_cum_cur_map_only"):
            self._file(f"node_currents{name}.txt", table_text(np.stack([ids[order], node_current[order]], axis=1)))
            self._file(f"branch_currents{name}.txt", table_text(_branches(netlist, ids, resistor_current)))


def _branches(netlist: Netlist, ids: NDArray[np.float64], current: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the table of branch currents (branches, 3): numbers of both nodes, the smaller first, and magnitude in A.

    `ids` (nodes,): number of every node in the user's files; `current` (resistors,): in A. Parallel resistors are one
    branch with the sum of the magnitudes of their currents.
    """
    low, high = np.sort(ids[netlist.resistor_nodes], axis=1).T
    pairs, branch = np.unique(np.stack([high, low], axis=1), axis=0, return_inverse=True)
    amps = np.bincount(branch.ravel(), np.abs(current), len(pairs))
    return np.stack([pairs[:, 1], pairs[:, 0], amps], axis=1)


def number_text(value: float) -> str:
    """Return a number as Julia prints it: its shortest digits, with an exponent for large and small magnitudes.

    The exponent is written for magnitudes of at least 1e6, and for those below 1e-4 except 0.
    """
    text = repr(float(value))
    if not np.isfinite(value) or value == 0.0 or 1e-4 <= abs(value) < 1e6:
        return text
    digits, _, exponent = f"{value!r}".partition("e")
    if not exponent:
        digits, _, exponent = np.format_float_scientific(value, unique=True, trim="0").partition("e")
    return f"{digits if '.' in digits else digits + '.0'}e{int(exponent)}"


def table_text(rows: NDArray[np.float64], separator: str = "\t") -> str:
    """Return the text of a table of numbers; `rows` (n, columns): one line each; `separator`: text between numbers."""
    return "".join(separator.join(map(number_text, row)) + "\n" for row in rows.tolist())


def grid_text(cells: NDArray[np.float64], place: Raster) -> str:
    """Return the text of an ESRI ASCII grid.

    `cells` (rows, columns): values, top row first, `NODATA` for an empty cell; `place`: raster with the same lower left
    corner and cell width.
    """
    rows, columns = cells.shape
    header = {
        "ncols": columns, "nrows": rows, "xllcorner": number_text(place.corner[0]),
        "yllcorner": number_text(place.corner[1]), "cellsize": number_text(place.size),
        "NODATA_value": number_text(NODATA),
    }  # fmt: skip
    head = "".join(f"{key:13} {value}\n" for key, value in header.items())
    return head + table_text(np.round(cells, _DECIMALS) + 0.0, " ")  # + 0.0 removes the sign of -0.0
