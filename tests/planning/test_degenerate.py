"""Outcomes of degenerate spaces, compared with a flood fill for every boundary, drive, edge, blend, method and command.

Tests internals: `resgrid.live_page.drawing`, `resgrid.live_page.messages`, `resgrid.live_page.saving`,
`resgrid.live_page.session`.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from support.cli import answer, call
from support.spaces import space_of

import resgrid as rg
from resgrid.live_page.drawing import Drawing, drawing_of_space
from resgrid.live_page.messages import write_drawing
from resgrid.live_page.saving import scene_toml
from resgrid.live_page.session import Session

FREE, OBSTACLE, GOAL = 0, 1, 2
MAPS = {
    "one_goal_cell": "2",
    "all_goals": "22/22",
    "goals_and_obstacles": "21/12",
    "one_free_cell": "111/120/111",
    "one_free_cell_cut_off": "211/111/110",
    "goal_walled_in": "00000/01110/01210/01110/00000",
    "goal_walled_in_with_a_free_neighbour": "00000/01110/01210/01010/01110/00000",
    "row": "2000",
    "column": "2/0/0",
    "part_without_goal": "20100",
    "open": "200/000",
    "goal_between_parts": "10200",
}
"""Cells, one digit each: rows of the first axis, separated by slashes."""

SHOWN = ("one_goal_cell", "goal_walled_in", "open", "goal_between_parts")
"""Maps that are also drawn and driven through."""

CIRCUITS: dict[str, dict[str, Any]] = {
    "dirichlet": {},
    "wall": {"wall": 1e4},
    "k = 0.5": {"k": 0.5},
    "neumann": {"k": 0.0},
    "driven": {"driven": True},
}


def cells_of(rows: str) -> np.ndarray:
    return np.array([[int(digit) for digit in row] for row in rows.split("/")], dtype=np.uint8)


def flood_fill(space: rg.ConfigurationSpace, from_codes: tuple[int, ...], through: int) -> set[tuple[int, ...]]:
    """Cells of code `through` that chains of such cells join to a cell of `from_codes`."""
    reached: set[tuple[int, ...]] = set()
    waiting = [cell for cell in np.ndindex(space.shape) if space.cell[cell] in from_codes]
    while waiting:
        for other in neighbours(space, waiting.pop()):
            if other is not None and space.cell[other] == through and other not in reached:
                reached.add(other)
                waiting.append(other)
    return reached


def neighbours(space: rg.ConfigurationSpace, cell: tuple[int, ...]) -> list[tuple[int, ...] | None]:
    """Neighbours across faces, None beyond an edge; the empty list on a ring of one cell."""
    found: list[tuple[int, ...] | None] = []
    for axis, size in enumerate(space.shape):
        for by in (-1, 1):
            index = cell[axis] + by
            if space.axes[axis].periodic:
                found += [(*cell[:axis], index % size, *cell[axis + 1 :])] if size > 1 else []
            else:
                found.append((*cell[:axis], index, *cell[axis + 1 :]) if 0 <= index < size else None)
    return found


def expected(space: rg.ConfigurationSpace, *, on_rail: bool, edge: str) -> np.ndarray:
    """Outcomes of starts in every cell, by plain flood fill; `on_rail`: only obstacles drive the grid."""
    connected = flood_fill(space, (GOAL,), FREE)
    outcome = np.full(space.shape, "start_blocked", dtype="U16")
    for cell in np.ndindex(space.shape):
        if space.cell[cell] == GOAL:
            outcome[cell] = "reached"
        elif space.cell[cell] == FREE:
            outcome[cell] = "goal_blocked" if not connected else "no_path" if cell not in connected else "reached"
    if on_rail:
        adjacent = [
            cell for cell in connected
            for other in neighbours(space, cell)
            if (edge == "obstacle" if other is None else space.cell[other] == OBSTACLE)
        ]  # fmt: skip
        driven = _connected_cells(space, adjacent)
        for cell in connected - driven:
            outcome[cell] = "no_current"
    return outcome


def _connected_cells(space: rg.ConfigurationSpace, cells: list[tuple[int, ...]]) -> set[tuple[int, ...]]:
    """Free cells that chains of free cells join to one of `cells`."""
    reached, waiting = set(cells), list(cells)
    while waiting:
        for other in neighbours(space, waiting.pop()):
            if other is not None and space.cell[other] == FREE and other not in reached:
                reached.add(other)
                waiting.append(other)
    return reached


def check_outcomes(planner: rg.Planner, wanted: np.ndarray) -> None:
    """Compare `streamline`, `streamlines` and `basins` with outcomes for a start in every cell; certify the paths."""
    space = planner.space
    starts = np.argwhere(np.ones(space.shape, dtype=bool))
    np.testing.assert_array_equal(planner.ends(space.centre(starts)).outcome.reshape(space.shape), wanted)
    np.testing.assert_array_equal(rg.basins(planner.field) >= 0, wanted == "reached")
    for start in starts.tolist():
        path = planner.path(cell=start)
        assert path.outcome == wanted[tuple(start)], (start, path)
        assert (path.reason is None) == (path.outcome is rg.Outcome.REACHED)
        rg.certify(path)
        if space.cell[tuple(start)] == GOAL:
            assert path.length == 0 and len(path.points) == 1


@pytest.mark.parametrize("method", ["auto", "direct", "multigrid"])
@pytest.mark.parametrize("edge", ["obstacle", "open"])
@pytest.mark.parametrize("circuit", ["dirichlet", "wall", "neumann", "k = 0", "k = 0.5", "k = 1", "wall, k = 1"])
@pytest.mark.quick_cases(14)
def test_every_start_of_a_degenerate_space_has_the_outcome_of_flood_fill(circuit, edge, method) -> None:
    boundary, _, k = circuit.partition("k = ")
    boundary = boundary.strip(", ") or "dirichlet"
    options: dict[str, Any] = {"boundary": boundary, "edge": edge, "method": method}
    options |= {"wall_resistance": 1e4} if boundary == "wall" else {}
    options |= {"k": float(k)} if k else {}
    on_rail = boundary != "neumann" and k in ("", "1")
    for rows in MAPS.values():
        cell = cells_of(rows)
        for rings in ((False, False), (True, False), (True, True)) if method == "auto" else ((True, False),):
            space = space_of(cell, periodic=rings)
            check_outcomes(rg.plan(space, **options), expected(space, on_rail=on_rail, edge=edge))


@settings(max_examples=60, deadline=None)
@given(data=st.data(), shape=array_shapes(min_dims=1, max_dims=3, min_side=1, max_side=4))
@pytest.mark.slow
def test_tiny_random_spaces_have_the_outcomes_of_a_flood_fill(data: st.DataObject, shape: tuple[int, ...]) -> None:
    cell = data.draw(arrays(np.uint8, shape, elements=st.sampled_from([0, 0, 1, 2])))
    assume((cell == GOAL).any())
    space = space_of(cell, periodic=tuple(data.draw(st.booleans()) for _ in shape))
    boundary, edge = data.draw(st.sampled_from(["dirichlet", "neumann", "wall"])), data.draw(st.sampled_from(EDGES))
    k = None if boundary == "neumann" else data.draw(st.sampled_from([None, 0.0, 0.5, 1.0]))
    options = {"wall_resistance": data.draw(st.sampled_from([0.0, 1e4]))} if boundary == "wall" else {}
    planner = rg.plan(space, boundary=boundary, edge=edge, k=k, **options)
    on_rail = boundary != "neumann" and k in (None, 1.0)
    check_outcomes(planner, expected(space, on_rail=on_rail, edge=edge))


EDGES = ["obstacle", "open"]


def starts_of(space: rg.ConfigurationSpace) -> list[list[float]]:
    """One start in every cell except obstacles, which `control` rejects as starts."""
    return space.centre(np.argwhere(space.cell != OBSTACLE)).tolist()


def drawing(rows: str, circuit: str, edge: str) -> Drawing:
    space = space_of(cells_of(rows))
    drawn = replace(drawing_of_space(space), starts=np.array(starts_of(space)), edge=(edge, edge), **CIRCUITS[circuit])
    return replace(drawn, title="Tiny")


def expected_outcomes(drawn: Drawing, circuit: str, edge: str) -> list[str]:
    """Outcomes of the starts of a drawing."""
    outcome = expected(drawn.space, on_rail=circuit in ("dirichlet", "wall"), edge=edge)
    return [str(outcome[tuple(drawn.space.locate(start))]) for start in drawn.starts]


@pytest.mark.parametrize("edge", EDGES)
@pytest.mark.parametrize("circuit", CIRCUITS)
@pytest.mark.parametrize("name", MAPS)
def test_path_and_the_live_page_have_the_outcomes_of_flood_fill(
    tmp_path: Path, name: str, circuit: str, edge: str
) -> None:
    """Outcomes of `path` and of the page for every start."""
    drawn = drawing(MAPS[name], circuit, edge)
    outcomes, file = expected_outcomes(drawn, circuit, edge), tmp_path / "tiny.toml"
    file.write_text(scene_toml(drawn.document()))
    negative = int(set(outcomes) != {"reached"})
    reply = answer("path", file, code=negative)["paths"]
    assert [path["outcome"] for path in reply] == outcomes
    assert [path["outcome"] for path in page_frame(drawn)["paths"]] == outcomes


@pytest.mark.parametrize(
    ("name", "circuit", "edge"),
    [(name, circuit, EDGES[(i + j) % 2]) for i, name in enumerate(SHOWN) for j, circuit in enumerate(CIRCUITS)],
)
@pytest.mark.quick_cases(7)
def test_plot_and_control_have_the_outcomes_of_flood_fill(tmp_path: Path, name: str, circuit: str, edge: str) -> None:
    """The cases contain every pair of a map, a circuit and an edge."""
    drawn = drawing(MAPS[name], circuit, edge)
    outcomes, file = expected_outcomes(drawn, circuit, edge), tmp_path / "tiny.toml"
    file.write_text(scene_toml(drawn.document()))
    assert call("plot", file, "-o", tmp_path / "tiny.png").exit_code == 0
    if circuit != "driven":
        runs = answer("control", file, code=int(set(outcomes) != {"reached"}))["runs"]
        assert [run["outcome"].replace("arrived", "reached") for run in runs] == outcomes


def page_frame(drawn: Drawing) -> dict[str, Any]:
    """Return the live page's reply to a drawing."""
    head, body = write_drawing(drawn)
    text = json.dumps({"seq": 1, "type": "solve", "drawing": head["drawing"], "exact": True}).encode()
    reply = Session(drawn, read_only=False).answer(len(text).to_bytes(4, "little") + text + body)
    content: dict[str, Any] = json.loads(reply[4 : 4 + int.from_bytes(reply[:4], "little")])
    assert "error" not in content, content
    return content


@pytest.mark.parametrize("circuit", ["dirichlet", "wall", "neumann"])
@pytest.mark.parametrize("name", ["goal_walled_in", "all_goals", "open", "row"])
def test_every_command_rejects_an_undriven_circuit_with_one_message(tmp_path: Path, name: str, circuit: str) -> None:
    """Commands for one circuit give one message and exit code 2; `info` still describes the scene."""
    drawn, file = drawing(MAPS[name], circuit, "open"), tmp_path / "tiny.toml"
    file.write_text(scene_toml(drawn.document()))
    flows = circuit == "neumann" and name in ("open", "row")
    asked = [("compile",), ("compile", "-o", tmp_path / "x.cir"), ("solve",), ("chip", "-o", tmp_path / "chip")]
    for subcommand, *options in asked[: len(asked) - flows]:
        result = call(subcommand, file, *options)
        assert result.exit_code == (0 if flows else 2), (subcommand, result.stderr)
        assert flows or ("nothing is driven: no " in result.stderr and not result.stdout)
    assert answer("info", file)["free_cells"] == int((drawn.cell == FREE).sum())
    assert flows or sorted(path.name for path in tmp_path.iterdir()) == ["tiny.toml"]


@pytest.mark.parametrize("circuit", CIRCUITS)
@pytest.mark.quick_cases(1)
def test_run_reports_outcomes_without_a_circuit(tmp_path: Path, circuit: str) -> None:
    """`run` draws and reports the outcomes, and writes no deck."""
    drawn, file = drawing(MAPS["goal_walled_in"], circuit, "obstacle"), tmp_path / "tiny.toml"
    file.write_text(scene_toml(drawn.document()))
    reply = answer("run", file, "-o", tmp_path / "out", code=1)
    assert {path["outcome"] for path in reply["paths"]} == {"reached", "goal_blocked"}
    assert reply["chips"] == [] and (tmp_path / "out" / "page.png").exists()


def test_clearance_curve_raises_without_paths_or_current() -> None:
    open_space, walled_in = space_of(cells_of(MAPS["open"])), space_of(cells_of(MAPS["goal_walled_in"]))
    with pytest.raises(rg.InputError, match="no free cell has a path"):
        rg.planning.clearance_curve(rg.plan(walled_in, k=0.5))
    flat = rg.plan(open_space, k=0.5, edge="open")
    with pytest.raises(rg.InputError, match="no current flows at k = 1: leave this value out"):
        rg.planning.clearance_curve(flat)
    assert np.isinf(rg.planning.clearance_curve(flat, ks=[0.0, 0.5]).mean).all()


def test_a_run_on_a_settling_grid_ends_when_no_path_exists() -> None:
    """Announced obstacles separate the robot from the goal, or enclose the goal."""
    axes = space_of(cells_of(MAPS["open"])).axes
    wall = rg.Box((0.0, 1.0), (2.0, 2.0))
    for boundary in ("dirichlet", "neumann"):
        scene = rg.Scene(axes, goals=(rg.GoalCell((0, 0)),), boundary=boundary, starts=((0.5, 2.5),))
        run = rg.simulation(scene.replace(hidden=(wall,)), announce=True, settle="sor").run()
        assert run.ending is rg.control.TerminationReason.NO_PATH
        adjacent = (rg.Box((0.0, 1.0), (1.0, 2.0)), rg.Box((1.0, 0.0), (2.0, 2.0)))
        run = rg.simulation(scene.replace(hidden=adjacent), announce=True, settle="sor").run()
        assert run.ending is rg.control.TerminationReason.GOAL_BLOCKED


@pytest.mark.parametrize("cells", ["0 2", "2 0 2"])
def test_info_describes_a_chip_whose_only_free_cell_is_the_driven_start(cells: str, tmp_path: Path) -> None:
    row = cells.split()
    goals = "\n".join(f"[[goal]]\ncell = [{index}, 0]" for index, code in enumerate(row) if int(code) == GOAL)
    x, y = (f'{{ name = "{name}", lower = 0, upper = {n}, cells = {n} }}' for name, n in (("x", len(row)), ("y", 1)))
    axes = f"[{x}, {y}]"
    (tmp_path / "chip.toml").write_text(
        f"schema = 1\nstarts = [[{row.index('0')}.5, 0.5]]\n[grid]\naxes = {axes}\n{goals}\n"
    )
    found = answer("info", tmp_path / "chip.toml", "--boundary", "neumann", "--drive", "start")
    assert found["resistors"] == len(row) - 1
    assert found["memory_bytes"] == 0
