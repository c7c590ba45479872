"""Analyses in decks, compared with ngspice results and with the grammars of other simulators; invalid ones."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.circuits import ladder
from support.grammar import strangers
from support.simulators import run, verdict, waves
from support.spaces import space_of
from support.tiles import tiled

import resgrid as rg

ALL = {
    "operating": [rg.spice.analyses.OperatingAnalysis()],
    "transient": [
        rg.spice.analyses.TransientAnalysis(2e-6, 4e-9),
        rg.spice.analyses.Measure("top", "n_0_0", "maximum"),
        rg.spice.analyses.Measure("low", "n_0_0", "minimum"),
        rg.spice.analyses.Measure("late", "n_0_1", "value", 1e-6),
        rg.spice.analyses.Measure("passed", "n_0_1", "crossing", 0.5),
    ],
    "noise": [rg.spice.analyses.NoiseAnalysis("n_0_0", 1e3, 1e9)],
    "temperature": [rg.spice.analyses.TemperatureAnalysis((27.0, 85.0))],
    "mismatch": [rg.spice.analyses.MismatchAnalysis(0.01, seed=3, runs=3)],
    "probes": [rg.spice.analyses.OperatingAnalysis(), rg.spice.analyses.Probe(("n_0_0",), ("v_obstacle",))],
}


def space(blocked: tuple[int, int] = (2, 3)) -> rg.ConfigurationSpace:
    cell = np.zeros((6, 5), dtype=np.uint8)
    cell[blocked], cell[5, 4] = 1, 2
    return space_of(cell)


def scene(blocked: tuple[int, int] = (2, 3), **options: object) -> rg.Netlist:
    return rg.compile_space(space(blocked), **options)


def tiles(blocked: tuple[int, int] = (2, 3), **options: object) -> tuple[rg.Netlist, rg.Chip]:
    names = ("supply", "wall_resistance")
    chip = rg.Chip(capacitance=1e-12, **{name: options[name] for name in names if name in options})
    return tiled(space(blocked), chip, **options)


def deck_text(deck: Any) -> str:
    files = [deck.path, deck.commands, deck.chip, deck.pattern]
    return "".join(file.read_text() for file in files if file is not None)


@pytest.mark.parametrize("form", ["flat", "cells"])
@pytest.mark.parametrize("dialect", ["xyce", "spectre"])
@pytest.mark.parametrize("asked", ALL.values(), ids=ALL)
def test_decks_conform_to_the_grammar_of_their_simulator(
    tmp_path: Path, dialect: str, form: str, asked: list[object]
) -> None:
    after = tiles((1, 1))[0] if form == "cells" else scene(supply=2.0)
    asked = [
        rg.spice.analyses.TransientAnalysis(2e-6, 4e-9, after)
        if isinstance(item, rg.spice.analyses.TransientAnalysis)
        else item
        for item in asked
    ]
    for options in ({}, {"boundary": "neumann"}, {"boundary": "wall", "wall_resistance": 1e4}):
        if options.get("boundary") == "neumann" and ("v_obstacle" in str(asked) or form == "flat"):
            continue
        if any(isinstance(item, rg.spice.analyses.TransientAnalysis) for item in asked) and options:
            continue
        netlist, chip = tiles(**options) if form == "cells" else (scene(**options), None)
        written = rg.write_spice(netlist, tmp_path / "a.cir", dialect, form=form, chip=chip, analyses=asked)
        assert strangers(deck_text(written), dialect) == []


def test_the_grammar_reports_foreign_lines() -> None:
    assert strangers("r_1 a b 1k\n", "xyce") == ["r_1 a b 1k"]
    assert strangers("r_1 a b 1.0\n", "spectre") == ["r_1 a b 1.0"]
    assert strangers(".ac dec 10 1 2\n", "xyce") != []


@pytest.mark.parametrize("dialect", ["ngspice", "ltspice", "hspice"])
def test_a_transient_starts_and_ends_at_both_operating_points(tmp_path: Path, dialect: str) -> None:
    (before, chip), (after, _) = tiles(), tiles((1, 1), supply=2.0)
    asked = [rg.spice.analyses.TransientAnalysis(4e-6, 4e-9, after)]
    written = rg.write_spice(before, tmp_path / "a.cir", dialect, form="cells", chip=chip, analyses=asked)
    run(written.commands, dialect)
    found = waves(tmp_path / "out.raw")
    for moment, netlist in ((0, before), (-1, after)):
        voltage = rg.solve(netlist).voltage
        for node in range(1, netlist.node_count):
            assert found[netlist.node_name(node)][moment] == pytest.approx(voltage[node], rel=0, abs=1e-6)


def test_measures_of_ngspice_agree_with_its_waveforms(tmp_path: Path) -> None:
    asked = [
        rg.spice.analyses.OperatingAnalysis(),
        *ALL["transient"],
        rg.spice.analyses.TemperatureAnalysis((27.0, 85.0)),
    ]
    (before, chip), (after, _) = tiles(), tiles((1, 1), supply=2.0)
    asked[1] = rg.spice.analyses.TransientAnalysis(2e-6, 4e-9, after)
    ends = [rg.solve(netlist) for netlist in (before, after)]
    middle = float(np.mean([point.voltage[point.netlist.cells.node[0, 1]] for point in ends]))
    asked[5] = rg.spice.analyses.Measure("passed", "n_0_1", "crossing", middle)
    written = rg.write_spice(before, tmp_path / "a.cir", form="cells", chip=chip, analyses=asked)
    command = written.commands.read_text().splitlines()[1].removeprefix("* ").split()
    assert command[:2] == ["ngspice", "-n"]
    said = run(written.commands).stdout
    measured = {name: float(value) for name, value in re.findall(r"^(\w+) += +(\S+)", said, re.MULTILINE)}
    found = waves(tmp_path / "out.raw", "Transient Analysis")
    time, corner, second = (np.array(found[name]) for name in ("time", "n_0_0", "n_0_1"))
    assert measured["top"] == pytest.approx(corner.max(), rel=1e-5)
    assert measured["low"] == pytest.approx(corner.min(), rel=1e-5)
    assert measured["late"] == pytest.approx(np.interp(1e-6, time, second), rel=1e-4)
    assert np.interp(measured["passed"], time, second) == pytest.approx(middle, rel=1e-3)


def test_a_transient_between_uniform_drives_ends_at_the_second_one(tmp_path: Path) -> None:
    (before, chip), (after, _) = tiles(boundary="neumann"), tiles((1, 1), boundary="neumann")
    asked = [rg.spice.analyses.TransientAnalysis(2e-5, 2e-8, after)]
    written = rg.write_spice(before, tmp_path / "a.cir", form="cells", chip=chip, analyses=asked)
    run(written.commands)
    found, voltage = waves(tmp_path / "out.raw"), rg.solve(after).voltage
    blocked = int(after.cells.node[1, 1])
    for node in set(range(1, after.node_count)) - {blocked}:  # that one discharges through open switches
        assert found[after.node_name(node)][-1] == pytest.approx(voltage[node], rel=1e-3, abs=1e-3)


def test_noise_is_the_thermal_noise_of_the_driving_point_resistance(tmp_path: Path) -> None:
    written = rg.write_spice(
        scene(), tmp_path / "a.cir", analyses=[rg.spice.analyses.NoiseAnalysis("n_2_2", 1.0, 10.0)]
    )
    run(written.commands)
    density = waves(tmp_path / "out.raw")["onoise_spectrum"][0]
    netlist = scene()
    node = int(netlist.cells.node[2, 2])
    probe = netlist.replace(
        source_volts=np.zeros(len(netlist.source_volts)), current_nodes=[[0, node]], current_amps=[1.0]
    )
    resistance = rg.solve(probe, accuracy="normwise").voltage[node]
    assert density == pytest.approx(math.sqrt(4 * 1.380649e-23 * 300.15 * resistance), rel=1e-4)


def test_noise_refers_to_a_grounded_source_of_the_deck(tmp_path: Path) -> None:
    ends, sources = [[1, 2], [2, 0], [3, 4]], [[3, 4], [1, 0]]
    netlist = rg.Netlist(5, ends, [1e-3, 1e-3, 1e-3], source_nodes=sources, source_volts=[1.0, 2.0])
    written = rg.write_spice(
        netlist, tmp_path / "a.cir", analyses=[rg.spice.analyses.NoiseAnalysis("node_2", 1.0, 10.0)]
    )
    assert "no AC value" not in run(written.commands).stdout
    density = waves(tmp_path / "out.raw")["onoise_spectrum"][0]
    assert density == pytest.approx(math.sqrt(4 * 1.380649e-23 * 300.15 * 500.0), rel=1e-4)
    without = rg.Netlist(2, [[1, 0]], [1.0], current_nodes=[[0, 1]], current_amps=[1.0])
    with pytest.raises(rg.InputError, match="the deck has none"):
        rg.write_spice(without, tmp_path / "b.cir", analyses=[rg.spice.analyses.NoiseAnalysis("node_1")])


def test_temperature_sweeps_agree_with_scaled_conductances(tmp_path: Path) -> None:
    netlist = scene()
    heated = netlist.replace(
        tc1=np.linspace(0, 5e-3, len(netlist.conductance)), tc2=np.full(len(netlist.conductance), 1e-6)
    )
    written = rg.write_spice(heated, tmp_path / "a.cir", analyses=[rg.spice.analyses.TemperatureAnalysis((27.0, 87.0))])
    run(written.commands)
    factor = 1 + heated.tc1 * 60 + heated.tc2 * 3600
    for celsius, scale in (("27.0", 1.0), ("87.0", factor)):
        found = waves(tmp_path / f"celsius.raw.{celsius}")
        voltage = rg.solve(netlist.replace(conductance=netlist.conductance / scale)).voltage
        assert found["n_4_3"][0] == pytest.approx(voltage[netlist.cells.node[4, 3]], rel=0, abs=1e-9)


@pytest.mark.parametrize("form", ["flat", "cells"])
def test_equal_seeds_give_equal_mismatch(tmp_path: Path, form: str) -> None:
    texts = []
    for i, seed in enumerate((1, 1, 2)):
        netlist, chip = tiles() if form == "cells" else (scene(), None)
        asked = [rg.spice.analyses.MismatchAnalysis(0.02, seed)]
        written = rg.write_spice(netlist, tmp_path / f"{i}.cir", form=form, chip=chip, analyses=asked)
        assert verdict(written.companion) == (0, "PASS")
        texts.append((written.chip or written.path).read_text().replace(f"{i}.cir", ""))
    assert texts[0] == texts[1] != texts[2]
    value = np.array(
        [
            float(x)
            for x in re.findall(r"resistance_\d=([\d.]+)" if form == "cells" else r"\nr_\S+ \S+ \S+ (\S+)", texts[0])
        ]
    )
    assert 0.01 < np.std(value / 1e4) < 0.03


@pytest.mark.parametrize("form", ["flat", "cells"])
def test_mismatch_runs_of_ngspice_are_reproducible(tmp_path: Path, form: str) -> None:
    found = []
    for name in ("a.cir", "b.cir"):
        netlist, chip = tiles() if form == "cells" else (scene(), None)
        asked = [rg.spice.analyses.MismatchAnalysis(0.05, 7, runs=4)]
        written = rg.write_spice(netlist, tmp_path / name, form=form, chip=chip, analyses=asked)
        assert written.companion is None
        run(written.commands)
        found.append([waves(tmp_path / f"run.raw.{i}")["n_4_3"][0] for i in range(1, 5)])
    assert found[0] == found[1]
    assert len(set(found[0])) == 4
    assert np.allclose(found[0], rg.solve(scene()).voltage[scene().cells.node[4, 3]], rtol=0.1)


def test_saturating_resistors_agree_with_behavioural_sources_of_ngspice(tmp_path: Path) -> None:
    netlist = ladder(4).replace(
        nonlinear_nodes=[[2, 0], [3, 4]], nonlinear_current=[2e-4, 1e-3], nonlinear_voltage=[0.1, 0.2]
    )
    voltage = rg.solve(netlist).voltage
    for dialect in ("ngspice", "ltspice", "hspice"):
        rg.write_spice(netlist, tmp_path / "a.cir", dialect)
        (tmp_path / "run").write_text('* run\n.include "a.cir"\n.op\n.end\n')
        run(tmp_path / "run", dialect)
        found = waves(tmp_path / "out.raw")
        for node in range(1, netlist.node_count):
            assert found[netlist.node_name(node)][0] == pytest.approx(voltage[node], rel=0, abs=1e-9)
    assert verdict(rg.write_spice(netlist, tmp_path / "a.cir").companion) == (0, "PASS")
    for dialect in ("xyce", "spectre"):
        assert strangers(deck_text(rg.write_spice(netlist, tmp_path / "b.cir", dialect)), dialect) == []


def test_the_sidecar_contains_analyses_and_expected_values(tmp_path: Path) -> None:
    asked = [rg.spice.analyses.TransientAnalysis(1e-6, 1e-9), rg.spice.analyses.NoiseAnalysis("n_0_0")]
    expected = {"noise": {"density": 1e-8}}
    netlist, chip = tiles()
    written = rg.write_spice(
        netlist, tmp_path / "a.cir", analyses=asked, expected=expected, scene_sha256="00", form="cells", chip=chip
    )
    sidecar = json.loads(written.sidecar.read_text())
    assert [item["kind"] for item in sidecar["analyses"]] == ["transient", "noise"]
    assert sidecar["expected"] == expected
    assert sidecar["scene_sha256"] == "00"
    assert 0 < sidecar["difference_from_flat"] < 5e-3
    with pytest.raises(rg.InputError, match="without NaN"):
        rg.write_spice(scene(), tmp_path / "a.cir", expected={"noise": float("nan")})


@pytest.mark.parametrize(
    ("asked", "options", "message"),
    [
        ([rg.spice.analyses.NoiseAnalysis("n_9_9")], {}, "no node or voltage source 'n_9_9'"),
        ([rg.spice.analyses.Probe(("n_0_0",), ("r_1",))], {}, "'r_1'"),
        (
            [rg.spice.analyses.OperatingAnalysis(), rg.spice.analyses.NoiseAnalysis("n_0_0")],
            {"dialect": "xyce"},
            "one analysis per file",
        ),
        ([rg.spice.analyses.Measure("top", "n_0_0", "maximum")], {}, "add a TransientAnalysis"),
        (
            [rg.spice.analyses.TransientAnalysis(1.0, 0.1), rg.spice.analyses.TransientAnalysis(1.0, 0.1)],
            {},
            "one of each",
        ),
        ([rg.spice.analyses.TransientAnalysis(1.0, 0.1, scene((1, 1)))], {}, "form='cells'"),
    ],
)
def test_inconsistent_analyses_raise_input_error_and_write_no_file(
    tmp_path: Path, asked: list[object], options: dict[str, str], message: str
) -> None:
    with pytest.raises(rg.InputError, match=message):
        rg.write_spice(scene(), tmp_path / "a.cir", analyses=asked, **options)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("make", "values"),
    [
        (rg.spice.analyses.TransientAnalysis, (1e-9, 1e-6)),
        (rg.spice.analyses.NoiseAnalysis, ("n", 10.0, 1.0)),
        (rg.spice.analyses.TemperatureAnalysis, ((-300.0,),)),
        (rg.spice.analyses.TemperatureAnalysis, ((),)),
        (rg.spice.analyses.MismatchAnalysis, (1.0,)),
        (rg.spice.analyses.MismatchAnalysis, (0.2, 0, 5)),
        (rg.spice.analyses.MismatchAnalysis, (0.01, -1)),
        (rg.spice.analyses.Measure, ("a b", "n", "maximum")),
        (rg.spice.analyses.Measure, ("a", "n", "value")),
        (rg.spice.analyses.Measure, ("a", "n", "median")),
        (rg.spice.analyses.Probe, ((),)),
    ],
)
def test_invalid_analyses_raise_input_error(make: type, values: tuple[object, ...]) -> None:
    with pytest.raises(rg.InputError):
        make(*values)
