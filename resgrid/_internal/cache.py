"""Disk cache of arrays, and of the parts of unfinished results, so that a later run does not compute them again.

The name of a cached file contains a hash of the inputs from which the result was computed.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.files import atomic_path


def cache_folder() -> Path | None:
    """Return the folder of cached results; None if the environment variable ``RESGRID_CACHE`` is set but empty.

    ``RESGRID_CACHE`` names the folder.  If this variable is not set, the folder is ``resgrid`` in ``XDG_CACHE_HOME`` or
    in ``~/.cache``, and the result is None if the user has no home folder.
    """
    named = os.environ.get("RESGRID_CACHE")
    if named is not None:
        return Path(named) if named else None
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        return (Path(base) if base else Path.home() / ".cache") / "resgrid"
    except RuntimeError:  # the user has no home folder
        return None


def load_array(name: str, key: str) -> NDArray[Any] | None:
    """Return the cached array of a key; None if there is no cache folder, no array of this key, or a damaged file.

    `name`: kind of the result, the first part of the file's name; `key`: hash of the inputs.
    """
    folder = cache_folder()
    if folder is None:
        return None
    try:
        with (folder / f"{name}-{key}.npz").open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            found: NDArray[Any] = arrays["array"]
            return found
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None


def store_array(name: str, key: str, array: NDArray[Any]) -> None:
    """Write an array to the cache; do nothing if there is no cache folder or the folder cannot be written.

    `name`: kind of the result, the first part of the file's name; `key`: hash of the inputs.
    """
    folder = cache_folder()
    if folder is None:
        return
    with contextlib.suppress(OSError, ValueError):  # a cache is not needed for the result
        folder.mkdir(parents=True, exist_ok=True)
        with atomic_path(folder / f"{name}-{key}.npz") as path, path.open("wb") as file:
            np.savez_compressed(file, array=array)


@contextlib.contextmanager
def unfinished_file(name: str, key: str) -> Iterator[Path | None]:
    """Yield the path of a file for parts of an unfinished result, and delete the file if the block succeeds.

    The block creates the file, or continues the file of an interrupted run: an interrupt leaves the file in the cache.
    The path is None if there is no cache folder, if the folder cannot be written, or while another process uses the
    file. `name`: kind of the result, the first part of the file's name; `key`: hash of the inputs.
    """
    folder = cache_folder()
    with contextlib.ExitStack() as stack:
        path = None
        if folder is not None:
            with contextlib.suppress(OSError):
                folder.mkdir(parents=True, exist_ok=True)
                locked = folder / f"{name}-{key}.lock"
                lock = stack.enter_context(locked.open("w"))
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                # Another process may have deleted the file between open and flock; its lock would then protect nothing.
                if os.path.samestat(os.fstat(lock.fileno()), locked.stat()):
                    path = folder / f"{name}-{key}.part"
        yield path
        if path is not None:
            for used in (path, path.with_suffix(".lock")):
                used.unlink(missing_ok=True)
