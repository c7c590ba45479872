"""Energy of a plan: an independent count of the readings, scaling laws, and the section of the report.

Tests internals: `resgrid.chip.plan_energy`.
"""

import json

import numpy as np
import pytest
from support.cli import call

import resgrid as rg
from resgrid.chip.plan_energy import readings_from

LESSON = "examples/scenes/lesson.toml"


def study_of(**keys):
    readout = rg.chip.Readout(bits=10, figure_of_merit="50f", conversion_time="100n")
    return rg.study(rg.read_scene(LESSON), rg.Chip(capacitance="60f", readout=readout, **keys))


def counted(resolution, start):
    """Count the readings on the walk from one start, cell by cell."""
    space, cell, count = resolution.space, tuple(start), 0
    while space.cell[cell] != rg.Cell.GOAL:
        count += 1
        for axis in (0, 1):
            for step in (-1, 1):
                other = list(cell)
                other[axis] += step
                inside = 0 <= other[axis] < space.shape[axis]
                count += inside and space.cell[tuple(other)] != rg.Cell.OBSTACLE
        cell = tuple(int(k) for k in np.unravel_index(resolution.following[cell], space.shape))
    return count


def test_the_readings_of_every_start_equal_a_count_cell_by_cell():
    study = study_of()
    resolution = study.adc_resolution()
    readings = readings_from(resolution, study.netlist.cells)
    starts = np.argwhere(resolution.space.goal_connected)
    assert [readings[tuple(start)] for start in starts] == [counted(resolution, start) for start in starts]


def test_the_parts_add_up():
    energy = study_of().plan_energy()
    assert energy.readout_energy == pytest.approx(energy.conversions * 50e-15 * 1024)
    assert energy.supply_energy == pytest.approx(energy.power * energy.conversions * 100e-9)
    assert energy.total == energy.settling_energy + energy.supply_energy + energy.readout_energy
    assert energy.time == energy.settle_time + energy.readout_time


def test_the_settling_energy_does_not_depend_on_the_resistance():
    small, large = (study_of(resistance=ohms).plan_energy() for ohms in (1e4, 1e5))
    assert large.settling_energy == pytest.approx(small.settling_energy, rel=1e-6)
    assert large.settle_time == pytest.approx(10 * small.settle_time, rel=1e-6)
    assert large.supply_energy == pytest.approx(small.supply_energy / 10, rel=1e-6)


def test_a_chip_without_capacitance_is_an_error_that_names_the_key():
    with pytest.raises(rg.InputError, match=r"chip\.capacitance"):
        rg.study(rg.read_scene(LESSON)).plan_energy()


def test_the_report_compares_the_energy_with_a_digital_processor(tmp_path):
    keys = ("capacitance=60f", "readout.figure_of_merit=50f", "readout.conversion_time=100n")
    sets = [word for key in keys for word in ("--set", f"chip.{key}")]
    result = call("chip", LESSON, "--only", "plan_energy", "--no-check", *sets, "-o", tmp_path / "out", "--json")
    assert result.exit_code == 0, result.stderr
    text = (tmp_path / "out" / "report.md").read_text()
    assert "1.5 µJ" in text
    assert "40 nm" in text
    assert "is incomplete" not in text
    value = {name: figure["value"] for name, figure in json.loads(result.stdout)["analyses"]["plan_energy"].items()}
    parts = value["settling_energy"] + value["supply_energy"] + value["readout_energy"]
    assert 0 < value["readout_energy"] < value["plan_energy"] == pytest.approx(parts)
