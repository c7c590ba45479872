"""What is written: JSON that any reader takes, and files that are whole or not there."""

from __future__ import annotations

import json
import math
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click

from resgrid.files import atomic_path, write_text

SCHEMA = 1


def json_text(data: Mapping[str, Any]) -> str:
    """One JSON object as text, with its schema number first."""
    return json.dumps({"schema": SCHEMA, **plain(dict(data))}, allow_nan=False, indent=2)


def plain(value: Any) -> Any:
    """Values that JSON knows: numbers that are finite, text, lists, tables, null."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int):
        return value
    return str(value)


def emit_text(target: str, text: str) -> None:
    """Write text to a file, or to standard output where the target is ``-``."""
    if target == "-":
        click.echo(text, nl=False)
    else:
        write_text(target, text)


def emit_file(target: str, suffix: str, write: Callable[[Path], object]) -> None:
    """Let a writer make a file, or copy what it makes to standard output where the target is ``-``."""
    if target != "-":
        with atomic_path(target) as temporary:
            write(temporary)
        return
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"output{suffix}"
        write(path)
        sys.stdout.flush()
        sys.stdout.buffer.write(path.read_bytes())
