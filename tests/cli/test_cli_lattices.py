"""The key ``lattice`` on the command line: paths, decks in ngspice, pictures, files, and refusals by name."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import resgrid as rg

PLANES = ("square8", "hexagonal")


@pytest.mark.parametrize("lattice", PLANES)
@pytest.mark.quick_cases(1)
def test_run_writes_certified_paths_and_decks_that_ngspice_confirms(answer, scenes, tmp_path, lattice):
    data = answer("run", scenes / "lesson.toml", "--lattice", lattice, "--check", "-o", tmp_path / "out")
    assert [path["outcome"] for path in data["paths"]] == ["reached"]
    assert all(path["certified"] and path["log_duration"] is None for path in data["paths"])
    (chip,) = data["chips"]
    assert chip["check"]["agrees"] and chip["check"]["max_relative_error"] < 1e-9
    sidecar = json.loads((tmp_path / "out" / "dirichlet.cir.json").read_text())
    space = rg.build_space(rg.read_scene(scenes / "lesson.toml"))
    cells = {tuple(node["cell"]) for name, node in sidecar["nodes"].items() if name.startswith("n_")}
    assert cells == set(map(tuple, np.argwhere(space.cell == rg.Cell.FREE).tolist()))


BLOCK = """schema = 1
starts = [[0.5, 0.5, 0.5]]
[grid]
axes = [
  { name = "x", lower = 0, upper = 5, cells = 5 },
  { name = "y", lower = 0, upper = 4, cells = 4 },
  { name = "z", lower = 0, upper = 3, cells = 3 },
]
[[obstacle]]
shape = "box"
lower = [2, 0, 0]
upper = [3, 3, 2]
[[goal]]
cell = [4, 0, 0]
"""
"""A scene of 5 x 4 x 3 cells with a wall."""


def test_decks_of_space_and_of_current_sources_agree_with_ngspice(answer, scenes, tmp_path):
    block = tmp_path / "block.toml"
    block.write_text(BLOCK)
    assert answer("path", block, "--lattice", "cube26")["paths"][0]["certified"]
    for words in (
        (scenes / "lesson.toml", "--boundary", "neumann", "--lattice", "hexagonal"),
        (scenes / "lesson.toml", "--boundary", "wall", "--set", "chip.wall_resistance=20k", "--lattice", "square8"),
        (block, "--lattice", "cube26"),
    ):
        answer("compile", *words, "-o", tmp_path / "deck.cir")
        assert answer("check", tmp_path / "deck.cir")["agrees"]
    assert (tmp_path / "deck.cir").read_text().splitlines()[0].startswith("* ")


def test_a_scene_file_names_its_lattice(answer, call, scenes, tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text((scenes / "lesson.toml").read_text().replace("schema = 1", 'schema = 1\nlattice = "square8"'))
    own = answer("path", scene)["paths"][0]
    assert own == answer("path", scenes / "lesson.toml", "--lattice", "square8")["paths"][0]
    assert own == answer("path", scenes / "lesson.toml", "--set", "lattice=square8")["paths"][0]
    assert own != answer("path", scene, "--lattice", "square")["paths"][0]
    assert answer("info", scene)["lattice"] == "square8"
    assert "lattice square8" in call("info", scene).stdout
    assert rg.read_scene(scene).lattice == "square8"


@pytest.mark.slow
@pytest.mark.parametrize("lattice", PLANES)
def test_blends_files_and_pictures_of_a_lattice(answer, call, scenes, tmp_path, lattice):
    rooms = (scenes / "rooms.toml", "--lattice", lattice)
    paths = answer("path", *rooms, "--k", "0,0.5,1", "-o", tmp_path / "paths.csv")["paths"]
    assert len(paths) == 9 and all(path["certified"] for path in paths)
    answer("solve", *rooms, "--k", "1", "-o", tmp_path / "field.npz")
    with np.load(tmp_path / "field.npz") as arrays:
        assert set(arrays) == {"potential", "log_drop", "cell", "points"}
        assert arrays["points"].shape == (*arrays["potential"].shape, 2)
    for what in ("page", "potential", "paths"):
        assert call("plot", *rooms, "--what", what, "-o", tmp_path / f"{what}.png").exit_code == 0
    lesson = (scenes / "lesson.toml", "--lattice", lattice)
    assert call("plot", *lesson, "--what", "circuit", "-o", tmp_path / "circuit.png").exit_code == 0


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("plot", "lesson.toml", "--what", "currents", "-o", "x.png"), "--what currents"),
        (("compile", "lesson.toml", "--form", "cells", "-o", "x.cir"), "rails = 'cells'"),
        (("board", "lesson.toml", "--no-kicad", "-o", "x"), "a board"),
        (("layout", "lesson.toml", "--process", "ihp-sg13g2:rppd", "-o", "x.gds"), "a layout"),
        (("control", "lesson.toml", "-o", "x.csv"), "control"),
        (("chip", "lesson.toml", "-o", "x"), "the chip"),
        (("solve", "chip.toml"), "rails = 'cells'"),
        (("resistance", "lesson.toml", "--between", "0.5,0.5", "5.5,5.5"), "lattice 'square8'"),
        (("path", "lesson.toml", "--method", "petsc"), "method = 'petsc'"),
        (("path", "turning.toml"), "needs 2 axes"),
    ],
)
def test_a_command_that_needs_the_square_grid_rejects_a_lattice(call, scenes, tmp_path, monkeypatch, words, part):
    monkeypatch.chdir(tmp_path)
    full = [scenes / word if str(word).endswith(".toml") else word for word in words]
    result = call(*full, "--lattice", "square8")
    assert result.exit_code == 2 and part in result.stderr and "square" in result.stderr
    assert not list(Path().iterdir())


def test_unknown_lattices_and_flat_cells_name_a_remedy(call, scenes, tmp_path):
    wrong = call("path", scenes / "lesson.toml", "--lattice", "hexagon")
    assert wrong.exit_code == 2 and "hexagonal" in wrong.stderr
    flat = tmp_path / "flat.toml"
    flat.write_text(
        'schema = 1\nlattice = "square8"\nstarts = [[0.5, 0.5]]\n[grid]\naxes = [{ name = "x", lower = 0, upper = 6, '
        'cells = 6 }, { name = "y", lower = 0, upper = 6, cells = 2 }]\n[[goal]]\ncell = [3, 1]\n'
    )
    result = call("path", flat)
    assert result.exit_code == 2 and "change the numbers of cells" in result.stderr


def test_resistances_of_a_lattice_are_those_between_named_nodes(answer, call, scenes):
    lesson = (scenes / "lesson.toml", "--lattice", "square8")
    refused = call("resistance", *lesson, "--between", "0.5,6.5", "6.5,1.5")
    assert refused.exit_code == 2
    assert "name nodes, such as n_3_4 or goal_0, or use --lattice square" in " ".join(refused.stderr.split())
    assert answer("resistance", *lesson, "--between", "n_0_6", "goal_0") != answer(
        "resistance", lesson[0], "--between", "n_0_6", "goal_0"
    )
