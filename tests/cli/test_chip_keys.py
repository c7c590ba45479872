"""Every key of [chip] is applied by every verb, rejected by name, or reported as ignored; the list is the schema's.

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

# What a chip says beside the key so that this makes a difference, and a value of the key.
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
    "defects.open_density": ({}, 0.1),
    "defects.open_at": ({}, [[4, 2, 0], [4, 3, 1]]),
    "defects.short_density": ({}, 0.1),
    "defects.short_resistance": ({"defects.short_density": 0.1}, 10.0),
}
HARMLESS_TO_FIELDS = {
    "resistance": "the potential is a share of the supply, currents are in units of supply / R",
    "supply": "the same",
    "wall_resistance": "it is applied",
    "capacitance": "no current flows through it once the grid has settled",
}
TWO_CHIPS = [
    ({key: value for key, (_, value) in KEYS.items() if key not in (*AREA, *SHEET, "drawing_grid")}, "wall"),
    (
        {
            key: value
            for key, (_, value) in KEYS.items()
            if key not in ("length", "mismatch", "preferred", "saturation_voltage")
        },
        "neumann",
    ),
]


def written(folder: Path, chip: dict[str, Any], boundary: str, name: str = "scene.toml") -> Path:
    """A scene of 6 x 5 cells with this chip."""
    rows = "".join(f"{key} = {json.dumps(value)}\n" for key, value in chip.items())
    text = f'schema = 1\nboundary = "{boundary}"\nstarts = [[0.5, 0.5]]\n[chip]\n{rows}[grid]\naxes = [\n'
    text += '{ name = "x", lower = 0, upper = 6, cells = 6 },\n{ name = "y", lower = 0, upper = 5, cells = 5 }\n]\n'
    text += '[[obstacle]]\nshape = "rectangle"\nlower = [2, 0]\nupper = [3, 3]\n[[goal]]\ncell = [5, 1]\n'
    (folder / name).write_text(text)
    return folder / name


def boundary_of(key: str) -> str:
    return {"wall_resistance": "wall", "internodal_switch_off": "neumann"}.get(key, "dirichlet")


@pytest.fixture
def scenes_of(tmp_path: Path, request: pytest.FixtureRequest) -> tuple[str, Path, Path]:
    """A key, a scene without it (or with its other value), and the same with it."""
    key = request.param
    beside, value = KEYS[key]
    before = written(tmp_path, beside, boundary_of(key), "before.toml")
    return key, before, written(tmp_path, {**beside, key: value}, boundary_of(key), "after.toml")


DECKS: dict[tuple[str, str], str] = {}
"""Decks of scenes without a key, by scene and dialect."""

each_key = pytest.mark.parametrize("scenes_of", KEYS, indirect=True)


def test_every_key_of_the_schema_is_decided() -> None:
    tables = {name: rg.scene_schema()["$defs"][name]["properties"] for name in ("Chip", "Readout", "Defects")}
    keys = set(tables["Chip"]) - {"readout", "defects"}
    keys |= {f"{name.lower()}.{key}" for name in ("Readout", "Defects") for key in tables[name]}
    assert keys == set(KEYS) == set(chip_keys(rg.Chip()))


@each_key
def test_a_flat_deck_of_every_dialect_holds_it_or_says_not(call, scenes_of) -> None:
    key, before, after = scenes_of
    for dialect in DIALECTS:
        result, scene = call("compile", after, "--dialect", dialect), (before.read_text(), dialect)
        if scene not in DECKS:
            DECKS[scene] = call("compile", before, "--dialect", dialect).stdout
        assert (result.stdout == DECKS[scene]) is (key in READING) is (f"chip.{key}" in result.stderr)


@each_key
def test_tiles_hold_it_or_refuse_it(call, answer, tmp_path, scenes_of) -> None:
    key, before, after = scenes_of
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
@pytest.mark.parametrize("verb", ["path", "info"])
def test_fields_and_paths_apply_it_or_report_it(answer, call, scenes_of, verb) -> None:
    key, _, after = scenes_of
    assert (f"chip.{key}" in answer(verb, after)["ignored"]) is (key not in HARMLESS_TO_FIELDS)
    assert (f"chip.{key}" in call(verb, after).stderr) is (key not in HARMLESS_TO_FIELDS)


@pytest.mark.parametrize(("chip", "boundary"), TWO_CHIPS)
def test_every_verb_means_the_same_circuit(answer, call, tmp_path, chip, boundary) -> None:
    scene, deck, out = written(tmp_path, chip, boundary), tmp_path / "a.cir", tmp_path / "out"
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
    told = json.loads(deck.with_name("a.cir.json").read_text())["nodes"]
    potential = np.load(tmp_path / "a.npz")["potential"]
    volts = [told[name]["voltage"] for name in ("n_0_0", "n_1_1", "n_5_4")]
    share = [potential[cell] for cell in ((0, 0), (1, 1), (5, 4))]
    assert (share[1] - share[2]) / (share[0] - share[2]) == pytest.approx((volts[1] - volts[2]) / (volts[0] - volts[2]))
    assert set(answer("control", scene)["ignored"]) == ideal
    assert set(answer("plot", scene, "-o", tmp_path / "a.png", "--what", "space")["ignored"]) == ideal


def test_an_ideal_chip_has_nothing_to_say(answer, call, lesson, tmp_path) -> None:
    for words in (("compile",), ("solve",), ("path",), ("info",), ("check", "--rules")):
        assert answer(words[0], lesson, *words[1:])["ignored"] == []
    assert call("solve", lesson).stderr == ""
    data = answer("compile", lesson, "--form", "cells", "-o", tmp_path / "a.cir")
    assert data["assumed"] == {
        f"chip.{rail}_switch_{state}": ohms
        for rail in ("goal", "obstacle")
        for state, ohms in (("on", 10.0), ("off", 1e10))
    }


@pytest.mark.parametrize("verb", ["compile", "solve", "check", "info", "plot", "control", "chip"])
def test_blends_that_a_verb_leaves_out_are_named(call, room, tmp_path, verb) -> None:
    room.write_text(room.read_text().replace("starts", "k = [0.5, 1.0, 0.0]\nstarts").replace(", [5.5, 4.5]", ""))
    words = {
        "plot": ("-o", tmp_path / "a.png", "--what", "potential"),
        "chip": ("-o", tmp_path / "out", "--only", "power", "--no-check"),
        "check": ("--rules",),
    }
    result = call(verb, room, *words.get(verb, ()), "--json")
    assert "k" in json.loads(result.stdout)["ignored"]
    assert "k = " in result.stderr


@pytest.mark.parametrize("verb", ["solve", "path", "info"])
def test_a_drive_of_what_a_rail_drives_is_named(answer, room, verb) -> None:
    words = (verb, room, "--start", "0.5,0.5", "--set", "boundary=neumann", "--set", "drive=uniform")
    assert answer(*words, "--k", 1)["ignored"] == ["drive"]
    assert answer(*words)["ignored"] == []
