"""Links of the live page: a scene's document, deflated and in base64url, in the fragment ``#s=...``."""

from __future__ import annotations

import base64
import binascii
import json
import re
import zlib
from pathlib import Path

from resgrid.errors import InputError
from resgrid.scene.read import build_scene
from resgrid.scene.scene import Scene

LARGEST = 1 << 26
"""Bytes of the longest document that a link may hold."""

_LINK = re.compile(r"https?://\S*#(?:\S*&)?s=(?P<code>[^&\s]+)")


def is_link(text: str) -> bool:
    """Whether a text is a link that holds a scene."""
    return _LINK.match(text) is not None


def read_link(text: str) -> Scene:
    """The scene that a link holds; nothing is fetched, and no map file is read."""
    match = _LINK.match(text)
    code = "" if match is None else match["code"]
    unpacking = zlib.decompressobj(-zlib.MAX_WBITS)
    try:
        content = unpacking.decompress(base64.urlsafe_b64decode(code + "=" * (-len(code) % 4)), LARGEST)
        document = json.loads(content) if unpacking.eof else None
    except (zlib.error, binascii.Error, ValueError, RecursionError):
        document = None
    if not isinstance(document, dict):
        raise InputError("this link holds no whole scene: part of it may be missing; copy it again")
    if "map" in document:
        raise InputError("the scene of this link names a map file, which a link cannot bring along")
    return build_scene(document, "the link", Path())
