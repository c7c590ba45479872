"""Cropped, coarse and refined maps, compared with loops over pixels and with slices of the unprepared map.

Tests internals: `resgrid.scene.maps.formats`, `resgrid.scene.overrides`.
"""

import tracemalloc
from math import cos, sin

import numpy as np
import pytest
from PIL import Image
from support.cli import call

import resgrid as rg
from resgrid.scene.maps.formats import read_map
from resgrid.scene.overrides import apply_overrides

FREE, WALL, UNKNOWN = 254, 0, 150


def write(folder, grey, yaw=0.0, resolution=0.1, origin=(-1.0, 2.0), suffix="pgm", **keys):
    Image.fromarray(np.asarray(grey, dtype=np.uint8)).save(folder / f"map.{suffix}")
    table = {"negate": 0, "occupied_thresh": 0.65, "free_thresh": 0.25} | keys
    head = f"image: map.{suffix}\nresolution: {resolution}\norigin: [{origin[0]}, {origin[1]}, {yaw}]\n"
    (folder / "map.yaml").write_text(head + "".join(f"{key}: {value}\n" for key, value in table.items()))
    return folder / "map.yaml"


def random_map(rng, shape=(31, 44), border=6):
    grey = np.full(shape, UNKNOWN)
    inside = rng.choice([FREE, WALL, UNKNOWN], size=(shape[0] - 2 * border, shape[1] - 2 * border), p=[0.8, 0.1, 0.1])
    grey[border : shape[0] - border, border : shape[1] - border] = inside
    return grey


def window_of(whole, part):
    """Return the slice of a map's cells that a part covers, from the positions of the axes."""
    slices = []
    for axis, small in zip(whole.axes, part.axes, strict=True):
        first = round((small.lower - axis.lower) / axis.spacing)
        assert abs(small.lower - axis.lower - first * axis.spacing) < 1e-9
        assert abs(small.spacing - axis.spacing) < 1e-12
        slices.append(slice(first, first + small.cells))
    return tuple(slices)


@pytest.mark.parametrize("suffix", ["pgm", "png"])
@pytest.mark.parametrize("yaw", [0.0, 0.4])
def test_the_known_part_is_the_bounding_box_of_the_known_pixels(tmp_path, yaw, suffix):
    rng = np.random.default_rng(3)
    for _ in range(20):
        grey = np.where(rng.random((17, 23)) < 0.03, rng.choice([FREE, WALL]), UNKNOWN)
        file = write(tmp_path, grey, yaw, suffix=suffix)
        if (grey == UNKNOWN).all():
            with pytest.raises(rg.InputError, match="no cell of this map is known"):
                rg.read_scene(file, crop="known")
            continue
        whole, part = rg.read_scene(file), rg.read_scene(file, crop="known")
        rows, columns = np.nonzero(grey != UNKNOWN)
        upwards = len(grey) - 1 - rows
        at = slice(columns.min(), columns.max() + 1), slice(upwards.min(), upwards.max() + 1)
        assert window_of(whole, part) == at and part.frame == whole.frame
        assert (part.map.cell == whole.map.cell[at]).all() and (part.map.unknown == whole.map.unknown[at]).all()


@pytest.mark.parametrize("sampling", ["conservative", "centre"])
@pytest.mark.parametrize("yaw", [0.0, 0.7])
def test_a_cropped_map_has_the_same_free_cells_as_the_whole_map(tmp_path, yaw, sampling):
    """Obstacles outside the part still block the cells that they block on the whole map."""
    rng = np.random.default_rng(5)
    for number in range(30):
        file = write(tmp_path, random_map(rng), yaw)
        robot = rg.PointRobot(float(rng.choice([0.0, 0.06, 0.17, 0.31])))
        lower = rng.uniform([-1.0, 2.0], [2.0, 4.0])
        box = (*lower, *(lower + rng.uniform(0.3, 2.0, 2)))
        unknown = ("obstacle", "free")[number % 2]
        options = {"unknown": unknown, "robot": robot, "sampling": sampling}
        table = {"file": str(file), "unknown": unknown}
        whole = rg.read_scene(file, **options)
        try:
            cells = read_map(table | {"crop": box}, robot.extent)
        except rg.InputError as error:
            assert "lies outside the map" in str(error)
            continue
        part = whole.replace(map=cells, axes=cells.axes, edge="obstacle")
        at = window_of(whole, part)
        spaces = [rg.build_space(scene, require_goal=False).cell for scene in (whole, part)]
        assert (spaces[1] == spaces[0][at]).all()


def test_a_footprint_collides_with_obstacles_outside_the_part(tmp_path):
    file = write(tmp_path, np.where(np.random.default_rng(9).random((31, 44)) < 0.03, WALL, FREE))
    text = (
        'schema = 1\nrobot.footprint = [[-0.2, -0.1], [0.3, -0.1], [0.3, 0.1], [-0.2, 0.1]]\n[map]\nfile = "map.yaml"\n'
    )
    whole = rg.parse_scene(text + "headings = 12\n", folder=file.parent)
    part = rg.parse_scene(text + "headings = 12\ncrop = [0.05, 3.05, 1.6, 4.4]\n", folder=file.parent)
    cells = [rg.build_space(scene, require_goal=False).cell for scene in (whole, part)]
    at = window_of(whole.map, part.map)
    assert part.map.surroundings is not None and (cells[1] == cells[0][at]).all() and not cells[1].all()


def test_a_box_keeps_the_cells_that_it_touches(tmp_path):
    """The reference tests the corners of every cell of the rotated map against the rotated box."""
    rng = np.random.default_rng(1)
    for yaw in (0.0, 0.3, -2.0):
        file = write(tmp_path, np.full((30, 40), FREE), yaw)
        frame = rg.read_scene(file).frame
        for _ in range(20):
            centre = np.array([-1.0, 2.0]) + np.array([[cos(yaw), -sin(yaw)], [sin(yaw), cos(yaw)]]) @ (2.0, 1.5)
            half = rng.uniform(0.05, 0.9, 2)
            box = (*(centre - half), *(centre + half))
            corners = np.array([(x, y) for x in (box[0], box[2]) for y in (box[1], box[3])])
            inside = frame.from_world(corners) if yaw else corners - (-1.0, 2.0)
            low, high = np.floor(inside.min(axis=0) / 0.1), np.ceil(inside.max(axis=0) / 0.1)
            part = rg.read_scene(file, crop=box)
            origin = np.zeros(2) if yaw else np.array((-1.0, 2.0))
            assert np.allclose([axis.lower for axis in part.axes], origin + 0.1 * low)
            assert [axis.cells for axis in part.axes] == (high - low).tolist()


def coarse_reference(grey, step, unknown_is_free):
    """Return cells and unknown mask of the coarse map by a loop over coarse cells; rows from the bottom."""
    grey = grey[::-1]
    shape = [-(-size // step) for size in grey.shape]
    cell, unknown = np.zeros(shape[::-1], np.uint8), np.zeros(shape[::-1], bool)
    for j in range(shape[0]):
        for i in range(shape[1]):
            block = grey[j * step : (j + 1) * step, i * step : (i + 1) * step]
            is_partial = block.size < step * step
            occupied = is_partial or (block == WALL).any()
            unknown[i, j] = not occupied and (block == UNKNOWN).any()
            cell[i, j] = occupied or (unknown[i, j] and not unknown_is_free)
    return cell, unknown


@pytest.mark.parametrize("unknown", ["obstacle", "free"])
def test_a_coarse_cell_is_free_only_if_all_its_cells_are(tmp_path, unknown, monkeypatch):
    monkeypatch.setattr("resgrid.scene.maps.preparation._CELLS_PER_BAND", 100)
    rng = np.random.default_rng(7)
    for step in (1, 2, 3, 5, 31):
        grey = random_map(rng, border=1)
        scene = rg.read_scene(write(tmp_path, grey), coarsen=step, unknown=unknown)
        cell, mask = coarse_reference(grey, step, unknown == "free")
        assert (scene.map.cell == cell).all() and (scene.map.unknown == mask).all()
        assert np.allclose([axis.spacing for axis in scene.axes], 0.1 * step)
        assert [axis.lower for axis in scene.axes] == [-1.0, 2.0]


@pytest.mark.parametrize(("crop", "size", "most"), [(None, "44 x 31", 31), ((3.05, 2.05, 3.35, 5.05), "4 x 31", 4)])
def test_joining_more_cells_than_the_map_has_is_one_error(tmp_path, crop, size, most):
    file = write(tmp_path, np.full((31, 44), FREE))
    words = rf"map.yaml: map\.coarsen = 1000 exceeds the size of the map, {size} cells: .*; give at most {most}$"
    with pytest.raises(rg.InputError, match=words):
        rg.read_scene(file, coarsen=1000, crop=crop)
    assert not (rg.read_scene(file, coarsen=most, crop=crop).map.cell == 1).all()
    shown = call("info", file, "--coarsen", 1000)
    assert shown.exit_code == 2 and shown.stderr.count("\n") == 1


def test_a_coarse_cell_has_the_smallest_conductivity(tmp_path):
    grey = np.random.default_rng(2).integers(130, 255, size=(12, 9))
    file = write(tmp_path, grey, mode="scale", occupied_thresh=0.9, free_thresh=0.05)
    fine, coarse = (rg.read_scene(file, least_conductivity=0.01, coarsen=step).map.conductivity for step in (1, 3))
    assert fine.shape == (9, 12) and len(np.unique(fine)) > 20
    assert (coarse == fine.reshape(3, 3, 4, 3).min(axis=(1, 3))).all()


def test_crop_precedes_coarsen_and_obstacles_outside_still_count(tmp_path):
    """Every free cell of the coarse part consists of cells that are free in the whole map, for the same robot."""
    rng = np.random.default_rng(11)
    for _ in range(20):
        grey = random_map(rng, border=0)
        grey = np.where(rng.random(grey.shape) < 0.7, FREE, grey)
        file = write(tmp_path, grey)
        robot, step = rg.PointRobot(float(rng.choice([0.0, 0.12]))), int(rng.integers(2, 5))
        box = (0.0, 3.0, float(rng.uniform(0.5, 2.5)), float(rng.uniform(3.5, 4.8)))
        whole = rg.build_space(rg.read_scene(file, robot=robot), require_goal=False)
        document = rg.read_scene(file, crop=box, coarsen=step)
        part = apply_overrides(document, {"robot.radius": robot.radius})
        assert part.axes[0].lower == pytest.approx(0.0) and part.axes[1].lower == pytest.approx(3.0)
        space = rg.build_space(part, require_goal=False)
        for cell in np.argwhere(space.cell == rg.Cell.FREE):
            first = np.array((10, 10)) + cell * step
            block = whole.cell[first[0] : first[0] + step, first[1] : first[1] + step]
            assert block.size == step * step and not block.any()


def test_refined_cells_repeat_the_cells_of_the_map(tmp_path):
    grey = random_map(np.random.default_rng(13))
    file = write(tmp_path, grey, 0.2)
    whole, fine = rg.read_scene(file), rg.read_scene(file, refine=3)
    assert (fine.map.cell == whole.map.cell.repeat(3, axis=0).repeat(3, axis=1)).all()
    assert (fine.map.unknown == whole.map.unknown.repeat(3, axis=0).repeat(3, axis=1)).all()
    assert [axis.upper for axis in fine.axes] == [axis.upper for axis in whole.axes] and fine.frame == whole.frame
    box = rg.read_scene(file, refine=3, crop=(0, 3, 1, 4))
    rough = rg.read_scene(file, crop=(0, 3, 1, 4))
    assert (box.map.cell == rough.map.cell.repeat(3, axis=0).repeat(3, axis=1)).all()


@pytest.mark.parametrize("keys", [{"crop": (0.0, 3.0, 2.0, 4.5)}, {"coarsen": 2}, {"refine": 2}, {"crop": "known"}])
def test_goals_starts_and_areas_stay_where_they_are_in_the_world(tmp_path, keys):
    grey = np.full((30, 40), UNKNOWN)
    grey[4:-4, 4:-4] = FREE
    file = write(tmp_path, grey, yaw=0.1)
    area = rg.CostArea(rg.Ball((1.0, 4.0), 0.3), 0.25)
    scene = rg.read_scene(file, goal=(1.7, 4.1), start=(0.5, 3.5), areas=(area,), **keys)
    space = rg.build_space(scene)
    (goal,) = np.argwhere(space.cell == rg.Cell.GOAL)
    assert np.abs(space.centre(goal) - (1.7, 4.1)).max() <= 0.1 * keys.get("coarsen", 1)
    slow = space.centre(np.argwhere(space.conductivity == 0.25))
    assert len(slow) and np.allclose(slow.mean(axis=0), (1.0, 4.0), atol=0.06)
    path = rg.plan(scene).paths()[0]
    rg.certify(path)
    assert path.points[0] == pytest.approx((0.5, 3.5)) and path.points[-1] == pytest.approx((1.7, 4.1))


def test_preparation_applies_to_pictures_arrays_and_movingai_maps(tmp_path):
    cell = np.zeros((12, 9), np.uint8)
    cell[5, 5] = rg.Cell.OBSTACLE
    cell[10, 2] = rg.Cell.GOAL
    np.save(tmp_path / "cells.npy", cell)
    scene = rg.read_scene(tmp_path / "cells.npy", crop=(4, 0, 12, 9), coarsen=2, spacing=1.0)
    assert scene.map.cell.shape == (4, 5) and scene.map.cell[0, 2] == rg.Cell.OBSTACLE
    assert scene.map.cell[3, 1] == rg.Cell.GOAL and (scene.map.cell[:, 4] == rg.Cell.OBSTACLE).all()
    (tmp_path / "a.map").write_text("type octile\nheight 2\nwidth 3\nmap\n..@\n...\n")
    assert rg.read_scene(tmp_path / "a.map", refine=2).map.cell.shape == (6, 4)
    with pytest.raises(rg.InputError, match=r"has no unknown cells; give the part as a box"):
        rg.read_scene(tmp_path / "a.map", crop="known")
    np.save(tmp_path / "voxels.npy", np.zeros((4, 5, 6), np.uint8))
    assert rg.read_scene(tmp_path / "voxels.npy", crop=(0, 1, 2, 2, 3, 4)).map.cell.shape == (2, 2, 2)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"crop": (0, 0, 1)}, "needs 4 numbers"),
        ({"crop": (0, 4, -1, 5)}, "the lower corner comes first"),
        ({"crop": (100, 100, 101, 101)}, r"lies outside the map, which extends over x in \[-1, 3\]"),
        ({"coarsen": 2, "refine": 2}, "exclude each other"),
        ({"coarsen": 0}, "map.coarsen"),
        ({"crop": "unknown"}, "map.crop"),
        ({"crop": (0, 3, 1, 4), "periodic": ["x"]}, "would cut the periodic axis 'x'"),
        ({"coarsen": 7, "periodic": ["x"]}, "would cut the periodic axis 'x'"),
    ],
)
def test_invalid_preparations_are_rejected_with_the_file_and_the_key(tmp_path, keys, message):
    file = write(tmp_path, np.full((30, 40), FREE))
    with pytest.raises(rg.InputError, match=message) as error:
        rg.read_scene(file, **keys)
    assert "map.yaml" in str(error.value) and str(error.value).count("map.yaml") == 1


def test_a_larger_robot_reads_the_map_again(tmp_path):
    file = write(tmp_path, random_map(np.random.default_rng(4), border=1))
    scene = rg.read_scene(file, crop=(0, 3, 2, 4))
    with pytest.raises(rg.InputError, match="read the scene again with this robot"):
        scene.map.space_of(rg.PointRobot(0.3))
    replaced = scene.replace(robot=rg.PointRobot(0.3))
    text = f'schema = 1\nrobot.radius = 0.3\n[map]\nfile = "{file}"\ncrop = [0, 3, 2, 4]\n'
    direct = rg.parse_scene(text.replace("robot.radius = 0.3", 'robot = { type = "disc", radius = 0.3 }'))
    changed = apply_overrides(scene, {"robot.radius": 0.3})
    spaces = [rg.build_space(one, require_goal=False).cell for one in (direct, changed, replaced)]
    assert (spaces[0] == spaces[1]).all() and (spaces[0] == spaces[2]).all()
    assert (spaces[0] != rg.build_space(scene, require_goal=False).cell).any()


@pytest.mark.parametrize("suffix", ["pgm", "png"])
def test_a_mostly_unknown_map_is_read_without_two_full_copies(tmp_path, suffix):
    grey = np.full((3000, 4000), UNKNOWN, dtype=np.uint8)
    grey[1400:1500, 900:1200] = FREE
    file = write(tmp_path, grey, suffix=suffix)
    tracemalloc.start()
    try:
        scene = rg.read_scene(file, crop="known")
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert scene.map.cell.shape == (300, 100) and not scene.map.cell.any()
    assert peak < 1.9 * grey.size


def test_maps_that_do_not_fit_name_the_numbers_of_cells_that_remain(tmp_path, monkeypatch):
    grey = np.full((400, 600), UNKNOWN)
    grey[100:150, 200:300] = FREE
    file = write(tmp_path, grey)
    monkeypatch.setattr("resgrid.scene.maps.preparation._CELLS_PER_BAND", 10_000)
    monkeypatch.setattr("resgrid._internal.memory.available_memory", lambda: 24 * 600 * 400 / 8.5)
    with pytest.raises(rg.BudgetError, match=r"--crop known leaves 100 x 50 cells, or --coarsen 3 leaves 200 x 134"):
        rg.read_scene(file)
    for keys, shape in (({"crop": "known"}, (100, 50)), ({"coarsen": 3}, (200, 134))):
        assert rg.read_scene(file, **keys).map.cell.shape == shape


def test_passages_that_are_too_narrow_for_the_cells_name_a_finer_division(tmp_path):
    """A disc of radius 0.16 m fits through a gap of 0.4 m, but not on cells of 0.1 m; 0.05 m: not on coarse cells."""
    grey = np.full((30, 60), FREE)
    grey[:, 30] = WALL
    grey[14:18, 30] = FREE
    file = write(tmp_path, grey, resolution=0.1)
    words = ("path", file, "--goal", "4.5,3.55", "--start=-0.5,3.55", "--robot-radius", "0.16")
    failed = call(*words)
    assert failed.exit_code == 1 and "--refine 4 opens a path, with 240 x 120 cells" in failed.stdout
    assert call(*words, "--refine", "4").exit_code == 0
    words = (*words[:-1], "0.05")
    failed = call(*words, "--coarsen", "4")
    assert failed.exit_code == 1 and "--coarsen 1 opens a path, with 60 x 30 cells" in failed.stdout
    assert call(*words).exit_code == 0


@pytest.mark.parametrize("command", ["info", "path", "run", "plot", "compile", "solve", "control", "check"])
@pytest.mark.quick_cases(2)
def test_every_subcommand_prepares_the_map(tmp_path, command):
    grey = np.full((20, 30), UNKNOWN)
    grey[4:-4, 4:-4] = FREE
    file = write(tmp_path, grey)
    output = {"info": (), "check": ()}.get(command, ("-o", tmp_path / "result"))
    output = {
        "plot": ("-o", tmp_path / "a.png"), "compile": ("-o", tmp_path / "a.cir"), "solve": ("-o", tmp_path / "a.npz"),
        "path": ("-o", tmp_path / "a.csv"), "control": ("-o", tmp_path / "a.csv"),
    }.get(command, output)  # fmt: skip
    words = (command, file, "--goal", "1.1,3.1", "--start=-0.2,2.8", "--crop=-0.6,2.4,1.6,3.6", "--coarsen", "2")
    done = call(*words, "--boundary", "dirichlet", *output)
    assert done.exit_code in (0, 3), done.stderr  # 3: no simulator
    assert call(command, file, "--crop", "everything", *output).exit_code == 2
    if command == "info":
        assert "11 x 6 = 66 cells" in done.stdout and "--crop -0.6,2.4,1.6,3.6, then --coarsen 2" in done.stdout
