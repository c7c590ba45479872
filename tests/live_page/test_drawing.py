"""Drawings of the live page, compared with their scenes, saved files and messages, and with ``rg.plan``.

Tests internals: `resgrid.live_page.arms`, `resgrid.live_page.drawing`, `resgrid.live_page.examples`,
`resgrid.live_page.frames`, `resgrid.live_page.messages`, `resgrid.live_page.saving`, `resgrid.live_page.solving`.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

import resgrid as rg
from resgrid.live_page.arms import poses
from resgrid.live_page.drawing import Drawing, blank, boxes, drawing_of, drawing_of_space, is_same_circuit
from resgrid.live_page.examples import examples, open_example
from resgrid.live_page.frames import NO_VALUE, describe, picture_of
from resgrid.live_page.messages import DrawingHead, read_drawing, write_drawing
from resgrid.live_page.saving import save
from resgrid.live_page.solving import WarmFields, solve_drawing, without_imperfections


def assert_same_drawing(one: Drawing, other: Drawing) -> None:
    for name in ("axes", "edge", "k", "wall", "driven", "title", "palette"):
        assert getattr(one, name) == getattr(other, name), name
    for name in ("cell", "level"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    np.testing.assert_allclose(one.starts, other.starts)


@given(arrays(bool, st.tuples(st.integers(1, 9), st.integers(1, 9))))
def test_boxes_cover_every_cell_once(mask):
    covered = np.zeros(mask.shape, dtype=int)
    for (i, j), (i_end, j_end) in boxes(mask):
        covered[i:i_end, j:j_end] += 1
    np.testing.assert_array_equal(covered, mask)


@pytest.mark.parametrize("name", examples())
def test_a_saved_example_reads_back_as_the_same_drawing(name, tmp_path):
    drawing = drawing_of(open_example(name))
    file = tmp_path / "scene.toml"
    file.write_bytes(save(drawing, "toml")[1])
    assert_same_drawing(drawing_of(rg.read_scene(file)), drawing)


@pytest.mark.parametrize("name", examples())
def test_the_page_and_rg_plan_return_the_same_paths(name, tmp_path):
    """Paths end at the goal points on the page, in the saved file and in the scene."""
    scene = open_example(name)
    if scene.drive == "start":
        return
    drawing = without_imperfections(replace(drawing_of(scene), k=0.0))
    head, body = write_drawing(drawing)
    shown = solve_drawing(read_drawing(DrawingHead.model_validate(head["drawing"]), body), exact=True).paths
    file = tmp_path / "scene.toml"
    file.write_bytes(save(drawing, "toml")[1])
    own, saved = (rg.plan(each, k=0.0).paths() for each in (scene, rg.read_scene(file)))
    assert [path.outcome for path in shown] == [path.outcome for path in own] == [path.outcome for path in saved]
    for others in (own, saved):
        np.testing.assert_allclose([path.length for path in shown], [path.length for path in others], rtol=1e-8)
        for path, other in zip(shown, others, strict=True):
            np.testing.assert_allclose(
                path.axis_points, other.axis_points, rtol=0, atol=1e-8 * path.space.spacing.max()
            )


def test_goal_cells_that_stay_keep_their_goal_points():
    drawing = drawing_of(open_example("rooms"))
    numbers = [number for number, *_ in drawing.goal_points]
    assert numbers == np.flatnonzero(drawing.cell == rg.Cell.GOAL).tolist()
    cell = drawing.cell.copy()
    cell.flat[numbers[::2]] = rg.Cell.FREE
    head, body = write_drawing(replace(drawing, cell=cell))
    assert [number for number, *_ in read_drawing(DrawingHead.model_validate(head["drawing"]), body).goal_points] == (
        numbers[1::2]
    )


@given(arrays(np.uint8, (7, 5), elements=st.integers(0, 2)), arrays(np.uint8, (7, 5), elements=st.integers(0, 2)))
def test_random_drawings_survive_messages_and_scenes(cell, level):
    axes = (rg.Axis("x", -1.0, 2.5, 7, unit="m"), rg.Axis("a", 0.0, 6.0, 5, periodic=True, unit="rad"))
    starts = np.array([[0.1, 0.2]])
    palette = (1.0, 0.1, 3.0)
    drawing = Drawing("any", axes, ("open", "periodic"), cell, level, palette, starts, k=0.25, wall=2e4, leak=0.3)
    head, body = write_drawing(drawing)
    assert_same_drawing(read_drawing(DrawingHead.model_validate(head["drawing"]), body), drawing)
    if (cell == 2).any():
        again = drawing_of(drawing.scene())
        np.testing.assert_array_equal(again.cell, cell)
        costs = np.array(palette)
        np.testing.assert_array_equal(np.array(again.palette)[again.level], costs[level])
        assert (again.k, again.wall, again.leak, again.edge) == (0.25, 2e4, 0.3, ("open", "periodic"))


def test_the_path_of_a_drawing_equals_the_path_of_its_scene():
    drawing = blank(24)
    cell = drawing.cell.copy()
    cell[10, 3:20] = 1
    for changes in (
        {}, {"k": 0.0}, {"k": 0.5}, {"wall": 3e4}, {"driven": True, "k": 0.0},
        {"leak": 0.04}, {"leak": 0.04, "k": 0.0}, {"leak": 0.04, "k": 0.5}, {"leak": 0.04, "wall": 3e4},
        {"lattice": "square8"}, {"lattice": "hexagonal", "k": 0.0}, {"lattice": "hexagonal", "k": 0.5},
    ):  # fmt: skip
        changed = replace(drawing, cell=cell, **changes)
        frame = solve_drawing(changed, exact=True)
        scene = changed.scene()
        if changed.driven:
            assert scene.drive == "start" and scene.boundary == "neumann"
            continue
        path = rg.plan(scene).path(scene.starts[0])
        np.testing.assert_array_equal(frame.paths[0].cells, path.cells)
        np.testing.assert_allclose(frame.paths[0].points, path.points)


def test_an_inexact_frame_is_marked_as_not_exact():
    drawing = blank(48)
    hasty = solve_drawing(drawing, exact=False)
    assert not hasty.exact
    assert hasty.field.space.shape == (48, 48)


@pytest.mark.parametrize(
    ("k", "wall", "leak"),
    [(0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1e4, 0.0), (0.0, 0.0, 1e-3), (1.0, 0.0, 1e-3)],
)
def test_warm_started_fields_equal_those_of_the_circuit(k, wall, leak):
    drawing, warm = replace(blank(64), k=k, wall=wall, leak=leak), WarmFields()
    cell = drawing.cell.copy()
    for column in range(20, 40, 4):
        cell[column : column + 4, 30] = 1
        changed = replace(drawing, cell=cell.copy())
        frame, plain = (solve_drawing(changed, exact=False, warm=start) for start in (warm, None))
        assert not frame.exact and not frame.solution.operating_points
        shown = changed.space.goal_connected
        np.testing.assert_allclose(frame.field.potential[shown], plain.field.potential[shown], atol=1e-4)
        head, body = describe(frame)
        expected, _ = describe(plain)
        assert [len(part) for part in body][1:] == [2 * cell.size, 4 * cell.size, cell.size]
        assert head["scale"]["kind"] == expected["scale"]["kind"] == ("decades" if k or leak else "height")


def test_a_flat_dirichlet_half_falls_back_to_the_plain_solver():
    drawing = replace(blank(8), edge=("open", "open"), k=0.5)  # the Dirichlet half of the blend is flat
    frame = solve_drawing(drawing, exact=False, warm=WarmFields())
    assert frame.solution.flat == ("dirichlet",)


@pytest.mark.parametrize("k", [0.0, 0.5, 1.0])
def test_a_broken_resistor_carries_no_current_and_the_path_avoids_it(k):
    drawing = replace(blank(16), k=k)
    path = solve_drawing(drawing, exact=True).paths[0]
    before, after = path.cells[3], path.cells[4]
    axis = int(np.flatnonzero(before != after)[0])
    face = (*np.maximum(before, after).tolist(), axis)
    frame = solve_drawing(replace(drawing, broken=(face,)), exact=True)
    assert frame.field.face_direction[axis][face[:2]] == 0
    cells = frame.paths[0].cells.tolist()
    assert frame.paths[0].outcome is rg.Outcome.REACHED
    assert (before.tolist(), after.tolist()) not in list(pairwise(cells))


def test_both_indices_of_a_resistor_on_a_seam_break_the_same_resistor():
    axes = (rg.Axis("a", 0.0, 8.0, 8, periodic=True), rg.Axis("b", 0.0, 4.0, 4))
    cell = np.zeros((8, 4), np.uint8)
    cell[4, 2] = 2
    drawing = Drawing("ring", axes, ("periodic", "obstacle"), cell, 0 * cell, (1.0,), np.empty((0, 2)))
    faces = [solve_drawing(replace(drawing, broken=((i, 1, 0),)), exact=True).field.face_direction[0] for i in (0, 8)]
    np.testing.assert_array_equal(*faces)
    assert faces[0][0, 1] == faces[0][8, 1] == 0


def test_equal_chip_seeds_give_equal_mismatch():
    drawing = blank(16)
    fields = [
        solve_drawing(replace(drawing, chip={"mismatch": 0.2, "seed": seed}), exact=True).field.potential
        for seed in (1, 1, 2)
    ]
    np.testing.assert_array_equal(fields[0], fields[1])
    assert not np.array_equal(fields[0], fields[2])


def test_spaces_that_cannot_be_drawn_raise_input_error(scenes: Path):
    with pytest.raises(rg.InputError, match="3 axes"):
        drawing_of(rg.read_scene(scenes / "voxels.toml"))
    with pytest.raises(rg.InputError, match="too many to draw"):
        drawing_of(rg.Scene([rg.Axis("x", 0, 1, 40000), rg.Axis("y", 0, 1, 40000)]))
    with pytest.raises(rg.InputError, match="1 axes"):
        drawing_of_space(rg.ConfigurationSpace([rg.Axis("x", 0, 1, 3)], [0, 1, 2]))
    with pytest.raises(rg.InputError, match="no goal"):
        solve_drawing(replace(blank(8), cell=np.zeros((8, 8), np.uint8)), exact=True)


@pytest.mark.parametrize(
    ("values", "shown"), [([0, 0.5, 1], 1.0), ([0.98, 0.5, 1], 0.98), ([0], 0.0), ([0.3], 0.3), ([], 1.0)]
)
def test_a_scene_opens_at_its_largest_k_or_at_1(scenes: Path, values: list[float], shown: float) -> None:
    scene = rg.read_scene(scenes / "lesson.toml", **({"k": values} if values else {}))
    assert drawing_of(scene).k == shown


def test_is_same_circuit_ignores_titles_starts_and_unused_costs() -> None:
    first = blank(12)
    walled = first.cell.copy()
    walled[3, 3] = rg.Cell.OBSTACLE
    alike = [
        replace(first, title="Other"),
        replace(first, starts=first.starts + 1.0),
        replace(first, palette=(1.0, 0.1)),
    ]
    other = [
        replace(first, cell=walled), replace(first, k=0.5), replace(first, wall=10.0),
        replace(first, broken=((2, 2, 0),)), replace(first, leak=0.1), replace(first, lattice="square8"),
        replace(first, chip={"resistance": 5.0}), replace(first, level=first.level + np.uint8(1), palette=(1.0, 0.1)),
        blank(13), replace(first, edge=("open", "obstacle")),
    ]  # fmt: skip
    assert all(is_same_circuit(first, drawing) for drawing in alike)
    assert not any(is_same_circuit(first, drawing) for drawing in other)
    driven = replace(first, driven=True, k=0.0)
    assert not is_same_circuit(driven, replace(driven, starts=driven.starts + 1.0))


def test_a_robot_from_a_urdf_file_is_drawn_as_its_cells() -> None:
    """Only an arm of two links has a workspace on the page."""
    scene = rg.read_scene("scara")
    drawing = drawing_of(scene)
    assert drawing.world is None
    np.testing.assert_array_equal(drawing.cell, rg.build_space(scene).cell)
    frame = solve_drawing(drawing, exact=True)
    assert poses(frame) == [] and [path.outcome for path in frame.paths] == ["reached"] * 2


@pytest.mark.parametrize("k", [0.0, 0.5, 1.0])
def test_a_leak_is_drawn_as_decades_of_the_drop(k: float) -> None:
    """Far from the goal of a corridor with open sides, the drop falls by a factor of e per screening length."""
    axes = (rg.Axis("x", 0.0, 40.0, 160, unit="m"), rg.Axis("y", 0.0, 1.0, 4, unit="m"))
    cell = np.zeros((160, 4), np.uint8)
    cell[0] = rg.Cell.GOAL
    drawing = Drawing("", axes, ("open", "open"), cell, 0 * cell, (1.0,), np.array([[39.0, 0.5]]), k=k, leak=0.25)
    frame = solve_drawing(drawing, exact=True)
    scale, picture = picture_of(frame)
    assert scale["kind"] == "decades" and frame.paths[0].outcome == "reached"
    decades = scale["low"] + picture / (NO_VALUE - 1) * (scale["high"] - scale["low"])
    assert decades[20, 0] - decades[60, 0] == pytest.approx(10.0 / 2.0 / np.log(10.0), rel=0.01)  # 10 m, length 2 m


def test_the_circuit_of_a_small_grid_states_the_resistance_of_its_leaks() -> None:
    for drawing, ohms in ((replace(blank(8), leak=0.04), 10e3 / 0.04), (blank(8), None)):
        head, _ = describe(solve_drawing(drawing, exact=True))
        assert head["circuit"]["leak"] == (None if ohms is None else pytest.approx(ohms))
        assert len(head["circuit"]["resistors"]) == 2 * 7 * 8 + 4 * 8
