"""Reader of rasters: ESRI ASCII grids, and GeoTIFF by an optional package."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.spice.networks.ascii_grids import Raster, read_ascii_grid
from resgrid.spice.networks.geotiff import is_geotiff, read_geotiff


def read_raster(path: Path) -> Raster:
    """Return a raster from an ESRI ASCII grid or a GeoTIFF; raise InputError for other formats or a damaged file."""
    return read_geotiff(path) if is_geotiff(path) else read_ascii_grid(path)


def read_cells(path: Path, habitat: Raster) -> NDArray[np.float64]:
    """Return the cells of a raster file, (rows, columns), top row first, NaN for an empty cell.

    `habitat`: raster of the habitat file.  Raises InputError if the raster has another shape, and issues a warning if
    its header states another place: as in Circuitscape, cells belong together by row and column.
    """
    raster = read_raster(path)
    if raster.cells.shape != habitat.cells.shape:
        sizes = (f"{rows} x {columns} cells" for rows, columns in (raster.cells.shape, habitat.cells.shape))
        raise InputError(f"{path} has {next(sizes)}, but the habitat has {next(sizes)}")
    if _is_elsewhere(raster, habitat):
        places = (
            f"at ({each.corner[0]:.10g}, {each.corner[1]:.10g}), cell size {each.size:.10g}"
            for each in (raster, habitat)
        )
        warnings.warn(
            f"{path}: its lower left corner is {next(places)}; that of the habitat is {next(places)}. Cells are "
            "matched by row and column, as in Circuitscape; correct the header if this is not intended",
            stacklevel=2,
        )
    return raster.cells


def _is_elsewhere(raster: Raster, habitat: Raster) -> bool:
    """Return whether two rasters of equal shape differ in place by more than 1e-3 of the habitat's cell width."""
    most = 1e-3 * habitat.size
    apart = max(abs(one - other) for one, other in zip(raster.corner, habitat.corner, strict=True))
    return apart > most or max(raster.cells.shape) * abs(raster.size - habitat.size) > most
