"""Nonlinear resistors: Newton's method against scipy, closed forms, ngspice and the maximum principle.

Tests internals: `resgrid.circuit.nonlinear`.
"""

from __future__ import annotations

import dataclasses
import subprocess
from pathlib import Path

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import root
from support.circuits import random_grid
from support.spaces import serpentine, space_of, spaces

import resgrid as rg
from resgrid.circuit.nonlinear import newton


def saturating(netlist: rg.Netlist, volts: float | np.ndarray) -> rg.Netlist:
    """Return the netlist with nonlinear resistors of the same small-signal resistance."""
    cell_map, m = netlist.cell_map, len(netlist.conductance)
    if cell_map is not None:
        cell_map = dataclasses.replace(
            cell_map,
            resistor_face=np.empty(0, dtype=np.int64),
            resistor_upward=np.empty(0, dtype=np.bool_),
            nonlinear_face=cell_map.resistor_face,
            nonlinear_upward=cell_map.resistor_upward,
        )
    voltage = np.broadcast_to(volts, m)
    return netlist.replace(
        resistor_nodes=np.empty((0, 2), dtype=np.int64),
        conductance=np.empty(0),
        nonlinear_nodes=netlist.resistor_nodes,
        nonlinear_current=netlist.conductance * voltage,
        nonlinear_voltage=voltage,
        cell_map=cell_map,
    )


def saturating_pair(amps: float = 0.5e-6) -> rg.Netlist:
    """Return a resistor with I = 1 uA tanh(dV / 0.1 V) from node 1 to ground, and a current source."""
    return rg.Netlist(
        2, np.empty((0, 2), dtype=np.int64), [],
        current_nodes=[[0, 1]], current_amps=[amps],
        nonlinear_nodes=[[1, 0]], nonlinear_current=[1e-6], nonlinear_voltage=[0.1],
    )  # fmt: skip


def obstacle_space() -> rg.ConfigurationSpace:
    cell = np.zeros((12, 12), dtype=np.uint8)
    cell[3:9, 5], cell[9, 3] = rg.Cell.OBSTACLE, rg.Cell.GOAL
    return space_of(cell)


@pytest.mark.parametrize("share", [1e-9, 0.5, 0.999, -0.5, 1 - 1e-9])
def test_the_voltage_of_one_resistor_is_the_inverse_of_its_law(share: float) -> None:
    point = rg.solve(saturating_pair(share * 1e-6))
    assert point.voltage[1] == pytest.approx(0.1 * np.arctanh(share), rel=1e-7 if share > 0.9999 else 1e-12)
    assert point.nonlinear_amps[0] == pytest.approx(share * 1e-6, rel=1e-12)
    assert point.power == pytest.approx(point.voltage[1] * share * 1e-6, rel=1e-7)


def test_a_mixed_circuit_agrees_with_scipy_root() -> None:
    linear = random_grid(3, side=5, drive=True)
    half = np.arange(len(linear.conductance)) % 2 == 0
    rng = np.random.default_rng(5)
    volts = rng.uniform(0.05, 0.5, int(half.sum()))
    netlist = linear.replace(
        resistor_nodes=linear.resistor_nodes[~half],
        conductance=linear.conductance[~half],
        nonlinear_nodes=linear.resistor_nodes[half],
        nonlinear_current=linear.conductance[half] * volts,
        nonlinear_voltage=volts,
    )

    def kcl(free: np.ndarray) -> np.ndarray:
        v = np.concatenate([[0.0, 1.0, 0.0, 0.0], free])
        out = np.zeros(len(v))
        for (a, b), g in zip(netlist.resistor_nodes, netlist.conductance, strict=True):
            out[a] += g * (v[a] - v[b])
            out[b] -= g * (v[a] - v[b])
        for (a, b), i0, v0 in zip(
            netlist.nonlinear_nodes, netlist.nonlinear_current, netlist.nonlinear_voltage, strict=True
        ):
            out[a] += i0 * np.tanh((v[a] - v[b]) / v0)
            out[b] -= i0 * np.tanh((v[a] - v[b]) / v0)
        np.subtract.at(out, netlist.current_nodes[:, 1], netlist.current_amps)
        return out[4:] * 1e4

    found = root(kcl, np.full(25, 0.4), tol=1e-14, method="hybr").x
    point = rg.solve(netlist)
    assert np.abs(point.voltage[4:] - found).max() < 1e-9
    assert np.abs(kcl(point.voltage[4:])).max() < 1e-14


def test_newton_converges_quadratically() -> None:
    history = np.array(newton(saturating(rg.compile_space(obstacle_space()), 0.3)).residual)
    tail = history[history > 1e-16][-4:]
    assert len(tail) == 4
    order = np.diff(np.log(tail))[1:] / np.diff(np.log(tail))[:-1]
    assert np.all(order > 1.7), history


def test_newton_is_damped_and_converges_in_deep_saturation() -> None:
    netlist = saturating(rg.compile_space(obstacle_space()), 2e-3)
    found = newton(netlist)
    assert min(found.step) < 1 and found.step[-1] == 1
    assert len(found.step) < 40
    assert rg.solve(netlist).kcl_residual < 1e-12


@pytest.mark.parametrize("order", [(2, 3, 1, 4, 5), (3, 5, 4, 2, 1), (4, 1, 2, 3, 5), (5, 4, 3, 2, 1)])
def test_nodes_outside_a_closed_current_loop_are_at_zero_volts(order: tuple[int, ...]) -> None:
    """The current flows in a closed loop; the other nodes are at 0 V, where a relative error has no meaning."""
    tied, end, up, down, injected = order
    netlist = rg.Netlist(
        6, [[tied, 0], [end, tied]], [1.1e-3, 2.7e-3],
        source_nodes=[[up, tied], [up, down]], source_volts=[0.53, 1.0],
        current_nodes=[[injected, tied]], current_amps=[7e-4],
        nonlinear_nodes=[[injected, down]], nonlinear_current=[7e-3], nonlinear_voltage=[6.76],
    )  # fmt: skip
    op = rg.solve(netlist)
    assert op.voltage[[tied, end]] == pytest.approx([0.0, 0.0], abs=1e-15)
    assert op.voltage[injected] == pytest.approx(-0.47 - 6.76 * np.arctanh(0.1))
    assert op.nonlinear_amps == pytest.approx([-7e-4])


@given(space=spaces(), volts=st.sampled_from([0.02, 0.2, 2.0]), spread=st.floats(0, 0.5), seed=st.integers(0, 99))
@settings(max_examples=25)
@pytest.mark.slow
def test_streamlines_with_saturating_resistors_have_the_outcomes_of_linear_ones(
    space: rg.ConfigurationSpace, volts: float, spread: float, seed: int
) -> None:
    linear = rg.compile_space(space, edge=["periodic" if ring else "obstacle" for ring in space.periodic])
    chip = saturating(
        linear, volts * np.random.default_rng(seed).uniform(1 - spread, 1 + spread, len(linear.conductance))
    )
    try:
        ideal = rg.field(rg.solve(linear))
    except rg.CircuitError:
        return
    field = rg.field(rg.solve(chip))
    for cell in np.argwhere(space.goal_connected):
        path = rg.streamline(field, cell=cell)
        assert path.outcome == rg.streamline(ideal, cell=cell).outcome
        rg.certify(path)


def test_log_drop_resolves_the_end_of_a_long_corridor_with_saturation() -> None:
    space = space_of(serpentine(8, 40, 2))
    field = rg.field(rg.solve(saturating(rg.compile_space(space), 0.05)))
    assert np.nanmin(field.log_drop[space.cell == rg.Cell.FREE]) < -200
    outcomes = {rg.streamline(field, cell=cell).outcome for cell in np.argwhere(space.goal_connected)}
    assert outcomes == {"reached"}


@pytest.mark.parametrize("amps", [1e-6, -1e-6, 1.5e-6])
def test_a_current_above_the_saturation_of_a_cut_raises_circuit_error(amps: float) -> None:
    with pytest.raises(rg.CircuitError, match=r"carry less than 1e-06 A, the sum of their I0"):
        rg.solve(saturating_pair(amps))


def test_the_error_states_the_overloaded_cut() -> None:
    linear = rg.compile_space(obstacle_space(), boundary="neumann", drive="uniform")
    goal_ring = np.isin(linear.resistor_nodes, linear.cells.goal_nodes).any(axis=1)
    netlist = saturating(linear, np.where(goal_ring, 0.1, 10.0))
    with pytest.raises(rg.CircuitError, match=r"drive 0.0001 A through the 4 nonlinear resistors around 137 nodes"):
        rg.solve(netlist)
    assert rg.solve(netlist.replace(current_amps=netlist.current_amps * 0.39)).kcl_residual < 1e-9


@pytest.mark.parametrize("seed", range(24))
def test_random_saturating_circuits_are_solved_or_reported_as_overloaded(seed: int) -> None:
    rng = np.random.default_rng(seed)
    linear = random_grid(seed, side=int(rng.integers(3, 8)), decades=float(rng.uniform(0, 8)), drive=bool(seed % 2))
    half = rng.random(len(linear.conductance)) < rng.choice([0.3, 0.9, 1.0])
    volts = 10.0 ** rng.uniform(-5, 0.5, int(half.sum()))
    netlist = linear.replace(
        resistor_nodes=linear.resistor_nodes[~half],
        conductance=linear.conductance[~half],
        nonlinear_nodes=linear.resistor_nodes[half],
        nonlinear_current=linear.conductance[half] * volts,
        nonlinear_voltage=volts,
        current_amps=linear.current_amps * 10.0 ** rng.uniform(-4, 0),
    )
    try:
        point = rg.solve(netlist)
    except rg.CircuitError as error:
        words = str(error).split()
        injected, least = float(words[words.index("drive") + 1]), float(words[words.index("than") + 1])
        assert injected >= least * (1 - 1e-5)
        return
    v = point.voltage
    d = v[netlist.nonlinear_nodes[:, 0]] - v[netlist.nonlinear_nodes[:, 1]]
    slope = netlist.nonlinear_current / netlist.nonlinear_voltage
    law = netlist.nonlinear_current * np.tanh(d / netlist.nonlinear_voltage)
    np.testing.assert_allclose(point.nonlinear_amps, law, rtol=1e-6, atol=1e-14 * slope.max() * np.abs(v).max())
    assert point.kcl_residual < 1e-9


def test_linearize_equals_differences_of_operating_points() -> None:
    netlist = saturating(rg.compile_space(obstacle_space(), boundary="neumann"), 0.5)
    point = rg.solve(netlist)
    row = int(netlist.cells.free_node[20])
    nudge = 1e-4 * netlist.current_amps[0]

    def voltage_with(amps: float) -> np.ndarray:
        return rg.solve(netlist.replace(
            current_nodes=np.concatenate([netlist.current_nodes, [[0, row]]]),
            current_amps=np.append(netlist.current_amps, amps),
        )).voltage  # fmt: skip

    seen = (voltage_with(nudge) - voltage_with(-nudge)) / (2 * nudge)
    slope = rg.solve(rg.circuit.linearize(point).replace(current_nodes=[[0, row]], current_amps=[1.0]))
    np.testing.assert_allclose(slope.voltage, seen, rtol=1e-6, atol=1e-6 * np.abs(seen).max())


def test_factorize_and_normalize_drive_reject_nonlinear_resistors() -> None:
    netlist = saturating(rg.compile_space(obstacle_space(), boundary="neumann"), 1.0)
    with pytest.raises(rg.InputError, match="linearize"):
        rg.factorize(netlist)
    with pytest.raises(rg.InputError, match="do not scale"):
        rg.normalize_drive(netlist, rg.solve(netlist))


def test_voltages_agree_with_ngspice(tmp_path: Path) -> None:
    cell = np.zeros((16, 16), dtype=np.uint8)
    cell[4:9, 6], cell[12, 3] = rg.Cell.OBSTACLE, rg.Cell.GOAL
    netlist = saturating(rg.compile_space(space_of(cell)), 0.2)
    lines = ["* tanh", *(f"v{k} {a} {b} {v!r}" for k, ((a, b), v) in enumerate(
        zip(netlist.source_nodes.tolist(), netlist.source_volts.tolist(), strict=True)))]  # fmt: skip
    laws = zip(
        netlist.nonlinear_nodes.tolist(), netlist.nonlinear_current.tolist(), netlist.nonlinear_voltage.tolist(),
        strict=True,
    )  # fmt: skip
    lines += [f"b{k} {a} {b} i={i!r}*tanh((v({a})-v({b}))/{v!r})" for k, ((a, b), i, v) in enumerate(laws)]
    lines += [".options reltol=1e-10 vntol=1e-12 abstol=1e-18 gmin=1e-18", ".control", "op", "set numdgt=15"]
    lines += ["print all", ".endc", ".end"]
    deck = tmp_path / "tanh.cir"
    deck.write_text("\n".join(lines) + "\n")
    run = subprocess.run(["ngspice", "-b", deck], capture_output=True, text=True, timeout=300, check=False)
    found = dict(line.split(" = ") for line in run.stdout.splitlines() if line.startswith("v(") and " = " in line)
    point = rg.solve(netlist)
    simulated = {int(name[2:-1]): float(value) for name, value in found.items()}
    assert len(simulated) >= netlist.node_count - 1
    assert max(abs(value - point.voltage[node]) for node, value in simulated.items()) < 1e-6


@pytest.mark.parametrize("scale", [1e-6, 1e-9, 1e-12])
@pytest.mark.parametrize("share", [1e-3, 0.9, 0.999])
def test_slope_and_power_are_exact_for_small_drops_at_a_high_potential(scale: float, share: float) -> None:
    """A fraction of ``I0`` flows through a resistor whose other end is at 1 V: the drop is ``V0 atanh(share)``."""
    netlist = rg.Netlist(
        3,
        [[1, 0]],
        [1e-3],
        source_nodes=[[1, 0]],
        source_volts=[1.0],
        current_nodes=[[0, 2]],
        current_amps=[share * scale],
        nonlinear_nodes=[[2, 1]],
        nonlinear_current=[scale],
        nonlinear_voltage=[scale],
    )
    point = rg.solve(netlist)
    drop = scale * np.arctanh(share)
    np.testing.assert_allclose(rg.study(point).power().nonlinear, [share * scale * drop], rtol=1e-9)
    np.testing.assert_allclose(rg.circuit.linearize(point).conductance[-1], (1 - share) * (1 + share), rtol=1e-9)


@pytest.mark.parametrize("volts", [0.1, 0.2, 0.5, 2.0, 3.0])
def test_slopes_and_gradients_of_saturated_resistors_are_exact(volts: float) -> None:
    """A saturated resistor of ``I0`` = 1 mA and ``V0`` = 10 mV in series with 1 ohm, and its slope by sech^2."""
    netlist = rg.Netlist(
        3,
        [[2, 0]],
        [1.0],
        source_nodes=[[1, 0]],
        source_volts=[volts],
        nonlinear_nodes=[[1, 2]],
        nonlinear_current=[1e-3],
        nonlinear_voltage=[0.01],
    )
    point = rg.solve(netlist)
    with mp.workdps(60):
        height = mp.findroot(lambda v: v - mp.tanh((volts - v) / mp.mpf(0.01)) * mp.mpf(1e-3), 1e-3)
        drop = (volts - height) / mp.mpf(0.01)
        slope = mp.sech(drop) ** 2 * mp.mpf(1e-3) / mp.mpf(0.01)
        slopes = [slope, slope / (1 + slope), -drop * slope / (1 + slope), mp.tanh(drop) / (1 + slope)]
    found = rg.gradient(point, of="voltage", at=2)
    values = [rg.circuit.linearize(point).conductance[-1], found.voltage[0], found.nonlinear_voltage[0]]
    np.testing.assert_allclose([*values, found.nonlinear_current[0]], [float(each) for each in slopes], rtol=1e-11)


def test_slopes_below_the_range_of_doubles_are_the_smallest_double() -> None:
    netlist = one_resistor(0.5).replace(source_nodes=[[1, 0]], source_volts=[100.0])
    assert rg.circuit.linearize(rg.solve(netlist)).conductance == [5e-324]


def test_currents_too_close_to_saturation_raise_circuit_error() -> None:
    with pytest.raises(rg.CircuitError, match="may be no operating point, because the currents are so close to I0"):
        rg.solve(one_resistor(1.0 - 1e-13))
    with pytest.raises(rg.CircuitError, match="there is no operating point"):
        rg.solve(one_resistor(1.0))
    assert rg.solve(one_resistor(1.0 - 1e-9)).voltage[1] == pytest.approx(0.1 * np.arctanh(1.0 - 1e-9), rel=1e-6)


def one_resistor(amps: float) -> rg.Netlist:
    """Return a current source on a nonlinear resistor to ground, ``I0`` = 1 A and ``V0`` = 0.1 V."""
    return rg.Netlist(
        2,
        [],
        [],
        current_nodes=[[0, 1]],
        current_amps=[amps],
        nonlinear_nodes=[[1, 0]],
        nonlinear_current=[1.0],
        nonlinear_voltage=[0.1],
    )


def test_saturated_resistors_between_fixed_nodes_have_exact_currents() -> None:
    held = rg.Netlist(
        3,
        [[1, 0]],
        [1e-3],
        source_nodes=[[1, 0], [2, 1]],
        source_volts=[1.0, 1.0],
        nonlinear_nodes=[[1, 2], [2, 0]],
        nonlinear_current=[1e-4] * 2,
        nonlinear_voltage=[0.1] * 2,
        current_nodes=[[0, 2]],
        current_amps=[1e-5],
    )
    point = rg.solve(held)
    np.testing.assert_allclose(point.nonlinear_amps, 1e-4 * np.tanh([-10.0, 20.0]), rtol=1e-12)
    np.testing.assert_allclose(point.source_current, [-1.09e-3, -1.9e-4], rtol=1e-6)
