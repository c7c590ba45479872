"""Studies: made from a scene, space, netlist or deck; circuits are built once; every analysis is a method with figures.

Tests internals: `resgrid.chip`, `resgrid.chip.report`.
"""

from __future__ import annotations

import inspect
from pathlib import Path

import numpy as np
import pytest
from support.dynamics import small_scene

import resgrid as rg
from resgrid.chip import ANALYSES
from resgrid.chip.report import SECTIONS, report_section

METHODS = ("settling", "noise", "power", "adc_resolution", "sensitivity", "yields", "faults", "sweep")
QUICK_OPTIONS = {"yields": {"trials": 8, "batch": 8}, "faults": {"seconds": 1e-9}, "sweep": {"trials": 2}}


@pytest.fixture(scope="module")
def scene() -> rg.Scene:
    return rg.read_scene(Path(__file__).parents[2] / "examples/scenes/chip.toml")


@pytest.fixture(scope="module")
def made(scene: rg.Scene) -> rg.chip.Study:
    return rg.study(scene)


def test_a_study_builds_its_circuit_once_and_reproducibly(made: rg.chip.Study, scene: rg.Scene) -> None:
    assert made.netlist is made.netlist
    assert made.op is made.op
    assert made.op.netlist is made.netlist
    np.testing.assert_array_equal(made.netlist.conductance, rg.chip.build_chip(made.ideal, scene.chip).conductance)
    again = rg.study(rg.build_space(scene), scene.chip)
    np.testing.assert_array_equal(made.netlist.conductance, again.netlist.conductance)
    np.testing.assert_array_equal(rg.study(scene, space=rg.build_space(scene)).op.voltage, made.op.voltage)


@pytest.mark.parametrize("analysis", METHODS)
@pytest.mark.quick_cases(4)
def test_every_analysis_returns_figures_with_text_html_and_json(made: rg.chip.Study, analysis: str) -> None:
    result = getattr(made, analysis)(**QUICK_OPTIONS.get(analysis, {}))
    assert isinstance(
        result,
        rg.chip.Settling
        | rg.chip.Noise
        | rg.chip.Power
        | rg.chip.ADCResolution
        | rg.chip.Sensitivity
        | rg.chip.Yield
        | rg.chip.FaultAnalysis
        | rg.chip.Sweep,
    )
    assert all(isinstance(figure, rg.chip.Figure) and len(figure.definition) > 20 for figure in result.figures.values())
    assert "array" not in repr(result)
    assert len(repr(result)) < 1000
    page, data = result._repr_html_(), result.to_json()
    for name, figure in result.figures.items():
        assert f"<td>{name.replace('_', ' ')}</td>\n<td>{figure}</td>" in page
        assert data[name]["value"] == figure.value
    with pytest.raises(ValueError, match="read-only"):
        next(value for value in vars(result).values() if isinstance(value, np.ndarray) and value.size)[...] = 0


def test_default_options_come_from_the_chip(made: rg.chip.Study, scene: rg.Scene) -> None:
    readout = scene.chip.readout
    assert made.settling().bits == made.bits == readout.bits
    assert made.adc_resolution().span == made.settling().span == made.span
    assert made.noise().band == (0.0, readout.noise_bandwidth)
    assert made.noise().temperature == pytest.approx(scene.chip.temperature + 273.15)
    assert made.noise(temperature=100.0, band=(1.0, 2.0)).temperature == 100.0
    assert isinstance(made.yields(**QUICK_OPTIONS["yields"]).overall, rg.chip.Proportion)
    assert "netlist" not in inspect.signature(made.settling).parameters


def test_a_study_of_a_deck_equals_the_study_of_its_operating_point(tmp_path: Path) -> None:
    op = rg.solve(small_scene())
    written = rg.write_spice(op, tmp_path / "a.cir")
    deck = rg.read_spice(written.path)
    theirs, ours = rg.study(rg.solve(deck)), rg.study(op)
    assert theirs.power().total == pytest.approx(ours.power().total)
    assert theirs.settling(bits=8).settle_time == pytest.approx(ours.settling(bits=8).settle_time, rel=1e-6)
    assert repr(theirs).startswith("Study(chip: ")
    with pytest.raises(rg.InputError, match="wired already"):
        rg.study(op, boundary="neumann")


def test_a_study_accepts_another_boundary_than_the_scene(scene: rg.Scene) -> None:
    walled = rg.study(scene, rg.Chip(wall_resistance=1e3), boundary="wall")
    assert walled.ideal.cells.wiring.wall_resistance == 1e3
    assert "boundary" in walled._repr_html_()


def test_the_report_has_a_section_for_every_analysis_of_the_subcommand(made: rg.chip.Study) -> None:
    assert tuple(SECTIONS) == ANALYSES
    section = report_section("power", made)
    assert section.text[0].startswith("The chip takes ")
    assert {picture.name for picture in section.pictures} == {"power", "droop"}


@pytest.mark.parametrize("from_scene", [True, False], ids=["scene", "space"])
@pytest.mark.parametrize("own", [None, 2e3])
def test_the_wall_resistance_of_a_wiring_and_of_an_option_applies(
    scene: rg.Scene, own: float | None, from_scene: bool
) -> None:
    chip, source = rg.Chip(wall_resistance=own), scene if from_scene else rg.build_space(scene)
    wall = rg.Wiring("wall", wall_resistance=5e3)
    studies = {
        5e3: rg.study(source, chip, wall),
        3e3: rg.study(source, chip, boundary="wall", wall_resistance=3e3),
        7e3: rg.study(source, chip, wall, wall_resistance=7e3),
        4e3: rg.study(source, chip, rg.Wiring(), boundary="wall", wall_resistance=4e3),
        0.0: rg.study(source, chip, rg.Wiring("wall", wall_resistance=0.0)),
    }
    for value, study in studies.items():
        assert study.ideal.cells.wiring.wall_resistance == study.description.wall_resistance == value
        assert study.netlist.node_count == study.ideal.node_count
    if own is not None:
        assert rg.study(source, chip, rg.Wiring(), boundary="wall").ideal.cells.wiring.wall_resistance == own


def test_a_resistance_and_a_supply_among_the_options_replace_those_of_the_chip(scene: rg.Scene) -> None:
    space = rg.build_space(scene)
    for source in (scene, space):
        study = rg.study(source, rg.Chip(resistance=1e3, supply=2.0), resistance=5e3, supply=3.0)
        assert (study.description.resistance, study.description.supply, study.span) == (5e3, 3.0, 3.0)
        assert (study.ideal.cells.wiring.resistance, study.ideal.cells.wiring.supply) == (5e3, 3.0)
