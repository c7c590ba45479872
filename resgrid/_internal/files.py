"""Files read with errors that say what is wrong; files and folders written whole or not at all."""

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
from collections.abc import Iterator
from pathlib import Path

from resgrid.errors import InputError

SUMMARY = "summary.json"
"""Lists the files of a folder of results."""

MAX_TEXT_BYTES = 1 << 28

_STALE = 86_400.0
"""Seconds after which what a killed process left half-written is taken for that."""


@contextlib.contextmanager
def temporary_folder() -> Iterator[Path]:
    """A folder among the system's temporary ones (``TMPDIR``), gone at the end.

    Also where the process ends while a thread that was left behind is removing it: both do it then.
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
    """All bytes of a file, or the first ones.

    `limit`: most bytes that there may be; `name`: what messages call it; `first`: how many are read, -1 for all;
    `piped`: whether it may be a pipe.
    """
    said = str(path) if name is None else name
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise InputError(f"{said}: this is a directory; give the file inside it")
        if stat.S_ISCHR(status.st_mode) or stat.S_ISBLK(status.st_mode):
            raise InputError(f"{said}: this is a device; give a file")
        if not (piped or stat.S_ISREG(status.st_mode)):
            raise InputError(f"{said}: this is no regular file; give one")
        if limit is not None and status.st_size > limit:
            raise InputError(f"{said}: {status.st_size} bytes are too many (at most {limit}); is it the right file?")
        with path.open("rb") as file:
            return file.read(first)
    except FileNotFoundError:
        raise InputError(f"{said}: there is no such file; check the name and the folder") from None
    except PermissionError:
        raise InputError(f"{said}: permission denied; make the file readable") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{said}: cannot be read ({error})") from None


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


def write_text(path: str | os.PathLike[str], text: str) -> Path:
    r"""Write UTF-8 text atomically, line ends as they are."""
    return write_bytes(path, text.encode("utf-8"))


def write_bytes(path: str | os.PathLike[str], data: bytes) -> Path:
    """Write bytes atomically; as `write_text` otherwise."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
    return Path(path)


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path that takes the place of ``path`` if the block succeeds and vanishes if it does not.

    The temporary file lies in the same folder and has the same suffix (writers that judge by it see what they
    expect).  A symbolic link is followed; a device such as ``/dev/stdout`` is written to once the content is complete.
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
    except OSError as error:
        raise _unwritable(Path(path), error) from error
    finally:
        temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def whole_folder(path: str | Path) -> Iterator[Path]:
    """Yield a temporary folder beside ``path`` whose files move there if the block succeeds.

    An existing folder keeps its other files; those that its own earlier ``summary.json`` lists and that were not made
    again are removed.  The summary is moved last.  While another process makes the same folder it is refused.
    """
    target = Path(path)
    if target.exists() and not target.is_dir():
        raise InputError(f"-o {path}: this is a file, and the results need a folder; name another")
    parents = _make_parents(target)
    temporary = temporary_place(target.parent, target.name)
    try:
        temporary.mkdir()
        with _held(temporary):
            if any(_is_held(other) for other in _beside(temporary.parent, target.name) if other != temporary):
                raise InputError(f"-o {path}: another run is writing this folder; wait for its end, or name another")
            yield temporary
            _move_files(temporary, target)
        parents = []
    except OSError as error:
        raise _unwritable(target, error) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        for parent in parents:
            with contextlib.suppress(OSError):  # somebody else has put something there
                parent.rmdir()


def _make_parents(target: Path) -> list[Path]:
    """Make the parents of a folder; those that were missing, the innermost first."""
    try:
        missing = [parent for parent in target.absolute().parents if not parent.exists()]
        target.absolute().parent.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise _unwritable(target, error) from error
    return missing


def _move_files(temporary: Path, target: Path) -> None:
    if not target.exists():
        temporary.rename(target)
        return
    names = sorted(file.name for file in temporary.iterdir())
    stale = _earlier_files(target) - set(names)
    for name in sorted(names, key=lambda name: name == SUMMARY):
        (temporary / name).replace(target / name)
    for name in stale:
        (target / name).unlink(missing_ok=True)


def _earlier_files(target: Path) -> set[str]:
    """Files that an earlier run left here, by its own summary."""
    try:
        listed = json.loads((target / SUMMARY).read_text(encoding="utf-8"))["files"]
        names = {str(name) for name in listed}
    except (OSError, ValueError, KeyError, TypeError):
        return set()
    return {name for name in names if Path(name).name == name and (target / name).is_file()}


def temporary_place(folder: Path, stem: str, suffix: str = "") -> Path:
    """Where something may be made before it is renamed; what was killed while it made the same is removed."""
    with contextlib.suppress(OSError):  # somebody else removed it; whether the folder can be written shows itself
        for left in _beside(folder, stem, suffix):
            if time.time() - left.lstat().st_mtime > _STALE and not _is_held(left):
                shutil.rmtree(left) if left.is_dir() and not left.is_symlink() else left.unlink()
    return folder / f".{stem[:80]}-{secrets.token_hex(6)}{suffix[:20]}"


def _beside(folder: Path, stem: str, suffix: str = "") -> list[Path]:
    """Every place in a folder where something of that name is being made, or was."""
    ours = re.compile(re.escape(f".{stem[:80]}-") + "[0-9a-f]{12}" + re.escape(suffix[:20]))
    return [path for path in folder.iterdir() if ours.fullmatch(path.name)]


@contextlib.contextmanager
def _held(place: Path) -> Iterator[bool]:
    """Hold what is being made until this process ends, however it does; yields whether nobody else holds it.

    That is True, too, where there are no locks (on Windows, in some networks), and of what is gone.
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


def _is_held(place: Path) -> bool:
    with _held(place) as alone:
        return not alone


def _lock(number: int) -> bool:
    try:
        import fcntl

        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except (ImportError, OSError):
        pass
    return True


def target_of(path: Path) -> Path:
    """The file itself that a name, perhaps of a link, stands for; refused where there can be none."""
    try:
        target = path.resolve()
        if target.is_dir():
            raise InputError(f"cannot write {path}: it is a directory; name a file")
        if not target.parent.exists():
            raise InputError(f"cannot write {path}: there is no folder {target.parent}; make it first")
    except (OSError, RuntimeError, ValueError) as error:  # a loop of links, a NUL in the name
        raise _unwritable(path, error) from error
    return target


def _create_temporary(folder: Path, target: Path, path: Path) -> Path:
    # Not tempfile.mkstemp: its files are private (0600), ours keep to the user's umask.
    temporary = temporary_place(folder, target.stem, target.suffix)
    try:
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    except OSError as error:
        raise _unwritable(path, error) from error
    return temporary


def _unwritable(path: Path, error: Exception) -> InputError:
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return InputError(f"cannot write {str(path)!r}: {reason}; check the path, its permissions and the free space")
