"""Readers of meshes, point clouds and OctoMaps, compared with trimesh, octomap-python and files written by hand.

Tests internals: `resgrid.scene.solids`.
"""

from __future__ import annotations

import contextlib
import struct
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.space_shapes import CUBE, FACES

import resgrid as rg
from resgrid.scene.solids.pcd import decompress_lzf

POINTS = np.array([[0.05, 0.15, -0.25], [0.95, 0.15, -0.25], [0.05, 0.35, 0.45], [0.07, 0.17, -0.22]])
CELLS = {(0, 1, -3), (9, 1, -3), (0, 3, 4)}
"""Voxels of width 0.1 that contain `POINTS`."""


def cells_of(voxels: rg.Voxels) -> set[tuple[int, ...]]:
    """Return all voxels of the boxes, as indices from the origin."""
    shift = np.rint(np.array(voxels.lower) / voxels.size).astype(int)
    cells: set[tuple[int, ...]] = set()
    for first, last in voxels.boxes + shift:
        block = np.stack(np.meshgrid(*map(np.arange, first, last), indexing="ij"), axis=-1).reshape(-1, 3)
        before = len(cells)
        cells |= set(map(tuple, block.tolist()))
        assert len(cells) == before + len(block), "boxes overlap"
    return cells


# Meshes


def crate(folder: Path, name: str) -> Path:
    trimesh = import_module("trimesh")
    trimesh.Trimesh(CUBE, FACES, process=False).export(folder / name)
    return folder / name


@pytest.mark.parametrize("name", ["a.stl", "a.obj", "a.ply", "a.dae", "A.STL"])
def test_a_mesh_of_every_format_is_a_closed_solid(tmp_path: Path, name: str) -> None:
    file = crate(tmp_path, name.lower()).rename(tmp_path / name)
    mesh = rg.maps.read_mesh(file, scale=2.0, position=(1.0, 0.0, 0.0), rotation=(0.0, 0.0, np.pi / 2), pieces=3)
    assert len(mesh.points) == 8 and len(mesh.triangles) == 12 and mesh.is_closed and mesh.pieces == 3
    np.testing.assert_allclose(mesh.bounds, [[-1, 0, 0], [1, 2, 2]], atol=1e-12)


def test_an_ascii_stl_and_an_obj_with_quads_are_read(tmp_path: Path) -> None:
    trimesh = import_module("trimesh")
    text = trimesh.exchange.stl.export_stl_ascii(trimesh.Trimesh(CUBE, FACES, process=False))
    (tmp_path / "a.stl").write_text(text)
    assert rg.maps.read_mesh(tmp_path / "a.stl").is_closed
    corners = "".join(f"v {x} {y} {z}\n" for x, y, z in CUBE)
    quads = "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
    (tmp_path / "a.obj").write_text(f"mtllib missing.mtl\no first\n{corners}{quads}")
    mesh = rg.maps.read_mesh(tmp_path / "a.obj")
    assert mesh.is_closed and len(mesh.triangles) == 12


def test_a_collada_file_in_centimetres_with_two_placed_parts(tmp_path: Path) -> None:
    trimesh = import_module("trimesh")
    scene = trimesh.Scene()
    box = trimesh.Trimesh(CUBE, FACES, process=False)
    scene.add_geometry(box, node_name="a")
    scene.add_geometry(box.copy(), node_name="b", transform=trimesh.transformations.translation_matrix([5, 0, 0]))
    data = trimesh.exchange.dae.export_collada([*scene.dump()]).decode()
    unit = '<unit name="centimeter" meter="0.01"/><up_axis>'
    (tmp_path / "a.dae").write_text(data.replace("<up_axis>", unit))
    mesh = rg.maps.read_mesh(tmp_path / "a.dae")
    np.testing.assert_allclose(mesh.bounds, [[0, 0, 0], [0.06, 0.01, 0.01]], atol=1e-12)


def test_triangles_that_are_oriented_differently_are_repaired(tmp_path: Path) -> None:
    trimesh = import_module("trimesh")
    faces = np.array(FACES)
    faces[::3] = faces[::3, ::-1]
    trimesh.Trimesh(CUBE, faces, process=False).export(tmp_path / "a.obj")
    assert not rg.Mesh(CUBE, faces).is_closed
    assert rg.maps.read_mesh(tmp_path / "a.obj").is_closed


def test_an_open_mesh_is_a_surface_with_a_warning(tmp_path: Path) -> None:
    trimesh = import_module("trimesh")
    trimesh.Trimesh(CUBE, FACES[:-1], process=False).export(tmp_path / "a.stl")
    with pytest.warns(UserWarning, match=r"not closed \(3 open edges\); .* obstacles without an inside: repair"):
        mesh = rg.maps.read_mesh(tmp_path / "a.stl")
    assert repr(mesh) == "<Mesh of 8 points and 11 triangles, open>"


def test_a_damaged_mesh_prints_nothing(tmp_path: Path) -> None:
    trimesh = import_module("trimesh")
    text = trimesh.exchange.stl.export_stl_ascii(trimesh.Trimesh(CUBE, FACES, process=False))
    (tmp_path / "a.stl").write_text(
        text.replace("facet normal 0", "facet normal zero", 1).replace("normal -", "normal x")
    )
    code = f"import resgrid as rg\ntry: rg.maps.read_mesh({str(tmp_path / 'a.stl')!r})\nexcept rg.InputError: pass"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (shown.stdout, shown.stderr) == ("", "")


def test_a_damaged_mesh_has_one_message(tmp_path: Path) -> None:
    trimesh = import_module("trimesh")
    data = trimesh.exchange.stl.export_stl(trimesh.Trimesh(CUBE, FACES, process=False))
    (tmp_path / "short.stl").write_bytes(data[:300])
    (tmp_path / "nan.stl").write_bytes(data[:100] + struct.pack("<f", np.nan) + data[104:])
    (tmp_path / "empty.obj").write_text("# nothing\n")
    (tmp_path / "cloud.ply").write_bytes(trimesh.PointCloud(CUBE).export(file_type="ply"))
    (tmp_path / "bad.dae").write_text("<COLLADA>")
    for name, words in {
        "missing.stl": "missing.stl: there is no such file",
        "crate.blend": r"unknown mesh format '\.blend'; convert the mesh to one of \.stl",
        "crate": "unknown mesh format ''",
        "short.stl": "cannot be read as STL .*300 bytes",
        "nan.stl": "vertex .* is not finite; repair the mesh",
        "empty.obj": "no triangles|cannot be read",
        "cloud.ply": "has no triangles|cannot be read",
        "bad.dae": "bad.dae",
    }.items():
        with pytest.raises(rg.InputError, match=words):
            rg.maps.read_mesh(tmp_path / name)


@pytest.mark.parametrize("name", ["a.stl", "ascii.stl", "ascii.ply", "binary.ply"])
def test_every_mesh_that_is_cut_short_is_rejected(tmp_path: Path, name: str) -> None:
    trimesh = import_module("trimesh")
    box, exchange = trimesh.Trimesh(CUBE, FACES, process=False), trimesh.exchange
    data = {
        "a.stl": lambda: exchange.stl.export_stl(box),
        "ascii.stl": lambda: exchange.stl.export_stl_ascii(box).encode().rstrip(),
        "ascii.ply": lambda: exchange.ply.export_ply(box, encoding="ascii").rstrip(),
        "binary.ply": lambda: exchange.ply.export_ply(box, encoding="binary"),
    }[name]()
    (tmp_path / name).write_bytes(data)
    assert rg.maps.read_mesh(tmp_path / name).is_closed
    end = len(data) if name in ("a.stl", "binary.ply") else data.rfind(b"\n")  # a text may lack its last digits
    for size in np.linspace(0, end - 1, 40).astype(int):
        (tmp_path / name).write_bytes(data[:size])
        with pytest.raises(rg.InputError):
            rg.maps.read_mesh(tmp_path / name)


# Point clouds

HEAD = (
    "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z intensity\nSIZE {s} 2\nTYPE F F F U\nCOUNT 1 1 1 2\nWIDTH {n}\nHEIGHT 1\n"
)


def records(points: np.ndarray, kind: str) -> np.ndarray:
    made = np.zeros(len(points), dtype=[("x", kind), ("y", kind), ("z", kind), ("i", "<u2", (2,))])
    for name, column in zip("xyz", points.T, strict=True):
        made[name] = column
    made["i"] = np.arange(2 * len(points)).reshape(-1, 2)
    return made


def compress_lzf(data: bytes) -> bytes:
    """Compress bytes greedily by the format of LibLZF."""
    out, literal, at = bytearray(), bytearray(), 0

    def flush() -> None:
        for start in range(0, len(literal), 32):
            part = literal[start : start + 32]
            out.append(len(part) - 1)
            out.extend(part)
        literal.clear()

    while at < len(data):
        length, distance = 0, 0
        for start in range(max(0, at - 8192), at):
            size = 0
            while size < 264 and at + size < len(data) and data[start + size] == data[at + size]:
                size += 1
            if size > length:
                length, distance = size, at - start - 1
        if length < 3:
            literal.append(data[at])
            at += 1
            continue
        flush()
        short = min(length - 2, 7)
        out.append(short << 5 | distance >> 8)
        if short == 7:
            out.append(length - 2 - 7)
        out.append(distance & 255)
        at += length
    flush()
    return bytes(out)


def pcd(points: np.ndarray, encoding: str, kind: str = "<f4") -> bytes:
    size = kind[-1]
    head = HEAD.format(s=" ".join([size] * 3), n=len(points)) + f"POINTS {len(points)}\nDATA {encoding}\n"
    made = records(points, kind)
    if encoding == "ascii":
        rows = (" ".join(map(str, [*row[:3], *row[3]])) for row in made.tolist())
        return (head + "\n".join(rows) + "\n").encode()
    if encoding == "binary":
        return head.encode() + made.tobytes()
    planes = b"".join(made[name].tobytes() for name in made.dtype.names or ())
    packed = compress_lzf(planes)
    return head.encode() + struct.pack("<II", len(packed), len(planes)) + packed


@pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
@pytest.mark.parametrize("kind", ["<f4", "<f8"])
def test_a_pcd_file_of_every_encoding_gives_its_voxels(tmp_path: Path, encoding: str, kind: str) -> None:
    file = tmp_path / "a.pcd"
    file.write_bytes(pcd(np.vstack([POINTS, [[np.nan] * 3]]), encoding, kind))
    voxels = rg.maps.read_point_cloud(file, 0.1)
    assert cells_of(voxels) == CELLS and voxels.size == 0.1
    moved = rg.maps.read_point_cloud(file, 0.1, scale=10.0, position=(0.0, 0.0, 5.0), rotation=(0.0, 0.0, np.pi))
    expected = np.floor((POINTS * [-10, -10, 10] + [0, 0, 5]) / 0.1 + 1e-6)
    if kind == "<f8":
        assert np.abs(np.array(sorted(cells_of(moved))) - np.unique(expected, axis=0)).max() <= 1


def test_a_ply_cloud_gives_its_voxels(tmp_path: Path) -> None:
    trimesh = import_module("trimesh")
    for encoding in ("ascii", "binary"):
        data = trimesh.exchange.ply.export_ply(trimesh.PointCloud(POINTS), encoding=encoding)
        (tmp_path / "a.ply").write_bytes(data)
        assert cells_of(rg.maps.read_point_cloud(tmp_path / "a.ply", 0.1)) == CELLS


@settings(max_examples=40)
@given(st.lists(st.sampled_from([b"a", b"bc", b"resistor", bytes(range(40)), b"\0" * 300]), max_size=30))
def test_lzf_data_is_decompressed(parts: list[bytes]) -> None:
    data = b"".join(parts)
    assert decompress_lzf(compress_lzf(data), len(data)) == data


@given(st.binary(max_size=60))
def test_damaged_lzf_data_ends_without_another_error(data: bytes) -> None:
    with contextlib.suppress(IndexError):
        assert isinstance(decompress_lzf(data, 100), bytes)


def test_a_damaged_cloud_has_one_message(tmp_path: Path) -> None:
    binary, packed = pcd(POINTS, "binary"), pcd(POINTS, "binary_compressed")
    spoilt = bytearray(packed)
    spoilt[-20] ^= 0xFF
    files = {
        "short.pcd": (binary[:-5], "cut short or damaged: it needs 64 bytes, but has 59"),
        "short_ascii.pcd": (pcd(POINTS, "ascii")[:-4], "needs 4 points of 5 numbers, but has 1[89] numbers"),
        "short_packed.pcd": (packed[:-3], "cut short or damaged"),
        "no_lengths.pcd": (packed[: packed.index(b"compressed\n") + 13], "8 bytes with the lengths"),
        "text.pcd": (b"hello\n", "its header has no line DATA"),
        "flat.pcd": (
            binary.replace(b"x y z", b"x y w"),
            "has the fields x, y, w, intensity, but x, y and z are needed",
        ),
        "type.pcd": (binary.replace(b"F F F U", b"F F Q U"), "header of this PCD file is incomplete or damaged"),
        "lengths.pcd": (binary.replace(b"F F F U", b"F F F"), "FIELDS, SIZE, TYPE and COUNT differ in length"),
        "several.pcd": (binary.replace(b"COUNT 1", b"COUNT 2"), "COUNT of x, y and z must be 1"),
        "count.pcd": (binary.replace(b"POINTS 4", b"POINTS -4"), "-4 points"),
        "huge.pcd": (binary.replace(b"POINTS 4", b"POINTS 4000000000000"), "GiB"),
        "zip.pcd": (binary.replace(b"DATA binary", b"DATA zip"), "DATA zip is unknown"),
        "nan.pcd": (pcd(POINTS * np.nan, "binary"), "has no points"),
        "inf.pcd": (pcd(np.full((2, 3), np.inf), "binary"), "2 points are not finite"),
        "empty.pcd": (pcd(POINTS[:0], "binary"), "has no points"),
        "first.ply": (b"plx\nformat ascii 1.0\n", "this is not a PLY file: its first line is not ply"),
        "flat.ply": (
            b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nend_header\n1 2\n",
            "the vertices of this PLY file lack z, but x, y and z are needed",
        ),
        "cloud.xyz": (b"", r"\.xyz is not a format of point clouds; give a \.ply or \.pcd file"),
    }
    for name, (data, words) in files.items():
        (tmp_path / name).write_bytes(data)
        with pytest.raises((rg.InputError, rg.BudgetError), match=words):
            rg.maps.read_point_cloud(tmp_path / name, 0.1)
    (tmp_path / "good.pcd").write_bytes(binary)
    with pytest.raises(rg.InputError, match=r"too narrow for floating point at coordinates up to 0\.95"):
        rg.maps.read_point_cloud(tmp_path / "good.pcd", 1e-20)
    with pytest.raises(rg.InputError, match="resolution = 0 must be a finite number above 0"):
        rg.maps.read_point_cloud(tmp_path / "good.pcd", 0)
    with pytest.raises(rg.InputError, match="there is no such file"):
        rg.maps.read_point_cloud(tmp_path / "missing.pcd", 0.1)


# OctoMaps


def a_tree(seed: int, kind: str = "OcTree"):
    """Return a random tree: a solid block, which is pruned to large leaves, with scattered free and occupied voxels."""
    octomap = import_module("octomap")
    random = np.random.default_rng(seed)
    tree = getattr(octomap, kind)(0.1)
    for cell in np.ndindex(9, 8, 8):
        tree.updateNode((np.array(cell) - [4, 4, 0] + 0.5) * 0.1, bool(cell[0] < 4))
    for place in random.uniform(-1.0, 1.0, (60, 3)):
        tree.updateNode(place, bool(random.random() < 0.5))
    tree.updateInnerOccupancy()
    return tree


def cells_by_library(tree) -> tuple[set[tuple[int, ...]], set[tuple[int, ...]]]:
    """Return occupied and free voxels of a tree, as octomap-python reports them."""
    found: tuple[set[tuple[int, ...]], set[tuple[int, ...]]] = set(), set()
    for leaf in tree.begin_leafs():
        width = round(leaf.getSize() / 0.1)
        first = np.rint(np.array(leaf.getCoordinate()) / 0.1 - width / 2).astype(int)
        block = np.stack(np.meshgrid(*[np.arange(width)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) + first
        found[not tree.isNodeOccupied(leaf)].update(map(tuple, block.tolist()))
    return found


@pytest.mark.parametrize("kind", ["OcTree", pytest.param("ColorOcTree", marks=pytest.mark.slow)])
@pytest.mark.parametrize("suffix", ["bt", "ot"])
def test_an_octomap_has_the_voxels_of_the_library(tmp_path: Path, kind: str, suffix: str) -> None:
    for seed in range(2):
        tree = a_tree(seed, kind)
        file = tmp_path / f"a.{suffix}"
        assert (tree.writeBinary if suffix == "bt" else tree.write)(str(file).encode())
        occupied, empty = cells_by_library(tree)
        voxels = rg.maps.read_octomap(file)
        assert cells_of(voxels) == occupied and voxels.size == pytest.approx(0.1)
        assert len(voxels.boxes) < 0.5 * len(occupied)
        known = np.array(sorted(occupied | empty))
        box = np.stack(np.meshgrid(*map(np.arange, known.min(0), known.max(0) + 1), indexing="ij"), -1).reshape(-1, 3)
        not_free = set(map(tuple, box.tolist())) - empty
        assert cells_of(rg.maps.read_octomap(file, unknown="obstacle")) == not_free
        clipped = rg.maps.read_octomap(file, unknown="obstacle", lower=(-0.3, -0.2, 0.0), upper=(0.25, 0.2, 0.3))
        assert cells_of(clipped) == {c for c in not_free if -3 <= c[0] < 3 and -2 <= c[1] < 2 and 0 <= c[2] < 3}
        half = rg.maps.read_octomap(file, unknown="obstacle", upper=(0.0, 5.0, 5.0))
        tops = known.min(0), np.array([0, 50, 50])
        assert {c for c in not_free if c[0] < 0} <= cells_of(half)
        assert all((np.array(c) >= tops[0]).all() and (np.array(c) < tops[1]).all() for c in cells_of(half))


def test_the_threshold_of_occupancy_selects_leaves(tmp_path: Path) -> None:
    tree = a_tree(1)
    tree.write(str(tmp_path / "a.ot").encode())
    likely = cells_of(rg.maps.read_octomap(tmp_path / "a.ot", occupied=0.6))
    assert likely == cells_by_library(tree)[0]
    with pytest.raises(rg.InputError, match="no voxel of this OctoMap is an obstacle; leave it out"):
        rg.maps.read_octomap(tmp_path / "a.ot", occupied=0.99)


@pytest.mark.parametrize("suffix", ["bt", "ot"])
def test_every_octomap_that_is_cut_short_is_rejected(tmp_path: Path, suffix: str) -> None:
    tree = a_tree(3)
    (tree.writeBinary if suffix == "bt" else tree.write)(str(tmp_path / f"a.{suffix}").encode())
    data = (tmp_path / f"a.{suffix}").read_bytes()
    for size in np.linspace(0, len(data) - 1, 60).astype(int):
        (tmp_path / f"b.{suffix}").write_bytes(data[:size])
        with pytest.raises(rg.InputError):
            rg.maps.read_octomap(tmp_path / f"b.{suffix}")


def test_an_invalid_octomap_has_one_message(tmp_path: Path) -> None:
    octomap = import_module("octomap")
    octomap.OcTree(0.1).writeBinary(str(tmp_path / "empty.bt").encode())
    octomap.OcTree(0.1).write(str(tmp_path / "empty.ot").encode())
    free = octomap.OcTree(0.1)
    free.updateNode(np.zeros(3), False)
    free.writeBinary(str(tmp_path / "free.bt").encode())
    free.write(str(tmp_path / "free.ot").encode())
    data = (tmp_path / "free.ot").read_bytes()
    (tmp_path / "kind.ot").write_bytes(data.replace(b"id OcTree", b"id SemanticTree"))
    (tmp_path / "res.bt").write_bytes((tmp_path / "free.bt").read_bytes().replace(b"res 0.1", b"res -1"))
    (tmp_path / "text.bt").write_text("octree")
    for name, words in {
        "empty.bt": "this OctoMap is empty",
        "empty.ot": "this OctoMap is empty",
        "free.bt": "no voxel of this OctoMap is an obstacle",
        "kind.ot": "trees of the kind 'SemanticTree' are unknown; save it as a .bt file",
        "res.bt": "resolution of this OctoMap is -1.0",
        "text.bt": "not an OctoMap of version 1.4 or later",
        "missing.bt": "there is no such file",
    }.items():
        with pytest.raises(rg.InputError, match=words):
            rg.maps.read_octomap(tmp_path / name)
    with pytest.raises(rg.InputError, match="clip box needs lower < upper"):
        rg.maps.read_octomap(tmp_path / "free.bt", lower=(0, 0, 0), upper=(1, 0, 1))
    with pytest.raises(rg.InputError, match="in the clip box"):
        rg.maps.read_octomap(tmp_path / "free.bt", lower=(5, 5, 5), upper=(6, 6, 6))
