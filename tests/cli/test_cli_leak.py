"""The key ``leak`` of scenes: the option, every subcommand, pictures, the live page, and moving robots.

Tests internals: `resgrid.control.relaxation`, `resgrid.live_page`, `resgrid.plot.circuits`, `resgrid.scene.overrides`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.cli import ROOM as WALLED, answer, call
from support.spaces import space_of

import resgrid as rg
from resgrid.control.relaxation import Relaxation, RelaxingGrid
from resgrid.live_page.drawing import drawing_of, is_same_circuit
from resgrid.live_page.messages import DrawingHead, read_drawing, write_drawing
from resgrid.live_page.settle import settle
from resgrid.live_page.solving import solve_drawing
from resgrid.plot.circuits import rail_areas
from resgrid.scene.overrides import apply_overrides, document_of

ROOM = WALLED.replace("[5.5, 4.5]", "[2.5, 4.5]")
"""A room in which all starts have a path."""


@pytest.fixture
def room(tmp_path: Path) -> Path:
    file = tmp_path / "room.toml"
    file.write_text("leak = 0.2\n" + ROOM)
    return file


def test_the_scene_key_has_a_unit_and_engineering_values(room: Path) -> None:
    scene = rg.read_scene(room)
    assert scene.leak == 0.2
    assert rg.scene_schema()["properties"]["leak"]["unit"] == "1/m^2"
    assert apply_overrides(scene, {"leak": "2k"}).leak == 2000.0
    assert rg.plan(scene).field.wiring.leak == 0.2
    assert rg.plan(scene, leak=0.5).field.wiring.leak == 0.5
    assert apply_overrides(scene, {}).leak == document_of(scene)["leak"] == 0.2
    with pytest.raises(rg.InputError, match="must be a finite number at least 0"):
        scene.replace(leak=-1.0)


def test_the_option_equals_the_key_and_the_library(room: Path, tmp_path: Path) -> None:
    plain = tmp_path / "plain.toml"
    plain.write_text(ROOM)
    lengths = [
        [path["length"] for path in answer("path", *words, "--json")["paths"]]
        for words in ((room,), (plain, "--leak", "0.2"), (plain, "--set", "leak=200m"), (room, "--leak", "0.2"))
    ]
    expected = [path.length for path in rg.plan(rg.read_scene(plain), leak=0.2).paths()]
    assert all(row == expected for row in lengths)
    assert answer("path", plain, "--json")["paths"][0]["length"] != expected[0]
    described = answer("info", room, "--json")
    assert described["leak"] == 0.2
    assert "leak 0.2" in call("info", room).output


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
def test_decks_with_a_leak_pass_the_check(room: Path, tmp_path: Path, boundary: str) -> None:
    deck = tmp_path / "room.cir"
    assert call("compile", room, "--boundary", boundary, "-o", deck).exit_code == 0
    assert deck.read_text().splitlines()[0] == f"* Room, {boundary}, leak 0.2"
    assert answer("check", deck, "--json")["agrees"] is True


def test_contradictions_end_with_exit_code_2_and_a_remedy(room: Path, tmp_path: Path) -> None:
    for words, part in (
        (("path", room, "--boundary", "neumann", "--drive", "uniform"), "remove drive, or set leak = 0"),
        (("path", room, "--boundary", "neumann", "--drive", "start"), "remove drive, or set leak = 0"),
        (("path", room, "--leak", "-2"), "leak: must be at least 0"),
        (("path", room, "--leak", "much"), "is not a number"),
        (("compile", room, "--form", "cells", "-o", tmp_path / "c.cir"), "a tile has no leak resistor"),
        (("board", room, "-o", tmp_path / "board"), "a board has no place"),
        (("layout", room, "--process", "toy:poly", "-o", tmp_path / "a.gds"), "a layout does not draw"),
    ):
        result = call(*words)
        assert result.exit_code == 2
        assert part in result.output
    assert not list(tmp_path.glob("c.cir*")) + list(tmp_path.glob("*.gds"))


@pytest.mark.slow
def test_a_run_with_open_obstacles_and_a_leak_has_a_logarithmic_drop(room: Path, tmp_path: Path) -> None:
    assert call("run", room, "--boundary", "neumann", "-o", tmp_path / "out").exit_code == 0
    with np.load(tmp_path / "out" / "neumann.npz") as saved:
        field = rg.plan(rg.read_scene(room), boundary="neumann").field
        assert field.log_drop is not None
        np.testing.assert_array_equal(saved["log_drop"], field.log_drop)
    assert answer("control", room, "-o", tmp_path / "run.csv", "--json")["runs"]


def test_the_diagram_draws_one_arrow_for_each_leak_and_no_rail_around_open_obstacles() -> None:
    space = space_of([[0, 0, 0], [0, 1, 0], [0, 0, 1], [0, 2, 0]])
    for boundary, around in (("dirichlet", True), ("neumann", False)):
        netlist = rg.compile_space(space, boundary=boundary, leak=0.5)
        axes = rg.draw(netlist, op=rg.solve(netlist))
        arrows = [text for text in axes.texts if getattr(text, "arrow_patch", None) is not None]
        assert len(arrows) == len(netlist.cells.free_node)
        labels = [text.get_text() for text in axes.get_legend().get_texts()]
        assert "leak from the obstacle rail, 20 kΩ" in labels
        assert not any("not drawn" in label for label in labels)
        assert rail_areas(netlist.cells)[0].is_empty is not around
        rg.draw(rg.field(rg.solve(netlist)))


def test_the_live_page_keeps_the_leak(room: Path) -> None:
    for boundary in ("dirichlet", "neumann"):
        scene = rg.read_scene(room).replace(boundary=boundary)
        drawing = drawing_of(scene)
        head, body = write_drawing(drawing)
        back = read_drawing(DrawingHead.model_validate(head["drawing"]), body)
        assert back.leak == drawing.leak == drawing.scene().leak == 0.2
        assert is_same_circuit(drawing, back)
        assert not is_same_circuit(drawing, drawing_of(scene.replace(leak=0.3)))
        field = solve_drawing(drawing, exact=True).field
        np.testing.assert_allclose(field.potential, rg.plan(scene).field.potential, rtol=0, atol=1e-9)
        times = settle(drawing, None)[0]["times"]
        assert len(times) > 3


@pytest.mark.parametrize("method", ["jacobi", "sor", "chip"])
@pytest.mark.parametrize("options", [{}, {"boundary": "neumann"}, {"k": 0.5}])
@pytest.mark.quick_cases(3)
def test_a_settling_grid_ends_at_the_field_with_the_leak(method: str, options: dict[str, object]) -> None:
    cell = np.zeros((9, 8), dtype=np.uint8)
    cell[7, 6] = rg.Cell.GOAL
    space = space_of(cell)
    cell[4, 2:] = rg.Cell.OBSTACLE
    before = rg.plan(space, leak=0.1, **options).field
    grid = RelaxingGrid(Relaxation(method=method), before)
    np.testing.assert_allclose(grid.field.potential, before.potential, rtol=0, atol=1e-9)
    grid.change(space_of(cell))
    for _ in range(400):
        grid.advance(1.0)
    assert grid.settled
    after = rg.plan(space_of(cell), leak=0.1, **options).field
    np.testing.assert_allclose(grid.field.potential, after.potential, rtol=0, atol=1e-5)
