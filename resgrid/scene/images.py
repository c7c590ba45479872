"""Pictures as arrays of channel values, whatever the file format."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import BudgetError, InputError, ResgridError
from resgrid.scene.files import read_bytes, require_memory
from resgrid.scene.pgm import read_pgm

if TYPE_CHECKING:
    from PIL.Image import Image

BYTES_PER_PIXEL = 24
"""Memory of a picture while it is turned into cells by its brightness."""

DEEP = ("I;16", "I;16B", "I;16L", "I;16N", "I")


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
            require_memory(image.size, str(path), bytes_per_pixel)
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
    if image.mode in ("L", "LA", "RGB", "RGBA"):
        grey = image.mode == "L" and "transparency" in image.info
        colour = image.mode == "RGB" and "transparency" in image.info
        return "LA" if grey else "RGBA" if colour else image.mode
    if image.mode == "1":
        return "L"
    return "RGBA" if image.mode in ("PA", "La", "RGBa") or "transparency" in image.info else "RGB"
