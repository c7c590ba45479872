"""ROS maps: the published expectations of both readers' own tests, and pixels worked out by hand."""

import numpy as np
import pytest
from PIL import Image

import resgrid as rg
from resgrid.errors import InputError
from resgrid.scene import occupancy_grid, read_scene, sample
from resgrid.scene.maps.ros import ros_greys

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


@pytest.mark.parametrize("dialect", ["nav2", "ros1"])
@pytest.mark.parametrize("name", ["nav2/testmap.yaml", "ros1/testmap.yaml"])
def test_published_occupancy(cases, name, dialect):
    assert occupancy_grid(cases / name, dialect).tolist() == EXPECTED


def test_published_spectrum(cases, tmp_path):
    image = (cases / "ros1" / "spectrum.png").resolve()
    file = write_yaml(tmp_path, image=image, occupied_thresh=0.65, free_thresh=0.1)
    values, counts = np.unique(occupancy_grid(file, "ros1"), return_counts=True)
    assert dict(zip(values.tolist(), counts.tolist(), strict=True)) == {-1: 140, 0: 26, 100: 90}


def test_every_grey_value_in_every_mode(tmp_path):
    """The two readers' arithmetic, pixel by pixel, in plain Python."""
    greys = list(range(256))
    for negate in (0, 1):
        for mode in ("trinary", "scale", "raw"):
            file = write(tmp_path, [greys], negate=negate, mode=mode)
            ros1 = [ros1_pixel(grey, negate, mode) for grey in greys]
            nav2 = [nav2_pixel(grey, negate, mode) for grey in greys]
            assert occupancy_grid(file, "ros1")[0].tolist() == ros1
            assert occupancy_grid(file, "nav2")[0].tolist() == nav2


def ros1_pixel(grey, negate, mode):
    value = 255 - grey if negate else grey
    if mode == "raw":
        return value - 256 if value > 127 else value
    p = (255 - value) / 255
    if p > 0.65:
        return 100
    if p < 0.196:
        return 0
    return -1 if mode == "trinary" else int(99 * (p - 0.196) / (0.65 - 0.196))


def nav2_pixel(grey, negate, mode):
    shade = grey / 255
    if mode == "raw":
        return grey if grey <= 100 else -1
    p = shade if negate else 1 - shade
    if p > 0.65:
        return 100
    if p < 0.196:
        return 0
    return -1 if mode == "trinary" else round((p - 0.196) / (0.65 - 0.196) * 100)


def test_thresholds_are_strict_and_the_readers_round_differently(tmp_path):
    # (255 - 204) / 255 is exactly the double 0.2; 1 - 204 / 255 lies below it
    file = write(tmp_path, [[204, 51]], free_thresh=0.2, occupied_thresh=0.8)
    assert occupancy_grid(file, "ros1").tolist() == [[-1, -1]]
    assert occupancy_grid(file, "nav2").tolist() == [[0, -1]]


@pytest.mark.parametrize("unknown", ["free", "obstacle"])
def test_raw_values_above_100_are_what_the_costmap_makes_of_what_the_server_sends(tmp_path, unknown):
    file = write(tmp_path, [[0, 64, 65, 100, 101, 127, 128, 254, 255]], mode="raw")
    open_ = unknown == "free"

    def blocked(dialect):
        scene = read_scene(file, dialect=dialect, unknown=unknown)
        return sample(scene, require_goal=False).cell[:, 0].tolist()

    assert blocked("ros1") == [0, 0, 1, 1, 1, 1, 1, 1, 0 if open_ else 1]
    assert blocked("nav2") == [0, 0, 1, 1, *([0] * 5 if open_ else [1] * 5)]
    assert {dialect: ros_greys(file, dialect)[101:].count("unknown") for dialect in ("ros1", "nav2")} == {
        "ros1": 1,
        "nav2": 155,
    }


def test_alpha(tmp_path):
    pixels = [[[128, 128, 128, 255], [128, 128, 128, 0], [0, 0, 0, 0], [255, 255, 255, 1], [0, 0, 0, 128]]]
    file = write(tmp_path, pixels, mode="trinary")
    # means with alpha: 159.75, 96, 0, 191.5, 32
    assert occupancy_grid(file, "ros1").tolist() == [[-1, -1, 100, -1, 100]]
    assert occupancy_grid(file, "nav2").tolist() == [[-1, -1, 100, -1, 100]]
    file = write_yaml(tmp_path, mode="scale")
    middle = (127 / 255 - 0.196) / (0.65 - 0.196)
    assert occupancy_grid(file, "ros1").tolist() == [[int(99 * middle), -1, 100, 0, 100]]
    assert occupancy_grid(file, "nav2").tolist() == [[round(100 * middle), -1, -1, -1, -1]]
    file = write_yaml(tmp_path, mode="raw")
    assert occupancy_grid(file, "ros1").tolist() == [[-128, -128, 0, -1, 0]]
    assert occupancy_grid(file, "nav2").tolist() == [[-1, -1, 0, -1, 0]]


def test_colours_are_averaged_without_weights(tmp_path):
    file = write(tmp_path, [[[255, 0, 0], [0, 255, 255], [200, 200, 0]]], mode="scale")
    # means 85, 170, 400/3; in ROS 1 a third channel of 0 counts as transparent between the thresholds
    p = [(255 - m) / 255 for m in (85, 170, 400 / 3)]
    scaled = [(v - 0.196) / (0.65 - 0.196) for v in p]
    assert occupancy_grid(file, "ros1").tolist() == [[100, int(99 * scaled[1]), -1]]
    assert occupancy_grid(file, "nav2").tolist() == [[100, round(100 * scaled[1]), round(100 * scaled[2])]]


def test_cells_lie_where_the_origin_says(tmp_path):
    file = write(tmp_path, [[0, 254, 254], [254, 254, 205]], origin="[-1.5, 2, 0]")
    scene = read_scene(file)
    assert scene.frame.is_world
    assert [(axis.lower, axis.upper, axis.cells) for axis in scene.axes] == [(-1.5, 0.0, 3), (2.0, 3.0, 2)]
    space = sample(scene, require_goal=False)
    assert space.cell[0, 1] == 1  # the top left pixel
    assert space.cell.sum() == 2  # and the unknown one, lower right
    assert space.cell[2, 0] == 1
    assert sample(read_scene(file, unknown="free"), require_goal=False).cell.sum() == 1
    assert sample(read_scene(file, goal=(-0.1, 2.9))).cell[2, 1] == 2


def test_a_turned_origin(tmp_path):
    file = write(tmp_path, [[254] * 4] * 2, origin=f"[10, 20, {np.pi / 2}]")
    scene = read_scene(file, goal=(9.25, 21.75), start=(9.75, 20.25))
    space = sample(scene)
    assert np.argwhere(space.cell == 2).tolist() == [[3, 1]]
    assert np.allclose(space.centre([3, 1]), [9.25, 21.75])
    blocked = scene.replace(obstacles=())
    assert sample(blocked).cell.sum() == 2
    wall = read_scene(file, goal=(9.25, 21.75), obstacles=(rg.Box((9, 20), (9.5, 21)),))
    assert np.argwhere(sample(wall).cell == 1).tolist() == [[0, 1], [1, 1]]
    half = read_scene(file, goal=(9.25, 21.75), obstacles=(rg.HalfSpace((0, 1), 20.5),))
    assert np.argwhere(sample(half).cell == 1).tolist() == [[0, 0], [0, 1]]
    with pytest.raises(InputError, match=r"starts\[0\].* in the map's frame"):
        sample(read_scene(file, goal=(9.25, 21.75), start=(10.5, 20)))


def test_lethal_decides_in_scale_mode(tmp_path):
    file = write(tmp_path, [[255, 170, 120, 0]], mode="scale")
    assert occupancy_grid(file).tolist() == [[0, 30, 73, 100]]
    assert sample(read_scene(file), require_goal=False).cell[:, 0].tolist() == [0, 0, 1, 1]
    assert sample(read_scene(file, lethal=20), require_goal=False).cell[:, 0].tolist() == [0, 1, 1, 1]
    assert sample(read_scene(file, lethal=100), require_goal=False).cell[:, 0].tolist() == [0, 0, 0, 1]


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
        ({"free_thresh": 0.7}, "free_thresh: 0.7 must lie below"),
        ({"free_thresh": None}, "free_thresh: this key is missing"),
        ({"occupied_thresh": 1.5}, "occupied_thresh: must be at most 1, got 1.5"),
        ({"mode": "Scale"}, "mode: 'Scale' is unknown"),
        ({"mode": "[1]"}, "mode: a list of 1 is unknown"),
        ({"image": "map.png\nx: [1"}, "not YAML"),
        ({"x": "!!python/object:os.system {}"}, "not YAML"),
    ],
)
def test_one_clear_message(tmp_path, changes, expected):
    write(tmp_path, [[0, 254]])
    with pytest.raises(InputError, match=expected):
        occupancy_grid(write_yaml(tmp_path, **changes))


def test_yaml_that_is_no_mapping(tmp_path):
    for text in ("- a\n- b\n", "", "42", "[" * 3000):
        (tmp_path / "map.yaml").write_text(text)
        with pytest.raises(InputError, match=r"map\.yaml"):
            read_scene(tmp_path / "map.yaml")
    with pytest.raises(InputError, match="dialect"):
        read_scene(write(tmp_path, [[0]]), dialect="ros3")
    with pytest.raises(InputError, match="takes no such option"):
        read_scene(write(tmp_path, [[0]]), passable=".")


def test_negate_takes_words_in_nav2_only(tmp_path):
    write(tmp_path, [[0, 255]])
    assert occupancy_grid(write_yaml(tmp_path, negate="yes")).tolist() == [[0, 100]]
    with pytest.raises(InputError, match="negate: must be 0 or 1"):
        occupancy_grid(write_yaml(tmp_path, negate="yes"), "ros1")


def test_the_robots_radius_grows_map_obstacles(tmp_path):
    pixels = np.full((9, 9), 254)
    pixels[4, 4] = 0
    file = write(tmp_path, pixels)
    assert sample(read_scene(file, robot=rg.PointRobot(0.5)), require_goal=False).cell.sum() == 9
    assert sample(read_scene(file, robot=rg.PointRobot(0.51)), require_goal=False).cell.sum() == 21


def test_aliases_are_read_and_never_merged(tmp_path):
    write(tmp_path, [[0, 254]], resolution="&r 0.5", x="[*r, *r]", free_thresh="*r")
    assert read_scene(tmp_path / "map.yaml").axes[0].spacing == 0.5
    bomb = "&a0 {k: 1}"
    for number in range(1, 40):
        bomb += f"\nx{number}: &a{number} {{<<: [{', '.join([f'*a{number - 1}'] * 9)}]}}"
    write(tmp_path, [[0, 254]], x0=bomb)
    with pytest.raises(InputError, match=r"line 8: this is not YAML \(a map merges no keys"):
        read_scene(tmp_path / "map.yaml")
