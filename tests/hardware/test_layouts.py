"""Layouts: extraction by klayout gives back the drawn circuit, and every fault is detected and located.

Tests internals: `resgrid.hardware`, `resgrid.hardware.layout_check`, `resgrid.hardware.layout_files`,
`resgrid.hardware.layout_process`, `resgrid.hardware.layout_tiles`, `resgrid.hardware.record`,
`resgrid.hardware.tools`, `resgrid.processes`.
"""

from __future__ import annotations

import builtins
import json
import re
import shutil
from pathlib import Path
from typing import Any

import gdstk
import numpy as np
import pytest
from hardware.layout_mutations import GOAL, MUTATIONS, Mutation, Shapes
from support.cli import answer, call

import resgrid as rg
from resgrid.hardware import layout_check
from resgrid.hardware.layout_files import require_suffix
from resgrid.hardware.layout_process import layout_rules
from resgrid.hardware.layout_tiles import rectangles
from resgrid.hardware.record import read_record
from resgrid.hardware.tools import find_klayout
from resgrid.processes import process_names

RPPD, TOY = "ihp-sg13g2:rppd", "toy:poly"


@pytest.fixture(autouse=True, scope="module")
def one_klayout() -> Any:
    """Look for klayout once."""
    tool = find_klayout()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(layout_check, "find_klayout", lambda: tool)
        yield


def space_of(seed: int, shape: tuple[int, int], goals: int = 1, **options: Any) -> rg.ConfigurationSpace:
    """A random space with goal regions of several cells."""
    rng = np.random.default_rng(seed)
    cell = (rng.random(shape) < 0.15).astype(np.uint8)
    for i, j in rng.integers(0, np.array(shape) - 1, (goals, 2)).tolist():
        cell[i : i + 2, j : j + rng.integers(1, 3)] = rg.Cell.GOAL
    return rg.ConfigurationSpace.from_array(cell, **options)


COSTS = np.random.default_rng(5).uniform(0.3, 3.0, (5, 4))
CASES: dict[str, tuple[rg.ConfigurationSpace, dict[str, Any]]] = {
    "dirichlet": (space_of(1, (5, 5)), {}),
    "several goals": (space_of(2, (7, 6), 4), {"edge": "open"}),
    "costs": (space_of(3, (5, 4), conductivity=COSTS), {"resistance": 20e3}),
    "cells that are not square": (space_of(4, (4, 5), spacing=(1.0, 0.6)), {"edge": ("open", "obstacle")}),
    "wall": (space_of(5, (5, 5)), {"boundary": "wall", "wall_resistance": 3e3}),
    "start": (space_of(6, (6, 6)), {"boundary": "neumann", "drive": "start"}),
}


@pytest.mark.parametrize("process", process_names())
@pytest.mark.parametrize("case", CASES)
@pytest.mark.quick_cases(6)
def test_the_extracted_circuit_is_the_compiled_one(process: str, case: str, tmp_path: Path) -> None:
    space, options = CASES[case]
    if options.get("drive") == "start":
        options = options | {"start": np.argwhere(space.goal_connected & (space.cell == rg.Cell.FREE))[0]}
    layout = rg.hardware.build_layout(space, process, **options)
    ideal = rg.compile_space(space, **options)
    assert np.array_equal(layout.op.netlist.resistor_nodes, ideal.resistor_nodes)
    assert layout.op.netlist.conductance == pytest.approx(ideal.conductance, rel=2e-3)
    file = rg.save(layout, tmp_path / ("chip.oas" if case == "wall" else "chip.gds"))
    check = rg.hardware.check_layout(file)
    assert check.agrees and check.findings == () and check.nodes > 0
    assert check.max_relative_error is not None and check.max_relative_error <= 1e-12
    assert check.parts == len(ideal.conductance) + len(layout.rails.pads)


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, rg.hardware.Layout]:
    """A layout without faults."""
    cell = np.zeros((5, 4), dtype=np.uint8)
    cell[GOAL], cell[0, 3] = rg.Cell.GOAL, rg.Cell.OBSTACLE
    layout = rg.hardware.build_layout(rg.ConfigurationSpace.from_array(cell), RPPD)
    file = rg.save(layout, tmp_path_factory.mktemp("layout") / "good.gds")
    assert rg.hardware.check_layout(file).agrees
    return file, layout


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation.__name__)
@pytest.mark.quick_cases(8)
def test_a_fault_is_detected_at_its_place(
    mutation: Mutation, good: tuple[Path, rg.hardware.Layout], tmp_path: Path
) -> None:
    file, layout = good
    shapes = Shapes(file, layout)
    x, y = mutation(shapes)
    shapes.write(tmp_path / "bad.gds")
    shutil.copy(file.with_suffix(".record.json"), tmp_path / "bad.record.json")
    check = rg.hardware.check_layout(tmp_path / "bad.gds")
    assert check.agrees is False
    margin = np.multiply(shapes.pitch, 2)
    assert any(is_near(finding, (x, y), margin) for finding in check.findings), check.findings


def is_near(finding: str, place: tuple[float, float], margin: np.ndarray[Any, Any]) -> bool:
    """Whether a place lies in the box around the places that a finding states, enlarged by a margin."""
    places = np.array(re.findall(r"\((-?[\d.]+), (-?[\d.]+)\) um", finding), dtype=float)
    return bool(len(places) and np.all(places.min(0) - margin <= place) and np.all(place <= places.max(0) + margin))


def test_the_same_scene_gives_the_same_bytes(good: tuple[Path, rg.hardware.Layout], tmp_path: Path) -> None:
    _, layout = good
    again = rg.hardware.build_layout(layout.op.netlist.cells.space, RPPD)
    for suffix in (".gds", ".oas"):
        first, second = rg.save(layout, tmp_path / f"a{suffix}"), rg.save(again, tmp_path / f"b{suffix}")
        assert first.read_bytes() == second.read_bytes()
    records = [(tmp_path / f"{name}.record.json").read_text().replace("b.oas", "a.oas") for name in "ab"]
    assert records[0] == records[1]


def test_the_record_has_the_drawn_values(good: tuple[Path, rg.hardware.Layout]) -> None:
    file, layout = good
    record = read_record(file)
    rules, shape = layout_rules(RPPD), layout.resistors[0]
    straight = shape.area / shape.width - shape.corners * shape.width
    ohms = 260.0 * (straight / (shape.width + 6) + shape.corners / 1.85) + 2 * 35e-6 / (shape.width * 1e-9)
    values = {part.value for part in record.parts if part.type == "resistor"}
    assert list(values) == pytest.approx([ohms], rel=1e-12) and abs(ohms / 10e3 - 1) < 1e-3
    assert rules.resistance(shape.area, shape.width, shape.corners) == pytest.approx(ohms, rel=1e-12)
    assert {source.positive: source.volts for source in record.sources} == {"obstacle": 1.0, "goal_0": 0.0}


def test_arrays_are_placed_by_reference(tmp_path: Path) -> None:
    cell = np.zeros((64, 64), dtype=np.uint8)
    cell[40:44, 20:24] = rg.Cell.GOAL
    layout = rg.hardware.build_layout(rg.ConfigurationSpace.from_array(cell), TOY, labels=False)
    file = rg.save(layout, tmp_path / "chip.gds", record=False)
    assert file.stat().st_size < 20_000
    assert not (tmp_path / "chip.record.json").exists()
    top = next(cell for cell in gdstk.read_gds(str(file)).cells if cell.name == "resgrid")
    bodies = len(top.get_polygons(layer=2, datatype=0))
    assert bodies == len(layout.value)


@pytest.mark.parametrize("seed", range(4))
def test_rectangles_cover_a_mask_once(seed: int) -> None:
    mask = np.random.default_rng(seed).random((9, 13)) < 0.6
    count = np.zeros(mask.shape, dtype=int)
    for i, j, columns, rows in rectangles(mask):
        count[i : i + columns, j : j + rows] += 1
    assert np.array_equal(count, mask.astype(int))


def test_matching_determines_the_width() -> None:
    space = space_of(1, (4, 4))
    for wanted in (0.01, 0.002):
        shape = rg.hardware.build_layout(space, TOY, matching=wanted).resistors[0]
        assert 0.02e-6 / np.sqrt(shape.area * 1e-18) <= wanted * 1.001
    assert rg.hardware.build_layout(space, TOY, width=2e-6).resistors[0].width == 2000


def test_large_drops_of_rails_give_a_warning() -> None:
    space = space_of(1, (6, 6))
    layout = rg.hardware.build_layout(space, RPPD, resistance=800.0, supply=3.3)
    assert any("voltage drop" in text or "wide" in text for text in layout.warnings)
    assert rg.hardware.build_layout(space, RPPD).warnings == ()
    drops = rg.hardware.build_layout(space, RPPD, resistance=20e3).drops
    assert rg.hardware.build_layout(space, RPPD, resistance=10e3).drops["obstacle"] > drops["obstacle"] > 0


@pytest.mark.parametrize(
    ("space", "options", "words"),
    [
        (rg.ConfigurationSpace.from_array([2, 0, 0]), {}, "two axes"),
        (rg.ConfigurationSpace.from_array([[2, 0], [0, 0], [0, 1]], periodic=(True, False)), {}, "periodic"),
        (rg.ConfigurationSpace.from_array([[2, 0], [0, 1]]), {"boundary": "neumann"}, "drive = 'start'"),
        (rg.ConfigurationSpace.from_array([[2, 0], [0, 1]]), {"resistance": 10.0}, "resistance"),
        (rg.ConfigurationSpace.from_array([[2, 0], [0, 1]]), {"width": 1e-7}, "smallest width"),
        (rg.ConfigurationSpace.from_array([[2, 0], [0, 1]]), {"width": 1e-6, "matching": 0.01}, "one of them"),
        (rg.ConfigurationSpace.from_array([[2, 0], [0, 1]]), {"matching": 2.0}, "between 0 and 1"),
        (rg.ConfigurationSpace.from_array([[2, 0], [0, 1]]), {"width": 1e3}, "exceeds 0.01 m"),
        (rg.ConfigurationSpace.from_array([[2, 0], [0, 1]]), {"matching": 1e-300}, "choose a larger matching"),
    ],
)
def test_arrays_that_cannot_be_drawn_are_rejected_with_a_remedy(
    space: rg.ConfigurationSpace, options: dict[str, Any], words: str
) -> None:
    with pytest.raises(rg.InputError, match=re.escape(words)):
        rg.hardware.build_layout(space, RPPD, **options)


def test_unknown_processes_and_suffixes_are_rejected(tmp_path: Path) -> None:
    space = rg.ConfigurationSpace.from_array([[2, 0], [0, 1]])
    with pytest.raises(rg.InputError, match="ihp-sg13g2:rppd"):
        rg.hardware.build_layout(space, "ihp-sg13g2:rpd")
    with pytest.raises(rg.InputError, match=r"\.gds"):
        require_suffix(tmp_path / "chip.png")


def test_absent_and_damaged_layouts_give_one_message(good: tuple[Path, rg.hardware.Layout], tmp_path: Path) -> None:
    file = tmp_path / "chip.gds"
    shutil.copy(good[0].with_suffix(".record.json"), tmp_path / "chip.record.json")
    with pytest.raises(rg.InputError, match=r"chip\.gds: there is no such file"):
        rg.hardware.check_layout(file)
    file.write_text("junk")
    with pytest.raises(rg.InputError, match=r"unknown format.*; write the layout again") as caught:
        rg.hardware.check_layout(file)
    assert "Traceback" not in str(caught.value)


def test_without_gdstk_the_install_command_is_printed(
    good: tuple[Path, rg.hardware.Layout], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    imported = builtins.__import__

    def without(name: str, *arguments: Any, **options: Any) -> Any:
        if name == "gdstk":
            raise ImportError(name)
        return imported(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(rg.ToolMissingError, match="pip install"):
        rg.save(good[1], tmp_path / "chip.gds")
    assert list(tmp_path.iterdir()) == []


def test_without_klayout_a_layout_is_not_verified(
    good: tuple[Path, rg.hardware.Layout], monkeypatch: pytest.MonkeyPatch
) -> None:
    def absent() -> None:
        raise rg.ToolMissingError("klayout is not installed")

    monkeypatch.setattr(layout_check, "find_klayout", absent)
    check = rg.hardware.check_layout(good[0])
    assert check.agrees is None and not check.verified and "klayout" in check.remark


def test_the_command_writes_a_layout_that_check_confirms(tmp_path: Path) -> None:
    file = tmp_path / "lesson.gds"
    data = answer("layout", "lesson", "--process", TOY, "-o", file)
    assert data["resistors"] == 140 and data["cells"] == [8, 8] and data["bytes"] == file.stat().st_size
    assert json.loads((tmp_path / "lesson.record.json").read_text())["process"] == TOY
    assert answer("check", file)["agrees"] is True
    result = call("layout", "lesson", "--process", TOY, "--matching", "0.005", "-o", file)
    assert result.exit_code == 0 and "8 x 8 cells" in result.stdout
    words = ["--set", f"chip.process={RPPD}", "--set", "chip.width=1u", "--set", "chip.readout.bits=8"]
    result = call("layout", "lesson", *words, "-o", file)
    assert result.exit_code == 0 and "1 um wide" in result.stdout
    assert "chip.process" not in result.stderr and "ignored: chip.readout" in result.stderr
    for words in (["--process", TOY, "-o", "-"], ["--process", TOY, "-o", "chip.png"], ["-o", file]):
        assert call("layout", "lesson", *words).exit_code == 2


def test_pictures_show_the_block_and_a_tile(good: tuple[Path, rg.hardware.Layout]) -> None:
    figure = rg.draw(good[1])
    block, tile = figure.axes
    assert "45 resistors" in block.get_title() and "one tile" in tile.get_title()
    assert len(tile.collections) >= 7
    assert {text.get_text() for text in block.texts} >= {"obstacle", "goal 0"}
