"""What files hold, and that a format is one encoder and one line.

Tests internals: `resgrid.io.tables`.
"""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
from support.cli import ROOM, call

import resgrid as rg
from resgrid.io.tables import FORMATS, Format, csv_bytes, emit, json_text, npz_bytes, require_names


def tsv_bytes(table) -> bytes:
    rows = zip(*(list(column) for column in table.values()), strict=True)
    return "\n".join("\t".join(map(str, row)) for row in [tuple(table), *rows]).encode()


def test_a_new_format_is_one_line_and_every_writer_takes_it(monkeypatch, tmp_path):
    (tmp_path / "room.toml").write_text(ROOM)
    assert call("path", tmp_path / "room.toml", "-o", tmp_path / "paths.tsv").exit_code == 2
    monkeypatch.setitem(FORMATS, ".tsv", Format("table", tsv_bytes))
    assert call("path", tmp_path / "room.toml", "-o", tmp_path / "paths.tsv").exit_code == 1  # one start has no path
    assert (tmp_path / "paths.tsv").read_text().startswith("path\tk\toutcome\tx\ty\n0\t1.0\treached\t0.5\t0.5\n")
    (tmp_path / "divider.sp").write_text("t\nv1 a 0 1\nr1 a b 1k\nr2 b 0 1k\n.end\n")
    assert call("solve", tmp_path / "divider.sp", "-o", tmp_path / "volts.tsv").exit_code == 0
    assert "\tb\t" in (tmp_path / "volts.tsv").read_text()
    run = rg.simulation(rg.read_scene(tmp_path / "room.toml")).run((0.5, 0.5))
    assert rg.save(run, tmp_path / "run.tsv").read_text().count("\n") == len(run.time)
    (record,) = json.loads(rg.save([run], tmp_path / "run.json").read_text())["runs"]
    assert record["columns"]["time"] == run.time.tolist() and record["outcome"] == run.ending


def test_numbers_are_read_back_as_they_were_and_holes_are_empty():
    table = {"name": ['a,"b"', "c"], "value": np.array([0.1 + 0.2, np.nan]), "flag": [True, None]}
    assert csv_bytes(table) == b'name,value,flag\n"a,""b""",0.30000000000000004,True\nc,,\n'
    record = {"a": np.float64(np.inf), "b": [np.nan, 1], "c": (np.arange(2), None), 3: {"d": np.bool_(True)}}
    assert json.loads(json_text(record)) == {
        "schema": 1, "a": None, "b": [None, 1], "c": [[0, 1], None], "3": {"d": True},
    }  # fmt: skip


def test_the_same_arrays_are_the_same_bytes(tmp_path):
    arrays = {"file": np.arange(3), "allow_pickle": np.eye(2), "names": np.array(["a", "bc"])}
    assert npz_bytes(arrays) == npz_bytes(arrays)
    (tmp_path / "a.npz").write_bytes(npz_bytes(arrays))
    with np.load(tmp_path / "a.npz") as read:
        assert list(read) == list(arrays)
        for name, array in arrays.items():
            np.testing.assert_array_equal(read[name], array)


def test_two_columns_of_one_name_are_refused():
    axes = [rg.Axis("t", 0, 1, 2), rg.Axis("x", 0, 1, 2)]
    require_names(axes, ["x", "t", "k", "k"])
    with pytest.raises(rg.InputError, match="axis 't' has the name of another column"):
        require_names(axes, ["t", "t", "x"])


def test_solutions_are_written_by_the_library_too(tmp_path):
    space = rg.ConfigurationSpace([rg.Axis("x", 0, 3, 3), rg.Axis("y", 0, 2, 2)], [[0, 0], [0, 2], [1, 0]])
    op = rg.solve(rg.compile_space(space))
    with np.load(rg.save(op, tmp_path / "field.npz")) as arrays:
        np.testing.assert_array_equal(arrays["potential"], rg.field(op).potential)
        np.testing.assert_array_equal(arrays["cell"], space.cell)
    with pytest.raises(rg.InputError, match=r"must end in \.npz"):
        rg.save(op, tmp_path / "field.csv")
    assert [file.name for file in tmp_path.iterdir()] == ["field.npz"]


def test_standard_output_that_takes_no_bytes_is_refused(monkeypatch):
    monkeypatch.setattr("sys.stdout", io.StringIO())
    with pytest.raises(rg.InputError, match="accepts no bytes"):
        emit("-", b"")
