"""Files of a deck: reading below a root folder only, encodings, and conversion to text with LF line ends."""

from __future__ import annotations

import codecs
import os
from dataclasses import dataclass, field
from pathlib import Path

from resgrid._internal.files import read_bytes
from resgrid.errors import InputError

MAX_BYTES = 2**31 - 2**20
"""Maximum size of one file of a deck, in bytes; a larger file raises InputError."""

MAX_FILES = 200
"""Maximum number of files of a deck, including the deck itself; more files raise InputError."""

_LOOKED_AT = 4096
"""Number of bytes at even offsets, and as many at odd offsets, in which zeros are counted to recognize UTF-16."""

_BOMS = ((codecs.BOM_UTF8, "utf-8"), (codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be"))


@dataclass(frozen=True, eq=False)
class SourceFile:
    """The content of one file.

    `number`: index among the files of the deck; `name`: name for messages; `path`: path with links resolved, None for
    text without a file; `data`: UTF-8 or Latin-1 text without byte order mark, with LF line ends and a final LF;
    `oddities`: unusual properties of the original file: "utf-16", "bom" (byte order mark of UTF-8), "cr" (carriage
    returns as line ends).
    """

    number: int
    name: str
    path: Path | None
    data: bytes
    oddities: frozenset[str] = frozenset()


@dataclass
class Library:
    """The files of one deck.

    `root`: folder that must contain the include files, None if includes are not allowed; `sources`: the files that have
    been read, the deck first.
    """

    root: Path | None
    sources: list[SourceFile] = field(default_factory=list)

    def add(self, name: str, path: Path | None, data: bytes) -> SourceFile:
        """Add a file to the library and return it; raise InputError above 200 files (`MAX_FILES`).

        `name`: name for messages; `path`: resolved path, None for text without a file; `data`: content in any encoding.
        """
        if len(self.sources) >= MAX_FILES:
            raise InputError(f"{name}: more than {MAX_FILES} files are included")
        source = SourceFile(len(self.sources), name, path, normalise(data, name), oddities_of(data))
        self.sources.append(source)
        return source

    def open(self, path: Path, name: str) -> SourceFile:
        """Return the file at `path`, which is read once and then kept in the library; `name`: name for messages."""
        resolved = resolve(path, name)
        known = next((source for source in self.sources if source.path == resolved), None)
        return known or self.add(name, resolved, deck_bytes(resolved, name))

    def find(self, file: str, including: SourceFile, *, starts: bool = False) -> tuple[Path, str]:
        """Return the path and name of an include file; raise InputError if it is missing or outside the root.

        The file is searched for in the folder of the including file, then in the root.  The returned name is for
        messages.  `file`: name in the include statement; `including`: the file that contains the statement; `starts`:
        True if the dialect's simulator prefers the folder in which it is started, so that a different file of this name
        in the deck's folder is an error; False if such a file does not matter.
        """
        if self.root is None:
            raise InputError(
                f"{file!r} is included, but the deck has no folder: give the folder of included files by --root FOLDER "
                "(in Python: root=)"
            )
        folder = self.root if including.path is None else including.path.parent
        tried: list[Path] = []
        for base in dict.fromkeys((folder, self.root)):
            path = resolve(base / file, file)
            if not path.is_relative_to(self.root):
                raise InputError(
                    f"{file!r} lies outside {str(self.root)!r}: copy it, or name a folder that contains it by --root "
                    "FOLDER (in Python: root=)"
                )
            if _exists(path):
                if starts:
                    self._refuse_two(file, path)
                return path, os.path.normpath(Path(including.name).parent / file) if base == folder else file
            tried.append(path)
        raise InputError(
            f"the file {file[-80:]!r} that is included does not exist (looked in {str(tried[0].parent)!r}); copy "
            "it to this folder, or correct its name"
        )

    def _refuse_two(self, file: str, path: Path) -> None:
        """Raise InputError if the deck's folder holds a file of the same name as an include file, but another content.

        `file`: name in the include statement; `path`: path of the file that is included.
        """
        deck = self.sources[0].path
        if deck is None or self.root is None:
            return
        other = resolve(deck.parent / file, file)
        is_other = other != path and other.is_relative_to(self.root) and _exists(other)
        if is_other and deck_bytes(other, file) != deck_bytes(path, file):
            raise InputError(
                f"{file!r} exists in {str(deck.parent)!r} and in {str(path.parent)!r}, and the folder in which the "
                "simulator is started decides between them: rename one, or write its path"
            )


def _exists(path: Path) -> bool:
    """Return whether a path exists; return False also if the operating system reports an error for the path."""
    try:
        return path.exists()
    except OSError:  # a name that is too long, a folder that may not be searched
        return False


def resolve(path: Path, name: str) -> Path:
    """Return a path without symbolic links and dots; raise InputError if that fails; `name`: path in messages."""
    try:
        return path.resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(f"cannot read {name!r}: {error}") from None


def deck_bytes(path: Path, name: str) -> bytes:
    """Return the content of a regular file; raise InputError for other paths and above about 2 GB (`MAX_BYTES`).

    `name`: name of the file in messages.
    """
    return read_bytes(path, MAX_BYTES, name=name, piped=False)


def normalise(data: bytes, name: str) -> bytes:
    """Return the content of a file without byte order mark, with LF line ends and a final LF.

    UTF-16 is converted to UTF-8; UTF-8 and Latin-1 stay.  Raises InputError for a zero byte.  `data`: content of the
    file; `name`: name of the file in messages.
    """
    mark, coding = coding_of(data)
    data = data[len(mark) :] if mark else data
    if coding.startswith("utf-16"):
        data = data.decode(coding, "replace").encode()
    if b"\0" in data:
        line = data[: data.index(b"\0")].count(b"\n") + 1
        raise InputError(f"{name}:{line}: a zero byte: this is not a text file (perhaps a raw file or a schematic)")
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return data if data.endswith(b"\n") else data + b"\n"


def coding_of(data: bytes) -> tuple[bytes, str]:
    """Return the byte order mark of a file's content, and the encoding: "utf-8", "utf-16-le" or "utf-16-be".

    UTF-16 without a mark is recognized by zeros in every second byte.  A missing mark is empty; the encoding is empty
    if neither a mark nor zeros determine it.

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
    """Return the set of unusual properties of a file.

    Its members are ``"utf-16"``, ``"bom"`` (a byte order mark of UTF-8), ``"cr"`` (carriage returns as line ends).
    """
    found = {"utf-16"} if coding_of(data)[1].startswith("utf-16") else set[str]()
    if data.startswith(codecs.BOM_UTF8):
        found.add("bom")
    if b"\r" in data and b"\n" not in data:
        found.add("cr")
    return frozenset(found)


def decode(data: bytes) -> str:
    """Return bytes as text, decoded as UTF-8 if they are valid UTF-8, otherwise as Latin-1."""
    try:
        return data.decode()
    except UnicodeDecodeError:
        return data.decode("latin-1")


def read_text(path: str | os.PathLike[str]) -> str:
    """Return the text of a file with LF line ends and a final LF; raise InputError if the file cannot be read."""
    name = os.fspath(path)
    return decode(normalise(deck_bytes(Path(name), name), name))
