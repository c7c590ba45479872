"""Tiles: the expanded netlist, one chip for many scenes, and what readers and simulators make of the text."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings, strategies as st
from support.simulators import run, verdict, waves
from support.spaces import space_of, spaces

import resgrid as rg
from resgrid.spice.read.deck import read_spice
from resgrid.spice.write.files import write_spice
from resgrid.spice.write.tiles import Tile, expanded_netlist

ROOM = [[0, 0, 0, 0, 0], [0, 1, 1, 0, 0], [0, 0, 0, 0, 2], [0, 1, 0, 0, 0]]
BOUNDARIES = [
    {},
    {"edge": "open"},
    {"boundary": "neumann"},
    {"boundary": "neumann", "drive": "start", "start": (0, 0)},
    {"boundary": "wall", "wall_resistance": 3.3e4},
]
IDEAL = Tile(
    goal_switch_on=1e-3,
    goal_switch_off=1e13,
    obstacle_switch_on=1e-3,
    obstacle_switch_off=1e13,
    internodal_switch_on=1e-3,
    internodal_switch_off=1e13,
)


def room(conductive: bool = False) -> rg.ConfigurationSpace:
    conductivity = np.random.default_rng(0).uniform(0.5, 2, (4, 5)) if conductive else None
    return space_of(ROOM, spacing=(1.0, 2.0), periodic=(True, False), conductivity=conductivity)


def difference(flat: rg.Netlist, tiled: rg.Netlist) -> float:
    """Largest difference of a free cell's voltage."""
    cells = np.isin(flat.cells.node, flat.cells.free_node)
    a, b = rg.solve(flat), rg.solve(tiled)
    return float(np.abs(a.voltage[flat.cells.node[cells]] - b.voltage[tiled.cells.node[cells]]).max())


@pytest.mark.parametrize("options", BOUNDARIES, ids=str)
@pytest.mark.parametrize("conductive", [False, True])
def test_ideal_switches_make_the_flat_netlist(options: dict[str, object], conductive: bool) -> None:
    flat = rg.compile_space(room(conductive), **options)
    if options.get("boundary") == "neumann" and "drive" not in options:
        flat = rg.scale_drive(flat, rg.solve(flat))
    errors = [difference(flat, expanded_netlist(flat, tile)) for tile in (Tile(), IDEAL)]
    assert errors[1] < 1e-6 < errors[0] < 5e-3


def test_the_rails_of_the_flat_netlist_do_not_matter() -> None:
    merged, cells = (expanded_netlist(rg.compile_space(room(), rails=rails)) for rails in ("merged", "cells"))
    np.testing.assert_array_equal(merged.conductance, cells.conductance)
    np.testing.assert_array_equal(merged.resistor_nodes, cells.resistor_nodes)


def test_paths_on_tiles_are_certified() -> None:
    field = rg.field(rg.solve(expanded_netlist(rg.compile_space(room()))))
    path = rg.streamline(field, start=(0.5, 1.0))
    rg.certify(path)
    assert str(path.outcome) == "reached"


def test_one_chip_serves_many_scenes(tmp_path: Path) -> None:
    other = np.array(ROOM)
    other[0, 3], other[1, 1], other[3, 3] = 1, 0, 2
    scenes = [rg.compile_space(space_of(cell, spacing=(1.0, 2.0))) for cell in (ROOM, other)]
    a, b = (write_spice(netlist, tmp_path / f"{i}.cir", form="cells") for i, netlist in enumerate(scenes))
    assert a.chip.read_bytes() == b.chip.read_bytes()
    assert a.pattern.read_bytes() != b.pattern.read_bytes()
    b.chip.write_bytes(a.chip.read_bytes())
    assert verdict(b.companion) == (0, "PASS")


@pytest.mark.parametrize("dialect", ["ngspice", "ltspice", "hspice"])
@pytest.mark.parametrize("options", BOUNDARIES, ids=str)
def test_ngspice_finds_the_expanded_netlist(tmp_path: Path, dialect: str, options: dict[str, object]) -> None:
    netlist, tile = rg.compile_space(room(conductive=True), **options), Tile(capacitance=1e-12)
    written = write_spice(netlist, tmp_path / "a.cir", dialect, form="cells", tile=tile)
    (tmp_path / "run").write_text('* run\n.include "a.cir"\n.op\n.end\n')
    run(tmp_path / "run", dialect)
    found, tiled = waves(tmp_path / "out.raw"), expanded_netlist(netlist, tile)
    voltage = rg.solve(tiled).voltage
    for node in range(1, tiled.node_count):
        assert found[tiled.node_name(node)][0] == pytest.approx(voltage[node], rel=0, abs=1e-9)
    if dialect == "ngspice":
        assert verdict(written.companion) == (0, "PASS")
        assert rg.check_deck(written.path).agrees


@settings(max_examples=25, suppress_health_check=list(HealthCheck))
@given(
    spaces(max_cells=6),
    st.sampled_from([BOUNDARIES[0], BOUNDARIES[2], BOUNDARIES[4]]),
    st.sampled_from(["ngspice", "ltspice", "xyce", "hspice"]),
    st.sampled_from(["flat", "cells"]),
)
def test_what_is_written_is_read_back(
    tmp_path_factory: pytest.TempPathFactory,
    space: rg.ConfigurationSpace,
    options: dict[str, object],
    dialect: str,
    form: str,
) -> None:
    tile = Tile(capacitance=1e-12, internodal_switch_on=50.0)
    try:
        netlist = rg.compile_space(space, **options)
        wanted = rg.solve(netlist if form == "flat" else expanded_netlist(netlist, tile))
    except rg.CircuitError:
        assume(False)
    written = write_spice(netlist, tmp_path_factory.mktemp("deck") / "a.cir", dialect, form=form, tile=tile)
    read = read_spice(written.path, dialect=dialect).netlist()
    found = dict(zip(read.names_of(np.arange(read.node_count)), rg.solve(read).voltage.tolist(), strict=True))
    names = wanted.netlist.names_of(np.arange(wanted.netlist.node_count))
    held = np.flatnonzero(np.isfinite(wanted.voltage))
    scale = max(1.0, float(np.abs(wanted.voltage[held]).max()))
    for node in held.tolist():
        assert found[names[node]] == pytest.approx(wanted.voltage[node], rel=0, abs=1e-12 * scale)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"goal_switch_on": 0.0}, "goal_switch_on = 0.0 must be positive"),
        ({"obstacle_switch_on": 1e11}, "must be below"),
        ({"capacitance": -1e-12}, "capacitance"),
        ({"resistance": float("nan")}, "resistance"),
    ],
)
def test_a_tile_that_cannot_be_is_refused(values: dict[str, float], message: str) -> None:
    with pytest.raises(rg.InputError, match=message):
        Tile(**values)


def test_a_netlist_without_cells_has_no_tiles(tmp_path: Path) -> None:
    bare = rg.Netlist(2, [[0, 1]], [1.0], source_nodes=[[1, 0]], source_volts=[1.0])
    with pytest.raises(rg.InputError, match="not compiled from a space"):
        write_spice(bare, tmp_path / "a.cir", form="cells")
    with pytest.raises(rg.InputError, match="choose one of flat, cells"):
        write_spice(bare, tmp_path / "a.cir", form="tiles")
    assert list(tmp_path.iterdir()) == []


def test_tiles_in_a_row_keep_the_states_of_their_neighbours_apart(tmp_path):
    """A parameter of a tile must not share its name with the state of one: ngspice would take the tile's own."""
    space = rg.ConfigurationSpace([rg.Axis("x", 0, 3, 3)], [2, 0, 1])
    written = rg.write_spice(rg.compile_space(space, rails="cells"), tmp_path / "row.cir", form="cells")
    names = re.findall(r"\b(state\w*)=", written.path.with_name("row.cir.chip").read_text())
    assert not set(names) & {f"state_{cell}" for cell in range(3)}
    assert rg.check_deck(written.path).agrees
