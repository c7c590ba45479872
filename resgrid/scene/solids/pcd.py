"""Reader of point clouds in PCD format, versions 0.6 and 0.7: ascii, binary and binary_compressed.

The format is described at https://pointclouds.org/documentation/tutorials/pcd_file_format.html
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.files import read_bytes
from resgrid._internal.memory import require_memory
from resgrid.errors import InputError

_TYPES = {("F", 4): "<f4", ("F", 8): "<f8"} | {
    (kind, size): f"<{kind.lower()}{size}" for kind in "IU" for size in (1, 2, 4, 8)
}
"""NumPy types of a field, by the entries of TYPE and SIZE in the header."""

_MAX_HEADER = 1 << 16
"""Largest length of the header of a PCD file, in bytes; longer ones are rejected."""


class PCDHeader(NamedTuple):
    """Header of a PCD file.

    `dtype`: NumPy type of one point with its named fields; `points`: number of points; `encoding`: ascii, binary or
    binary_compressed; `start`: offset of the first byte of the data in the file.
    """

    dtype: np.dtype[np.void]
    points: int
    encoding: str
    start: int


def read_pcd(path: Path) -> NDArray[np.float64]:
    """Return the points (n, 3) of a PCD file; points with a coordinate NaN, which mark missing echoes, are omitted."""
    data = read_bytes(path)
    header = _header(data, path)
    require_memory(header.points * (header.dtype.itemsize + 24.0), f"{path}: {header.points} points", "thin the cloud")
    body = memoryview(data)[header.start :]
    if header.encoding == "ascii":
        points = _ascii_points(bytes(body), header, path)
    else:
        compressed = header.encoding == "binary_compressed"
        records = _planes(_decompressed(body, header, path), header) if compressed else _records(body, header, path)
        points = np.column_stack([records[name].reshape(-1).astype(np.float64) for name in "xyz"])
    return points[~np.isnan(points).any(axis=1)]


def _header(data: bytes, path: Path) -> PCDHeader:
    """Return the header of a PCD file; `data`: content of the file; `path`: name of the file, for messages."""
    entries: dict[str, list[str]] = {}
    start = 0
    while "DATA" not in entries:
        end = data.find(b"\n", start, _MAX_HEADER)
        if end < 0:
            raise InputError(f"{path}: this is not a PCD file: its header has no line DATA; save the cloud again")
        words = data[start:end].decode("latin-1").split("#")[0].split()
        start = end + 1
        if words:
            entries[words[0].upper()] = words[1:]
    try:
        names = [name.lower() for name in entries.get("FIELDS", entries.get("COLUMNS", []))]
        counts = [int(count) for count in entries.get("COUNT", ["1"] * len(names))]
        if len({len(names), len(counts), len(entries["TYPE"]), len(entries["SIZE"])}) > 1:
            raise ValueError("FIELDS, SIZE, TYPE and COUNT differ in length")
        if any(name in ("x", "y", "z") and count != 1 for name, count in zip(names, counts, strict=True)):
            raise ValueError("COUNT of x, y and z must be 1")
        keys = list(zip(entries["TYPE"], map(int, entries["SIZE"]), strict=True))
        shape = zip(names, [_TYPES[kind.upper(), size] for kind, size in keys], counts, strict=True)
        labels = [
            (name if name in "xyz" else f"{name}_{n}", kind, (count,)) for n, (name, kind, count) in enumerate(shape)
        ]
        dtype = np.dtype(labels)
        points = (
            int(entries["POINTS"][0]) if "POINTS" in entries else int(entries["WIDTH"][0]) * int(entries["HEIGHT"][0])
        )
        encoding = entries["DATA"][0].lower()
    except (KeyError, ValueError, IndexError) as error:
        raise InputError(
            f"{path}: the header of this PCD file is incomplete or damaged ({error}); save it again"
        ) from None
    if not {"x", "y", "z"} <= set(dtype.names or ()):
        raise InputError(f"{path}: this cloud has the fields {', '.join(names)}, but x, y and z are needed")
    if encoding not in ("ascii", "binary", "binary_compressed"):
        raise InputError(f"{path}: DATA {encoding} is unknown; save it as ascii, binary or binary_compressed")
    if points < 0:
        raise InputError(f"{path}: the header of this PCD file has {points} points; save it again")
    return PCDHeader(dtype, points, encoding, start)


def _ascii_points(body: bytes, header: PCDHeader, path: Path) -> NDArray[np.float64]:
    """Return the points (n, 3) of an ascii file; `body`: text after the header; `path`: for messages."""
    columns = sum(int(np.prod(header.dtype[name].shape)) for name in header.dtype.names or ())
    words = body.split()
    if len(words) != header.points * columns:
        raise _cut_short(path, f"{header.points} points of {columns} numbers", f"{len(words)} numbers")
    first = np.cumsum([0, *(int(np.prod(header.dtype[name].shape)) for name in header.dtype.names or ())])
    where = [int(first[(header.dtype.names or ()).index(name)]) for name in "xyz"]
    try:
        return np.column_stack([np.array(words[column::columns], dtype=np.float64) for column in where])
    except ValueError as error:
        raise InputError(f"{path}: a coordinate is not a number ({error}); save the cloud again") from None


def _records(body: memoryview, header: PCDHeader, path: Path) -> NDArray[np.void]:
    """Return the structured records (n,) of a binary file; `body`: bytes after the header; `path`: for messages."""
    needed = header.points * header.dtype.itemsize
    if len(body) < needed:
        raise _cut_short(path, f"{needed} bytes", f"{len(body)} bytes")
    return np.frombuffer(body[:needed], dtype=header.dtype)


def _planes(data: bytes, header: PCDHeader) -> dict[str, NDArray[np.void]]:
    """Return the values of each field, one per point, by name of the field.

    `data`: decompressed data, in which the values of a field are consecutive.
    """
    fields, start = {}, 0
    for name in header.dtype.names or ():
        kind, size = header.dtype[name], header.dtype[name].itemsize * header.points
        fields[name] = np.frombuffer(data[start : start + size], dtype=kind)
        start += size
    return fields


def _decompressed(body: memoryview, header: PCDHeader, path: Path) -> bytes:
    """Return the decompressed data of a binary_compressed file.

    `body`: bytes after the header: compressed and decompressed length, each a uint32, then the data; `path`: for
    messages.
    """
    needed = header.points * header.dtype.itemsize
    if len(body) < 8:
        raise _cut_short(path, "8 bytes with the lengths of the data", f"{len(body)} bytes")
    size, full = (int(number) for number in np.frombuffer(body[:8], "<u4"))
    if len(body) - 8 < size:
        raise _cut_short(path, f"{size} compressed bytes", f"{len(body) - 8} bytes")
    if full != needed:
        raise _cut_short(path, f"{needed} bytes after decompression", f"{full} bytes")
    try:
        data = decompress_lzf(bytes(body[8 : 8 + size]), full)
    except IndexError:
        data = b""
    if len(data) != full:
        raise InputError(f"{path}: the compressed data is damaged; save the cloud again")
    return data


def decompress_lzf(data: bytes, size: int) -> bytes:
    """Return data decompressed by the algorithm of LibLZF (M. Lehmann); raise IndexError for damaged data.

    `size`: length of the decompressed data in bytes; decompression stops once the result is longer.
    A control byte below 32 precedes that many literal bytes plus one.  Other control bytes hold the length minus 2 of a
    repetition in the upper three bits (7: the next byte is added), and the upper five bits of its distance minus 1.
    """
    out, at = bytearray(), 0
    while at < len(data) and len(out) <= size:
        control = data[at]
        at += 1
        if control < 32:
            out += data[at : at + control + 1]
            at += control + 1
            continue
        length = control >> 5
        if length == 7:
            length += data[at]
            at += 1
        distance = ((control & 31) << 8) + data[at] + 1
        at += 1
        first = len(out) - distance
        if first < 0:
            raise IndexError("a repetition starts before the data")
        pattern = out[first : first + length + 2]
        out += (pattern * ((length + 2) // len(pattern) + 1))[: length + 2]
    return bytes(out)


def _cut_short(path: Path, needed: str, found: str) -> InputError:
    return InputError(f"{path}: the file is cut short or damaged: it needs {needed}, but has {found}; copy it again")
