"""Scene files: values and messages compared with literals, for every kind of error with line, key and remedy.

Tests internals: `resgrid.scene.overrides`.
"""

import json
import os

import numpy as np
import pytest

import resgrid as rg
from resgrid.scene.overrides import apply_overrides

GRID = """
schema = 1
grid.axes = [
  { name = "x", lower = 0, upper = 4, cells = 4 },
  { name = "y", lower = 0, upper = 3, spacing = 1 },
]
"""
GOAL = "[[goal]]\npoint = [3.5, 0.5]\n"


def message(text, **options):
    with pytest.raises(rg.InputError) as caught:
        scene = rg.parse_scene(text, "s.toml")
        rg.build_space(scene)
    return str(caught.value)


def test_all_errors_of_a_scene_are_reported_with_line_key_and_remedy():
    text = """schema = 1
boundry = "wall"
boundary = "dirichlett"
[robot]
radius = -1
[grid]
edge = "open"
axes = [
  { name = "x", lower = 0, upper = 8, cells = 8.5 },
  { name = "x", lower = 3, upper = 2, cells = 4 },
]
[[obstacle]]
shape = "circl"
[[obstacle]]
shape = "circle"
center = [1, nan]
radius = "3"
[[obstacle]]
shape = "rectangle"
lower = [0, 0, 0]
upper = [1, inf]
[[goal]]
point = [1, 2, 3]
[chip]
resistance = "10kohm"
"""
    found = message(text)
    for expected in (
        "line 2: boundry: unknown key; did you mean 'boundary'?",
        "line 3: boundary: 'dirichlett' is unknown: it may be dirichlet or neumann or wall; did you mean 'dirichlet'?",
        "line 5: robot.radius: must be at least 0, got -1",
        "line 7: grid.edge: this key belongs at the top level",
        "line 9: grid.axes[0].cells: must be a whole number",
        "line 10: grid.axes[1].name: another axis is called 'x'",
        "line 10: grid.axes[1]: axis 'x': lower = 3.0 must lie below upper = 2.0",
        "line 12: obstacle[0]: shape = 'circl' is unknown",
        "line 14: obstacle[1].centre: this key is missing",
        "line 16: obstacle[1].center: unknown key; did you mean 'centre'?",
        "line 17: obstacle[1].radius: must be a number, got '3'",
        "line 20: obstacle[2].lower: needs at most 2 entries, got 3",
        "line 21: obstacle[2].upper[1]: must be a finite number, got inf",
        "line 23: goal[0].point: needs 2 coordinates, one for each axis, got 3",
        "line 25: chip.resistance: '10kohm' is not a number",
    ):
        assert expected in found, expected
    assert found.startswith("s.toml: 15 errors\n")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("schema = 1\nx = [1,", "line 2, column"),
        ("schema = 1", "a scene needs a [grid] with axes, or a [map]"),
        (GRID.replace("schema = 1", ""), "schema: this key is missing"),
        (GRID.replace("schema = 1", "schema = 2"), "schema: 2 is unknown: it may be 1"),
        (GRID.replace("schema = 1", 'schema = "1"'), "schema: must be the number 1, without quotes, got '1'"),
        ("schema = 1\n[grid]\naxes = 3", "line 3: grid.axes: must be a list, such as [1, 2], got 3"),
        (GRID + '[map]\nfile = "a.png"', "either a [grid] or a [map]"),
        ('boundary = "wall"' + GRID + GOAL, "needs wall_resistance in [chip]"),
        ('drive = "uniform"' + GRID + GOAL, "remove drive"),
        ('drive = "start"\nboundary = "neumann"' + GRID + GOAL, "add starts"),
        ('edge = ["open", "open", "open"]' + GRID + GOAL, "one entry for each of the 2 axes"),
        ('edge = "periodic"' + GRID + GOAL, "set periodic = true"),
        ("k = 1.5" + GRID + GOAL, "line 1: k: must be at most 1, got 1.5"),
        ("k = nan" + GRID + GOAL, "must be a finite number"),
        (GRID.replace("cells = 4", "cells = 4, spacing = 1") + GOAL, "give either cells or spacing, not both"),
        (GRID.replace("spacing = 1", "spacing = 0.7") + GOAL, "does not divide"),
        (GRID.replace("cells = 4", "cells = 0") + GOAL, "must be at least 1"),
        (GRID.replace("upper = 4", f"upper = {10**400}") + GOAL, "grid.axes[0].upper"),
        (GRID, "there is no goal"),
        (GRID + "[[goal]]\npoint = [9, 0.5]", "goal[0]: the point [9.0, 0.5] lies outside the grid"),
        (GRID + "[[goal]]\ncell = [4, 0]", "goal[0]: cell [4, 0] is not in the grid of 4 x 3 cells"),
        (GRID + '[[goal]]\nshape = "circle"\ncentre = [9, 9]\nradius = 1', "goal[0]: this goal lies outside"),
        (
            GRID + GOAL + '[[obstacle]]\nshape="box"\nlower=[3, 0]\nupper=[4, 2]',
            "goal[0]: the point [3.5, 0.5] lies in an",
        ),
        (
            GRID
            + '[[goal]]\nshape="circle"\ncentre=[3, 1]\nradius=1\n[[obstacle]]\nshape="sphere"\ncentre=[2,1]\nradius=9',
            "goal[0]: this goal lies inside an obstacle",
        ),
        ("starts = [[1, 1], [1, -1]]" + GRID + GOAL, "starts[1]: the point [1.0, -1.0] lies outside"),
        (GRID + GOAL + "[[start]]\ncell = [0, 3]", "start[0]: cell [0, 3] is not in the grid"),
        (GRID + GOAL + "[[start]]\n", "a start needs point"),
        (GRID + "goal = [5, 0]\n", "goal[1]: must be a table, such as { point = [...] }"),
        (GRID + "[goal]\npoint = [1, 1]\n", "goal: must be a list of tables: write [[goal]], or put [ ] around"),
        (GRID + "[[goal]]\nshape = 3", "goal[0]"),
        (GRID + '[[goal]]\nshape = "point"\nat = [1, 2]', "shape = 'point' is not a shape but a key of a place; write"),
        (GRID + '[[goal]]\nshape = "point"\npoint = [1, 2]', "is not a shape but a key of a place; remove this key"),
        (GRID + "[[goal]]\npoints = [1, 2]", "'points' is unknown; did you mean 'point'?"),
        (GRID + "[[start]]\ncells = [1, 2]", "'cells' is unknown; did you mean 'cell'?"),
        (
            GRID + "[[goal]]\npoint = [1, 2]\nradius = 1",
            "goal[0].radius: unknown key of a point; the keys are",
        ),
        (
            GRID + "[[goal]]\npoint = [1, 2]\ncell = [1, 1]",
            "goal[0].cell: unknown key of a point; the keys are",
        ),
        (
            GRID + '[[obstacle]]\nshape="rectangle"\nlower=[0,0]\nupper=[1,1]\nradius=1',
            "obstacle[0].radius: unknown key of a rectangle; the keys are shape, lower, upper",
        ),
        (GRID + '[robot]\ntype = "arm"\nradius = 1\nlinks = [{ length = 1 }, { length = 1 }]', "unknown key of an arm"),
        (GRID + "goal = 3", "goal"),
        ('schema = 1\n[map]\nfile = "a\\u0000b.png"', "cannot be read (embedded null byte)"),
        (GRID.replace('name = "x", ', "") + GOAL, "grid.axes[0].name: this key is missing"),
        ("deep = " + "[" * 5000 + "]" * 5000, "this TOML cannot be read"),
        (GRID.replace("lower = 0, upper = 4", "lower = -1e308, upper = 1e308") + GOAL, "must be at most 1e+60"),
        (GRID.replace("lower = 0, upper = 4", "lower = 1e17, upper = 1.00001e17, cells_ = 1"), "unknown key"),
        (GRID.replace("lower = 0, upper = 4", "lower = 1e15, upper = 1000000000000004"), "too narrow"),
        (GRID + GOAL + '[[obstacle]]\nshape="sphere"\ncentre=[0, 0]\nradius=1e200', "radius: must be at most 1e+60"),
        (GRID + "[chip]\nsupply = 0", "supply = 0 drives no current"),
        (GRID + '[[obstacle]]\nshape="rectangle"\nlower=[1,1]\nupper=[0,2]', "lower <= upper"),
    ],
)
def test_each_error_has_its_message(text, expected):
    assert expected in message(text)


def test_plane_shapes_need_two_axes():
    text = GRID.replace("]\n", '  { name = "z", lower = 0, upper = 1, cells = 1 },\n]\n')
    assert "use sphere instead" in message(text + '[[obstacle]]\nshape="circle"\ncentre=[1,1]\nradius=1')
    ring = GRID.replace("cells = 4", "cells = 4, periodic = true")
    assert "0 along a periodic axis" in message(ring + '[[obstacle]]\nshape="half_plane"\nnormal=[1, 0]\noffset=1')


def test_huge_grids_raise_budget_error_before_allocation():
    scene = rg.parse_scene(GRID.replace("cells = 4", "cells = 1_000_000_000_000") + GOAL)
    with pytest.raises(rg.BudgetError, match=r"3e\+12 cells needs about 4.47e\+04 GiB"):
        rg.build_space(scene)


def test_unreadable_files_raise_input_error(tmp_path):
    with pytest.raises(rg.InputError, match="there is no such file"):
        rg.read_scene(tmp_path / "absent.toml")
    with pytest.raises(rg.InputError, match="is a directory"):
        rg.read_scene(tmp_path)
    folder = tmp_path / "folder.toml"
    folder.mkdir()
    with pytest.raises(rg.InputError, match="is a directory"):
        rg.read_scene(folder)
    latin = tmp_path / "latin.toml"
    latin.write_bytes(b"schema = 1\ntitle = '\xe9'\n")
    with pytest.raises(rg.InputError, match="line 2: this is not UTF-8"):
        rg.read_scene(latin)
    with pytest.raises(rg.InputError, match="not a map of a known format"):
        rg.read_scene(_written(tmp_path / "x.dat", b"hello"))
    with pytest.raises(rg.InputError, match="cannot be read"):
        rg.read_scene("a\0b.toml")
    with pytest.raises(rg.InputError, match="device"):
        rg.read_scene("/dev/zero", format="image")


def test_only_the_first_bytes_of_an_unknown_file_are_read(tmp_path):
    file = tmp_path / "huge.unknown"
    with file.open("wb") as opened:
        opened.truncate(1 << 40)
    with pytest.raises(rg.InputError, match="not a map of a known format"):
        rg.read_scene(file)
    if os.geteuid() != 0:
        secret = _written(tmp_path / "secret.toml", b"schema = 1")
        secret.chmod(0)
        with pytest.raises(rg.InputError, match="permission denied"):
            rg.read_scene(secret)


def _written(path, data):
    path.write_bytes(data)
    return path


def test_goal_cells_are_the_cells_a_goal_overlaps():
    big = rg.build_space(rg.parse_scene(GRID + '[[goal]]\nshape="rectangle"\nlower=[0.4, 0.4]\nupper=[2.6, 1.0]'))
    assert np.argwhere(big.cell == 2).tolist() == [[0, 0], [1, 0], [2, 0]]
    small = rg.build_space(rg.parse_scene(GRID + '[[goal]]\nshape="circle"\ncentre=[1.9, 1.9]\nradius=0.2'))
    assert np.argwhere(small.cell == 2).tolist() == [[1, 1], [1, 2], [2, 1], [2, 2]]
    part = rg.build_space(rg.parse_scene(GRID + '[[goal]]\nshape="rectangle"\nlower=[0, 0]\nupper=[2, 1]\n'
                              '[[obstacle]]\nshape="rectangle"\nlower=[0, 0]\nupper=[1, 1]'))  # fmt: skip
    assert np.argwhere(part.cell == 2).tolist() == [[1, 0]]


def test_areas_set_the_conductivity_of_cells():
    space = rg.build_space(
        rg.parse_scene(GRID + GOAL + '[[area]]\nshape="rectangle"\nlower=[0, 0]\nupper=[2, 3]\nconductivity=0.1')
    )
    assert space.conductivity[:, 0].tolist() == [0.1, 0.1, 1, 1]
    assert rg.build_space(rg.parse_scene(GRID + GOAL)).conductivity is None


def test_overrides_are_converted_and_checked_like_file_keys():
    scene = rg.parse_scene(GRID + GOAL)
    changed = apply_overrides(
        scene,
        {"resistance": "4k7", "boundary": "neumann", "goal": "0.5,0.5", "start": [(1, 1), (2, 2)], "k": "0,0.5"}
        | {"robot.radius": "0.1", "grid.axes[0].cells": "8", "edge": "open"},
    )
    assert changed.chip.resistance == 4700
    assert (changed.boundary, changed.edge, changed.k) == ("neumann", ("open", "open"), (0, 0.5))
    assert changed.starts == ((1, 1), (2, 2))
    assert changed.robot.radius == 0.1
    assert rg.build_space(changed).cell[1, 0] == 2
    assert rg.build_space(apply_overrides(scene, {"goal_cell": (0, 2)})).cell[0, 2] == 2
    assert apply_overrides(scene, {"start_cell": "[[0, 2]]"}).starts == ((0.5, 2.5),)
    assert apply_overrides(scene, {"edge": "open, obstacle"}).edge == ("open", "obstacle")
    spaced = apply_overrides(scene, {"grid.axes.0.spacing": 0.5})
    assert spaced.axes[0].cells == 8
    for changes, expected in (
        ({"boundry": "wall"}, "did you mean 'boundary'"),
        ({"boundary": "wal"}, "did you mean 'wall'"),
        ({"chip.resistance": "10ohm"}, "chip.resistance"),
        ({"obstacle[3].radius": 1}, "there is no entry '3'"),
        ({"title.x": 1}, "not a table or list"),
        ({"grid.axes": "1,2", "grid.cells": "4"}, "grid.axes[0]: must be a table of keys, got 1"),
        ({"grid.axes": "2026-01-01", "grid.cells": "4"}, "grid.axes: must be a list"),
        ({"goal": "1,2,3"}, "needs 2 coordinates"),
        ({"goal": "nowhere"}, "must be a list"),
        ({"start": (float("nan"), 1)}, "must be a finite number"),
    ):
        with pytest.raises(rg.InputError, match=r"\w") as caught:
            apply_overrides(scene, changes)
        assert expected in str(caught.value)


def test_replace_checks_values_and_keeps_the_original():
    scene = rg.parse_scene(GRID + GOAL)
    assert scene.replace(boundary="neumann", starts=((1.0, 1.0),)).boundary == "neumann"
    assert scene.boundary == "dirichlet"
    with pytest.raises(rg.InputError, match="did you mean 'boundary'"):
        scene.replace(boundry="wall")
    with pytest.raises(rg.InputError, match="boundary"):
        scene.replace(boundary="nonsense")


def test_the_scene_schema_is_json_and_contains_every_key():
    schema = json.loads(json.dumps(rg.scene_schema()))
    assert {"schema", "title", "grid", "map", "obstacle", "goal", "chip", "k", "edge"} <= set(schema["properties"])
    assert schema["required"] == ["schema"]
    assert schema["additionalProperties"] is False


@pytest.mark.parametrize("name", ["lesson", "rooms", "voxels", "ring"])
def test_shipped_scenes_have_a_path_from_every_start(scenes, name):
    scene = rg.read_scene(scenes / f"{name}.toml")
    space = rg.build_space(scene)
    assert scene.title
    assert scene.starts
    assert space.goal_count == (2 if name == "rooms" else 1)
    for start in scene.starts:
        assert space.goal_connected[tuple(space.locate(start))]
