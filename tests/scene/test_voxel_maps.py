"""OctoMaps, point clouds and voxel maps as maps, compared with octomap-python, scipy and loops over voxels.

Tests internals: `resgrid.robots.box_distances`, `resgrid.scene.maps`.
"""

from __future__ import annotations

import tracemalloc
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage
from support.cli import answer, call

import resgrid as rg
from resgrid.robots.box_distances import distance_from_boxes, near_boxes
from resgrid.scene.maps import voxel_parts
from resgrid.scene.maps.formats import read_map

octomap = import_module("octomap")  # without types

FREE, OBSTACLE = rg.Cell.FREE, rg.Cell.OBSTACLE
WIDTH = 0.25


def tree_of(occupied: NDArray[np.bool_], known: NDArray[np.bool_], corner: tuple[int, int, int]) -> Any:
    """Return an OctoMap with voxels of width 0.25, whose first voxel is `corner`, in voxels from the origin."""
    tree = octomap.OcTree(WIDTH)
    for voxel in np.argwhere(known):
        tree.updateNode((voxel + corner + 0.5) * WIDTH, bool(occupied[tuple(voxel)]))
    tree.updateInnerOccupancy()
    return tree


def random_rooms(rng: np.random.Generator, shape: tuple[int, int, int] = (17, 12, 9)) -> list[NDArray[np.bool_]]:
    """Return occupied and known voxels: blocks, so that the tree has leaves of several sizes; all corners are known."""
    coarse = [-(-size // 4) for size in shape]
    known = np.kron(rng.random(coarse) < 0.7, np.ones((4, 4, 4)))[: shape[0], : shape[1], : shape[2]].astype(bool)
    known[0, 0, 0] = known[-1, -1, -1] = True
    return [(rng.random(shape) < 0.1) & known, known]


def write(folder: Path, rng: np.random.Generator) -> tuple[Path, NDArray[np.bool_], NDArray[np.bool_]]:
    occupied, known = random_rooms(rng)
    tree_of(occupied, known, (-5, 3, -2)).writeBinary(str(folder / "rooms.bt").encode())
    tree_of(occupied, known, (-5, 3, -2)).write(str(folder / "rooms.ot").encode())
    return folder / "rooms.bt", occupied, known


@pytest.mark.parametrize("unknown", ["obstacle", "free"])
@pytest.mark.parametrize("suffix", [".bt", ".ot"])
def test_an_octomap_has_the_cells_of_the_octomap_library(tmp_path: Path, unknown: str, suffix: str) -> None:
    file, occupied, known = write(tmp_path, np.random.default_rng(3))
    scene = rg.read_scene(file.with_suffix(suffix), unknown=unknown)
    assert scene.map is not None and scene.map.unknown is not None
    np.testing.assert_allclose([(axis.lower, axis.spacing) for axis in scene.axes][1], (0.75, WIDTH))
    assert [axis.unit for axis in scene.axes] == ["m", "m", "m"]
    np.testing.assert_array_equal(scene.map.unknown, ~known)
    expected = occupied | ~known if unknown == "obstacle" else occupied
    np.testing.assert_array_equal(scene.map.cell == OBSTACLE, expected)
    tree = octomap.OcTree(str(file).encode())
    for cell in np.argwhere(known)[::7]:
        place = [axis.centres[index] for axis, index in zip(scene.axes, cell, strict=True)]
        assert bool(tree.isNodeOccupied(tree.search(np.array(place)))) == bool(scene.map.cell[tuple(cell)])


def test_probabilities_of_an_octomap_have_a_threshold(tmp_path: Path) -> None:
    tree = octomap.OcTree(1.0)
    for x, hits in enumerate((1, 2, 4)):
        for _ in range(hits):
            tree.updateNode(np.array([x + 0.5, 0.5, 0.5]), True)
    chances = [tree.search(np.array([x + 0.5, 0.5, 0.5])).getOccupancy() for x in range(3)]
    tree.write(str(tmp_path / "a.ot").encode())
    for threshold in (0.5, 0.8, 0.95, 0.99):
        scene = rg.read_scene(tmp_path / "a.ot", occupied=threshold)
        assert scene.map is not None
        assert (scene.map.cell[:, 0, 0] == OBSTACLE).tolist() == [chance >= threshold for chance in chances]


@pytest.mark.parametrize("radius", [0.0, 0.1, 0.3, 0.6])
@pytest.mark.parametrize("sampling", ["conservative", "centre"])
def test_a_cropped_map_has_the_free_cells_of_the_whole_one(tmp_path: Path, radius: float, sampling: str) -> None:
    rng = np.random.default_rng(int(10 * radius))
    file, *_ = write(tmp_path, rng)
    options = {"robot": rg.PointRobot(radius), "sampling": sampling}
    whole = rg.build_space(rg.read_scene(file, **options), require_goal=False)
    for _ in range(8):
        first = rng.integers(0, [12, 8, 6])
        end = first + rng.integers(1, [5, 4, 3], endpoint=True)
        corner = np.array([-5, 3, -2])
        box = [*(first + corner + 0.1) * WIDTH, *(end + corner - 0.1) * WIDTH]
        cells = read_map({"file": str(file), "crop": box}, radius)
        scene = rg.read_scene(file, **options)
        part = rg.build_space(scene.replace(map=cells, axes=cells.axes, edge="obstacle"), require_goal=False)
        at = tuple(slice(a, b) for a, b in zip(first, end, strict=True))
        np.testing.assert_array_equal(part.cell, whole.cell[at])


def test_free_cells_of_a_ball_agree_with_a_distance_transform_of_finer_cells(tmp_path: Path) -> None:
    """Distances of fine centres are too large by at most one diagonal of a fine cell."""
    occupied = np.random.default_rng(8).random((17, 12, 9)) < 0.01
    tree_of(occupied, np.ones_like(occupied), (-5, 3, -2)).writeBinary(str(tmp_path / "a.bt").encode())
    apart = ndimage.distance_transform_edt(~np.kron(occupied, np.ones((3, 3, 3))).astype(bool), sampling=WIDTH / 3)
    nearest = apart.reshape(17, 3, 12, 3, 9, 3).min(axis=(1, 3, 5))
    for radius in (0.2, 0.4):
        space = rg.build_space(rg.read_scene(tmp_path / "a.bt", robot=rg.PointRobot(radius)), require_goal=False)
        is_free = space.cell == FREE
        assert (nearest[is_free] > radius).all() and is_free.sum() > 200
        assert is_free[nearest > radius + 3**0.5 * WIDTH / 3].all()


def test_coarse_and_fine_cells_and_the_known_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, occupied, known = write(tmp_path, np.random.default_rng(5))
    monkeypatch.setattr("resgrid.scene.maps.preparation._CELLS_PER_BAND", 500)
    coarse = rg.read_scene(file, coarsen=3).map
    padded = np.pad(occupied, [(0, 1), (0, 0), (0, 0)], constant_values=True)
    unseen = np.pad(~known, [(0, 1), (0, 0), (0, 0)])
    blocks = [values.reshape(6, 3, 4, 3, 3, 3).any(axis=(1, 3, 5)) for values in (padded, unseen)]
    assert coarse is not None and coarse.unknown is not None
    np.testing.assert_array_equal(coarse.cell == OBSTACLE, blocks[0] | blocks[1])
    np.testing.assert_array_equal(coarse.unknown, blocks[1] & ~blocks[0])
    fine = rg.read_scene(file, refine=2).map
    assert fine is not None
    np.testing.assert_array_equal(fine.cell[::2, 1::2, ::2], rg.read_scene(file).map.cell)
    assert rg.read_scene(file, crop="known").axes == rg.read_scene(file).axes


def test_a_cloud_blocks_the_voxels_that_contain_a_point(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    points = rng.uniform(-1.0, 2.0, (200, 3))
    head = f"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH {len(points)}\nHEIGHT 1\nDATA ascii\n"
    (tmp_path / "a.pcd").write_text(head + "\n".join(f"{x:.7f} {y:.7f} {z:.7f}" for x, y, z in points))
    scene = rg.read_scene(tmp_path / "a.pcd", spacing=0.3)
    assert scene.map is not None
    lower = np.array([axis.lower for axis in scene.axes])
    own = np.floor((points - lower) / 0.3 + 1e-9).astype(int)
    expected = np.zeros(scene.map.cell.shape, dtype=bool)
    expected[tuple(own.T)] = True
    np.testing.assert_array_equal(scene.map.cell == OBSTACLE, expected)
    np.testing.assert_allclose(lower / 0.3, np.floor(points.min(axis=0) / 0.3), atol=1e-9)
    turned = rg.parse_scene(
        'schema = 1\n[map]\nfile = "a.pcd"\nspacing = 300\nscale = 1000\nrotation = [0, 0, 3.141592653589793]\n',
        folder=tmp_path,
    )
    np.testing.assert_allclose(turned.axes[0].upper, np.ceil(-points[:, 0].min() / 0.3) * 300)


def test_only_the_cropped_part_of_a_huge_map_becomes_an_array(tmp_path: Path) -> None:
    (tmp_path / "huge.3dmap").write_text("voxel 60000 60000 60000\n7 8 9\n40000 2 3\n")
    with pytest.raises(
        rg.BudgetError, match=r"GiB is free; --crop X0,Y0,Z0,X1,Y1,Z1 keeps .*, or --coarsen \d+ leaves"
    ):
        rg.read_scene(tmp_path / "huge.3dmap")
    tracemalloc.start()
    part = rg.read_scene(tmp_path / "huge.3dmap", crop=(5, 5, 5, 105, 105, 105))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert part.map is not None and np.argwhere(part.map.cell == OBSTACLE).tolist() == [[2, 3, 4]]
    assert peak < 12e6


def test_cubes_of_all_sizes_are_filled_and_clipped() -> None:
    rng = np.random.default_rng(11)
    for _ in range(20):
        cubes = np.column_stack([rng.integers(-9, 20, (40, 3)), rng.integers(1, 8, 40)]).astype(np.int32)
        out, reference = np.zeros((13, 9, 11), np.uint8), np.zeros((13, 9, 11), np.uint8)
        begin = rng.integers(-4, 5, 3).tolist()
        voxel_parts._fill(out, cubes, begin, 1)
        for x, y, z, width in cubes - [*begin, 0]:
            reference[max(x, 0) : max(x + width, 0), max(y, 0) : max(y + width, 0), max(z, 0) : max(z + width, 0)] = 1
        np.testing.assert_array_equal(out, reference)


@pytest.mark.parametrize("rule", ["conservative", "centre"])
def test_distances_in_bands_are_those_of_the_whole_grid(monkeypatch: pytest.MonkeyPatch, rule) -> None:
    monkeypatch.setattr("resgrid.robots.box_distances._CELLS_AT_ONCE", 60)
    rng = np.random.default_rng(6)
    for _ in range(12):
        mask, spacing, reach = rng.random((23, 5, 4)) < 0.03, rng.uniform(0.2, 1.0, 3), rng.uniform(0.0, 3.0)
        whole = distance_from_boxes(mask, spacing, rule) <= reach if mask.any() else mask
        np.testing.assert_array_equal(near_boxes(mask, spacing, reach, rule), whole)


def test_commands_take_an_octomap_as_they_take_a_map(tmp_path: Path) -> None:
    occupied = np.zeros((8, 6, 5), dtype=bool)
    occupied[4, :5] = True
    known = np.ones_like(occupied)
    tree_of(occupied, known, (0, 0, 0)).writeBinary(str(tmp_path / "hall.bt").encode())
    file = tmp_path / "hall.bt"
    ends = ("--goal", "1.75,0.2,0.4", "--start", "0.2,0.3,0.6")
    data = answer("info", file)
    assert data["shape"] == [8, 6, 5] and data["map"]["format"] == "octomap" and data["map"]["unknown_cells"] == 0
    assert data["no_circuit"] == "no goal; give --goal X,Y,Z"
    path = answer("path", file, *ends)["paths"][0]
    assert path["outcome"] == "reached" and min(point[1] for point in path["points"]) < 1.25 < max(
        point[1] for point in path["points"]
    )
    assert call("compile", file, *ends[:2], "-o", tmp_path / "hall.cir").exit_code == 0
    assert call("path", file, *ends, "--robot-radius", "0.3").exit_code == 1  # the gap is one voxel
    piped = answer("path", "-", *ends, piped=file.read_bytes())["paths"][0]
    assert piped["points"] == path["points"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"crop": (0, 0, 1, 1)}, r"rooms\.bt: map\.crop needs 6 numbers"),
        ({"crop": (50, 0, 0, 60, 1, 1)}, "this box lies outside the map, which extends over x in "),
        ({"coarsen": 10}, r"map\.coarsen = 10 exceeds the size of the map, 17 x 12 x 9 cells: .* give at most 9"),
        ({"spacing": 0.1}, r"rooms\.bt: map\.spacing: a map of format 'octomap' has no such option"),
        ({"occupied": 1.0}, r"map\.occupied: must be below 1"),
        ({"unknown": "maybe"}, r"map\.unknown"),
        (
            {"robot": rg.PolygonRobot(((-0.1, -0.1), (0.1, -0.1), (0.0, 0.1)))},
            "moves in the plane, but this map has .* x, y, z",
        ),
        ({"robot": rg.DiscRobot(0.1)}, "a disc moves in the plane and needs 2 axes, got 3"),
    ],
)
def test_options_that_do_not_fit_an_octomap_have_one_message(tmp_path: Path, options, words: str) -> None:
    file, *_ = write(tmp_path, np.random.default_rng(1))
    with pytest.raises(rg.InputError, match=words):
        rg.build_space(rg.read_scene(file, **options), require_goal=False)


def test_a_cloud_needs_a_width_of_voxels_and_has_no_unknown_ones(tmp_path: Path) -> None:
    head = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 2\nHEIGHT 1\nDATA ascii\n0 0 0\n4 1 1\n"
    (tmp_path / "a.pcd").write_text(head)
    with pytest.raises(rg.InputError, match=r"give their width, such as spacing = 0\.04 \(--spacing 0\.04\) .* 4$"):
        rg.read_scene(tmp_path / "a.pcd")
    with pytest.raises(rg.InputError, match=r"has no unknown cells; .* \(--crop 0,0,0,10,5,3\)"):
        rg.read_scene(tmp_path / "a.pcd", spacing=0.5, crop="known")
    (tmp_path / "a.bt").write_bytes(b"ply\nformat ascii 1.0\n")
    with pytest.raises(rg.InputError, match=r"a\.bt: this is not an OctoMap"):
        rg.read_scene(tmp_path / "a.bt")


def test_a_mesh_read_as_a_cloud_has_a_warning(tmp_path: Path) -> None:
    head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    faces = "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    (tmp_path / "a.ply").write_text(head + faces)
    with pytest.warns(UserWarning, match="of this mesh of 1 faces only vertices count"):
        scene = rg.read_scene(tmp_path / "a.ply", spacing=0.2)
    assert scene.map is not None and (scene.map.cell == OBSTACLE).sum() == 3
