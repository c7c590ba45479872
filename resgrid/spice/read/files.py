"""Files of a deck, read whole, and only below a root."""

from __future__ import annotations

import codecs
import os
from dataclasses import dataclass, field
from pathlib import Path

from resgrid._internal.files import read_bytes
from resgrid.errors import InputError

MAX_BYTES = 2**31 - 2**20
MAX_FILES = 200
_LOOKED_AT = 4096

_BOMS = ((codecs.BOM_UTF8, "utf-8"), (codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be"))


@dataclass(frozen=True, eq=False)
class SourceFile:
    """One file's content.

    `number`: its index among the files of the deck; `name`: as displayed; `path`: where it lies, links resolved; None
    for text without a file; `data`: UTF-8 (or Latin-1) without byte order mark, LF line ends, ending in one;
    `oddities`: what was changed for that, of ``"utf-16"`` and ``"cr"`` (line ends of carriage returns alone).
    """

    number: int
    name: str
    path: Path | None
    data: bytes
    oddities: frozenset[str] = frozenset()


@dataclass
class Library:
    """The files of one deck, and where others may be taken from."""

    root: Path | None
    sources: list[SourceFile] = field(default_factory=list)

    def add(self, name: str, path: Path | None, data: bytes) -> SourceFile:
        """Take up a file's content."""
        if len(self.sources) >= MAX_FILES:
            raise InputError(f"{name}: more than {MAX_FILES} files are included")
        source = SourceFile(len(self.sources), name, path, normalise(data, name), oddities_of(data))
        self.sources.append(source)
        return source

    def open(self, path: Path, name: str) -> SourceFile:
        """Read a file; one that was read before is not read again."""
        resolved = resolve(path, name)
        known = next((source for source in self.sources if source.path == resolved), None)
        return known or self.add(name, resolved, deck_bytes(resolved, name))

    def find(self, file: str, beside: SourceFile) -> tuple[Path, str]:
        """Where an included file lies, and how to display it."""
        if self.root is None:
            raise InputError(f"{file!r} is included, but the deck has no folder: give the root to read below")
        folder = self.root if beside.path is None else beside.path.parent
        tried: list[Path] = []
        for base in dict.fromkeys((folder, self.root)):
            path = resolve(base / file, file)
            if not path.is_relative_to(self.root):
                raise InputError(f"{file!r} lies outside {str(self.root)!r}: copy it, or name a wider root")
            if _exists(path):
                return path, os.path.normpath(Path(beside.name).parent / file) if base == folder else file
            tried.append(path)
        raise InputError(
            f"the file {file[-80:]!r} that is included does not exist (looked in {str(tried[0].parent)!r})"
        )


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # a name that is too long, a folder that may not be searched
        return False


def resolve(path: Path, name: str) -> Path:
    """A path without links and dots; ``name`` is what messages call it."""
    try:
        return path.resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(f"cannot read {name!r}: {error}") from None


def deck_bytes(path: Path, name: str) -> bytes:
    """All bytes of a regular file of at most `MAX_BYTES`, which messages call by the name that the deck has for it."""
    return read_bytes(path, MAX_BYTES, name=name, piped=False)


def normalise(data: bytes, name: str) -> bytes:
    """Make text of bytes: no byte order mark, LF line ends, a final one; not decoded yet."""
    mark, coding = coding_of(data)
    data = data[len(mark) :] if mark else data
    if coding.startswith("utf-16"):
        data = data.decode(coding, "replace").encode()
    if b"\0" in data:
        line = data[: data.index(b"\0")].count(b"\n") + 1
        raise InputError(f"{name}:{line}: it holds a zero byte, so it is no text (a raw file? a schematic?)")
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return data if data.endswith(b"\n") else data + b"\n"


def coding_of(data: bytes) -> tuple[bytes, str]:
    """Return a file's byte order mark and encoding; UTF-16 without a mark shows by zeros in every second byte.

    Examples
    --------
    >>> coding_of("R1 a 0 1k".encode("utf-16-le")), coding_of(b"R1 a 0 1k")
    ((b'', 'utf-16-le'), (b'', ''))
    """
    for mark, coding in _BOMS:
        if data.startswith(mark):
            return mark, coding
    head = data[: 2 * _LOOKED_AT]
    even, odd = head[0::2].count(0), head[1::2].count(0)
    if head and len(data) % 2 == 0 and (even == 0) != (odd == 0) and max(even, odd) > len(head) / 4:
        return b"", "utf-16-le" if odd else "utf-16-be"
    return b"", ""


def oddities_of(data: bytes) -> frozenset[str]:
    """Return the oddities of a file, as in `SourceFile`."""
    found = {"utf-16"} if coding_of(data)[1].startswith("utf-16") else set[str]()
    if b"\r" in data and b"\n" not in data:
        found.add("cr")
    return frozenset(found)


def decode(data: bytes) -> str:
    """Text of bytes: UTF-8 if it is that, otherwise Latin-1."""
    try:
        return data.decode()
    except UnicodeDecodeError:
        return data.decode("latin-1")


def read_text(path: str | os.PathLike[str]) -> str:
    """Text of a file: LF line ends, a final one."""
    name = os.fspath(path)
    return decode(normalise(deck_bytes(Path(name), name), name))
