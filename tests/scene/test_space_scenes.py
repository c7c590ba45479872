"""Scenes with obstacles in space: keys, files, error messages, changes by options, and links.

Tests internals: `resgrid.live_page.opening`, `resgrid.scene` (`overrides`, `reading`, `schema`).
"""

from __future__ import annotations

import base64
import json
import sys
import zlib
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from support.cli import answer, call
from support.space_shapes import CUBE, FACES

import resgrid as rg
from resgrid.live_page.opening import open_document
from resgrid.scene.overrides import apply_overrides, document_of
from resgrid.scene.reading import link_document

SCENE = """schema = 1
robot = { type = "point", radius = 0.05 }
starts = [[0.1, 0.1, 0.1]]
goal = [{ point = [1.9, 1.9, 0.9] }]
grid.axes = [
  { name = "x", lower = 0, upper = 2, cells = 12 },
  { name = "y", lower = 0, upper = 2, cells = 12 },
  { name = "z", lower = 0, upper = 1, cells = 6 },
]
[[obstacle]]
shape = "cylinder"
start = [1, 1, 0]
end = [1, 1, 1]
radius = 0.3
[[obstacle]]
shape = "capsule"
start = [0.2, 0.6, 0.5]
end = [0.4, 0.6, 0.5]
radius = 0.1
[[obstacle]]
shape = "oriented_box"
centre = [1.5, 0.4, 0.5]
size = [0.4, 0.2, 0.3]
rotation = [0, 0, 0.7]
"""
FILES = """[[obstacle]]
shape = "mesh"
file = "crate.stl"
scale = 0.001
position = [0.2, 1.2, 0.0]
pieces = 2
[[obstacle]]
shape = "point_cloud"
file = "scans/scan.pcd"
resolution = 0.1
[[obstacle]]
shape = "octomap"
file = "map.bt"
unknown = "obstacle"
lower = [0.5, 1.5, 0.2]
"""


@pytest.fixture
def room(tmp_path: Path) -> Path:
    """A scene with all shapes in space, and its files."""
    trimesh, octomap = import_module("trimesh"), import_module("octomap")
    trimesh.Trimesh(CUBE * 400, FACES, process=False).export(tmp_path / "crate.stl")
    tree = octomap.OcTree(0.1)
    for x in (0.55, 0.65, 0.75):
        tree.updateNode(np.array([x, 1.65, 0.35]), True)
    tree.writeBinary(str(tmp_path / "map.bt").encode())
    (tmp_path / "scans").mkdir()
    head = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 2\nHEIGHT 1\nDATA ascii\n"
    (tmp_path / "scans" / "scan.pcd").write_text(head + "1.75 1.05 0.55\n1.75 1.15 0.55\n")
    (tmp_path / "room.toml").write_text(SCENE + FILES)
    return tmp_path / "room.toml"


def test_a_scene_holds_the_shapes_of_its_tables_and_files(room: Path) -> None:
    scene = rg.read_scene(room)
    cylinder, capsule, box, mesh, cloud, octomap = scene.obstacles
    assert cylinder == rg.Cylinder((1.0, 1.0, 0.0), (1.0, 1.0, 1.0), 0.3)
    assert capsule == rg.Capsule((0.2, 0.6, 0.5), (0.4, 0.6, 0.5), 0.1)
    assert box == rg.OrientedBox((1.5, 0.4, 0.5), (0.4, 0.2, 0.3), (0.0, 0.0, 0.7))
    assert isinstance(mesh, rg.Mesh) and mesh.is_closed and mesh.pieces == 2
    np.testing.assert_allclose(mesh.bounds, [[0.2, 1.2, 0.0], [0.6, 1.6, 0.4]])
    assert isinstance(cloud, rg.Voxels) and cloud.count == 2
    assert isinstance(octomap, rg.Voxels) and octomap.count == 3 * 2 * 2
    blocked = rg.build_space(scene).cell == rg.Cell.OBSTACLE
    same = rg.PointRobot(0.05).occupancy(scene.axes, list(scene.obstacles), "conservative")
    np.testing.assert_array_equal(blocked, same)


def test_a_path_among_shapes_in_space_is_found(room: Path) -> None:
    paths = answer("path", room)["paths"]
    assert [path["outcome"] for path in paths] == ["reached"]
    points = np.array(paths[0]["points"])
    assert (np.hypot(points[:, 0] - 1.0, points[:, 1] - 1.0) > 0.35).all()
    outcome = answer("path", room, "--set", "obstacle[0].radius=0.9", code=1)["paths"][0]["outcome"]
    assert outcome == "no_path"


def test_a_scene_is_the_same_after_changes_of_other_keys(room: Path) -> None:
    scene = rg.read_scene(room)
    changed = apply_overrides(scene, {"robot.radius": 0.1, "obstacle[4].resolution": 0.05})
    assert [type(shape) for shape in changed.obstacles] == [type(shape) for shape in scene.obstacles]
    assert changed.obstacles[4].size == 0.05 and changed.robot == rg.PointRobot(0.1)
    assert document_of(changed)["obstacle"][3]["file"] == str(room.parent / "crate.stl")
    own = scene.replace(obstacles=(rg.Voxels.of_cells([[0, 0, 0]], 0.1),))
    with pytest.raises(rg.InputError, match="a scene file describes a Voxels by its file"):
        document_of(own)


def test_a_changed_file_is_read_again(room: Path) -> None:
    assert rg.read_scene(room).obstacles[4].count == 2
    scan = room.parent / "scans" / "scan.pcd"
    scan.write_text(scan.read_text().replace("WIDTH 2", "WIDTH 3") + "1.95 1.15 0.55\n")
    assert rg.read_scene(room).obstacles[4].count == 3


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("crate.stl", "crates.stl", "line 25: obstacle[3]: {folder}/crates.stl: there is no such file"),
        ("crate.stl", "crate.3ds", "unknown mesh format '.3ds'; convert the mesh to one of .stl"),
        ('file = "crate.stl"\n', "", "line 25: obstacle[3].file: this key is missing; add it"),
        ('"crate.stl"', '""', "obstacle[3].file: must not be empty"),
        ('"crate.stl"', "3", "obstacle[3].file: must be text in quotes"),
        ("scale = 0.001", "scale = -1", "obstacle[3].scale: must be greater than 0, got -1"),
        ("pieces = 2", "pices = 2", "obstacle[3].pices: unknown key; did you mean 'pieces'?"),
        ("resolution = 0.1\n", "", "obstacle[4].resolution: this key is missing; add it"),
        ("resolution = 0.1", "resolution = 1e-30", "voxels of 1e-30 are too narrow for floating point"),
        ('"obstacle"\nlower', '"solid"\nlower', "obstacle[5].unknown: 'solid' is unknown: it may be free or obstacle"),
        ("lower = [0.5, 1.5, 0.2]", "lower = [5, 5, 5]", "no voxel of this OctoMap is an obstacle in the clip box"),
        ("lower = [0.5, 1.5, 0.2]", "lower = [5, 5]", "obstacle[5].lower: needs at least 3 entries, got 2"),
        ("radius = 0.3", "radius = -1", "obstacle[0].radius: must be greater than 0, got -1"),
        ("end = [1, 1, 1]", "end = [1, 1, 0]", "line 10: obstacle[0]: the ends of a cylinder must differ"),
        ("end = [1, 1, 1]", "end = [1, 1]", "obstacle[0].end: needs at least 3 entries, got 2"),
        ("size = [0.4,", "size = [0.0,", "obstacle[2].size[0]: must be greater than 0, got 0.0"),
        ('"cylinder"', '"cilinder"', "shape = 'cilinder' is unknown: it may be one of rectangle, box,"),
        ('{ point = [1.9, 1.9, 0.9] }', '{ shape = "capsule" }', "goal[0]: shape = 'capsule' is unknown"),
    ],
)  # fmt: skip
def test_an_invalid_key_has_one_message(room: Path, old: str, new: str, words: str) -> None:
    text = room.read_text()
    assert old in text
    room.write_text(text.replace(old, new, 1))
    result = call("path", room)
    assert result.exit_code == 2 and result.stderr.count("error:") == 1
    assert words.format(folder=room.parent) in result.stderr


def test_a_plane_rejects_shapes_in_space(room: Path) -> None:
    text = room.read_text().replace('  { name = "z", lower = 0, upper = 1, cells = 6 },\n', "")
    text = text.replace("[0.1, 0.1, 0.1]", "[0.1, 0.1]").replace("[1.9, 1.9, 0.9]", "[1.9, 1.9]")
    with pytest.raises(rg.InputError) as caught:
        rg.parse_scene(text, folder=room.parent)
    words = "a shape in space has 3 coordinates, but this workspace has 2; use another shape"
    assert str(caught.value).count(words) == 6


def test_a_link_cannot_name_files_of_obstacles(room: Path) -> None:
    document = {"schema": 1, "obstacle": [{"shape": "mesh", "file": "/etc/hostname"}]}
    code = base64.urlsafe_b64encode(zlib.compress(json.dumps(document).encode())).decode()
    with pytest.raises(rg.InputError, match="needs the file of a map, mask or obstacle, which a link cannot contain"):
        link_document(f"http://localhost/#s={code}")
    with pytest.raises(rg.InputError, match="needs files of obstacles, to which the page has no access"):
        open_document(document)


def test_areas_may_be_shapes_in_space(room: Path) -> None:
    area = '[[area]]\nshape = "cylinder"\nstart = [1, 1, 0]\nend = [1, 1, 1]\nradius = 0.6\nconductivity = 0.5\n'
    space = rg.build_space(rg.parse_scene(room.read_text() + area, folder=room.parent))
    assert space.conductivity is not None
    assert set(np.unique(space.conductivity)) == {0.5, 1.0}


def test_a_scene_without_the_extra_names_the_command(room: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trimesh = import_module("trimesh")
    trimesh.Trimesh(CUBE * 400, FACES, process=False).export(room.parent / "crate.ply")
    room.write_text(room.read_text().replace("crate.stl", "crate.ply"))
    monkeypatch.setitem(sys.modules, "trimesh", None)
    result = call("path", room)
    assert result.exit_code == 3
    assert "crate.ply: PLY files need trimesh" in result.stderr and "pip install" in result.stderr
