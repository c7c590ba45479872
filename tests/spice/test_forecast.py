"""Forecast run times of simulators, compared with times measured with ngspice 39; time limits.

Tests internals: `resgrid.spice.run.cost_estimate`.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import resgrid as rg
from resgrid.spice.run.cost_estimate import core_of, forecast, require_time


def network(pairs: NDArray[np.int64]) -> rg.Netlist:
    """1 V at node 1, resistors of 1 kohm, and one from the last node to ground."""
    last = int(pairs.max())
    ends = np.concatenate([pairs, [[last, 0]]])
    return rg.Netlist(last + 1, ends, np.full(len(ends), 1e-3), source_nodes=[[1, 0]], source_volts=[1.0])


def box(*shape: int) -> rg.Netlist:
    index = 1 + np.arange(np.prod(shape)).reshape(shape)
    pairs = [
        np.stack([np.take(index, range(n - 1), axis).ravel(), np.take(index, range(1, n), axis).ravel()], axis=1)
        for axis, n in enumerate(shape)
    ]
    return network(np.concatenate(pairs))


def tree(size: int) -> rg.Netlist:
    rng = np.random.default_rng(size)
    child = np.arange(2, size)
    return network(np.stack([child, [rng.integers(max(1, i - 50), i) for i in child.tolist()]], axis=1))


def random_graph(size: int, rounds: int) -> rg.Netlist:
    rng = np.random.default_rng(size)
    walks = [rng.permutation(np.arange(1, size)) for _ in range(rounds)]
    return network(np.concatenate([np.stack([walk, np.roll(walk, 1)], axis=1) for walk in walks]))


@pytest.mark.parametrize(
    ("netlist", "seconds"),
    [
        (box(64, 64), 0.45),
        (box(128, 128), 9.41),
        (box(192, 192), 65.9),
        (box(256, 256), 240.0),
        (box(14, 14, 14), 4.2),
        (box(20, 20, 20), 120.8),
        (box(6, 6, 6, 6), 2.41),
        (random_graph(800, 3), 1.62),
        (random_graph(1500, 3), 7.77),
        (tree(40_000), 0.18),
    ],
)
def test_forecasts_agree_with_measured_times_within_a_factor_of_3(netlist: rg.Netlist, seconds: float) -> None:
    assert seconds / 3 < forecast(netlist).seconds < seconds * 3


def test_trees_and_chains_have_no_core() -> None:
    assert core_of(rg.spice.Circuit.of(tree(500))) == (0, 0.0)
    assert core_of(rg.spice.Circuit.of(box(400))) == (0, 0.0)
    assert core_of(rg.spice.Circuit.of(rg.Netlist(2, [[1, 0]], [1.0]))) == (0, 0.0)


def test_rails_are_not_part_of_the_core() -> None:
    grid = box(30, 30)
    size, width = core_of(rg.spice.Circuit.of(grid))
    rail = grid.node_count
    ties = np.stack([np.full(900, rail), 1 + np.arange(900)], axis=1)
    tied = rg.Netlist(
        rail + 1,
        np.concatenate([grid.resistor_nodes, ties]),
        np.full(len(grid.conductance) + 900, 1.0),
        source_nodes=[[1, 0], [rail, 0]],
        source_volts=[1.0, 2.0],
    )
    assert core_of(rg.spice.Circuit.of(tied)) == (size, pytest.approx(width))


def test_a_forecast_beyond_the_time_limit_raises_budget_error() -> None:
    slow = forecast(box(256, 256))
    assert "min" in str(slow)
    with pytest.raises(rg.BudgetError, match=r"4 min.*time limit is 60 s.*--engine eecircuit"):
        require_time(slow, 60.0)
    fast = forecast(box(256, 256), "eecircuit")
    assert 2 < fast.seconds < 15
    require_time(fast, 60.0)
    with pytest.raises(rg.InputError, match="there is no cost model"):
        forecast(box(4, 4), "spice3")


@pytest.mark.parametrize(
    ("engine", "version", "costs"),
    [
        ("ngspice", "39", "ngspice"),
        ("ngspice", "41", "ngspice"),
        ("ngspice", "42", "ngspice-klu"),
        ("ngspice", "45.2", "ngspice-klu"),
        ("ngspice", "44+", "ngspice-klu"),
        ("ngspice", "unknown", "ngspice"),
        ("eecircuit", "", "eecircuit"),
    ],
)
def test_versions_select_the_cost_model(engine: str, version: str, costs: str) -> None:
    assert forecast(box(4, 4), engine, version).engine == costs
