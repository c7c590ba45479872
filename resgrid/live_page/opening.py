"""Import of drawings: files that the user opens on the page, and links."""

from __future__ import annotations

import base64
import binascii
import re
import tempfile
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from resgrid.errors import InputError
from resgrid.live_page.drawing import Drawing, drawing_of
from resgrid.live_page.messages import File
from resgrid.scene import read_scene
from resgrid.scene.file_names import needs_files
from resgrid.scene.reading import build_scene

_SUFFIXES = (".toml", ".yaml", ".yml", ".map", ".png", ".pgm", ".jpg", ".jpeg", ".bmp")
_PLAIN = re.compile(r"[\w. +()-]+")


def open_document(document: Mapping[str, Any] | None) -> Drawing:
    """Return the drawing of the scene in a link of the live page.

    `document`: keys and tables of the scene, None if the link contains no scene.  Raises InputError for None, for an
    invalid scene, and for a scene that needs a map file or obstacle files.
    """
    if document is None:
        raise InputError("this link contains no scene; copy the whole link again")
    _refuse_files(document)
    return drawing_of(build_scene(document, "the link", Path()))


def open_files(files: Sequence[File] | None) -> Drawing:
    """Return the drawing of a scene file, or of a map with its picture; raise InputError for invalid files or none.

    `files`: the files that the user opens, or None; the scene has no access to other files.
    """
    if not files:
        raise InputError("there is no file to open; drop a scene or a map on the page")
    with tempfile.TemporaryDirectory() as folder:
        for file in files:
            if not _PLAIN.fullmatch(file.name) or Path(file.name).suffix.lower() not in _SUFFIXES:
                raise InputError(
                    f"{file.name}: the page opens only plain file names that end in {', '.join(_SUFFIXES)}; rename it"
                )
            (Path(folder) / file.name).write_bytes(_bytes(file))
        first = min(files, key=lambda file: _SUFFIXES.index(Path(file.name).suffix.lower())).name
        try:
            if first.lower().endswith((".yaml", ".yml")):
                _refuse_foreign_picture(Path(folder) / first, files)
            if first.lower().endswith(".toml"):
                _refuse_files(tomllib.loads((Path(folder) / first).read_text(encoding="utf-8")))
            return drawing_of(read_scene(Path(folder) / first))
        except InputError as error:
            raise InputError(str(error).replace(f"{folder}/", "")) from None
        except ValueError as error:
            raise InputError(f"{first}: {error}") from None


def _bytes(file: File) -> bytes:
    try:
        return base64.b64decode(file.data, validate=True)
    except binascii.Error as error:
        raise InputError(f"{file.name} was damaged in transfer ({error}); open it again") from None


def _refuse_files(document: Mapping[str, Any]) -> None:
    """Raise InputError for a scene with files of maps, masks or obstacles, to which the page has no access.

    `document`: keys and tables of the scene, in the form of a scene file.
    """
    if "map" in document:
        raise InputError("this scene needs a map file, to which the page has no access; drop the map itself")
    if "mask" in document:
        raise InputError("this scene needs the files of its masks, to which the page has no access; remove the masks")
    if needs_files(document):
        raise InputError(
            "this scene needs files of obstacles, to which the page has no access; plan it with resgrid run"
        )


def _refuse_foreign_picture(map_file: Path, files: Sequence[File]) -> None:
    """Raise InputError unless the picture of a ROS map is one of the opened files.

    `map_file`: the YAML file of the map, which names the picture; `files`: the opened files.
    """
    from resgrid.scene.maps.yaml_cpp import read_mapping

    picture = read_mapping(map_file, ("image",)).get("image")
    if picture not in [file.name for file in files]:
        raise InputError(f"{map_file.name} needs the picture {picture!r}: drop both files together")
