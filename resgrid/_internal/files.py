"""Reading of files with precise error messages, and atomic writing of files and folders."""

from __future__ import annotations

import contextlib
import json
import os
import re
import secrets
import shutil
import stat
import tempfile
import time
import weakref
from collections.abc import Iterator
from pathlib import Path

from resgrid.errors import InputError, ResgridError

SUMMARY = "summary.json"
"""Name of the JSON file whose entry ``files`` lists all files of a folder of results."""

MAX_TEXT_BYTES = 1 << 28
"""Maximum size of a text file, in bytes; a larger file raises InputError."""

_PART = 1 << 20
"""Number of bytes that are read at once from a pipe, whose size is unknown."""

_STALE = 86_400.0
"""Age in seconds above which an unlocked temporary file is deleted as a remnant of a killed process."""


@contextlib.contextmanager
def temporary_folder() -> Iterator[Path]:
    """Yield a new folder in the system's temporary folder (``TMPDIR``), and delete the folder at the end of the block.

    The folder is deleted twice: if the process ends while another thread deletes it, one of both calls succeeds.
    """
    folder = tempfile.TemporaryDirectory(prefix="resgrid-", ignore_cleanup_errors=True)
    try:
        yield Path(folder.name)
    finally:
        shutil.rmtree(folder.name, ignore_errors=True)
        folder.cleanup()


def read_bytes(
    path: Path, limit: int | None = None, *, name: str | None = None, first: int = -1, piped: bool = True
) -> bytes:
    """Return the bytes of a file; raise InputError if the file cannot be read or is too large.

    `path`: path of the file; `limit`: maximum size in bytes, None for no limit; `name`: name of the file in messages,
    by default the path; `first`: number of bytes to read, -1 for all; `piped`: whether a pipe is accepted.
    """
    said = str(path) if name is None else name
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise InputError(f"{said}: this is a directory; give the file inside it")
        if stat.S_ISCHR(status.st_mode) or stat.S_ISBLK(status.st_mode):
            raise InputError(f"{said}: this is a device; give a file")
        if not (piped or stat.S_ISREG(status.st_mode)):
            raise InputError(f"{said}: this is not a regular file; give one")
        if limit is not None and status.st_size > limit:
            raise InputError(f"{said}: {status.st_size} bytes are too many (at most {limit}); is it the right file?")
        with path.open("rb") as file:
            if limit is None or first >= 0 or stat.S_ISREG(status.st_mode):
                return file.read(first)
            data = bytearray()
            while len(data) <= limit and (part := file.read(_PART)):  # `read` reserves all bytes that it may return
                data += part
        if len(data) > limit:
            raise InputError(f"{said}: more than {limit} bytes are too many; is it the right file?")
        return bytes(data)
    except InputError:
        raise
    except FileNotFoundError:
        raise _missing(path, said) from None
    except PermissionError:
        raise InputError(f"{said}: permission denied; make the file readable") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{said}: cannot be read ({error})") from None


def _missing(path: Path, name: str) -> InputError:
    """Return the InputError for a missing file; `name`: name of the file in the message.

    If the path has a part such as ``https:``, the user gave an internet address, whose two slashes `Path` has replaced
    by one.  The message then says that addresses are not opened.  Text of `name` before the address is removed, such as
    the current folder in an absolute path.
    """
    if not {"http:", "https:", "file:", "ftp:"}.isdisjoint(path.parts):
        address = re.sub(r"\S*?\b(https?|file|ftp):/+", r"\1://", name, count=1)
        return InputError(f"{address}: addresses are not opened; save the file on this computer, and give its name")
    return InputError(f"{name}: there is no such file; check the name and the folder")


def read_text(path: Path) -> str:
    """Return the text of a UTF-8 file, with LF line ends; raise InputError if it is unreadable, not UTF-8 or too large.

    The maximum size is `MAX_TEXT_BYTES` (256 MiB).
    """
    return decode(read_bytes(path, MAX_TEXT_BYTES), path)


def decode(data: bytes, path: Path) -> str:
    """Return UTF-8 bytes as text, without byte order mark and with LF line ends; raise InputError for other bytes.

    `path`: name of the file in messages.
    """
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(f"{path}: line {line}: this is not UTF-8 text; save the file as UTF-8") from None
    return text.replace("\r\n", "\n")


def write_text(path: str | os.PathLike[str], text: str) -> Path:
    """Write UTF-8 text to a file atomically, with unchanged line ends, and return the path of the file."""
    return write_bytes(path, text.encode("utf-8"))


def write_bytes(path: str | os.PathLike[str], data: bytes) -> Path:
    """Write bytes to a file atomically, and return the path of the file."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
    return Path(path)


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield the path of a temporary file that replaces `path` if the block succeeds, and is deleted otherwise.

    The temporary file lies in the same folder and has the same suffix, because some writers choose a format by suffix.
    A symbolic link is followed.  A device such as ``/dev/stdout`` is written after the block, when the content is
    complete.  Raise InputError if `path` cannot be written.
    """
    target = target_of(Path(path))
    is_device = Path(path).exists() and not Path(path).is_file()
    temporary = _create_temporary(Path(tempfile.gettempdir()) if is_device else target.parent, target, Path(path))
    try:
        yield temporary
        if is_device:
            with temporary.open("rb") as source, Path(path).open("wb") as sink:
                shutil.copyfileobj(source, sink)
        else:
            temporary.replace(target)
    except ResgridError:
        raise
    except OSError as error:
        raise unwritable(Path(path), error) from error
    finally:
        temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def whole_folder(path: str | Path) -> Iterator[Path]:
    """Yield a temporary folder next to `path`, whose files are moved to the folder `path` if the block succeeds.

    An existing folder `path` keeps its other files, except files that the ``summary.json`` of the earlier run lists and
    that were not written again.  The summary is moved last.

    Raises
    ------
    InputError
        If `path` is a file or cannot be written, or another process is writing the same folder.
    """
    target = Path(path)
    if target.exists() and not target.is_dir():
        raise InputError(f"-o {path}: this is a file, and the results need a folder; name another")
    with _temporary_beside(target, target) as temporary:
        if any(_is_locked(other) for other in _temporary_paths(temporary.parent, target.name) if other != temporary):
            raise InputError(f"-o {path}: another run is writing this folder; wait for its end, or name another")
        yield temporary
        _move_files(temporary, target)


@contextlib.contextmanager
def files_together(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder inside `folder`, whose files are moved to `folder` if the block succeeds.

    All other files in `folder` are kept, also those that a ``summary.json`` lists.  After an error, an interrupt, or
    the end of the process during the block, the temporary folder is deleted, and so are `folder` and its parents if
    this function created them.

    Raises
    ------
    InputError
        If `folder` is a file or cannot be written.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is a file, and the results need a folder; name another")
    with _temporary_beside(folder / "resgrid", folder) as temporary:
        yield temporary
        for file in sorted(temporary.iterdir()):
            file.replace(folder / file.name)


@contextlib.contextmanager
def _temporary_beside(place: Path, named: Path) -> Iterator[Path]:
    """Yield a new locked temporary folder next to `place`, which is deleted after the block.

    Missing parent folders of `place` are created, and deleted if the block leaves them empty, also if the process ends
    in the block.  `named`: the path in the message if the system refuses an operation.
    """
    created = _make_parents(place, named)
    temporary = temporary_place(place.parent, place.name)
    # finalize also runs if the process ends while a generator is suspended in the block
    remove = weakref.finalize(_temporary_beside, _remove_folders, temporary, created)
    try:
        temporary.mkdir()
        with _locked(temporary):
            yield temporary
    except ResgridError:
        raise
    except OSError as error:
        raise unwritable(named, error) from error
    finally:
        remove()


def _remove_folders(temporary: Path, created: list[Path]) -> None:
    """Delete a temporary folder, and then the empty ones among the folders `created`, innermost first."""
    shutil.rmtree(temporary, ignore_errors=True)
    for folder in created:
        with contextlib.suppress(OSError):  # another process has written into the folder
            folder.rmdir()


def _make_parents(target: Path, named: Path) -> list[Path]:
    """Create the parents of a path, and return the created ones, innermost first.

    `named`: the path in the message of the InputError if the system refuses.
    """
    _refuse_file(target.parent, named)
    try:
        missing = [parent for parent in target.absolute().parents if not parent.exists()]
        target.absolute().parent.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise unwritable(named, error) from error
    return missing


def _refuse_file(folder: Path, named: Path) -> None:
    """Raise InputError, which names the path `named`, if the folder or one of its parents is a file."""
    for parent in (folder, *folder.parents):
        if parent.exists() and not parent.is_dir():
            raise InputError(f"cannot write {named}: {parent} is a file, not a folder; name another folder")


def _move_files(temporary: Path, target: Path) -> None:
    """Move all files of the folder `temporary` to `target`, the summary last.

    Files in subfolders move to subfolders of the same name.  Files in `target` that the summary of an earlier run
    lists, and that are not replaced, are deleted.
    """
    if not target.exists():
        temporary.rename(target)
        return
    names = sorted(file.relative_to(temporary).as_posix() for file in temporary.rglob("*") if not file.is_dir())
    stale = _earlier_files(target) - set(names)
    for name in names:  # before the first file is moved
        place = target / name
        if place.is_dir():
            raise InputError(f"cannot write {place}: this is a directory; rename it, or name another folder")
        _refuse_file(place.parent, place)
    for name in sorted(names, key=lambda name: name == SUMMARY):
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        (temporary / name).replace(target / name)
    for name in stale:
        (target / name).unlink(missing_ok=True)


def _earlier_files(target: Path) -> set[str]:
    """Return the names of the files in the folder `target` that the summary of an earlier run lists.

    A file in a subfolder has the name of the subfolder before its own, with a slash.
    """
    try:
        listed = json.loads((target / SUMMARY).read_text(encoding="utf-8"))["files"]
        names = {str(name) for name in listed}
    except (OSError, ValueError, KeyError, TypeError):
        return set()
    return {name for name in names if _is_inside(name) and (target / name).is_file()}


def _is_inside(name: str) -> bool:
    """Return whether a file name is relative and without ``..``, so that the file lies in the folder or a subfolder."""
    parts = Path(name).parts
    return bool(parts) and "/".join(parts) == name and ".." not in parts and not Path(name).is_absolute()


def temporary_place(folder: Path, stem: str, suffix: str = "") -> Path:
    """Return an unused path for a temporary file or folder, and delete remnants of killed processes.

    `folder`: folder of the path; `stem`, `suffix`: beginning and end of the name, cut off after 80 and 20 characters. A
    remnant has this stem and suffix, is older than a day (`_STALE`), and is not locked.
    """
    with contextlib.suppress(OSError):  # another process deleted the remnant; an unwritable folder fails later
        for remnant in _temporary_paths(folder, stem, suffix):
            if time.time() - remnant.lstat().st_mtime > _STALE and not _is_locked(remnant):
                shutil.rmtree(remnant) if remnant.is_dir() and not remnant.is_symlink() else remnant.unlink()
    return folder / f".{stem[:80]}-{secrets.token_hex(6)}{suffix[:20]}"


def _temporary_paths(folder: Path, stem: str, suffix: str = "") -> list[Path]:
    """Return the existing paths in a folder whose names `temporary_place` has made from this stem and suffix.

    `folder`: the folder; `stem`, `suffix`: beginning and end of the names.
    """
    ours = re.compile(re.escape(f".{stem[:80]}-") + "[0-9a-f]{12}" + re.escape(suffix[:20]))
    return [path for path in folder.iterdir() if ours.fullmatch(path.name)]


@contextlib.contextmanager
def _locked(place: Path) -> Iterator[bool]:
    """Lock a temporary file or folder during the block; yield whether the lock was acquired.

    `place`: path of the file or folder.  The system releases the lock when the process ends.  The value is also True if
    the path does not exist or the file system has no locks (Windows, some network file systems).
    """
    try:
        number = os.open(place, os.O_RDONLY)
    except OSError:
        yield True
        return
    try:
        yield _lock(number)
    finally:
        os.close(number)


def _is_locked(place: Path) -> bool:
    """Return whether another process has locked the file or folder `place`."""
    with _locked(place) as acquired:
        return not acquired


def _lock(number: int) -> bool:
    """Lock an open file descriptor without waiting; return False if another process has locked the file, else True."""
    try:
        import fcntl

        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except (ImportError, OSError):
        pass
    return True


def target_of(path: Path) -> Path:
    """Return the file that a path or symbolic link refers to; raise InputError if that file cannot be written."""
    try:
        target = path.resolve()
        if target.is_dir():
            raise InputError(f"cannot write {path}: it is a directory; name a file")
        if not target.parent.exists():
            raise InputError(f"cannot write {path}: there is no folder {target.parent}; make it first")
    except InputError:
        raise
    except (OSError, RuntimeError, ValueError) as error:  # a cycle of links, a NUL in the name
        raise unwritable(path, error) from error
    return target


def _create_temporary(folder: Path, target: Path, path: Path) -> Path:
    """Create an empty temporary file in a folder, and return its path; raise InputError if this fails.

    `folder`: folder of the temporary file; `target`: file that the temporary file will replace, whose name is part of
    the temporary name; `path`: name of the target as the caller wrote it, for messages.
    """
    # tempfile.mkstemp creates private files (0600); results must obey the user's umask.
    temporary = temporary_place(folder, target.stem, target.suffix)
    try:
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    except OSError as error:
        raise unwritable(path, error) from error
    return temporary


def unwritable(path: Path, error: Exception) -> InputError:
    """Return the InputError for a path that cannot be written; `error`: exception of the failed operation."""
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return InputError(f"cannot write {str(path)!r}: {reason}; check the path, its permissions and the free space")
