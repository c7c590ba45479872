"""Pictures of chip results, compared with the values in the results."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from support.dynamics import small_scene, with_capacitors
from support.spaces import space_of

import resgrid as rg


@pytest.fixture(scope="module")
def op() -> rg.OperatingPoint:
    return rg.solve(small_scene())


@pytest.fixture(scope="module")
def settled() -> rg.chip.Settling:
    return rg.study(small_scene()).settling(bits=8)


@pytest.fixture(scope="module")
def noise() -> rg.chip.Noise:
    return rg.study(small_scene()).noise(band=(0.0, 1e6))


@pytest.fixture(scope="module")
def power(op: rg.OperatingPoint) -> rg.chip.Power:
    return rg.study(op).power()


@pytest.fixture(scope="module")
def bits(op: rg.OperatingPoint) -> dict[str, rg.chip.ADCResolution]:
    return {
        "Dirichlet": rg.study(op).adc_resolution(),
        "Neumann": rg.study(rg.solve(small_scene(boundary="neumann"))).adc_resolution(),
    }


def pixels(axes) -> np.ndarray:
    """Values of a map, shape of the space."""
    return np.ma.filled(axes.images[0].get_array().astype(float), np.nan).T


def test_the_settling_map_shows_the_settling_times_of_cells(settled: rg.chip.Settling) -> None:
    axes = rg.draw(settled)
    cell_map = settled.netlist.cells
    shown = pixels(axes)
    free = cell_map.space.cell == 0
    assert shown[free] == pytest.approx(1e9 * settled.node_time[cell_map.node[free]])
    assert np.isnan(shown[~free]).all()
    assert "settles in" in axes.get_title()
    assert "(ns)" in axes.child_axes[0].get_ylabel()


def test_the_settling_curve_crosses_the_band_at_the_settling_time(settled: rg.chip.Settling) -> None:
    axes = rg.draw(settled, quantity="curve")
    curve = axes.lines[0]
    band = settled.span / 2**9
    crossing = np.interp(-np.log(band), -np.log(curve.get_ydata()), curve.get_xdata())
    assert crossing == pytest.approx(settled.settle_time, rel=0.01)
    assert axes.get_yscale() == "log"


@pytest.mark.parametrize("quantity", ["total", "limit", "resistance"])
def test_noise_maps_are_proportional_to_the_noise_of_nodes(noise: rg.chip.Noise, quantity: str) -> None:
    axes = rg.draw(noise, quantity=quantity)
    cell_map = noise.netlist.cells
    shown, free = pixels(axes), cell_map.space.cell == 0
    ratio = shown[free] / getattr(noise, quantity)[cell_map.node[free]]
    assert np.ptp(ratio) < 1e-9 * ratio.max()
    assert round(np.log10(ratio[0])) % 3 == 0


def test_the_power_map_shows_cell_heat_and_ten_resistors(power: rg.chip.Power) -> None:
    axes = rg.draw(power)
    assert len(axes.collections[0].get_segments()) == 10
    heat = pixels(axes)
    assert np.nanmax(heat) == pytest.approx(1e6 * np.nanmax(power.cell_heat))
    goal = np.array([11.5, 2.5])
    assert np.abs(axes.collections[0].get_segments()[0] - goal).max() <= 1.5


def test_the_droop_map_has_values_on_rail_cells_only() -> None:
    netlist = small_scene(rails="cells")
    power = rg.study(rg.solve(netlist)).power()
    axes = rg.draw(power, quantity="droop")
    shown = pixels(axes)
    assert np.isfinite(shown[netlist.cells.space.cell != 0]).all()
    assert np.isnan(shown[netlist.cells.space.cell == 0]).all()


def test_resistors_that_flip_a_start_are_drawn_between_their_cells(op: rg.OperatingPoint) -> None:
    result = rg.study(op).sensitivity((5, 5))
    axes = rg.draw(result, drift=0.8)
    flips = result.flips(0.8)
    segments = axes.collections[1].get_segments()
    assert 0 < len(flips) == len(segments)
    cell = op.netlist.cell_of_node()
    for number, segment in zip(flips.tolist(), segments, strict=True):
        ends = cell[op.netlist.resistor_nodes[number]]
        if (ends >= 0).all():
            centres = np.stack(np.unravel_index(ends, (16, 16)), axis=1) + 0.5
            assert np.sort(segment, axis=0) == pytest.approx(np.sort(centres, axis=0))


def test_resolution_maps_show_the_bits_of_starts_or_cells(bits: dict[str, rg.chip.ADCResolution]) -> None:
    result = bits["Dirichlet"]
    for starts in (True, False):
        axes = rg.draw(result, starts=starts)
        wanted = result.start_bits if starts else result.cell_bits
        assert pixels(axes)[result.space.goal_connected] == pytest.approx(wanted[result.space.goal_connected])
    assert axes.get_title() == result.sentence()


def test_starts_beyond_any_resolution_have_a_legend() -> None:
    cell = np.zeros((6, 5), dtype=np.uint8)
    cell[0, 0] = 2
    cell[3:5, 1:] = 1
    netlist = rg.compile_space(space_of(cell), boundary="neumann", drive="start", start=(3, 0))
    axes = rg.draw(rg.study(rg.solve(netlist)).adc_resolution())
    assert "no resolution suffices" in [text.get_text() for text in axes.get_legend().get_texts()]


def test_the_fraction_of_served_starts_rises_to_1(bits: dict[str, rg.chip.ADCResolution]) -> None:
    axes = rg.draw(bits, quantity="served")
    for line, result in zip(axes.lines, bits.values(), strict=False):
        share = line.get_ydata()
        assert (np.diff(share) >= 0).all()
        assert share[-1] == 1.0
        assert np.interp(10, line.get_xdata(), share) == pytest.approx(result.served(10), abs=0.02)


def test_a_figure_of_several_results_has_one_colour_scale(bits: dict[str, rg.chip.ADCResolution]) -> None:
    figure = rg.draw(bits, title="Precision")
    maps = [axes for axes in figure.findobj(lambda artist: hasattr(artist, "images")) if axes.images]
    assert [axes.get_title() for axes in maps] == list(bits)
    assert len({axes.images[0].get_clim() for axes in maps}) == 1


def test_unknown_quantities_and_unsuitable_results_raise_input_error(
    noise: rg.chip.Noise, power: rg.chip.Power, bits: dict[str, rg.chip.ADCResolution]
) -> None:
    for value in (noise, power, bits):
        with pytest.raises(rg.InputError, match="quantity = 'colour' must be '"):
            rg.draw(value, quantity="colour")
    with pytest.raises(rg.InputError, match="band"):
        rg.draw(rg.study(small_scene()).noise(), quantity="total")
    cube = np.zeros((4, 4, 4), dtype=np.uint8)
    cube[0, 0, 0] = 2
    solid = with_capacitors(rg.compile_space(space_of(cube)), 1e-12)
    with pytest.raises(rg.InputError, match="two axes"):
        rg.draw(rg.study(solid).settling())
    with pytest.raises(rg.InputError, match="not compiled"):
        rg.draw(rg.study(small_scene().replace(cell_map=None)).noise())


def plain_space() -> rg.ConfigurationSpace:
    cell = np.zeros((7, 6), dtype=np.uint8)
    cell[2:5, 3] = 1
    cell[1, 1] = 2
    return space_of(cell)


CHIP = rg.Chip(mismatch=0.05, goal_switch_on=200.0, readout=rg.chip.Readout(bits=7))


def test_the_yield_map_shows_percentages_and_the_number_of_chips() -> None:
    result = rg.study(plain_space(), CHIP).yields(trials=32, batch=32)
    axes = rg.draw(result)
    shown = pixels(axes)
    assert np.nanmax(shown) == pytest.approx(100 * np.nanmax(result.probability))
    assert f"{100 * result.overall.value:.1f} %" in axes.get_title()
    assert "32 chips" in axes.get_title()


def test_the_sweep_picture_marks_the_cheapest_points() -> None:
    result = rg.study(plain_space(), CHIP).sweep(("mismatch", [0.0, 0.1]), ("readout.bits", [4, 8, 16]), trials=8)
    axes = rg.draw(result, share=0.9)
    np.testing.assert_allclose(axes.images[0].get_array(), 100 * result.share.T)
    (marks,) = (line for line in axes.lines if line.get_marker() == "o")
    expected = [result.second_values.index(value) for value in result.cheapest(0.9)]
    assert list(marks.get_ydata()) == expected
    assert [label.get_text() for label in axes.get_xticklabels()] == ["0 %", "10 %"]
    single = rg.study(plain_space(), CHIP).sweep(("readout.offset", [1e-3]), ("readout.bits", [8]), trials=2)
    assert rg.draw(single).get_xticklabels()[0].get_text() == "1 mV"


@pytest.mark.parametrize("chip", [CHIP, pytest.param(rg.Chip(saturation_voltage=0.5), marks=pytest.mark.slow)])
def test_the_fault_picture_shows_elements_whose_faults_lose_starts(chip: rg.Chip) -> None:
    netlist = rg.chip.build_chip(rg.study(plain_space(), chip).ideal, chip)
    result = rg.study(netlist).faults(readout=rg.chip.Readout(bits=7), seconds=5.0)
    for fault in ("open", "short"):
        axes = rg.draw(result, fault=fault)
        drawn = [lines.get_array() for lines in axes.collections if isinstance(lines, LineCollection)]
        values = np.concatenate([array for array in drawn if array is not None])
        bent = bool(netlist.cell_map.nonlinear_face.size)
        lost = getattr(result, fault)[len(netlist.conductance) if bent else 0 :]
        face = netlist.cells.nonlinear_face if bent else netlist.cells.resistor_face
        assert sorted(values) == sorted(lost[(lost > 0) & (face[: len(lost)] >= 0)])
    with pytest.raises(rg.InputError, match="fault"):
        rg.draw(result, fault="bent")
