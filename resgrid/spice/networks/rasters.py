"""Reader of rasters: ESRI ASCII grids, and GeoTIFF by an optional package."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.spice.networks.ascii_grids import Raster, read_ascii_grid
from resgrid.spice.networks.geotiff import is_geotiff, read_geotiff


def read_raster(path: Path) -> Raster:
    """Return a raster from an ESRI ASCII grid or a GeoTIFF; raise InputError for other formats or a damaged file."""
    return read_geotiff(path) if is_geotiff(path) else read_ascii_grid(path)


def read_cells(path: Path, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return the cells of a raster file, (rows, columns), top row first, NaN for an empty cell.

    `shape`: shape of the habitat file.  Raises InputError if the raster has another shape.
    """
    cells = read_raster(path).cells
    if cells.shape != shape:
        sizes = (f"{rows} x {columns} cells" for rows, columns in (cells.shape, shape))
        raise InputError(f"{path} has {next(sizes)}, but the habitat has {next(sizes)}")
    return cells
