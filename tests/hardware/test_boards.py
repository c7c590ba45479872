"""Boards: their circuit, files and folder; geometry of the copper without outside programs; and kicad-cli's rules.

Tests internals: `resgrid.hardware.board_files`, `resgrid.hardware.e_series`, `resgrid.hardware.kicad.pcb`,
`resgrid.hardware.kicad.sexpr`, `resgrid.hardware.plane`, `resgrid.hardware.routing`.
"""

from __future__ import annotations

import csv
import json
import re
import zipfile
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
from shapely import LineString, Point, Polygon, STRtree, box
from shapely.geometry.base import BaseGeometry
from support.cli import answer, call

import resgrid as rg
from resgrid.hardware.board_files import board_files
from resgrid.hardware.e_series import nearest_e96, resistance_text
from resgrid.hardware.kicad.pcb import Track
from resgrid.hardware.kicad.sexpr import Word, format_tree, identity, number_text
from resgrid.hardware.plane import fill_plane
from resgrid.hardware.routing import route

CLEARANCE = 0.15
"""Smallest distance between copper of different nets, in millimetres."""


def space_of(cells: np.ndarray, spacing: float = 1.0) -> rg.ConfigurationSpace:
    axes = [rg.Axis(name, 0.0, spacing * n, n) for name, n in zip("xy", cells.shape, strict=True)]
    return rg.ConfigurationSpace(axes, cells)


def random_space(seed: int) -> rg.ConfigurationSpace:
    """A space with random obstacles and one or two goal cells in different rows."""
    random = np.random.default_rng(seed)
    shape = tuple(random.integers(5, 15, 2))
    cells = (random.random(shape) < 0.25).astype(np.uint8)
    for row in random.choice(shape[1], size=random.integers(1, 3), replace=False):
        cells[random.integers(shape[0]), row] = 2
    return space_of(cells)


def copper_of(board: rg.hardware.Board) -> list[tuple[str, str, BaseGeometry]]:
    """Layer, net and area of every piece of copper; plated holes appear on both layers."""
    routing = route(board.placement)
    plane = fill_plane(board.placement, routing)
    pieces = [(plane.layer, plane.net, Polygon(part).buffer(0)) for part in plane.filled]
    for track in routing.tracks:
        pieces.append((track.layer, track.net, LineString([track.start, track.stop]).buffer(track.width / 2)))
    for via in routing.vias:
        pieces += [(layer, via.net, Point(via.x, via.y).buffer(via.size / 2)) for layer in ("F.Cu", "B.Cu")]
    for placed in board.placement.parts:
        for pad, net in zip(placed.footprint.pads, placed.nets, strict=False):
            (x, y), (width, height) = placed.place_of(pad), placed.size_of(pad)
            area: BaseGeometry = box(x - width / 2, y - height / 2, x + width / 2, y + height / 2)
            area = Point(x, y).buffer(width / 2) if pad.shape == "circle" else area
            pieces += [(layer, net, area) for layer in (("F.Cu", "B.Cu") if pad.drill else ("F.Cu",))]
    return pieces


def joined_pads(board: rg.hardware.Board) -> dict[str, set[int]]:
    """Numbers of the connected pieces of copper by net, found by touching areas and holes only."""
    pieces = copper_of(board)
    parent = list(range(len(pieces)))

    def root(at: int) -> int:
        while parent[at] != at:
            parent[at] = parent[parent[at]]
            at = parent[at]
        return at

    tree = STRtree([area for *_, area in pieces])
    for first, second in tree.query([area for *_, area in pieces], predicate="intersects").T.tolist():
        (layer, net, area), (other, name, shape) = pieces[first], pieces[second]
        if layer == other or (area.equals(shape) and net == name):
            parent[root(first)] = root(second)
    found = defaultdict(set)
    for at, (_, net, _) in enumerate(pieces):
        found[net].add(root(at))
    return dict(found)


@pytest.mark.parametrize("kind", ["fixed", "jumpers"])
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.quick_cases(4)
def test_copper_joins_exactly_the_pads_of_a_net(kind: str, seed: int) -> None:
    board = rg.hardware.build_board(random_space(seed), kind=kind)
    found = joined_pads(board)
    assert all(len(parts) == 1 for parts in found.values()), {net for net, parts in found.items() if len(parts) > 1}
    assert len({min(parts) for parts in found.values()}) == len(found)


@pytest.mark.parametrize(("kind", "pitch"), [("fixed", 5.08), ("fixed", 6.35), ("jumpers", 6.35), ("jumpers", 10.16)])
def test_copper_of_different_nets_keeps_its_distance(kind: str, pitch: float) -> None:
    board = rg.hardware.build_board(random_space(3), kind=kind, pitch=pitch)
    pieces = copper_of(board)
    tree = STRtree([area for *_, area in pieces])
    wide = [area.buffer(CLEARANCE) for *_, area in pieces]
    for first, second in tree.query(wide, predicate="intersects").T.tolist():
        (layer, net, _), (other, name, _) = pieces[first], pieces[second]
        assert layer != other or net == name, (layer, net, name)


@pytest.mark.parametrize("kind", ["fixed", "jumpers"])
def test_open_borders_have_no_resistors(kind: str) -> None:
    cells = np.zeros((6, 5), np.uint8)
    cells[2, 2], cells[5, 4] = 1, 2
    board = rg.hardware.build_board(space_of(cells), kind=kind, edge="open")
    ends = [end for part in board.circuit.resistors for end in part.ends]
    assert all(0 <= i < 6 and 0 <= j < 5 for i, j in ends)
    assert all(len(parts) == 1 for parts in joined_pads(board).values())
    record = board.record()
    assert {net for part in record.parts if part.type == "resistor" for net in part.nets} == set(record.voltages)


def test_a_missing_track_is_seen_by_the_geometry_test(monkeypatch: pytest.MonkeyPatch) -> None:
    board = rg.hardware.build_board(random_space(3))
    routing = route(board.placement)
    track = next(track for track in routing.tracks if track.net.startswith("n_"))
    assert isinstance(track, Track)
    rest = type(routing)(tuple(each for each in routing.tracks if each != track), routing.vias)
    monkeypatch.setattr(f"{__name__}.route", lambda _placement: rest)
    assert len(joined_pads(board)[track.net]) > 1


def test_the_circuit_is_the_compiled_space_with_values_of_e96() -> None:
    space = rg.build_space(rg.read_scene("lesson"))
    board = rg.hardware.build_board(space, boundary="wall", wall_resistance=33e3, resistance=10e3)
    ideal = rg.compile_space(space, boundary="wall", wall_resistance=33e3, resistance=10e3)
    assert sorted({part.ohms for part in board.circuit.resistors}) == [10e3, 43.2e3]
    assert board.largest_deviation == pytest.approx(0.2 / 43, rel=1e-9)
    op = rg.solve(ideal.replace(conductance=1 / nearest_e96(1 / ideal.conductance)))
    names = ideal.names_of(np.arange(ideal.node_count))
    assert {net: volts for net, volts in board.voltages.items() if net != "0"} == pytest.approx(
        {name: volts for name, volts in zip(names, op.voltage.tolist(), strict=True) if name != "0"}
    )
    assert board.power == pytest.approx(op.power) and board.supply_current == pytest.approx(op.power)
    assert sum(board.circuit.goal_currents.values()) == pytest.approx(board.supply_current)


def test_a_board_with_jumpers_has_the_voltages_of_the_fixed_board() -> None:
    fixed, jumpers = (rg.hardware.build_board(rg.read_scene("lesson"), kind=kind) for kind in ("fixed", "jumpers"))
    shared = [net for net in fixed.voltages if net.startswith("n_")]
    assert [jumpers.voltages[net] for net in shared] == pytest.approx([fixed.voltages[net] for net in shared])
    assert len(jumpers.circuit.resistors) == 7 * 8 * 2 + 4 * 8
    assert sorted(jumpers.closed.values()) == [(1, 2)] * 7 + [(2, 3)]
    assert fixed.closed == {} and jumpers.power == pytest.approx(fixed.power)


def test_a_driven_start_is_at_the_supply() -> None:
    board = rg.hardware.build_board(
        rg.read_scene("lesson"), boundary="neumann", drive="start", start=(0, 6), supply=5.0
    )
    assert board.voltages["n_0_6"] == 5.0 and board.voltages["goal_0"] == 0.0
    assert board.placement.headers[0].nets == ("n_0_6", "0")
    assert len(board.circuit.resistors) == 88


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"boundary": "neumann"}, "needs 56 current sources.*--drive start"),
        ({"kind": "jumpers", "boundary": "neumann", "drive": "start", "start": (0, 6)}, "--kind fixed"),
        ({"kind": "jumpers", "boundary": "wall", "wall_resistance": 1e4}, "--kind fixed"),
        ({"goal_voltage": 1.0}, "the goal rail of a board is its ground"),
        ({"pitch": 5.0}, r"pitch = 5 mm.*5.08 to 25.4 mm"),
        ({"kind": "jumpers", "pitch": 5.08}, "6.35 to 25.4 mm"),
        ({"resistance": 10.0, "supply": 5.0}, r"dissipate [\d.]+ W.*0603.*larger --resistance"),
        ({"kind": "both"}, "kind"),
        ({"tolerance": 0.0}, "tolerance"),
    ],
)
def test_a_board_that_cannot_be_made_is_refused_with_a_remedy(options: dict[str, object], words: str) -> None:
    with pytest.raises(rg.InputError, match=words):
        rg.hardware.build_board(rg.build_space(rg.read_scene("lesson")), **options)  # type: ignore[arg-type]


def test_spaces_that_have_no_board_are_refused_with_a_remedy() -> None:
    cells = np.zeros((5, 4), np.uint8)
    cells[2, 2] = 2
    ring = [rg.Axis("angle", 0.0, 5.0, 5, periodic=True), rg.Axis("y", 0.0, 4.0, 4)]
    with pytest.raises(rg.InputError, match=r"axis 'angle' is periodic.*periodic = false"):
        rg.hardware.build_board(rg.ConfigurationSpace(ring, cells))
    solid = np.zeros((3, 3, 3), np.uint8)
    solid[1, 1, 1] = 2
    axes = [rg.Axis(name, 0.0, 3.0, 3) for name in "xyz"]
    with pytest.raises(rg.InputError, match=r"3 axes.*2 axes"):
        rg.hardware.build_board(rg.ConfigurationSpace(axes, solid))
    with pytest.raises(rg.InputError, match=r"3 to 64 cells.*grid.cells"):
        rg.hardware.build_board(space_of(np.full((2, 9), 2, np.uint8)))
    uneven = rg.ConfigurationSpace(
        [rg.Axis("x", 0.0, 5.0, 5), rg.Axis("y", 0.0, 4.0, 4)], cells, conductivity=np.linspace(1, 2, 20).reshape(5, 4)
    )
    with pytest.raises(rg.InputError, match=r"other conductivity.*--kind fixed"):
        rg.hardware.build_board(uneven, kind="jumpers")
    board = rg.hardware.build_board(uneven)
    assert 0 < board.largest_deviation < 0.013
    many = np.zeros((5, 6), np.uint8)
    many[::2, 1] = 2
    with pytest.raises(rg.InputError, match="3 goal regions lie in row 1 only"):
        rg.hardware.build_board(space_of(many))


@pytest.mark.slow
def test_the_same_scene_gives_the_same_bytes() -> None:
    first, second = (board_files(rg.hardware.build_board(rg.read_scene("lesson"))) for _ in range(2))
    assert first == second
    assert all(text.endswith("\n") and "\r" not in text for text in first.values())
    assert not re.search(r"\b20[2-9]\d\b", first["README.md"])  # no date
    identities = first["grid.kicad_pcb"].count("(uuid ")
    assert len(set(first["grid.kicad_pcb"].split('(uuid "')[1:])) >= 0.99 * identities > 1000


def test_values_are_those_of_the_series() -> None:
    assert nearest_e96([9_761.0, 1.0, 99.9e3, 4.7e6, 919.5]).tolist() == [9760.0, 1.0, 100e3, 4.75e6, 909.0]
    assert [resistance_text(value) for value in (9760.0, 1e4, 1e6, 47.5)] == ["9.76k", "10k", "1M", "47.5"]


def test_s_expressions_quote_texts_and_not_words() -> None:
    assert format_tree(["at", 1.5, -0.0, 2]) == "(at 1.5 0 2)\n"
    assert format_tree(["a", Word("b"), 'c "d" \\', True]) == '(a b "c \\"d\\" \\\\" yes)\n'
    assert format_tree(["a", ["b", ["c", 1]], ["d", 2], ["e", 3], ["f", 4]]).count("\n") == 6
    assert number_text(0.1 + 0.2) == "0.3" and identity("a", 1) == identity("a", 1) != identity("a", 2)


@pytest.mark.slow
def test_the_folder_lists_parts_voltages_and_yield(tmp_path: Path) -> None:
    data = answer("board", "lesson", "--no-kicad", "-o", tmp_path / "class", "--tolerance", "5 %")
    folder = tmp_path / "class"
    assert json.loads((folder / "summary.json").read_text())["files"] == data["files"]
    present = {file.relative_to(folder).as_posix() for file in folder.rglob("*") if file.is_file()}
    assert present == set(data["files"])
    assert {"README.md", "expected_voltages.png", "grid.kicad_pro", "fp-lib-table"} <= present
    assert data["tolerance"] == 0.05 and data["kicad"] is None and 0.5 < data["yield"]["value"] < 1
    assert (
        data["width_mm"] < 100
        and data["resistors"] == 140
        and data["supply_current"] == pytest.approx(246.17e-6, rel=1e-4)
    )
    with (folder / "bill_of_materials.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert (rows[0]["references"], rows[0]["quantity"], rows[0]["tolerance"]) == ("R1-R140", "140", "5 %")
    with (folder / "expected_voltages.csv").open() as file:
        pads = {(row["column"], row["row"]): row for row in csv.DictReader(file)}
    assert len(pads) == 57 and float(pads["6", "1"]["volts"]) == 0 and pads["6", "1"]["cell"] == "goal"
    assert float(pads["6", "2"]["volts"]) == pytest.approx(0.573718, abs=1e-6)
    text = (folder / "README.md").read_text()
    assert "246.2 µA" in text and "| 6,2 | 0.574 V |" in text and max(map(len, text.splitlines())) < 140
    library = folder / "resgrid.pretty"
    assert {file.stem for file in library.iterdir()} >= {"R_0603_1608Metric_HandSolder", "PinHeader_1x04_P2.54mm"}


@pytest.mark.slow
def test_another_board_replaces_the_files_of_the_first_and_keeps_foreign_ones(tmp_path: Path) -> None:
    folder = tmp_path / "class"
    assert call("board", "lesson", "--no-kicad", "-o", folder, "-q").exit_code == 0
    (folder / "resgrid.pretty" / "mine.kicad_mod").write_text("mine")
    assert call("board", "lesson", "--kind", "jumpers", "--no-kicad", "-o", folder, "-q").exit_code == 0
    assert (folder / "jumper_plan.pdf").exists() and not (folder / "expected_voltages.pdf").exists()
    assert (folder / "resgrid.pretty" / "mine.kicad_mod").read_text() == "mine"
    assert (folder / "resgrid.pretty" / "SolderJumper_3_Open.kicad_mod").exists()
    assert not list(tmp_path.glob(".class-*"))


@pytest.mark.slow
def test_a_missing_kicad_is_reported_with_a_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RESGRID_KICAD_CLI", str(tmp_path / "nothing"))
    result = call("board", "lesson", "-o", tmp_path / "class")
    assert result.exit_code == 0 and "no Gerber files" in result.stderr and "RESGRID_KICAD_CLI" in result.stderr
    refused = call("board", "lesson", "--kicad", "-o", tmp_path / "other")
    assert refused.exit_code == 3 and not (tmp_path / "other").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["rooms"], "a board is one circuit"),
        (["ring"], "cells along each axis"),
        (["voxels"], "3 axes"),
        (["lesson", "--tolerance", "80 %"], "up to 50 %"),
        (["lesson", "--boundary", "neumann"], "--drive start"),
    ],
)
def test_a_scene_without_a_board_is_refused_and_writes_nothing(words: list[str], said: str, tmp_path: Path) -> None:
    result = call("board", *words, "--no-kicad", "-o", tmp_path / "class")
    assert result.exit_code == 2 and said in result.stderr and not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_board_has_pictures() -> None:
    board = rg.hardware.build_board(rg.read_scene("lesson"), kind="jumpers")
    letters = [text.get_text() for text in rg.draw(board).texts]
    assert letters.count("O") == 7 and letters.count("G") == 1
    for side in ("front", "back"):
        assert any(text.get_text() == "Eight by eight" for text in rg.draw(board, side=side).texts)
    with pytest.raises(rg.InputError, match="'plan' or 'front' or 'back'"):
        rg.draw(board, side="left")


@pytest.mark.slow
def test_kicad_writes_the_files_for_a_manufacturer(tmp_path: Path) -> None:
    """Needs kicad-cli, which `scripts/unpack_kicad.sh .venv-kicad` provides."""
    scene = 'schema = 1\ntitle = "Small"\nstarts = [[0.5, 0.5]]\n[grid]\naxes = [{ name = "x", lower = 0, upper = 5, '
    scene += 'cells = 5 }, { name = "y", lower = 0, upper = 4, cells = 4 }]\n[[goal]]\ncell = [3, 2]\n'
    (tmp_path / "small.toml").write_text(scene)
    data = answer("board", tmp_path / "small.toml", "--kicad", "-o", tmp_path / "small")
    folder = tmp_path / "small"
    assert data["kicad"].startswith("9.") and (folder / "schematic.pdf").read_bytes().startswith(b"%PDF")
    with zipfile.ZipFile(folder / "gerbers.zip") as archive:
        names = set(archive.namelist())
    assert {"grid-F_Cu.gtl", "grid-B_Cu.gbl", "grid-Edge_Cuts.gm1"} <= names and any(
        name.endswith(".drl") for name in names
    )
    for name in ("board_front.png", "board_back.png", "grid.d356", "positions.csv"):
        assert (folder / name).stat().st_size > 500
