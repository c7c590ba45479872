"""Many short texts in one array of bytes, put together column by column."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from string import Formatter

import numpy as np
from numpy.typing import NDArray

from resgrid.spice.text import kernels


@dataclass(frozen=True, eq=False)
class Texts:
    r"""Texts of ASCII characters, one after the other.

    `data`: all characters; `offset` (n + 1,): where each text begins, and where the last one ends.

    Examples
    --------
    >>> weave(2, b"r", names(["a", "b"]), b" ", numbers(np.array([1e3, 0.1])), b"\n").decode()
    'ra 1000.0\nrb 0.1\n'
    """

    data: NDArray[np.uint8]
    offset: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.offset) - 1

    def decode(self) -> str:
        """All of them as one string."""
        return self.data.tobytes().decode("ascii")

    def take(self, index: NDArray[np.int64]) -> Chosen:
        """Some of them, as a column for `weave`; shape of ``index`` (rows,)."""
        return Chosen(self, index)

    def strings(self) -> list[str]:
        """Each of them as a string."""
        text, ends = self.decode(), self.offset.tolist()
        return [text[a:b] for a, b in pairwise(ends)]


@dataclass(frozen=True, eq=False)
class Chosen:
    """A column: one of the texts for every row."""

    texts: Texts
    index: NDArray[np.int64]


def names(words: Sequence[str]) -> Texts:
    """Make texts of ASCII strings."""
    lengths = np.fromiter(map(len, words), dtype=np.int64, count=len(words))
    data = np.frombuffer("".join(words).encode("ascii"), dtype=np.uint8)
    return Texts(data, np.concatenate([[0], np.cumsum(lengths)]))


def numbers(values: NDArray[np.float64]) -> Texts:
    """Write finite numbers as ``repr`` does.  Shapes: `values` (n,)."""
    bits = np.ascontiguousarray(values, dtype=np.float64).view(np.uint64)
    out = np.empty(kernels.LONGEST * len(bits), dtype=np.uint8)
    offset = np.empty(len(bits) + 1, dtype=np.int64)
    kernels.shortest_decimals(bits, kernels.powers_of_ten(), out, offset)
    return Texts(out[: offset[-1]].copy(), offset)


def weave(rows: int, *columns: bytes | Texts | Chosen) -> Texts:
    """Put rows of text together from columns."""
    length = np.full(rows, sum(len(column) for column in columns if isinstance(column, bytes)), dtype=np.int64)
    chosen = [_chosen(column) for column in columns]
    for column in chosen:
        if isinstance(column, Chosen):
            length += np.diff(column.texts.offset)[column.index]
    offset = np.concatenate([np.zeros(1, dtype=np.int64), np.cumsum(length)])
    out, at = np.empty(int(offset[-1]), dtype=np.uint8), offset[:-1].copy()
    for column in chosen:
        if isinstance(column, Chosen):
            kernels.put_texts(out, at, column.texts.data, column.texts.offset, column.index)
        else:
            kernels.put_literal(out, at, np.frombuffer(column, dtype=np.uint8))
    return Texts(out, offset)


def _chosen(column: bytes | Texts | Chosen) -> bytes | Chosen:
    return Chosen(column, np.arange(len(column), dtype=np.int64)) if isinstance(column, Texts) else column


def fill(template: str, rows: int, columns: Mapping[str, bytes | Texts | Chosen]) -> Texts:
    """Fill a `str.format` template once a row."""
    pieces: list[bytes | Texts | Chosen] = []
    for literal, name, _, _ in Formatter().parse(template):
        if literal:
            pieces.append(literal.encode("ascii"))
        if name is not None:
            pieces.append(columns[name])
    return weave(rows, *pieces)
