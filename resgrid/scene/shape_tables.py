"""Schema of the tables of shapes in scene files: shapes by their numbers, and shapes read from files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

from annotated_types import Len
from pydantic import AfterValidator, Field, create_model

from resgrid.errors import InputError
from resgrid.robots import Ball, Box, Capsule, Cylinder, HalfSpace, Mesh, OrientedBox, Polygon, Voxels
from resgrid.robots.solids import Length
from resgrid.scene.solids.mesh_files import read_mesh
from resgrid.scene.solids.octomap import read_octomap
from resgrid.scene.solids.point_clouds import read_point_cloud
from resgrid.scene.table_models import TableModel, fields_from, meanings, value_of

REGIONS: dict[str, tuple[type, bool]] = {
    "rectangle": (Box, True),
    "box": (Box, False),
    "circle": (Ball, True),
    "sphere": (Ball, False),
    "polygon": (Polygon, True),
    "half_plane": (HalfSpace, False),
}
"""Shapes of goals by their names in files, each with a flag: whether points have exactly two coordinates."""

SHAPES: dict[str, tuple[type, bool]] = REGIONS | {
    "cylinder": (Cylinder, False),
    "capsule": (Capsule, False),
    "oriented_box": (OrientedBox, False),
}
"""Shapes of obstacles and areas by their names in files, each with a flag: whether points have two coordinates."""

READERS: dict[str, Callable[..., Mesh | Voxels]] = {
    "mesh": read_mesh,
    "point_cloud": read_point_cloud,
    "octomap": read_octomap,
}
"""Readers of shapes in files by the names of the shapes in scenes; options of a reader are keys of the table."""

_SENTENCES = {
    "mesh": "A solid or a surface of triangles in a file: STL, OBJ, COLLADA (`.dae`) or PLY.",
    "point_cloud": "All voxels of a cubic grid that contain a point of a file: PLY or PCD.",
    "octomap": "The occupied voxels of an OctoMap (`.bt` or `.ot`).",
}
"""Descriptions of the shapes in files, by name."""

_NEEDED: dict[str, dict[str, Any]] = {"mesh": {}, "point_cloud": {"resolution": Length}, "octomap": {}}
"""Types of the keys that a reader needs besides the file, by the name of the shape and by key."""


def shape_annotations(names: Mapping[str, tuple[type, bool]]) -> dict[str, Any]:
    """Return the pydantic annotations of shapes, by the names of the shapes in files.

    `names`: for every name, the class of the shape and a flag: True if its points must have two coordinates.
    """
    return {name: value_of(shape, ("shape", name), planar) for name, (shape, planar) in names.items()}


def file_annotations() -> dict[str, Any]:
    """Return the pydantic annotations of the tables of shapes that are read from files, by the names in `READERS`."""
    return {name: _file_annotation(name) for name in READERS}


def _file_annotation(name: str) -> Any:
    """Return the pydantic annotation of a shape that is read from a file; `name`: its name in scenes."""
    reader = READERS[name]
    about = meanings(reader)
    keys: dict[str, Any] = {
        "shape": (Literal[name], Field(name, description="Selects this shape.")),
        "file": (Annotated[str, Len(1)], Field(description="Name of the file, relative to the scene's folder.")),
        **{key: (hint, Field(description=about[key])) for key, hint in _NEEDED[name].items()},
        **fields_from(reader),
    }
    table: Any = create_model(f"shape_{name}", __base__=TableModel, __doc__=_SENTENCES[name], **keys)

    def fill(filled: TableModel) -> Mesh | Voxels:
        options = {key: getattr(filled, key) for key in table.model_fields if key not in ("shape", "file")}
        given = filled.model_dump(exclude_unset=True) | {"shape": name}
        try:
            return replace(_read(name, given["file"], _stamp(given["file"]), tuple(options.items())), table=given)
        except InputError as error:
            raise ValueError(str(error)) from None

    return Annotated[table, AfterValidator(fill)]


@lru_cache(maxsize=16)
def _read(name: str, file: str, stamp: tuple[int, int], options: tuple[tuple[str, Any], ...]) -> Mesh | Voxels:  # noqa: ARG001
    """Return the shape in a file; cached, so that an unchanged file is read once.

    `name`: name of the shape in scenes; `file`: path; `stamp`: time of the last change and size of the file; `options`:
    pairs of a keyword of the reader and its value.
    """
    return READERS[name](file, **dict(options))


def _stamp(file: str) -> tuple[int, int]:
    """Return time of the last change in nanoseconds and size in bytes of a file; zeros for a missing file."""
    try:
        status = Path(file).stat()
    except (OSError, ValueError):
        return 0, 0
    return status.st_mtime_ns, status.st_size
