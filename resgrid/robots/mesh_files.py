"""Triangle meshes from files: STL, OBJ and PLY by trimesh, COLLADA (DAE) by a reader of its own."""

from __future__ import annotations

import io
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.extras import install_command
from resgrid._internal.files import read_bytes
from resgrid.errors import InputError, ToolMissingError
from resgrid.robots.collada import read_collada
from resgrid.robots.mesh_completeness import check_complete

FORMATS = (".stl", ".obj", ".ply", ".dae")
"""Suffixes of the supported mesh formats, in lower case."""

MAX_BYTES = 1 << 29
"""Maximum size of a mesh file, in bytes."""


def read_mesh(file: Path) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return the vertices (v, 3) and triangles (t, 3) of a mesh file, in the units of the file.

    Lengths of COLLADA files are converted to metres by the file's unit.  COLLADA's up axis is ignored, as in ROS.

    Parameters
    ----------
    file : Path
        Path of an STL, OBJ, PLY or DAE file; capital letters in the suffix do not matter.

    Returns
    -------
    points : ndarray of float64, shape (v, 3)
        Vertices of the triangles, without duplicates.
    triangles : ndarray of int32, shape (t, 3)
        Indices of the three vertices of every triangle.

    Raises
    ------
    InputError
        If the file is missing or damaged, has another format or no triangles, or a coordinate is not finite.
    ToolMissingError
        If trimesh is not installed.
    """
    suffix = file.suffix.lower()
    if suffix not in FORMATS:
        known = ", ".join(FORMATS)
        raise InputError(f"{file}: unknown mesh format {file.suffix!r}; convert the mesh to one of {known}")
    data = read_bytes(file, MAX_BYTES)
    check_complete(data, suffix, file)
    points, triangles = read_collada(data, str(file)) if suffix == ".dae" else _by_trimesh(file, data, suffix[1:])
    if not len(triangles):
        raise InputError(f"{file}: the mesh has no triangles; is it the right file?")
    if triangles.min() < 0 or triangles.max() >= len(points):
        raise InputError(f"{file}: a triangle refers to a vertex that does not exist; repair the mesh")
    used = np.unique(triangles)
    bad = used[~np.isfinite(points[used]).all(axis=1)]
    if len(bad):
        raise InputError(f"{file}: vertex {bad[0]} = {points[bad[0]].tolist()} is not finite; repair the mesh")
    return _merged(points[triangles])


def _merged(corners: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return distinct vertices (v, 3), and triangles as indices (t, 3), of triangles given by corners (t, 3, 3)."""
    points, numbers = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return points, numbers.reshape(-1, 3).astype(np.int32)


def _by_trimesh(file: Path, data: bytes, kind: str) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return the vertices and triangles that trimesh reads from the bytes of a file of a kind such as ``"stl"``."""
    try:
        trimesh: Any = import_module("trimesh")
    except ImportError:
        raise ToolMissingError(f"{file}: meshes need trimesh; install it: {install_command('robots')}") from None
    options = {"skip_materials": True, "split_objects": False} if kind == "obj" else {}
    try:
        mesh = trimesh.load(io.BytesIO(data), file_type=kind, force="mesh", process=False, **options)
        points = np.array(mesh.vertices, dtype=np.float64).reshape(-1, 3)
        return points, np.array(mesh.faces, dtype=np.int32).reshape(-1, 3)
    except (MemoryError, RecursionError):
        raise
    except Exception as error:  # trimesh raises exceptions of many classes for damaged files
        raise InputError(f"{file}: the mesh cannot be read as {kind.upper()} ({error}); export it again") from None
