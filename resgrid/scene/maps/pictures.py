"""Pictures as maps, and as arrays of channel values, whatever the file format.

Portable grey maps (https://netpbm.sourceforge.net/doc/pgm.html) are read here and to the letter, for thresholds of maps
need the values as they stand; all other formats by Pillow.
"""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import NDArray

from resgrid.budget import BYTES_PER_CELL, SMALLER_MAP, require_grid_memory
from resgrid.errors import BudgetError, InputError, ResgridError
from resgrid.files import read_bytes
from resgrid.scene.maps.arrays import cells_from_rows
from resgrid.space import Cell

if TYPE_CHECKING:
    from PIL.Image import Image

BYTES_PER_PIXEL = 24
"""Memory of a picture while it is turned into cells by its brightness."""

THRESHOLD = 128
"""Grey value from which a pixel is free, of a picture that does not say."""

DEEP = ("I;16", "I;16B", "I;16L", "I;16N", "I")
MAX_VALUE = 65535
MAX_DIGITS = 18
_BLANK = rb"(?:[ \t\r\n\v\f]|#[^\r\n]*[\r\n])+"
_NUMBER = re.compile(_BLANK + rb"(\d{1,18})(?!\d)")
_COMMENT = re.compile(rb"#[^\r\n]*")


@dataclass(frozen=True, eq=False)
class Raster:
    """A picture.

    `values` (height, width, channels): the top row first; 1 (grey), 2 (grey, alpha), 3 (red, green, blue) or 4
    channels; `maxval`: the value of white, and of opaque.
    """

    values: NDArray[np.uint16]
    maxval: int

    @property
    def has_alpha(self) -> bool:
        """Whether the last channel is opacity."""
        return self.values.shape[2] in (2, 4)

    @property
    def grey(self) -> NDArray[np.int32]:
        """Brightness from 0 to 255, shape ``(height, width)``: ITU-R 601 luma, rounded; opacity is ignored."""
        if self.values.shape[2] <= 2:
            return self._channel(0)
        luma = 500 + 299 * self._channel(0)
        luma += 587 * self._channel(1)
        luma += 114 * self._channel(2)
        luma //= 1000
        return luma

    def _channel(self, number: int) -> NDArray[np.int32]:
        """Values of one channel, from 0 to 255."""
        values = self.values[..., number].astype(np.int32)
        return values if self.maxval == 255 else values * 255 // self.maxval


def read_grey(path: Path, threshold: Annotated[int, Ge(0), Le(65536)] = THRESHOLD) -> NDArray[np.uint8]:
    """Read a picture in which dark is an obstacle.

    Parameters
    ----------
    threshold
        Grey value from which a pixel is free.
    """
    grey = read_raster(path).grey
    return cells_from_rows(np.where(grey < threshold, Cell.OBSTACLE, Cell.FREE).astype(np.uint8))


def read_epic(path: Path) -> NDArray[np.uint8]:
    """Read a picture by the convention of epic: 0 is an obstacle, 255 a goal, everything between is free.

    Colours are turned to grey by their rounded luma, opacity is ignored (K. Wray, D. Ruiken, R. Grupen and
    S. Zilberstein, "Log-space harmonic function path planning", IROS 2016; OpenCV's ``IMREAD_GRAYSCALE``).
    """
    grey = read_raster(path).grey
    return cells_from_rows(
        np.where(grey == 0, Cell.OBSTACLE, np.where(grey == 255, Cell.GOAL, Cell.FREE)).astype(np.uint8)
    )


def read_raster(path: Path, bytes_per_pixel: int = BYTES_PER_PIXEL) -> Raster:
    """Read a picture file: PGM by our own reader, every other format that Pillow knows by Pillow."""
    data = read_bytes(path)
    if not data:
        raise InputError(f"{path}: the file is empty")
    if data[:2] in (b"P2", b"P5"):
        values, maxval = read_pgm(data, path, bytes_per_pixel)
        return Raster(values[..., np.newaxis], maxval)
    return _read_with_pillow(data, path, bytes_per_pixel)


def _read_with_pillow(data: bytes, path: Path, bytes_per_pixel: int) -> Raster:
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            Image.open(BytesIO(data)).verify()  # the checksums of PNG, which decoding alone does not look at
            image = Image.open(BytesIO(data))
            require_grid_memory(image.size, str(path), bytes_per_pixel, SMALLER_MAP)
            return _raster(image, path)
    except UnidentifiedImageError:
        raise InputError(f"{path}: this is not a picture of a known format (PNG, PGM, BMP, ...)") from None
    except Image.DecompressionBombError as error:
        raise BudgetError(f"{path}: the picture is too large ({error})") from None
    except ResgridError:
        raise
    except Exception as error:  # each of Pillow's decoders has its own ways to fail on damaged bytes
        raise InputError(f"{path}: the picture is damaged or cut short ({error}); copy it again") from None


def _raster(image: Image, path: Path) -> Raster:
    if min(image.size) == 0:
        raise InputError(f"{path}: the picture has no pixels")
    if image.mode in DEEP:
        deep: NDArray[Any] = np.asarray(image).astype(np.int64)
        if deep.min() < 0 or deep.max() > 65535:
            raise InputError(f"{path}: grey values must lie between 0 and 65535")
        return Raster(deep.astype(np.uint16)[..., np.newaxis], 65535)
    if image.mode == "F":
        raise InputError(f"{path}: a picture of floating-point values is no map; save it with 8 or 16 bits")
    values = np.asarray(image.convert(_plain_mode(image))).astype(np.uint16)
    return Raster(values if values.ndim == 3 else values[..., np.newaxis], 255)


def _plain_mode(image: Image) -> str:
    plain = "L" if image.mode in ("1", "L", "LA") else "RGB"
    return f"{plain}A" if image.has_transparency_data else plain


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
    count = width * height
    if count <= len(data):  # otherwise it is cut short
        require_grid_memory((width, height), str(path), bytes_per_pixel, SMALLER_MAP)
    values = _plain_values(data, at + 1, count, path) if magic == b"P2" else _binary_values(data, at + 1, count, maxval)
    if len(values) < count:
        raise InputError(
            f"{path}: the file is cut short: {width} x {height} = {count} pixels are announced, "
            f"{len(values)} are there; copy it again"
        )
    if values.max() > maxval:
        raise InputError(f"{path}: pixel {int(values.argmax())} is {values.max()}, above the maximum {maxval}")
    return values.reshape(height, width).astype(np.uint16), maxval


def _binary_values(data: bytes, at: int, count: int, maxval: int) -> NDArray[Any]:
    dtype = np.dtype(np.uint8 if maxval < 256 else ">u2")
    return np.frombuffer(data, dtype, min(count, max(0, len(data) - at) // dtype.itemsize), at)


def _plain_values(data: bytes, at: int, count: int, path: Path) -> NDArray[Any]:
    words = _COMMENT.sub(b" ", data[at:]).split()[:count]
    wrong = next((word for word in words if not word.isdigit() or len(word) > MAX_DIGITS), None)
    if wrong is not None:
        raise InputError(f"{path}: the raster holds {wrong[:20]!r}; a plain PGM holds whole numbers up to its maximum")
    return np.array(words, dtype=bytes).astype(np.int64)


def _line(data: bytes, at: int) -> int:
    return data.count(b"\n", 0, at) + 1
