"""Reader of point clouds, as the union of the voxels that contain a point."""

from __future__ import annotations

import os
import warnings
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.files import read_bytes
from resgrid._internal.memory import require_memory
from resgrid.errors import InputError
from resgrid.robots import Voxels
from resgrid.robots.mesh_files import import_trimesh
from resgrid.robots.ply import check_ply, count_faces
from resgrid.robots.solids import Angle, Length, SpacePoint, rigid_pose
from resgrid.scene.solids.pcd import read_pcd

_BYTES_PER_POINT = 400
"""Estimated memory in bytes per point of a cloud while its voxels are merged into boxes."""

_PCD_STARTS = (b"# .PCD", b"VERSION")
"""First bytes of PCD files."""


def read_point_cloud(
    file: str | os.PathLike[str],
    resolution: Length,
    *,
    scale: Length = 1.0,
    position: SpacePoint = (0.0, 0.0, 0.0),
    rotation: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0),
) -> Voxels:
    r"""Read a point cloud (PLY or PCD) as an obstacle: all voxels of a cubic grid that contain a point.

    Corners of voxels are multiples of the resolution.  Points of a PCD file with a coordinate NaN are omitted, because
    they mark missing echoes.

    Parameters
    ----------
    file : path-like
        The file, whose suffix is ``.ply`` or ``.pcd``.
    resolution : float
        Width of a voxel, in axis units.
    scale : float
        Factor that converts the lengths of the file to axis units, such as 0.001 for millimetres.
    position : tuple of (float, float, float)
        Position of the file's origin, in axis units.
    rotation : tuple of (float, float, float)
        Roll, pitch and yaw in radians, as in URDF: rotations about the fixed x axis, then y, then z.

    Returns
    -------
    Voxels
        The occupied voxels, merged into few boxes.

    Raises
    ------
    InputError
        If the file is missing, damaged or empty, its format is unknown, or the resolution is below 64 units in the last
        place of the largest coordinate.
    BudgetError
        If the cloud would not fit in memory.
    ToolMissingError
        If the package trimesh is not installed, for PLY files.

    Examples
    --------
    >>> head = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 2\nHEIGHT 1\nPOINTS 2\n"
    >>> from pathlib import Path
    >>> size = Path("cloud.pcd").write_text(head + "DATA ascii\n0.1 0.1 0.1\n0.1 0.3 0.1\n")
    >>> rg.maps.read_point_cloud("cloud.pcd", resolution=0.25)
    <Voxels: 2 of width 0.25 in 1 box>
    """
    path = Path(file)
    if path.suffix.lower() not in (".ply", ".pcd"):
        raise InputError(
            f"{path}: {path.suffix or 'no suffix'} is not a format of point clouds; give a .ply or .pcd file"
        )
    pose = rigid_pose(position, rotation) * [scale, scale, scale, 1.0]
    return Voxels.of_cells(cloud_cells(path, resolution, pose, _BYTES_PER_POINT), resolution)


def cloud_cells(path: Path, resolution: float, pose: NDArray[np.float64], bytes_per_point: float) -> NDArray[np.int64]:
    """Return the voxel that contains each point of a cloud, as three indices counted from the origin, shape (n, 3).

    `path`: PLY or PCD file, recognised by its first bytes; `resolution`: width of a voxel; `pose` (4, 4):
    transformation from coordinates of the file to those of the voxels; `bytes_per_point`: memory per point of the
    cloud, for the check against the available memory.
    """
    first = read_bytes(path, first=7)
    if path.suffix.lower() == ".ply" and not first.startswith((b"ply", *_PCD_STARTS)):
        raise InputError(f"{path}: this is not a PLY file: its first line is not ply; save the cloud again")
    points = _ply_points(path) if first.startswith(b"ply") else read_pcd(path)
    _check_points(points, path)
    require_memory(len(points) * bytes_per_point, f"{path}: {len(points)} points", "thin the cloud")
    points = points @ pose[:3, :3].T + pose[:3, 3]
    least = 64 * float(np.spacing(np.abs(points).max()))
    if resolution < least:
        raise InputError(
            f"{path}: voxels of {resolution:g} are too narrow for floating point at coordinates up to "
            f"{np.abs(points).max():g}; give a resolution of at least {least:.2g}"
        )
    return np.floor(points / resolution).astype(np.int64)


def _ply_points(path: Path) -> NDArray[np.float64]:
    """Return the vertices (n, 3) of a PLY file, in units of the file; a warning is issued if the file has faces."""
    data = read_bytes(path)
    check_ply(data, str(path))
    faces = count_faces(data)
    if faces:
        warnings.warn(
            f"{path}: of this mesh of {faces} faces only vertices count, and the space between them is free; sample "
            'points of the surface, or use the mesh as an obstacle (shape = "mesh")',
            stacklevel=2,
        )
    trimesh = import_trimesh(path, "ply")
    try:
        loaded = trimesh.load(BytesIO(data), file_type="ply", process=False)
        points = getattr(loaded, "vertices", ())  # trimesh returns an empty scene for a file without points
        return np.array(points, dtype=np.float64).reshape(-1, 3)
    except MemoryError:
        raise
    except Exception as error:  # trimesh raises exceptions of many classes for damaged files
        raise InputError(f"{path}: the cloud cannot be read as PLY ({error}); save it again") from None


def _check_points(points: NDArray[np.float64], path: Path) -> None:
    """Raise InputError if there is no point, or a coordinate is not finite; `points` (n, 3) of the file `path`."""
    if not len(points):
        raise InputError(f"{path}: this file has no points; save the cloud again")
    wrong = ~np.isfinite(points).all(axis=1)
    if wrong.any():
        number = int(np.argmax(wrong))
        raise InputError(
            f"{path}: {int(wrong.sum())} points are not finite, the first is point {number}: "
            f"{points[number].tolist()}; remove them"
        )
