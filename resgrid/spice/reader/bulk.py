"""The short way for plain cards: compiled loops cut a whole file, and keep aside what needs a closer look."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.spice.reader.sources import decode

LEAST_BYTES = 40_000
"""Below this size the compiled loops cost more to load than they save."""


@dataclass(frozen=True, eq=False)
class Bulk:
    """Plain cards of one file.

    Attributes
    ----------
    node_names : list of str
        As spelt first.
    kind : ndarray of uint8, shape (n,)
        0 resistor, 1 voltage source, 2 current source, 3 capacitor.
    names : list of str
        Of the elements.
    nodes : ndarray of int64, shape (n, 2)
        Index into ``node_names``.
    value : ndarray of float64, shape (n,)
    line : ndarray of int64, shape (n,)
    other : ndarray of int64, shape (k, 3)
        First and last byte and number of every line that was not plain.
    """

    node_names: list[str]
    kind: NDArray[np.uint8]
    names: list[str]
    nodes: NDArray[np.int64]
    value: NDArray[np.float64]
    line: NDArray[np.int64]
    other: NDArray[np.int64]

    def others(self, data: bytes) -> Iterator[tuple[int, str]]:
        """Lines that were not plain."""
        for first, last, number in self.other.tolist():
            yield number, decode(data[first:last])


def plain_lines(data: bytes, start: int) -> Iterator[tuple[int, str]]:
    """Every line of a file from a byte on, with its number."""
    number = data.count(b"\n", 0, start) + 1
    return enumerate(decode(data[start:]).split("\n"), number)


def scan(data: bytes, start: int) -> Bulk | None:
    """Cut a file into plain cards and others; None if the file must be read line by line."""
    return None
