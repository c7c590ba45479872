"""Overrides of scene keys: independent of their order, checked together, contradictions reported.

Tests internals: `resgrid.scene.overrides`, `resgrid.scene.reading`.
"""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from PIL import Image
from support.cli import answer, call

import resgrid as rg
from resgrid.scene.overrides import apply_overrides, build_changed, document_of
from resgrid.scene.reading import parse_document, read_document

ROOM = """schema = 1
starts = [[0.5, 0.5]]
goal = [{ point = [7.5, 7.5] }]
chip = { resistance = 1e4 }
[grid]
axes = [
  { name = "x", lower = 0, upper = 8, spacing = 1 },
  { name = "y", lower = 0, upper = 8, cells = 8 },
]
[[obstacle]]
shape = "circle"
center = [4, 4]
radius = 1.0
"""
PLATE = "[[-0.4, -0.2], [0.4, -0.2], [0.4, 0.2], [-0.4, 0.2]]"
SETS = (
    ("--set", "grid.cells=16"),
    ("--set", "grid.axes.1.cells=12"),
    ("--set", "grid.axes.0.upper=9"),
    ("--set", "obstacle[0].radius=0.5"),
    ("--set", "chip={resistance=2e4}"),
    ("--set", "chip.supply=3"),
    ("--set", "sampling=centre"),
    ("--start=10,10",),
    ("--start=1,11",),
    ("--goal=11,1",),
    ("--cells",),
    ("--robot-radius=0.2",),
    ("--boundary=wall",),
    ("--set", "chip.wall_resistance=33k"),
    ("--k=0.5",),
    ("--edge=open,obstacle",),
)
"""Consistent options for `ROOM`; cells beyond 8 need a finer grid."""
ON_MAP = (
    ("--set", f"robot.footprint={PLATE}"),
    ("--start=-3.3,-1.7,1.57",),
    ("--goal=1.2,3.8",),
    ("--set", "map.headings=8"),
    ("--set", "sampling=centre"),
    ("--set", "map.spacing=0.5"),
    ("--format=image",),
    ("--origin=-7,-5",),
    ("--threshold=100",),
    ("--boundary=neumann",),
    ("--k=1",),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scene file and an image of a map."""
    folder = tmp_path_factory.mktemp("overrides")
    (folder / "room.toml").write_text(ROOM.replace("center", "centre"))
    rows = np.full((20, 28), 254, dtype=np.uint8)
    rows[5:15, 12:14] = 0
    Image.fromarray(rows).save(folder / "room.png")
    return folder


def described(file: Path, options: tuple[tuple[str, ...], ...], subcommand: str = "info") -> dict[str, Any]:
    """Return the description of a scene under options."""
    result = answer(subcommand, file, *(word for option in options for word in option))
    return {key: value for key, value in result.items() if key != "seconds"}


@pytest.mark.parametrize(("name", "options"), [("room.toml", SETS), ("room.png", ON_MAP)])
def test_options_in_any_order_describe_the_same_scene(
    name: str, options: tuple[tuple[str, ...], ...], folder: Path
) -> None:
    expected = described(folder / name, options)
    assert expected["shape"] == ([16, 12] if name == "room.toml" else [28, 20, 8])
    for seed in range(12):
        mixed = random.Random(seed).sample(options, len(options))
        same_starts = [option for option in options if option[0].startswith("--start")]
        mixed = [same_starts.pop(0) if option[0].startswith("--start") else option for option in mixed]
        assert described(folder / name, tuple(mixed)) == expected


CHANGES: dict[str, Any] = {
    "grid.cells": "16",
    "grid.axes.1.cells": 12,
    "grid.axes[0].upper": 9,
    "obstacle.0.radius": 0.5,
    "chip": {"resistance": 2e4},
    "supply": 3,
    "start_cell": [(10, 10)],
    "start": [(1, 1)],
    "goal_cell": [(11, 1)],
    "robot.radius": 0.2,
    "boundary": "wall",
    "chip.wall_resistance": "33k",
    "edge": "open, obstacle",
    "k": [0.5],
}


@given(st.permutations(list(CHANGES)), st.integers(1, len(CHANGES)))
def test_overrides_in_any_order_give_the_same_scene_or_error(keys: list[str], count: int) -> None:
    text = ROOM.replace("center", "centre")
    chosen = keys[:count]

    def outcome(names: list[str], *, of_scene: bool) -> Any:
        changes = {name: CHANGES[name] for name in names}
        document = parse_document(text, "room.toml")
        try:
            if of_scene:
                return document_of(apply_overrides(build_changed(document, {}), changes))
            return document_of(build_changed(document, changes))
        except rg.InputError as error:
            return str(error)

    for of_scene in (False, True):
        assert outcome(chosen, of_scene=of_scene) == outcome(sorted(chosen), of_scene=of_scene)


@pytest.mark.parametrize("subcommand", ["info", "path", "plot", "compile", "solve", "control", "convert"])
def test_a_footprint_and_a_start_with_a_heading_are_checked_together(
    subcommand: str, folder: Path, tmp_path: Path
) -> None:
    """The new robot needs starts of three coordinates, which the old one would reject."""
    output = {"plot": "page.png", "convert": "room.cir", "control": "run.csv"}.get(subcommand)
    words = [
        subcommand, folder / "room.png", "--spacing=0.5", "--origin=-7,-5", "--set", "map.headings=8", "--goal=1.2,3.8",
        "--set", f"robot.footprint={PLATE}", "--set", "sampling=centre", "--start=-3.3,-1.7,1.57",
    ]  # fmt: skip
    result = call(*words, *(["-o", tmp_path / output] if output else []))
    assert result.exit_code == 0, result.stderr


@pytest.mark.parametrize("subcommand", ["info", "path", "solve"])
def test_cell_options_refer_to_the_overridden_grid(subcommand: str, lesson: Path) -> None:
    result = call(subcommand, lesson, "--set", "grid.cells=16", "--start=1,13", "--cells")
    assert result.exit_code == 0, result.stderr


@pytest.fixture
def lesson(scenes: Path) -> Path:
    return scenes / "lesson.toml"


@pytest.mark.parametrize(
    ("options", "names"),
    [
        (("--set", "chip.supply=3", "--set", "chip.supply=5"), "chip.supply"),
        (("--set", "supply=3", "--set", "chip.supply=5"), "chip.supply"),
        (("--set", "obstacle[0].lower=[1, 2]", "--set", "obstacle.0.lower=[1, 3]"), "obstacle.0.lower"),
        (("--k", "0.5", "--set", "k=0.3"), "k"),
        (("--boundary", "wall", "--set", "boundary=neumann"), "boundary"),
        (("--robot-radius", "0.1", "--set", "radius=0.2"), "robot.radius"),
    ],
)
def test_contradictory_options_exit_with_2(options: tuple[str, ...], names: str, lesson: Path) -> None:
    result = call("info", lesson, *options)
    assert result.exit_code == 2
    assert names in result.stderr and "leave one of them out" in result.stderr


def test_spacing_and_number_of_cells_exclude_each_other(lesson: Path) -> None:
    result = call("info", lesson, "--set", "grid.axes.0.cells=16", "--set", "grid.axes.0.spacing=0.5")
    assert result.exit_code == 2 and "not both" in result.stderr


def test_errors_have_line_numbers_only_for_keys_of_the_file(tmp_path: Path) -> None:
    file = tmp_path / "wrong.toml"
    file.write_text(ROOM)  # 'center' is unknown
    with pytest.raises(rg.InputError) as caught:
        build_changed(read_document(file, {}), {"start": [(1, 2, 3)], "k": 2})
    places = [line.strip().rpartition(": ")[0] for line in str(caught.value).splitlines()[1:]]
    assert places == ["k", "start[0].point", "line 10: obstacle[0].centre", "line 12: obstacle[0].center"]


def test_build_changed_does_not_modify_the_document(scenes: Path) -> None:
    document = read_document(scenes / "lesson.toml", {})
    assert document_of(build_changed(document, {})) == document_of(rg.read_scene(scenes / "lesson.toml"))
    raw = parse_document((scenes / "lesson.toml").read_text(), "lesson").raw
    build_changed(document, {"grid.cells": 16})
    assert document.raw == raw, "a change must not write into the document that was read"
