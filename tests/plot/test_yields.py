"""Pictures of many chips: what is drawn is what was found."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from support.spaces import space_of

import resgrid as rg


def space() -> rg.ConfigurationSpace:
    cell = np.zeros((7, 6), dtype=np.uint8)
    cell[2:5, 3] = 1
    cell[1, 1] = 2
    return space_of(cell)


CHIP = rg.Chip(mismatch=0.05, goal_switch_on=200.0, readout=rg.Readout(bits=7))


def test_yield_is_drawn_by_start() -> None:
    result = rg.study(rg.study(space(), CHIP).ideal, CHIP).yields(trials=32, batch=32)
    axes = rg.plot_yield(result)
    shown = np.ma.filled(axes.images[0].get_array(), np.nan)
    assert np.nanmax(shown) == pytest.approx(100 * np.nanmax(result.probability))
    assert f"{100 * result.overall.value:.1f} %" in axes.get_title()
    assert "32 chips" in axes.get_title()


def test_exploration_marks_the_cheapest_points() -> None:
    result = rg.study(space(), CHIP).exploration(("mismatch", [0.0, 0.1]), ("readout.bits", [4, 8, 16]), trials=8)
    axes = rg.plot_exploration(result, share=0.9)
    np.testing.assert_allclose(axes.images[0].get_array(), 100 * result.share.T)
    (marks,) = (line for line in axes.lines if line.get_marker() == "o")
    expected = [result.second_values.index(value) for value in result.cheapest(0.9)]
    assert list(marks.get_ydata()) == expected
    assert [label.get_text() for label in axes.get_xticklabels()] == ["0 %", "10 %"]
    single = rg.study(space(), CHIP).exploration(("readout.offset", [1e-3]), ("readout.bits", [8]), trials=2)
    assert rg.plot_exploration(single).get_xlabel() == "readout, offset (V)"


@pytest.mark.parametrize("chip", [CHIP, rg.Chip(saturation_voltage=0.5)])
def test_criticality_draws_the_elements_that_cost_starts(chip: rg.Chip) -> None:
    netlist = rg.build_chip(rg.study(space(), chip).ideal, chip)
    result = rg.study(netlist).criticality(readout=rg.Readout(bits=7), seconds=5.0)
    for fault in ("open", "short"):
        axes = rg.plot_criticality(result, fault=fault)
        drawn = [lines.get_array() for lines in axes.collections if isinstance(lines, LineCollection)]
        values = np.concatenate([array for array in drawn if array is not None])
        bent = bool(netlist.cell_map.nonlinear_face.size)
        lost = getattr(result, fault)[len(netlist.conductance) if bent else 0 :]
        face = netlist.cells.nonlinear_face if bent else netlist.cells.resistor_face
        assert sorted(values) == sorted(lost[(lost > 0) & (face[: len(lost)] >= 0)])
    with pytest.raises(rg.InputError, match="fault"):
        rg.plot_criticality(result, fault="bent")
