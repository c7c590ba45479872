"""A folder of results that appears whole or not at all."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from resgrid.errors import InputError
from resgrid.files import temporary_place

SUMMARY = "summary.json"


@contextmanager
def whole_folder(path: str | Path) -> Iterator[Path]:
    """Yield a temporary folder beside ``path`` whose files move there if the block succeeds.

    An existing folder keeps its other files; those that its own earlier ``summary.json`` lists and that were not made
    again are removed.  The summary is moved last.
    """
    target = Path(path)
    if target.exists() and not target.is_dir():
        raise InputError(f"-o {path}: this is a file, and the results need a folder; name another")
    made = _made_parents(target)
    temporary = temporary_place(target.parent, target.name)
    try:
        temporary.mkdir()
        yield temporary
        _move(temporary, target)
        made = []
    except OSError as error:
        raise _unwritable(target, error) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        for parent in made:
            _remove_empty(parent)


def _made_parents(target: Path) -> list[Path]:
    """Make the parents of a folder; those that were missing, the innermost first."""
    try:
        missing = [parent for parent in target.absolute().parents if not parent.exists()]
        target.absolute().parent.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise _unwritable(target, error) from error
    return missing


def _move(temporary: Path, target: Path) -> None:
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


def _remove_empty(folder: Path) -> None:
    try:
        folder.rmdir()
    except OSError:  # somebody else has put something there
        return


def _unwritable(target: Path, error: Exception) -> InputError:
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return InputError(
        f"cannot write into {str(target)!r}: {reason}; check the path, its permissions and the free space"
    )
