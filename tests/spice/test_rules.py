"""Rules of `rg.check_erc`: every fault with its place; voltage loops compared with linear algebra.

Tests internals: `resgrid.spice.check.connectivity`.
"""

from __future__ import annotations

import io

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.circuits import ladder, random_grid

import resgrid as rg
from resgrid.spice.check.connectivity import loop_voltages

BASE = ladder(3)  # nodes 0 to 4


def with_two_more_nodes(**changes: object) -> rg.Netlist:
    return BASE.replace(node_count=7, **changes)


def test_sound_circuits_have_no_findings() -> None:
    assert rg.check_erc(ladder()) == ()
    assert rg.check_erc(random_grid(0)) == ()


@pytest.mark.parametrize(
    ("netlist", "rule", "severity", "place"),
    [
        (with_two_more_nodes(), "floating", "warning", "node_5, node_6"),
        (
            with_two_more_nodes(current_nodes=[[0, 5]], current_amps=[1e-6]),
            "trapped current",
            "error",
            "0, node_5",
        ),
        (BASE.replace(source_nodes=[[1, 0], [0, 1]], source_volts=[1.0, -1.0]), "voltage loop", "warning", "0, node_1"),
        (BASE.replace(source_nodes=[[1, 0], [1, 0]], source_volts=[1.0, 2.0]), "voltage loop", "error", "0, node_1"),
        (BASE.replace(conductance=[1e-9, 1e-3, 1e-3, 1e9]), "value range", "warning", "node_1, node_2"),
        (BASE.replace(conductance=[1e-310, 1e-3, 1e-3, 1e-3]), "value", "error", "node_1, node_2"),
        (
            BASE.replace(resistor_nodes=[[1, 2], [2, 3], [3, 4], [4, 0], [2, 2]], conductance=[1e-3] * 5),
            "shorted resistor",
            "warning",
            "node_2",
        ),
        (BASE.replace(node_names=("0", "a", "A", "b", "c")), "names", "warning", "a"),
        (rg.Netlist(3, [[1, 2]], [1.0], source_nodes=[[1, 2]], source_volts=[1.0]), "ground", "error", "0"),
    ],
)
def test_each_rule_reports_its_fault_with_severity_and_place(
    netlist: rg.Netlist, rule: str, severity: str, place: str
) -> None:
    found = {finding.rule: finding for finding in rg.check_erc(netlist)}
    assert rule in found
    assert (found[rule].severity, found[rule].place) == (severity, place)
    assert found[rule].message
    assert found[rule].remedy


def test_errors_come_first() -> None:
    severities = [
        finding.severity for finding in rg.check_erc(with_two_more_nodes(current_nodes=[[0, 5]], current_amps=[1e-6]))
    ]
    assert severities == ["error", "warning"]


SOUND = "* sound\nv1 a 0 1\nr1 a b 1k\nr2 b 0 1k\n"


def findings_of(text: str) -> dict[tuple[str, str], str]:
    return {
        (f.rule, f.severity): f.place for f in rg.check_erc(rg.read_spice(io.StringIO(text))) if f.rule != "reading"
    }


def test_a_sound_deck_has_no_findings() -> None:
    assert findings_of(SOUND + ".end\n") == {}


@pytest.mark.parametrize(
    ("lines", "rule", "severity", "line"),
    [
        ("rx c d 1k\n", "floating", "error", 5),
        ("r3 b x 1k\ncx c 0 1u\n", "capacitor node", "error", 6),
        ("i1 0 c 1u\n", "trapped current", "error", 5),
        ("v2 a 0 1\n", "voltage loop", "error", 5),
        ("r3 b 0 1k\nv2 a 0 2\n", "voltage loop", "error", 6),
        ("r3 a 0 0\n", "voltage loop", "error", 5),
        ("r3 b c 0\nr4 b c 0\nr5 c 0 1\n", "voltage loop", "warning", 6),
        ("r3 b 0 0\n", "zero resistance", "warning", 5),
        ("r3 b 0 -5\n", "negative resistance", "error", 5),
        ("r3 b b 5\n", "shorted resistor", "warning", 5),
        ("i3 b b 5\n", "shorted current source", "warning", 5),
        ("r3 b c 5\n", "dangling", "info", 5),
        ("r3 b 0 1e-14\n", "value range", "warning", 3),
        ("r3 b 0 1e-6\n", "extreme value", "info", 5),
        ("r3 b 0 1e15\n", "extreme value", "info", 5),
    ],
)
def test_every_fault_of_a_deck_is_reported_with_its_line(lines: str, rule: str, severity: str, line: int) -> None:
    found = findings_of(SOUND + lines + ".end\n")
    assert (rule, severity) in found, found
    assert found[rule, severity].endswith(f":{line}")


def test_a_deck_without_ground_is_an_error() -> None:
    assert ("ground", "error") in findings_of("* t\nv1 a b 1\nr1 a b 1k\n.end\n")


def test_islands_are_reported_individually_with_their_nodes() -> None:
    text = SOUND + "".join(f"rx{i} p{i} q{i} 1k\n" for i in range(12)) + ".end\n"
    floating = [f for f in rg.check_erc(rg.read_spice(io.StringIO(text))) if f.rule == "floating"]
    assert len(floating) == 11
    assert floating[0].nodes == ("p0", "q0")
    assert "2 more parts, with 4 nodes" in floating[-1].message


def test_notes_of_the_reader_are_findings() -> None:
    found = [f for f in rg.check_erc(rg.read_spice(io.StringIO(SOUND + "r9 b 0 1M\n.end\n"))) if f.rule == "reading"]
    assert any("milli" in finding.message and finding.severity == "warning" for finding in found)
    assert "milli" in str(found[0])


@pytest.mark.parametrize(
    ("name", "severity", "word"),
    [
        ("gnd", "warning", "ground"),
        ("a b", "warning", "separate words"),
        ("a=b", "warning", "separate words"),
        ("a$b", "warning", "comment"),
        ("knöten", "warning", "ASCII"),
        ("a-b", "info", "operators"),
        ("1a", "info", "Spectre"),
        ("time", "info", "variables"),
        ("", "warning", "separate words"),
    ],
)
def test_misread_node_names_are_reported(name: str, severity: str, word: str) -> None:
    netlist = rg.Netlist(
        3, [[1, 2], [2, 0]], [1.0, 1.0], source_nodes=[[1, 0]], source_volts=[1.0], node_names=("0", "fine", name)
    )
    assert any(f.rule == "names" and f.severity == severity and word in f.message for f in rg.check_erc(netlist))
    assert rg.check_erc(netlist.replace(node_names=("0", "fine", "n_12_7"))) == ()


def test_places_of_compiled_circuits_are_cells() -> None:
    cell = np.zeros((5, 3), dtype=np.uint8)
    cell[2], cell[0, 0] = 1, 2
    space = rg.ConfigurationSpace([rg.Axis("x", 0, 5, 5), rg.Axis("y", 0, 3, 3)], cell)
    netlist = rg.compile_space(space)
    corner, middle = netlist.cells.node[3, 0], netlist.cells.node[0, 2]
    subject = rg.spice.Circuit.of(netlist)
    assert subject.place_of_nodes(np.array([corner])) == "cell (3, 0)"
    assert subject.place_of_nodes(np.array([corner, middle])) == "cells (3, 0), (0, 2)"
    assert subject.place_of_nodes(np.array([0])) == "0"


@pytest.mark.parametrize(("volts", "contradicts"), [(1.0, False), (1.0 + 1e-13, False), (1.0 + 1e-10, True)])
def test_a_loop_without_solution_is_an_error(volts: float, contradicts: bool) -> None:
    netlist = rg.Netlist(2, [[1, 0]], [1.0], source_nodes=[[1, 0], [1, 0]], source_volts=[1.0, volts])
    assert any(violation.severity == "error" for violation in rg.check_erc(netlist)) == contradicts
    if contradicts:
        with pytest.raises(rg.CircuitError, match="contradicts"):
            rg.solve(netlist)


@pytest.mark.parametrize(
    "loop", [[(2, 2, 1e-9)], [(2, 1, 1e-9), (2, 1, 2e-9)], [(3, 2, 1e-9), (3, 1, 3e-9), (2, 1, 1e-9)]]
)
def test_a_large_source_outside_a_loop_does_not_hide_a_contradiction(loop: list[tuple[int, int, float]]) -> None:
    sources = [(1, 0, 1e6), *loop]
    netlist = rg.Netlist(
        4,
        [[2, 0], [3, 1], [2, 3]],
        np.ones(3),
        source_nodes=[source[:2] for source in sources],
        source_volts=[source[2] for source in sources],
    )
    assert any(violation.severity == "error" for violation in rg.check_erc(netlist))
    with pytest.raises(rg.CircuitError, match=r"contradicts the other sources by 1e-09 V"):
        rg.solve(netlist)


def test_a_consistent_small_loop_on_a_large_source_is_solved() -> None:
    sources = [(1, 0, 1e6), (2, 1, 1e-9), (3, 2, 2e-9), (3, 1, 3e-9)]
    netlist = rg.Netlist(
        4,
        [[2, 1], [3, 0]],
        np.ones(2),
        source_nodes=[source[:2] for source in sources],
        source_volts=[source[2] for source in sources],
    )
    with pytest.warns(UserWarning, match="undetermined"):
        assert rg.solve(netlist).resistor_current[0] == 1e-9


@pytest.mark.slow
@given(st.lists(st.tuples(st.integers(0, 7), st.integers(0, 7), st.integers(-3, 3)), max_size=14))
@settings(max_examples=200)
def test_contradictions_agree_with_matrix_ranks(sources: list[tuple[int, int, int]]) -> None:
    """A source closes a loop if its row depends on earlier rows; it contradicts them if its voltage differs."""
    ends = np.array([(a, b) for a, b, _ in sources], dtype=np.int64).reshape(-1, 2)
    volts = np.array([v for *_, v in sources], dtype=np.float64)
    rest, closing, bad = loop_voltages(ends, volts, 8)
    rows = np.zeros((len(ends), 8))
    np.add.at(rows, (np.arange(len(ends)), ends[:, 0]), 1.0)
    np.add.at(rows, (np.arange(len(ends)), ends[:, 1]), -1.0)
    for i in range(len(ends)):
        before = np.linalg.matrix_rank(rows[:i]) if i else 0
        assert closing[i] == (np.linalg.matrix_rank(rows[: i + 1]) == before)
        kept = [j for j in range(i) if not closing[j]]
        if closing[i]:
            solution = np.linalg.lstsq(rows[kept], volts[kept], rcond=None)[0] if kept else np.zeros(8)
            assert rest[i] == pytest.approx(abs(rows[i] @ solution - volts[i]), abs=1e-9)
            assert bad[i] == (rest[i] > 1e-9)
