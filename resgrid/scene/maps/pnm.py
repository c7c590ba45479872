"""Reader of portable anymaps (PBM, PGM, PPM; plain and binary), which keeps values exact, as thresholds require.

Formats: https://netpbm.sourceforge.net/doc/pbm.html, pgm.html and ppm.html.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.memory import BYTES_PER_CELL, SMALLER_MAP, require_grid_memory
from resgrid.errors import InputError

MAGICS = (b"P1", b"P2", b"P3", b"P4", b"P5", b"P6")
MAX_VALUE = 65535
MAX_DIGITS = 18

_BLANK = rb"(?:[ \t\r\n\v\f]|#[^\r\n]*[\r\n])+"
_NUMBER = re.compile(_BLANK + rb"(\d{1,18})(?!\d)")
_COMMENT = re.compile(rb"#[^\r\n]*")
_SPACES = (b" ", b"\t", b"\r", b"\n", b"\v", b"\f")


class _Header(NamedTuple):
    """The header of a portable anymap.

    `kind`: digit after P in the first line, 1 to 6; `width`, `height`: size in pixels; `maxval`: channel value of
    white; `start`: offset of the first pixel in the file, in bytes.
    """

    kind: int
    width: int
    height: int
    maxval: int
    start: int

    @property
    def channels(self) -> int:
        return 3 if self.kind in (3, 6) else 1


def read_pnm(data: bytes, path: Path, bytes_per_pixel: int = BYTES_PER_CELL) -> tuple[NDArray[Any], int]:
    """Return the channel values (height, width, channels) of an anymap, and the channel value of white.

    `data`: content of the file; `path`: name of the file, for messages; `bytes_per_pixel`: memory that the caller needs
    per pixel, for the check of the available memory.  Blanks, tabs, line ends and comments (from ``#`` to the end of
    the line) may separate the numbers of the header; one blank character ends the header.  If the value of white is
    above 255, binary values have two bytes, the high byte first.  Bits become grey values, 0 for black and 1 for white.
    Bytes after the last pixel are ignored.
    """
    header = _read_header(data, path)
    width, height, maxval, channels = header.width, header.height, header.maxval, header.channels
    count = width * height * channels
    if count <= 8 * len(data):  # otherwise the file is cut short
        require_grid_memory((width, height), str(path), bytes_per_pixel, SMALLER_MAP)
    values = _raster(data, header, count, path)
    if len(values) < count:
        raise InputError(
            f"{path}: the file is cut short: the header gives {width} x {height} = {width * height} pixels, the file "
            f"has {len(values) // channels}; copy it again"
        )
    if values.max() > maxval:
        raise InputError(
            f"{path}: pixel {int(values.argmax()) // channels} is {values.max()}, above the maximum {maxval} of the "
            "header; correct the header or export the picture again"
        )
    return values.reshape(height, width, channels).astype(np.uint8 if maxval < 256 else np.uint16, copy=False), maxval


def _read_header(data: bytes, path: Path) -> _Header:
    if data[:2] not in MAGICS:
        raise InputError(f"{path}: this is not a PNM file: it starts with {data[:4]!r}, not with P1 to P6")
    kind = int(data[1:2])
    is_bitmap = kind in (1, 4)
    at, numbers = 2, []
    for name in ("width", "height") if is_bitmap else ("width", "height", "maximum"):
        match = _NUMBER.match(data, at)
        if match is None:
            raise InputError(f"{path}: line {_line(data, at)}: the header lacks its {name}")
        numbers.append(int(match[1]))
        at = match.end()
    width, height, maxval = numbers if len(numbers) == 3 else (*numbers, 1)
    if width == 0 or height == 0:
        raise InputError(f"{path}: the picture has no pixels ({width} x {height})")
    if not 1 <= maxval <= MAX_VALUE:
        raise InputError(f"{path}: the maximum value is {maxval}; it must be between 1 and {MAX_VALUE}")
    if data[at : at + 1] not in _SPACES:
        raise InputError(f"{path}: line {_line(data, at)}: a blank must follow the header")
    return _Header(kind, width, height, maxval, at + 1)


def _raster(data: bytes, header: _Header, count: int, path: Path) -> NDArray[Any]:
    """Return the channel values in the file as a flat array of `count` entries, or fewer if the file is cut short.

    `data`: content of the file; `count`: number of channel values of the whole picture; `path`: name of the file, for
    messages.
    """
    if header.kind == 1:
        return _plain_bits(data[header.start :], count, path)
    if header.kind == 4:
        return _packed_bits(data, header)
    if header.kind in (2, 3):
        return _plain_values(data[header.start :], count, path)
    dtype = np.dtype(np.uint8 if header.maxval < 256 else ">u2")
    return np.frombuffer(
        data, dtype, min(count, max(0, len(data) - header.start) // dtype.itemsize), min(header.start, len(data))
    )


def _plain_values(data: bytes, count: int, path: Path) -> NDArray[Any]:
    words = _COMMENT.sub(b" ", data).split()[:count]
    wrong = next((word for word in words if not word.isdigit() or len(word) > MAX_DIGITS), None)
    if wrong is not None:
        raise InputError(
            f"{path}: the raster contains {wrong[:20]!r}; a plain raster contains whole numbers up to the maximum"
        )
    return np.array(words, dtype=bytes).astype(np.int64)


def _plain_bits(data: bytes, count: int, path: Path) -> NDArray[Any]:
    """Return the pixels (n,) of a plain bitmap, 0 for black and 1 for white, n at most `count`.

    `data`: digits of the file, with or without blanks, in which 1 is black.
    """
    digits = np.frombuffer(b"".join(_COMMENT.sub(b" ", data).split()), np.uint8)[:count]
    wrong = ~np.isin(digits, (ord("0"), ord("1")))
    if wrong.any():
        raise InputError(f"{path}: the raster contains {chr(digits[wrong][0])!r}; a plain bitmap contains 0 and 1")
    return ord("1") - digits


def _packed_bits(data: bytes, header: _Header) -> NDArray[Any]:
    """Return the pixels (n,) of the complete rows of a binary bitmap, 0 for black and 1 for white, top row first.

    In the file, rows are padded to whole bytes, and the bit 1 is black.  `data`: content of the file.
    """
    row = -(-header.width // 8)
    rows = min(header.height, max(0, len(data) - header.start) // row)
    packed = np.frombuffer(data, np.uint8, rows * row, min(header.start, len(data))).reshape(rows, row)
    return 1 - np.unpackbits(packed, axis=1)[:, : header.width].reshape(-1)


def _line(data: bytes, at: int) -> int:
    return data.count(b"\n", 0, at) + 1
