"""Flat decks and their sidecars: text compared with literals, names, reciprocals compared with exact fractions.

Tests internals: `resgrid.spice.run.ngspice`, `resgrid.spice.write.flat`, `resgrid.spice.write.names`.
"""

from __future__ import annotations

import json
import re
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from support.circuits import dense_solution, ladder, random_grid
from support.spaces import space_of

import resgrid as rg
from resgrid.spice.run.ngspice import simulate
from resgrid.spice.write.flat import flatten, resistances
from resgrid.spice.write.names import legal_names


def test_names_that_ngspice_misreads_are_not_written() -> None:
    netlist = rg.Netlist(3, [[1, 2], [2, 0]], [1e-3, 1e-3], source_nodes=[[1, 0]], source_volts=[1.0])
    deck = flatten(netlist.replace(node_names=("0", "temper", "Temper")))
    assert deck.node_names == ["temper_2", "temper_3"]
    assert simulate(deck.text.encode()).voltage == pytest.approx({"temper_2": 1.0, "temper_3": 0.5})


def test_the_deck_of_a_ladder_equals_a_handwritten_one() -> None:
    assert flatten(ladder(3), title="ladder").text == (
        "* ladder\n"
        "* ngspice dialect: 4 nodes besides ground, 1 voltage sources, 1 current sources, 4 resistors\n"
        "* voltage sources\n"
        "v_node_1 node_1 0 1.0\n"
        "* current sources\n"
        "i_node_2 0 node_2 1e-05\n"
        "* resistors\n"
        "r_node_1_node_2 node_1 node_2 1000.0\n"
        "r_node_2_node_3 node_2 node_3 1000.0\n"
        "r_node_3_node_4 node_3 node_4 1000.0\n"
        "r_node_4 node_4 0 1000.0\n"
        ".end\n"
    )


def test_element_names_come_from_cells_and_rails() -> None:
    netlist = rg.compile_space(space_of([[1, 0, 2], [0, 0, 0]]), edge="open", resistance=10e3)
    lines = flatten(netlist).text.splitlines()
    assert lines[0] == "* resistor grid of 2 x 3 cells, dirichlet boundary"
    assert {"v_obstacle obstacle 0 1.0", "v_goal_0 goal_0 0 0.0"} <= set(lines)
    assert any(re.fullmatch(r"r_1_0_1_1 n_1_0 n_1_1 10000\.0", line) for line in lines)


def test_the_deck_does_not_depend_on_the_order_of_elements() -> None:
    netlist = random_grid(1)
    order = np.random.default_rng(0).permutation(len(netlist.conductance))
    shuffled = netlist.replace(
        resistor_nodes=netlist.resistor_nodes[order], conductance=netlist.conductance[order], source_volts=[1.0, 0, 0]
    )
    assert flatten(shuffled).text == flatten(netlist).text


@given(st.lists(st.floats(1e-300, 1e300), min_size=1, max_size=20))
def test_resistances_are_the_best_reciprocals_of_conductances(values: list[float]) -> None:
    for conductance, resistance in zip(values, resistances(np.array(values)).tolist(), strict=True):
        error = abs(1 / resistance - conductance)
        neighbours = [np.nextafter(1 / conductance, 0), 1 / conductance, np.nextafter(1 / conductance, np.inf)]
        assert error <= min(abs(1 / float(x) - conductance) for x in neighbours)
        assert abs(Fraction(resistance) * Fraction(conductance) - 1) < Fraction(1, 10**15)


def test_reciprocals_of_round_resistances_are_round() -> None:
    meant = np.array([3300.0, 10e3, 47e3, 1.2345678e5, 99e-3])
    np.testing.assert_array_equal(resistances(1 / meant), meant)


def test_temperature_coefficients_and_capacitors_are_written() -> None:
    netlist = ladder(2).replace(
        tc1=[1e-3, 0.0, -0.0], tc2=[0.0, 1e-6, 0.0], capacitor_nodes=[[2, 0], [2, 3]], capacitance=[1e-12, 2e-12]
    )
    lines = flatten(netlist).text.splitlines()
    assert "r_node_1_node_2 node_1 node_2 1000.0 tc1=0.001 tc2=0.0" in lines
    assert "r_node_3 node_3 0 1000.0 tc1=0.0 tc2=0.0" in lines
    assert {"c_node_2 node_2 0 1e-12", "c_node_2_node_3 node_2 node_3 2e-12"} <= set(lines)


def test_floating_parts_and_redundant_sources_are_omitted() -> None:
    netlist = ladder(2).replace(
        node_count=7,
        resistor_nodes=[*ladder(2).resistor_nodes.tolist(), [4, 5]],
        conductance=[1e-3] * 4,
        source_nodes=[[1, 0], [0, 1]],
        source_volts=[1.0, -1.0],
        current_nodes=[[4, 5]],
        current_amps=[1.0],
        capacitor_nodes=[[3, 6]],
        capacitance=[1e-12],
    )
    deck = flatten(netlist)
    assert deck.left_out == ["node_4", "node_5", "node_6"]
    assert not re.search(r"node_[456]", deck.text)
    assert "* left out: 3 floating nodes (listed in the sidecar), 4 elements" in deck.text
    assert deck.text.count("\nv_") == 1


def test_foreign_names_are_mapped_and_recorded(tmp_path: Path) -> None:
    netlist = ladder(2).replace(
        node_names=("gnd!", "VDD", "vdd", "gnd"),
        element_names={
            "resistor": ("R1", "r1", "X.7"),
            "voltage source": ("Vsup",),
            "current source": ("feed",),
            "capacitor": (),
        },
    )
    deck = flatten(netlist)
    assert deck.node_names == ["vdd_2", "vdd", "gnd_2"]
    assert deck.renamed_nodes == {"vdd_2": "VDD", "gnd_2": "gnd"}
    assert deck.renamed_elements == {"r1_2": "R1", "r_x_7": "X.7", "vsup": "Vsup", "i_feed": "feed"}
    written = rg.write_spice(dense_solution(netlist), tmp_path / "a.cir")
    sidecar = json.loads(written.sidecar.read_text())
    assert sidecar["renamed"] == {"nodes": deck.renamed_nodes, "elements": deck.renamed_elements}


@pytest.mark.parametrize("title", ["a\nr1 a 0 1", "*#quit", ".control", "é\x00\x1b", "", "x" * 1000])
def test_a_title_stays_one_comment_line(title: str) -> None:
    lines = flatten(ladder(), title=title).text.splitlines()
    assert lines[0].startswith("* ")
    assert lines[0].isascii()
    assert lines[0].isprintable()
    assert lines[1:] == flatten(ladder()).text.splitlines()[1:]


@pytest.mark.parametrize(
    ("netlist", "error", "message"),
    [
        (ladder().replace(source_nodes=[[1, 0], [1, 0]], source_volts=[1.0, 2.0]), rg.CircuitError, "contradicts"),
        (ladder().replace(node_count=9, current_nodes=[[0, 8]], current_amps=[1.0]), rg.CircuitError, "floating part"),
        (ladder().replace(conductance=[1e-310] * 5), rg.InputError, "open"),
        (rg.Netlist(2, [], []), rg.InputError, "no node has a path"),
    ],
)
def test_netlists_without_a_valid_deck_raise(netlist: rg.Netlist, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        flatten(netlist)


def test_an_unknown_dialect_raises_input_error_with_suggestions() -> None:
    with pytest.raises(rg.InputError, match=r"did you mean 'ngspice'\?"):
        flatten(ladder(), dialect="ngspize")
    with pytest.raises(rg.InputError, match=r"choose one of .*ngspice"):
        flatten(ladder(), dialect="verilog")


def test_the_sidecar_contains_cells_and_voltages_without_nan(tmp_path: Path) -> None:
    netlist = rg.compile_space(space_of([[1, 0, 0, 2]]), edge="open", resistance=10e3)
    written = rg.write_spice(netlist, tmp_path / "a.cir", title="t")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.cir", "a.cir.json", "a.cir.ngspice", "a.cir.verify"]
    sidecar = json.loads(written.sidecar.read_text(), parse_constant=pytest.fail)
    assert sidecar["schema"] == 1
    assert sidecar["sha256"] == written.sha256
    assert sidecar["supply"] == 1.0
    assert sidecar["nodes"]["n_0_1"] == {"cell": [0, 1], "voltage": pytest.approx(2 / 3, abs=1e-15)}
    assert sidecar["nodes"]["obstacle"] == {"cell": None, "voltage": 1.0}
    assert sidecar["sources"]["v_goal_0"] == pytest.approx(1 / 30e3)
    before = [path.read_bytes() for path in sorted(tmp_path.iterdir())]
    rg.write_spice(netlist, tmp_path / "a.cir", title="t")
    assert [path.read_bytes() for path in sorted(tmp_path.iterdir())] == before


@pytest.mark.parametrize("name", [".", "missing/a.cir", 'a".cir', "/dev/null"])
def test_an_invalid_path_raises_input_error_and_leaves_no_file(tmp_path: Path, name: str) -> None:
    with pytest.raises(rg.InputError, match="cannot write"):
        rg.write_spice(dense_solution(ladder()), tmp_path / name)
    assert list(tmp_path.iterdir()) == []


@given(st.lists(st.text(max_size=6) | st.sampled_from(["a", "A", "a_2", "gnd", "GND", "0", ""])))
def test_names_are_legal_unique_and_stable(wanted: list[str]) -> None:
    names = legal_names(wanted, "n", ["gnd"])
    assert len(names) == len(wanted) == len(set(names))
    assert all(re.fullmatch("[a-z][a-z0-9_]*", name) and name != "gnd" for name in names)
    for name in set(wanted):
        if re.fullmatch("[a-z][a-z0-9_]*", name) and name != "gnd":
            assert names[wanted.index(name)] == name
    assert legal_names(names, "n", ["gnd"]) == names


def test_50000_equal_names_are_numbered() -> None:
    names = legal_names(["a"] * 50_000, "n")
    assert names[:3] == ["a", "a_2", "a_3"]
    assert len(set(names)) == 50_000


def test_a_legal_name_has_precedence_over_a_mapped_one() -> None:
    assert legal_names(["N1", "n1", "n1"], "n") == ["n1_2", "n1", "n1_3"]


def test_rail_nodes_are_named_after_rail_and_cell(tmp_path: Path, scenes: Path) -> None:
    scene = rg.read_scene(scenes / "lesson.toml")
    chip = rg.Chip(rail_resistance=0.5, goal_switch_on=10.0, goal_switch_off=1e10, obstacle_switch_on=1e3)
    study = rg.study(rg.build_space(scene), chip)
    written = rg.write_spice(study.netlist, tmp_path / "chip.cir")
    deck = rg.read_spice(written.path)
    names = set(deck.node_names)
    assert {"obstacle", "goal_0", "obstacle_0_0", "goal_0_0_0"} <= names
    assert not [name for name in names if name.startswith("node_")]
    assert rg.check_deck(written.path).agrees
