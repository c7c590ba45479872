"""Records of boards and layouts: what is written is read again, and a damaged record names its problem.

Tests internals: `resgrid.hardware.record`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import resgrid as rg
from resgrid.hardware.record import format_record, natural_order, read_record, record_path, write_record

RECORD = rg.hardware.HardwareRecord(
    "board",
    "jumpers",
    "grid.kicad_pcb",
    "0123",
    parts=(
        rg.hardware.Part("R10", "resistor", 10_200.0, ("n_0_0", "obstacle")),
        rg.hardware.Part("R2", "resistor", 1e4, ("n_0_0", "n_1_0")),
        rg.hardware.Part("JP1", "jumper", None, ("obstacle", "n_1_0", "0"), (2, 3)),
        rg.hardware.Part("H1", "hole", None, ()),
    ),
    sources=(rg.hardware.Supply("obstacle", "obstacle", "0", 1.0),),
    voltages={"obstacle": 1.0, "n_0_0": 10_000 / 20_200, "n_1_0": 0.0},
    nodes={"n_0_0": (0, 0), "n_1_0": (1, 0)},
)


def test_a_record_is_read_as_it_was_written(tmp_path: Path) -> None:
    path = write_record(tmp_path / "grid.kicad_pcb", RECORD)
    assert path == record_path(tmp_path / "grid.kicad_pcb") == tmp_path / "grid.record.json"
    for file in (path, tmp_path / "grid.kicad_pcb"):
        again = read_record(file)
        assert again == replace(
            RECORD, parts=tuple(sorted(RECORD.parts, key=lambda part: natural_order(part.reference)))
        )
    assert format_record(again) == path.read_text() == format_record(RECORD)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("10200.0", '"10k2"', "parts.3.value: Input should be a valid number"),
        ("10200.0", "-1.0", "resistor R10 has the value -1.0"),
        ("10200.0", "null", "resistor R10 has the value None"),
        ('"R10"', '"R2"', "2 parts have the reference R2"),
        ('"kind"', '"kin"', "kind: Field required"),
        ('"scene_hash"', '"extra": 1, "scene_hash"', "extra: Unexpected keyword argument"),
        ('"schema": 1', '"schema": 2', '"schema": 1'),
        ('"closed": [2, 3]', '"closed": [2, 4]', "JP1 joins pads [2, 4]"),
        ('"positive": "obstacle"', '"positive": "rail"', "source obstacle is on net rail, which no part touches"),
        ('"obstacle": 1.0', '"rail": 1.0', "net rail has a voltage"),
        ("{", "[", "Expecting"),
    ],
)
def test_a_damaged_record_is_rejected_with_its_problem(tmp_path: Path, old: str, new: str, words: str) -> None:
    path = write_record(tmp_path / "grid.kicad_pcb", RECORD)
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(rg.InputError, match=r"grid\.record\.json is damaged") as caught:
        read_record(path)
    assert words in str(caught.value) and str(caught.value).endswith("write the board or layout again")


def test_an_absent_record_names_the_commands_that_write_it(tmp_path: Path) -> None:
    with pytest.raises(rg.InputError, match=r"grid\.record\.json is absent .* 'resgrid board'"):
        read_record(tmp_path / "grid.kicad_pcb")


def test_a_contradictory_record_is_not_written(tmp_path: Path) -> None:
    wrong = replace(RECORD, parts=(*RECORD.parts, RECORD.parts[0]))
    with pytest.raises(rg.InputError, match="2 parts have the reference R10"):
        write_record(tmp_path / "grid.kicad_pcb", wrong)
    assert not list(tmp_path.iterdir())
