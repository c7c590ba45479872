"""Checkpoint files: JSON lines from which a later run can continue after the process that wrote them was killed."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from resgrid.errors import InputError

_REMEDY = "remove it or name another"

_MAX_HEAD_BYTES = 65536
"""Maximum length of the first line in bytes.  The limit bounds the memory for reading a file that is no checkpoint."""


class Journal:
    """A checkpoint file of JSON lines; the first line (the head) identifies the run.

    Every further line is a record, a result of the run.  An incomplete last line is deleted, and the continued run
    writes its record again: the file of an interrupted and continued run equals that of an uninterrupted run.
    """

    def __init__(self, path: str | os.PathLike[str], head: dict[str, Any]) -> None:
        """Create or continue a file; raise InputError if the file is not a checkpoint or belongs to another run.

        `path`: path of the file; `head`: description of the run (values that JSON can represent, by name), which the
        first line of the file must equal.
        """
        self._path, line = Path(path), _line(head).encode()
        try:
            with self._path.open("ab+") as file:
                file.seek(0)
                first = file.readline(_MAX_HEAD_BYTES)
                if line.startswith(first) and first != line:  # empty, or the head is incomplete
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
        """Yield the records of the file in order, without the head; raise InputError if a line is damaged.

        A record is the dictionary that was passed to `append`.
        """
        with self._path.open(encoding="utf-8", errors="replace") as file:
            next(file)
            for number, text in enumerate(file, 2):
                try:
                    record = json.loads(text)
                except ValueError as error:
                    raise self.damaged(f"line {number}: {error}") from error
                yield record

    def append(self, record: dict[str, Any]) -> None:
        """Append a record and close the file, so that the record survives the death of the process.

        `record`: values that JSON can represent, by name.  Raise InputError if the file cannot be written.
        """
        try:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(_line(record))
        except OSError as error:
            raise self._unusable(error) from error

    def _check(self, first: bytes, head: dict[str, Any]) -> None:
        """Raise InputError if the first line of the file, `first`, is not the description of this run, `head`."""
        try:
            found = json.loads(first.decode(errors="replace"))
        except ValueError as error:
            raise self.damaged(error) from error
        if not isinstance(found, dict) or found.keys() != head.keys():
            raise self.damaged("its first line is not that of a checkpoint")
        if found != head:
            raise InputError(
                f"the checkpoint {str(self._path)!r} belongs to another run: the scene, the chip or the seed differs; "
                f"{_REMEDY}"
            )

    def _unusable(self, error: OSError) -> InputError:
        """Return the InputError for a checkpoint that cannot be written; `error`: exception of the failed operation."""
        return InputError(
            f"cannot write the checkpoint {str(self._path)!r}: {error.strerror}; check the path, its permissions and "
            "the free space, then run again: the results that it holds are kept"
        )

    def damaged(self, why: object) -> InputError:
        """Return the InputError for a damaged checkpoint; `why`: reason, for the message."""
        return InputError(f"cannot read the checkpoint {str(self._path)!r}: {why}; {_REMEDY}")


def _line(record: dict[str, Any]) -> str:
    """Return a record (values that JSON can represent, by name) as a line of compact JSON, with the line end."""
    return json.dumps(record, separators=(",", ":")) + "\n"
