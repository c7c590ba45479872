"""Maps on the command line: dialects, sketches, unknown space and queries of benchmarks."""

import io
import re
import shlex

import numpy as np
import pytest
from PIL import Image

import resgrid as rg

KEYS = "resolution: 0.5\norigin: [-4, -3, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.19\n"


@pytest.fixture
def map_file(tmp_path):
    """Write a map of 100 x 60 unknown cells with 8 x 6 free cells inside walls."""
    grey = np.full((60, 100), 205, dtype=np.uint8)
    grey[20:28, 30:40] = 0
    grey[21:27, 31:39] = 254
    Image.fromarray(grey).save(tmp_path / "map.pgm")
    file = tmp_path / "map.yaml"
    file.write_text(f"image: map.pgm\n{KEYS}")
    return file


@pytest.mark.parametrize("dialect", ["nav2", "nav2-jazzy", "ros1"])
def test_info_reports_the_dialect_of_the_map(answer, call, map_file, dialect):
    assert answer("info", map_file, "--map-dialect", dialect)["map"]["dialect"] == dialect
    assert f"ros as {dialect} reads it" in call("info", map_file, "--map-dialect", dialect).stdout
    assert answer("info", map_file)["map"]["dialect"] == "nav2"
    scene = map_file.with_name("scene.toml")
    scene.write_text(f'schema = 1\n[map]\nfile = "map.yaml"\ndialect = "{dialect}"\n')
    assert answer("info", scene)["map"]["dialect"] == dialect


def test_unknown_dialects_exit_with_2_without_a_misleading_proposal(call, map_file):
    result = call("info", map_file, "--map-dialect", "ros2")
    assert result.exit_code == 2 and "'ros2' is unknown" in result.stderr and "did you mean" not in result.stderr


def test_the_sketch_shows_only_the_known_part_of_a_mostly_unknown_map(answer, call, map_file):
    data = answer("info", map_file, "--start=12,14")
    assert (data["sketch_lower"], data["sketch_upper"]) == ([10.0, 12.0], [17.0, 18.0])
    assert data["sketch_key"].startswith("# obstacle, ? unknown, + partly, . free")
    rows = data["sketch"]
    middle, letters = rows[len(rows) // 2], set("".join(rows))
    assert letters == set("?#.S") and middle.strip("?").startswith("#") and middle.strip("?#").strip(".S") == ""
    text = call("info", map_file).stdout
    assert "only the known part: x 10 to 17 m, y 12 to 18 m" in text and "138" not in text
    whole = answer("info", map_file, "--unknown", "free")
    assert (whole["sketch_lower"], whole["sketch_upper"]) == ([-4.0, -3.0], [46.0, 27.0])
    assert "?" not in "".join(whole["sketch"]) + whole["sketch_key"]


def test_the_letter_of_a_start_is_at_its_position_in_the_sketch(answer, map_file):
    for x, y in [(11.75, 13.75), (15.25, 16.25), (13.3, 15.2)]:
        data = answer("info", map_file, f"--start={x},{y}")
        (left, bottom), (right, top) = data["sketch_lower"], data["sketch_upper"]
        rows = data["sketch"]
        ((row, column),) = ((r, text.index("S")) for r, text in enumerate(rows) if "S" in text)
        assert left + (right - left) * column / len(rows[0]) <= x <= left + (right - left) * (column + 1) / len(rows[0])
        assert top - (top - bottom) * (row + 1) / len(rows) <= y <= top - (top - bottom) * row / len(rows)


def test_a_goal_in_unknown_space_exits_with_2_and_a_remedy(call, map_file):
    result = call("info", map_file, "--goal", "0,0")
    assert result.exit_code == 2 and "lies in unknown space" in result.stderr and "--unknown free" in result.stderr
    assert call("info", map_file, "--goal", "0,0", "--unknown", "free").exit_code == 0
    assert "lies in an obstacle" in call("info", map_file, "--goal", "11.25,14").stderr


@pytest.mark.parametrize("picture", ["space", "page", "potential", "currents", "paths"])
@pytest.mark.quick_cases(2)
def test_pictures_draw_unknown_cells_and_obstacles_in_different_colours(call, map_file, tmp_path, picture):
    words = () if picture == "space" else ("--goal", "12,14.5", "--start", "9.5,12.5")
    assert call("plot", map_file, *words, "--what", picture, "-o", tmp_path / "space.png").exit_code == 0
    pixels = np.asarray(Image.open(tmp_path / "space.png").convert("RGB")).reshape(-1, 3)
    for colour in ((0x9D, 0xB3, 0xC6), (0x3D, 0x3D, 0x3D)):
        assert (pixels == colour).all(axis=1).sum() > 500


@pytest.mark.filterwarnings("always")
def test_an_image_with_a_map_header_next_to_it_is_reported(call, map_file):
    result = call("info", map_file.with_name("map.pgm"))
    assert result.exit_code == 0 and "map.yaml contains its resolution" in result.stderr
    assert "holds its resolution" not in call("info", map_file.with_name("map.pgm"), "--format", "image").stderr


def test_a_map_from_standard_input_needs_an_absolute_picture(call, map_file):
    words = ("info", "-", "--format", "ros", "--map-dialect", "ros1")
    result = call(*words, piped=map_file.read_text())
    assert result.exit_code == 2 and "the picture 'map.pgm' lies in an unknown folder" in result.stderr
    assert (
        call(*words, piped=map_file.read_text().replace("map.pgm", str(map_file.with_name("map.pgm")))).exit_code == 0
    )


PIPED = {
    "picture": (b"P5 3 2 255\n" + bytes([0, 255, 255, 255, 255, 255]), "0.5,1.5"),
    "movingai": (b"type octile\nheight 2\nwidth 4\nmap\n@...\n....\n", "0.5,1.5"),
    "voxels": (b"voxel 3 3 2\n0 0 0\n", "0.5,0.5,0.5"),
}


@pytest.mark.parametrize("kind", [*PIPED, "npy", "deck"])
def test_messages_about_standard_input_name_it(call, kind):
    """Two messages for every format: a goal in an obstacle, and an input that is cut short."""
    if kind == "deck":
        rejected = call("solve", "-", "--read-as", "ngspice", piped="t\nR1 a b\n.end\n")
        assert rejected.exit_code == 2 and "error: standard input:2: R1 has no value" in rejected.stderr
        return
    stream = io.BytesIO()
    np.save(stream, np.eye(3, dtype=np.uint8))
    data, goal = PIPED.get(kind, (stream.getvalue(), "0.5,0.5"))
    blocked = call("info", "-", "--goal", goal, piped=data)
    assert blocked.exit_code == 2 and "error: standard input: goal[0]: the point" in blocked.stderr
    short = call("info", "-", piped=data[:-4] if kind == "npy" else data[: len(data) * 3 // 4])
    assert short.exit_code == 2 and "error: standard input: " in short.stderr and "/standard_input" not in short.stderr
    assert "/standard_input" not in call("info", "-", "--json", piped=data).stdout


def test_a_map_names_its_own_key_for_periodic_edges(call, tmp_path):
    np.save(tmp_path / "ring.npy", np.zeros((4, 3), np.uint8))
    words = ("info", tmp_path / "ring.npy", "--edge")
    one, two = call(*words, "periodic,open"), call(*words, "periodic")
    assert one.exit_code == two.exit_code == 2
    for result, rules in ((one, "periodic,open"), (two, "periodic")):
        option = shlex.split(result.stderr.partition("--set ")[2].partition(" makes")[0])
        assert call(*words, rules, "--set", *option).exit_code == 0
    assert rg.read_scene(tmp_path / "ring.npy", periodic=["x", "y"], edge="periodic").edge == ("periodic", "periodic")


def test_queries_for_another_map_exit_with_2(call, tmp_path):
    for name in "ab":
        (tmp_path / f"{name}.map").write_text("type octile\nheight 2\nwidth 4\nmap\n....\n....\n")
    scenario = tmp_path / "a.scen"
    scenario.write_text("0\tmaps/a.map\t4\t2\t0\t0\t1\t1\t1.4\n")
    assert call("path", tmp_path / "a.map", "--queries", scenario).exit_code == 0
    result = call("path", tmp_path / "b.map", "--queries", scenario)
    assert result.exit_code == 2 and "these queries are for the map 'a.map', not for 'b.map'" in result.stderr
    scenario.write_text("0\ta.map\t0\t0\t1\t1\t1.4\n")
    assert call("path", tmp_path / "a.map", "--queries", scenario).exit_code == 0


def test_a_path_through_voxels_passes_over_an_obstacle(answer, tmp_path):
    (tmp_path / "v.3dmap").write_text("voxel 3 3 2\n1 0 0\n1 1 0\n1 2 0\n")
    data = answer("path", tmp_path / "v.3dmap", "--start", "0.5,1.5,0.5", "--goal", "2.5,1.5,0.5")
    assert data["paths"][0]["outcome"] == "reached" and max(z for _, _, z in data["paths"][0]["points"]) > 1
    assert answer("info", tmp_path / "v.3dmap")["map"]["format"] == "voxels"


@pytest.mark.parametrize("yaw", [0.0, 0.3])
def test_messages_resolve_cells_in_a_frame_far_from_the_origin(call, tmp_path, yaw):
    grey = np.full((20, 30), 254, np.uint8)
    grey[8:12, 8:20] = 0
    Image.fromarray(grey).save(tmp_path / "map.png")
    file, paths = tmp_path / "map.yaml", tmp_path / "paths.yaml"
    keys = KEYS.replace("0.5", "0.1").replace("-4, -3, 0", f"500040.046, 5399954.609, {yaw}")
    file.write_text(f"image: map.png\n{keys}")
    frame = rg.Frame(500040.046, 5399954.609, yaw)
    places = [",".join(map(repr, frame.to_world(point).tolist())) for point in ((2.5, 0.5), (0.5, 0.5), (1.4, 1.0))]
    text = call("info", file, "--crop", "500030.25,5399950,500050,5399955.75").stdout
    assert "--crop 500030.25,5399950,500050,5399955.75" in text
    assert ("origin at (500040.046, 5399954.609)" if yaw else "x: 500040.046 to 500043.046 m") in text
    assert "x in [5000" in call("info", file, "--crop", "0,0,1,1").stderr
    blocked = call("path", file, f"--goal={places[2]}", f"--start={places[1]}").stderr
    nearest = re.search(r"the nearest is \((\S+), (\S+)\)", blocked)
    assert call("path", file, f"--goal={nearest[1]},{nearest[2]}", f"--start={places[1]}").exit_code == 0
    call("path", file, f"--goal={places[0]}", f"--start={places[1]}", f"--start={places[2]}", "-o", paths)
    comments = [line for line in paths.read_text().splitlines() if line.startswith("# start")]
    assert [line.rpartition(": ")[2] for line in comments] == ["reached", "start_blocked"]
    for line, place in zip(comments, places[1:], strict=True):
        shown = re.findall(r"[\d.]+", line)[:2]
        np.testing.assert_allclose(np.array(shown, float), np.array(place.split(","), float), rtol=0, atol=1e-3)
