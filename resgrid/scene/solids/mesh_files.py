"""`read_mesh`: a mesh file (STL, OBJ, COLLADA or PLY) as an obstacle in space."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le

from resgrid.errors import InputError
from resgrid.robots import Mesh
from resgrid.robots.mesh import MOST_PIECES
from resgrid.robots.mesh_files import import_trimesh, read_mesh as read_triangles
from resgrid.robots.solids import Angle, Length, SpacePoint, rigid_pose


def read_mesh(
    file: str | os.PathLike[str],
    *,
    scale: Length = 1.0,
    position: SpacePoint = (0.0, 0.0, 0.0),
    rotation: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0),
    pieces: Annotated[int, Ge(1), Le(MOST_PIECES)] = 1,
) -> Mesh:
    r"""Read a mesh: STL, OBJ, COLLADA (``.dae``) or PLY.

    All parts of the file become one mesh.  Equal vertices are merged, and triangles are oriented alike where the
    surface allows it.  A warning is issued if the surface is not closed: parts that are not closed have no inside.
    Lengths of a COLLADA file are converted to metres; its ``up_axis`` is ignored, as ROS does.

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
        If the file is PLY, or its triangles must be turned, and the package trimesh is not installed.

    Examples
    --------
    >>> text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    >>> from pathlib import Path
    >>> size = Path("wedge.obj").write_text(text)
    >>> rg.maps.read_mesh("wedge.obj", scale=0.5, position=(1.0, 0.0, 0.0)).bounds
    ((1.0, 0.0, 0.0), (1.5, 0.5, 0.5))
    """
    path = Path(file)
    points, triangles = read_triangles(path)
    triangles = triangles[(triangles != np.roll(triangles, 1, axis=1)).all(axis=1)]
    if not len(triangles):
        raise InputError(f"{path}: every triangle of this mesh is a line or a point; export the mesh again")
    pose = rigid_pose(position, rotation)
    mesh = _oriented(Mesh(points * scale @ pose[:3, :3].T + pose[:3, 3], triangles, pieces), path)
    if not mesh.is_closed:
        warnings.warn(
            f"{path}: the surface is not closed ({mesh.open_edges} open edges); the parts with open edges are "
            "obstacles without an inside: repair them, or cover the inside by another obstacle",
            stacklevel=2,
        )
    return mesh


def _oriented(mesh: Mesh, path: Path) -> Mesh:
    """Return a mesh with equally oriented triangles if each edge has two triangles; otherwise the mesh itself.

    A closed mesh, whose triangles are equally oriented already, is also returned unchanged.  `path`: name of the file,
    for messages.
    """
    edges = np.sort(np.concatenate([mesh.triangles, np.roll(mesh.triangles, -1, axis=1)]).reshape(2, -1).T, axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    if mesh.is_closed or (count != 2).any():
        return mesh
    trimesh = import_trimesh(path, path.suffix[1:])
    model = trimesh.Trimesh(mesh.points, mesh.triangles, process=False)
    trimesh.repair.fix_normals(model, multibody=True)
    return Mesh(mesh.points, np.asarray(model.faces, dtype=np.int32), mesh.pieces)
