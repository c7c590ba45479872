"""Decks on the command line: solve, info, check and convert, against hand calculation and ngspice; rejected decks.

Tests internals: `resgrid.spice.run.rawfile`.
"""

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
from resgrid.spice.run.rawfile import read_rawfile

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


def test_solve_reports_duplicate_names_and_control_commands(tmp_path, call):
    twice = tmp_path / "twice.cir"
    twice.write_text("* t\nV1 in 0 1\nR1 in a 1k\nr1 in a 1k\nR2 a 0 1k\n.op\n.end\n")
    for subcommand in ("solve", "info"):
        result = call(subcommand, twice)
        assert result.exit_code == 0
        assert f"{twice}:4: 1 resistor names are given twice (r1); ngspice does not run such a deck" in result.stderr
    changed = tmp_path / "changed.cir"
    changed.write_text("* t\nV1 in 0 1\nR1 in a 1k\nR2 a 0 1k\n.control\nalter r2 3k\nop\n.endc\n.end\n")
    result = call("solve", changed)
    assert f"{changed}:5: the commands of .control ... .endc are not run: alter would change" in result.stderr


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


DIVIDER = "filter number 5\nv1 a 0 1\nr1 a b 1k\nr2 b 0 1k\n.op\n.end\n"


@pytest.mark.parametrize("name", ["x.spi", "x.inp", "x.txt", "x", "x.map"])
def test_read_as_declares_a_file_of_any_suffix_to_be_a_deck(answer, call, tmp_path, name):
    path = tmp_path / name
    path.write_text(DIVIDER)
    assert answer("solve", path, "--read-as", "ngspice")["nodes"] == 3
    assert answer("info", path, "--read-as", "xyce")["dialect"] == "xyce"
    assert answer("check", path, "--rules", "--read-as", "ngspice")["passes"]
    assert answer("check", path, "--read-as", "ngspice")["agrees"]
    assert call("convert", path, "--read-as", "ngspice", "-o", tmp_path / "out.cir").exit_code == 0
    pairs = answer("resistance", path, "--read-as", "ngspice", "--between", "b", "0")["pairs"]
    assert pairs[0]["resistance"] == pytest.approx(500)
    assert rg.read_spice(path, dialect="ngspice").node_count == 3


@pytest.mark.parametrize("name", ["x.spi", "x.inp", "x.txt", "x"])
def test_files_of_unknown_kind_are_answered_with_the_suffixes_of_decks(call, tmp_path, name):
    path = tmp_path / name
    path.write_text(DIVIDER.replace("filter number 5", "t"))
    for words in (("solve",), ("info",), ("check",), ("resistance", "--between", "a", "b"), ("convert", "-o", "-")):
        error = call(words[0], path, *words[1:]).stderr
        assert "decks in .cir, .sp, .spice," in error and "maps in .yaml" in error and "(--read-as)" in error
    error = call("path", path).stderr
    assert "maps in .yaml" in error and "--read-as" not in error
    assert "or add --read-as if the file is a deck" in call("solve", path, "--root", tmp_path).stderr


def test_networks_keep_their_meaning_and_have_no_dialect(answer, call, tmp_path):
    for name in ("e.txt", "e.csv", "e.tsv"):
        (tmp_path / name).write_text("a b 1\nb ground 2\n")
        assert answer("solve", tmp_path / name)["resistors"] == 2
    for name in ("e.csv", "e.tsv"):
        assert "has no dialect: remove --read-as" in call("solve", tmp_path / name, "--read-as", "ngspice").stderr
        assert "includes no files: remove --root" in call("solve", tmp_path / name, "--root", tmp_path).stderr
    (tmp_path / "d.txt").write_text(DIVIDER)  # its title has the form of an edge
    assert "if the file is a deck, give its dialect (--read-as" in call("solve", tmp_path / "d.txt").stderr


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("x.asc", b"Version 4\nSHEET 1 880 680\n", "a schematic of LTspice, not a netlist; export its netlist"),
        ("x.asc", "Version 4\nSHEET 1 880 680\n".encode("utf-16"), "a schematic of LTspice, not a netlist"),
        ("x.asc", b"ncols 1\nnrows 1\ncellsize 1\n1\n", "an ESRI ASCII grid, not a map; name it in a Circuitscape"),
    ],
)
def test_schematics_and_rasters_are_named_with_a_remedy(call, tmp_path, name, content, words):
    path = tmp_path / name
    path.write_bytes(content)
    for subcommand in ("solve", "path", "info"):
        result = call(subcommand, path)
        assert result.exit_code == 2 and words in result.stderr
    if "schematic" in words:
        assert words in call("solve", path, "--read-as", "ltspice").stderr


def test_circuitscape_configurations_are_named_with_their_commands(call, tmp_path):
    path = tmp_path / "job.ini"
    path.write_text("scenario = pairwise\n")
    assert "a Circuitscape configuration, not a scene or map; 'resgrid resistance' runs it" in call("path", path).stderr
    assert "run it with 'resgrid resistance'" in call("solve", path).stderr


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


def test_floating_nodes_are_listed_without_a_voltage(answer, call, island, tmp_path):
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


def test_check_rules_exits_with_1_for_errors(answer, call, deck, island, lesson):
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
    assert "1 error," in printed and "expected behaviour of simulators" in printed


def test_check_refuses_options_that_a_check_of_rules_would_ignore(call, deck):
    for option, value in (("--tolerance", "1e-9"), ("--timeout", "9"), ("--engine", "ngspice")):
        refused = call("check", "--rules", deck, option, value)
        assert refused.exit_code == 2
        assert f"--rules runs no simulator: leave out {option}" in refused.stderr


def test_check_compares_ngspice_with_the_solution(answer, call, deck, island, tmp_path):
    data = answer("check", deck)
    assert data["agrees"] and data["reference"] == "solve" and data["nodes"] == 5 and data["remark"] == ""
    data = answer("check", island, code=1)
    text = "\n".join(data["findings"])
    assert "island.sp:3: node b" in text and "the portability check predicts this" in text


def test_included_files_are_simulated_unchanged(answer, deck, tmp_path):
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "part.inc").write_text("rp in p 1k\n.tran 1 2\n.include more.inc\n")
    (tmp_path / "models" / "more.inc").write_text("rq p 0 1k\r\n")
    deck.write_text(DECK.replace(".tran", ".include 'models/part.inc'\n.tran"))
    data = answer("check", deck)
    assert data["agrees"] and data["verified"] and data["nodes"] == 6 and data["as_read"] is None
    below = tmp_path / "decks" / "deep"
    below.mkdir(parents=True)
    (below / "d.sp").write_text(deck.read_text().replace("models/", "../../models/"))
    assert answer("check", below / "d.sp", "--root", tmp_path)["agrees"]


def test_an_include_that_ngspice_may_resolve_differently_is_rejected(call, tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "part.inc").write_text("r2 b 0 1k\n.include two.inc\n")
    (tmp_path / "sub" / "two.inc").write_text("r3 b 0 1k\n")
    (tmp_path / "two.inc").write_text("r3 b 0 1\n")
    deck = tmp_path / "d.sp"
    deck.write_text("t\nv1 a 0 10\nr1 a b 1k\n.include sub/part.inc\n.end\n")
    result = call("check", deck)
    assert result.exit_code == 2 and "part.inc:2:1: 'two.inc' exists in" in result.stderr


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ((".tran", ".control\nshell touch pwned\n.endc\n.tran"), "'.control' is not simulated"),
        (("Designer's", "*ng_script"), "'*ng_script' is not simulated"),
        ((".tran", ".include bad.inc\n.tran"), "'.control' is not simulated"),
        ((".tran", ".include linked.inc\n.tran"), "is a symbolic link"),
        ((".tran", '.include "FOLDER/good.inc"\n.tran'), "is not a plain name"),
        ((".tran", ".include nowhere/../good.inc\n.tran"), "is not a plain name"),
    ],
)
def test_decks_that_are_unsafe_to_simulate_exit_with_5_and_run_no_commands(answer, call, deck, tmp_path, change, why):
    (tmp_path / "good.inc").write_text("rp in 0 1k\n")
    (tmp_path / "bad.inc").write_text("rp in 0 1k\n.control\nshell touch pwned\n.endc\n")
    (tmp_path / "linked.inc").symlink_to(tmp_path / "good.inc")
    old, new = change
    deck.write_text(DECK.replace(old, new.replace("FOLDER", str(tmp_path))))
    data = answer("check", deck, code=5)
    assert (data["agrees"], data["verified"], data["max_abs_error"], data["nodes"]) == (None, False, None, 0)
    assert why in data["remark"] and data["as_read"]["agrees"] and data["as_read"]["nodes"] == 5
    printed = call("check", deck)
    assert printed.exit_code == 5 and printed.stdout.startswith("not verified: ngspice did not run")
    assert not Path("pwned").exists() and not list(tmp_path.rglob("pwned"))


@pytest.mark.parametrize(
    "last",
    [
        ".controlled\nshell touch FOLDER/pwned\n.endc",
        ".con\rtrol\nshell touch FOLDER/pwned\n.endc",
        ".incl /etc/passwd",
        ".incl ../outside.inc",
        ".include\n+ /etc/passwd",
        'a1 [out] [x] m\n.model m d_process (process_file="touch" process_params=["FOLDER/pwned"])',
    ],
)
@pytest.mark.parametrize("included", [True, False])
def test_commands_and_files_after_end_are_not_run(call, deck, tmp_path, last, included):
    """ngspice continues to read after .end; commands and files there must not run."""
    (tmp_path / "good.inc").write_text("rp in 0 1k\n")
    (tmp_path.parent / "outside.inc").write_text("rp in 0 1\n")
    more = ".include good.inc\n" if included else ""
    last = last.replace("FOLDER", str(tmp_path))
    deck.write_bytes(DECK.replace("\n.end\n", f"\n{more}.end\n{last}\n").encode())
    result = call("check", deck)
    assert result.exit_code in (2, 5), result.output
    assert not (tmp_path / "pwned").exists()


@pytest.mark.parametrize("cards", ["v1 a 0 sin(0 1 1k)\nr1 a b 1k\nr2 b 0 1k", "v1 a 0 10\nr0 a b 1k\nr9 b z 1k"])
def test_decks_without_currents_are_solved_checked_and_converted(answer, call, tmp_path, cards):
    deck = tmp_path / "rest.sp"
    deck.write_text(f"t\n{cards}\n.end\n")
    data = answer("solve", deck)
    assert (data["power"], data["kcl_residual"], data["floating_nodes"]) == (0.0, 0.0, [])
    assert "0 W dissipated" in call("solve", deck, "-o", tmp_path / "x.raw").stdout
    assert answer("check", deck)["agrees"]
    assert call("convert", deck, "-o", tmp_path / "out.cir").exit_code == 0
    assert answer("check", tmp_path / "out.cir")["agrees"]


def test_check_finds_a_device_on_the_title_line(answer, tmp_path):
    deck = tmp_path / "untitled.sp"
    deck.write_text("r1 a b 1k\nv1 a 0 1\nr2 b 0 1k\nr3 a b 3k\n.tran 1 2\n+ 0\n.end\n")
    assert answer("solve", deck)["resistors"] == 3
    data = answer("check", deck, code=1)
    assert any("r1 is lost" in finding for finding in data["findings"])
    assert any("untitled.sp:1: node b" in finding for finding in data["findings"])


def test_a_simulation_over_the_timeout_exits_with_4(call, deck):
    result = call("check", deck, "--timeout", "0.001")
    assert result.exit_code == 4 and "s: allow more (--timeout" in result.stderr
    assert call("check", deck, "--timeout", "nan").exit_code == 2
    assert call("check", deck, "--engine", "spice3").exit_code == 2


def test_a_missing_engine_exits_with_3(call, deck, monkeypatch, tmp_path):
    monkeypatch.setenv("RESGRID_EECIRCUIT", str(tmp_path))
    monkeypatch.setenv("RESGRID_NODE", os.sys.executable)
    result = call("check", deck, "--engine", "eecircuit")
    assert result.exit_code == 3 and "npm install eecircuit-engine" in result.stderr


@pytest.mark.parametrize("dialect", ["ngspice", "ltspice", "xyce", "hspice"])
def test_converted_decks_contain_the_same_circuit(answer, call, deck, tmp_path, dialect):
    out = tmp_path / "other.cir"
    data = answer("convert", deck, "-o", out, "--dialect", dialect)
    assert data["dialect"] == dialect and data["resistors"] == 3 and Path(data["sidecar"]).exists()
    again = answer("solve", out)
    assert again["worst_drops"][0]["drop"] == pytest.approx(2 - OUT, rel=1e-12)
    checked = answer("check", out, code=0 if dialect == "ngspice" else 5)
    assert (checked["agrees"], checked["verified"]) == ((True, True) if dialect == "ngspice" else (None, False))
    assert dialect == "ngspice" or (dialect in checked["remark"] and checked["as_read"]["agrees"])
    call("convert", deck, "-o", tmp_path / "bare.cir", "--dialect", dialect, "--bare")
    assert (tmp_path / "bare.cir").read_bytes() == out.read_bytes()
    assert not (tmp_path / "bare.cir.json").exists()
    assert call("convert", deck, "-o", "-", "--dialect", dialect).stdout_bytes == out.read_bytes()


@pytest.mark.filterwarnings("ignore:.*form loops")
def test_elements_that_a_deck_cannot_represent_are_counted_by_kind(answer, call, tmp_path):
    """An island of two resistors and a capacitor, and a source that closes a loop."""
    graph = nx.MultiGraph()
    for first, second, kind, values in (
        (1, 0, "voltage source", {"volts": 5.0}), (1, 0, "voltage source", {"volts": 5.0}),
        (1, 2, "resistor", {"conductance": 1e-3}), (2, 0, "resistor", {"conductance": 1e-3}),
        (3, 4, "resistor", {"conductance": 1e-3}), (4, 5, "resistor", {"conductance": 1e-3}),
        (3, 5, "capacitor", {"capacitance": 1e-12}),
    ):  # fmt: skip
        graph.add_edge(first, second, kind=kind, nodes=[first, second], **values)
    rg.save(rg.Netlist.from_networkx(graph), tmp_path / "island.json")
    for words in ((), ("--bare",)):
        data = answer("convert", tmp_path / "island.json", "-o", tmp_path / "island.cir", *words)
        assert data["left_out"] == {"floating_nodes": 3, "voltage_sources": 1, "resistors": 2, "capacitors": 1}
        assert (data["resistors"], data["voltage_sources"], data["capacitors"]) == (4, 2, 1)
    message = call("convert", tmp_path / "island.json", "-o", tmp_path / "island.cir").stderr
    assert "floating nodes (3), voltage sources (1), resistors (2), capacitors (1)" in message


def test_converted_graphs_contain_the_same_circuit(answer, call, deck, tmp_path):
    edges = tmp_path / "edges.txt"
    words = "voltage sources (3), current sources (1), capacitors (1)"
    assert (
        f"left out, because the format of {edges} cannot represent them: {words}"
        in call("convert", deck, "-o", edges).stderr
    )
    data = answer("convert", deck, "-o", edges)
    kinds = ("voltage_sources", "current_sources", "capacitors")
    assert data["left_out"] == {kind: data[kind] for kind in kinds} == {kinds[0]: 3, kinds[1]: 1, kinds[2]: 1}
    assert answer("convert", deck, "-o", tmp_path / "graph.json")["left_out"] == {}
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


@pytest.mark.parametrize("suffix", [".graphml", ".json", ".npz", ".cir"])
def test_converted_files_are_read_by_every_subcommand(answer, call, deck, tmp_path, suffix):
    file = tmp_path / f"other{suffix}"
    assert call("convert", deck, "-o", file).exit_code == 0
    data = answer("solve", file)
    assert (data["nodes"], data["resistors"], data["voltage_sources"], data["current_sources"]) == (6, 3, 3, 1)
    assert data["worst_drops"][0]["drop"] == pytest.approx(2 - OUT, rel=1e-12)
    assert answer("info", file)["smallest_resistance"] == 500
    assert answer("check", "--rules", file)["passes"]
    back = tmp_path / "back.cir"
    assert call("convert", file, "-o", back).exit_code == 0
    assert answer("check", back)["agrees"]


def test_edge_lists_and_circuitscape_configurations_are_read(answer, call, deck, tmp_path):
    edges = tmp_path / "edges.txt"
    call("convert", deck, "-o", edges)
    assert answer("info", edges)["resistors"] == answer("solve", edges)["resistors"] == 3
    assert call("convert", edges, "-o", tmp_path / "edges.json").exit_code == 0
    assert answer("solve", tmp_path / "edges.json")["resistors"] == 3
    for name, text in {"g.txt": "1 2 5\n2 3 5\n", "s.txt": "1 1\n", "d.txt": "3 0\n"}.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "net.ini").write_text(
        "[Calculation options]\ndata_type = network\nscenario = advanced\nground_file_is_resistances = True\n"
        "[Habitat raster or graph]\nhabitat_file = g.txt\nhabitat_map_is_resistances = True\n"
        "[Options for advanced mode]\nsource_file = s.txt\nground_file = d.txt\n"
    )
    assert answer("solve", tmp_path / "net.ini")["power"] == pytest.approx(10.0)


def test_check_rejects_networks_without_a_deck(call, deck, tmp_path):
    assert call("convert", deck, "-o", tmp_path / "a.json").exit_code == 0
    result = call("check", tmp_path / "a.json")
    assert result.exit_code == 2 and "convert it to a deck" in result.stderr


def test_a_spectre_deck_is_read_back(answer, call, deck, tmp_path):
    assert call("convert", deck, "-o", tmp_path / "a.scs").exit_code == 0
    assert call("convert", tmp_path / "a.scs", "-o", tmp_path / "b.cir").exit_code == 0
    assert answer("solve", tmp_path / "a.scs")["power"] == answer("solve", tmp_path / "b.cir")["power"]


def test_scenes_are_converted_to_decks(answer, call, lesson, tmp_path):
    out = tmp_path / "lesson.scs"
    assert answer("convert", lesson, "-o", out)["dialect"] == "spectre"
    assert "resistor" in out.read_text()
    deck = tmp_path / "lesson.cir"
    assert call("convert", lesson, "-o", deck).exit_code == 0
    assert answer("check", deck)["agrees"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("solve", "DECK", "-o", "x.xls"), ".csv, .json, .npz or .raw"),
        (("solve", "DECK", "-o", "x.raw", "--raw", "hex"), "binary or ascii"),
        (("solve", "DECK", "--worst", "-1"), "x>=0"),
        (("solve", "DECK", "-o", "-", "--json"), "standard output"),
        (("solve", "DECK", "--boundary", "wall"), "is a deck"),
        (("solve", "DECK", "--read-as", "pspice"), "pspice"),
        (("solve", "DECK", "--root", "nowhere"), "nowhere"),
        (("info", "DECK", "--k", "1"), "is a deck"),
        (("check", "DECK", "--rules", "--deck", "x"), "leave --deck out"),
        (("convert", "DECK"), "-o"),
        (("convert", "DECK", "-o", "x.xyz"), "must end in"),
        (("convert", "DECK", "-o", "DECK"), "this is the input"),
        (("convert", "DECK", "-o", "x.txt", "--bare"), "no dialect and no sidecar"),
        (("convert", "DECK", "-o", "-", "--json"), "standard output"),
        (("convert", "DECK", "-o", "x.cir", "--dialect", "spike"), "spike"),
        (("path", "DECK"), "deck"),
        (("solve", "absent.sp"), "absent.sp"),
        (("solve", "FOLDER.sp"), "FOLDER.sp"),
        (("check", "absent.sp"), "absent.sp"),
        (("convert", "absent.sp", "-o", "x.cir"), "absent.sp"),
    ],
)
def test_invalid_deck_options_exit_with_2_and_one_message(call, deck, tmp_path, monkeypatch, words, message):
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
        (b"* t\nv1 a 0 1\nr1 a 0 1e999\n.end\n", 2, ":3"),
    ],
)
def test_invalid_decks_exit_with_2_and_one_message(call, tmp_path, text, code, message):
    deck = tmp_path / "bad.sp"
    deck.write_bytes(text)
    for subcommand in ("solve", "check"):
        result = call(subcommand, deck)
        assert result.exit_code == code, (subcommand, result.output)
        assert message in result.stderr
