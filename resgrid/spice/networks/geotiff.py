"""Reader and writer of GeoTIFF rasters, by the optional package rasterio."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.extras import install_command
from resgrid._internal.files import atomic_path
from resgrid.errors import InputError, ToolMissingError
from resgrid.spice.networks.ascii_grids import NODATA, Raster


def is_geotiff(path: Path) -> bool:
    """Return whether the name of a file ends with a suffix of GeoTIFF files."""
    return path.suffix.lower() in (".tif", ".tiff")


def _rasterio() -> Any:
    """Return the module rasterio; raise ToolMissingError if it is not installed."""
    try:
        import rasterio
    except ImportError as error:
        raise ToolMissingError(f"GeoTIFF needs rasterio; type: {install_command('geotiff')} ({error})") from None
    return rasterio


def read_geotiff(path: Path) -> Raster:
    """Return the first band of a GeoTIFF; raise InputError for other files and cells that are not square."""
    rasterio = _rasterio()
    try:
        with rasterio.open(path) as source:
            cells = source.read(1).astype(np.float64)
            empty, transform, crs = source.nodata, source.transform, source.crs
    except rasterio.errors.RasterioError as error:
        raise InputError(f"{path} is not a readable GeoTIFF: {error}") from None
    if transform.b or transform.d or not np.isclose(transform.a, -transform.e):
        raise InputError(f"{path}: its cells are not square or the raster is rotated; resample it")
    cells[(cells == NODATA) | (cells == (NODATA if empty is None else empty))] = np.nan
    corner = (transform.c, transform.f + transform.e * len(cells))
    return Raster(cells, corner, transform.a, {"transform": transform, "crs": crs})


def write_geotiff(path: Path, cells: NDArray[np.float64], raster: Raster) -> Path:
    """Write cells (rows, columns) as a GeoTIFF in single precision; return its path.

    `path`: path of the file; `cells`: values, top row first, `NODATA` for an empty cell; `raster`: raster whose
    georeference the file gets.
    """
    rasterio = _rasterio()
    rows, columns = cells.shape
    with atomic_path(path) as temporary, rasterio.open(
        temporary, "w", driver="GTiff", height=rows, width=columns, count=1, dtype="float32", nodata=NODATA,
        **dict(raster.profile or {}),
    ) as target:  # fmt: skip
        target.write(cells.astype(np.float32), 1)
    return path
