"""Files read with errors that say what is wrong, and memory asked for before it is taken."""

from __future__ import annotations

import stat
from math import prod
from pathlib import Path

from resgrid.budget import require_memory as require_bytes
from resgrid.errors import InputError

BYTES_PER_CELL = 16
MAX_TEXT_BYTES = 1 << 28


def read_bytes(path: Path, limit: int | None = None) -> bytes:
    """All bytes of a file."""
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise InputError(f"{path}: this is a directory; give the file inside it")
        if stat.S_ISCHR(status.st_mode) or stat.S_ISBLK(status.st_mode):
            raise InputError(f"{path}: this is a device; give a file")
        if limit is not None and status.st_size > limit:
            raise InputError(f"{path}: {status.st_size} bytes are too many (at most {limit}); is it the right file?")
        return path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file; check the name and the folder") from None
    except PermissionError:
        raise InputError(f"{path}: permission denied; make the file readable") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from None


def read_text(path: Path) -> str:
    """All text of a UTF-8 file, line ends turned into newlines."""
    return decode(read_bytes(path, MAX_TEXT_BYTES), path)


def decode(data: bytes, path: Path) -> str:
    """UTF-8 text of some bytes, a byte order mark dropped, line ends turned into newlines."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(f"{path}: line {line}: this is not UTF-8 text; save the file as UTF-8") from None
    return text.replace("\r\n", "\n")


def require_memory(shape: tuple[int, ...], what: str, bytes_per_cell: int = BYTES_PER_CELL) -> None:
    """Refuse a grid that would not fit in memory, before anything is allocated."""
    size = " x ".join(map(str, shape))
    require_bytes(prod(shape) * bytes_per_cell, f"{what}: {size} = {prod(shape):.3g} cells", "take fewer, larger cells")
