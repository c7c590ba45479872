"""Reasons of failed paths and the remedies in their messages, each checked by applying it."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result
from PIL import Image
from support.cli import ROOM, call

import resgrid as rg

HEAD = "image: map.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"


def ros_map(folder: Path, rows: list[str]) -> Path:
    """A ROS map of letters: # occupied, ? unknown, . free; the first row is the top one."""
    greys = {"#": 0, "?": 205, ".": 254}
    Image.fromarray(np.array([[greys[letter] for letter in row] for row in rows], np.uint8)).save(folder / "map.pgm")
    (folder / "map.yaml").write_text(HEAD)
    return folder / "map.yaml"


def place_in(text: str, before: str) -> str:
    """Return the coordinates after the words `before` in the form of an option."""
    found = re.search(rf"{before} \(([^)]*)\)", text)
    assert found is not None, text
    return found[1].replace(" ", "")


def test_starts_and_goals_in_unknown_space_are_reported_with_two_remedies(tmp_path: Path) -> None:
    file = ros_map(tmp_path, ["??????", "??????", "......", "......", "...##.", "......"])
    start = call("path", file, "--goal", "0.05,0.05", "--start", "0.25,0.55", "--k", "0,1")
    assert start.exit_code == 1
    (line,) = start.stdout.splitlines()
    assert "start (0.25, 0.55), k = 0, 1: start_blocked: the start lies in unknown space (cell (2, 5)); " in line
    assert "--unknown free makes unknown cells free and opens a path" in line
    place = place_in(line, "nearest place with a path to a goal is")
    assert call("path", file, "--goal", "0.05,0.05", "--start", place).exit_code == 0
    assert call("path", file, "--goal", "0.05,0.05", "--start", "0.25,0.55", "--unknown", "free").exit_code == 0
    goal = call("path", file, "--goal", "0.25,0.55", "--start", "0.05,0.05")
    assert goal.exit_code == 2
    assert "lies in unknown space (cell (2, 5)); move it to a free place that a start can reach" in goal.stderr
    assert "--unknown free" in goal.stderr
    place = place_in(goal.stderr, "the nearest is")
    assert call("path", file, "--goal", place, "--start", "0.05,0.05").exit_code == 0
    wall = call("path", file, "--goal", "0.05,0.05", "--start", "0.35,0.15")
    assert "lies in an obstacle (cell (3, 1))" in wall.stdout and "--unknown" not in wall.stdout
    assert "smaller" not in wall.stdout and "refine" not in wall.stdout


POCKET = ["........", ".#####..", ".#...#..", ".#.#.#..", ".#...#..", ".#####..", "........", "........"]


def test_the_proposed_nearest_place_has_a_path_to_the_goal(tmp_path: Path) -> None:
    """The middle of a closed pocket is nearer to free cells within it than to those outside."""
    file = ros_map(tmp_path, POCKET)
    for words in (("--start", "0.05,0.05"), ()):
        result = call("path", file, "--goal", "0.35,0.45", *words)
        assert result.exit_code == 2
        place = place_in(result.stderr, "the nearest is")
        assert call("path", file, "--goal", place, "--start", "0.05,0.05").exit_code == 0
    inside = call("path", file, "--goal", "0.35,0.45", "--start", "0.25,0.55")
    place = place_in(inside.stderr, "the nearest is")
    assert call("path", file, "--goal", place, "--start", "0.25,0.55").exit_code == 0
    start = call("path", file, "--goal", "0.05,0.05", "--start", "0.35,0.45", "--k", "0,0.5,1")
    assert start.exit_code == 1 and len(start.stdout.splitlines()) == 1
    place = place_in(start.stdout, "goal is")
    assert call("path", file, "--goal", "0.05,0.05", "--start", place).exit_code == 0
    shut = call("path", file, "--goal", "0.05,0.05", "--start", "0.25,0.55")
    assert shut.exit_code == 1 and shut.stdout.rstrip().endswith("; open a passage")


@pytest.mark.parametrize(("radius", "helps"), [("0.12", True), ("0.25", False)])
def test_centre_sampling_is_proposed_only_if_it_opens_a_path(tmp_path: Path, radius: str, helps: bool) -> None:
    """A gap of 0.3 m: the centres of its middle cells are 0.15 m from the walls, their borders 0.1 m."""
    wall, free = "." * 5 + "#" + "." * 5, "." * 11
    file = ros_map(tmp_path, [wall] * 4 + [free] * 3 + [wall] * 4)
    words = ("path", file, "--robot-radius", radius, "--goal", "0.95,0.55", "--start", "0.15,0.55")
    result = call(*words)
    assert result.exit_code == 1 and "no_path" in result.stdout
    assert ("--set sampling=centre opens a path" in result.stdout) == helps
    assert "radius smaller" in result.stdout and ("--refine 4 opens a path" in result.stdout) == helps
    assert call(*words, "--refine", "4").exit_code == (0 if helps else 1)
    assert (call(*words, "--set", "sampling=centre").exit_code == 0) == helps


def test_refining_the_grid_is_proposed_only_if_it_opens_a_path(tmp_path: Path) -> None:
    """Two walls leave a gap of one and a half cells, which twice as many cells resolve."""
    text = ROOM.replace("upper = [5, 5]", "upper = [5, 2.75]").replace("[0.5, 0.5], [5.5, 4.5]", "[5.5, 0.5]")
    text += '[[obstacle]]\nshape = "rectangle"\nlower = [4, 3.5]\nupper = [5, 5]\n'
    (tmp_path / "gap.toml").write_text(text)
    result = call("path", tmp_path / "gap.toml")
    assert result.exit_code == 1 and "refine the grid" in result.stdout
    finer = ("--set", "grid.axes.0.cells=12", "--set", "grid.axes.1.cells=10", "--goal", "3.5,3.5")
    assert call("path", tmp_path / "gap.toml", *finer).exit_code == 0
    (tmp_path / "shut.toml").write_text(ROOM)
    shut = call("path", tmp_path / "shut.toml", "--start", "5.5,0.5")
    assert "refine" not in shut.stdout and "open a passage" in shut.stdout


def test_planner_path_reasons_contain_the_nearest_place() -> None:
    cell = np.zeros((6, 3))
    cell[2, :], cell[5, 1] = 1, 2
    space = rg.ConfigurationSpace([rg.Axis("x", 0, 6, 6), rg.Axis("y", 0, 3, 3)], cell)
    planner = rg.plan(space)
    blocked, lost = planner.path((2.5, 0.5)), planner.path((0.5, 0.5))
    nearest = "the nearest place with a path to a goal is (3.5, 0.5), cell (3, 0)"
    assert blocked.reason == f"the start lies in an obstacle; {nearest}"
    assert str(lost.reason).startswith("obstacles separate the start from every goal; the nearest place")
    assert planner.path((3.5, 0.5)).reason is None


@pytest.mark.parametrize("name", ["goal", "via", "start"])
def test_the_remedy_for_a_place_that_is_given_as_a_cell_is_a_cell(tmp_path: Path, name: str) -> None:
    cell = np.zeros((9, 9), np.uint8)
    cell[2, 2] = 1
    np.save(tmp_path / "u.npy", cell)
    words = ["path", tmp_path / "u.npy", "--spacing", "2", "--origin=-1,-1", "--cells"]
    places = {"goal": "0,8", "start": "8,8", name: "2,2"}

    def run() -> Result:
        return call(*words, *(word for key, place in places.items() for word in (f"--{key}", place)))

    blocked = run()
    assert blocked.exit_code in (1, 2)
    assert ("that a start can reach, the nearest is cell (1, 2)" in blocked.stderr) == (name != "start")
    found = re.search(r"cell \((\d), (\d)\)$", (blocked.stdout + blocked.stderr).rstrip())
    assert found is not None
    places[name] = f"{found[1]},{found[2]}"
    assert run().exit_code == 0


def test_blocked_goal_cells_of_python_get_cells_as_remedies() -> None:
    axes = (rg.Axis("x", -1.0, 5.0, 3), rg.Axis("y", -1.0, 1.0, 1))
    scene = rg.Scene(axes, obstacles=(rg.Box((1.0, -1.0), (3.0, 1.0)),))
    with pytest.raises(rg.InputError, match=r"the nearest is cell \(0, 0\)$"):
        rg.build_space(scene.replace(goal=rg.GoalCell((1, 0))))
    with pytest.raises(rg.InputError, match=r"the nearest is \(0, 0\); --goal-tolerance 2 includes that place$"):
        rg.build_space(scene.replace(goal=(2.0, 0.0)))


def test_coarsen_is_blamed_for_blocked_goals_and_starts(tmp_path: Path) -> None:
    """Isolated obstacle pixels, every 4 cells: joining 4 x 4 cells leaves no free cell, 2 x 2 cells leave passages."""
    rows = ["".join("#" if not (row % 4 or column % 4) else "." for column in range(24)) for row in range(24)]
    file = ros_map(tmp_path, rows)
    places = ("--start", "0.25,0.15", "--goal", "2.25,2.05")
    blocked = call("path", file, *places, "--coarsen", "4")
    assert blocked.exit_code == 2 and "no cell is free; --coarsen 2 frees it, with 12 x 12 cells" in blocked.stderr
    assert call("path", file, *places, "--coarsen", "2").exit_code == 0
    cells = call("path", file, "--cells", "--start", "0,0", "--goal", "5,5", "--coarsen", "4")
    assert "12 x 12 cells; cells then have other numbers, and the goal is cell (11, 11)" in cells.stderr
    (tmp_path / "start").mkdir()
    file = ros_map(tmp_path / "start", ["#......."] + ["........"] * 7)
    start = call("path", file, "--start", "0.15,0.55", "--goal", "0.75,0.05", "--coarsen", "4")
    assert start.exit_code == 1 and "start_blocked" in start.stdout and "--coarsen 2 opens a path" in start.stdout
    assert call("path", file, "--start", "0.15,0.55", "--goal", "0.75,0.05", "--coarsen", "2").exit_code == 0


def test_free_unknown_cells_are_proposed_only_if_they_free_the_place(tmp_path: Path) -> None:
    """The unknown column is 0.1 m from a wall, nearer than the robot's radius."""
    file = ros_map(tmp_path, ["#.?....."] * 8)
    words = ("path", file, "--robot-radius", "0.15")
    goal = call(*words, "--goal", "0.25,0.45", "--start", "0.65,0.45")
    assert goal.exit_code == 2 and "lies in unknown space" in goal.stderr
    assert "--unknown free together with a smaller radius of the robot frees it" in goal.stderr
    assert "--unknown free treats" not in goal.stderr
    smaller = ("path", file, "--robot-radius", "0.05", "--unknown", "free")
    assert call(*smaller, "--goal", "0.25,0.45", "--start", "0.65,0.45").exit_code == 0
    start = call(*words, "--start", "0.25,0.45", "--goal", "0.65,0.45")
    assert start.exit_code == 1 and "lies in unknown space" in start.stdout and "--unknown free" not in start.stdout


def test_reached_goals_are_reported_with_region_and_place(tmp_path: Path) -> None:
    file = ros_map(tmp_path, ["......", "......"])
    result = call("path", file, "--goal", "0.05,0.05", "--goal", "0.55,0.15", "--start", "0.45,0.05")
    assert "reached goal 1 (regions count from 0 to 1) at (0.55, 0.15), length" in result.stdout
    result = call("path", file, "--goal", "0.05,0.05", "--start", "0.45,0.05")
    assert "reached goal 0 at (0.05, 0.05), length" in result.stdout
