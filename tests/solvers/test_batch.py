"""Batches of chips, compared with modified nodal analysis and single solutions of every chip.

Tests internals: `resgrid.circuit.batch`, `resgrid.circuit.equations`, `resgrid.solvers.hierarchy_reuse`.
"""

from __future__ import annotations

from concurrent.futures import Executor, ThreadPoolExecutor

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import spsolve
from support.spaces import space_of

import resgrid as rg
from resgrid.circuit.batch import prepare_batch
from resgrid.circuit.equations import assemble
from resgrid.solvers.hierarchy_reuse import solve_by_levels, solve_in_order


def open_grid(shape: tuple[int, ...], periodic: tuple[bool, ...] | None = None, **options: object) -> rg.Netlist:
    cell = (np.random.default_rng(1).random(shape) < 0.06).astype(np.uint8)
    cell[tuple(n // 3 for n in shape)] = 2
    return rg.compile_space(space_of(cell, periodic=periodic), **options)


def samples(netlist: rg.Netlist, chips: int, spread: float = 0.05) -> np.ndarray:
    rng = np.random.default_rng(2)
    return netlist.conductance * np.exp(spread * rng.standard_normal((chips, len(netlist.conductance))))


def exact(netlist: rg.Netlist, conductance: np.ndarray) -> np.ndarray:
    """Node voltages by modified nodal analysis (Ho, Ruehli & Brennan 1975), with all source currents."""
    n, s = netlist.node_count, len(netlist.source_volts)
    a, b = netlist.resistor_nodes.T
    row, column = np.concatenate([a, b, a, b]), np.concatenate([a, b, b, a])
    value = np.concatenate([conductance, conductance, -conductance, -conductance])
    plus, minus = netlist.source_nodes.T
    extra = np.arange(n, n + s)
    row = np.concatenate([row, plus, minus, extra, extra])
    column = np.concatenate([column, extra, extra, plus, minus])
    value = np.concatenate([value, np.ones(s), -np.ones(s), np.ones(s), -np.ones(s)])
    rhs = np.zeros(n + s)
    np.add.at(rhs, netlist.current_nodes[:, 0], -netlist.current_amps)
    np.add.at(rhs, netlist.current_nodes[:, 1], netlist.current_amps)
    rhs[n:] = netlist.source_volts
    live = np.flatnonzero(np.isin(np.arange(n + s), row) & (np.arange(n + s) > 0))
    matrix = sparse.csc_matrix((value, (row, column)), shape=(n + s, n + s))[live][:, live]
    voltage = np.full(n + s, np.nan)
    voltage[0], voltage[live] = 0.0, spsolve(matrix, rhs[live])
    return voltage[:n]


GRIDS = {
    "plane": ((40, 50), None, {}),
    "cells": ((40, 50), None, {"rails": "cells"}),
    "torus": ((32, 48), (True, True), {}),
    "uneven torus": ((36, 42), (True, True), {}),
    "volume": ((12, 14, 16), None, {}),
    "uniform": ((40, 50), None, {"boundary": "neumann"}),
    "odd ring": ((41, 50), (True, False), {}),
    "small": ((9, 9), None, {}),
}


@pytest.mark.parametrize("name", GRIDS)
def test_every_chip_agrees_with_modified_nodal_analysis(name: str) -> None:
    shape, periodic, options = GRIDS[name]
    netlist = open_grid(shape, periodic, **options)
    batch = prepare_batch(netlist)
    assert batch is not None
    method = solve_in_order if name in {"odd ring", "small"} else solve_by_levels
    assert batch.solver.func is method
    conductance = samples(netlist, 3)
    found = rg.circuit.solve_many(netlist, conductance)
    scale = np.nanmax(np.abs(found))
    for volts, chip in zip(found, conductance, strict=True):
        point = rg.solve(netlist.replace(conductance=chip), accuracy="normwise", rtol=1e-14, method="direct")
        np.testing.assert_allclose(volts, point.voltage, rtol=0, atol=2e-8 * scale)
        if options.get("boundary") is None:
            np.testing.assert_allclose(volts, exact(netlist, chip), rtol=0, atol=2e-8 * scale)


def test_floating_sources_and_parallel_resistors_agree_with_nodal_analysis() -> None:
    netlist = rg.Netlist(
        6,
        [[0, 1], [1, 2], [1, 2], [2, 3], [4, 5], [5, 0], [3, 0], [2, 4]],
        np.linspace(1.0, 2.0, 8),
        source_nodes=[[1, 0], [3, 4]],
        source_volts=[1.0, 0.25],
        current_nodes=[[0, 5]],
        current_amps=[0.1],
    )
    conductance = samples(netlist, 4, 0.5)
    for volts, chip in zip(rg.circuit.solve_many(netlist, conductance, rtol=1e-14), conductance, strict=True):
        np.testing.assert_allclose(volts, exact(netlist, chip), rtol=1e-12)


def test_results_do_not_depend_on_the_batch_or_the_executor(processes: Executor) -> None:
    netlist = open_grid((40, 50))
    conductance = samples(netlist, 20)
    together = rg.circuit.solve_many(netlist, conductance)
    np.testing.assert_array_equal(rg.circuit.solve_many(netlist, conductance[7:8])[0], together[7])
    with ThreadPoolExecutor(2) as threads:
        np.testing.assert_array_equal(rg.circuit.solve_many(netlist, conductance, executor=threads), together)
    np.testing.assert_array_equal(rg.circuit.solve_many(netlist, conductance, executor=processes), together)


def test_netlists_of_rails_and_empty_batches_are_accepted() -> None:
    rails = rg.Netlist(2, [[0, 1]], [1.0], source_nodes=[[1, 0]], source_volts=[2.0])
    np.testing.assert_array_equal(rg.circuit.solve_many(rails, [[3.0], [4.0]]), [[0, 2], [0, 2]])
    assert rg.circuit.solve_many(open_grid((9, 9)), np.empty((0, len(open_grid((9, 9)).conductance)))).shape[0] == 0


def test_invalid_conductances_raise_input_error() -> None:
    netlist = open_grid((9, 9))
    good = samples(netlist, 2)
    bad = good.copy()
    bad[1, 5] = -1.0
    with pytest.raises(rg.InputError, match="chip 1: resistor 5 has conductance -1"):
        rg.circuit.solve_many(netlist, bad)
    with pytest.raises(rg.InputError, match="one row per chip"):
        rg.circuit.solve_many(netlist, good[0])
    with pytest.raises(rg.InputError, match="must be numbers"):
        rg.circuit.solve_many(netlist, "many")  # type: ignore[arg-type]
    with pytest.raises(rg.InputError, match="rtol"):
        rg.circuit.solve_many(netlist, good, rtol=0.0)


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
def test_chips_far_from_the_nominal_one_meet_the_tolerance(boundary: str) -> None:
    netlist = open_grid((40, 50), boundary=boundary)
    far = samples(netlist, 6, 1.5)
    for volts, chip in zip(rg.circuit.solve_many(netlist, far, rtol=1e-8), far, strict=True):
        system = assemble(netlist.replace(conductance=chip))
        solved, x = system.unknown >= 0, np.zeros(system.size)
        x[system.unknown[solved]] = volts[solved] - system.reference
        residual = system.drive - (system.laplacian.diagonal * x - system.laplacian.edges @ x)
        assert np.linalg.norm(residual) <= 1.01e-8 * np.linalg.norm(system.drive)
        np.testing.assert_allclose(volts, exact(netlist, chip), rtol=0, atol=1e-6)


@pytest.mark.parametrize("shape", [(40, 50), (9, 9)], ids=["multigrid", "factors"])
@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
@pytest.mark.parametrize("spread", [0.3, 3.0])
def test_chips_of_any_spread_agree_with_single_solutions(shape: tuple[int, int], boundary: str, spread: float) -> None:
    """With open obstacles currents are a millionth of matrix times voltage: a small residual is weak evidence."""
    netlist = open_grid(shape, boundary=boundary)
    for rtol in (1e-6, 1e-10):
        chips = samples(netlist, 2, spread)
        for volts, chip in zip(rg.circuit.solve_many(netlist, chips, rtol=rtol), chips, strict=True):
            alone = rg.solve(netlist.replace(conductance=chip)).voltage
            assert np.abs(volts - alone).max() <= 1e2 * rtol * np.abs(alone).max()


@pytest.mark.parametrize("shape", [(40, 50), (20, 24)], ids=["multigrid", "factors"])
@pytest.mark.parametrize("where", ["contact", "inside", "contacts"])
@pytest.mark.parametrize("times", [1e4, 1e6, 1e9])
def test_short_circuits_do_not_hide_errors_of_other_nodes(shape: tuple[int, int], where: str, times: float) -> None:
    """Relative to the large currents of stiff contacts, other residuals appear small."""
    netlist = open_grid(shape)
    (chip,) = samples(netlist, 1)
    contact = np.flatnonzero((netlist.resistor_nodes == netlist.cells.obstacle_node).any(axis=1))
    inside = np.setdiff1d(np.arange(len(chip)), contact)
    chip[{"contact": contact[:1], "inside": inside[len(inside) // 2 :][:1], "contacts": contact}[where]] *= times
    (volts,) = rg.circuit.solve_many(netlist, [chip])
    np.testing.assert_allclose(volts, rg.solve(netlist.replace(conductance=chip)).voltage, rtol=0, atol=2e-8)


def test_weak_branches_parallel_to_stiff_ones_are_accurate() -> None:
    netlist = rg.Netlist(
        4, [[1, 2], [2, 0], [1, 3], [3, 0]], [1.0, 1.0, 1e-11, 1e-11], source_nodes=[[1, 0]], source_volts=[1.0]
    )
    (volts,) = rg.circuit.solve_many(netlist, [[1.0, 1.0, 3e-11, 1e-11]])
    np.testing.assert_allclose(volts, [0.0, 1.0, 0.5, 0.75], rtol=1e-9)


@pytest.mark.parametrize("shape", [(40, 50), (9, 9)], ids=["multigrid", "factors"])
@pytest.mark.parametrize("scale", [1e-160, 1e-20, 1e20, 1e150])
def test_results_do_not_depend_on_the_unit_of_conductance(shape: tuple[int, int], scale: float) -> None:
    netlist = open_grid(shape)
    chips = samples(netlist, 2)
    expected = rg.circuit.solve_many(netlist, chips)
    np.testing.assert_allclose(rg.circuit.solve_many(netlist, scale * chips), expected, rtol=0, atol=1e-8)
    scaled = netlist.replace(conductance=scale * netlist.conductance)
    np.testing.assert_allclose(rg.circuit.solve_many(scaled, scale * chips), expected, rtol=0, atol=1e-8)


@pytest.mark.parametrize("on", [100.0, 1.0, 1e-3, 1e-6])
def test_switches_of_low_resistance_do_not_hide_errors(on: float) -> None:
    """The nominal chip contains the same switches."""
    netlist = open_grid((40, 50), rails="cells")
    chip = rg.Chip(mismatch=0.2, obstacle_switch_on=on, goal_switch_on=on)
    built, chips = rg.study(netlist, chip).conductances([1, 2])
    for volts, conductance in zip(rg.circuit.solve_many(built, chips), chips, strict=True):
        alone = rg.solve(built.replace(conductance=conductance)).voltage
        np.testing.assert_allclose(volts, alone, rtol=0, atol=2e-8)


def test_nodes_joined_by_stiff_resistors_are_accurate() -> None:
    """Two nodes with almost equal voltages are weakly connected to the rails: rounding errors hide their residual."""
    ends = [[1, 0], [2, 0], [3, 2], [4, 2], [5, 4], [6, 5], [7, 5], [8, 6], [9, 7], [10, 9], [7, 6]]
    nominal = [
        242.94735833203677, 8.156223174342891, 0.27470256639614615, 1.5564604637947583, 0.028363311037768485,
        10.142588980395097, 0.3787807626204636, 19.758061420025744, 0.004521932355358756, 6.165325563429716,
        0.0020847058661289945,
    ]  # fmt: skip
    wild = [
        776974772.4223409, 196.86383251908683, 5154.746875782792, 6.974357707731618e-06, 84044155.37090617,
        2.5090991512889663e-07, 6.353097757428127e-05, 358693.24585274694, 59.74793020569362, 8.54608005119265,
        180.29309761650362,
    ]  # fmt: skip
    netlist = rg.Netlist(11, ends, nominal, source_nodes=[[0, 9]], source_volts=[-5.0])
    up, down = wild[5] + wild[6], wild[3]  # nodes 2, 6 and 7 are at the rails, up to about 1e-7
    assert rg.circuit.solve_many(netlist, [wild])[0, 4] == pytest.approx(5.0 * up / (up + down), rel=1e-6)


def test_underflowing_products_of_residuals_are_handled() -> None:
    netlist = rg.Netlist(
        4, [[1, 0], [2, 0], [3, 1], [1, 3]], [1e-12, 1e12, 1e-12, 1e12],
        source_nodes=[[3, 0], [2, 0]], source_volts=[-1.0, -1.0],
    )  # fmt: skip
    chip = [2.2817240247438017e-17, 446932994385.402, 2.455655477476633e-13, 1.2704184391898117e25]
    assert rg.circuit.solve_many(netlist, [chip])[0, 1] == pytest.approx(-1.0)
