"""Decks of tiles, compared with flat netlists, with ngspice, and with the decks read back."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings, strategies as st
from support.simulators import run, verdict, waves
from support.spaces import space_of, spaces
from support.tiles import tiled

import resgrid as rg

ROOM = [[0, 0, 0, 0, 0], [0, 1, 1, 0, 0], [0, 0, 0, 0, 2], [0, 1, 0, 0, 0]]
BOUNDARIES = [
    {},
    {"edge": "open"},
    {"boundary": "neumann"},
    {"boundary": "neumann", "drive": "start", "start": (0, 0)},
    {"boundary": "wall", "wall_resistance": 3.3e4},
]
IDEAL = {f"{name}_switch_{end}": ohms for name in ("goal", "obstacle", "internodal") for end, ohms in
         (("on", 1e-3), ("off", 1e13))}  # fmt: skip


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
def test_tiles_with_ideal_switches_equal_the_flat_netlist(options: dict[str, object], conductive: bool) -> None:
    flat = rg.compile_space(room(conductive), **options)
    wall = options.get("wall_resistance")
    errors = [
        difference(flat, tiled(room(conductive), rg.Chip(wall_resistance=wall, **switches), **options)[0])
        for switches in ({}, IDEAL)
    ]
    highest = float(np.nanmax(rg.solve(flat).voltage))
    assert errors[1] < 1e-6 * highest and errors[1] < errors[0] < 5e-3 * highest


def test_paths_on_tiles_are_certified() -> None:
    field = rg.field(rg.solve(tiled(room())[0]))
    path = rg.streamline(field, start=(0.5, 1.0))
    rg.certify(path)
    assert str(path.outcome) == "reached"


def test_one_chip_file_is_valid_for_several_scenes(tmp_path: Path) -> None:
    other = np.array(ROOM)
    other[0, 3], other[1, 1], other[3, 3] = 1, 0, 2
    scenes = [tiled(space_of(cell, spacing=(1.0, 2.0))) for cell in (ROOM, other)]
    a, b = (
        rg.write_spice(netlist, tmp_path / f"{i}.cir", form="cells", chip=chip)
        for i, (netlist, chip) in enumerate(scenes)
    )
    assert a.chip.read_bytes() == b.chip.read_bytes()
    assert a.pattern.read_bytes() != b.pattern.read_bytes()
    b.chip.write_bytes(a.chip.read_bytes())
    assert verdict(b.companion) == (0, "PASS")


@pytest.mark.parametrize("dialect", ["ngspice", "ltspice", "hspice"])
@pytest.mark.parametrize("options", BOUNDARIES, ids=str)
def test_ngspice_agrees_with_the_netlist_of_tiles(tmp_path: Path, dialect: str, options: dict[str, object]) -> None:
    described = rg.Chip(
        capacitance=1e-12, mismatch=0.1, gradient=(0.2,), wall_resistance=options.get("wall_resistance")
    )
    netlist, chip = tiled(room(conductive=True), described, **options)
    written = rg.write_spice(netlist, tmp_path / "a.cir", dialect, form="cells", chip=chip)
    (tmp_path / "run").write_text('* run\n.include "a.cir"\n.op\n.end\n')
    run(tmp_path / "run", dialect)
    found, voltage = waves(tmp_path / "out.raw"), rg.solve(netlist).voltage
    for node in range(1, netlist.node_count):
        highest = max(1.0, float(np.abs(voltage).max()))
        assert found[netlist.node_name(node)][0] == pytest.approx(voltage[node], rel=0, abs=1e-9 * highest)
    if dialect == "ngspice":
        assert verdict(written.companion) == (0, "PASS")
        assert rg.check_deck(written.path).agrees


@pytest.mark.slow
@settings(max_examples=25, suppress_health_check=list(HealthCheck))
@given(
    spaces(max_cells=6),
    st.sampled_from([BOUNDARIES[0], BOUNDARIES[2], BOUNDARIES[4]]),
    st.sampled_from(["ngspice", "ltspice", "xyce", "hspice", "spectre"]),
    st.sampled_from(["flat", "cells"]),
)
def test_written_decks_read_back_with_equal_voltages(
    tmp_path_factory: pytest.TempPathFactory,
    space: rg.ConfigurationSpace,
    options: dict[str, object],
    dialect: str,
    form: str,
) -> None:
    described = rg.Chip(
        capacitance=1e-12, internodal_switch_on=50.0, wall_resistance=options.get("wall_resistance"), pelgrom=3.0,
        width=1e-6, length=1e-6, preferred="E24",
    )  # fmt: skip
    try:
        netlist, chip = tiled(space, described, **options)
        wanted = rg.solve(netlist)
    except rg.CircuitError:
        assume(False)
    folder = tmp_path_factory.mktemp("deck")
    written = rg.write_spice(wanted, folder / "a.cir", dialect, form=form, chip=chip)
    read = rg.read_spice(written.path, dialect=dialect).netlist()
    found = dict(zip(read.names_of(np.arange(read.node_count)), rg.solve(read).voltage.tolist(), strict=True))
    names = wanted.netlist.names_of(np.arange(wanted.netlist.node_count))
    held = np.flatnonzero(np.isfinite(wanted.voltage))
    scale = max(1.0, float(np.abs(wanted.voltage[held]).max()))
    for node in held.tolist():
        assert found[names[node]] == pytest.approx(wanted.voltage[node], rel=0, abs=1e-12 * scale)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"goal_switch_on": None}, r"set chip\.goal_switch_on"),
        ({"goal_switch_on": 20.0}, "is not an array of tiles"),
        ({"internodal_switch_on": 2e4, "internodal_switch_off": 1e9}, "is not an array of tiles"),
        ({"wall_resistance": 1.0}, ""),
    ],
)
def test_a_chip_that_does_not_match_the_netlist_raises_input_error(
    tmp_path: Path, values: dict[str, float], message: str
) -> None:
    netlist, chip = tiled(room())
    other = dataclasses.replace(chip, **values)
    if not message:
        assert rg.write_spice(netlist, tmp_path / "a.cir", form="cells", chip=other).chip is not None
        return
    with pytest.raises(rg.InputError, match=message):
        rg.write_spice(netlist, tmp_path / "a.cir", form="cells", chip=other)


@pytest.mark.parametrize(
    "values",
    [
        {"rail_resistance": 1.0},
        {"saturation_voltage": 0.3},
        {"readout": rg.chip.Readout(input_resistance=1e8)},
        {"defects": rg.chip.Defects(open_density=0.2)},
        {"tc1": 1e-3},
    ],
    ids=str,
)
def test_effects_outside_tiles_raise_input_error(tmp_path: Path, values: dict[str, Any]) -> None:
    netlist, chip = tiled(room(), rg.Chip(**values))
    with pytest.raises(rg.InputError, match="write a flat deck"):
        rg.write_spice(netlist, tmp_path / "a.cir", form="cells", chip=chip)
    assert list(tmp_path.iterdir()) == []


def test_a_netlist_without_cells_has_no_tiles(tmp_path: Path) -> None:
    bare = rg.Netlist(2, [[0, 1]], [1.0], source_nodes=[[1, 0]], source_volts=[1.0])
    with pytest.raises(rg.InputError, match="compiled from a space"):
        rg.write_spice(bare, tmp_path / "a.cir", form="cells")
    with pytest.raises(rg.InputError, match="'flat' or 'cells'"):
        rg.write_spice(bare, tmp_path / "a.cir", form="tiles")
    assert list(tmp_path.iterdir()) == []


def test_tile_parameters_and_states_have_different_names(tmp_path):
    """If a tile parameter had the name of a state, ngspice would use the parameter instead."""
    space = rg.ConfigurationSpace([rg.Axis("x", 0, 3, 3)], [2, 0, 1])
    netlist, chip = tiled(space)
    written = rg.write_spice(netlist, tmp_path / "row.cir", form="cells", chip=chip)
    names = re.findall(r"\b(state\w*)=", written.path.with_name("row.cir.chip").read_text())
    assert not set(names) & {f"state_{cell}" for cell in range(3)}
    assert rg.check_deck(written.path).agrees
