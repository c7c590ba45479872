from __future__ import annotations

import numpy as np
import pytest
from support.dynamics import small_scene, with_capacitors
from support.spaces import space_of

import resgrid as rg
from resgrid.plot import (
    plot_bits_histogram,
    plot_noise,
    plot_power,
    plot_precision,
    plot_precision_page,
    plot_sensitivity,
    plot_served,
    plot_settling,
    plot_settling_curve,
    save_figure,
)


@pytest.fixture(scope="module")
def op() -> rg.OperatingPoint:
    return rg.solve(small_scene())


@pytest.fixture(scope="module")
def settled() -> rg.Settling:
    return rg.study(small_scene()).settling(bits=8)


@pytest.fixture(scope="module")
def noise() -> rg.Noise:
    return rg.study(small_scene()).noise(band=(0.0, 1e6))


@pytest.fixture(scope="module")
def power(op: rg.OperatingPoint) -> rg.Power:
    return rg.study(op).power()


@pytest.fixture(scope="module")
def bits(op: rg.OperatingPoint) -> dict[str, rg.Precision]:
    return {
        "Dirichlet": rg.study(op).precision(),
        "Neumann": rg.study(rg.solve(small_scene(boundary="neumann"))).precision(),
    }


def pixels(axes) -> np.ndarray:
    """Values of a map, shape of the space."""
    return np.ma.filled(axes.images[0].get_array().astype(float), np.nan).T


def test_a_map_shows_when_each_cell_settles(settled: rg.Settling) -> None:
    axes = plot_settling(settled)
    cell_map = settled.netlist.cells
    shown = pixels(axes)
    free = cell_map.space.cell == 0
    assert shown[free] == pytest.approx(1e9 * settled.node_time[cell_map.node[free]])
    assert np.isnan(shown[~free]).all()
    assert "settles in" in axes.get_title()
    assert "(ns)" in axes.child_axes[0].get_ylabel()


def test_the_curve_crosses_the_band_where_it_has_settled(settled: rg.Settling) -> None:
    axes = plot_settling_curve(settled)
    curve = axes.lines[0]
    band = settled.span / 2**9
    crossing = np.interp(-np.log(band), -np.log(curve.get_ydata()), curve.get_xdata())
    assert crossing == pytest.approx(settled.settle_time, rel=0.01)
    assert axes.get_yscale() == "log"


@pytest.mark.parametrize("quantity", ["total", "limit", "resistance"])
def test_a_map_shows_the_noise(noise: rg.Noise, quantity: str) -> None:
    axes = plot_noise(noise, quantity=quantity)
    cell_map = noise.netlist.cells
    shown, free = pixels(axes), cell_map.space.cell == 0
    ratio = shown[free] / getattr(noise, quantity)[cell_map.node[free]]
    assert np.ptp(ratio) < 1e-9 * ratio.max()
    assert round(np.log10(ratio[0])) % 3 == 0


def test_heat_and_its_ten_hottest_resistors(power: rg.Power) -> None:
    axes = plot_power(power)
    assert len(axes.collections[0].get_segments()) == 10
    heat = pixels(axes)
    assert np.nanmax(heat) == pytest.approx(1e6 * np.nanmax(power.cell_heat))
    goal = np.array([11.5, 2.5])
    assert np.abs(axes.collections[0].get_segments()[0] - goal).max() <= 1.5


def test_droop_lies_on_rail_cells() -> None:
    netlist = small_scene(rails="cells")
    power = rg.study(rg.solve(netlist)).power()
    axes = plot_power(power, quantity="droop")
    shown = pixels(axes)
    assert np.isfinite(shown[netlist.cells.space.cell != 0]).all()
    assert np.isnan(shown[netlist.cells.space.cell == 0]).all()


def test_resistors_that_decide_are_drawn_where_they_are(op: rg.OperatingPoint) -> None:
    result = rg.study(op).sensitivity((5, 5))
    axes = plot_sensitivity(result, drift=0.8)
    flips = result.flips(0.8)
    segments = axes.collections[1].get_segments()
    assert 0 < len(flips) == len(segments)
    cell = op.netlist.cell_of_node()
    for number, segment in zip(flips.tolist(), segments, strict=True):
        ends = cell[op.netlist.resistor_nodes[number]]
        if (ends >= 0).all():
            centres = np.stack(np.unravel_index(ends, (16, 16)), axis=1) + 0.5
            assert np.sort(segment, axis=0) == pytest.approx(np.sort(centres, axis=0))


def test_maps_of_bits(bits: dict[str, rg.Precision]) -> None:
    result = bits["Dirichlet"]
    for starts in (True, False):
        axes = plot_precision(result, starts=starts)
        wanted = result.start_bits if starts else result.cell_bits
        assert pixels(axes)[result.space.goal_connected] == pytest.approx(wanted[result.space.goal_connected])
    assert axes.get_title() == result.sentence()


def test_starts_that_no_bits_serve_are_named() -> None:
    cell = np.zeros((6, 5), dtype=np.uint8)
    cell[0, 0] = 2
    cell[3:5, 1:] = 1
    netlist = rg.compile_space(space_of(cell), boundary="neumann", drive="start", start=(3, 0))
    axes = plot_precision(rg.study(rg.solve(netlist)).precision())
    assert "no number of bits will do" in [text.get_text() for text in axes.get_legend().get_texts()]


def test_the_share_served_rises_to_one(bits: dict[str, rg.Precision]) -> None:
    axes = plot_served(bits)
    for line, result in zip(axes.lines, bits.values(), strict=False):
        share = line.get_ydata()
        assert (np.diff(share) >= 0).all()
        assert share[-1] == 1.0
        assert np.interp(10, line.get_xdata(), share) == pytest.approx(result.served(10), abs=0.02)
    counts = plot_bits_histogram(bits)
    assert "starts" in counts.get_ylabel()


def test_the_page_has_a_map_each_and_two_curves(bits: dict[str, rg.Precision], tmp_path) -> None:
    figure = plot_precision_page(bits, title="Precision")
    figure.canvas.draw()
    maps = [axes for axes in figure.findobj(lambda artist: hasattr(artist, "images")) if axes.images]
    assert [axes.get_title() for axes in maps] == list(bits)
    assert len({axes.images[0].get_clim() for axes in maps}) == 1
    sizes = [text.get_fontsize() for text in figure.findobj(lambda artist: hasattr(artist, "get_fontsize"))]
    assert min(sizes) >= 7
    assert save_figure(figure, tmp_path / "page.png").stat().st_size > 0


def test_what_cannot_be_drawn_is_refused(noise: rg.Noise, power: rg.Power) -> None:
    for draw in (plot_served, plot_bits_histogram, plot_precision_page):
        with pytest.raises(rg.InputError, match="nothing to draw"):
            draw({})
    with pytest.raises(rg.InputError, match="limit"):
        plot_noise(noise, quantity="colour")
    with pytest.raises(rg.InputError, match="droop"):
        plot_power(power, quantity="sound")
    with pytest.raises(rg.InputError, match="band"):
        plot_noise(rg.study(small_scene()).noise(), quantity="total")
    cube = np.zeros((4, 4, 4), dtype=np.uint8)
    cube[0, 0, 0] = 2
    solid = with_capacitors(rg.compile_space(space_of(cube)), 1e-12)
    with pytest.raises(rg.InputError, match="two axes"):
        plot_settling(rg.study(solid).settling())
    with pytest.raises(rg.InputError, match="not compiled"):
        plot_noise(rg.study(small_scene().replace(cell_map=None)).noise())
