"""Results on disk under a key of their inputs, so that a later run with the same inputs does not compute them again."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import os
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.files import atomic_path


def cache_folder() -> Path | None:
    """Return the folder of cached results, or None if the variable ``RESGRID_CACHE`` is empty.

    ``RESGRID_CACHE`` names the folder; without it, the folder is ``resgrid`` in ``XDG_CACHE_HOME`` or in ``~/.cache``.
    """
    named = os.environ.get("RESGRID_CACHE")
    if named is not None:
        return Path(named) if named else None
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        return (Path(base) if base else Path.home() / ".cache") / "resgrid"
    except RuntimeError:  # the user has no home folder
        return None


def fingerprint(*values: Any) -> str:
    """Return a hash of values as 32 hexadecimal digits.

    Arrays count with shape, data type and bytes, dataclasses with class name and fields, floats with all their digits.
    """
    digest = hashlib.sha256()
    for part in _parts(values):
        digest.update(len(part).to_bytes(8, "little"))
        digest.update(part)
    return digest.hexdigest()[:32]


def _parts(value: Any) -> Iterator[bytes]:
    """Yield byte strings that determine a value."""
    if isinstance(value, np.ndarray):
        yield f"array {value.shape} {value.dtype.str}".encode()
        yield np.ascontiguousarray(value).tobytes()
    elif dataclasses.is_dataclass(value):
        yield f"record {type(value).__name__}".encode()
        for field in dataclasses.fields(value):
            yield field.name.encode()
            yield from _parts(getattr(value, field.name))
    elif isinstance(value, Mapping):
        yield f"mapping {len(value)}".encode()
        for key in sorted(value):
            yield from _parts(key)
            yield from _parts(value[key])
    elif isinstance(value, list | tuple):
        yield f"list {len(value)}".encode()
        for entry in value:
            yield from _parts(entry)
    else:
        yield f"{type(value).__name__} {value!r}".encode()


def load_array(name: str, key: str) -> NDArray[Any] | None:
    """Return the cached array of a key, or None if there is none or its file is damaged.

    `name`: kind of the result, the first part of the file's name; `key`: fingerprint of the inputs.
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
    """Write an array to the cache; without effect if there is no cache or it cannot be written.

    `name`: kind of the result, the first part of the file's name; `key`: fingerprint of the inputs.
    """
    folder = cache_folder()
    if folder is None:
        return
    with contextlib.suppress(OSError, ValueError):  # a cache is not needed for the result
        folder.mkdir(parents=True, exist_ok=True)
        with atomic_path(folder / f"{name}-{key}.npz") as path, path.open("wb") as file:
            np.savez_compressed(file, array=array)
