"""A deck of several files put together."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from resgrid.errors import InputError
from resgrid.spice.dialects.record import Dialect


def with_parts(path: Path, data: bytes, parts: Iterable[str], rules: Dialect) -> bytes:
    """Put the parts of a deck in the place of the lines that include them."""
    for name in parts:
        part = path.with_name(Path(name).name)
        try:
            content = part.read_bytes()
        except OSError as error:
            raise InputError(f"cannot read {part}, a part of the deck {path.name}: {error.strerror}") from error
        data = data.replace(rules.include.format(file=name).encode(), content.rstrip(b"\n"), 1)
    return data
