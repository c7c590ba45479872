"""Lattices of the live page: pictures, currents and circuits of nodes, compared with `rg.planning.lattice_field`.

Tests internals: `resgrid.live_page.drawing`, `resgrid.live_page.examples`, `resgrid.live_page.frames`,
`resgrid.live_page.messages`, `resgrid.live_page.saving`, `resgrid.live_page.settle`, `resgrid.live_page.solving`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

import resgrid as rg
from resgrid.live_page.drawing import Drawing, blank, drawing_of
from resgrid.live_page.examples import open_example
from resgrid.live_page.frames import NO_VALUE, describe, picture_of, probe
from resgrid.live_page.messages import DrawingHead, read_drawing, write_drawing
from resgrid.live_page.saving import save
from resgrid.live_page.settle import settle
from resgrid.live_page.solving import solve_drawing

Lattice = Literal["square8", "hexagonal"]
LATTICES: tuple[Lattice, ...] = ("square8", "hexagonal")


def lesson(lattice: Lattice) -> Drawing:
    return replace(drawing_of(open_example("lesson")), lattice=lattice)


@pytest.mark.parametrize("lattice", LATTICES)
@pytest.mark.parametrize("name", ["lesson", "ring", "mud", "corridor"])
def test_the_page_shows_the_certified_node_paths_of_rg_plan(name: str, lattice: Lattice) -> None:
    drawing = replace(drawing_of(open_example(name)), lattice=lattice)
    frame = solve_drawing(drawing, exact=True)
    expected = rg.plan(drawing.scene(), k=drawing.k).paths()
    assert len(frame.paths) == len(expected) > 0
    for path, other in zip(frame.paths, expected, strict=True):
        assert isinstance(path, rg.planning.NodePath) and path.outcome == "reached"
        np.testing.assert_allclose(path.line, other.line, rtol=1e-12)
        rg.certify(path)


@pytest.mark.parametrize("lattice", LATTICES)
@pytest.mark.quick_cases(1)
def test_a_drawing_with_a_lattice_survives_messages_and_scenes(lattice: Lattice) -> None:
    drawing = lesson(lattice)
    head, body = write_drawing(drawing)
    assert read_drawing(DrawingHead.model_validate(head["drawing"]), body).lattice == lattice
    assert drawing_of(drawing.scene()).lattice == drawing.scene().lattice == lattice
    for kind in ("toml", "json", "csv", "deck", "svg", "circuit"):
        assert save(drawing, kind)[1]


@pytest.mark.parametrize("lattice", LATTICES)
@pytest.mark.parametrize("k", [0.0, 0.5, 1.0])
def test_the_picture_shows_the_node_nearest_to_the_centre_of_every_cell(lattice: Lattice, k: float) -> None:
    frame = solve_drawing(replace(lesson(lattice), k=k), exact=True)
    field = frame.field
    assert isinstance(field, rg.planning.LatticeField)
    sites = field.lattice.central_sites
    index = np.stack(np.unravel_index(sites, field.lattice.shape), axis=-1)
    np.testing.assert_array_equal(field.lattice.cells(index), np.moveaxis(np.indices(sites.shape), 0, -1))
    scale, picture = picture_of(frame)
    value = scale["low"] + picture / (NO_VALUE - 1) * (scale["high"] - scale["low"])
    expected = field.potential.ravel()[sites]
    if scale["kind"] == "decades":
        expected, value = 1.0 - expected, 10.0**value
    free = field.space.cell == rg.Cell.FREE
    np.testing.assert_allclose(value[free], expected[free], rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("lattice", LATTICES)
def test_currents_of_probe_obey_kirchhoff_s_current_law_and_follow_the_path(lattice: Lattice) -> None:
    frame = solve_drawing(replace(blank(16), lattice=lattice), exact=True)
    (path,) = frame.paths
    assert isinstance(path, rg.planning.NodePath)
    shown = probe(frame, [8, 8])
    steps = {arrow: amperes for arrow, amperes, _ in shown["steps"]}
    assert len(steps) == {"square8": 8, "hexagonal": 6}[lattice]
    assert abs(sum(steps.values())) <= 1e-6 * max(map(abs, steps.values()))
    assert "amperes" not in shown and shown["bits"] is None
    assert shown["proved"][0] == "the largest current density leads to a lower potential"
    for node, cell, after in zip(path.nodes[:-2], path.cells, path.nodes[1:], strict=False):
        sites = path.field.lattice
        if np.ravel_multi_index(tuple(node), sites.shape) != sites.central_sites[tuple(cell)]:
            continue  # another node represents this cell
        steps = probe(frame, cell.tolist())["steps"]
        way = sites.points(after) - sites.points(node)
        angle = round(np.arctan2(*way[::-1]) / (np.pi / 4)) % 8
        taken = [(arrow, amperes) for arrow, amperes, leads in steps if leads]
        assert [arrow for arrow, _ in taken] == ["→↗↑↖←↙↓↘"[angle]] and taken[0][1] > 0


@pytest.mark.parametrize("lattice", LATTICES)
def test_moving_dots_follow_the_largest_currents(lattice: Lattice) -> None:
    frame = solve_drawing(lesson(lattice), exact=True)
    _, body = describe(frame)
    currents = np.frombuffer(body[2], np.int8).reshape(8, 8, 4).astype(float)
    np.testing.assert_array_equal(currents[..., ::2], currents[..., 1::2])
    speed = np.frombuffer(body[3], np.uint8).reshape(8, 8)
    free = frame.field.space.cell == rg.Cell.FREE
    assert np.all(speed[free] > 0) and not speed[~free].any()
    assert currents[6, 2, 2] < 0 and abs(currents[6, 2, 2]) == 127  # above the goal, dots move down


@pytest.mark.parametrize("lattice", LATTICES)
@pytest.mark.parametrize("k", [0.0, 1.0])
def test_the_circuit_has_the_resistors_of_the_netlist(lattice: Lattice, k: float) -> None:
    frame = solve_drawing(replace(lesson(lattice), k=k), exact=True)
    (op,) = frame.solution.operating_points.values()
    circuit = describe(frame)[0]["circuit"]
    a, b, c, d, ohms, volts, amperes = np.array(circuit["segments"]).T
    contacts = np.array(circuit["contacts"]).reshape(-1, 3)
    siemens = op.netlist.conductance.sum()
    assert np.sum(1.0 / ohms) + np.sum(1.0 / contacts[:, 2]) == pytest.approx(siemens, rel=1e-12)
    assert bool(len(contacts)) == (k == 1.0)
    np.testing.assert_allclose(volts, ohms * amperes, rtol=1e-9)
    longest = {"square8": 2**0.5, "hexagonal": 1.0}[lattice]
    assert np.hypot(c - a, d - b).max() == pytest.approx(longest)
    assert len(circuit["nodes"]) == len(op.netlist.lattice_map.free_node)
    assert [supply["rail"] for supply in circuit["supplies"]] == (["obstacles", "goal 0"] if k else ["goal 0"])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"chip": {"mismatch": 0.1}}, "choose the lattice square, or set the mismatch to none"),
        ({"broken": ((3, 3, 0),)}, "repair the resistors"),
        ({"leak": 0.1}, "a leak to the obstacle rail needs cells with face neighbours"),
    ],
)
def test_what_a_lattice_does_not_support_is_rejected_with_a_remedy(change: dict[str, object], said: str) -> None:
    with pytest.raises(rg.InputError, match=said):
        solve_drawing(replace(lesson("square8"), **change), exact=True)


def test_a_transient_of_a_lattice_is_rejected_with_a_remedy() -> None:
    with pytest.raises(rg.InputError, match="choose the lattice square"):
        settle(lesson("hexagonal"), None)


def test_a_lattice_has_no_previews() -> None:
    assert solve_drawing(replace(blank(48), lattice="square8"), exact=False).exact
