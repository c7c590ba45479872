"""Verification of boards by kicad-cli and ngspice: a written board agrees, and every fault is found in its place.

Tests internals: `resgrid.hardware.board_check`, `resgrid.hardware.kicad_reports`, `resgrid.hardware.tools`.
"""

from __future__ import annotations

import dataclasses
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hardware.board_mutations import MUTATIONS, Place, Project, drill_through_a_track, located
from support.cli import call

import resgrid as rg
from resgrid.hardware import board_check
from resgrid.hardware.kicad_reports import BoardReports, report_board
from resgrid.hardware.tools import KicadCli, find_kicad

CELLS = np.zeros((5, 4), np.uint8)
CELLS[1, 1], CELLS[2, 1], CELLS[4, 3] = 1, 1, 2


def write_small_board(folder: Path, kind: str) -> Path:
    axes = [rg.Axis("x", 0.0, 5.0, 5), rg.Axis("y", 0.0, 4.0, 4)]
    space = rg.ConfigurationSpace(axes, CELLS)
    rg.save(rg.hardware.build_board(space, kind=kind, resistance=10e3), folder)
    return folder


@pytest.fixture(scope="module")
def boards(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Folder of a board of each kind; no test changes these folders."""
    return {kind: write_small_board(tmp_path_factory.mktemp("boards") / kind, kind) for kind in ("fixed", "jumpers")}


@pytest.fixture(scope="module")
def known_reports() -> dict[tuple[object, ...], BoardReports]:
    """Reports of kicad-cli by the names and contents of the files that it reads."""
    return {}


@pytest.fixture(autouse=True)
def _reports_once(known_reports: dict[tuple[object, ...], BoardReports], monkeypatch: pytest.MonkeyPatch) -> None:
    """Run kicad-cli once for equal files: a test that changes only lists or the record uses the earlier reports."""

    def report_once(kicad: KicadCli, board: Path, folder: Path, timeout: float) -> BoardReports:
        files = sorted(file for file in board.parent.rglob("*") if file.suffix not in (".csv", ".json"))
        key = (kicad, board.name, *((file.name, file.read_bytes()) for file in files if file.is_file()))
        if key not in known_reports:
            known_reports[key] = report_board(kicad, board, folder, timeout)
        return known_reports[key]

    monkeypatch.setattr(board_check, "report_board", report_once)


@pytest.fixture
def board(boards: dict[str, Path], tmp_path: Path) -> Path:
    """Copy of the folder of a fixed board."""
    return Path(shutil.copytree(boards["fixed"], tmp_path / "board"))


@pytest.mark.parametrize("kind", ["fixed", pytest.param("jumpers", marks=pytest.mark.slow)])
def test_a_written_board_agrees_with_its_record(boards: dict[str, Path], kind: str) -> None:
    check = rg.hardware.check_board(boards[kind])
    record = rg.hardware.read_record(boards[kind] / "grid.kicad_pcb")
    assert (check.agrees, check.verified, check.findings) == (True, True, ())
    assert check.parts == len(record.parts) and check.nodes == len(record.voltages)
    assert check.max_relative_error is not None and check.max_relative_error < 1e-12
    assert set(check.tools) == {"kicad-cli", "ngspice"}


@pytest.mark.slow
@pytest.mark.parametrize("mutate", MUTATIONS, ids=lambda mutate: mutate.__name__)
def test_a_fault_is_found_and_located(board: Path, mutate: Callable[[Project], list[Place]]) -> None:
    project = Project.read(board, seed=1)
    places = mutate(project)
    project.write(board)
    check = rg.hardware.check_board(board)
    assert check.agrees is False
    assert located(check.findings, places), (places, check.findings)


@pytest.mark.slow
def test_old_files_for_the_manufacturer_are_found(board: Path, tmp_path: Path) -> None:
    pcb = board / "grid.kicad_pcb"
    kicad, gerbers = find_kicad(), tmp_path / "gerbers"
    gerbers.mkdir()
    kicad.run("pcb", "export", "gerbers", "-l", "F.Cu,B.Cu,F.Mask", "-o", f"{gerbers}/", pcb)
    kicad.run("pcb", "export", "drill", "-o", f"{gerbers}/", pcb)
    shutil.make_archive(str(board / "gerbers"), "zip", gerbers)
    assert rg.hardware.check_board(board).agrees
    project = Project.read(board, seed=1)
    places = drill_through_a_track(project)
    project.write(board)
    findings = rg.hardware.check_board(board).findings
    assert located(findings, places)
    assert [finding for finding in findings if finding.startswith("gerbers.zip")] == [
        "gerbers.zip: the holes differ from the board; export the drill files again"
    ]
    (board / "gerbers.zip").write_bytes(b"PK")
    assert any(text.startswith("gerbers.zip cannot be read") for text in rg.hardware.check_board(board).findings)


def test_a_changed_record_contradicts_itself_and_the_board(board: Path) -> None:
    path = board / "grid.record.json"
    record = json.loads(path.read_text())
    part = next(part for part in record["parts"] if part["reference"] == "R5")
    part["value"] *= 2
    path.write_text(json.dumps(record))
    check = rg.hardware.check_board(board)
    assert any(finding.startswith("the record contradicts itself: n_") for finding in check.findings)
    assert any(finding.startswith("board: R5: 10000 ohm instead of 20000") for finding in check.findings)


def test_lists_that_contradict_the_record_are_found(board: Path) -> None:
    voltages, bill = board / "expected_voltages.csv", board / "bill_of_materials.csv"
    lines = voltages.read_text().splitlines()
    record = rg.hardware.read_record(board / "grid.kicad_pcb")
    expected = record.voltages[record.part["TP2"].nets[0]]
    fields = lines[2].split(",")
    fields[-2] = f"{expected + 2e-6:.6f}"
    voltages.write_text("\n".join([lines[0], ",".join(fields), *lines[3:]]))
    bill.write_text(bill.read_text().replace("10k ohm", "12k ohm", 1))
    findings = rg.hardware.check_board(board).findings
    assert "expected_voltages.csv: TP1 is missing" in findings
    assert f"expected_voltages.csv: TP2: {expected + 2e-6:.6f} V instead of {expected:.6f} V" in findings
    assert "bill_of_materials.csv: R5: 12000 ohm instead of 10000" in findings
    bill.write_text("references,quantity,value,package,tolerance,description\nR1-Q3,1,1,1,1,resistor\n")
    voltages.write_bytes(b"pad,volts\xff\n")
    unreadable = [text for text in rg.hardware.check_board(board).findings if "csv" in text]
    assert len(unreadable) == 2 and "'R1-Q3' is not a reference" in unreadable[1]


@pytest.mark.slow
def test_without_a_schematic_the_board_is_not_verified(board: Path) -> None:
    for sheet in board.glob("*.kicad_sch"):
        sheet.unlink()
    check = rg.hardware.check_board(board)
    assert (check.agrees, check.verified, check.findings) == (None, False, ())
    assert "no schematic" in check.remark


def test_without_kicad_the_board_is_not_verified(boards: dict[str, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RESGRID_KICAD_CLI", "/nowhere/kicad-cli")
    result = call("check", boards["fixed"])
    assert result.exit_code == 5
    assert "not verified: RESGRID_KICAD_CLI = /nowhere/kicad-cli is not a program" in result.stdout


@pytest.mark.slow
def test_the_command_prints_findings_and_exits_with_one(board: Path) -> None:
    result = call("check", board / "grid.kicad_pro", "-q")
    assert result.exit_code == 0 and "confirm the record with" in result.stdout
    project = Project.read(board, seed=1)
    ((name, words),) = next(m for m in MUTATIONS if m.__name__ == "change_a_value_on_the_board")(project)
    project.write(board)
    result = call("check", board / "grid.kicad_pcb")
    assert result.exit_code == 1 and f"board: {name}: {words} instead of" in result.stdout
    data = json.loads(call("check", board, "--json").stdout)
    assert data["schema"] == 1 and data["agrees"] is False and data["verified"] is True
    assert data["reference"] == "record" and any(words in text for text in data["findings"])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--rules"], "--rules and --deck check scenes and decks"),
        (["--deck", "a.cir"], "--rules and --deck check scenes and decks"),
        (["--k", "0.5"], "options for keys of scenes and maps have no effect"),
    ],
)
def test_options_of_decks_and_scenes_are_rejected(boards: dict[str, Path], arguments: list[str], words: str) -> None:
    result = call("check", boards["fixed"], *arguments)
    assert result.exit_code == 2 and words in result.stderr


def test_folders_and_files_without_one_board_are_rejected(board: Path, tmp_path: Path) -> None:
    with pytest.raises(rg.InputError, match="holds no board"):
        rg.hardware.check_board(tmp_path)
    shutil.copyfile(board / "grid.kicad_pcb", board / "other.kicad_pcb")
    with pytest.raises(rg.InputError, match=r"holds 2 boards \(grid.kicad_pcb, other.kicad_pcb\); name one"):
        rg.hardware.check_board(board)
    (board / "grid.kicad_pcb").write_text("(kicad_pcb")
    with pytest.raises(rg.InputError, match=r"'kicad-cli pcb \w+.*' failed for .*grid\.kicad_pcb"):
        rg.hardware.check_board(board / "grid.kicad_pcb")


@pytest.mark.slow
@pytest.mark.parametrize("goals", [((0, 1), (6, 1)), ((2, 2), (6, 2)), ((0, 7), (7, 7))])
def test_two_goal_regions_in_a_row_keep_the_clearance(tmp_path: Path, goals: tuple[tuple[int, int], ...]) -> None:
    scene = rg.read_scene("lesson.toml", goal=[rg.GoalCell(goal) for goal in goals])
    check = rg.hardware.check_board(rg.save(rg.hardware.build_board(scene), tmp_path / "board"))
    assert check.agrees, check.findings


@pytest.mark.slow
def test_marks_of_variables_in_a_title_are_not_expanded(tmp_path: Path) -> None:
    scene = dataclasses.replace(rg.read_scene("lesson.toml"), title="a ${REFERENCE}\n%R @{1+1}")
    board = rg.hardware.build_board(scene)
    assert board.title == "a {REFERENCE} R {1+1}"
    check = rg.hardware.check_board(rg.save(board, tmp_path / "board"))
    assert check.agrees, check.findings


@pytest.mark.parametrize(
    ("options", "message"), [({"supply": -5.0}, "positive"), ({"resistance": 1e12}, "sold from 1 ohm")]
)
def test_supplies_and_resistors_that_no_board_has_are_refused(options: dict[str, float], message: str) -> None:
    with pytest.raises(rg.InputError, match=message):
        rg.hardware.build_board(rg.build_space(rg.read_scene("lesson.toml")), **options)  # type: ignore[arg-type]
