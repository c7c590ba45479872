"""Files written whole or not at all: a temporary file in the same folder, renamed when it is complete."""

from __future__ import annotations

import os
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from resgrid.errors import InputError


def write_text(path: str | os.PathLike[str], text: str) -> Path:
    r"""Write UTF-8 text atomically, line ends as they are.

    Parameters
    ----------
    path : path-like
        Where to write; an existing file is replaced.
    text : str
        The content.  Nothing is translated: ``"\n"`` is one byte on every system.

    Returns
    -------
    Path
        The path.

    Raises
    ------
    InputError
        If the path is a directory or cannot be written.
    """
    return write_bytes(path, text.encode("utf-8"))


def write_bytes(path: str | os.PathLike[str], data: bytes) -> Path:
    """Write bytes atomically; as `write_text` otherwise.

    Parameters
    ----------
    path : path-like
        Where to write; an existing file is replaced.
    data : bytes
        The content.

    Returns
    -------
    Path
        The path.

    Raises
    ------
    InputError
        If the path is a directory or cannot be written.
    """
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
    return Path(path)


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path that takes the place of ``path`` if the block succeeds and vanishes if it does not.

    The temporary file lies in the same folder and has the same suffix (writers that judge by it see what they
    expect).  A symbolic link is followed; a device such as ``/dev/stdout`` is written to once the content is complete.

    Parameters
    ----------
    path : path-like
        Where the content goes in the end.

    Yields
    ------
    Path
        An empty file, to be overwritten by the block.

    Raises
    ------
    InputError
        If the path is a directory or cannot be written.
    """
    target = _target(Path(path))
    is_device = Path(path).exists() and not Path(path).is_file()
    temporary = _create_temporary(Path(tempfile.gettempdir()) if is_device else target.parent, target, Path(path))
    try:
        yield temporary
        if is_device:
            with temporary.open("rb") as source, Path(path).open("wb") as sink:
                shutil.copyfileobj(source, sink)
        else:
            temporary.replace(target)
    except OSError as error:
        raise _unwritable(Path(path), error) from error
    finally:
        temporary.unlink(missing_ok=True)


def _target(path: Path) -> Path:
    try:
        target = path.resolve()
        if target.is_dir():
            raise InputError(f"cannot write {path}: it is a directory; name a file")
    except (OSError, RuntimeError, ValueError) as error:  # a loop of links, a NUL in the name
        raise _unwritable(path, error) from error
    return target


def _create_temporary(folder: Path, target: Path, path: Path) -> Path:
    # Not tempfile.mkstemp: its files are private (0600), ours keep to the user's umask.
    temporary = folder / f".{target.stem[:80]}-{secrets.token_hex(6)}{target.suffix[:20]}"
    try:
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    except OSError as error:
        if not isinstance(error, FileNotFoundError) or folder.is_dir():
            raise _unwritable(path, error) from error
        raise InputError(f"cannot write {path}: there is no folder {folder}; make it first") from error
    return temporary


def _unwritable(path: Path, error: Exception) -> InputError:
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return InputError(f"cannot write {str(path)!r}: {reason}; check the path, its permissions and the free space")
