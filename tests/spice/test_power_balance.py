"""IR drop and power balance of solved circuits, compared with values computed by hand and with the solver's power."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.circuits import random_grid

import resgrid as rg


def test_each_net_has_its_own_supply() -> None:
    """1.8 V - 1 ohm - a (1 A to ground net g); g - 1 ohm - 0 V pad; a 3.3 V net joined by a load only."""
    netlist = rg.Netlist(
        7,
        [[1, 2], [3, 4], [5, 6]],
        [1.0, 1.0, 1.0],
        source_nodes=[[1, 0], [4, 0], [5, 0]],
        source_volts=[1.8, 0.0, 3.3],
        current_nodes=[[2, 3], [6, 2]],
        current_amps=[1.0, 0.5],
    )
    drops = rg.spice.ir_drop(rg.solve(netlist))
    np.testing.assert_allclose(drops.supply[1:], [1.8, 1.8, 0.0, 0.0, 3.3, 3.3])
    np.testing.assert_allclose(drops.drop[1:], [0.0, 0.5, -1.0, 0.0, 0.0, 0.5], atol=1e-15)
    assert drops.worst(2).tolist() == [3, 2]
    assert drops.worst(0).tolist() == []
    assert len(drops.worst(100)) == 6


def test_floating_nodes_have_no_drop() -> None:
    netlist = rg.Netlist(4, [[1, 0]], [1.0], source_nodes=[[1, 0]], source_volts=[1.0])
    drops = rg.spice.ir_drop(rg.solve(netlist))
    assert np.isnan(drops.drop[2:]).all() and drops.worst(10).tolist() == [1]


@given(st.integers(0, 10_000), st.booleans())
@settings(max_examples=30)
def test_delivered_power_equals_dissipated_power(seed: int, drive: bool) -> None:
    point = rg.solve(random_grid(seed, side=4, drive=drive))
    balance = rg.spice.power_balance(point)
    assert balance.imbalance < 1e-12
    assert balance.dissipated == pytest.approx(point.power, rel=1e-12)
    drops = rg.spice.ir_drop(point)
    assert drops.supply[1] == 1.0 and np.all(drops.supply[4:] == 1.0)


def test_nonlinear_resistors_are_part_of_the_balance() -> None:
    netlist = rg.Netlist(
        3, [[1, 2]], [1e-3], source_nodes=[[1, 0]], source_volts=[1.0], nonlinear_nodes=[[2, 0], [1, 0]],
        nonlinear_current=[2e-4, 1e-5], nonlinear_voltage=[0.1, 0.3],
    )  # fmt: skip
    balance = rg.spice.power_balance(rg.solve(netlist))
    assert balance.imbalance < 1e-12
    assert 0 < balance.nonlinear_power.sum() < balance.delivered


def test_a_loop_of_sources_has_an_undetermined_balance() -> None:
    pairs = [[1, 0], [1, 0]]
    with pytest.warns(UserWarning, match="loops"):
        open_ = rg.spice.power_balance(
            rg.solve(rg.Netlist(2, [[1, 0]], [1.0], source_nodes=pairs, source_volts=[1.0, 1.0]))
        )
    assert np.isnan(open_.delivered) and np.isnan(open_.imbalance)
    shorts = {"source_nodes": [[1, 0], [1, 2], [1, 2]], "source_volts": [1.0, 0.0, 0.0]}
    with pytest.warns(UserWarning, match="loops"):
        closed = rg.spice.power_balance(rg.solve(rg.Netlist(3, [[2, 0]], [1.0], **shorts)))
    assert closed.delivered == pytest.approx(1.0) and closed.imbalance == 0
