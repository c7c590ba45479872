"""Readers of scenes: from TOML files and text, from names of map files, and from links of the live page.

A link contains a whole scene, compressed.  The cells of a map are read by `resgrid.scene.maps`.  The module also
validates a document and builds its scene (`build_scene`).
"""

from __future__ import annotations

import base64
import binascii
import json
import os
import re
import tomllib
import zlib
from collections.abc import Callable, Mapping
from itertools import chain, repeat
from math import isclose
from pathlib import Path
from typing import Any, NamedTuple

from resgrid._internal.files import decode, read_bytes
from resgrid.core.axis import Axis
from resgrid.core.frame import Frame
from resgrid.errors import InputError
from resgrid.robots import ROBOTS, Robot
from resgrid.scene.consistency import inconsistencies
from resgrid.scene.file_names import needs_files, with_absolute_files
from resgrid.scene.maps.arrays import MapCells
from resgrid.scene.maps.formats import COMMON, format_of, map_options, read_map, warn_of_header
from resgrid.scene.messages import Problem, report
from resgrid.scene.scene import IN_FILES, LISTS, Scene, check_attributes, start_point
from resgrid.scene.shipped import shipped_scene
from resgrid.scene.toml_lines import Path as KeyPath, key_lines

_LINK = re.compile(r"https?://\S*#(?:\S*&)?s=(?P<code>[^&\s]+)")
"""Pattern of a link of the live page: its fragment holds a scene's document as JSON, compressed by zlib, in base64url.
"""

_MAX_DOCUMENT_BYTES = 1 << 26
"""Largest size of the document in a link, in bytes, after decompression; links with a larger one are rejected."""


MapReader = Callable[[Mapping[str, Any], float], MapCells]
"""Function that returns the cells of a map from two arguments: the ``[map]`` table, and the extent of the robot.

The extent is the largest distance from the robot's reference point to a point of the robot, in axis units.
"""


class Document(NamedTuple):
    """The content of a scene file before validation.

    `raw`: keys and tables; `source`: name of the file, for messages; `folder`: folder to which names of map files are
    relative; `lines`: line numbers of keys by key path, empty for maps and links.
    """

    raw: dict[str, Any]
    source: str
    folder: Path
    lines: dict[KeyPath, int]


def read_scene(file: str | os.PathLike[str], **options: Any) -> Scene:
    """Read a scene: a TOML file, or a map.

    Parameters
    ----------
    file : path-like
        A scene (``.toml``), a ROS map (``.yaml``), a MovingAI map (``.map``), a voxel map (``.3dmap``), an OctoMap
        (``.bt``, ``.ot``), a point cloud (``.ply``, ``.pcd``), a NumPy array (``.npy``) or a picture; other suffixes
        are recognised by the first bytes of the file.  A warning is issued if the picture belongs to a ROS map in the
        same folder.  A name without a folder that is not a file in the current folder stands for the shipped scene of
        this name, such as ``rooms``.
    **options
        Options of the map reader: ``format``, ``dialect``, ``unknown``, ``lethal``, ``least_conductivity``,
        ``passable``, ``threshold``, ``occupied``, ``spacing``, ``scale``, ``position``, ``rotation``, ``origin``,
        ``unit``, ``periodic``, ``headings``, and of its preparation: ``crop``, ``coarsen``, ``refine``,
        ``inflate_around_unknown``.  For every scene, the keywords of `Scene.replace`, such as ``goal=(3.5, 4.5)``,
        ``k=0.5`` or ``boundary="neumann"``.

    Returns
    -------
    Scene
        The validated scene.

    Raises
    ------
    InputError
        If the scene is invalid; one message lists all problems, with key paths and lines.
    BudgetError
        If a map would not fit in memory.

    Examples
    --------
    >>> scene = rg.read_scene("lesson", k=0.5)
    >>> scene.title, scene.k, len(scene.obstacles)
    ('Eight by eight', (0.5,), 3)
    """
    map_keys = (*COMMON[1:], *map_options())
    check_attributes(options, *map_keys)
    table = {key: options.pop(key) for key in map_keys if key in options}
    scene = build_scene(*read_document(file, table))
    return scene.replace(**options) if options else scene


def read_document(file: str | os.PathLike[str], table: Mapping[str, Any]) -> Document:
    """Return the unvalidated document of a scene file or map.

    `file`: path, or name of a shipped scene; `table`: options of the map reader by name, such as ``spacing``, which
    replace keys of the ``[map]`` table.  Raises InputError for options if the scene file has no map.
    """
    path = shipped_scene(file) or Path(file)
    if path.suffix.lower() != ".toml":
        map_table = {**table, "file": path.name, "format": format_of(path, table)}
        if "format" not in table and map_table["format"] == "image":
            warn_of_header(path)
        return Document({"schema": 1, "title": path.stem, "map": map_table}, str(path), path.parent, {})
    raw, lines = _toml(decode(read_bytes(path), path), str(path))
    if table and "map" not in raw:
        raise InputError(f"{path}: this scene has no map, so {', '.join(table)} has no effect; leave it out")
    if table and isinstance(raw["map"], dict):
        raw["map"] |= table
    return Document(raw, str(path), path.parent, lines)


def parse_scene(text: str, source: str = "scene", folder: str | os.PathLike[str] = ".") -> Scene:
    """Read a scene from TOML text.

    Parameters
    ----------
    text : str
        The content of a scene file.
    source : str
        Name of the text, for messages.
    folder : path-like
        Folder to which names of map files are relative.

    Returns
    -------
    Scene
        The validated scene.

    Raises
    ------
    InputError
        If the scene is invalid; one message lists all problems, with key paths and lines.
    BudgetError
        If a map would not fit in memory.

    Examples
    --------
    >>> scene = rg.parse_scene('''
    ... schema = 1
    ... goal = [{ point = [1.8, 0.2] }]
    ... grid.axes = [
    ...   { name = "x", lower = 0, upper = 2, cells = 4, unit = "m" },
    ...   { name = "y", lower = 0, upper = 1, cells = 2, unit = "m" },
    ... ]
    ... ''')
    >>> rg.build_space(scene).cell
    array([[0, 0],
           [0, 0],
           [0, 0],
           [2, 0]], dtype=uint8)
    """
    return build_scene(*parse_document(text, source, Path(folder)))


def parse_document(text: str, source: str, folder: Path = Path()) -> Document:
    """Return the unvalidated document of a TOML text.

    `source`: name of the text, for messages; `folder`: folder to which names of map files are relative.
    """
    raw, lines = _toml(text, source)
    return Document(raw, source, folder, lines)


def is_link(text: str) -> bool:
    """Return whether a text has the form of a link of the live page (``https://...#s=...``) that contains a scene."""
    return _LINK.match(text) is not None


def read_link(text: str) -> Scene:
    """Return the validated scene that a link of the live page contains."""
    return build_scene(*link_document(text))


def link_document(text: str) -> Document:
    """Return the unvalidated document that a link of the live page contains, without network access.

    Raises InputError if the link is damaged, or if the scene in it needs files, such as a map.
    """
    match = _LINK.match(text)
    code = "" if match is None else match["code"]
    unpacking = zlib.decompressobj()
    try:
        content = unpacking.decompress(base64.urlsafe_b64decode(code + "=" * (-len(code) % 4)), _MAX_DOCUMENT_BYTES)
        document = json.loads(content) if unpacking.eof else None
    except (zlib.error, binascii.Error, ValueError, RecursionError):
        document = None
    if not isinstance(document, dict):
        raise InputError("the scene in this link is incomplete or damaged; copy the whole link again")
    if needs_files(document):
        raise InputError(
            "the scene in this link needs the file of a map, mask or obstacle, which a link cannot contain; ask for "
            "the scene file and this file"
        )
    return Document(document, "the link", Path(), {})


_REPEATED = ("obstacle", "goal", "start", "area", "hidden", "mask")
"""Keys of a scene whose tables can occur several times, with two brackets."""


def _toml(text: str, source: str) -> tuple[dict[str, Any], dict[KeyPath, int]]:
    text = text.replace("\r\n", "\n")
    try:
        return tomllib.loads(text), key_lines(text)
    except tomllib.TOMLDecodeError as error:
        last = text.rstrip("\n").split("\n")
        end = f"at line {len(last)}, column {len(last[-1]) + 1}, the end of the document"
        twice = re.match(r"Cannot declare \('(\w+)',\) twice", str(error))
        name = twice[1] if twice else ""
        hint = f"; write [[{name}]] before every {name}" if name in _REPEATED else "; join both tables" if name else ""
        raise InputError(f"{source}: this is not TOML: {str(error).replace('at end of document', end)}{hint}") from None
    except (RecursionError, ValueError) as error:
        raise InputError(f"{source}: this TOML cannot be read ({error}); check its nesting and its numbers") from None


def build_scene(
    raw: Mapping[str, Any],
    source: str,
    folder: Path,
    lines: dict[KeyPath, int] | None = None,
    known: MapCells | MapReader | None = None,
) -> Scene:
    """Return the validated scene of a document; raise one InputError that lists all problems.

    `raw`: keys and tables of the document; `source`: name of the document, for messages; `folder`: folder to which
    names of map files are relative; `lines`: line numbers by key path, None for a document without lines; `known`:
    cells of the scene's map, or the function that reads them, None if the map file must be read.
    """
    from resgrid.scene.schema import robot_of, validate

    raw = with_absolute_files(with_footprint(raw), folder)
    robot = robot_of(raw.get("robot", {}))
    raw = with_axes(raw, robot)
    document, problems, values = validate(raw)
    if robot is None:  # a valid robot might imply the missing keys of axes
        problems = [problem for problem in problems if problem[0][:1] != ("grid",) or "is missing" not in problem[1]]
    problems += _grid_or_map_problems(raw, robot)
    axes, frame, cells = _axes_of(document, None if problems else robot, folder, known)
    names = _axis_names(raw) if axes is None else [axis.name for axis in axes]
    chip, table = raw.get("chip", {}), raw.get("robot")
    has_wall = not isinstance(chip, Mapping) or "wall_resistance" in chip
    kind = ROBOTS.get(str(table.get("type", "point"))) if isinstance(table, Mapping) else None
    inconsistent = inconsistencies(document, robot or kind, axes, names, values, has_wall=has_wall)
    problems += [problem for problem in inconsistent if problem[0] not in {path for path, _ in problems}]
    if problems or robot is None or axes is None:
        raise InputError(report(problems, source, lines))
    starts = (
        start_point(start, axes, frame, f"{source}: start[{number}]") for number, start in enumerate(document.start)
    )
    attributes: dict[str, Any] = {name: tuple(getattr(document, key)) for key, name in LISTS.items()}
    attributes |= {key: getattr(document, key) for key in IN_FILES}
    return Scene(
        axes=axes,
        robot=robot,
        starts=(*document.starts, *starts),
        map=cells,
        frame=frame,
        edge=document.edge,
        source=source,
        **attributes,
    )


def _axes_of(
    document: Any, robot: Robot | None, folder: Path, known: MapCells | MapReader | None
) -> tuple[tuple[Axis, ...] | None, Frame, MapCells | None]:
    """Return axes and frame of the configuration space, and the cells of the map (None without a map).

    `document`: typed document; `robot`: None for a document with errors; then the map is not read, and the axes are
    those of the table ``[grid]``, or None without this table; `folder`: folder to which names of map files are
    relative; `known`: cells of the map, or the function that reads them, None if the map file must be read.
    """
    grid = None if document.grid is None else tuple(document.grid.axes)
    if document.map is None or robot is None:
        return grid, Frame(), None
    table = document.map.model_dump(exclude_unset=True) | {"file": str(folder.resolve() / document.map.file)}
    if grid is not None and table.get("crop") is not None:
        raise InputError(f"{table['file']}: map.crop would lose obstacles in the reach of this robot; remove crop")
    extent = robot.extent if grid is None else 0.0
    if isinstance(known, MapCells):
        cells = known if grid is not None or extent <= known.extent else read_map(table, extent)
    else:
        cells = (known or read_map)(table, extent)
    if grid is None:
        return (*cells.space_of(robot), cells)
    if not cells.frame.is_world:
        raise InputError(
            f"{table['file']}: this map is rotated (yaw {cells.frame.yaw:g}), but a robot with a [grid] of its own "
            "needs a map with yaw 0; set the third number of its origin to 0"
        )
    return grid, Frame(), cells


def _grid_or_map_problems(raw: Mapping[str, Any], robot: Robot | None) -> list[Problem]:
    if "grid" in raw and "map" in raw and (robot is None or robot.moves_in_workspace):
        return [(("map",), "a map has cells of its own, so a scene has either a [grid] or a [map]; remove one of them")]
    if "map" in raw and "grid" not in raw and robot is not None:
        try:
            robot.axes_on_map((), 1)
        except InputError as error:
            return [(("map",), str(error))]
    if "grid" not in raw and "map" not in raw:
        return [((), 'a scene needs a [grid] with axes, or a [map] with file = "..."')]
    return []


def _axis_names(raw: Mapping[str, Any]) -> list[str | None]:
    """Return the names of the axes of an unvalidated document (keys and tables); None for axes without a valid name."""
    grid = raw.get("grid")
    tables = grid.get("axes") if isinstance(grid, Mapping) else None
    tables = tables if isinstance(tables, list) else []
    names = [table.get("name") if isinstance(table, Mapping) else None for table in tables]
    return [name if isinstance(name, str) else None for name in names]


def with_footprint(raw: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a document in which the robot's key ``footprint`` is replaced by ``type = "polygon"`` and ``vertices``.

    A document without this key is returned unchanged.
    """
    robot = raw.get("robot")
    if not isinstance(robot, Mapping) or "footprint" not in robot:
        return raw
    vertices = {"type": "polygon", "vertices": robot["footprint"]}
    return {**raw, "robot": {**vertices, **{key: value for key, value in robot.items() if key != "footprint"}}}


def with_axes(raw: Mapping[str, Any], robot: Robot | None) -> Mapping[str, Any]:
    """Return a document with missing keys of its axes added from the robot and from ``grid.cells``.

    Keys that an axis has are unchanged.  `raw`: keys and tables of a scene file; `robot`: robot that implies keys of
    its axes (an arm, a turning polygon), None if the robot's table is invalid.
    """
    grid = raw.get("grid")
    if not isinstance(grid, Mapping):
        return raw
    implied = robot.implied_axes() if robot else ()
    cells, axes = grid.get("cells"), grid.get("axes")
    if axes is None and implied and cells is not None:
        axes = [{} for _ in implied]
    if not isinstance(axes, list):
        return raw
    counts = cells if isinstance(cells, list) else [cells]
    each = repeat(counts[0]) if len(counts) == 1 else chain(counts, repeat(None))
    full = [_with_implied(*parts) for parts in zip(axes, chain(implied, repeat({})), each, strict=False)]
    return {**raw, "grid": {**grid, "axes": full}}


def _with_implied(axis: Any, implied: Mapping[str, Any], cells: Any) -> Any:
    if not isinstance(axis, Mapping):
        return axis
    full = {**implied, **axis}
    if implied.get("periodic") and "periodic" not in axis and ("lower" in axis or "upper" in axis):
        spans = [(ends["lower"], ends["upper"]) for ends in (full, implied)]
        are_numbers = all(isinstance(end, int | float) for span in spans for end in span)
        full["periodic"] = are_numbers and isclose(*(high - low for low, high in spans), rel_tol=1e-9)
    if cells is not None and not {"cells", "spacing"} & set(full):
        full["cells"] = cells
    return full
