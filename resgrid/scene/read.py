"""Scenes read from files: TOML scenes, and maps of every known format."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path
from typing import Any

from resgrid.errors import InputError
from resgrid.files import decode, read_bytes
from resgrid.scene.build import build_scene
from resgrid.scene.maps.formats import COMMON, FORMATS, format_of
from resgrid.scene.overrides import apply_overrides
from resgrid.scene.scene import Scene
from resgrid.scene.toml_lines import key_lines

MAP_OPTIONS = (*COMMON[1:], *dict.fromkeys(option for entry in FORMATS.values() for option in entry.options))


def read_scene(path: str | os.PathLike[str], **options: Any) -> Scene:
    """Read a scene: a TOML file, or a map.

    Parameters
    ----------
    path : path-like
        ``.toml`` is a scene; ``.yaml`` a ROS map, ``.map`` a MovingAI map, ``.npy`` an array, pictures are plain maps.
        Anything else is recognised by its first bytes.
    **options
        For maps, how to read them: ``format``, ``dialect``, ``unknown``, ``lethal``, ``passable``, ``threshold``,
        ``spacing``, ``origin``, ``unit``.  For every scene, keys to change as in `apply_overrides`, such as
        ``goal=(3.5, 4.5)`` or ``boundary="neumann"``.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        If anything is wrong; one message lists it all, with lines.
    BudgetError
        If a map would not fit in memory.
    """
    file = Path(path)
    if file.suffix.lower() == ".toml":
        scene = parse_scene(decode(read_bytes(file), file), str(file), file.parent)
        changes = {f"map.{key}" if key in MAP_OPTIONS else key: value for key, value in options.items()}
    else:
        table = {key: options.pop(key) for key in MAP_OPTIONS if key in options}
        table["format"] = format_of(file, table)
        table = {key: list(value) if isinstance(value, tuple) else value for key, value in table.items()}
        raw = {"schema": 1, "title": file.stem, "map": {"file": file.name, **table}}
        scene = build_scene(raw, str(file), file.parent)
        changes = options
    return apply_overrides(scene, changes) if changes else scene


def parse_scene(text: str, source: str = "scene", folder: str | os.PathLike[str] = ".") -> Scene:
    """Read a scene from TOML text.

    Parameters
    ----------
    text : str
        The content of a scene file.
    source : str
        Its name, for messages.
    folder : path-like
        Where the names of map files start.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        If anything is wrong; one message lists it all, with lines.
    BudgetError
        If a map would not fit in memory.
    """
    text = text.replace("\r\n", "\n")
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        last = text.rstrip("\n").split("\n")
        end = f"at line {len(last)}, column {len(last[-1]) + 1}, the end of the document"
        raise InputError(f"{source}: this is not TOML: {str(error).replace('at end of document', end)}") from None
    except (RecursionError, ValueError) as error:
        raise InputError(f"{source}: this is not TOML that can be read ({error})") from None
    return build_scene(raw, source, Path(folder), key_lines(text))


def scene_schema() -> dict[str, Any]:
    """The JSON Schema of scene files.

    Returns
    -------
    dict
        JSON Schema, draft 2020-12.
    """
    from resgrid.scene.document import SceneDocument

    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **SceneDocument.model_json_schema(by_alias=True)}
