"""Reader of meshes (STL, OBJ, COLLADA, PLY, OFF), and of the vertices of PLY files."""

from __future__ import annotations

import os
import re
import warnings
from io import BytesIO
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import NDArray

from resgrid._internal.extras import install_command
from resgrid._internal.files import read_bytes
from resgrid.errors import InputError, ToolMissingError
from resgrid.robots import Mesh
from resgrid.robots.mesh import MOST_PIECES
from resgrid.robots.solids import Angle, Length, SpacePoint, rigid_pose
from resgrid.scene.solids.completeness import check_complete

SUFFIXES = (".stl", ".obj", ".dae", ".ply", ".off")
"""Suffixes of mesh files."""

_UNIT = re.compile(rb"<unit\b[^>]*\bmeter\s*=\s*[\"']\s*([0-9.eE+-]+)")
"""Pattern of the unit of length of a COLLADA file, in metres."""


def read_mesh(
    file: str | os.PathLike[str],
    *,
    scale: Length = 1.0,
    position: SpacePoint = (0.0, 0.0, 0.0),
    rotation: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0),
    pieces: Annotated[int, Ge(1), Le(MOST_PIECES)] = 1,
) -> Mesh:
    r"""Read a mesh: STL, OBJ, COLLADA (``.dae``), PLY or OFF.

    All parts of the file become one mesh.  Equal vertices are merged, and triangles are oriented alike where the
    surface allows it.  A warning is issued if the surface is not closed: such a mesh has no inside.  Lengths of a
    COLLADA file are converted to metres; its ``up_axis`` is ignored, as ROS does.

    Parameters
    ----------
    file : path-like
        The file; its suffix decides the format.
    scale : float
        Factor that converts the lengths of the file to axis units, such as 0.001 for millimetres.
    position : tuple of (float, float, float)
        Position of the file's origin, in axis units.
    rotation : tuple of (float, float, float)
        Roll, pitch and yaw in radians, as in URDF: rotations about the fixed x axis, then y, then z.
    pieces : int
        Largest number of convex sets that cover the mesh in proofs for robot arms; one is the convex hull, which fills
        concavities.

    Returns
    -------
    Mesh
        The mesh.

    Raises
    ------
    InputError
        If the file is missing, damaged or empty, or its format is unknown.
    ToolMissingError
        If the package trimesh (for ``.dae`` also pycollada) is not installed.

    Examples
    --------
    >>> text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    >>> from pathlib import Path
    >>> size = Path("wedge.obj").write_text(text)
    >>> rg.maps.read_mesh("wedge.obj", scale=0.5, position=(1.0, 0.0, 0.0)).bounds
    ((1.0, 0.0, 0.0), (1.5, 0.5, 0.5))
    """
    path = Path(file)
    points, triangles = merge_equal(*load_triangles(path))
    if not len(triangles):
        raise InputError(f"{path}: this file has no triangles; export the mesh again, or read it as a point cloud")
    pose = rigid_pose(position, rotation)
    mesh = _oriented(Mesh(points * scale @ pose[:3, :3].T + pose[:3, 3], triangles.astype(np.int32), pieces))
    if not mesh.is_closed:
        warnings.warn(
            f"{path}: the surface is not closed ({mesh.open_edges} open edges), so the mesh is an obstacle without an "
            "inside; repair it, or use a box for its inside",
            stacklevel=2,
        )
    return mesh


def load_triangles(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return vertices (v, 3) and triangles (t, 3) of a mesh file, in metres for COLLADA files.

    A point cloud has no triangles.  Raises InputError for damaged files, and for coordinates that are not finite.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(
            f"{path}: {suffix or 'no suffix'} is not a format of meshes; give one of {', '.join(SUFFIXES)}"
        )
    data = read_bytes(path)
    check_complete(data, suffix, path)
    parts = _parts_of(_loaded(data, suffix, path))
    offsets = np.cumsum([0, *(len(points) for points, _ in parts)])
    points = np.concatenate([np.empty((0, 3)), *(points for points, _ in parts)])
    triangles = np.concatenate(
        [np.empty((0, 3), np.int64), *(each + first for (_, each), first in zip(parts, offsets, strict=False))]
    )
    check_points(points, path)
    unit = _UNIT.search(data) if suffix == ".dae" else None
    return points * (float(unit[1]) if unit else 1.0), triangles


def check_points(points: NDArray[np.float64], path: Path) -> None:
    """Raise InputError if there is no point, or a coordinate is not finite; `points` (n, 3) of the file `path`."""
    if not len(points):
        raise InputError(f"{path}: this file has no points; export it again")
    wrong = ~np.isfinite(points).all(axis=1)
    if wrong.any():
        number = int(np.argmax(wrong))
        raise InputError(
            f"{path}: {int(wrong.sum())} points are not finite, the first is point {number}: "
            f"{points[number].tolist()}; remove them"
        )


def merge_equal(
    points: NDArray[np.float64], triangles: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return vertices without repetition (v, 3), and triangles (t, 3) with three different vertices.

    STL files repeat every vertex in each of its triangles.  Only equal coordinates are merged.
    """
    kept, index = np.unique(points + 0.0, axis=0, return_inverse=True)  # + 0.0 turns -0.0 into 0.0
    merged = index.reshape(-1)[triangles]
    return kept, merged[(merged != np.roll(merged, 1, axis=1)).all(axis=1)]


def _loaded(data: bytes, suffix: str, path: Path) -> Any:
    """Return trimesh's value for the content of a mesh file."""
    try:
        import trimesh

        if suffix == ".dae":
            import collada  # type: ignore[import-untyped]  # noqa: F401
    except ImportError as error:
        raise ToolMissingError(
            f"{path}: reading it needs the package {error.name}; {install_command('robots')}"
        ) from None
    try:
        return trimesh.load(BytesIO(data), file_type=suffix[1:], process=False)
    except Exception as error:  # readers of damaged files raise exceptions of many types
        words = str(error).splitlines()
        raise InputError(
            f"{path}: this file cannot be read as {suffix} ({words[0] if words else type(error).__name__}); it may be "
            "damaged or cut short: export it again"
        ) from None


def _parts_of(loaded: Any) -> list[tuple[NDArray[np.float64], NDArray[np.int64]]]:
    """Return vertices (v, 3) and triangles (t, 3) of every part of trimesh's scene, mesh or point cloud."""
    if hasattr(loaded, "geometry"):
        parts = []
        for node in loaded.graph.nodes_geometry:
            pose, name = loaded.graph[node]
            for points, triangles in _parts_of(loaded.geometry[name]):
                parts.append((points @ pose[:3, :3].T + pose[:3, 3], triangles))
        return parts
    points = np.asarray(loaded.vertices, dtype=np.float64).reshape(-1, 3)
    return [(points, np.asarray(getattr(loaded, "faces", np.empty((0, 3))), dtype=np.int64).reshape(-1, 3))]


def _oriented(mesh: Mesh) -> Mesh:
    """Return a mesh whose triangles have the same orientation, if its surface is closed; otherwise the mesh itself."""
    if mesh.is_closed:
        return mesh
    import trimesh

    model = trimesh.Trimesh(mesh.points, mesh.triangles, process=False)
    if not model.is_watertight:
        return mesh
    trimesh.repair.fix_normals(model, multibody=True)  # type: ignore[no-untyped-call]
    return Mesh(mesh.points, np.asarray(model.faces, dtype=np.int32), mesh.pieces)
