"""Pictures of paths in voxel worlds, and the surfaces of cells.

Tests internals: `resgrid.plot.voxels`, `resgrid.plot.raster`, `resgrid.robots.voxel_surfaces`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support.cli import call

import resgrid as rg
from resgrid.plot.figures import figure_of
from resgrid.plot.raster import Camera
from resgrid.plot.voxels import VoxelView
from resgrid.robots.voxel_surfaces import coarse_cells, faces_between, is_voxel_world

AXES = tuple(rg.Axis(name, -1.0, 4.0, 5) for name in "xyz")


def room(shape: tuple[int, int, int] = (12, 10, 8)) -> rg.ConfigurationSpace:
    """Return a closed room with a wall that leaves a gap at the top."""
    cell = np.zeros(shape, dtype=np.uint8)
    for axis in range(3):
        np.moveaxis(cell, axis, 0)[[0, -1]] = rg.Cell.OBSTACLE
    cell[6, :, :5] = rg.Cell.OBSTACLE
    cell[9, 7, 2] = rg.Cell.GOAL
    return rg.ConfigurationSpace.from_array(cell, spacing=0.5)


@pytest.fixture(scope="module")
def planner() -> rg.planning.Planner:
    return rg.plan(room())


@pytest.mark.parametrize("merge", [False, True])
def test_faces_between_cells_have_the_area_of_a_count_and_face_the_air(merge: bool) -> None:
    rng = np.random.default_rng(4)
    for _ in range(10):
        solid = rng.random((5, 5, 5)) < 0.5
        faces = faces_between(solid, ~solid, AXES, merge=merge)
        count = sum(int((np.diff(solid.astype(int), axis=axis) != 0).sum()) for axis in range(3))
        edges = np.diff(faces.corners, axis=1)
        normals = np.cross(edges[:, 0], edges[:, 1])
        assert np.linalg.norm(normals, axis=1).sum() == pytest.approx(count)
        centres = faces.corners.mean(axis=1)
        ahead = np.floor(centres + 0.25 * np.sign(normals) + 1).astype(int)
        behind = np.floor(centres - 0.25 * np.sign(normals) + 1).astype(int)
        assert not solid[tuple(ahead.T)].any() and solid[tuple(behind.T)].all()
        plane = faces.plane
        for number in np.unique(plane):
            assert len(np.unique(np.sign(normals[plane == number]), axis=0)) == 1


def test_coarse_cells_have_a_marked_cell() -> None:
    mask = np.random.default_rng(0).random((7, 6, 5)) < 0.1
    coarse = coarse_cells(mask, 3)
    assert coarse.shape == (3, 2, 2) and coarse.any() and not coarse.all()
    for block in np.ndindex(coarse.shape):
        assert coarse[block] == mask[tuple(slice(3 * first, 3 * first + 3) for first in block)].any()


def test_the_walls_in_front_of_a_closed_room_are_transparent() -> None:
    space = room()
    view = VoxelView(space, Camera(-55.0, 38.0), None, None, np.empty((0, 3)))
    surface = view.layers()[0]
    inside = space.axis_centre((3, 4, 1))[np.newaxis]
    assert not view.hidden(inside, [surface]).any()
    assert view.hidden(inside - (0.0, 0.0, 1.0), [surface]).all()  # below the floor


@pytest.mark.slow
def test_a_path_is_drawn_with_slices_at_its_heights(planner: rg.planning.Planner) -> None:
    path = planner.path((1.25, 2.25, 1.25))
    figure = rg.draw(path)
    surface, *slices = figure.axes
    heights = sorted(float(axes.get_title().split("=")[1].split()[0]) for axes in slices)
    assert len(slices) == 3 and heights[0] == 1.25 and 2.5 < heights[-1] < path.points[:, 2].max() + 0.5
    labels = {text.get_text() for text in figure.legends[0].get_texts()}
    assert {"surface of obstacles", "goal", "path", "start", "goal reached", "path in the slice"} <= labels
    assert surface.images and {text.get_text() for text in surface.texts} == {
        "x 0 to 6 m", "y 0 to 5 m", "z 0 to 4 m"
    }  # fmt: skip
    assert len(rg.draw(path, axis=2, indices=[2]).axes) == 1
    labels = {text.get_text() for text in rg.draw([path], k=[1.0]).legends[0].get_texts()}
    assert "$k$ = 1 (Dirichlet)" in labels and "path" not in labels
    assert len(figure_of(rg.draw(rg.shortcut(path))).axes) == 4


def test_obstacles_above_hidden_paths_are_cut(planner: rg.planning.Planner) -> None:
    cell = planner.space.cell.copy()
    cell[:, :, 0], cell[:, :, -1] = 0, 1
    cell[:, [0, -1]] = cell[[0, -1]] = 0
    cell[1:-1, 1:-1, 6] = 1  # a roof above open space
    space = rg.ConfigurationSpace.from_array(cell, spacing=0.5)
    path = rg.plan(space).path((1.25, 2.25, 1.25))
    labels = [text.get_text() for text in rg.plot.draw_voxels(space, [path]).get_legend().get_texts()]
    assert any(label.startswith("obstacles cut at z = ") for label in labels)
    whole = [text.get_text() for text in rg.plot.draw_voxels(space, [path], top=4.0).get_legend().get_texts()]
    assert not any("cut" in label for label in whole)


def test_a_blocked_start_is_a_cross(planner: rg.planning.Planner) -> None:
    axes = rg.plot.draw_voxels(planner.space, [planner.path(cell=(6, 3, 2))])
    assert "start blocked" in [text.get_text() for text in axes.get_legend().get_texts()]


def test_a_large_grid_is_drawn_in_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("resgrid.robots.voxel_surfaces._MOST_CELLS", 5)
    view = VoxelView(room(), Camera(), None, None, np.empty((0, 3)))
    assert view.solid.shape == (4, 4, 3) and view.box[1].tolist() == [6.0, 6.0, 4.5]


def test_other_spaces_are_drawn_in_slices_and_refused_by_name() -> None:
    ring = rg.ConfigurationSpace.from_array(np.pad([[[2]]], 2), periodic=(True, False, False))
    assert not is_voxel_world(ring) and is_voxel_world(room())
    with pytest.raises(rg.InputError, match="draw_voxels needs a space with the axes x, y and z"):
        rg.plot.draw_voxels(ring)
    with pytest.raises(rg.InputError, match="the path belongs to another space"):
        rg.plot.draw_voxels(room((13, 10, 8)), [rg.plan(room()).path((1.25, 2.25, 1.25))])


@pytest.mark.slow
def test_plot_draws_the_paths_of_a_scene_in_space(scenes: Path, tmp_path: Path) -> None:
    file = tmp_path / "maze.png"
    assert call("plot", scenes / "voxel_maze.toml", "--what", "paths", "-o", file).exit_code == 0
    with Image.open(file) as image:
        assert image.width == 1480 and np.ptp(np.asarray(image.convert("L"))) > 200
