"""Portable grey maps, plain (P2) and binary (P5), read to the letter.

Format: https://netpbm.sourceforge.net/doc/pgm.html.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.scene.files import BYTES_PER_CELL, require_memory

MAX_VALUE = 65535
MAX_DIGITS = 18
_BLANK = rb"(?:[ \t\r\n\v\f]|#[^\r\n]*[\r\n])+"
_NUMBER = re.compile(_BLANK + rb"(\d{1,18})(?!\d)")
_COMMENT = re.compile(rb"#[^\r\n]*")


def read_pgm(data: bytes, path: Path, bytes_per_pixel: int = BYTES_PER_CELL) -> tuple[NDArray[np.uint16], int]:
    """Grey values of a PGM file.

    Blanks, tabs, line ends and comments (from ``#`` to the end of the line) may stand between the numbers of the
    header; one blank character ends it.  Values above 255 take two bytes, the higher first.

    Returns `values` (height, width).
    """
    magic = data[:2]
    if magic not in (b"P2", b"P5"):
        raise InputError(f"{path}: not a PGM file: it starts with {data[:4]!r}, not with P2 or P5")
    at = 2
    header = []
    for name in ("width", "height", "maximum"):
        match = _NUMBER.match(data, at)
        if match is None:
            raise InputError(f"{path}: line {_line(data, at)}: the PGM header lacks its {name}")
        header.append(int(match[1]))
        at = match.end()
    width, height, maxval = header
    if width == 0 or height == 0:
        raise InputError(f"{path}: the picture has no pixels ({width} x {height})")
    if not 1 <= maxval <= MAX_VALUE:
        raise InputError(f"{path}: the maximum grey value is {maxval}; it must be between 1 and {MAX_VALUE}")
    if data[at : at + 1] not in (b" ", b"\t", b"\r", b"\n", b"\v", b"\f"):
        raise InputError(f"{path}: line {_line(data, at)}: a blank must follow the maximum grey value")
    raster = _plain if magic == b"P2" else _binary
    if width * height <= len(data):  # otherwise it is cut short
        require_memory((width, height), str(path), bytes_per_pixel)
    return raster(data, at + 1, width, height, maxval, path), maxval


def _binary(data: bytes, at: int, width: int, height: int, maxval: int, path: Path) -> NDArray[np.uint16]:
    size = 1 if maxval < 256 else 2
    needed = width * height * size
    if len(data) - at < needed:
        raise _too_short(path, width, height, (len(data) - at) // size)
    values = np.frombuffer(data, dtype=np.uint8 if size == 1 else ">u2", count=width * height, offset=at)
    if values.max() > maxval:
        raise InputError(f"{path}: pixel {int(values.argmax())} is {values.max()}, above the maximum {maxval}")
    return values.reshape(height, width).astype(np.uint16)


def _plain(data: bytes, at: int, width: int, height: int, maxval: int, path: Path) -> NDArray[np.uint16]:
    if width * height > len(data):
        raise _too_short(path, width, height, len(data))
    words = _COMMENT.sub(b" ", data[at:]).split()
    if len(words) < width * height:
        raise _too_short(path, width, height, len(words))
    words = words[: width * height]
    if not b"".join(words).isdigit() or max(map(len, words)) > MAX_DIGITS:
        wrong = next(word for word in words if not word.isdigit() or len(word) > MAX_DIGITS)
        raise InputError(f"{path}: the raster holds {wrong[:20]!r}; a plain PGM holds whole numbers up to its maximum")
    values = np.array(words).astype(np.int64)
    if values.max() > maxval:
        raise InputError(f"{path}: pixel {int(values.argmax())} is {values.max()}, above the maximum {maxval}")
    return values.reshape(height, width).astype(np.uint16)


def _too_short(path: Path, width: int, height: int, found: int) -> InputError:
    return InputError(
        f"{path}: the file is cut short: {width} x {height} = {width * height} pixels are announced, "
        f"{found} are there; copy it again"
    )


def _line(data: bytes, at: int) -> int:
    return data.count(b"\n", 0, at) + 1
