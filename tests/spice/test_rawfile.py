"""Raw files: reading compared with literal bytes, damaged files, and written files loaded by ngspice.

Tests internals: `resgrid.spice.run.rawfile`.
"""

from __future__ import annotations

import contextlib
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from support.circuits import random_grid

import resgrid as rg
from resgrid.spice.run.rawfile import FORMS, RawFile, format_raw, raw_of, read_rawfile

HEAD = (
    b"Title: * Binary: a: b\nDate: today\nPlotname: Operating Point\nFlags: real\n"
    b"No. Variables: 3\nNo. Points: 1       \nVariables:\n"
    b"\t0\tv(a)\tvoltage\n\t1\tv(b)\tvoltage\n\t2\ti(v_a)\tcurrent\nBinary:\n"
)
GOOD = HEAD + struct.pack("<3d", 1.0, 0.1, -2e-300)


def test_a_valid_file_is_read_exactly() -> None:
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
def test_truncated_files_raise_input_error(length: int) -> None:
    with pytest.raises(rg.InputError):
        read_rawfile(GOOD[:length])


@given(st.binary(max_size=300))
def test_random_bytes_raise_input_error(data: bytes) -> None:
    with pytest.raises(rg.InputError):
        read_rawfile(data)


@given(st.integers(0, len(HEAD) - 1), st.integers(0, 255))
def test_a_damaged_header_raises_only_input_error(place: int, byte: int) -> None:
    damaged = GOOD[:place] + bytes([byte]) + GOOD[place + 1 :]
    with contextlib.suppress(rg.InputError):
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
def test_each_defect_has_its_message(data: bytes, message: str) -> None:
    with pytest.raises(rg.InputError, match=message):
        read_rawfile(data)


@pytest.mark.parametrize("form", FORMS)
def test_ngspice_loads_written_files(tmp_path: Path, form: str) -> None:
    point = rg.solve(random_grid(3))
    rg.save(point, tmp_path / "x.raw", form=form, title="a  title\nof two lines")
    deck = tmp_path / "load.cir"
    words = ["load x.raw", "set numdgt=16", "print v(node_7)", "print i(v1)", "quit"]
    deck.write_text("* load\n.control\n" + "\n".join(words) + "\n.endc\n.end\n")
    run = subprocess.run(["ngspice", "-n", "-b", deck.name], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert not run.stderr.strip(), run.stderr
    printed = dict(line.split(" = ") for line in run.stdout.splitlines() if " = " in line and "(" in line)
    assert float(printed["v(node_7)"]) == pytest.approx(point.voltage[7], rel=1e-14)
    assert float(printed["i(v1)"]) == pytest.approx(point.source_current[0], rel=1e-14)


def test_binary_files_keep_every_bit() -> None:
    point = rg.solve(random_grid(4))
    raw = read_rawfile(format_raw(raw_of(point)))
    np.testing.assert_array_equal(raw.values[0], np.concatenate([point.voltage[1:], point.source_current]))
    assert raw.names[:2] == ("v(node_1)", "v(node_2)") and raw.names[-1] == "i(v3)" and raw.kinds[-1] == "current"


def test_text_files_keep_every_digit() -> None:
    values = np.array([[0.1, -1e-300], [1 / 3, 2.5e300]])
    text = format_raw(RawFile("", ("v(a)", "v(b c)"), ("voltage", "voltage"), values), form="ascii").decode()
    numbers = [float(word.split("\t")[-1]) for word in text.partition("Values:\n")[2].splitlines()]
    assert numbers == values.ravel().tolist()
    assert "\tv(bc)\t" in text


def test_vectors_have_ngspice_names_without_floating_nodes() -> None:
    netlist = random_grid(2).replace(
        element_names={"voltage source": ("VDD", "x1.V2", "l7")},
    )
    netlist = netlist.replace(node_count=netlist.node_count + 1)
    vectors = raw_of(rg.solve(netlist))
    assert vectors.names[-3:] == ["i(vdd)", "i(v.x1.v2)", "i(l7)"]
    assert len(vectors.names) == netlist.node_count - 2 + 3


def test_an_unknown_form_raises_input_error(tmp_path: Path) -> None:
    with pytest.raises(rg.InputError, match="binary or ascii"):
        rg.save(rg.solve(random_grid(1)), tmp_path / "x.raw", form="hex")
