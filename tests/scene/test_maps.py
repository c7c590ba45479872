"""Map formats (MovingAI, voxels, images, anymaps, NumPy): cells compared with literal arrays and Pillow; damaged files.

Tests internals: `resgrid.scene.maps.formats`, `resgrid.scene.maps.pictures`, `resgrid.scene.maps.pnm`.
"""

import io
import struct
import subprocess
import sys
import zlib

import numpy as np
import pytest
from PIL import Image

import resgrid as rg
from resgrid.scene.maps.formats import FORMATS, MapFormat
from resgrid.scene.maps.pictures import read_raster
from resgrid.scene.maps.pnm import read_pnm

MAP = "type octile\nheight 3\nwidth 4\nmap\n.G@O\nTSW.\n....\n"


def write(path, content):
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def cells(path, **options):
    return rg.build_space(rg.read_scene(path, **options), require_goal=False).cell


def png(pixels, mode="L"):
    stream = io.BytesIO()
    Image.fromarray(np.array(pixels, dtype=np.uint8)).convert(mode).save(stream, "png")
    return stream.getvalue()


def test_letters_of_movingai_maps_are_free_or_obstacle(tmp_path):
    file = write(tmp_path / "a.map", MAP)
    assert cells(file).T[::-1].tolist() == [[0, 0, 1, 1], [1, 0, 1, 0], [0, 0, 0, 0]]
    assert cells(file, passable=".").T[::-1].tolist() == [[0, 1, 1, 1], [1, 1, 1, 0], [0, 0, 0, 0]]
    scene = rg.read_scene(file, goal=(3.5, 1.5))
    assert rg.build_space(scene).cell[3, 1] == 2
    assert [(axis.lower, axis.upper, axis.unit) for axis in scene.axes] == [(0, 4, "cell"), (0, 3, "cell")]
    assert (cells(write(tmp_path / "crlf.map", MAP.replace("\n", "\r\n"))) == cells(file)).all()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (MAP.replace("TSW.", "TSW"), "line 6: the row has 3 letters, but the header has width 4"),
        (MAP.replace("TSW.", "TSW.."), "line 6: the row has 5"),
        (MAP.replace("TSW.", "TSx."), "line 6, column 3: 'x' is not a letter of terrain"),
        (MAP.replace("height 3", "height 4"), "ends after 3 rows"),
        (MAP.replace("height 3", "height 2"), "line 7: more rows"),
        (MAP.replace("height 3", "height 0"), "'height N'"),
        (MAP.replace("height 3", "height -1"), "'height N'"),
        (MAP.replace("height 3\n", ""), "'height N'"),
        (MAP.replace("height 3", "height 1000000000").replace("width 4", "width 1000000000"), "width"),
        (MAP.replace("octile", "hex"), "line 1: type 'hex' does not have square cells"),
        (MAP.replace("width 4", "width 4\nheight 3"), "line 4: 'height' is in the header twice"),
        (MAP.replace("\nmap\n", "\n"), "line 4: expected"),
        ("type octile\n", "expected|does not end"),
        ("", "expected|does not end"),
        (b"\xff\xfe\x00", "UTF-8"),
    ],
)
def test_movingai_errors_name_the_line(tmp_path, text, expected):
    with pytest.raises(rg.InputError, match=expected):
        rg.read_scene(write(tmp_path / "a.map", text))


def test_an_unknown_passable_letter_raises_input_error(tmp_path):
    with pytest.raises(rg.InputError, match="'x' is not a letter of terrain"):
        rg.read_scene(write(tmp_path / "a.map", MAP), passable=".x")


def test_scenario_files_are_read_and_errors_name_the_line(tmp_path):
    text = "version 1\n0\ta b.map\t4\t3\t0\t0\t3\t2\t3.82842712\n\n3 c.map 4 3 1 1 2 2 1.5\n"
    first, second = rg.maps.read_movingai_scenarios(write(tmp_path / "a.scen", text))
    assert (first.map, first.start, first.goal, first.optimal_length) == ("a b.map", (0, 2), (3, 0), 3.82842712)
    assert (second.bucket, second.start, second.goal) == (3, (1, 1), (2, 0))
    for bad, expected in (
        ("version 2\n", "line 1: expected 'version 1' or 'version 0'"),
        ("0\ta\n", "line 1: expected 9 fields"),
        ("type octile\n", "line 1: expected 9 fields"),
        ("0 gone.map 0 0 1 1 1\n", r"version 0 omits the size of its map, and the map file .*gone\.map does not exist"),
        ("version 1\n0 a.map 4 3 0 0 3 2\n", "line 2: expected 9 fields"),
        ("version 1\n0 a.map 4 3 0 0 3 3 1\n", r"line 2: the goal \(3, 3\) is outside"),
        ("version 1\n0 a.map 4 3 0 0 3 2 nan\n", "line 2: expected 9 fields"),
    ):
        with pytest.raises(rg.InputError, match=expected):
            rg.maps.read_movingai_scenarios(write(tmp_path / "a.scen", bad))


@pytest.mark.parametrize("first", ["", "version 0\n", "version 0.0\n"])
def test_scenarios_of_version_0_have_the_size_of_their_map(tmp_path, first):
    write(tmp_path / "a.map", MAP)
    file = write(tmp_path / "a.scen", f"{first}0\tmaps/dao/a.map\t0\t0\t3\t2\t3.8\n1 a.map 1 1 2 2 1.5\n")
    one, other = rg.maps.read_movingai_scenarios(file)
    assert (one.width, one.height, one.start, one.goal, one.optimal_length) == (4, 3, (0, 2), (3, 0), 3.8)
    assert (other.bucket, other.start, other.goal) == (1, (1, 1), (2, 0))
    with pytest.raises(rg.InputError, match=r"line 1: the goal \(3, 3\) is outside the 4 x 3 map"):
        rg.maps.read_movingai_scenarios(write(tmp_path / "a.scen", "0 a.map 0 0 3 3 1\n"))


def test_scenarios_of_version_1_need_no_version_line(tmp_path):
    (query,) = rg.maps.read_movingai_scenarios(write(tmp_path / "a.scen", "0\ta b.map\t4\t3\t0\t0\t3\t2\t3.8\n"))
    assert (query.map, query.start, query.goal) == ("a b.map", (0, 2), (3, 0))


def test_letters_of_warehouse_maps_are_free(tmp_path):
    file = write(tmp_path / "w.map", "type octile\nheight 1\nwidth 4\nmap\nE.S@\n")
    assert cells(file)[:, 0].tolist() == [0, 0, 0, 1]


def test_voxel_maps_are_read_with_axes_in_cells(tmp_path):
    file = write(tmp_path / "v.3dmap", "voxel 4 3 2\n1 2 0\n\n1 2 1\n3 0 0\n1 2 0\n")
    space = rg.build_space(rg.read_scene(file, goal=(0.5, 0.5, 1.5)))
    assert np.argwhere(space.cell == 1).tolist() == [[1, 2, 0], [1, 2, 1], [3, 0, 0]]
    assert np.argwhere(space.cell == 2).tolist() == [[0, 0, 1]]
    assert [(axis.name, axis.upper, axis.unit) for axis in space.axes] == [
        (n, u, "cell") for n, u in zip("xyz", (4, 3, 2), strict=True)
    ]
    assert (cells(write(tmp_path / "v.txt", file.read_text().replace("\n", "\r\n"))) == (space.cell == 1)).all()
    assert not cells(write(tmp_path / "free.3dmap", "voxel 2 2 2")).any()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "line 1: expected 'voxel X Y Z'"),
        ("voxel 4 3\n", "line 1"),
        ("voxel 4 3 0\n", "line 1"),
        ("voxel 4 3 -2\n", "line 1"),
        ("voxel 100000 100000 100000\n", "GiB"),
        ("voxel 4 3 2\n0 0 0\n4 0 0\n", "line 3: expected a voxel 'x y z' of 4 x 3 x 2, got '4 0 0'"),
        ("voxel 4 3 2\n-1 0 0\n", "line 2"),
        ("voxel 4 3 2\n0 0\n0 0\n0 0\n", "line 2"),
        ("voxel 4 3 2\n0 0 0\n\n0 0 0 0\n", "line 4"),
        ("voxel 4 3 2\n0 0 1.5\n", "line 2"),
        ("voxel 4 3 2\n0 0 99999999999999999999\n", "line 2"),
    ],
)
def test_errors_of_voxel_maps_name_the_line(tmp_path, text, expected):
    with pytest.raises(rg.ResgridError, match=expected):
        rg.read_scene(write(tmp_path / "v.3dmap", text))


@pytest.mark.parametrize("name", ["arena", "den312d", "random-32-32-20", "room-32-32-4", "maze-32-32-2"])
def test_starts_and_goals_of_every_scenario_are_connected(cases, name):
    from resgrid.core.regions import label_regions

    folder = cases / "movingai"
    (queries,) = (rg.maps.read_movingai_scenarios(file) for file in folder.glob(f"{name}*.scen"))
    cell = cells(folder / f"{name}.map")
    region = label_regions(cell == 0, (False, False))
    for query in queries:
        assert cell.shape == (query.width, query.height)
        assert region[query.start] == region[query.goal] > 0


@pytest.mark.parametrize(
    "data",
    [
        b"P5\n3 2\n255\n" + bytes([0, 1, 2, 3, 4, 255]),
        b"P5 # a comment\n# another\n3\t2\r\n255 " + bytes([0, 1, 2, 3, 4, 255]),
        b"P2\n3 2 255\n0 1 2\n3 4\n255\n",
        b"P2 3 2\n#c\n255\n0 1 2 # three 9 9\n3 4 255 77",
        b"P5#x\n3#y\n2#z\n255\n" + bytes([0, 1, 2, 3, 4, 255]) + b"P5 trailing",
    ],
)
def test_pgm_headers_with_comments_and_blanks_are_read(tmp_path, data):
    values, maxval = read_pnm(data, tmp_path)
    assert (values[..., 0].tolist(), maxval) == ([[0, 1, 2], [3, 4, 255]], 255)


def test_pgm_values_of_two_bytes_are_read(tmp_path):
    assert read_pnm(b"P5 2 1 65535\n\x01\x02\xff\xff", tmp_path)[0].tolist() == [[[258], [65535]]]
    assert read_pnm(b"P2 2 1 1000\n7 1000", tmp_path)[0].tolist() == [[[7], [1000]]]
    # a raster that starts with bytes that look like a comment or a blank
    assert read_pnm(b"P5 2 1 255\n#\n", tmp_path)[0].tolist() == [[[35], [10]]]
    assert cells(write(tmp_path / "a.pgm", b"P5 3 1 3\n\x00\x01\x02"))[:, 0].tolist() == [1, 1, 0]


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"P5",
        b"P5\n",
        b"P5 3",
        b"P5 3 2",
        b"P5 3 2 255",
        b"P5 3 2 255\n12345",
        b"P5 0 2 255\n",
        b"P5 3 2 0\n123456",
        b"P5 3 2 65536\n" + b"1" * 12,
        b"P5 3 2 100\n\xff23456",
        b"P5 3 2 255x123456",
        b"P5 1000000000 1000000000 255\n123",
        b"P5 99999999999999999999 2 255\n123",
        b"P2 1000000000 1000000000 255\n1 2 3",
        b"P2 3 1 255\n1 2",
        b"P2 3 1 255\n1 2 x",
        b"P2 3 1 255\n1 2 -3",
        b"P2 3 1 255\n1 2 256",
        b"P2 3 1 255\n1 2 1.5",
        b"P9 3 1 255\n",
        b"\x89PNG\r\n\x1a\nrubbish",
        png([[1, 2], [3, 4]])[:-20],
        png([[1, 2], [3, 4]])[:40],
        b"GIF89a",
        bytes(100),
    ],
)
def test_damaged_images_raise_input_error(tmp_path, data):
    file = write(tmp_path / "a.pgm", data)
    with pytest.raises(rg.InputError, match=r"a\.pgm"):
        rg.read_scene(file)


def test_images_beyond_the_memory_raise_an_error(tmp_path):
    data = bytearray(png([[1]]))
    data[16:24] = (60000).to_bytes(4) + (60000).to_bytes(4)
    data[29:33] = zlib.crc32(bytes(data[12:29])).to_bytes(4)
    with pytest.raises(rg.ResgridError, match=r"60000 x 60000 = 3\.6e\+09 cells needs about .* GiB is free"):
        rg.read_scene(write(tmp_path / "a.png", bytes(data)))


def test_plain_images_have_threshold_spacing_and_origin(tmp_path):
    file = write(tmp_path / "a.png", png([[0, 127, 128, 255]]))
    assert cells(file)[:, 0].tolist() == [1, 1, 0, 0]
    assert cells(file, threshold=1)[:, 0].tolist() == [1, 0, 0, 0]
    scene = rg.read_scene(file, spacing=0.5, origin=(1, 2))
    assert [(axis.lower, axis.upper, axis.unit) for axis in scene.axes] == [(1, 3, "m"), (2, 2.5, "m")]
    for options, expected in (
        ({"spacing": -1}, "greater than 0"),
        ({"origin": (1, 2, 3)}, "needs 2 coordinates"),
        ({"threshold": "x"}, "whole number"),
        ({"treshold": 3}, "did you mean 'threshold'"),
    ):
        with pytest.raises(rg.InputError, match=expected):
            rg.read_scene(file, **options)


def test_epic_colours_are_obstacles_goals_or_free(tmp_path):
    colours = [[[0, 0, 0], [255, 255, 255], [150, 150, 150], [255, 0, 0], [0, 0, 1], [0, 0, 9]]]
    file = write(tmp_path / "a.png", png(colours, "RGB"))
    assert cells(file, format="epic")[:, 0].tolist() == [1, 2, 0, 0, 1, 0]
    transparent = write(tmp_path / "b.png", png([[[0, 0, 0, 0], [255, 255, 255, 0], [9, 9, 9, 255]]], "RGBA"))
    assert cells(transparent, format="epic")[:, 0].tolist() == [1, 2, 0]


def test_images_of_16_bits_1_bit_and_palettes_are_read(tmp_path):
    stream = io.BytesIO()
    Image.fromarray(np.array([[0, 32767, 32896, 65535]], dtype=np.uint16)).save(stream, "png")
    assert cells(write(tmp_path / "deep.png", stream.getvalue()))[:, 0].tolist() == [1, 1, 0, 0]
    assert cells(write(tmp_path / "p.png", png([[0, 255]], "P")))[:, 0].tolist() == [1, 0]
    assert cells(write(tmp_path / "1.png", png([[0, 255]], "1")))[:, 0].tolist() == [1, 0]


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def raw_png(size, depth, colour, rows, key=None):
    """Bytes of a PNG file; `rows`: bytes of each row; `key`: the transparent colour."""
    header = struct.pack(">IIBBBBB", *size, depth, colour, 0, 0, 0)
    transparent = b"" if key is None else chunk(b"tRNS", key)
    data = zlib.compress(b"".join(b"\0" + row for row in rows))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + transparent + chunk(b"IDAT", data) + chunk(b"IEND", b"")


@pytest.mark.parametrize(("colour", "channels"), [(0, 1), (2, 3), (4, 2), (6, 4)])
def test_pngs_of_16_bits_per_channel_are_read_exactly(tmp_path, colour, channels):
    values = (np.arange(5 * 3 * channels).reshape(3, 5, channels) * 1093 % 65536).astype(np.uint16)
    values[0, 0, -1] = 65534  # nearly opaque, which is visible in the lower byte only
    rows = [row.astype(">u2").tobytes() for row in values]
    raster = read_raster(write(tmp_path / "a.png", raw_png((5, 3), 16, colour, rows)))
    assert raster.maxval == 65535 and raster.values.tolist() == values.tolist()


@pytest.mark.parametrize(
    ("depth", "colour", "row", "key", "opacity"),
    [
        (16, 0, b"\x01\x02\x01\x03\x02\x02", b"\x01\x02", [0, 1, 1]),
        (16, 2, bytes(range(6)) * 2 + bytes(6), bytes(range(6)), [0, 0, 1]),
        (8, 0, b"\x07\x08\x07", b"\0\x07", [0, 1, 0]),
        (8, 2, b"\x01\x02\x03\x01\x02\x04\x01\x02\x03", b"\0\x01\0\x02\0\x03", [0, 1, 0]),
        (4, 0, b"\x5a\x50", b"\0\x05", [0, 1, 0]),
        (2, 0, b"\x64", b"\0\x01", [0, 1, 0]),
        (1, 0, b"\xa0", b"\0\x01", [0, 1, 0]),
    ],
)
def test_the_transparent_colour_of_a_png_becomes_an_alpha_channel(tmp_path, depth, colour, row, key, opacity):
    raster = read_raster(write(tmp_path / "a.png", raw_png((3, 1), depth, colour, [row], key)))
    assert raster.has_alpha and (raster.values[0, :, -1] // raster.maxval).tolist() == opacity


@pytest.mark.parametrize(
    ("data", "expected", "white"),
    [
        (b"P1\n# c\n3 2\n0 1 1\n1 0 0", [[[1], [0], [0]], [[0], [1], [1]]], 1),
        (b"P1 3 2 011100", [[[1], [0], [0]], [[0], [1], [1]]], 1),
        (b"P4 3 2\n\x60\x9ftrailing", [[[1], [0], [0]], [[0], [1], [1]]], 1),
        (b"P3 2 1 9\n1 2 3 # c\n 7 8 9", [[[1, 2, 3], [7, 8, 9]]], 9),
        (b"P6 2 1 255\n\1\2\3\4\5\6", [[[1, 2, 3], [4, 5, 6]]], 255),
        (b"P6 1 1 300\n\0\1\0\2\1\0", [[[1, 2, 256]]], 300),
    ],
)
def test_anymaps_of_all_types_are_read_exactly(tmp_path, data, expected, white):
    values, maxval = read_pnm(data, tmp_path)
    assert (values.tolist(), maxval) == (expected, white)
    assert read_raster(write(tmp_path / "a.ppm", data)).values.tolist() == expected


@pytest.mark.parametrize(
    "data",
    [b"P1 3 2 01110", b"P1 3 2 011102", b"P4 9 2\n\0\0\0", b"P3 1 1 9\n1 2", b"P6 1 1 9\n\1\2", b"P6 1 1 9\n\1\2\x0a"],
)
def test_damaged_anymaps_raise_input_error(tmp_path, data):
    with pytest.raises(rg.InputError, match=r"a\.ppm: .*(cut short|raster|above)"):
        rg.read_scene(write(tmp_path / "a.ppm", data))


@pytest.mark.parametrize("suffix", ["jpg", "jpeg", "JPG", "dat"])
def test_jpeg_images_are_read_as_maps(tmp_path, suffix):
    stream = io.BytesIO()
    Image.fromarray(np.repeat(np.array([[0, 255]], dtype=np.uint8), 8, axis=1)).save(stream, "jpeg", quality=95)
    file = write(tmp_path / f"a.{suffix}", stream.getvalue())
    assert cells(file)[:, 0].tolist() == [1] * 8 + [0] * 8
    keys = "resolution: 1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"
    write(tmp_path / "a.yaml", f"image: {file.name}\n{keys}")
    assert cells(tmp_path / "a.yaml")[:, 0].tolist() == [1] * 8 + [0] * 8


def test_image_sizes_are_limited_by_memory_only(tmp_path, monkeypatch):
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 3)
    assert cells(write(tmp_path / "a.png", png([[0, 255] * 20]))).shape == (40, 1)
    assert Image.MAX_IMAGE_PIXELS == 3


def test_exhausted_memory_raises_budget_error(tmp_path, monkeypatch):
    def read(path):
        raise MemoryError("Unable to allocate 1.00 TiB for an array with shape (1,)")

    monkeypatch.setitem(FORMATS, "npy", MapFormat(read, (".npy",)))
    with pytest.raises(rg.BudgetError, match=r"a\.npy: the memory limit of this process is too small for this map"):
        rg.read_scene(write(tmp_path / "a.npy", b""))


def test_a_plain_image_with_a_ros_header_in_its_folder_causes_a_warning(tmp_path):
    file = write(tmp_path / "a.png", png([[0, 205, 255]]))
    assert cells(file)[:, 0].tolist() == [1, 0, 0]
    write(tmp_path / "a.yaml", "image: other.png\n")
    assert cells(file)[:, 0].tolist() == [1, 0, 0]
    write(tmp_path / "a.yaml", "image: a.png\n")
    with pytest.warns(UserWarning, match=r"a\.png is read as a plain picture.*a\.yaml contains its resolution"):
        assert cells(file)[:, 0].tolist() == [1, 0, 0]
    assert cells(file, format="image")[:, 0].tolist() == [1, 0, 0]


@pytest.mark.parametrize("name", ["maze_1", "umass_lpr", "c_space"])
def test_real_epic_images_agree_with_pillow(cases, name):
    grey = np.asarray(Image.open(cases / "epic" / f"{name}.png").convert("L"))
    cell = cells(cases / "epic" / f"{name}.png", format="epic")
    assert ((cell == 1) == (grey == 0)[::-1].T).all()
    assert ((cell == 2) == (grey == 255)[::-1].T).all()
    assert (cell == 2).any()


def test_numpy_files_of_all_versions_and_orders_are_read(tmp_path):
    codes = np.array([[0, 1, 2], [0, 0, 1]])
    for array in (codes, codes.astype(np.uint8), np.asfortranarray(codes)):
        np.save(tmp_path / "a.npy", array)
        assert cells(tmp_path / "a.npy").tolist() == codes.tolist()
    for version in ((1, 0), (2, 0), (3, 0)):
        for kind in (">i8", "<u2", "i1", ">u4"):
            with (tmp_path / "a.npy").open("wb") as file:
                np.lib.format.write_array(file, np.asfortranarray(codes).astype(kind), version)
            assert cells(tmp_path / "a.npy").tolist() == codes.tolist()
    np.save(tmp_path / "a.npy", np.zeros((2, 3, 4, 5), dtype=bool))
    assert cells(tmp_path / "a.npy").shape == (2, 3, 4, 5)
    assert rg.read_scene(tmp_path / "a.npy", goal=(0.5, 1.5, 2.5, 3.5)).ndim == 4


@pytest.mark.parametrize(
    "array",
    [
        np.array([[0, 3]]),
        np.array([[0.0, 1.0]]),
        np.array([[0, -1]]),
        np.zeros((0, 3), dtype=int),
        np.zeros((1, 1, 1, 1, 1), dtype=int),
        np.array(3),
        np.array(["a"]),
        np.array([{}], dtype=object),
    ],
)
def test_arrays_of_other_values_types_or_shapes_raise_input_error(tmp_path, array):
    np.save(tmp_path / "a.npy", array)
    with pytest.raises(rg.InputError, match=r"a\.npy"):
        rg.read_scene(tmp_path / "a.npy")


def test_damaged_numpy_files_raise_an_error(tmp_path):
    stream = io.BytesIO()
    np.save(stream, np.zeros((20, 20), dtype=np.uint8))
    whole = stream.getvalue()
    huge = whole.replace(b"(20, 20), }" + b" " * 20, b"(1000000000, 1000000000), }"[:27] + b" " * 4)
    for data in (b"", whole[:5], whole[:40], whole[:-7], huge, b"\x93NUMPY\x09\x00" + whole[8:]):
        with pytest.raises(rg.ResgridError, match=r"a\.npy"):
            rg.read_scene(write(tmp_path / "a.npy", data))


def test_a_scene_with_a_map_file_adds_obstacles_and_goals(tmp_path):
    write(tmp_path / "floor.map", MAP)
    scene = write(
        tmp_path / "s.toml",
        'schema = 1\n[map]\nfile = "floor.map"\n[[goal]]\ncell = [0, 0]\n'
        '[[obstacle]]\nshape = "rectangle"\nlower = [1, 0]\nupper = [2, 1]\n',
    )
    space = rg.build_space(rg.read_scene(scene))
    assert (space.cell[0, 0], space.cell[1, 0], space.cell[2, 2]) == (2, 1, 1)
    assert rg.build_space(rg.read_scene(scene, passable=".")).cell[1, 1] == 1
    for line, expected in (
        ('file = "gone.map"', r"gone\.map: there is no such file"),
        ('file = "floor.map"\npasable = "."', "did you mean 'passable'"),
        ('file = "floor.map"\nthreshold = 3', "has no such option"),
        ('file = "."', "is a directory"),
    ):
        write(tmp_path / "t.toml", f"schema = 1\n[map]\n{line}\n")
        with pytest.raises(rg.InputError, match=expected):
            rg.read_scene(tmp_path / "t.toml")
    write(tmp_path / "t.toml", 'schema = 1\nstarts = [[1, 2, 3]]\n[map]\nfile = "floor.map"\n')
    with pytest.raises(rg.InputError, match=r"line 2: starts\[0\]: needs 2 coordinates"):
        rg.read_scene(tmp_path / "t.toml")


def test_goal_cells_covered_by_grown_obstacles_are_reported(tmp_path):
    codes = np.array([[1, 2, 2, 2]])
    np.save(tmp_path / "a.npy", codes)
    assert cells(tmp_path / "a.npy", robot=rg.PointRobot(0.5)).tolist() == [[1, 1, 2, 2]]
    with pytest.raises(rg.InputError, match="goal cells"):
        cells(tmp_path / "a.npy", robot=rg.PointRobot(5.0))


def test_a_registered_format_is_read_by_its_suffix(tmp_path, monkeypatch):
    def read_csv(path):
        return np.loadtxt(path, delimiter=",", dtype=np.uint8)

    monkeypatch.setitem(FORMATS, "csv", MapFormat(read_csv, (".csv",)))
    file = write(tmp_path / "a.csv", "0,1,0\n0,0,0\n")
    assert cells(file, spacing=0.5).tolist() == [[0, 1, 0], [0, 0, 0]]
    assert rg.read_scene(file, goal=(0.2, 0.2), spacing=0.5).axes[0].upper == 1.0
    with pytest.raises(rg.InputError, match=r"map\.format: 'cvs' is unknown: it may be .*; did you mean 'csv'"):
        rg.read_scene(file, format="cvs")


WITH_OPTION = '''
import numpy as np
import resgrid as rg
from resgrid.scene.maps.formats import FORMATS, MapFormat

def read_csv(path, delimiter: str = ","):
    """Read a table of cells.

    Parameters
    ----------
    delimiter
        What stands between columns.
    """
    return np.loadtxt(path, delimiter=delimiter, dtype=np.uint8)

FORMATS["csv"] = MapFormat(read_csv, (".csv",))
print(rg.read_scene("a.toml").map.cell.tolist(), rg.read_scene("a.csv", delimiter=";").map.cell.tolist())
print(rg.scene_schema()["$defs"]["Map"]["properties"]["delimiter"]["description"])
'''


def test_options_of_a_registered_reader_are_keys_of_the_map_table(tmp_path):
    write(tmp_path / "a.csv", "0;1\n0;0\n")
    write(tmp_path / "a.toml", 'schema = 1\n[map]\nfile = "a.csv"\ndelimiter = ";"\n')
    done = subprocess.run(
        [sys.executable, "-c", WITH_OPTION], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.stdout == "[[0, 1], [0, 0]] [[0, 1], [0, 0]]\nWhat stands between columns (csv).\n", done.stderr


@pytest.mark.parametrize("mode", ["L", "RGBA"])
@pytest.mark.parametrize("kind", ["image", "epic", "ros", "costs"])
def test_reading_an_image_stays_within_the_memory_estimate(tmp_path, monkeypatch, mode, kind):
    """The estimate that rejects large maps, compared with the traced peak."""
    import tracemalloc

    from resgrid._internal import memory

    asked = []
    monkeypatch.setattr(memory, "require_memory", lambda needed, *_: asked.append(needed))
    file = tmp_path / "map.png"
    Image.new(mode, (400, 300), "white").save(file)
    options = {"format": kind}
    if kind in ("ros", "costs"):
        options = {"least_conductivity": 0.1} if kind == "costs" else {}
        keys = "resolution: 1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\nmode: scale\n"
        file = tmp_path / "map.yaml"
        file.write_text(f"image: map.png\n{keys}")
    rg.read_scene(file, **options)  # complete all imports before memory is traced
    tracemalloc.start()
    rg.read_scene(file, **options)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak <= max(asked) + 200_000
