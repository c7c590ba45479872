"""Files of results that grow line by line, and can be taken up again wherever their writer was killed."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from resgrid.errors import InputError

_REMEDY = "remove it or name another"

_LONGEST = 65536
"""Bytes of a first line at most: nobody else's file is read further."""


class Journal:
    """A file of JSON lines below a first one that says what they belong to.

    A last line that was cut off is dropped, and written again in its turn: a run that was killed and one that was not
    end in the same bytes.
    """

    def __init__(self, path: str | os.PathLike[str], head: dict[str, Any]) -> None:
        """Begin a file, or take one up; InputError if it is none of ours, or belongs to another run."""
        self._path, line = Path(path), _line(head).encode()
        try:
            with self._path.open("ab+") as file:
                file.seek(0)
                first = file.readline(_LONGEST)
                if line.startswith(first) and first != line:  # new, or cut off within its first line
                    file.truncate(0)
                    file.write(line)
                else:
                    self._check(first, head)
                    file.truncate(len(first) + file.read().rfind(b"\n") + 1)
        except FileNotFoundError as error:
            folder = str(self._path.parent)
            raise InputError(
                f"cannot write the checkpoint {str(path)!r}: there is no folder {folder!r}; make it first"
            ) from error
        except OSError as error:
            raise self._unusable(error) from error

    def __iter__(self) -> Iterator[dict[str, Any]]:
        """The lines so far, without the first."""
        with self._path.open(encoding="utf-8", errors="replace") as file:
            next(file)
            for number, text in enumerate(file, 2):
                try:
                    record = json.loads(text)
                except ValueError as error:
                    raise self.damaged(f"line {number}: {error}") from error
                yield record

    def append(self, record: dict[str, Any]) -> None:
        """Write one more line; it is the system's at once, so that a process that is killed loses none."""
        try:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(_line(record))
        except OSError as error:
            raise self._unusable(error) from error

    def _check(self, first: bytes, head: dict[str, Any]) -> None:
        try:
            found = json.loads(first.decode(errors="replace"))
        except ValueError as error:
            raise self.damaged(error) from error
        if not isinstance(found, dict) or found.keys() != head.keys():
            raise self.damaged("it does not begin as one")
        if found != head:
            raise InputError(
                f"the checkpoint {str(self._path)!r} belongs to another run: the scene, the chip or the seed differs; "
                f"{_REMEDY}"
            )

    def _unusable(self, error: OSError) -> InputError:
        return InputError(
            f"cannot write the checkpoint {str(self._path)!r}: {error.strerror}; check the path, its permissions and "
            "the free space, then run again: what it holds is taken up"
        )

    def damaged(self, why: object) -> InputError:
        """What to raise of a file with a fault."""
        return InputError(f"cannot read the checkpoint {str(self._path)!r}: {why}; {_REMEDY}")


def _line(record: dict[str, Any]) -> str:
    return json.dumps(record, separators=(",", ":")) + "\n"
