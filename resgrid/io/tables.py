"""Encoders of file formats for all writers: tables (CSV), records (JSON), named arrays (NPZ), text and HTML pages.

The functions `write` and `emit` choose the encoder by the suffix, and write the bytes to a file or standard output.

A view is a representation of a value: a table, a record (nested dictionary), named arrays, or a message as text.
"""

from __future__ import annotations

import csv
import json
import math
import os
import sys
import zipfile
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from html import escape
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from resgrid._internal.files import write_bytes
from resgrid.core.axis import Axis
from resgrid.errors import InputError

SCHEMA = 1
"""Version number of the JSON records, stored under the key ``schema``."""

Views = Mapping[str, Callable[[], Any]]
"""Functions that return the content of a file of a value, by name: ``"table"`` (CSV), ``"record"`` (JSON) and so on.

Only the content that is written is computed.
"""


class Format(NamedTuple):
    """A file format.

    `view`: name of the content: "table" (columns by name), "record" (dictionary for JSON), "arrays" (arrays by name),
    "message" (text for ROS), "waveforms", "edges" or "graph"; `encode`: function that converts this content to the
    bytes of the file.
    """

    view: str
    encode: Callable[[Any], bytes]


def csv_bytes(table: Mapping[str, Sequence[Any]]) -> bytes:
    """Return the bytes of a CSV table, with a first line of column names; NaN becomes an empty entry.

    `table`: columns of equal length, by name.
    """
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table)
    writer.writerows(zip(*map(_cells, table.values()), strict=True))
    return text.getvalue().encode()


def _cells(column: Sequence[Any]) -> list[Any]:
    """Return the entries of a column as a list in which NaN is replaced by empty text."""
    values = column.tolist() if isinstance(column, np.ndarray) else column
    return ["" if isinstance(value, float) and math.isnan(value) else value for value in values]


def json_bytes(record: Mapping[str, Any]) -> bytes:
    """Return the bytes of a record as one JSON object that starts with the version number `SCHEMA`, and a line end."""
    return f"{json_text(record)}\n".encode()


def json_text(record: Mapping[str, Any]) -> str:
    """Return the text of a record as one JSON object that starts with the version number `SCHEMA`."""
    return json.dumps({"schema": SCHEMA, **as_json(record)}, allow_nan=False, indent=2)


def as_json(value: Any) -> Any:
    """Return a value converted to JSON types: arrays to lists, NaN and infinity to null, other objects to text."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): as_json(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [as_json(entry) for entry in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int) else str(value)


def npz_bytes(arrays: Mapping[str, Any]) -> bytes:
    """Return the bytes of an NPZ file of named arrays, without timestamps, so that equal arrays give equal bytes."""
    data = BytesIO()
    with zipfile.ZipFile(data, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            entry = BytesIO()
            np.lib.format.write_array(entry, np.asanyarray(array), allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), entry.getvalue(), zipfile.ZIP_DEFLATED)
    return data.getvalue()


FORMATS: dict[str, Format] = {
    ".csv": Format("table", csv_bytes),
    ".json": Format("record", json_bytes),
    ".npz": Format("arrays", npz_bytes),
    ".yaml": Format("message", str.encode),
    ".raw": Format("waveforms", bytes),
    ".txt": Format("edges", str.encode),
    ".graphml": Format("graph", bytes),
}
"""File formats by suffix; on standard output (``-``), a value has the first of these formats that exists for it."""


def suffix_of(target: str | os.PathLike[str], views: Collection[str], kind: str) -> str:
    """Return the suffix that selects the format of the file `target`; raise InputError for an unknown suffix.

    `views`: names of the contents that the value has, such as ``"table"`` (see `Format`); `kind`: name of the value in
    messages, such as "a path".
    """
    known = [suffix for suffix, form in FORMATS.items() if form.view in views]
    suffix = known[0] if os.fspath(target) == "-" else Path(target).suffix.lower()
    if suffix not in known:
        *others, last = known
        words = f"{', '.join(others)} or {last}" if others else last
        raise InputError(f"cannot write {kind} as {os.fspath(target)!r}: its name must end in {words}")
    return suffix


def write(target: str | os.PathLike[str], views: Views, kind: str) -> Path:
    """Write a value atomically in the format that the suffix selects, and return the path of the file.

    `target`: name of the file, ``-`` for standard output, which is then also the path; `views`: functions without
    arguments that return the content of the file, by the name of the content: ``table`` (CSV), ``record`` (JSON),
    ``arrays`` (NPZ) and so on; `kind`: name of the value in messages, such as "a path".
    """
    form = FORMATS[suffix_of(target, views, kind)]
    return emit(target, form.encode(views[form.view]()))


def emit(target: str | os.PathLike[str], data: bytes) -> Path:
    """Write the bytes `data` to the file `target` atomically, or to standard output if `target` is ``-``.

    The result is the path of the file, or ``Path("-")``.
    """
    if os.fspath(target) == "-":
        stream = getattr(sys.stdout, "buffer", None)
        if stream is None:
            raise InputError("'-' is standard output, but sys.stdout accepts no bytes here; give the name of a file")
        sys.stdout.flush()
        rest = memoryview(data)
        while rest:  # an unbuffered stream may write a part only, and the next write reports the cause
            rest = rest[stream.write(rest) :]
        return Path(target)
    return write_bytes(target, data)


def require_names(axes: Iterable[Axis], names: Sequence[str]) -> None:
    """Raise InputError if an axis has the same name as another column of a file.

    `axes`: the axes; `names`: names of all columns of a file, those of the axes included.
    """
    for axis in axes:
        if names.count(axis.name) > 1:
            raise InputError(
                f"axis {axis.name!r} has the name of another column of this file; rename the axis (name of the axis in "
                "[grid]), or write another format"
            )


def html_page(title: str, markdown: str) -> str:
    """Return an HTML page with a title and the content of a Markdown text."""
    from markdown_it import MarkdownIt

    body = MarkdownIt("commonmark").enable("table").render(markdown)
    return _PAGE.format(title=escape(title), body=body)


_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<title>{title}</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<style>
:root {{ --text: #1a1a1a; --page: #fff; --line: #ccc; --soft: #f3f3f3; --link: #0a5fb0; }}
@media (prefers-color-scheme: dark) {{
  :root {{ --text: #e4e4e4; --page: #16181b; --line: #43474d; --soft: #24272b; --link: #7ab7f0; }}
}}
body {{ font: 15px/1.45 sans-serif; color: var(--text); background: var(--page); max-width: 60em; margin: 2em auto;
  padding: 0 1em; overflow-wrap: break-word; }}
a {{ color: var(--link); }}
code {{ background: var(--soft); padding: 0 0.2em; border-radius: 3px; }}
table {{ border-collapse: collapse; margin: 1em 0; }}
th, td {{ text-align: left; vertical-align: top; padding: 0.2em 0.8em 0.2em 0; border-bottom: 1px solid var(--line); }}
td:nth-child(2) {{ white-space: nowrap; }}
img {{ max-width: 100%; max-height: 36em; background: #fff; border-radius: 4px; }}
@media (max-width: 40em) {{
  body {{ margin: 1em auto; padding: 0 0.8em; }}
  h1 {{ font-size: 1.5em; }}
  table {{ font-size: 0.9em; }}
  th, td {{ padding-right: 0.6em; }}
  td:nth-child(2) {{ white-space: normal; }}
  code {{ overflow-wrap: anywhere; }}
}}
</style>
</head>
<body>
{body}
</body>
</html>
"""
