"""Nodal systems: rows, ties and counts against dense sums, with compressed rows and without.

Tests internals: `resgrid.circuit.equations`, `resgrid.solvers.laplacian`, `resgrid.solvers.method_choice`.
"""

from __future__ import annotations

import io
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.spaces import space_of, spaces

import resgrid as rg
from resgrid.circuit.equations import Equations, assemble
from resgrid.solvers.laplacian import WEAK, conductance_statistics
from resgrid.solvers.method_choice import choose_method

RULES: tuple[dict[str, Any], ...] = (
    {},
    {"boundary": "neumann"},
    {"boundary": "wall", "wall_resistance": 3e4},
    {"rails": "cells"},
    {"supply": -2.0},
)


def dense_sums(system: Equations) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Couplings, excess and feed, resistor by resistor."""
    n, netlist, known = system.size, system.netlist, system.known_voltages()
    coupling, excess, feed = np.zeros((n, n)), np.zeros(n), np.zeros(n)
    for (a, b), g in zip(netlist.resistor_nodes.tolist(), netlist.conductance.tolist(), strict=True):
        for here, there in ((a, b), (b, a)):
            i, j = system.unknown[here], system.unknown[there]
            if i >= 0 and j >= 0 and i != j:
                coupling[i, j] += g
                feed[i] += g * (system.forest.offsets[0][there] - system.forest.offsets[0][here])
            elif i >= 0 and j < 0:
                excess[i] += g
                feed[i] += g * (known[there] - system.reference - system.forest.offsets[0][here])
    return coupling, excess, feed


def check(system: Equations) -> None:
    coupling, excess, feed = dense_sums(system)
    assert system.unknown.dtype == np.int32
    np.testing.assert_allclose(system.laplacian.ground, excess, rtol=1e-14)
    np.testing.assert_allclose(system.feed, feed, rtol=1e-12, atol=1e-12 * np.abs(feed).max(initial=0.0))
    np.testing.assert_allclose(system.laplacian.diagonal, coupling.sum(axis=1) + excess, rtol=1e-14)
    np.testing.assert_allclose(system.laplacian.edges.toarray(), coupling, rtol=1e-14)
    if system.rails is not None:
        np.testing.assert_allclose(system.rails.to_high + system.rails.to_low, excess, rtol=1e-14)
        heights = [volts - system.reference for volts in (system.rails.high, system.rails.low)]
        tied = heights[0] * system.rails.to_high + heights[1] * system.rails.to_low
        np.testing.assert_allclose(system.feed, tied, rtol=1e-14, atol=0)


@settings(max_examples=60)
@given(space=spaces(), rules=st.sampled_from(RULES), seed=st.integers(0, 99))
def test_rows_are_sums_over_resistors(space: rg.ConfigurationSpace, rules: dict[str, Any], seed: int) -> None:
    try:
        netlist = rg.compile_space(space, **rules)
        spread = np.random.default_rng(seed).uniform(0.5, 2.0, len(netlist.conductance))
        system = assemble(netlist.replace(conductance=netlist.conductance * spread))
    except rg.CircuitError as error:
        assert "nothing is driven" in str(error)
        return
    check(system)


def with_sources(seed: int) -> rg.Netlist:
    """A random graph with floating sources, 0 V ones among them, parts that float, and currents."""
    rng = np.random.default_rng(seed)
    count = 24
    pairs = rng.integers(0, count, (30, 2))
    sources = np.stack([np.zeros(2, np.int64), np.array([1, 2])], axis=1)
    floating = np.stack([rng.permutation(np.arange(3, 13)), rng.permutation(np.arange(13, 23))], axis=1)[:5]
    return rg.Netlist(
        count,
        pairs,
        10.0 ** rng.uniform(-1, 1, len(pairs)),
        source_nodes=np.concatenate([sources, floating]),
        source_volts=np.concatenate([[-1.0, 0.5], rng.choice([0.0, 0.25, -1.5], len(floating))]),
    )


AT_REST = {
    "all sources 0 V": ("V1 a 0 0\nR1 a b 1\nR2 b 0 1", {"a": 0, "b": 0}),
    "an open load": ("V1 a 0 10\nR1 a b 1\nR2 b c 1", {"a": 10, "b": 10, "c": 10}),
    "a load between equal rails": ("V1 a 0 2\nV2 b 0 2\nR1 a b 1", {"a": 2, "b": 2}),
    "two loads, each on one rail": ("V1 a 0 2\nV2 b 0 5\nR1 a c 1\nR2 b d 1", {"c": 2, "d": 5}),
    "no source at all": ("R1 a 0 1\nR2 a b 1", {"a": 0, "b": 0}),
    "beside a part that floats": ("V1 a 0 3\nR1 a b 1\nR2 x y 1", {"b": 3, "x": None, "y": None}),
    "behind a capacitor": ("V1 a 0 3\nC1 a b 1\nR1 b 0 1", {"a": 3, "b": 0}),
}


@pytest.mark.parametrize("what", AT_REST)
@pytest.mark.parametrize("accuracy", ["direction", "normwise"])
def test_a_circuit_in_which_nothing_flows_is_a_circuit(what: str, accuracy: str) -> None:
    text, volts = AT_REST[what]
    point = rg.solve(rg.read_spice(io.StringIO(f"t\n{text}\n.end\n")).netlist(), accuracy=accuracy)
    for name, expected in volts.items():
        node = point.netlist.node_names.index(name)
        assert np.isnan(point.voltage[node]) if expected is None else point.voltage[node] == expected
    assert not point.resistor_current.any() and not point.source_current.any()
    assert (point.power, point.kcl_residual, point.log_drop, point.potential) == (0.0, 0.0, None, None)
    assert len(point.floating) == list(volts.values()).count(None)


@pytest.mark.parametrize("netlist", [rg.Netlist(1, np.empty((0, 2), np.int32), []), rg.Netlist(3, [[1, 2]], [1.0])])
def test_a_circuit_that_does_not_touch_ground_is_none(netlist: rg.Netlist) -> None:
    with pytest.raises(rg.CircuitError, match="touches ground"):
        rg.solve(netlist)


def test_what_hangs_on_a_rail_is_no_rail() -> None:
    """A resistor between two rails of 10 V and 5 V makes them the only two, whatever hangs on one of them."""
    deck = rg.read_spice(io.StringIO("t\nV1 a 0 10\nV2 b 0 5\nR1 a b 1\nR2 a c 1\n.end\n"))
    point = rg.solve(deck.netlist())
    assert point.log_drop is not None
    drop = dict(zip(deck.node_names, point.log_drop.tolist(), strict=True))
    assert drop["b"] == 0.0 and drop["a"] == drop["c"] == -np.inf


@settings(max_examples=60)
@given(seed=st.integers(0, 2**32 - 1))
def test_floating_sources_share_rows(seed: int) -> None:
    try:
        system = assemble(with_sources(seed))
    except rg.CircuitError as error:
        assert "ground" in str(error)
        return
    check(system)
    root = system.forest.root
    for node, row in enumerate(system.unknown.tolist()):
        assert row == system.unknown[root[node]]
    solved = np.unique(root[system.unknown >= 0])
    assert system.unknown[solved].tolist() == list(range(system.size))
    unsolved = np.flatnonzero(system.unknown < 0)
    assert set(unsolved) >= set(system.undriven) | set(system.floating)
    assert np.array_equal(np.flatnonzero(np.isnan(system.known_voltages()) & (system.unknown < 0)), system.floating)


@settings(max_examples=60)
@given(space=spaces(), rules=st.sampled_from(RULES), decades=st.sampled_from([0.0, 3.0]), seed=st.integers(0, 99))
def test_counts_are_those_of_the_compressed_rows(
    space: rg.ConfigurationSpace, rules: dict[str, Any], decades: float, seed: int
) -> None:
    try:
        netlist = rg.compile_space(space, **rules)
        spread = 10.0 ** np.random.default_rng(seed).uniform(0, decades, len(netlist.conductance))
        system = assemble(netlist.replace(conductance=netlist.conductance * spread))
    except rg.CircuitError:
        return
    found = conductance_statistics(system.laplacian)
    coupling = system.laplacian.edges.toarray()
    strongest = coupling.max(axis=1, initial=0.0)
    present = coupling > 0
    weak = present & (coupling < WEAK * np.maximum(strongest[:, None], strongest))
    values = np.concatenate([coupling[present], system.laplacian.ground[system.laplacian.ground > 0]])
    assert found.entries == np.count_nonzero(present)
    assert found.weak == np.count_nonzero(weak) / max(np.count_nonzero(present), 1)
    assert (found.smallest, found.largest) == (values.min(initial=np.inf), values.max(initial=0.0))
    assert found.mean == pytest.approx(coupling[present].mean() if present.any() else 0.0, rel=1e-12)
    of_rows = conductance_statistics(replace(system.laplacian, listed=None, compressed=system.laplacian.as_rows()))
    assert of_rows == replace(found, mean=pytest.approx(found.mean, rel=1e-12))


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
def test_a_grid_is_judged_without_compressed_rows(boundary: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("resgrid.solvers.laplacian._compress", lambda *_: pytest.fail("rows were compressed"))
    cell = (np.random.default_rng(3).random((120, 120)) < 0.1).astype(np.uint8)
    cell[30, 30] = 2
    system = assemble(rg.compile_space(space_of(cell), boundary=boundary))
    assert conductance_statistics(system.laplacian).entries > 0
    assert choose_method(system.laplacian, accuracy="normwise").method == "multigrid"
