"""Decks on the command line: solved, described, checked, converted, and refused in one message."""

from __future__ import annotations

import csv
import io
import json
import os
from pathlib import Path

import networkx as nx
import numpy as np
import pytest

import resgrid as rg
from resgrid.spice.rawfile import read_rawfile

DECK = """Designer's deck: a divider in a subcircuit
.param rr=1k
.subckt half in out params: r=2k
R1 in mid {r}
L1 mid m2 1u
R2 m2 out {r/2}
.ends
Vdd in 0 DC 2
X1 in out half r={rr}
Vsense out o2 0
Rl o2 0 500
Il o2 0 1m
C1 out 0 1p
.tran 1u 10u
.print tran v(out)
+ v(o2)
.end
"""
# By hand: 2 V, 1.5 kohm, 500 ohm to ground, 1 mA drawn: (2 - v) / 1500 = v / 500 + 1e-3.
OUT = (2 / 1500 - 1e-3) / (1 / 1500 + 1 / 500)


@pytest.fixture
def deck(tmp_path: Path) -> Path:
    path = tmp_path / "half.sp"
    path.write_text(DECK)
    return path


@pytest.fixture
def island(tmp_path: Path) -> Path:
    path = tmp_path / "island.sp"
    path.write_text("* island\nv1 a 0 1\nr1 a b 1e8\nr2 b 0 1e8\nrx c d 1k\n.end\n")
    return path


def test_solve_lists_the_worst_drops(answer, call, deck):
    data = answer("solve", deck)
    assert (data["nodes"], data["resistors"], data["voltage_sources"], data["current_sources"]) == (6, 3, 3, 1)
    assert data["worst_drops"][0]["drop"] == pytest.approx(2 - OUT, rel=1e-12)
    assert {row["node"] for row in data["worst_drops"][:2]} == {"out", "o2"}
    assert data["power_imbalance"] < 1e-14 and data["floating_nodes"] == []
    supply = next(row for row in data["supplies"] if row["name"] == "Vdd")
    assert supply["amps"] == pytest.approx(-(2 - OUT) / 1500, rel=1e-12)
    assert len(answer("solve", deck, "--worst", 1)["worst_drops"]) == 1
    printed = call("solve", deck).stdout
    assert "worst drops" in printed and "X1.mid" in printed


@pytest.mark.parametrize("suffix", [".csv", ".json", ".npz", ".raw"])
def test_solutions_keep_names_voltages_currents_and_powers(call, deck, tmp_path, suffix):
    file = tmp_path / f"out{suffix}"
    assert call("solve", deck, "-o", file).exit_code == 0
    currents = {"X1.R1": (2 - OUT) / 1500, "Vdd": -(2 - OUT) / 1500, "Il": 1e-3}
    if suffix == ".csv":
        rows = {row["name"]: row for row in csv.DictReader(io.StringIO(file.read_text()))}
        voltage = float(rows["out"]["voltage"])
        got = {name: float(rows[name]["current"]) for name in currents}
        assert float(rows["Rl"]["power"]) == pytest.approx(OUT**2 / 500)
        assert (rows["X1.R1"]["first"], rows["X1.R1"]["second"], rows["X1.R1"]["value"]) == ("in", "X1.mid", "1000.0")
    elif suffix == ".json":
        data = json.loads(file.read_text())
        voltage = data["voltages"]["out"]
        table = {**data["elements"]["resistor"], **data["elements"]["voltage source"]}
        table |= data["elements"]["current source"]
        got = {name: table[name]["current"] for name in currents}
    elif suffix == ".npz":
        with np.load(file) as arrays:
            voltage = arrays["voltage"][list(arrays["node"]).index("out")]
            got = {
                str(name): current
                for kind in ("resistor", "voltage_source", "current_source")
                for name, current in zip(arrays[f"{kind}_name"], arrays[f"{kind}_current"], strict=True)
            }
    else:
        raw = read_rawfile(file.read_bytes())
        values = dict(zip(raw.names, raw.values[0].tolist(), strict=True))
        voltage, got = values["v(out)"], {"Vdd": values["i(vdd)"]}
        assert {"v(x1.mid)", "i(l.x1.l1)"} <= set(values)
    assert voltage == pytest.approx(OUT, rel=1e-12)
    for name, current in got.items():
        assert name not in currents or current == pytest.approx(currents[name], rel=1e-12)


def test_solutions_go_to_standard_output_as_csv(call, deck):
    assert call("solve", deck, "-o", "-").stdout.startswith(
        "kind,name,first,second,value,voltage,current,power\nnode,0,"
    )


def test_nodes_that_float_have_no_voltage(answer, call, island, tmp_path):
    assert answer("solve", island)["floating_nodes"] == ["c", "d"]
    assert "floating            c, d" in call("solve", island).stdout
    call("solve", island, "-o", tmp_path / "x.csv")
    assert "\nnode,c,,,,,,\n" in (tmp_path / "x.csv").read_text()


def test_info_describes_a_deck(answer, call, deck):
    data = answer("info", deck)
    assert data["subcircuits"] == ["half"] and data["dialect"] == "ngspice" and data["supply_volts"] == [2.0]
    assert data["smallest_resistance"] == 500 and data["ngspice_seconds"] < 1
    assert any(".tran" in note["text"] for note in data["notes"])
    assert "3 of 500 to 1000 ohm" in call("info", deck).stdout


def test_rules_end_with_one_where_there_are_errors(answer, call, deck, island, lesson):
    assert answer("check", "--rules", deck)["passes"]
    data = answer("check", "--rules", island, code=1)
    finding = data["findings"][0]
    assert (finding["rule"], finding["severity"], finding["nodes"]) == ("floating", "error", ["c", "d"])
    assert finding["place"].endswith("island.sp:5")
    verdict = {v["simulator"]: v for v in data["simulators"]}
    assert verdict["ngspice"]["outcome"] == "wrong" and verdict["ngspice"]["max_error"] == pytest.approx(2.5e-5, 1e-3)
    assert set(verdict) == {"ngspice", "ltspice", "xyce", "hspice", "spectre"}
    assert answer("check", "--rules", lesson)["passes"]
    printed = call("check", "--rules", island).stdout
    assert "1 errors" in printed and "will your simulator get it right?" in printed


def test_check_holds_ngspice_against_our_solution(answer, call, deck, island, tmp_path):
    data = answer("check", deck)
    assert data["agrees"] and data["reference"] == "solve" and data["nodes"] == 5 and data["remark"] == ""
    data = answer("check", island, code=1)
    text = "\n".join(data["findings"])
    assert "island.sp:3: node b" in text and "this was to be expected" in text
    (tmp_path / "part.inc").write_text("rp in 0 1k\n")
    deck.write_text(DECK.replace(".tran", ".include part.inc\n.tran"))
    data = answer("check", deck)
    assert data["agrees"] and "includes other files" in data["remark"]
    deck.write_text(DECK.replace(".tran", ".control\nshell touch pwned\n.endc\n.tran"))
    assert ".control" in answer("check", deck)["remark"] and not Path("pwned").exists()


def test_a_device_taken_for_the_title_is_missed(answer, tmp_path):
    deck = tmp_path / "untitled.sp"
    deck.write_text("r1 a b 1k\nv1 a 0 1\nr2 b 0 1k\nr3 a b 3k\n.tran 1 2\n+ 0\n.end\n")
    assert answer("solve", deck)["resistors"] == 3
    data = answer("check", deck, code=1)
    assert any("r1 is lost" in finding for finding in data["findings"])
    assert any("untitled.sp:1: node b" in finding for finding in data["findings"])


def test_a_run_that_would_take_too_long_ends_with_four(call, deck):
    result = call("check", deck, "--timeout", "0.001")
    assert result.exit_code == 4 and "--engine eecircuit" in result.stderr
    assert call("check", deck, "--timeout", "nan").exit_code == 2
    assert call("check", deck, "--engine", "spice3").exit_code == 2


def test_an_absent_engine_ends_with_three(call, deck, monkeypatch, tmp_path):
    monkeypatch.setenv("RESGRID_EECIRCUIT", str(tmp_path))
    monkeypatch.setenv("RESGRID_NODE", os.sys.executable)
    result = call("check", deck, "--engine", "eecircuit")
    assert result.exit_code == 3 and "npm install eecircuit-engine" in result.stderr


@pytest.mark.parametrize("dialect", ["ngspice", "ltspice", "xyce", "hspice"])
def test_converted_decks_hold_the_same_circuit(answer, call, deck, tmp_path, dialect):
    out = tmp_path / "other.cir"
    data = answer("convert", deck, "-o", out, "--dialect", dialect)
    assert data["dialect"] == dialect and data["resistors"] == 3 and Path(data["sidecar"]).exists()
    again = answer("solve", out)
    assert again["worst_drops"][0]["drop"] == pytest.approx(2 - OUT, rel=1e-12)
    assert answer("check", out)["agrees"]
    call("convert", deck, "-o", tmp_path / "bare.cir", "--dialect", dialect, "--bare")
    assert (tmp_path / "bare.cir").read_bytes() == out.read_bytes()
    assert not (tmp_path / "bare.cir.json").exists()
    assert call("convert", deck, "-o", "-", "--dialect", dialect).stdout_bytes == out.read_bytes()


def test_converted_graphs_hold_the_same_circuit(answer, call, deck, tmp_path):
    edges = tmp_path / "edges.txt"
    assert "sources (4), capacitors (1)" in call("convert", deck, "-o", edges).stderr
    assert edges.read_text().splitlines()[0] == "in X1.mid 1000.0"
    for suffix in (".graphml", ".json"):
        file = tmp_path / f"graph{suffix}"
        assert call("convert", deck, "-o", file).exit_code == 0
    read = nx.node_link_graph(json.loads((tmp_path / "graph.json").read_text()), edges="edges")
    netlist = rg.Netlist.from_networkx(read)
    assert rg.solve(netlist).voltage.max() == 2.0 and len(netlist.conductance) == 3
    assert nx.read_graphml(tmp_path / "graph.graphml").number_of_edges() == 8
    assert call("convert", deck, "-o", tmp_path / "arrays.npz").exit_code == 0
    with np.load(tmp_path / "arrays.npz") as arrays:
        assert list(arrays["resistor_names"]) == ["X1.R1", "X1.R2", "Rl"]


def test_scenes_are_converted_too(answer, call, lesson, tmp_path):
    out = tmp_path / "lesson.scs"
    assert answer("convert", lesson, "-o", out)["dialect"] == "spectre"
    assert "resistor" in out.read_text()
    deck = tmp_path / "lesson.cir"
    assert call("convert", lesson, "-o", deck).exit_code == 0
    assert answer("check", deck)["agrees"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("solve", "DECK", "-o", "x.xls"), ".csv, .json, .npz, .raw"),
        (("solve", "DECK", "-o", "x.raw", "--raw", "hex"), "binary or ascii"),
        (("solve", "DECK", "--worst", "-1"), "0 or more"),
        (("solve", "DECK", "-o", "-", "--json"), "standard output"),
        (("solve", "DECK", "--boundary", "wall"), "is a deck"),
        (("solve", "DECK", "--read-as", "pspice"), "pspice"),
        (("solve", "DECK", "--root", "nowhere"), "nowhere"),
        (("info", "DECK", "--k", "1"), "is a deck"),
        (("check", "DECK", "--rules", "--deck", "x"), "deck already"),
        (("convert", "DECK"), "-o"),
        (("convert", "DECK", "-o", "x.xyz"), "must end in"),
        (("convert", "DECK", "-o", "DECK"), "this is the input"),
        (("convert", "DECK", "-o", "x.txt", "--bare"), "no deck"),
        (("convert", "DECK", "-o", "-", "--json"), "standard output"),
        (("convert", "DECK", "-o", "x.cir", "--dialect", "spike"), "spike"),
        (("path", "DECK"), "deck"),
        (("solve", "absent.sp"), "absent.sp"),
        (("solve", "FOLDER.sp"), "FOLDER.sp"),
        (("check", "absent.sp"), "absent.sp"),
        (("convert", "absent.sp", "-o", "x.cir"), "absent.sp"),
    ],
)
def test_what_is_wrong_is_one_message(call, deck, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "FOLDER.sp").mkdir()
    result = call(*[deck if word == "DECK" else word for word in words])
    assert result.exit_code == 2, result.output
    assert message in result.stderr and "Traceback" not in result.output
    assert {file.name for file in tmp_path.iterdir()} == {"half.sp", "FOLDER.sp"}


@pytest.mark.parametrize(
    ("text", "code", "message"),
    [
        (b"", 2, "touches ground"),
        (b"\x00\xff" * 50, 2, ""),
        (b"* t\nv1 a 0 1\nr1 a 0 -1\n.end\n", 2, ":3"),
        (b"* t\nv1 a 0 1\nq1 a b 0 mod\n.end\n", 2, ":3"),
        (b"* t\nv1 a 0 1\nv2 a 0 2\nr1 a 0 1\n.end\n", 2, "bad.sp:3: voltage source v2"),
        (b"* t\nr1 a 0 1\nr2 a b 1\n.end\n", 2, "nothing is driven"),
        (b"* t\nv1 a 0 1\nr1 a 0 1e999\n.end\n", 2, ":3"),
    ],
)
def test_bad_decks_are_one_message(call, tmp_path, text, code, message):
    deck = tmp_path / "bad.sp"
    deck.write_bytes(text)
    for verb in ("solve", "check"):
        result = call(verb, deck)
        assert result.exit_code == code, (verb, result.output)
        assert message in result.stderr
