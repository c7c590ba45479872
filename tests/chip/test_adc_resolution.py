"""Resolution of the read-out (bits): exact corridors by mpmath, and the definition evaluated cell by cell."""

from __future__ import annotations

import json

import mpmath
import numpy as np
import pytest
from support.dynamics import small_scene
from support.spaces import space_of

import resgrid as rg


def corridor_netlist(width: int, length: int = 64) -> rg.Netlist:
    """Return a corridor: the goal across one end, the walls and the other end at the supply voltage."""
    cell = np.zeros((length + 1, width), dtype=np.uint8)
    cell[0] = 2
    return rg.compile_space(space_of(cell))


@pytest.mark.parametrize(("width", "bits"), [(8, 34.0), (4, 56.7)])
def test_bits_at_the_end_of_a_corridor_equal_the_exact_series(width: int, bits: float) -> None:
    result = rg.study(rg.solve(corridor_netlist(width))).adc_resolution()
    assert result.cell_bits[-1].max() == pytest.approx(bits, abs=0.05)
    assert result.cell_bits[-1].max() == pytest.approx(exact_corridor_bits(width, 64), abs=1e-9)
    assert np.nanmax(result.start_bits) == pytest.approx(bits, abs=0.05)


def exact_corridor_bits(width: int, length: int) -> float:
    """Return the bits at the far corner from the sine series of the discrete corridor, with 60 or 500 digits."""
    with mpmath.workdps(500 if length > 100 else 60):

        def drop(x: int, y: int) -> mpmath.mpf:
            total = mpmath.mpf(0)
            for k in range(1, width + 1):
                angle = mpmath.pi * k / (width + 1)
                beta = mpmath.acosh(2 - mpmath.cos(angle))
                weight = sum(mpmath.sin(angle * j) for j in range(1, width + 1)) * 2 / (width + 1)
                decay = mpmath.sinh(beta * (length + 1 - x)) / mpmath.sinh(beta * (length + 1))
                total += weight * mpmath.sin(angle * y) * decay
            return total

        best = max(drop(length - 1, 1), drop(length, 2))
        return float(mpmath.log(1 / (best - drop(length, 1)), 2))


def test_bits_are_exact_where_voltage_differences_underflow_doubles() -> None:
    result = rg.study(rg.solve(corridor_netlist(2, 800))).adc_resolution()
    assert result.cell_bits[-1, 0] == pytest.approx(exact_corridor_bits(2, 800), abs=1e-6)
    assert result.cell_bits[-1, 0] > 1100


@pytest.mark.parametrize("options", [{}, {"boundary": "neumann"}, {"boundary": "wall", "wall_resistance": 30e3}])
def test_bits_follow_from_the_definition_cell_by_cell(options: dict[str, object]) -> None:
    op = rg.solve(small_scene(**options))
    result = rg.study(op).adc_resolution()
    cell_map = op.netlist.cells
    volts = np.where(cell_map.node >= 0, op.voltage[cell_map.node], np.nan)
    code = cell_map.space.cell
    span = np.nanmax(volts[code == rg.Cell.FREE]) if options.get("boundary") == "neumann" else 1.0
    assert result.span == pytest.approx(span)
    for cell in map(tuple, np.argwhere(cell_map.space.goal_connected)):
        around = [(cell[0] + dx, cell[1] + dy) for dx, dy in ((-1, 0), (1, 0), (0, -1), (0, 1))]
        around = [p for p in around if all(0 <= i < n for i, n in zip(p, code.shape, strict=True)) and code[p] != 1]
        best = min(volts[p] for p in around)
        assert result.cell_bits[cell] == pytest.approx(np.log2(span / (volts[cell] - best)), abs=1e-6)
        need, here = -np.inf, int(np.ravel_multi_index(cell, code.shape))
        while code.flat[here] == rg.Cell.FREE:
            need = max(need, result.cell_bits.flat[here])
            here = int(result.following.flat[here])
        assert result.start_bits[cell] == need
    assert np.isnan(result.cell_bits[code != rg.Cell.FREE]).all()


def test_descent_on_quantized_voltages_reaches_the_goal_with_the_stated_bits() -> None:
    """Voltages are floored to 2**b steps; b is one bit above the requirement."""
    op = rg.solve(small_scene())
    result = rg.study(op).adc_resolution()
    cell_map = op.netlist.cells
    code = cell_map.space.cell
    bits = result.bits_for(1.0)
    reading = np.floor(np.where(cell_map.node >= 0, op.voltage[cell_map.node], 1.0) * 2.0**bits)
    assert (
        reading.ravel()[result.following[cell_map.space.goal_connected]] < reading[cell_map.space.goal_connected]
    ).all()
    coarse = np.floor(np.where(code == 0, op.voltage[cell_map.node], 1.0) * 2.0 ** (bits - 2))
    below = coarse.ravel()[result.following[cell_map.space.goal_connected]]
    assert not (below < coarse[cell_map.space.goal_connected]).all()


def test_the_summary_sentence_states_the_fraction_of_served_starts() -> None:
    result = rg.study(rg.solve(small_scene())).adc_resolution()
    share = np.mean(result.starts <= 10)
    assert 0 < share < 1
    assert result.sentence() == f"a 10-bit read-out serves {int(100 * share)} % of the starts"
    assert result.sentence(8).startswith("an 8-bit")
    assert result.served(0) <= result.served(8) <= result.served(10) <= result.served(64) == 1.0
    for share in (0.1, 0.5, 0.99, 1.0):
        bits = result.bits_for(share)
        assert result.served(bits) >= share > result.served(bits - 1)


def test_halving_the_range_saves_one_bit() -> None:
    op = rg.solve(small_scene())
    whole, half = rg.study(op).adc_resolution(), rg.study(op).adc_resolution(span=0.5)
    free = op.netlist.cells.space.goal_connected
    assert (whole.cell_bits - half.cell_bits)[free] == pytest.approx(1.0)


def test_a_negative_supply_needs_the_same_bits() -> None:
    up, down = (rg.study(rg.solve(small_scene(supply=volts))).adc_resolution() for volts in (2.0, -2.0))
    assert (up.following == down.following).all()
    assert up.starts == pytest.approx(down.starts)


def test_cells_without_current_need_infinitely_many_bits() -> None:
    cell = np.zeros((6, 5), dtype=np.uint8)
    cell[0, 0] = 2
    netlist = rg.compile_space(space_of(cell), boundary="neumann", drive="start", start=(3, 0))
    cell[3:5, 1:] = 1
    dead_end = rg.compile_space(space_of(cell), boundary="neumann", drive="start", start=(3, 0))
    assert np.isfinite(rg.study(rg.solve(netlist)).adc_resolution().cell_bits[3, 0])
    assert np.isinf(rg.study(rg.solve(dead_end)).adc_resolution().start_bits[5, 4])
    assert rg.study(rg.solve(dead_end)).adc_resolution().bits_for(1.0) is None


def test_json_has_units_and_invalid_arguments_raise_input_error() -> None:
    op = rg.solve(small_scene())
    data = rg.study(op).adc_resolution().to_json()
    assert data["most_bits"]["unit"] == "bit"
    assert data["sentence"] == rg.study(op).adc_resolution().sentence(10)
    with pytest.raises(rg.InputError, match="span"):
        rg.study(op).adc_resolution(span=0.0)
    with pytest.raises(rg.InputError, match="fraction"):
        rg.study(op).adc_resolution().bits_for(1.5)
    bare = op.netlist.replace(cell_map=None)
    with pytest.raises(rg.InputError, match="not compiled"):
        rg.study(rg.solve(bare)).adc_resolution()


def test_a_neighbour_behind_a_missing_resistor_is_still_compared() -> None:
    netlist = small_scene()
    cell_map = netlist.cells
    node = cell_map.node
    broken = np.flatnonzero((netlist.resistor_nodes == [node[8, 12], node[9, 12]]).all(axis=1))
    keep = np.ones(len(netlist.conductance), dtype=bool)
    keep[broken] = False
    import dataclasses

    cell_map = dataclasses.replace(
        cell_map, resistor_face=cell_map.resistor_face[keep], resistor_upward=cell_map.resistor_upward[keep]
    )
    op = rg.solve(
        netlist.replace(
            resistor_nodes=netlist.resistor_nodes[keep], conductance=netlist.conductance[keep], cell_map=cell_map
        )
    )
    result = rg.study(op).adc_resolution()
    volts = {p: op.voltage[node[p]] for p in ((8, 12), (7, 12), (9, 12), (8, 11), (8, 13))}
    best = min(volts, key=volts.__getitem__)
    assert len(broken) == 1
    assert result.following[8, 12] == np.ravel_multi_index(best, (16, 16))
    assert result.cell_bits[8, 12] == pytest.approx(np.log2(1 / (volts[8, 12] - volts[best])))


@pytest.mark.parametrize("shape", [(2, 5), (1, 6), (3, 4, 5)])
def test_periodic_neighbours_are_compared_across_the_seam(shape: tuple[int, ...]) -> None:
    cell = np.zeros(shape, dtype=np.uint8)
    cell.flat[-1] = 2
    op = rg.solve(rg.compile_space(space_of(cell, periodic=(True,) * len(shape)), boundary="neumann"))
    result = rg.study(op).adc_resolution()
    assert np.isfinite(result.starts).all()
    volts = op.voltage[op.netlist.cells.node].ravel()
    for here in np.flatnonzero(cell.ravel() == 0).tolist():
        index = np.array(np.unravel_index(here, shape))
        around = [
            int(np.ravel_multi_index(tuple((index + side * np.eye(len(shape), dtype=int)[axis]) % shape), shape))
            for axis in range(len(shape))
            for side in (-1, 1)
        ]
        assert volts[result.following.flat[here]] == pytest.approx(min(volts[a] for a in around), abs=1e-12)


def test_a_space_without_starts_gives_null_values_instead_of_nan() -> None:
    cell = np.array([[0, 1, 2]], dtype=np.uint8)
    result = rg.study(rg.solve(rg.compile_space(space_of(cell), rails="cells"))).adc_resolution()
    assert result.sentence() == "no start has a path to a goal"
    assert result.to_json()["served_10_bits"]["value"] is None
    assert "NaN" not in json.dumps(result.to_json())


@pytest.mark.parametrize("span", ["x", 0.0, -1.0, np.nan, np.inf, True], ids=str)
def test_invalid_spans_raise_input_error(span: object) -> None:
    with pytest.raises(rg.InputError, match="span = "):
        rg.study(rg.solve(small_scene())).adc_resolution(span=span)  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", range(4))
def test_no_analysis_steps_into_an_obstacle_cell_whose_voltage_droops(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cell = (rng.random((7, 9)) < 0.15).astype(np.uint8)
    cell[3, 4] = rg.Cell.GOAL
    chip = rg.Chip(obstacle_switch_on=1e6, mismatch=0.1, seed=seed)
    study = rg.study(space_of(cell), chip)
    code, volts = cell.ravel(), study.op.voltage[study.netlist.cells.node].ravel()
    result = study.adc_resolution()
    following = result.following.ravel()
    moving = np.flatnonzero(following >= 0)
    assert (code[following[moving]] != rg.Cell.OBSTACLE).all()
    assert (volts[following[moving]] < volts[moving]).all()
    cells = np.stack(np.unravel_index(moving, cell.shape), axis=1)
    assert (study.sensitivity(cells).best == following[moving]).all()
    one = rg.study(study.ideal, rg.Chip(obstacle_switch_on=1e6))
    served = np.isfinite(one.adc_resolution().start_bits)
    assert (one.yields().reached == served).all()
