"""Transients, against matrix exponentials, closed forms, conservation of energy and ngspice.

Tests internals: `resgrid.circuit.stepping`, `resgrid.spice.write.flat`.
"""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.dynamics import ExactMotion, random_dynamics, run_analysis, small_scene, with_capacitors
from support.spaces import space_of

import resgrid as rg
from resgrid.circuit.stepping import Method
from resgrid.spice.write.flat import flatten

METHODS = get_args(Method)


def one_pole(**changes: object) -> rg.Netlist:
    """Return 1 V through 1 kohm into 1 nF: a time constant of 1 us."""
    return rg.Netlist(
        3, [[1, 2]], [1e-3], source_nodes=[[1, 0]], source_volts=[1.0], capacitor_nodes=[[2, 0]], capacitance=[1e-9]
    ).replace(**changes)


@settings(max_examples=15)
@given(seed=st.integers(0, 10**6), method=st.sampled_from(["tr-bdf2", "trapezoidal"]))
@pytest.mark.slow
def test_random_circuits_follow_the_matrix_exponential(seed: int, method: str) -> None:
    netlist = random_dynamics(seed)
    before = np.random.default_rng(seed).uniform(-1, 1, netlist.node_count)
    before[0] = 0.0
    exact = ExactMotion(netlist, before)
    slowest = exact.tau.max()
    times = np.append(0.0, slowest * np.geomspace(1e-4, 5, 9))
    found = rg.circuit.transient(netlist, times, initial=before, method=method, tolerance=1e-5)
    wanted = exact.voltage(times)
    span = np.ptp(wanted)
    assert np.abs(found.voltage[0] - wanted[0]).max() < 1e-9 * span
    assert np.abs(found.voltage - wanted).max() < 1e-5 * span


@pytest.mark.parametrize(("method", "order"), [("tr-bdf2", 2), ("trapezoidal", 2), ("backward_euler", 1)])
def test_the_error_falls_with_the_order_of_the_method(method: str, order: int) -> None:
    netlist = random_dynamics(3)
    exact = ExactMotion(netlist)
    times = np.array([exact.tau.max()])
    error = [
        np.abs(
            rg.circuit.transient(netlist, times, step=times[0] / n, method=method).voltage - exact.voltage(times)
        ).max()
        for n in (400, 800)
    ]
    assert np.log2(error[0] / error[1]) == pytest.approx(order, abs=0.25)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.quick_cases(1)
def test_a_transient_ends_at_the_operating_point(method: str) -> None:
    netlist = small_scene()
    tolerance = 1e-3 if method == "backward_euler" else 1e-6
    found = rg.circuit.transient(netlist, [1e-3], method=method, tolerance=tolerance)
    assert np.abs(found.voltage[-1] - rg.solve(netlist).voltage).max() < 1e-12


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
def test_transients_of_a_scene_agree_with_ngspice(boundary: str, tmp_path: Path) -> None:
    netlist = small_scene(boundary=boundary)
    slowest = ExactMotion(netlist).tau.max()
    times = slowest * np.linspace(0.3, 3.0, 10)
    step = slowest / 1000
    statements = f".options method=trap reltol=1e-6\n.tran {step} {times[-1]} 0 {step} uic"
    raw = run_analysis(flatten(netlist).text, statements, tmp_path)
    found = rg.circuit.transient(netlist, times, tolerance=1e-6)
    free = netlist.cells.free_node
    clock = raw.values[:, raw.names.index("time")]
    supply = np.ptp(found.voltage)
    for node, name in zip(free.tolist(), netlist.names_of(free), strict=True):
        if f"v({name})" in raw.names:
            theirs = np.interp(times, clock, raw.values[:, raw.names.index(f"v({name})")])
            assert np.abs(theirs - found.voltage[:, node]).max() < 1e-4 * supply


def test_a_stiff_circuit_takes_few_steps() -> None:
    conductance = np.geomspace(1e-3, 1e-8, 21)
    nodes = np.arange(1, 23)
    pairs = np.stack([nodes[:-1], nodes[1:]], axis=1)
    caps = np.stack([nodes[1:], np.zeros(21, dtype=np.int64)], axis=1)
    netlist = rg.Netlist(
        23,
        pairs,
        conductance,
        source_nodes=[[1, 0]],
        source_volts=[1.0],
        capacitor_nodes=caps,
        capacitance=[1e-12] * 21,
    )
    exact = ExactMotion(netlist)
    assert exact.tau.max() / exact.tau.min() > 1e5
    times = exact.tau.max() * np.array([1e-5, 1e-3, 0.1, 1, 5])
    found = rg.circuit.transient(netlist, times)
    assert np.abs(found.voltage - exact.voltage(times)).max() < 1e-6
    assert found.steps < 3000
    assert found.factorizations < 40


def test_a_single_pole_has_the_exact_voltages_and_energies() -> None:
    found = rg.circuit.transient(one_pole(), [0.0, 1e-6, 1e-4])
    assert found.voltage[:, 2] == pytest.approx([0, 1 - np.exp(-1), 1], abs=1e-6)
    assert found.stored[-1] == pytest.approx(0.5e-9, rel=1e-6)
    assert found.energy[-1] == pytest.approx(1e-9, rel=1e-6)


@pytest.mark.parametrize("method", ["tr-bdf2", "trapezoidal"])
def test_delivered_energy_is_dissipated_or_stored(method: str) -> None:
    netlist = random_dynamics(5)
    exact = ExactMotion(netlist)
    times = np.linspace(0, 3 * exact.tau.max(), 4001)
    across = np.subtract(*exact.voltage(times)[:, netlist.resistor_nodes.T].transpose(1, 0, 2))
    power = across**2 @ netlist.conductance
    dissipated = np.sum((power[1:] + power[:-1]) / 2 * np.diff(times))
    found = rg.circuit.transient(netlist, times[[0, -1]], method=method)
    assert found.energy[-1] - (found.stored[-1] - found.stored[0]) == pytest.approx(dissipated, rel=1e-4)


def test_capacitors_to_a_rail_divide_its_voltage_step() -> None:
    pair = one_pole(capacitor_nodes=[[2, 0], [2, 1]], capacitance=[3e-9, 1e-9])
    assert rg.circuit.transient(pair, [0.0]).voltage[0, 2] == pytest.approx(0.25)
    kept = rg.circuit.transient(pair, [0.0], initial=[0.0, 1.0, 0.5])
    assert kept.voltage[0, 2] == pytest.approx(0.5)


def test_a_node_tied_by_capacitors_only_has_a_voltage() -> None:
    netlist = rg.Netlist(
        4, [[1, 2]], [1e-3], source_nodes=[[1, 0]], source_volts=[1.0],
        capacitor_nodes=[[2, 3], [3, 0]], capacitance=[1e-9, 1e-9],
    )  # fmt: skip
    assert rg.circuit.transient(netlist, [1e-4]).voltage[-1, 2:] == pytest.approx([1.0, 0.5], abs=1e-6)


def test_floating_nodes_have_nan_voltages_in_a_transient() -> None:
    netlist = one_pole(node_count=5, capacitor_nodes=[[2, 0], [3, 4]], capacitance=[1e-9, 1e-9])
    found = rg.circuit.transient(netlist, [1e-6])
    assert np.isnan(found.voltage[-1, 3:]).all()
    assert np.isfinite(found.energy).all()


def test_a_current_into_a_capacitor_raises_its_voltage_linearly() -> None:
    netlist = rg.Netlist(
        2, np.empty((0, 2), dtype=np.int64), [], current_nodes=[[0, 1]], current_amps=[1e-6],
        capacitor_nodes=[[1, 0]], capacitance=[1e-9],
    )  # fmt: skip
    found = rg.circuit.transient(netlist, [1e-3, 2e-3])
    assert found.voltage[:, 1] == pytest.approx([1.0, 2.0])
    assert found.energy[-1] == pytest.approx(found.stored[-1]) == pytest.approx(2e-9)


def scene(x: int, rails: str) -> rg.Netlist:
    cell = np.zeros((8, 6), dtype=np.uint8)
    cell[x, 1:4], cell[7, 0] = 1, 2
    return with_capacitors(rg.compile_space(space_of(cell), rails=rails), 1e-12)


@pytest.mark.parametrize("rails", ["merged", "cells"])
def test_a_transient_starts_from_the_voltages_of_the_previous_scene(rails: str) -> None:
    old, new = rg.solve(scene(2, rails)), scene(3, rails)
    found = rg.circuit.transient(new, [0.0, 1e-4], initial=old)
    cell_map, before = new.cells, old.netlist.cells
    both = (cell_map.space.cell == 0) & (before.space.cell == 0)
    assert found.voltage[0][cell_map.node[both]] == pytest.approx(old.voltage[before.node[both]], abs=1e-12)
    freed = (cell_map.space.cell == 0) & (before.space.cell == 1)
    assert found.voltage[0][cell_map.node[freed]] == pytest.approx(1.0)
    assert found.voltage[-1] == pytest.approx(rg.solve(new).voltage, abs=1e-9)


def test_a_transient_from_the_operating_point_is_constant() -> None:
    netlist = small_scene()
    op = rg.solve(netlist)
    found = rg.circuit.transient(netlist, [0.0, 1e-8, 1e-6], initial=op)
    assert np.abs(found.voltage - op.voltage).max() < 1e-14


@pytest.mark.parametrize("method", METHODS)
def test_a_stepper_equals_a_transient_with_a_fixed_step(method: str) -> None:
    netlist = random_dynamics(7)
    h = ExactMotion(netlist).tau.max() / 50
    stepper = rg.circuit.transient_stepper(netlist, h, method=method)
    voltage = stepper.start()
    for _ in range(20):
        voltage = stepper.advance(voltage)
    whole = rg.circuit.transient(netlist, [20 * h], step=h, method=method).voltage[-1]
    damped = method == "trapezoidal"
    assert voltage == pytest.approx(whole, abs=1e-3 if damped else 1e-9)


def test_transients_by_multigrid_and_direct_solver_agree() -> None:
    netlist = small_scene()
    direct, multigrid = (
        rg.circuit.transient(netlist, [3e-8], step=1e-8, solver=name) for name in ("direct", "multigrid")
    )
    assert multigrid.voltage == pytest.approx(direct.voltage, abs=1e-9)


@pytest.mark.parametrize(
    ("times", "options", "word"),
    [
        ([1.0, 0.5], {}, "ascending"),
        ([-1.0], {}, "at least 0"),
        ([np.nan], {}, "finite"),
        ([], {}, "at least one"),
        (["soon"], {}, "numbers"),
        ([1e-6], {"step": 0.0}, "step"),
        ([1e-6], {"step": np.nan}, "step"),
        ([1e-6], {"tolerance": 0.0}, "tolerance"),
        ([1e-6], {"method": "euler"}, "trapezoidal"),
        ([1e-6], {"initial": [0.0, 1.0]}, "3 nodes"),
        ([1e-6], {"initial": [0.0, np.inf, 0.0]}, "not finite"),
        ([1e-6], {"initial": "discharged"}, "OperatingPoint"),
        ([1e-6], {"initial": [0.0, 1.0, 1.0 + 1.0j]}, "OperatingPoint"),
        ([1e-6 + 0j], {}, "must be numbers"),
        (["1e-6"], {}, "must be numbers"),
        (np.ma.masked_array([1e-6, 2e-6], [False, True]), {}, "real"),
        (None, {}, "times"),
        ([1e-6], {"step": "short"}, "step"),
        ([1e-6], {"step": 1e-6 + 0j}, "step"),
        ([1e-6], {"step": np.array([1e-6, 1e-6])}, "step"),
        ([1e-6], {"tolerance": "fine"}, "tolerance"),
        ([1e-6], {"tolerance": None}, "tolerance"),
        ([1e-6], {"tolerance": 1e-6 + 0j}, "tolerance"),
        ([1e-6], {"tolerance": np.array([1e-6, 1e-6])}, "tolerance"),
        ([1e-6], {"method": None}, "method = None must be"),
        ([1e-6], {"method": np.array(["tr-bdf2"] * 2)}, "method = .* must be"),
        ([1e-6], {"solver": "foo"}, "multigrid"),
    ],
)
def test_invalid_transient_arguments_raise_input_error(
    times: list[float], options: dict[str, object], word: str
) -> None:
    with pytest.raises(rg.InputError, match=word):
        rg.circuit.transient(one_pole(), times, **options)


@pytest.mark.parametrize(
    ("step", "options", "word"),
    [
        (None, {}, "step"),
        ("short", {}, "step"),
        (np.inf, {}, "step"),
        (1e-6, {"solver": "foo"}, "multigrid"),
        (1e-6, {"method": "euler"}, "trapezoidal"),
    ],
)
def test_invalid_stepper_arguments_raise_input_error(step: float, options: dict[str, object], word: str) -> None:
    with pytest.raises(rg.InputError, match=word):
        rg.circuit.transient_stepper(one_pole(), step, **options)


@pytest.mark.parametrize(
    ("voltage", "word"),
    [
        (None, "real number"),
        ("high", "real number"),
        ([0.0, 1.0, 1j], "real number"),
        ([0.0, 1.0], "3 nodes"),
        ([[0.0, 1.0, 0.5]], "3 nodes"),
        ([0.0, 1.0, np.nan], "not finite"),
    ],
)
def test_invalid_voltages_of_a_stepper_raise_input_error(voltage: object, word: str) -> None:
    stepper = rg.circuit.transient_stepper(one_pole(), 1e-6)
    with pytest.raises(rg.InputError, match=word):
        stepper.advance(voltage)


def test_a_stepper_accepts_a_list_of_voltages() -> None:
    stepper = rg.circuit.transient_stepper(one_pole(), 1e-6)
    assert stepper.advance([0.0, 1.0, 0.5]) == pytest.approx(stepper.advance(np.array([0.0, 1.0, 0.5])))


def test_transient_rejects_values_that_are_not_netlists() -> None:
    with pytest.raises(rg.InputError, match="Netlist"):
        rg.circuit.transient("netlist", [1e-6])


def test_backward_euler_voltages_are_exact_over_many_orders_of_magnitude() -> None:
    count = 20
    nodes = np.arange(1, count + 2)
    netlist = rg.Netlist(
        count + 2,
        np.stack([nodes[:-1], nodes[1:]], axis=1),
        np.full(count, 1e-12),
        source_nodes=[[1, 0]],
        source_volts=[1.0],
        capacitor_nodes=np.stack([nodes[1:], 0 * nodes[1:]], axis=1),
        capacitance=np.full(count, 1e-9),
    )
    stepper = rg.circuit.transient_stepper(netlist, 1e-6, method="backward_euler")
    voltage = stepper.advance(stepper.start())
    # KCL at a node: (C / h + 2 G) V = G (V before + V behind), where V behind is smaller by orders of magnitude.
    share = 1e-12 * 1e-6 / 1e-9
    assert voltage[2 : count + 1] == pytest.approx((share / (1 + 2 * share)) ** np.arange(1, count), rel=1e-12, abs=0)


def test_too_many_steps_raise_budget_error() -> None:
    with pytest.raises(rg.BudgetError, match="steps"):
        rg.circuit.transient(one_pole(), [1.0], step=1e-12)


def test_a_current_into_a_floating_node_raises_the_error_of_solve() -> None:
    """An operating point and a transient raise the same message."""
    netlist = one_pole(node_count=4, current_nodes=[[0, 3]], current_amps=[1.0])
    with pytest.raises(rg.CircuitError, match="no resistor or voltage source ties these to ground") as moving:
        rg.circuit.transient(netlist, [1e-6])
    with pytest.raises(rg.CircuitError) as at_rest:
        rg.solve(netlist)
    assert str(moving.value) == str(at_rest.value)


def test_an_initial_scene_on_another_grid_raises_input_error() -> None:
    with pytest.raises(rg.InputError, match="another scene on the same grid"):
        rg.circuit.transient(scene(2, "merged"), [1e-6], initial=rg.solve(small_scene()))
