"""``resgrid resistance``: decks, networks, scenes, Circuitscape jobs, files and rejected inputs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.cli import ROOM, call

import resgrid as rg

DECK = "a ladder\nv1 vdd 0 1.8\nr1 vdd a 10\nr2 a b 10\nrload b 0 1k\nr9 c d 5\n.op\n.end\n"

OPEN = ("room.toml", "--boundary", "neumann")
CHIP = ("room.toml", "--set", "chip.mismatch=0.05")


HEAD = "ncols 3\nnrows 1\nxllcorner 0\nyllcorner 0\ncellsize 1\n"


@pytest.fixture(autouse=True)
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a deck, an edge list, a scene and a Circuitscape job."""
    monkeypatch.chdir(tmp_path)
    Path("deck.sp").write_text(DECK)
    Path("edges.txt").write_text("a b 1\nb c 1\nc a 1\n")
    Path("room.toml").write_text(ROOM)
    Path("habitat.asc").write_text("ncols 3\nnrows 1\nxllcorner 0\nyllcorner 0\ncellsize 1\n1 1 3\n")
    Path("points.txt").write_text("1 0.5 0.5\n2 2.5 0.5\n")
    Path("job.ini").write_text(
        "scenario = pairwise\nhabitat_file = habitat.asc\nhabitat_map_is_resistances = True\n"
        "connect_using_avg_resistances = True\npoint_file = points.txt\noutput_file = job.out\n"
    )
    return tmp_path


def test_pairs_of_a_deck_with_sources_as_wires() -> None:
    """The supply is a wire between vdd and ground: a sees 10 ohm in parallel with 1010 ohm."""
    result = call("resistance", "deck.sp", "--between", "a", "vdd", "--between", "a b", "0", "--json")
    assert result.exit_code == 0
    pairs = json.loads(result.stdout)["pairs"]
    assert pairs[0]["resistance"] == pytest.approx(1 / (1 / 10 + 1 / 1010))
    assert pairs[1]["resistance"] == pytest.approx(1 / (1 / 10 + 1 / 1000))
    text = call("resistance", "deck.sp", "--between", "a", "vdd").stdout
    assert "a - vdd  9.901960784 ohm" in text


def test_all_pairs_and_files(desk: Path) -> None:
    result = call("resistance", "edges.txt", "--between", "a", "b", "--between", "c", "a", "--all", "-o", "r.csv")
    assert result.exit_code == 0
    lines = Path("r.csv").read_text().splitlines()
    assert lines[0] == "first,second,resistance" and len(lines) == 4
    assert [float(line.split(",")[2]) for line in lines[1:]] == pytest.approx([2 / 3] * 3)
    assert call("resistance", "edges.txt", "--between", "a", "b", "-o", "r.json").exit_code == 0
    assert json.loads(Path("r.json").read_text())["pairs"][0]["resistance"] == pytest.approx(2 / 3)
    assert call("resistance", "edges.txt", "--between", "a", "b", "-o", "r.npz").exit_code == 0
    with np.load("r.npz") as arrays:
        assert arrays["matrix"][0, 1] == pytest.approx(2 / 3)


def test_an_unconnected_pair_is_a_negative_answer() -> None:
    result = call("resistance", "deck.sp", "--between", "a", "c", "--json")
    assert result.exit_code == 1
    assert json.loads(result.stdout)["pairs"][0] == {
        "first": "a", "second": "c", "resistance": None, "connected": False,
    }  # fmt: skip
    assert "not connected" in call("resistance", "deck.sp", "--between", "a", "c").stdout


def test_places_of_a_scene() -> None:
    words = ("room.toml", "--boundary", "neumann", "--resistance", "1")
    world = json.loads(call("resistance", *words, "--between", "0.5,0.5", "2.5,3.5", "--json").stdout)
    cells = json.loads(call("resistance", *words, "--cells", "--between", "0,0", "2,3", "--json").stdout)
    names = json.loads(call("resistance", *words, "--between", "n_0_0", "n_2_3", "--json").stdout)
    assert world["pairs"] == cells["pairs"] == names["pairs"]
    netlist = rg.compile_space(rg.build_space(rg.read_scene("room.toml")), boundary="neumann", resistance=1.0)
    expected = rg.effective_resistance(netlist, [((0, 0), (2, 3))], cells=True).resistance[0]
    assert world["pairs"][0]["resistance"] == pytest.approx(expected, rel=1e-12)


def test_cells_without_a_path_to_a_goal_are_part_of_the_circuit() -> None:
    """The wall of the room separates column 5 from the goal."""
    words = ("resistance", "room.toml", "--boundary", "neumann", "--resistance", "1", "--cells", "--json")
    apart = call(*words, "--between", "0,0", "5,4")
    assert apart.exit_code == 1 and json.loads(apart.stdout)["pairs"][0]["connected"] is False
    inside = call(*words, "--between", "5,0", "5,4")
    assert inside.exit_code == 0 and json.loads(inside.stdout)["pairs"][0]["resistance"] == pytest.approx(4.0)


def test_a_resistance_needs_neither_a_drive_nor_a_goal() -> None:
    np.save("free.npy", np.zeros((6, 1), dtype=np.uint8))
    line = ("resistance", "free.npy", "--cells", "--edge", "open", "--resistance", "1", "--between", "0,0", "5,0")
    for options in ((), ("--goal", "2,0"), ("--boundary", "neumann"), ("--boundary", "neumann", "--lattice", "square")):
        result = call(*line, *options, "--json")
        assert result.exit_code == 0, result.stderr
        assert json.loads(result.stdout)["pairs"][0]["resistance"] == pytest.approx(5.0)
    driven = call(*line, "--goal", "2,0", "--boundary", "neumann", "--drive", "start", "--start", "0,0", "--json")
    data = json.loads(driven.stdout)
    assert data["pairs"][0]["resistance"] == pytest.approx(5.0) and data["ignored"] == ["drive"]
    assert "ignored: drive = 'start': a resistance needs no drive" in driven.stderr
    chip = call(*line, "--boundary", "neumann", "--set", "chip.internodal_switch_on=2", "--json")
    assert json.loads(chip.stdout)["pairs"][0]["resistance"] == pytest.approx(5 * 3.0)


def test_rails_cells_and_equal_places_are_terminals() -> None:
    words = ("resistance", "room.toml", "--cells", "--json")
    pairs = (("3,3", "4,2"), ("0,0", "0,0"), ("0,0", "3,3"), ("0,0", "goal_0"), ("0,0", "obstacle"))
    result = call(*words, *(word for pair in pairs for word in ("--between", *pair)))
    ohms = [pair["resistance"] for pair in json.loads(result.stdout)["pairs"]]
    assert result.exit_code == 0 and ohms[:2] == [0.0, 0.0] and ohms[2] == ohms[3] == ohms[4] > 0


def test_a_circuitscape_job() -> None:
    result = call("resistance", "job.ini", "-o", "there", "--json")
    assert result.exit_code == 0
    data = json.loads(result.stdout)
    assert data["resistance"] == [[0.0, 3.0], [3.0, 0.0]] and data["scenario"] == "pairwise"
    assert sorted(file.name for file in Path("there").iterdir()) == [
        "job_resistances.out", "job_resistances_3columns.out",
    ]  # fmt: skip
    text = call("resistance", "job.ini").stdout
    assert "1 - 2  3 ohm" in text and Path("job_resistances.out").is_file()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--goal", "1,1"], "is a Circuitscape job: options for keys of scenes and maps have no effect; remove them"),
        (["--set", "nonsense.key=3"], "options for keys of scenes and maps have no effect"),
        (["--boundary", "neumann", "--robot-radius", "3", "--coarsen", "4"], "options for keys of scenes and maps"),
        (["--format", "ros"], "options for keys of scenes and maps have no effect"),
        (["--read-as", "xyce"], "not a deck: --read-as is for decks; remove it"),
        (["--all"], "define its pairs and circuits: leave out --all"),
        (["--method", "direct"], "define its pairs and circuits: leave out --method"),
    ],
)
def test_options_without_effect_on_a_circuitscape_job_are_rejected(words: list[str], message: str) -> None:
    result = call("resistance", "job.ini", "-o", "there", *words)
    assert result.exit_code == 2 and message in result.stderr
    assert not Path("there").exists()


def test_options_without_effect_on_resistances_are_reported() -> None:
    result = call("resistance", "deck.sp", "--between", "a", "0", "--cells")
    assert result.exit_code == 2 and "deck.sp is a circuit without cells: leave out --cells" in result.stderr
    result = call("resistance", "job.ini", "-o", "there", "--threads", "2")
    assert result.exit_code == 0 and "ignored: --threads" in result.stderr


def test_a_missing_pair_is_answered_with_nodes_of_the_input() -> None:
    Path("source.asc").write_text(HEAD + "1 -9999 -9999\n")
    Path("ground.asc").write_text(HEAD + "-9999 -9999 0\n")
    Path("advanced.ini").write_text(
        "scenario = advanced\nhabitat_file = habitat.asc\nhabitat_map_is_resistances = True\n"
        "source_file = source.asc\nground_file = ground.asc\n"
    )
    for name, pair in (("advanced.ini", "ground r0_c0"), ("deck.sp", "0 vdd")):
        result = call("resistance", name)
        assert result.exit_code == 2 and f"such as --between {pair}; 'resgrid solve {name} -o" in result.stderr
        assert call("resistance", name, "--between", *pair.split()).exit_code == 0


def test_a_circuitscape_job_writes_into_an_existing_folder() -> None:
    Path("results").mkdir()
    Path("results/notes.txt").write_text("kept\n")
    for _ in range(2):
        assert call("resistance", "job.ini", "-o", "results").exit_code == 0
    assert sorted(file.name for file in Path("results").iterdir()) == [
        "job_resistances.out", "job_resistances_3columns.out", "notes.txt",
    ]  # fmt: skip


def test_unconnected_points_of_a_job_are_null_in_json() -> None:
    Path("habitat.asc").write_text("ncols 3\nnrows 1\nxllcorner 0\nyllcorner 0\ncellsize 1\n1 -9999 3\n")
    result = call("resistance", "job.ini", "--json")
    data = json.loads(result.stdout)
    assert result.exit_code == 1
    assert data["resistance"] == [[0.0, None], [None, 0.0]] and data["connected"] == [[True, False], [False, True]]
    Path("job.ini").write_text(Path("job.ini").read_text() + "scenario = one-to-all\n")
    data = json.loads(call("resistance", "job.ini", "--json").stdout)
    assert data["resistance"] == [None, None] and data["connected"] == [False, False]
    assert "1  not connected" in call("resistance", "job.ini").stdout


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["deck.sp"], "no pair is given: add --between A B"),
        (["deck.sp", "--between", "a", "zz"], "the circuit has no node 'zz'"),
        (["deck.sp", "--between", "a", "b", "-o", "r.txt"], "cannot write effective resistances as 'r.txt'"),
        (["room.toml", "--between", "1,2,3", "4,4"], "--between 1,2,3: a place of this scene has 2 coordinates"),
        (["room.toml", "--cells", "--between", "1.5,2", "4,4"], "give whole numbers"),
        (
            ["room.toml", "--cells", "--between", "9,9", "4,4"],
            "--between 9,9: the space has no cell (9, 9); its cells are",
        ),
        (["room.toml", "--between", "9,9", "4,4"], "--between 9,9: the point (9.0, 9.0) lies outside the grid"),
        (["room.toml", "--between", "1,1", " "], "--between: a terminal is empty"),
        ([*OPEN, "--cells", "--between", "4,2", "3,3"], "--between 4,2: cell (4, 2) is an open obstacle"),
        ([*OPEN, "--between", "goal_0", "obstacle"], "no node 'obstacle'; obstacles are open"),
        (
            [*CHIP, "--between", "1,1", "goal_0"],
            "no node 'goal_0'; each of its cells is a node of its own here, such as n_3_3",
        ),
        ([*CHIP, "--between", "1,1", "goal_1"], "no node 'goal_1'; some of its nodes are"),
        (["job.ini", "--between", "1", "2"], "leave --between out"),
        (["wrong.ini"], "Circuitscape has no key 'scenari'; did you mean 'scenario'?"),
        (["missing.ini"], "missing.ini"),
        (["job.ini", "-o", "-"], "-o -: the results of a Circuitscape job are several files; name a folder"),
        (["deck.sp", "--between", "a", "b", "-o", "folder"], "cannot write"),
        (["foo.ini"], "foo.ini: the scenario 'foo' has no focal points; choose one of pairwise, one-to-all"),
        (["foo.ini", "--between", "1", "2"], "the scenario 'foo' has no focal points"),
        (["empty.ini"], "empty.txt: a job needs at least two focal points, got 0"),
    ],
)
def test_rejected_inputs(words: list[str], message: str) -> None:
    Path("wrong.ini").write_text("scenari = pairwise\n")
    Path("foo.ini").write_text("scenario = foo\n")
    Path("empty.ini").write_text(Path("job.ini").read_text() + "point_file = empty.txt\n")
    Path("empty.txt").touch()
    Path("folder").mkdir()
    result = call("resistance", *words)
    assert result.exit_code == 2 and message in result.stderr
