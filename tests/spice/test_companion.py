"""The companion file, run by ngspice: PASS for the written deck, FAIL after any change."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.circuits import ladder, random_grid
from support.simulators import verdict

import resgrid as rg


@pytest.fixture
def deck(tmp_path: Path):
    netlist = random_grid(3, side=9)
    return rg.write_spice(rg.solve(netlist), tmp_path / "a.cir")


def test_the_companion_passes_for_the_written_deck(deck) -> None:
    assert verdict(deck.companion) == (0, "PASS")


@pytest.mark.parametrize("number", [0, 40, 80])
def test_the_companion_fails_for_a_changed_resistor(deck, number: int) -> None:
    lines = deck.path.read_text().splitlines()
    at = [i for i, line in enumerate(lines) if line.startswith("r_")][number]
    start, value = lines[at].rsplit(" ", 1)
    lines[at] = f"{start} {float(value) * 1.000001!r}"
    deck.path.write_text("\n".join(lines) + "\n")
    assert verdict(deck.companion) == (1, "FAIL")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("\nr_", "\n* r_"),
        ("v_node_1 node_1 0 1.0", "v_node_1 node_1 0 1.00001"),
        (".end", "r_new node_5 node_9 1e4\n.end"),
    ],
)
def test_the_companion_fails_for_other_changes(deck, old: str, new: str) -> None:
    text = deck.path.read_text()
    assert old in text
    deck.path.write_text(text.replace(old, new, 1))
    assert verdict(deck.companion) == (1, "FAIL")


def test_the_companion_does_not_pass_without_the_deck(deck) -> None:
    deck.path.unlink()
    assert verdict(deck.companion)[1] != "PASS"


def test_verify_false_and_other_dialects_write_no_companion(tmp_path: Path) -> None:
    written = rg.write_spice(ladder(), tmp_path / "a.cir", verify=False)
    assert written.companion is None and not (tmp_path / "a.cir.verify").exists()
    assert rg.write_spice(ladder(), tmp_path / "b.cir", "xyce").companion is None


def test_the_companion_fails_for_a_leak_behind_wide_wires(tmp_path: Path) -> None:
    """Wires of 0.5 ohm could carry 3.6 A and the load draws 40 uA: 3 nA more must be detected."""
    pairs = [[1, 2], [2, 3], [3, 0]]
    netlist = rg.Netlist(4, pairs, [2.0, 2.0, 1 / 45e3], source_nodes=[[1, 0]], source_volts=[1.8])
    deck = rg.write_spice(netlist, tmp_path / "a.cir")
    assert verdict(deck.companion) == (0, "PASS")
    deck.path.write_text(deck.path.read_text().replace(".end", "r_leak node_1 0 6e8\n.end"))
    assert verdict(deck.companion) == (1, "FAIL")
