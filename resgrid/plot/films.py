"""Animations as files: GIF with one palette, or MP4 by ffmpeg; whole or not at all."""

from __future__ import annotations

import os
import shutil
import subprocess
import zlib
from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError, ToolMissingError
from resgrid.files import atomic_path

ANIMATIONS = (".gif", ".mp4")
MOST_FRAMES = 600
_COLOURS = 255

Frame = NDArray[np.uint8]
"""A picture of shape (height, width, 3)."""


def save_animation(
    frames: Iterable[Frame],
    path: str | os.PathLike[str],
    *,
    rate: float = 20.0,
    progress: Callable[[int], object] | None = None,
) -> Path:
    """Write an animation.

    Parameters
    ----------
    frames : iterable of ndarray of uint8, shape (height, width, 3)
        Drawn one by one as they are written; at most `MOST_FRAMES`.
    path : path-like
        Its suffix, ``.gif`` or ``.mp4``, says the format; MP4 needs ffmpeg.
    rate : float
        Frames a second.
    progress : callable, optional
        Told how many frames are drawn.

    Returns
    -------
    Path
        The path.  An interruption leaves no file behind.

    Raises
    ------
    InputError
        If the suffix is unknown, there is no frame or there are too many, or the path cannot be written.
    ToolMissingError
        If ffmpeg is asked for and not installed.
    """
    write = _writer(path)
    if not 0 < rate <= 100:
        raise InputError(f"rate = {rate}, but an animation shows more than 0 and at most 100 frames a second")
    with atomic_path(path) as temporary:
        write(_counted(frames, progress), temporary, rate)
    return Path(path)


def check_animation(path: str | os.PathLike[str]) -> None:
    """Refuse a file that no animation can be written to, before anything is drawn; errors as `save_animation`."""
    _writer(path)


def _writer(path: str | os.PathLike[str]) -> Callable[[Iterator[Frame], Path, float], None]:
    suffix = Path(path).suffix.lower()
    if suffix == ".gif":
        return _write_gif
    if suffix != ".mp4":
        raise InputError(f"cannot write an animation as {str(path)!r}: its suffix must be {' or '.join(ANIMATIONS)}")
    if shutil.which("ffmpeg") is None:
        raise ToolMissingError("MP4 needs ffmpeg, which is not installed; install it, or name the file .gif")
    return _write_mp4


def _counted(frames: Iterable[Frame], progress: Callable[[int], object] | None) -> Iterator[Frame]:
    number = 0
    for number, frame in enumerate(frames, 1):
        if number > MOST_FRAMES:
            raise InputError(f"an animation has at most {MOST_FRAMES} frames; show fewer")
        yield frame
        if progress is not None:
            progress(number)
    if not number:
        raise InputError("an animation needs at least one frame")


def _write_gif(frames: Iterator[Frame], path: Path, rate: float) -> None:
    """Two rounds: the colours of all frames decide one palette, so that no colour changes from frame to frame."""
    from PIL import Image

    palette, kept, shape = _Palette(), [], (0, 0)
    for frame in frames:
        packed = _packed(frame)
        palette.see(packed)
        kept.append(zlib.compress(packed.tobytes(), 1))
        shape = packed.shape
    colours, number_of = palette.settle()

    def picture(data: bytes) -> Image.Image:
        image = Image.fromarray(number_of[np.frombuffer(zlib.decompress(data), np.uint32).reshape(shape)])
        image.putpalette(colours.tobytes())
        return image

    first, *rest = map(picture, kept)
    duration = max(round(100 / rate), 1) * 10
    with path.open("wb") as file:
        first.save(file, format="GIF", save_all=True, append_images=rest, duration=duration, loop=0)


def _packed(frame: Frame) -> NDArray[np.uint32]:
    """Colours as one number each, shape (height, width)."""
    red, green, blue = (frame[..., channel].astype(np.uint32) for channel in range(3))
    return np.asarray(red << 16 | green << 8 | blue, dtype=np.uint32)


class _Palette:
    """At most 255 colours for all frames: half of them the most frequent, half those farthest from all others."""

    def __init__(self) -> None:
        self._counts: dict[int, int] = {}
        self._last: NDArray[np.uint32] | None = None

    def see(self, packed: NDArray[np.uint32]) -> None:
        """Count the pixels that a frame changes."""
        new = packed if self._last is None else packed[packed != self._last]
        for colour, count in zip(*(part.tolist() for part in np.unique(new, return_counts=True)), strict=True):
            self._counts[colour] = self._counts.get(colour, 0) + count
        self._last = packed

    def settle(self) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """The palette, shape (n, 3), and the number in it of every colour seen, by the colour's own number."""
        from scipy.spatial import KDTree

        seen = np.array(sorted(self._counts, key=lambda colour: -self._counts[colour]), dtype=np.uint32)
        points = np.stack([seen >> 16, seen >> 8 & 255, seen & 255], axis=1).astype(np.float64)
        chosen = list(range(min(len(seen), _COLOURS // 2)))
        distance = np.asarray(KDTree(points[chosen]).query(points)[0])
        while len(chosen) < _COLOURS and distance.max() > 0:
            chosen.append(int(distance.argmax()))
            distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
        number_of = np.zeros(1 << 24, dtype=np.uint8)
        number_of[seen] = KDTree(points[chosen]).query(points)[1]
        return points[chosen].astype(np.uint8), number_of


def _write_mp4(frames: Iterator[Frame], path: Path, rate: float) -> None:
    first = next(frames)
    height, width = first.shape[:2]
    words = [
        "ffmpeg", "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}",
        "-r", f"{rate:g}", "-i", "-", "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p",
        "-f", "mp4", str(path),
    ]  # fmt: skip
    process = subprocess.Popen(words, stdin=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        assert process.stdin is not None
        complaint = _feed(process, process.stdin, chain([first], frames))
    except BaseException:
        process.kill()
        process.wait()
        raise
    if process.returncode:
        raise InputError(f"ffmpeg could not write {path.name}: {complaint.strip() or 'no reason given'}")


def _feed(process: subprocess.Popen[bytes], pipe: IO[bytes], frames: Iterator[Frame]) -> str:
    try:
        for frame in frames:
            pipe.write(np.ascontiguousarray(frame).tobytes())
    except BrokenPipeError:
        pass  # it says why on its standard error
    return process.communicate()[1].decode(errors="replace")
