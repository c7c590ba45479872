"""Triangle meshes from files: STL, OBJ and COLLADA (DAE) by strict readers of the project, PLY by trimesh."""

from __future__ import annotations

import io
import logging
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.extras import install_command
from resgrid._internal.files import read_bytes
from resgrid.errors import InputError, ToolMissingError
from resgrid.robots.collada import read_collada
from resgrid.robots.obj import read_obj
from resgrid.robots.ply import check_ply
from resgrid.robots.stl import read_stl

FORMATS = (".stl", ".obj", ".ply", ".dae")
"""Suffixes of the supported mesh formats, in lower case."""

MAX_BYTES = 1 << 29
"""Maximum size of a mesh file, in bytes; larger files raise InputError."""


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
        If the file is PLY, and trimesh is not installed.
    """
    suffix = file.suffix.lower()
    if suffix not in FORMATS:
        known = ", ".join(FORMATS)
        raise InputError(f"{file}: unknown mesh format {file.suffix!r}; convert the mesh to one of {known}")
    data = read_bytes(file, MAX_BYTES)
    if suffix == ".obj":
        points, triangles = read_obj(data, str(file))
    elif suffix == ".stl":
        corners = read_stl(data, str(file)).reshape(-1, 3)
        points, triangles = corners, np.arange(len(corners), dtype=np.int32).reshape(-1, 3)
    elif suffix == ".dae":
        points, triangles = read_collada(data, str(file))
    else:
        check_ply(data, str(file))
        points, triangles = _read_ply(file, data)
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


def import_trimesh(file: Path, kind: str) -> Any:
    """Return the module trimesh, whose log messages are not printed; raise ToolMissingError if it is not installed.

    Without a handler, Python prints the tracebacks that trimesh logs for damaged files.
    `file`, `kind`: path and format (such as ``"PLY"``) of the file, for the message.
    """
    try:
        trimesh: Any = import_module("trimesh")
    except ImportError:
        raise ToolMissingError(
            f"{file}: {kind.upper()} files need trimesh; install it: {install_command('robots')}"
        ) from None
    log = logging.getLogger("trimesh")
    if not log.handlers:
        log.addHandler(logging.NullHandler())
    return trimesh


def _read_ply(file: Path, data: bytes) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return the vertices (v, 3) and triangles (t, 3) that trimesh reads from the bytes of a PLY file.

    Raises InputError for a damaged file. `file`: path of the file, for messages.
    """
    trimesh = import_trimesh(file, "ply")
    try:
        mesh = trimesh.load(io.BytesIO(data), file_type="ply", force="mesh", process=False)
        points = np.array(mesh.vertices, dtype=np.float64).reshape(-1, 3)
        return points, np.array(mesh.faces, dtype=np.int32).reshape(-1, 3)
    except (MemoryError, RecursionError):
        raise
    except Exception as error:  # trimesh raises exceptions of many classes for damaged files
        raise InputError(f"{file}: the mesh cannot be read as PLY ({error}); export it again") from None
