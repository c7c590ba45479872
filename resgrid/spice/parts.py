"""A deck of several files put together, its parts held against the hashes in its sidecar."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

from resgrid.errors import InputError
from resgrid.spice.dialects import Dialect


def with_parts(path: Path, data: bytes, parts: Mapping[str, str], rules: Dialect) -> tuple[bytes, list[str]]:
    """Put the parts of a deck in the place of the lines that include them.

    Parameters
    ----------
    path : Path
        The deck.
    data : bytes
        Its content.
    parts : mapping of str to str
        Files beside the deck, and their hashes, from its sidecar.
    rules : Dialect
        Of the deck.

    Returns
    -------
    data : bytes
    findings : list of str
        Which of them differ from what was written.

    Raises
    ------
    InputError
        If a part cannot be read.
    """
    findings = []
    for name, sha256 in parts.items():
        part = path.with_name(Path(name).name)
        try:
            content = part.read_bytes()
        except OSError as error:
            raise InputError(f"cannot read {part}, a part of the deck {path.name}: {error.strerror}") from error
        if hashlib.sha256(content).hexdigest() != sha256:
            findings.append(f"{part.name} differs from what resgrid wrote (SHA-256 in {path.name}.json)")
        data = data.replace(rules.include.format(file=name).encode(), content.rstrip(b"\n"), 1)
    return data, findings
