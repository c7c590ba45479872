"""Data that all tasks of a parallel job share: pickled into a file once, read and cached by every worker."""

from __future__ import annotations

import hashlib
import pickle
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from resgrid.errors import InputError


@dataclass(frozen=True)
class SharedData:
    """The argument, in pickled form, that all calls of a parallel job part (`JobPart`) share.

    `digest`: SHA-256 hash of the data; `path`: file that contains the data; `data`: the bytes, for a worker that cannot
    read the file, else None.
    """

    digest: str
    path: str = field(compare=False)
    data: bytes | None = field(default=None, compare=False, repr=False)


def packed(shared: Any, folder: Path) -> SharedData:
    """Pickle the shared argument of a job part into a file, and return its hash and path.

    `shared`: the argument; `folder`: folder of the file, which is named after the hash. Raises InputError if the
    argument cannot be pickled.
    """
    try:
        data = pickle.dumps(shared, protocol=5)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise InputError(
            f"the shared data of the items cannot be pickled for worker processes: {error}; use threads"
        ) from error
    digest = hashlib.sha256(data).hexdigest()
    path = folder / digest
    path.write_bytes(data)
    return SharedData(digest, str(path))


@lru_cache(maxsize=4)
def unpacked(packed: SharedData) -> Any:
    """Return the shared argument of a job part, which is then cached in the worker process.

    Raises OSError if the file of the argument cannot be read.
    """
    return pickle.loads(Path(packed.path).read_bytes() if packed.data is None else packed.data)
