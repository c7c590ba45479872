"""Reader of scenes and maps from standard input, and the error for map options of a scene without a map."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import click

import resgrid as rg
from resgrid._internal.files import decode
from resgrid.cli.options import CommandInput, accepts_decks
from resgrid.cli.streams import STANDARD_INPUT, standard_input
from resgrid.errors import BudgetError, InputError

if TYPE_CHECKING:
    from resgrid.scene.reading import Document


def refuse_map_options(source: CommandInput) -> None:
    """Raise InputError if options of maps are given for a scene without a map."""
    if source.map_options:
        options = ", ".join(source.map_options)
        raise InputError(f"{source.name}: this scene has no map, so {options} has no effect; leave it out")


def piped_scene(source: CommandInput) -> rg.Scene:
    """Return the scene from standard input, with the changes of `source`.

    The input is a map if its first bytes are those of a map format or ``--format`` is given; otherwise it is TOML.
    """
    from resgrid.scene.maps.formats import FORMATS
    from resgrid.scene.maps.ros_header import NEWEST, read_header
    from resgrid.scene.overrides import build_changed
    from resgrid.scene.reading import read_document

    data = standard_input().read()
    if not data.strip():
        raise InputError(f"{STANDARD_INPUT} is empty; give a scene file, or pipe one")
    if (
        not data.startswith(tuple(begin for entry in FORMATS.values() for begin in entry.magic))
        and source.map_options.get("format") is None
    ):
        refuse_map_options(source)
        return build_changed(_piped_document(data), source.changes)
    # The folder exists until the subcommand ends, because some subcommands read the map again.
    file = Path(click.get_current_context().with_resource(tempfile.TemporaryDirectory())) / "standard_input"
    file.write_bytes(data)
    try:
        if source.map_options.get("format") == "ros":
            image = read_header(file, source.map_options.get("dialect", NEWEST)).image
            if not Path(image).is_absolute():
                raise InputError(f"{file}: the picture {image!r} lies in an unknown folder; name the file of the map")
        document = read_document(file, source.map_options)
        return build_changed(document._replace(source=STANDARD_INPUT), source.changes)
    except (InputError, BudgetError) as error:
        raise type(error)(str(error).replace(str(file), STANDARD_INPUT)) from None


def _piped_document(data: bytes) -> Document:
    """Return the TOML document in the content of standard input; raise InputError for other text.

    The message names the option of a piped deck, ``--read-as``, if the subcommand has this option.
    """
    from resgrid.scene.reading import parse_document

    try:
        return parse_document(decode(data, Path(STANDARD_INPUT)), STANDARD_INPUT)
    except InputError as error:
        hint = "; if it is a deck, add --read-as ngspice" if accepts_decks() else ""
        raise InputError(f"{error}{hint}") from None
