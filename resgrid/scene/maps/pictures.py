"""Readers of pictures of any file format, as maps and as arrays of channel values.

The module `resgrid.scene.maps.pnm` reads portable anymaps, Pillow reads all other formats.
"""

from __future__ import annotations

import struct
import threading
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, overload

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import NDArray

from resgrid._internal.files import read_bytes
from resgrid._internal.memory import SMALLER_MAP, require_grid_memory
from resgrid.core.cell import Cell
from resgrid.errors import InputError, ResgridError
from resgrid.scene.maps.arrays import cells_from_rows
from resgrid.scene.maps.pnm import MAGICS, read_pnm

if TYPE_CHECKING:
    from PIL.Image import Image

BYTES_PER_PIXEL = 24
"""Estimated memory for decoding a picture and converting it to cells, in bytes per pixel."""

DECODED_BYTES = 5
"""Estimated memory for decoding a picture of which only parts become cells, in bytes per pixel."""

THRESHOLD = 128
"""Default of the smallest grey value (0 to 255) of a free pixel."""

DEEP_MODES = ("I;16", "I;16B", "I;16L", "I;16N", "I")
"""Pixel modes of Pillow whose grey values have more than 8 bits."""

_DEEP_COLOURS = {"RGB;16B": "RGB;16L", "RGBA;16B": "RGBA;16L"}
"""Raw modes with which Pillow decodes PNGs of 16 bits per channel: mode for the high bytes to mode for the low bytes.
"""

_LIMIT = threading.Lock()


@dataclass(frozen=True, eq=False)
class PixelRaster:
    """The channel values of a picture.

    `values` (height, width, channels), uint8 or uint16: top row first, 1 (grey), 2 (grey, alpha), 3 (red, green, blue)
    or 4 channels (with alpha); `maxval`: channel value of white and of full opacity; `numbers` (height, width): indices
    of colours in the palette, None for a picture without a palette; `is_grey_alpha`: whether the file is a PNG of grey
    and opacity.
    """

    values: NDArray[np.uint8] | NDArray[np.uint16]
    maxval: int
    numbers: NDArray[np.uint8] | None = None
    is_grey_alpha: bool = False

    def part(self, rows: slice, columns: slice) -> PixelRaster:
        """Return a part of the picture as a raster that shares the memory; row 0 is the top row."""
        numbers = None if self.numbers is None else self.numbers[rows, columns]
        return PixelRaster(self.values[rows, columns], self.maxval, numbers, self.is_grey_alpha)

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""
        height, width = self.values.shape[:2]
        return height, width

    @property
    def has_alpha(self) -> bool:
        """Whether the last channel is opacity."""
        return self.values.shape[2] in (2, 4)

    @property
    def grey(self) -> NDArray[np.int32]:
        """Grey values from 0 to 255, shape (height, width): rounded ITU-R 601 luma, without opacity."""
        if self.values.shape[2] <= 2:
            return self._channel(0)
        luma = 500 + 299 * self._channel(0)
        luma += 587 * self._channel(1)
        luma += 114 * self._channel(2)
        luma //= 1000
        return luma

    @property
    def bytes(self) -> NDArray[np.int32]:
        """Channel values from 0 to 255, in the shape of `values`.

        A value of 16 bits is represented by its high byte, as in libpng and OpenCV.
        """
        return self._bytes(self.values)

    def _channel(self, number: int) -> NDArray[np.int32]:
        """Return the values of channel `number` (from 0), scaled to 0 to 255, shape (height, width)."""
        return self._bytes(self.values[..., number])

    def _bytes(self, values: NDArray[Any]) -> NDArray[np.int32]:
        whole = values.astype(np.int32)
        if self.maxval == 65535:
            whole >>= 8
        return whole if self.maxval in (255, 65535) else whole * 255 // self.maxval


def read_grey(path: Path, threshold: Annotated[int, Ge(0), Le(65536)] = THRESHOLD) -> NDArray[np.uint8]:
    """Return the cell codes (width, height) of a picture: dark pixels are obstacles, all others are free.

    The first index runs along x, the second along y, upwards: index 0 of the second axis is the bottom row.

    Parameters
    ----------
    threshold
        Smallest grey value, from 0 (black) to 255 (white), of a free pixel.
    """
    grey = read_raster(path).grey
    return cells_from_rows(np.where(grey < threshold, Cell.OBSTACLE, Cell.FREE).astype(np.uint8))


def read_epic(path: Path) -> NDArray[np.uint8]:
    """Return the cell codes (width, height) of a picture by the convention of the program epic.

    Codes are those of `Cell`: the grey value 0 gives 1 (obstacle), 255 gives 2 (goal), other values 0 (free).  The
    first index runs along x, the second along y, upwards: index 0 of the second axis is the bottom row.  Colours are
    converted to grey by their rounded luma, opacity is ignored (K. Wray, D. Ruiken, R. Grupen and S. Zilberstein,
    "Log-space harmonic function path planning", IROS 2016; OpenCV's ``IMREAD_GRAYSCALE``).
    """
    grey = read_raster(path).grey
    return cells_from_rows(
        np.where(grey == 0, Cell.OBSTACLE, np.where(grey == 255, Cell.GOAL, Cell.FREE)).astype(np.uint8)
    )


def read_raster(path: Path, bytes_per_pixel: int = BYTES_PER_PIXEL) -> PixelRaster:
    """Return the channel values of a picture file of any format that `read_pnm` or Pillow supports.

    `bytes_per_pixel`: memory per pixel for decoding and later use.  Raises BudgetError if the picture would not fit in
    memory, and InputError if the file is missing, damaged or of another kind.
    """
    data = _bytes_of(path)
    if data[:2] in MAGICS:
        return PixelRaster(*read_pnm(data, path, bytes_per_pixel))
    return _read_with_pillow(data, path, bytes_per_pixel)


def open_picture(path: Path) -> PixelRaster | DecodedPicture:
    """Return the picture in a file, decoded at most once; the method `part` of the result returns parts as rasters.

    The picture needs the memory of the file and, for compressed files, of the decoded pixels.  Raises BudgetError if
    the decoded pixels would not fit; the memory of the parts is not checked here.
    """
    data = _bytes_of(path)
    if data[:2] in MAGICS:
        return PixelRaster(*read_pnm(data, path, 0))  # shares the memory of the file
    return _read_with_pillow(data, path, DECODED_BYTES, in_parts=True)


def _bytes_of(path: Path) -> bytes:
    data = read_bytes(path)
    if not data:
        raise InputError(f"{path}: the file is empty; copy it again")
    return data


@dataclass(frozen=True, eq=False)
class DecodedPicture:
    """A picture in the memory of Pillow.

    `image`: the picture; `data`: content of the file; `path`: name of the file, for messages.
    """

    image: Image
    data: bytes
    path: Path

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.image.height, self.image.width

    def part(self, rows: slice, columns: slice) -> PixelRaster:
        """Return a part of the picture as a raster; row 0 is the top row, and the slices have no step."""
        (top, bottom, _), (left, right, _) = rows.indices(self.image.height), columns.indices(self.image.width)
        return _raster(self.image.crop((left, top, right, bottom)), self.data, self.path)


@overload
def _read_with_pillow(data: bytes, path: Path, bytes_per_pixel: int) -> PixelRaster: ...
@overload
def _read_with_pillow(
    data: bytes, path: Path, bytes_per_pixel: int, *, in_parts: bool
) -> PixelRaster | DecodedPicture: ...
def _read_with_pillow(
    data: bytes, path: Path, bytes_per_pixel: int, *, in_parts: bool = False
) -> PixelRaster | DecodedPicture:
    """Return a picture that Pillow decodes, as a raster or in the memory of Pillow.

    `data`: content of the file; `path`: name of the file, for messages; `bytes_per_pixel`: memory per pixel that is
    checked beforehand; `in_parts`: whether the picture may stay in the memory of Pillow, so that only parts become
    rasters; pictures of 16 bits, and BMPs with opacity that Pillow drops, become rasters all the same.
    """
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings(), _any_size():
            warnings.simplefilter("ignore")
            Image.open(BytesIO(data)).verify()  # checks the checksums of PNG, which decoding ignores
            image = Image.open(BytesIO(data))
        require_grid_memory(image.size, str(path), bytes_per_pixel, SMALLER_MAP)
        is_deep = image.mode in DEEP_MODES or (_png_layout(data) or (0,))[0] == 16
        if in_parts and not (is_deep or min(image.size) == 0 or image.mode == "F" or _has_spare_bytes(data)):
            image.load()
            return DecodedPicture(image, data, path)
        return _raster(image, data, path)
    except UnidentifiedImageError:
        raise InputError(f"{path}: this is not a picture of a known format (PNG, PGM, JPEG, BMP, ...)") from None
    except (ResgridError, MemoryError):
        raise
    except Exception as error:  # for damaged bytes, Pillow's decoders raise exceptions of many types
        raise InputError(f"{path}: the picture is damaged or cut short ({error}); copy it again") from None


@contextmanager
def _any_size() -> Iterator[None]:
    """Disable Pillow's limit of the number of pixels of a picture within the ``with`` block.

    The size of the picture must be checked against the available memory before decoding.
    """
    from PIL import Image

    with _LIMIT:
        before, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
        try:
            yield
        finally:
            Image.MAX_IMAGE_PIXELS = before


def _raster(image: Image, data: bytes, path: Path) -> PixelRaster:
    if min(image.size) == 0:
        raise InputError(f"{path}: the picture has no pixels; export it again")
    if image.mode == "F":
        raise InputError(f"{path}: a picture of floating-point values cannot be a map; save it with 8 or 16 bits")
    layout = _png_layout(data)
    if image.mode in DEEP_MODES or layout in ((16, 2), (16, 4), (16, 6)):
        deep = _transparent(_deep_values(image, data, layout, path), image.info.get("transparency"))
        return PixelRaster(deep, 65535, is_grey_alpha=layout == (16, 4))
    if layout is not None and layout[1] == 0:
        key = image.info.pop("transparency", None)  # in the file's bit depth, whereas Pillow scales greys to 8 bits
        grey = np.asarray(image.convert("L"))[..., np.newaxis]
        top = 2 ** layout[0] - 1
        return PixelRaster(_transparent(grey, None if key is None else min(key, top) * (255 // top)), 255)
    if image.mode == "RGB" and _has_spare_bytes(data):
        return PixelRaster(_with_spare_bytes(image, data), 255)
    values = np.asarray(image.convert(_channel_mode(image)))
    numbers = np.asarray(image) if image.mode == "P" and _keeps_palette(image) else None
    return PixelRaster(values if values.ndim == 3 else values[..., np.newaxis], 255, numbers, layout == (8, 4))


def _has_spare_bytes(data: bytes) -> bool:
    """Return whether a BMP file has 32 bits per pixel and no colour masks.

    The fourth byte of such a pixel is the opacity, which Pillow drops.  `data`: content of the file.
    """
    return data.startswith(b"BM") and data[14] >= 40 and data[28:30] == b"\x20\0" and not any(data[30:34])


def _with_spare_bytes(image: Image, data: bytes) -> NDArray[np.uint8]:
    """Return the channels of a BMP of 32 bits per pixel: red, green, blue and opacity, shape (height, width, 4).

    `image`: the decoded colours; `data`: content of the file.
    """
    first, height = struct.unpack("<I", data[10:14])[0], struct.unpack("<i", data[22:26])[0]
    rows = np.frombuffer(data, np.uint8, 4 * image.width * image.height, first)
    opacity = rows.reshape(image.height, image.width, 4)[:: -1 if height > 0 else 1, :, 3]
    return np.dstack([np.asarray(image), opacity])


def _keeps_palette(image: Image) -> bool:
    """Return whether SDL_image, with which ROS 1 reads pictures, keeps the palette of an image.

    SDL_image keeps a palette in which at most one colour is transparent, and this colour fully.
    """
    opacity = image.info.get("transparency", b"")
    return not isinstance(opacity, bytes) or opacity.replace(b"\xff", b"") in (b"", b"\0")


def _png_layout(data: bytes) -> tuple[int, int] | None:
    """Return bits per channel and colour type of a PNG file; None for other files.

    Colour types: 0 grey, 2 colour, 3 palette, 4 grey with opacity, 6 colour with opacity.
    """
    return (data[24], data[25]) if data.startswith(b"\x89PNG") and len(data) > 25 else None


def _deep_values(image: Image, data: bytes, layout: tuple[int, int] | None, path: Path) -> NDArray[np.uint16]:
    """Return the channel values (height, width, channels) of a picture with 16 bits per channel.

    `image`: the picture as Pillow opens it; `data`: content of the file; `layout`: bits per channel and colour type of
    a PNG, otherwise None; `path`: name of the file, for messages.
    """
    from PIL import Image as Pillow, ImageFile

    if layout == (16, 4):  # decoded as 8-bit RGBA, whose channels are then two bytes of grey and two of opacity
        with _any_size():
            image = Pillow.open(BytesIO(_with_layout(data, 8, 6)))
        quarters = np.asarray(image)
        return _joined(quarters[..., ::2], quarters[..., 1::2])
    if image.mode not in DEEP_MODES:
        with _any_size():
            lower = Pillow.open(BytesIO(data))
        assert isinstance(lower, ImageFile.ImageFile)
        ((codec, extent, offset, unpacking),) = lower.tile
        # Pillow before version 11 has no named tuple for tiles.
        lower.tile = [(codec, extent, offset, _DEEP_COLOURS[str(unpacking)])]  # type: ignore[list-item]
        return _joined(np.asarray(image), np.asarray(lower))
    deep: NDArray[Any] = np.asarray(image).astype(np.int64)
    if deep.min() < 0 or deep.max() > 65535:
        raise InputError(f"{path}: grey values must lie between 0 and 65535; save the picture with 16 bits")
    return deep.astype(np.uint16)[..., np.newaxis]


def _joined(higher: NDArray[np.uint8], lower: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Return 16-bit values composed of their high and low bytes, in the shape of `higher` and `lower`."""
    return (higher.astype(np.uint16) * np.uint16(256) + lower).astype(np.uint16)


def _with_layout(data: bytes, depth: int, colour: int) -> bytes:
    """Return the bytes of a PNG file with bit depth and colour type in its header replaced; the pixels are unchanged.

    `data`: content of the file; `depth`: bits per channel; `colour`: colour type of the PNG format.
    """
    header = data[12:24] + bytes((depth, colour)) + data[26:29]
    return data[:12] + header + struct.pack(">I", zlib.crc32(header)) + data[33:]


def _transparent(values: NDArray[Any], key: Any) -> NDArray[Any]:
    """Return channel values with an added opacity channel: 0 at pixels of the transparent colour, full at all others.

    `values` (height, width, channels): channel values without opacity; `key`: the transparent colour, one number per
    channel; None returns `values` unchanged.
    """
    if key is None:
        return values
    opaque = (values != np.atleast_1d(np.array(key))).any(axis=2)
    return np.dstack([values, np.where(opaque, np.iinfo(values.dtype).max, 0).astype(values.dtype)])


def _channel_mode(image: Image) -> str:
    opaque = "L" if image.mode in ("1", "L", "LA") else "RGB"
    return f"{opaque}A" if image.has_transparency_data else opaque
