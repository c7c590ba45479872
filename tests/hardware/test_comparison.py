"""Differences between circuits: each is reported once, with its place.

Tests internals: `resgrid.hardware.comparison`.
"""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from resgrid.hardware import HardwareRecord, Part
from resgrid.hardware.comparison import Label, Pad, compare_nets, compare_values, compare_voltages, match_nets, pads_of

CELLS = [f"n_{i}" for i in range(4)]
RECORD = HardwareRecord(
    "board", "fixed", "grid.kicad_pcb", "",
    parts=(
        *(Part(f"R{k + 1}", "resistor", 1e4, (CELLS[k], CELLS[k + 1])) for k in range(3)),
        *(Part(f"R{k + 4}", "resistor", 2e4, (CELLS[k], "obstacle")) for k in range(4)),
        *(Part(f"TP{k + 1}", "test_pad", None, (CELLS[k],)) for k in range(4)),
        Part("J1", "connector", None, ("obstacle", "0")),
        Part("H1", "hole", None, ()),
    ),
    voltages={"n_0": 0.5, "n_1": 0.25, "obstacle": 1.0},
)  # fmt: skip


def changed(changes: Mapping[Pad, Label | None]) -> dict[Pad, Label | None]:
    """The record's own nets with other names, except for some pads."""
    return {pad: net.upper() for pad, net in pads_of(RECORD).items()} | dict(changes)


OPEN = "(open track or missing via)"
SHORT = ["n_1 and n_2 are connected (short circuit)"]


def all_on(net: str, *joined: str) -> dict[Pad, Label | None]:
    return {pad: net for pad, own in pads_of(RECORD).items() if own in joined}


@pytest.mark.parametrize(
    ("changes", "messages"),
    [
        ({}, []),
        ({("R2", 2): "N_1"}, ["R2: pad 2 is on n_1 instead of n_2"]),
        ({("R2", 1): "N_2", ("R2", 2): "N_1"}, []),  # turned around
        (
            {("R1", 1): "N_2", ("R1", 2): "N_3"},
            ["R1: pad 1 is on n_2 instead of n_0", "R1: pad 2 is on n_3 instead of n_1"],
        ),
        ({("R6", 1): "X", ("TP3", 1): "X"}, [f"n_2 is split in two: pads R2.2, R3.1 | R6.1, TP3.1 {OPEN}"]),
        ({("R2", 2): "X", ("TP3", 1): "Y"}, [f"n_2 is split in three: pads R3.1, R6.1 | R2.2 | TP3.1 {OPEN}"]),
        (all_on("N_1", "n_2"), SHORT),
        (all_on("BOTH", "n_1", "n_2"), SHORT),
        ({("R7", 2): None}, ["R7: pad 2 is connected to nothing instead of obstacle"]),
        ({("R9", 1): "N_1"}, ["R9 is not in the record"]),
        ({("R1", 3): "N_1"}, ["R1: pad 3 is not in the record"]),
    ],
)
def test_a_difference_is_located(changes: Mapping[Pad, Label | None], messages: list[str]) -> None:
    assert compare_nets(RECORD, changed(changes)) == messages


def test_absent_parts_and_pads_are_named() -> None:
    found = {pad: net for pad, net in changed({}).items() if pad[0] != "R2" and pad != ("R3", 2)}
    assert compare_nets(RECORD, found) == ["R2 is missing (resistor between n_1 and n_2)", "R3: pad 2 is missing"]


def test_names_of_nets_play_no_part() -> None:
    numbers = {net: number for number, net in enumerate(sorted(set(pads_of(RECORD).values())))}
    found = {pad: numbers[net] for pad, net in pads_of(RECORD).items()}
    assert compare_nets(RECORD, found) == []
    assert match_nets(pads_of(RECORD), found) == {number: net for net, number in numbers.items()}


def test_two_exchanged_ends_of_tracks_are_two_wrong_pads() -> None:
    """Nets of two pads each: the ends of both tracks are exchanged."""
    record = HardwareRecord("board", "fixed", "", "", parts=(
        Part("J1", "connector", None, ("a", "b")), Part("J2", "connector", None, ("a", "b")),
    ))  # fmt: skip
    assert compare_nets(record, {("J1", 1): 0, ("J1", 2): 1, ("J2", 1): 1, ("J2", 2): 0}) == [
        "J2: pad 1 is on b instead of a",
        "J2: pad 2 is on a instead of b",
    ]


def test_values_are_compared_by_reference() -> None:
    values = {"R1": 10_200.0, "R2": 1e4 * (1 + 1e-12), "R3": None}
    assert compare_values(RECORD, values) == [
        "R1: 10200 ohm instead of 10000",
        "R3: a value that is not a number instead of 10000",
    ]


def test_voltages_are_compared_relative_to_the_supply() -> None:
    same = compare_voltages(RECORD, {"n_0": 0.5 + 1e-10, "n_1": 0.25, "obstacle": 1.0}, 1e-9, "ngspice")
    assert same.nodes == 3 and same.findings == () and same.max_abs_error == pytest.approx(1e-10, rel=1e-3)
    other = compare_voltages(RECORD, {"n_0": float("nan"), "n_1": 0.26}, 1e-9, "ngspice")
    assert other.findings == (
        "n_0: ngspice finds nan V, expected 0.5 V",
        "n_1: ngspice finds 0.26 V, expected 0.25 V",
        "ngspice has no voltage of obstacle",
    )
