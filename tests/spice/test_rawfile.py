from __future__ import annotations

import contextlib
import struct

import pytest
from hypothesis import given, strategies as st

from resgrid.errors import InputError
from resgrid.spice.run.rawfile import read_rawfile

HEAD = (
    b"Title: * Binary: a: b\nDate: today\nPlotname: Operating Point\nFlags: real\n"
    b"No. Variables: 3\nNo. Points: 1       \nVariables:\n"
    b"\t0\tv(a)\tvoltage\n\t1\tv(b)\tvoltage\n\t2\ti(v_a)\tcurrent\nBinary:\n"
)
GOOD = HEAD + struct.pack("<3d", 1.0, 0.1, -2e-300)


def test_a_good_file_is_read_to_the_last_bit() -> None:
    raw = read_rawfile(GOOD)
    assert raw.plot == "Operating Point"
    assert raw.names == ("v(a)", "v(b)", "i(v_a)")
    assert raw.kinds == ("voltage", "voltage", "current")
    assert raw.values.tolist() == [[1.0, 0.1, -2e-300]]


def test_complex_points_are_read() -> None:
    head = HEAD.replace(b"real", b"complex").replace(b"Points: 1", b"Points: 2")
    raw = read_rawfile(head + struct.pack("<12d", *range(12)))
    assert raw.values[1].tolist() == [6 + 7j, 8 + 9j, 10 + 11j]


@given(st.integers(0, len(GOOD) - 1))
def test_a_truncated_file_is_refused(length: int) -> None:
    with pytest.raises(InputError):
        read_rawfile(GOOD[:length])


@given(st.binary(max_size=300))
def test_garbage_is_refused(data: bytes) -> None:
    with pytest.raises(InputError):
        read_rawfile(data)


@given(st.integers(0, len(HEAD) - 1), st.integers(0, 255))
def test_a_damaged_header_raises_nothing_else(place: int, byte: int) -> None:
    damaged = GOOD[:place] + bytes([byte]) + GOOD[place + 1 :]
    with contextlib.suppress(InputError):
        assert read_rawfile(damaged).values.size == 3


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (GOOD + b"x", "more than one plot"),
        (GOOD.replace(b"Binary:", b"Values:"), "text raw file"),
        (GOOD.replace(b"Variables: 3", b"Variables: 3e5"), "not a number"),
        (GOOD.replace(b"\t1\tv(b)", b"\t7\tv(b)"), "out of order"),
    ],
)
def test_the_message_says_what_is_wrong(data: bytes, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_rawfile(data)
