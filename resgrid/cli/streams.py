"""Standard streams: replacements for closed descriptors and an unbuffered output, and access to standard input."""

from __future__ import annotations

import io
import os
import sys
from typing import BinaryIO

from resgrid.errors import InputError


def prepare_streams() -> None:
    """Open closed standard descriptors on the null device, and buffer an unbuffered standard output.

    A file opened later would otherwise get the descriptor of a closed stream, and child processes would write to it.
    An unbuffered stream (``PYTHONUNBUFFERED``) loses the end of a text without an error if the disk becomes full,
    because Python ignores the number of bytes that were written.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the smallest free descriptor, which is this number
    raw = getattr(sys.stdout, "buffer", None)
    if isinstance(raw, io.RawIOBase) and isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout = io.TextIOWrapper(
            io.BufferedWriter(raw), encoding=sys.stdout.encoding, errors=sys.stdout.errors, line_buffering=True
        )


STANDARD_INPUT = "standard input"
"""Name of the input ``-`` in messages and results."""


def standard_input() -> BinaryIO:
    """Return the binary stream of standard input; raise InputError if the process has none."""
    if sys.stdin is None:
        raise InputError(f"{STANDARD_INPUT} is closed; give the name of a file, or pipe one")
    return sys.stdin.buffer
