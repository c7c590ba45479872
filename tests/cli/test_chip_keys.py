"""Every key of [chip] in the schema is applied, rejected or reported as ignored by every subcommand.

Tests internals: `resgrid.chip.build`, `resgrid.spice.dialects`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import resgrid as rg
from resgrid.chip.build import READING, chip_keys
from resgrid.spice.dialects import DIALECTS

SHEET = {"sheet_resistance": 250.0, "width": 1e-6}
AREA = {"pelgrom": 4.0, "width": 1e-6, "length": 9e-6}

# Other keys that the key needs to have an effect, and a value of the key.
KEYS: dict[str, tuple[dict[str, Any], Any]] = {
    "resistance": ({}, 4.7e3),
    "supply": ({}, 3.3),
    "wall_resistance": ({"wall_resistance": 1e3}, 5e3),
    "capacitance": ({}, 1e-12),
    "goal_switch_on": ({}, 100.0),
    "goal_switch_off": ({}, 1e8),
    "obstacle_switch_on": ({}, 100.0),
    "obstacle_switch_off": ({}, 1e8),
    "internodal_switch_on": ({}, 100.0),
    "internodal_switch_off": ({}, 1e8),
    "process": ({}, "ihp-sg13g2:rhigh"),
    "corner": ({"process": "ihp-sg13g2:rppd"}, "high"),
    "mismatch": ({}, 0.1),
    "pelgrom": (AREA, 5.0),
    "width": (AREA, 2e-6),
    "length": (AREA, 4e-6),
    "gradient": ({}, [0.1]),
    "temperature": ({"tc1": 1e-3}, 85.0),
    "tc1": ({}, 1e-3),
    "tc2": ({"tc1": 1e-3}, 1e-6),
    "preferred": ({"resistance": 5e3}, "E6"),
    "sheet_resistance": (SHEET, 333.0),
    "drawing_grid": (SHEET, 3e-6),
    "rail_resistance": ({}, 1.0),
    "saturation_voltage": ({}, 0.2),
    "seed": ({"mismatch": 0.1}, 3),
    "readout.input_resistance": ({}, 1e8),
    "readout.offset": ({}, 1e-3),
    "readout.noise_bandwidth": ({}, 1e6),
    "readout.bits": ({}, 8),
    "readout.range": ({}, [0.0, 2.0]),
    "readout.figure_of_merit": ({}, 5e-14),
    "readout.conversion_time": ({}, 1e-6),
    "defects.open_density": ({}, 0.1),
    "defects.open_at": ({}, [[4, 2, 0], [4, 3, 1]]),
    "defects.short_density": ({}, 0.1),
    "defects.short_resistance": ({"defects.short_density": 0.1}, 10.0),
}
HARMLESS_TO_FIELDS = {
    "corner": "it scales all resistances alike",
    "resistance": "the potential is a fraction of the supply, currents are in units of supply / R",
    "supply": "the potential is a fraction of the supply, currents are in units of supply / R",
    "wall_resistance": "it is applied",
    "capacitance": "no current flows through it once the grid has settled",
}
TWO_CHIPS = [
    (
        {
            key: value
            for key, (_, value) in KEYS.items()
            if key not in (*AREA, *SHEET, "drawing_grid", "process", "corner")
        },
        "wall",
    ),
    (
        {
            key: value
            for key, (_, value) in KEYS.items()
            if key not in ("process", "corner", "length", "mismatch", "preferred", "saturation_voltage")
        },
        "neumann",
    ),
]


def write_scene(folder: Path, chip: dict[str, Any], boundary: str, name: str = "scene.toml") -> Path:
    """Write a scene of 6 x 5 cells with this chip."""
    rows = "".join(f"{key} = {json.dumps(value)}\n" for key, value in chip.items())
    text = f'schema = 1\nboundary = "{boundary}"\nstarts = [[0.5, 0.5]]\n[chip]\n{rows}[grid]\naxes = [\n'
    text += '{ name = "x", lower = 0, upper = 6, cells = 6 },\n{ name = "y", lower = 0, upper = 5, cells = 5 }\n]\n'
    text += '[[obstacle]]\nshape = "rectangle"\nlower = [2, 0]\nupper = [3, 3]\n[[goal]]\ncell = [5, 1]\n'
    (folder / name).write_text(text)
    return folder / name


def boundary_of(key: str) -> str:
    return {"wall_resistance": "wall", "internodal_switch_off": "neumann"}.get(key, "dirichlet")


@pytest.fixture
def key_scenes(tmp_path: Path, request: pytest.FixtureRequest) -> tuple[str, Path, Path]:
    """Return a key, a scene without the key (or with another value), and a scene with the key."""
    key = request.param
    others, value = KEYS[key]
    before = write_scene(tmp_path, others, boundary_of(key), "before.toml")
    return key, before, write_scene(tmp_path, {**others, key: value}, boundary_of(key), "after.toml")


DECKS: dict[tuple[str, str], str] = {}
"""Decks of scenes without a key, by scene and dialect."""

each_key = pytest.mark.parametrize("key_scenes", KEYS, indirect=True)


def test_every_key_of_the_schema_is_tested() -> None:
    tables = {name: rg.scene_schema()["$defs"][name]["properties"] for name in ("Chip", "Readout", "Defects")}
    keys = set(tables["Chip"]) - {"readout", "defects"}
    keys |= {f"{name.lower()}.{key}" for name in ("Readout", "Defects") for key in tables[name]}
    assert keys == set(KEYS) == set(chip_keys(rg.Chip()))


@each_key
def test_flat_decks_of_every_dialect_contain_a_key_or_report_it(call, key_scenes) -> None:
    key, before, after = key_scenes
    for dialect in DIALECTS:
        result, scene = call("compile", after, "--dialect", dialect), (before.read_text(), dialect)
        if scene not in DECKS:
            DECKS[scene] = call("compile", before, "--dialect", dialect).stdout
        assert (result.stdout == DECKS[scene]) is (key in READING) is (f"chip.{key}" in result.stderr)


@each_key
def test_decks_of_cells_contain_a_key_report_it_or_reject_it(call, answer, tmp_path, key_scenes) -> None:
    key, before, after = key_scenes
    result = call("compile", after, "--form", "cells", "-o", tmp_path / "after.cir")
    if result.exit_code:
        assert result.exit_code == 2
        assert f"chip.{key}" in result.stderr
        assert not (tmp_path / "after.cir").exists()
        return
    data = answer("compile", after, "--form", "cells", "-o", tmp_path / "after.cir")
    assert call("compile", before, "--form", "cells", "-o", tmp_path / "before.cir").exit_code == 0
    one, other = (
        "".join((tmp_path / f"{name}.cir{suffix}").read_text() for suffix in ("", ".chip", ".pattern"))
        for name in ("before", "after")
    )
    assert (one.replace("before", "after") == other) is (f"chip.{key}" in data["ignored"]) is (key in READING)
    assert f"chip.{key}" not in data["assumed"]


@each_key
@pytest.mark.parametrize("subcommand", ["path", "info"])
def test_path_and_info_apply_a_key_or_report_it_as_ignored(answer, call, key_scenes, subcommand) -> None:
    key, _, after = key_scenes
    assert (f"chip.{key}" in answer(subcommand, after)["ignored"]) is (key not in HARMLESS_TO_FIELDS)
    assert (f"chip.{key}" in call(subcommand, after).stderr) is (key not in HARMLESS_TO_FIELDS)


@pytest.mark.parametrize(("chip", "boundary"), TWO_CHIPS)
@pytest.mark.quick_cases(1)
def test_all_subcommands_use_the_same_circuit(answer, call, tmp_path, chip, boundary) -> None:
    scene, deck, out = write_scene(tmp_path, chip, boundary), tmp_path / "a.cir", tmp_path / "out"
    call("compile", scene, "-o", deck)
    lines = deck.read_text().splitlines()[1:]
    assert call("convert", scene, "-o", "-").stdout.splitlines()[1:] == lines
    unused = {"chip.wall_resistance"} if "wall_resistance" in chip and boundary != "wall" else set()
    ideal = {f"chip.{key}" for key in chip if key not in HARMLESS_TO_FIELDS} | unused
    if boundary == "wall":
        ran = answer("run", scene, "-o", out, "--no-check")
        assert (out / "wall.cir").read_text().splitlines()[1:] == lines
        assert set(ran["ignored"]) == ideal
    else:
        assert answer("chip", scene, "-o", out, "--only", "power", "--no-check")["ignored"] == []
        assert (out / "op.cir").read_text().splitlines()[1:] == lines
    checked = answer("check", scene, "--deck", deck, "--tolerance", 1e-6)
    solved = answer("solve", scene, "-o", tmp_path / "a.npz")
    assert set(solved["ignored"]) == set(checked["ignored"]) == {f"chip.{key}" for key in READING} | unused
    assert checked["agrees"]
    nodes = json.loads(deck.with_name("a.cir.json").read_text())["nodes"]
    potential = np.load(tmp_path / "a.npz")["potential"]
    volts = [nodes[name]["voltage"] for name in ("n_0_0", "n_1_1", "n_5_4")]
    share = [potential[cell] for cell in ((0, 0), (1, 1), (5, 4))]
    assert (share[1] - share[2]) / (share[0] - share[2]) == pytest.approx((volts[1] - volts[2]) / (volts[0] - volts[2]))
    assert set(answer("control", scene)["ignored"]) == ideal
    assert set(answer("plot", scene, "-o", tmp_path / "a.png", "--what", "space")["ignored"]) == ideal


def test_an_ideal_chip_has_no_ignored_keys(answer, call, lesson, tmp_path) -> None:
    for words in (("compile",), ("solve",), ("path",), ("info",), ("check", "--rules")):
        assert answer(words[0], lesson, *words[1:])["ignored"] == []
    assert call("solve", lesson).stderr == ""
    data = answer("compile", lesson, "--form", "cells", "-o", tmp_path / "a.cir")
    assert data["assumed"] == {
        f"chip.{rail}_switch_{state}": ohms
        for rail in ("goal", "obstacle")
        for state, ohms in (("on", 10.0), ("off", 1e10))
    }


@pytest.mark.parametrize("subcommand", ["compile", "solve", "check", "info", "plot", "control", "chip"])
def test_blends_that_a_subcommand_does_not_use_are_reported(call, room, tmp_path, subcommand) -> None:
    room.write_text(room.read_text().replace("starts", "k = [0.5, 1.0, 0.0]\nstarts").replace(", [5.5, 4.5]", ""))
    words = {
        "plot": ("-o", tmp_path / "a.png", "--what", "potential"),
        "chip": ("-o", tmp_path / "out", "--only", "power", "--no-check"),
        "check": ("--rules",),
    }
    result = call(subcommand, room, *words.get(subcommand, ()), "--json")
    assert "k" in json.loads(result.stdout)["ignored"]
    assert "k = " in result.stderr


@pytest.mark.parametrize("subcommand", ["solve", "path", "info"])
def test_a_drive_without_effect_on_a_dirichlet_grid_is_reported(answer, room, subcommand) -> None:
    words = (subcommand, room, "--start", "0.5,0.5", "--set", "boundary=neumann", "--set", "drive=uniform")
    assert answer(*words, "--k", 1)["ignored"] == ["drive"]
    assert answer(*words)["ignored"] == []
