"""ROS maps, compared with the published tests of map_server and nav2_map_server and a pixel-by-pixel reference.

Tests internals: `resgrid.scene.maps.ros`, `resgrid.scene.maps.ros_header`, `resgrid.scene.nearest_place`,
`resgrid.scene.world_coordinates`.
"""

import os

import numpy as np
import pytest
from PIL import Image

import resgrid as rg
from resgrid.scene.maps.ros import ros_greys
from resgrid.scene.maps.ros_header import read_header
from resgrid.scene.nearest_place import is_unknown
from resgrid.scene.world_coordinates import locate_point, unknown_cells

HEADER = {
    "image": "map.png",
    "resolution": 0.5,
    "origin": "[0, 0, 0]",
    "negate": 0,
    "occupied_thresh": 0.65,
    "free_thresh": 0.196,
}
WALL, ROOM = [100] + [0] * 9, [100, 0, 0, 0, 0, 0, 100, 100, 0, 0]
DOOR = [100] * 4 + [0, 0] + [100] * 3 + [0]
# map_server/test/test_constants.cpp, the same in nav2_map_server; the bottom row first
EXPECTED = [[0] * 10, DOOR, DOOR, WALL, WALL, ROOM, ROOM, ROOM, ROOM, WALL]


def write(folder, pixels, **changes):
    Image.fromarray(np.array(pixels, dtype=np.uint8)).save(folder / "map.png")
    return write_yaml(folder, **changes)


def write_yaml(folder, **changes):
    table = {key: value for key, value in (HEADER | changes).items() if value is not None}
    (folder / "map.yaml").write_text("".join(f"{key}: {value}\n" for key, value in table.items()))
    return folder / "map.yaml"


@pytest.mark.parametrize("dialect", ["nav2", "nav2-jazzy", "ros1"])
@pytest.mark.parametrize("name", ["nav2/testmap.yaml", "ros1/testmap.yaml"])
def test_occupancy_equals_the_published_test_maps(cases, name, dialect):
    assert rg.maps.from_occupancy_grid(cases / name, dialect).tolist() == EXPECTED


def test_occupancy_equals_the_published_spectrum(cases, tmp_path):
    image = (cases / "ros1" / "spectrum.png").resolve()
    file = write_yaml(tmp_path, image=image, occupied_thresh=0.65, free_thresh=0.1)
    values, counts = np.unique(rg.maps.from_occupancy_grid(file, "ros1"), return_counts=True)
    assert dict(zip(values.tolist(), counts.tolist(), strict=True)) == {-1: 140, 0: 26, 100: 90}


def test_every_grey_value_equals_the_reference_in_every_mode(tmp_path):
    """The references repeat the arithmetic of the three readers in plain Python."""
    greys = list(range(256))
    for negate in (0, 1):
        for mode in ("trinary", "scale", "raw"):
            file = write(tmp_path, [greys], negate=negate, mode=mode)
            ros1 = [ros1_pixel(grey, negate, mode) for grey in greys]
            jazzy = [jazzy_pixel(grey, negate, mode) for grey in greys]
            nav2 = [nav2_pixel(grey, negate, mode) for grey in greys]
            assert rg.maps.from_occupancy_grid(file, "ros1")[0].tolist() == ros1
            assert rg.maps.from_occupancy_grid(file, "nav2-jazzy")[0].tolist() == jazzy
            assert rg.maps.from_occupancy_grid(file, "nav2")[0].tolist() == nav2
            assert rg.maps.from_occupancy_grid(file)[0].tolist() == nav2


def ros1_pixel(grey, negate, mode):
    value = 255 - grey if negate else grey
    if mode == "raw":
        return value - 256 if value > 127 else value
    p = (255 - value) / 255
    if p > 0.65:
        return 100
    if p < 0.196:
        return 0
    return -1 if mode == "trinary" else int(1 + 98 * ((p - 0.196) / (0.65 - 0.196)))


def nav2_pixel(grey, negate, mode, free=0.196, occupied=0.65):
    single = np.float32
    if mode == "raw":
        return grey if grey <= 100 else -1
    p = single(grey) / single(255)
    p = p if negate else single(1) - p
    if p <= single(free):
        return 0
    if p >= single(occupied):
        return 100
    ratio = (p - single(free)) / single(occupied - free) * single(100)
    return -1 if mode == "trinary" else int(np.floor(ratio + single(0.5)))


def jazzy_pixel(grey, negate, mode):
    shade = grey / 255
    if mode == "raw":
        return grey if grey <= 100 else -1
    p = shade if negate else 1 - shade
    if p > 0.65:
        return 100
    if p < 0.196:
        return 0
    return -1 if mode == "trinary" else round((p - 0.196) / (0.65 - 0.196) * 100)


def test_thresholds_are_strict_in_older_readers_only(tmp_path):
    # (255 - 204) / 255 is exactly the double 0.2; 1 - 204 / 255 lies below it
    file = write(tmp_path, [[204, 51]], free_thresh=0.2, occupied_thresh=0.8)
    assert rg.maps.from_occupancy_grid(file, "ros1").tolist() == [[-1, -1]]
    assert rg.maps.from_occupancy_grid(file, "nav2-jazzy").tolist() == [[0, -1]]
    assert rg.maps.from_occupancy_grid(file, "nav2").tolist() == [[0, 100]]


@pytest.mark.parametrize(
    ("free", "occupied", "expected"),
    [
        (0.5, 0.5, {"nav2": [100, 100, 0, 0], "nav2-jazzy": [100, 100, 0, 0], "ros1": [100, 100, 0, 0]}),
        (0.6, 0.4, {"nav2": [100, 0, 0, 0], "nav2-jazzy": [100, 100, 100, 0], "ros1": [100, 100, 100, 0]}),
        (1, 0, {"nav2": [0, 0, 0, 0], "nav2-jazzy": [100, 100, 100, 0], "ros1": [100, 100, 100, 0]}),
    ],
)
@pytest.mark.parametrize("mode", ["trinary", "scale"])
def test_thresholds_in_reversed_order_are_applied_in_reader_order(tmp_path, mode, free, occupied, expected):
    file = write(tmp_path, [[0, 120, 130, 255]], free_thresh=free, occupied_thresh=occupied, mode=mode)
    assert {name: rg.maps.from_occupancy_grid(file, name)[0].tolist() for name in expected} == expected


@pytest.mark.parametrize("unknown", ["free", "obstacle"])
def test_raw_values_above_100_follow_the_costmap_of_each_dialect(tmp_path, unknown):
    file = write(tmp_path, [[0, 64, 65, 100, 101, 127, 128, 254, 255]], mode="raw")
    open_ = unknown == "free"

    def blocked(dialect):
        scene = rg.read_scene(file, dialect=dialect, unknown=unknown)
        return rg.build_space(scene, require_goal=False).cell[:, 0].tolist()

    assert blocked("ros1") == [0, 0, 1, 1, 1, 1, 1, 1, 0 if open_ else 1]
    assert blocked("nav2") == [0, 0, 1, 1, *([0] * 5 if open_ else [1] * 5)]
    assert {dialect: ros_greys(file, dialect)[101:].count("unknown") for dialect in ("ros1", "nav2")} == {
        "ros1": 1,
        "nav2": 155,
    }


def test_alpha_channels_follow_each_dialect(tmp_path):
    pixels = [[[128, 128, 128, 255], [128, 128, 128, 0], [0, 0, 0, 0], [255, 255, 255, 1], [0, 0, 0, 128]]]
    file = write(tmp_path, pixels, mode="trinary")
    # means with alpha: 159.75, 96, 0, 191.5, 32
    assert rg.maps.from_occupancy_grid(file, "ros1").tolist() == [[-1, -1, 100, -1, 100]]
    assert rg.maps.from_occupancy_grid(file, "nav2-jazzy").tolist() == [[-1, -1, 100, -1, 100]]
    assert rg.maps.from_occupancy_grid(file, "nav2").tolist() == [[-1, -1, -1, -1, -1]]
    file = write_yaml(tmp_path, mode="scale")
    middle = (127 / 255 - 0.196) / (0.65 - 0.196)
    assert rg.maps.from_occupancy_grid(file, "ros1").tolist() == [[int(1 + 98 * middle), -1, 100, 0, 100]]
    assert rg.maps.from_occupancy_grid(file, "nav2").tolist() == [[round(100 * middle), -1, -1, -1, -1]]
    file = write_yaml(tmp_path, mode="raw")
    assert rg.maps.from_occupancy_grid(file, "ros1").tolist() == [[-128, -128, 0, -1, 0]]
    assert rg.maps.from_occupancy_grid(file, "nav2").tolist() == [[-1, -1, 0, -1, 0]]
    assert rg.maps.from_occupancy_grid(file, "nav2-jazzy").tolist() == [[-1, -1, 0, -1, 0]]


def test_opaque_pixels_are_walls_despite_an_alpha_channel(tmp_path):
    pixels = [[[255, 255, 255, 255], [0, 0, 0, 255], [255, 255, 255, 255]]]
    file = write(tmp_path, pixels, free_thresh=0.2, occupied_thresh=0.9)
    assert rg.maps.from_occupancy_grid(file).tolist() == [[0, 100, 0]]
    assert rg.maps.from_occupancy_grid(file, "nav2-jazzy").tolist() == [[0, -1, 0]]


def test_nav2_weights_colours_by_luma(tmp_path):
    # 255 times .299, .587 and .114, truncated: 76, 149, 29
    file = write(tmp_path, [[[255, 0, 0], [0, 255, 0], [0, 0, 255]]], mode="raw")
    assert rg.maps.from_occupancy_grid(file).tolist() == [[76, -1, 29]]
    assert rg.maps.from_occupancy_grid(file, "nav2-jazzy").tolist() == [[85, 85, 85]]
    file = write_yaml(tmp_path, occupied_thresh=0.5)
    assert rg.maps.from_occupancy_grid(file).tolist() == [[100, -1, 100]]


def test_older_dialects_average_colours_without_weights(tmp_path):
    file = write(tmp_path, [[[255, 0, 0], [0, 255, 255], [200, 200, 0]]], mode="scale")
    # means 85, 170, 400/3; in ROS 1 a third channel of 0 counts as transparent between the thresholds
    p = [(255 - m) / 255 for m in (85, 170, 400 / 3)]
    scaled = [(v - 0.196) / (0.65 - 0.196) for v in p]
    assert rg.maps.from_occupancy_grid(file, "ros1").tolist() == [[100, int(1 + 98 * scaled[1]), -1]]
    assert rg.maps.from_occupancy_grid(file, "nav2-jazzy").tolist() == [
        [100, round(100 * scaled[1]), round(100 * scaled[2])]
    ]


def test_palette_images_are_read_as_colours_except_in_ros_1(tmp_path):
    picture = Image.fromarray(np.array([[0, 1, 2]], dtype=np.uint8), "P")
    picture.putpalette([255, 255, 255, 0, 0, 0, 254, 254, 254])
    file = write(tmp_path, [[0]])
    picture.save(tmp_path / "map.png")
    assert (
        rg.maps.from_occupancy_grid(file).tolist()
        == rg.maps.from_occupancy_grid(file, "nav2-jazzy").tolist()
        == [[0, 100, 0]]
    )
    with pytest.warns(UserWarning, match="indices of the palette as grey values"):
        assert rg.maps.from_occupancy_grid(file, "ros1").tolist() == [[100, 100, 100]]
    picture.save(tmp_path / "map.png", transparency=bytes([255, 0, 255]))
    for mode in ("trinary", "scale", "raw"):
        with pytest.warns(UserWarning, match="indices of the palette as grey values"):
            expected = [[0, 1, 2]] if mode == "raw" else [[100, 100, 100]]
            assert rg.maps.from_occupancy_grid(write_yaml(tmp_path, mode=mode), "ros1").tolist() == expected
    file = write_yaml(tmp_path)
    picture.save(tmp_path / "map.png", transparency=bytes([255, 128, 0]))  # SDL_image turns this into colours
    assert rg.maps.from_occupancy_grid(file, "ros1").tolist() == [[0, 100, -1]]


def test_cells_are_placed_by_the_origin(tmp_path):
    file = write(tmp_path, [[0, 254, 254], [254, 254, 205]], origin="[-1.5, 2, 0]")
    scene = rg.read_scene(file)
    assert scene.frame.is_world
    assert [(axis.lower, axis.upper, axis.cells) for axis in scene.axes] == [(-1.5, 0.0, 3), (2.0, 3.0, 2)]
    space = rg.build_space(scene, require_goal=False)
    assert space.cell[0, 1] == 1  # the top left pixel
    assert space.cell.sum() == 2  # and the unknown one, lower right
    assert space.cell[2, 0] == 1
    assert rg.build_space(rg.read_scene(file, unknown="free"), require_goal=False).cell.sum() == 1
    assert rg.build_space(rg.read_scene(file, goal=(-0.1, 2.9))).cell[2, 1] == 2


def test_a_turned_origin_turns_cells_starts_and_shapes(tmp_path):
    file = write(tmp_path, [[254] * 4] * 2, origin=f"[10, 20, {np.pi / 2}]")
    scene = rg.read_scene(file, goal=(9.25, 21.75), start=(9.75, 20.25))
    space = rg.build_space(scene)
    assert np.argwhere(space.cell == 2).tolist() == [[3, 1]]
    assert np.allclose(space.centre([3, 1]), [9.25, 21.75])
    blocked = scene.replace(obstacles=())
    assert rg.build_space(blocked).cell.sum() == 2
    wall = rg.read_scene(file, goal=(9.25, 21.75), obstacles=(rg.Box((9, 20), (9.5, 21)),))
    assert np.argwhere(rg.build_space(wall).cell == 1).tolist() == [[0, 1], [1, 1]]
    half = rg.read_scene(file, goal=(9.25, 21.75), obstacles=(rg.HalfSpace((0, 1), 20.5),))
    assert np.argwhere(rg.build_space(half).cell == 1).tolist() == [[0, 0], [0, 1]]
    with pytest.raises(rg.InputError, match=r"starts\[0\].* in the map's frame"):
        rg.build_space(rg.read_scene(file, goal=(9.25, 21.75), start=(10.5, 20)))


@pytest.mark.parametrize("percent", range(1, 101))
def test_threshold_in_percent_has_no_rounding_error(tmp_path, percent):
    file = write(tmp_path, [[percent - 1, percent]], mode="raw", occupied_thresh=percent / 100)
    assert rg.read_scene(file).map.cell[:, 0].tolist() == [0, 1]
    assert ros_greys(file)[percent - 1 : percent + 1] == ["free", "obstacle"]


def test_lethal_is_the_threshold_in_scale_mode(tmp_path):
    file = write(tmp_path, [[255, 170, 120, 0]], mode="scale")
    assert rg.maps.from_occupancy_grid(file).tolist() == [[0, 30, 73, 100]]
    assert rg.build_space(rg.read_scene(file), require_goal=False).cell[:, 0].tolist() == [0, 0, 1, 1]
    assert rg.build_space(rg.read_scene(file, lethal=20), require_goal=False).cell[:, 0].tolist() == [0, 1, 1, 1]
    assert rg.build_space(rg.read_scene(file, lethal=100), require_goal=False).cell[:, 0].tolist() == [0, 0, 0, 1]


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"image": None}, "image: this key is missing"),
        ({"image": '""'}, "image: must not be empty"),
        ({"image": "gone.png"}, "gone.png: there is no such file"),
        ({"resolution": None}, "resolution: this key is missing"),
        ({"resolution": 0}, "resolution: must be greater than 0"),
        ({"resolution": "wide"}, "resolution: must be a number, got 'wide'"),
        ({"origin": "[.nan, 0, 0]"}, r"origin\[0\]: must be a finite number"),
        ({"origin": "[0, 0]"}, "origin: must be a list of three"),
        ({"origin": 3}, "origin: must be a list of three"),
        ({"negate": "maybe"}, "negate: must be 0"),
        ({"negate": None}, "negate: this key is missing"),
        ({"free_thresh": None}, "free_thresh: this key is missing"),
        ({"occupied_thresh": 1.5}, "occupied_thresh: must be at most 1, got '1.5'"),
        ({"mode": "scaled"}, "mode: 'scaled' is unknown: it may be trinary or scale or raw; did you mean 'scale'"),
        ({"mode": "[1]"}, "mode: a list of 1 is unknown"),
        ({"origin": "[0, 1:30, 0]"}, r"origin\[1\]: must be a number, got '1:30'"),
        ({"origin": "[0, 0, [1]]"}, r"origin\[2\]: must be a number, got a table"),
        ({"resolution": "1_0"}, "resolution: must be a number, got '1_0'"),
        ({"resolution": "1e400"}, "resolution: must be a number, got '1e400'"),
        ({"negate": "08"}, "negate: must be 0, 1, true or false, got '08'"),
        ({"note": "\nimage: other.png"}, "line 8: image: this key is already on line 1; remove one"),
        ({"image": "map.png\nx: [1"}, "not YAML"),
    ],
)
def test_each_header_error_has_its_message(tmp_path, changes, expected):
    write(tmp_path, [[0, 254]])
    with pytest.raises(rg.InputError, match=expected):
        rg.maps.from_occupancy_grid(write_yaml(tmp_path, **changes))


def test_invalid_yaml_dialects_and_options_raise_input_error(tmp_path):
    for text in ("- a\n- b\n", "", "42", "[" * 3000):
        (tmp_path / "map.yaml").write_text(text)
        with pytest.raises(rg.InputError, match=r"map\.yaml"):
            rg.read_scene(tmp_path / "map.yaml")
    for dialect in ("ros2", "ros3", "nav3"):
        with pytest.raises(rg.InputError, match=f"dialect: '{dialect}' is unknown: it may be nav2.*jazzy.*ros1$"):
            rg.read_scene(write(tmp_path, [[0]]), dialect=dialect)
        with pytest.raises(rg.InputError, match=f"dialect = '{dialect}' must be 'nav2' or 'nav2-jazzy' or 'ros1'"):
            rg.maps.from_occupancy_grid(tmp_path / "map.yaml", dialect)
    with pytest.raises(rg.InputError, match="did you mean 'nav2-jazzy'"):
        rg.read_scene(tmp_path / "map.yaml", dialect="nav2-jazy")
    with pytest.raises(rg.InputError, match="has no such option"):
        rg.read_scene(write(tmp_path, [[0]]), passable=".")


def test_negate_accepts_words_in_nav2_only(tmp_path):
    write(tmp_path, [[0, 255]])
    assert rg.maps.from_occupancy_grid(write_yaml(tmp_path, negate="yes")).tolist() == [[0, 100]]
    with pytest.raises(rg.InputError, match="negate: must be 0 or 1"):
        rg.maps.from_occupancy_grid(write_yaml(tmp_path, negate="yes"), "ros1")


def test_map_obstacles_grow_by_the_radius_of_the_robot(tmp_path):
    pixels = np.full((9, 9), 254)
    pixels[4, 4] = 0
    file = write(tmp_path, pixels)
    assert rg.build_space(rg.read_scene(file, robot=rg.PointRobot(0.5)), require_goal=False).cell.sum() == 9
    assert rg.build_space(rg.read_scene(file, robot=rg.PointRobot(0.51)), require_goal=False).cell.sum() == 21


def test_yaml_aliases_are_read_but_merge_keys_are_ignored(tmp_path):
    write(tmp_path, [[0, 254]], resolution="&r 0.5", x="[*r, *r]", free_thresh="*r")
    assert rg.read_scene(tmp_path / "map.yaml").axes[0].spacing == 0.5
    bomb = "&a0 {k: 1}"
    for number in range(1, 40):
        bomb += f"\nx{number}: &a{number} {{<<: [{', '.join([f'*a{number - 1}'] * 9)}]}}"
    write(tmp_path, [[0, 254]], x0=bomb)
    assert rg.maps.from_occupancy_grid(tmp_path / "map.yaml").tolist() == [[100, 0]]
    (tmp_path / "map.yaml").write_text("base: &b\n  image: map.png\n<<: *b\nresolution: 1\n")
    with pytest.raises(rg.InputError, match="image: this key is missing"):
        rg.read_scene(tmp_path / "map.yaml")


SCALARS = [
    ("resolution", "0.5 # m", 0.5),
    ("resolution", "'0.5'", 0.5),
    ("resolution", ".5e0", 0.5),
    ("origin", "[-010, -020, 0]", [-10, -20, 0]),
    ("origin", "[ +1., .5,\n\t1e1 ]", [1, 0.5, 10]),
    ("origin", "\n- 1\n- 2\n- 3", [1, 2, 3]),
    ("negate", '"0"', False),
    ("negate", "010", True),
    ("negate", "0x0", False),
    ("negate", "Yes", True),
    ("negate", "OFF", False),
    ("negate", "-1", True),
    ("mode", "Trinary", "trinary"),
    ("mode", "'RAW'", "raw"),
    ("image", "20230105", "20230105"),
    ("image", "2023-01-05", "2023-01-05"),
    ("image", "0x10", "0x10"),
    ("image", "it's a:b.png", "it's a:b.png"),
    ("image", ">-\n  map.png", "map.png"),
]


@pytest.mark.parametrize(("key", "text", "expected"), SCALARS)
def test_scalars_are_converted_like_in_yaml_cpp(tmp_path, key, text, expected):
    assert getattr(read_header(write_yaml(tmp_path, **{key: text}), "nav2"), key) == expected


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace(": ", ":\t"),
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text + "---\nimage: other.png\n",
        lambda text: text + "...\n{",
        lambda text: "%YAML:1.0\n---\n" + text,
        lambda text: "%YAML:1.0\n" + text,
        lambda text: "\ufeff" + text,
        lambda text: "# caf\xe9\n" + text.replace("\n", " # \xfcber\n"),
        lambda text: text.replace("image", "'image'").replace("free_thresh", "? free_thresh\n"),
        lambda text: "{" + text.strip().replace("\n", ", ") + "}",
        lambda text: text + "\t# tab\n",
    ],
)
@pytest.mark.parametrize("encoding", ["latin-1", "utf-8", "utf-16"])
def test_headers_in_other_encodings_and_styles_are_equivalent(tmp_path, change, encoding):
    file = write_yaml(tmp_path)
    plain = read_header(file, "nav2")
    text = change(file.read_text())
    if encoding == "latin-1":
        text = text.replace("\ufeff", "")
    file.write_bytes(text.encode(encoding))
    assert read_header(file, "nav2") == plain
    assert read_header(file, "ros1") == plain


def test_ros_1_headers_have_their_own_rules(tmp_path):
    for mode in ("[1]", "~"):  # a mode that is not text is ignored
        assert read_header(write_yaml(tmp_path, mode=mode), "ros1").mode == "trinary"
    with pytest.raises(rg.InputError, match="mode: 'Scale' is unknown"):
        read_header(write_yaml(tmp_path, mode="Scale"), "ros1")
    assert read_header(write_yaml(tmp_path, origin="[1, 2, 3, 4]"), "ros1").origin == [1, 2, 3]
    with pytest.raises(rg.InputError, match="origin: must be a list of three"):
        read_header(write_yaml(tmp_path, origin="[1, 2, 3, 4]"), "nav2")


@pytest.mark.parametrize("name", ["/home/ann/maps/map.png", "maps\\map.png", "C:\\maps\\map.png", "../maps/map.png"])
def test_a_missing_image_is_replaced_by_one_in_the_headers_folder(tmp_path, name):
    file = write(tmp_path, [[0, 254]], image=name)
    with pytest.warns(UserWarning, match=r"image: the file .*map\.png is read instead"):
        assert rg.maps.from_occupancy_grid(file).tolist() == [[100, 0]]


def test_backslashes_separate_folders(tmp_path):
    (tmp_path / "maps").mkdir()
    Image.fromarray(np.array([[254, 0]], dtype=np.uint8)).save(tmp_path / "maps" / "map.png")
    file = write(tmp_path, [[0, 254]], image="maps\\map.png")
    with pytest.warns(UserWarning, match="is read instead"):
        assert rg.maps.from_occupancy_grid(file).tolist() == [[0, 100]]


def test_image_names_in_other_encodings_are_found(tmp_path):
    raw = bytes(tmp_path) + b"/caf\xe9.png"
    Image.fromarray(np.array([[0, 254]], dtype=np.uint8)).save(tmp_path / "map.png")
    (tmp_path / "map.png").rename(os.fsdecode(raw))
    file = write_yaml(tmp_path)
    file.write_bytes(file.read_bytes().replace(b"map.png", b"caf\xe9.png"))
    assert rg.maps.from_occupancy_grid(file).tolist() == [[100, 0]]


def test_unknown_cells_are_stored_in_the_map(tmp_path):
    file = write(tmp_path, [[0, 205, 254], [254, 205, 254]], origin=f"[10, 20, {np.pi / 2}]")
    scene = rg.read_scene(file)
    assert scene.map.unknown.tolist() == [[False, False], [True, True], [False, False]]
    assert np.array_equal(unknown_cells(scene.map, scene.axes), scene.map.unknown)

    def seen(point, scene=scene):
        cell, _ = locate_point(scene.axes, scene.frame, point, "start")
        return is_unknown(scene, cell)

    # turned by 90 degrees: the map's x runs along y, its y against x
    assert seen((9.75, 20.75)) and seen((9.25, 20.75))
    assert not seen((9.75, 20.25)) and not seen((9.75, 21.25))
    free = rg.read_scene(file, unknown="free")
    assert free.map.unknown.any() and unknown_cells(free.map, free.axes) is None and not seen((9.75, 20.75), free)
    turning = scene.replace(robot=rg.PointRobot(0.1))
    assert seen((9.75, 20.75), turning)
    assert unknown_cells(None, scene.axes) is None and unknown_cells(scene.map, scene.axes[:1]) is None


def test_goals_in_unknown_space_are_reported_as_unknown(tmp_path):
    pixels = np.full((4, 6), 254)
    pixels[:, 3] = 205
    pixels[:, 4] = 0
    file = write(tmp_path, pixels)
    with pytest.raises(rg.InputError, match=r"lies in unknown space \(cell \(3, 1\)\); .*; --unknown free"):
        rg.build_space(rg.read_scene(file, goal=(1.75, 0.75)))
    with pytest.raises(
        rg.InputError,
        match=r"lies in an obstacle \(cell \(4, 1\)\); move it to a free place of the .*, the nearest is \S+ \S+; "
        r"--goal-tolerance 1 includes that place$",
    ):
        rg.build_space(rg.read_scene(file, goal=(2.25, 0.75)))
    with pytest.raises(
        rg.InputError, match=r"this goal lies in unknown space \(all of its 2 cells\); move it .*; --unknown free"
    ):
        rg.build_space(rg.read_scene(file, goal=rg.Box((1.6, 0.2), (1.9, 0.8))))
    with pytest.raises(rg.InputError, match="this goal lies inside an obstacle"):
        rg.build_space(rg.read_scene(file, goal=rg.Box((1.6, 0.2), (2.4, 0.8))))
    assert rg.build_space(rg.read_scene(file, goal=(1.75, 0.75), unknown="free")).goal_count == 1


@pytest.mark.parametrize("top_down", [False, True])
def test_the_fourth_byte_of_a_bmp_without_masks_is_alpha(tmp_path, top_down):
    """GraphicsMagick reads the byte as alpha; Pillow writes it from RGBA but ignores it when reading."""
    pixels = [[[0, 0, 0, 255], [255, 255, 255, 255]], [[255, 255, 255, 0], [0, 0, 0, 0]]]
    Image.fromarray(np.array(pixels, np.uint8), "RGBA").save(tmp_path / "map.bmp")
    if top_down:
        data = bytearray((tmp_path / "map.bmp").read_bytes())
        data[22:26], first = (-2).to_bytes(4, "little", signed=True), int.from_bytes(data[10:14], "little")
        data[first : first + 16] = data[first + 8 : first + 16] + data[first : first + 8]
        (tmp_path / "map.bmp").write_bytes(data)
    file = write_yaml(tmp_path, image="map.bmp")
    assert rg.maps.from_occupancy_grid(file).tolist() == [[-1, -1], [100, 0]]
    assert rg.maps.from_occupancy_grid(file, "nav2-jazzy").tolist() == [
        [-1, 100],
        [100, 0],
    ]  # means 191.25, 0, 63.75, 255
    file = write_yaml(tmp_path, image="map.bmp", mode="scale")
    assert rg.maps.from_occupancy_grid(file, "nav2-jazzy").tolist() == [[-1, -1], [100, 0]]


def test_grey_pngs_have_no_alpha_up_to_jazzy(tmp_path):
    """As in GraphicsMagick 1.3.40: the fourth value of a mean is 255; no cell of mode scale is transparent."""
    pixels = np.array([[[253, 124], [0, 56], [255, 0], [128, 10]]], np.uint8)
    file = write_yaml(tmp_path, free_thresh=0.05, occupied_thresh=0.5)
    Image.fromarray(pixels, "LA").save(tmp_path / "map.png")
    assert rg.maps.from_occupancy_grid(file, "nav2-jazzy").tolist() == [[0, 100, 0, -1]]
    assert rg.maps.from_occupancy_grid(file).tolist() == [[-1, -1, -1, -1]]
    file = write_yaml(tmp_path, free_thresh=0.25, mode="scale")
    assert rg.maps.from_occupancy_grid(file, "nav2-jazzy").tolist() == [[0, 100, 0, 62]]
