"""Maps on the command line: how they were read, sketches of them, and queries of benchmarks."""

import numpy as np
import pytest
from PIL import Image

KEYS = "resolution: 0.5\norigin: [-4, -3, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.19\n"


@pytest.fixture
def seen(tmp_path):
    """A room of 8 x 6 free cells within walls, in a map of 100 x 60 cells of which the others are unknown."""
    grey = np.full((60, 100), 205, dtype=np.uint8)
    grey[20:28, 30:40] = 0
    grey[21:27, 31:39] = 254
    Image.fromarray(grey).save(tmp_path / "map.pgm")
    file = tmp_path / "map.yaml"
    file.write_text(f"image: map.pgm\n{KEYS}")
    return file


@pytest.mark.parametrize("dialect", ["nav2", "nav2-jazzy", "ros1"])
def test_info_names_the_reader_that_was_followed(answer, call, seen, dialect):
    assert answer("info", seen, "--map-dialect", dialect)["map"]["dialect"] == dialect
    assert f"ros as {dialect} reads it" in call("info", seen, "--map-dialect", dialect).stdout
    assert answer("info", seen)["map"]["dialect"] == "nav2"
    scene = seen.with_name("scene.toml")
    scene.write_text(f'schema = 1\n[map]\nfile = "map.yaml"\ndialect = "{dialect}"\n')
    assert answer("info", scene)["map"]["dialect"] == dialect


def test_unknown_dialects_are_refused_without_a_wrong_guess(call, seen):
    said = call("info", seen, "--map-dialect", "ros2")
    assert said.exit_code == 2 and "'ros2' is unknown" in said.stderr and "did you mean" not in said.stderr


def test_a_sketch_shows_the_known_part_of_a_map_that_is_mostly_unknown(answer, call, seen):
    data = answer("info", seen, "--start=12,14")
    assert (data["sketch_lower"], data["sketch_upper"]) == ([10.0, 12.0], [17.0, 18.0])
    assert data["sketch_key"].startswith("# obstacle, ? unknown, + partly, . free")
    rows = data["sketch"]
    middle, letters = rows[len(rows) // 2], set("".join(rows))
    assert letters == set("?#.S") and middle.strip("?").startswith("#") and middle.strip("?#").strip(".S") == ""
    text = call("info", seen).stdout
    assert "only the known part: x 10 to 17 m, y 12 to 18 m" in text and "138" not in text
    whole = answer("info", seen, "--unknown", "free")
    assert (whole["sketch_lower"], whole["sketch_upper"]) == ([-4.0, -3.0], [46.0, 27.0])
    assert "?" not in "".join(whole["sketch"]) + whole["sketch_key"]


def test_a_start_lies_where_its_letter_is(answer, seen):
    for x, y in [(11.75, 13.75), (15.25, 16.25), (13.3, 15.2)]:
        data = answer("info", seen, f"--start={x},{y}")
        (left, bottom), (right, top) = data["sketch_lower"], data["sketch_upper"]
        rows = data["sketch"]
        ((row, column),) = ((r, text.index("S")) for r, text in enumerate(rows) if "S" in text)
        assert left + (right - left) * column / len(rows[0]) <= x <= left + (right - left) * (column + 1) / len(rows[0])
        assert top - (top - bottom) * (row + 1) / len(rows) <= y <= top - (top - bottom) * row / len(rows)


def test_goals_in_unknown_space_are_called_so(call, seen):
    said = call("info", seen, "--goal", "0,0")
    assert said.exit_code == 2 and "lies in unknown space" in said.stderr and "--unknown free" in said.stderr
    assert call("info", seen, "--goal", "0,0", "--unknown", "free").exit_code == 0
    assert "lies in an obstacle" in call("info", seen, "--goal", "11.25,14").stderr


@pytest.mark.parametrize("what", ["space", "page", "potential", "currents", "paths"])
def test_pictures_tell_unknown_cells_apart(call, seen, tmp_path, what):
    words = () if what == "space" else ("--goal", "12,14.5", "--start", "9.5,12.5")
    assert call("plot", seen, *words, "--what", what, "-o", tmp_path / "space.png").exit_code == 0
    pixels = np.asarray(Image.open(tmp_path / "space.png").convert("RGB")).reshape(-1, 3)
    for colour in ((0x9D, 0xB3, 0xC6), (0x3D, 0x3D, 0x3D)):
        assert (pixels == colour).all(axis=1).sum() > 500


@pytest.mark.filterwarnings("always")
def test_a_picture_beside_its_header_is_read_with_a_word(call, seen):
    said = call("info", seen.with_name("map.pgm"))
    assert said.exit_code == 0 and "map.yaml contains its resolution" in said.stderr
    assert "holds its resolution" not in call("info", seen.with_name("map.pgm"), "--format", "image").stderr


def test_queries_of_another_map_are_refused(call, tmp_path):
    for name in "ab":
        (tmp_path / f"{name}.map").write_text("type octile\nheight 2\nwidth 4\nmap\n....\n....\n")
    scenario = tmp_path / "a.scen"
    scenario.write_text("0\tmaps/a.map\t4\t2\t0\t0\t1\t1\t1.4\n")
    assert call("path", tmp_path / "a.map", "--queries", scenario).exit_code == 0
    said = call("path", tmp_path / "b.map", "--queries", scenario)
    assert said.exit_code == 2 and "these queries are for the map 'a.map', not for 'b.map'" in said.stderr
    scenario.write_text("0\ta.map\t0\t0\t1\t1\t1.4\n")
    assert call("path", tmp_path / "a.map", "--queries", scenario).exit_code == 0


def test_a_path_through_voxels(answer, tmp_path):
    (tmp_path / "v.3dmap").write_text("voxel 3 3 2\n1 0 0\n1 1 0\n1 2 0\n")
    data = answer("path", tmp_path / "v.3dmap", "--start", "0.5,1.5,0.5", "--goal", "2.5,1.5,0.5")
    assert data["paths"][0]["outcome"] == "reached" and max(z for _, _, z in data["paths"][0]["points"]) > 1
    assert answer("info", tmp_path / "v.3dmap")["map"]["format"] == "voxels"
