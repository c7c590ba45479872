"""Tests internals: `resgrid.chip.time_constants`, `resgrid.circuit.dynamics`, `resgrid.spice.write.flat`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.dynamics import ExactMotion, random_dynamics, run_analysis, small_scene, with_capacitors
from support.spaces import space_of

import resgrid as rg
from resgrid.chip.time_constants import fastest_time_constant, slowest_modes
from resgrid.circuit.dynamics import dynamics_of
from resgrid.spice.write.flat import flatten

R, C = 10e3, 1e-12


def held_square(n: int) -> rg.Netlist:
    """N x N cells, every one with C to ground, the edge held at ground through R."""
    node = np.arange(1, n * n + 1).reshape(n, n)
    inner = [(node[:-1], node[1:]), (node[:, :-1], node[:, 1:])]
    edge = [(side, 0 * side) for side in (node[0], node[-1], node[:, 0], node[:, -1])]
    pairs = np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b in inner + edge])
    caps = np.stack([node.ravel(), 0 * node.ravel()], axis=1)
    return rg.Netlist(n * n + 1, pairs, np.full(len(pairs), 1 / R), capacitor_nodes=caps, capacitance=np.full(n * n, C))


@pytest.mark.parametrize("n", [5, 16, 64])
def test_time_constants_of_a_held_square(n: int) -> None:
    dynamics = dynamics_of(held_square(n))
    rate = 2 * (1 - np.cos(np.pi * np.arange(1, n + 1) / (n + 1)))
    exact = np.sort(R * C / np.add.outer(rate, rate).ravel())[::-1]
    slow = slowest_modes(dynamics, 4)
    tau, mode = slow.tau[:4], (slow.shape * np.sqrt(slow.tau))[:, :4]
    assert tau == pytest.approx(exact[:4], rel=1e-8)
    assert tau[0] == pytest.approx(R * C / (8 * np.sin(np.pi / (2 * (n + 1))) ** 2), rel=1e-9)
    assert fastest_time_constant(dynamics) == pytest.approx(exact[-1], rel=3e-3)
    ripple = dynamics.capacitance.matrix @ mode - dynamics.conductance.matrix @ mode * tau
    assert np.abs(ripple).max() < 1e-5 * C / np.sqrt(1 / R)


def test_the_two_figures_of_a_64_cell_grid() -> None:
    assert slowest_modes(dynamics_of(held_square(64)), 1).tau[0] / (R * C) == pytest.approx(214.08, abs=0.005)
    cell = np.zeros((64, 64), dtype=np.uint8)
    cell[0, 0] = 2
    corner = with_capacitors(rg.compile_space(space_of(cell), boundary="neumann", edge="open"), C)
    assert slowest_modes(dynamics_of(corner), 1).tau[0] / (R * C) == pytest.approx(10204, abs=1)


@settings(max_examples=15)
@given(seed=st.integers(0, 10**6))
def test_time_constants_of_random_circuits(seed: int) -> None:
    netlist = random_dynamics(seed, side=6)
    exact = np.sort(ExactMotion(netlist).tau)[::-1]
    dynamics = dynamics_of(netlist)
    assert slowest_modes(dynamics, 5).tau[:5] == pytest.approx(exact[:5], rel=1e-8)
    assert fastest_time_constant(dynamics) == pytest.approx(exact[exact > 0][-1], rel=1e-6)


def test_iteration_and_dense_algebra_agree_where_nodes_lack_capacitance(monkeypatch: pytest.MonkeyPatch) -> None:
    dynamics = dynamics_of(random_dynamics(11, side=8))
    dense = slowest_modes(dynamics, 3).tau[:3], fastest_time_constant(dynamics)
    monkeypatch.setattr("resgrid.chip.time_constants.DENSE", 0)
    assert slowest_modes(dynamics, 3).tau == pytest.approx(dense[0], rel=1e-8)
    assert fastest_time_constant(dynamics) == pytest.approx(dense[1], rel=3e-3)


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
def test_the_last_node_settles_when_the_exact_motion_says(boundary: str) -> None:
    netlist = small_scene(boundary=boundary)
    result = rg.study(netlist).settling(bits=8)
    exact = ExactMotion(netlist)
    final = exact.voltage(np.array([np.inf]))
    band = result.span / 2**9

    def outside(time: float) -> bool:
        return bool(np.nanmax(np.abs(exact.voltage(np.array([time])) - final)) > band)

    assert outside(result.settle_time * 0.995)
    assert not outside(result.settle_time * 1.005)
    assert result.settle_time <= result.bound
    assert result.power == pytest.approx(rg.solve(netlist).power)
    assert result.mode.max() == 1.0
    assert result.mode.min() >= -1e-12


def test_a_stiff_part_that_a_source_lifts_ends_at_the_operating_point() -> None:
    """Inside it flows nothing in the end, though each of its rows is fed by 6 kA, less as much."""
    netlist = rg.Netlist(
        5, [[1, 0], [3, 2], [4, 2], [3, 4]], [1e-10, 6e3, 0.03, 60.0], source_nodes=[[2, 1]], source_volts=[1.0],
        capacitor_nodes=[[3, 0], [4, 0]], capacitance=[C, C],
    )  # fmt: skip
    result = rg.study(netlist).settling()
    assert result.final == pytest.approx([0.0, 0.0, 1.0, 1.0, 1.0], abs=1e-12)
    assert result.power == pytest.approx(0.0, abs=1e-30)


def test_a_change_of_scene_settles_sooner_than_a_cold_start() -> None:
    netlist = small_scene()
    other = netlist.cells.space.cell.copy()
    other[4, 7] = 0
    before = rg.solve(rg.compile_space(space_of(other)))
    assert rg.study(netlist).settling(initial=before).settle_time < rg.study(netlist).settling().settle_time


def test_nothing_to_do_takes_no_time() -> None:
    netlist = small_scene()
    result = rg.study(netlist).settling(initial=rg.solve(netlist))
    assert result.settle_time == result.energy == 0.0


def test_ngspice_shows_the_same_slowest_time_constant(tmp_path: Path) -> None:
    netlist = small_scene(boundary="neumann")
    tau = slowest_modes(dynamics_of(netlist), 1).tau[0]
    statements = f".options method=trap reltol=1e-6\n.tran {tau / 500} {6 * tau} 0 {tau / 500} uic"
    raw = run_analysis(flatten(netlist).text, statements, tmp_path)
    clock = raw.values[:, raw.names.index("time")]
    volts = raw.values[:, raw.names.index("v(n_15_15)")]
    final = rg.solve(netlist).voltage[netlist.cells.node[15, 15]]
    early, late = np.interp([2 * tau, 4 * tau], clock, final - volts)
    assert 2 * tau / np.log(early / late) == pytest.approx(tau, rel=0.01)


def test_readings_have_units_and_definitions() -> None:
    data = rg.study(small_scene()).settling(bits=6).to_json()
    assert data["settle_time"]["unit"] == "s"
    assert "6-bit" in data["settle_time"]["definition"]
    assert data["energy_per_plan"]["value"] > 0
    assert len(data["time_constants"]) == 6


@pytest.mark.parametrize(
    ("netlist", "options", "error", "word"),
    [
        (small_scene(), {"bits": 0}, rg.InputError, "bits"),
        (small_scene(), {"modes": 0}, rg.InputError, "modes"),
        (small_scene(), {"span": -1.0}, rg.InputError, "span"),
        (rg.compile_space(small_scene().cells.space), {}, rg.InputError, "no time constants; give chip.capacitance"),
        (held_square(3), {}, rg.InputError, "final voltages are equal"),
        (
            rg.Netlist(
                4, [[1, 2]], [1.0], source_nodes=[[1, 0]], source_volts=[1.0], capacitor_nodes=[[2, 0], [3, 0]],
                capacitance=[C, C],
            ),
            {}, rg.CircuitError, "never settles",
        ),
    ],
)  # fmt: skip
def test_what_cannot_settle_is_refused(
    netlist: rg.Netlist, options: dict[str, float], error: type[Exception], word: str
) -> None:
    with pytest.raises(error, match=word):
        rg.study(netlist).settling(**options)
