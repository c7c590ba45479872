"""Links that contain a whole scene: reading them back, damaged links, and links as arguments of the command line.

Tests internals: `resgrid.live_page.drawing`, `resgrid.live_page.examples`, `resgrid.live_page.solving`,
`resgrid.scene.overrides`, `resgrid.scene.reading`.
"""

from __future__ import annotations

import base64
import json
import zlib
from dataclasses import replace

import numpy as np
import pytest
from support.cli import answer, call

import resgrid as rg
from resgrid.live_page.drawing import blank, drawing_of
from resgrid.live_page.examples import open_example
from resgrid.live_page.solving import solve_drawing
from resgrid.scene.overrides import document_of
from resgrid.scene.reading import is_link, read_link


def link(document: object) -> str:
    content = zlib.compress(json.dumps(document).encode())
    return f"http://127.0.0.1:8017/#s={base64.urlsafe_b64encode(content).decode().rstrip('=')}"


def test_a_link_reads_back_as_its_scene():
    drawing = blank(12)
    address = link(drawing.document())
    assert is_link(address) and not is_link("http://127.0.0.1/") and not is_link("rooms.toml")
    np.testing.assert_array_equal(drawing_of(read_link(address)).cell, drawing.cell)


def test_path_and_run_accept_a_link_instead_of_a_scene_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    address = link(blank(12).document())
    assert answer("path", address)["paths"][0]["outcome"] == "reached"
    assert answer("path", address, "--k", "0.5")["paths"][0]["k"] == 0.5
    assert call("run", address, "--no-check").exit_code == 0
    assert (tmp_path / "out" / "scene" / "paths.csv").exists()


@pytest.mark.parametrize(
    "address",
    [link({"schema": 1})[:-9], "http://x/#s=@@", "http://x/#s=AAAA", link([1]), link({"map": {"file": "/etc/passwd"}})],
)
def test_a_damaged_link_raises_input_error(address):
    with pytest.raises(rg.InputError, match="link"):
        read_link(address)


def test_a_link_with_a_changed_letter_is_rejected_or_the_same_scene():
    """The checksum detects the change, except in unused last bits of a letter."""
    drawing = replace(blank(12), broken=((3, 4, 0),), chip={"mismatch": 0.1, "seed": 7})
    address = link(drawing.document())
    document, first, rng = document_of(read_link(address)), address.index("#s=") + 3, np.random.default_rng(0)
    letters = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_"
    for place in rng.integers(first, len(address), 2000):
        letter = letters[rng.integers(64)]
        try:
            scene = read_link(address[:place] + letter + address[place + 1 :])
        except rg.InputError:
            continue
        assert document_of(scene) == document


def test_links_contain_broken_resistors_mismatch_and_wall_resistance():
    chip = {"mismatch": 0.1, "seed": 7, "defects": {"open_density": 0.01}}
    drawing = replace(blank(12), broken=((3, 4, 0), (12, 4, 0)), wall=2e3, chip=chip)
    again = drawing_of(read_link(link(drawing.document())))
    assert again.broken == drawing.broken and again.wall == 2e3
    assert {key: again.chip[key] for key in ("mismatch", "seed")} == {"mismatch": 0.1, "seed": 7}
    assert again.chip["defects"]["open_density"] == 0.01
    whole = drawing_of(read_link(link(replace(drawing, broken=()).document())))
    assert whole.broken == ()


def test_resistors_broken_on_the_page_are_open_in_build_chip(tmp_path):
    """The page solves the circuit of `resgrid.chip.build_chip` for the chip description in the link."""
    drawing = replace(blank(12), broken=((3, 4, 0), (5, 2, 1)), chip={"mismatch": 0.1, "seed": 7})
    scene = read_link(link(drawing.document()))
    ideal = rg.compile_space(rg.build_space(scene))
    chip = rg.chip.build_chip(ideal, scene.chip)
    assert len(chip.conductance) == len(ideal.conductance) - 2
    frame = solve_drawing(drawing, exact=True)
    np.testing.assert_array_equal(frame.field.potential, rg.field(rg.solve(chip)).potential)
    assert "chip.defects.open_at" in answer("path", link(drawing.document()))["ignored"]


def test_a_link_keeps_the_arm_until_its_cells_are_painted_over():
    drawing = drawing_of(open_example("chair"))
    moved = replace(drawing, k=0.5, starts=np.array([[1.0, -1.0]]), broken=((3, 4, 0),))
    scene = read_link(link(moved.document()))
    assert isinstance(scene.robot, rg.Arm) and scene.k == (0.5,) and scene.starts == ((1.0, -1.0),)
    again = drawing_of(scene)
    assert again.world is not None and again.broken == moved.broken
    np.testing.assert_array_equal(again.cell, drawing.cell)
    cell = drawing.cell.copy()
    cell[:9, :9] = 1
    painted = drawing_of(read_link(link(replace(moved, cell=cell).document())))
    assert painted.world is None
    np.testing.assert_array_equal(painted.cell, cell)
