"""Raw files: read back bit for bit by us, and loaded by ngspice itself."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
from support.circuits import random_grid

import resgrid as rg
from resgrid.errors import InputError
from resgrid.nodal.solve import solve
from resgrid.spice.run.rawfile import FORMS, RawFile, format_raw, raw_of, read_rawfile


@pytest.mark.parametrize("form", FORMS)
def test_ngspice_loads_what_is_written(tmp_path: Path, form: str) -> None:
    point = solve(random_grid(3))
    rg.write_solution(point, tmp_path / "x.raw", form=form, title="a  title\nof two lines")
    deck = tmp_path / "load.cir"
    words = ["load x.raw", "set numdgt=16", "print v(node_7)", "print i(v1)", "quit"]
    deck.write_text("* load\n.control\n" + "\n".join(words) + "\n.endc\n.end\n")
    run = subprocess.run(["ngspice", "-n", "-b", deck.name], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert not run.stderr.strip(), run.stderr
    printed = dict(line.split(" = ") for line in run.stdout.splitlines() if " = " in line and "(" in line)
    assert float(printed["v(node_7)"]) == pytest.approx(point.voltage[7], rel=1e-14)
    assert float(printed["i(v1)"]) == pytest.approx(point.source_current[0], rel=1e-14)


def test_binary_files_keep_every_bit() -> None:
    point = solve(random_grid(4))
    raw = read_rawfile(format_raw(raw_of(point)))
    np.testing.assert_array_equal(raw.values[0], np.concatenate([point.voltage[1:], point.source_current]))
    assert raw.names[:2] == ("v(node_1)", "v(node_2)") and raw.names[-1] == "i(v3)" and raw.kinds[-1] == "current"


def test_text_files_keep_every_digit() -> None:
    values = np.array([[0.1, -1e-300], [1 / 3, 2.5e300]])
    text = format_raw(RawFile("", ("v(a)", "v(b c)"), ("voltage", "voltage"), values), form="ascii").decode()
    numbers = [float(word.split("\t")[-1]) for word in text.partition("Values:\n")[2].splitlines()]
    assert numbers == values.ravel().tolist()
    assert "\tv(bc)\t" in text


def test_names_are_those_of_ngspice_and_floating_nodes_are_left_out() -> None:
    netlist = random_grid(2).replace(
        element_names={"voltage source": ("VDD", "x1.V2", "l7")},
    )
    netlist = netlist.replace(node_count=netlist.node_count + 1)
    vectors = raw_of(solve(netlist))
    assert vectors.names[-3:] == ["i(vdd)", "i(v.x1.v2)", "i(l7)"]
    assert len(vectors.names) == netlist.node_count - 2 + 3


def test_a_wrong_form_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="binary or ascii"):
        rg.write_solution(solve(random_grid(1)), tmp_path / "x.raw", form="hex")
