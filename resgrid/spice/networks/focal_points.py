"""Readers of the focal points of a Circuitscape job: their cells, the pairs to measure, and their source strengths.

Resistances are measured between focal points: cells, regions of cells, or nodes of a network.  The module also reads
text files that consist of numbers.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.spice.networks.ascii_grids import Raster
from resgrid.spice.networks.configurations import Configuration
from resgrid.spice.networks.geotiff import is_geotiff
from resgrid.spice.networks.rasters import read_cells
from resgrid.spice.read.files import read_text

_MOST = 2.0**53
"""Largest accepted magnitude of a whole number; double precision represents every whole number up to this one."""


@dataclass(frozen=True, eq=False)
class FocalPoints:
    """Focal points of a Circuitscape raster job, each of one cell or of several cells (a region).

    Resistances are measured between focal points.  `ids` (k,): different numbers of the points, increasing; `cells`:
    for every point its flat cell indices (row, from 0 at the top, times number of columns plus column).  Cells from a
    raster are sorted by column and then by row, those from a list of places have the order of the list.
    """

    ids: NDArray[np.int64]
    cells: tuple[NDArray[np.int64], ...]

    @property
    def has_regions(self) -> bool:
        """Whether a focal point has several cells."""
        return any(len(cells) > 1 for cells in self.cells)

    def only(self, ids: NDArray[np.int64]) -> FocalPoints:
        """Return the focal points whose numbers are among `ids`."""
        kept = np.isin(self.ids, ids)
        return FocalPoints(self.ids[kept], tuple(cells for cells, keep in zip(self.cells, kept, strict=True) if keep))


def numbers_of(path: Path, columns: int | None, *, skip: int = 0) -> NDArray[np.float64]:
    """Return the numbers of a text file, (lines, columns); raise InputError, which names the line, for other words.

    `path`: the file; `columns`: number of numbers per line, None for that of the first line with numbers; `skip`:
    number of lines at the beginning of the file that are not read.
    """
    rows: list[list[float]] = []
    for number, line in enumerate(read_text(path).split("\n")[skip:], skip + 1):
        words = line.replace(",", " ").split()
        if not words:
            continue
        try:
            row = [float(word.replace("_", "?")) for word in words]  # float() would skip the mark
        except ValueError:
            raise InputError(f"{path}:{number}: {line.strip()[:80]!r} does not consist of numbers") from None
        count = columns or (len(rows[0]) if rows else len(row))
        if len(row) != count or not np.isfinite(row).all():
            raise InputError(f"{path}:{number}: expected {count} finite numbers, got {line.strip()[:80]!r}")
        rows.append(row)
    return np.array(rows, dtype=np.float64).reshape(len(rows), len(rows[0]) if rows else columns or 0)


def whole_numbers(path: Path, values: NDArray[np.float64], kind: str = "focal point") -> NDArray[np.int64]:
    """Return the values of a file as integers; raise InputError unless they are whole, with magnitudes up to 2**53.

    `path`: the file, for the message; `values`: its numbers, of any shape; `kind`: noun for the numbered objects in the
    message.
    """
    wrong = (values != np.rint(values)) | (np.abs(values) > _MOST)
    if wrong.any():
        raise InputError(f"{path}: the number of a {kind}, {values[wrong][0]:g}, is not a whole number up to 2**53")
    return values.astype(np.int64)


def read_points(path: Path, habitat: Raster) -> FocalPoints:
    """Return the focal points of a raster, or of a text file with lines ``number x y`` (map coordinates of `habitat`).

    An empty cell, and a cell or line with the number 0 or less, is no focal point; lines with such a number cause a
    warning.  (In a raster Circuitscape takes 0 for an empty cell.  In a list it reads a point 0, but uses 0 for cells
    outside all regions and for the corner of the table of resistances.)  Cells or lines of one number form a region.
    `path`: the file; `habitat`: raster of the job.  Raises InputError for a place outside the habitat, and for fewer
    than two points.
    """
    rows, columns = habitat.cells.shape
    is_raster = _is_raster(path)
    if is_raster:
        number = np.nan_to_num(read_cells(path, habitat))
        column, row = np.nonzero(number.T > 0)
        ids, left_out = number[row, column], np.unique(number[number <= 0])
    else:
        ids, x, y = numbers_of(path, 3).T
        row = np.ceil(rows - (y - habitat.corner[1]) / habitat.size) - 1
        column = np.ceil((x - habitat.corner[0]) / habitat.size) - 1
        outside = (row < 0) | (column < 0) | (row >= rows) | (column >= columns)
        if outside.any():
            first = int(np.argmax(outside))
            raise InputError(
                f"{path}: focal point {ids[first]:g} at ({x[first]:g}, {y[first]:g}) is not on the habitat"
            )
        left_out = np.unique(ids[ids <= 0])
        row, column, ids = row[ids > 0], column[ids > 0], ids[ids > 0]
    numbers = whole_numbers(path, ids)
    flat = (row * columns + column).astype(np.int64)
    different = np.unique(numbers)
    _report_left_out(path, left_out, len(different), is_raster=is_raster)
    return FocalPoints(different, tuple(flat[numbers == one] for one in different))


def _report_left_out(path: Path, numbers: NDArray[np.float64], count: int, *, is_raster: bool) -> None:
    """Raise InputError for fewer than two focal points, and warn of lines that are no focal points.

    `path`: the file; `numbers`: different numbers of 0 or less in the file, ascending; `count`: number of focal points;
    `is_raster`: whether the file is a raster, in which such numbers are usual for empty cells.
    """
    reason = ""
    if numbers.size:
        reason = f"the number {numbers[-1]:g} is no focal point; number the points from 1"
    if count < 2:
        raise InputError(f"{path}: a job needs at least two focal points, got {count}" + (reason and f": {reason}"))
    if reason and not is_raster:
        warnings.warn(f"{path}: {reason}", stacklevel=2)


def _is_raster(path: Path) -> bool:
    """Return whether a file is a GeoTIFF or an ASCII grid, and not a list of points."""
    return is_geotiff(path) or read_text(path).lstrip()[:5].lower() == "ncols"


def allowed_pairs(job: Configuration, ids: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the numbers (k,) of the focal points that take part, and the mask (k, k) of the pairs that are measured.

    All points and pairs take part unless the configuration `job` names a file that includes or excludes pairs. Then
    points that are not in the file do not take part, even if the file lists the pairs to exclude. The numbers ascend;
    the mask is symmetric, with False on the diagonal. `ids` (n,): numbers of all points, ascending. Raises InputError
    for an invalid file, and if fewer than two points remain.
    """
    if not job.flag("use_included_pairs"):
        return ids, ~np.eye(len(ids), dtype=np.bool_)
    path = job.file("included_pairs_file")
    head = read_text(path).split(None, 2)
    if head[:1] == ["mode"] and len(head) > 1:
        if head[1] not in ("include", "exclude"):
            raise InputError(f"{path}:1: mode {head[1]!r} is neither include nor exclude")
        listed = whole_numbers(path, numbers_of(path, 2, skip=1))
        named = np.unique(listed[listed != 0])
        chosen = np.zeros((len(named), len(named)), dtype=np.bool_)
        both = (listed != 0).all(axis=1)
        first, second = np.searchsorted(named, listed[both]).T
        chosen[first, second] = chosen[second, first] = True
        included = chosen if head[1] == "include" else ~chosen
    elif head[:1] == ["min"]:
        lines = read_text(path).split("\n")
        try:
            least, most = (float(line.split()[1]) for line in lines[:2])
        except (IndexError, ValueError):
            raise InputError(f"{path}:1: the first two lines are not 'min' and 'max' with one number each") from None
        table = numbers_of(path, None, skip=2)
        if not table.size:
            raise InputError(f"{path}: the table of pairs is empty; add a row with the numbers of the points")
        named, value = whole_numbers(path, table[1:, 0]), table[1:, 1:]
        if value.shape != (len(named), len(named)):
            raise InputError(f"{path}: the table has {value.shape[0]} rows and {value.shape[1]} columns of values")
        _check_heading(path, named, table[0, 1:])
        within = (value >= least) & (value <= most)
        included = within | within.T
        order = np.argsort(named)
        named, included = named[order], included[np.ix_(order, order)]
    else:
        raise InputError(f"{path}: its first line is neither 'mode include', 'mode exclude' nor 'min' with a number")
    kept = np.isin(named, ids)
    if np.count_nonzero(kept) < 2:
        raise InputError(f"{path}: fewer than two of its points are focal points; correct the numbers")
    return named[kept], included[np.ix_(kept, kept)] & ~np.eye(int(kept.sum()), dtype=np.bool_)


def _check_heading(path: Path, rows: NDArray[np.int64], columns: NDArray[np.float64]) -> None:
    """Raise InputError unless the rows of a table of pairs have different numbers, and its columns the same, in order.

    `path`: the file; `rows, columns` (k,): numbers of the points at the beginning of the rows and of the columns.
    """
    numbers, counts = np.unique(rows, return_counts=True)
    if (counts > 1).any():
        raise InputError(f"{path}: the table has two rows for the point {numbers[counts > 1][0]}; delete one of them")
    different = np.flatnonzero(rows != columns)
    if different.size:
        first = int(different[0])
        raise InputError(
            f"{path}: row {first + 1} of the table belongs to the point {rows[first]}, but column {first + 1} to the "
            f"point {columns[first]:g}; write the points in the same order"
        )


def strengths_of(job: Configuration, ids: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the current that each focal point injects as a source, in A, (k,).

    The current is 1 A unless the configuration names a file of source strengths that contains the point. `ids` (k,):
    numbers of the points.
    """
    amps = np.ones(len(ids))
    if job.flag("use_variable_source_strengths"):
        for number, value in numbers_of(job.file("variable_source_file"), 2):
            amps[ids == number] = value
    return amps
