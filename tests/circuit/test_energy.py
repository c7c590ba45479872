"""Energy delivered by sources in a transient, against closed forms with small differences of large numbers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

import resgrid as rg


@pytest.mark.parametrize("weak", [1e-6, 1e-10, 1e-13, 1e-16])
def test_energy_includes_the_small_current_through_a_weak_resistor(weak: float) -> None:
    netlist = rg.Netlist(
        4, [[1, 2], [2, 3], [3, 0]], [1.0, 1.0, weak], source_nodes=[[1, 0]], source_volts=[1.0],
        capacitor_nodes=[[2, 0]], capacitance=[1e-12],
    )  # fmt: skip
    time = 1e-6 / weak
    found = rg.circuit.transient(netlist, [0.0, time], initial=rg.solve(netlist))
    assert found.energy[-1] == pytest.approx(time / (1 / weak + 2), rel=1e-9)


@given(common=st.floats(-1e8, 1e8), volts=st.floats(0.5, 2.0))
@pytest.mark.slow
def test_energy_does_not_depend_on_the_reference_of_the_voltages(common: float, volts: float) -> None:
    netlist = rg.Netlist(
        4, [[1, 2], [2, 3]], [1e-3, 1e-3], source_nodes=[[1, 0], [3, 0]], source_volts=[common + volts, common],
        capacitor_nodes=[[2, 3]], capacitance=[1e-9],
    )  # fmt: skip
    across = (common + volts) - common
    # Half of the current charges the capacitor to half of the voltage with a time constant of C / 2 mS.
    time = 1e-6
    charge = 0.5e-9 * across * -np.expm1(-2.0 * time / 1e-6)
    wanted = across * (0.5e-3 * across * time + 0.5 * charge)
    found = rg.circuit.transient(netlist, [time], initial=[0.0, common, common, common], step=time / 200)
    assert found.energy[-1] == pytest.approx(wanted, rel=1e-5 + 1e-13 * abs(common))


def test_energy_of_a_settled_circuit_equals_power_times_time() -> None:
    netlist = rg.Netlist(
        4, [[1, 2], [2, 0], [2, 3], [3, 0]], [1e-3, 2e-3, 5e-4, 1e-3], source_nodes=[[1, 0]], source_volts=[1.0],
        current_nodes=[[0, 3]], current_amps=[1e-3], capacitor_nodes=[[2, 3], [3, 0]], capacitance=[1e-9, 2e-9],
    )  # fmt: skip
    op = rg.solve(netlist)
    found = rg.circuit.transient(netlist, [0.0, 1e3], initial=op)
    assert found.energy[-1] == pytest.approx(1e3 * op.power, rel=1e-12)
    assert found.energy[0] == 0.0


def floating_loop() -> rg.Netlist:
    """Return 1 V into an RC circuit, and 1 A through 1 ohm between two floating nodes."""
    return rg.Netlist(
        5, [[1, 2], [3, 4]], [1.0, 1.0], source_nodes=[[1, 0]], source_volts=[1.0],
        current_nodes=[[3, 4]], current_amps=[1.0], capacitor_nodes=[[2, 0]], capacitance=[1.0],
    )  # fmt: skip


@pytest.mark.parametrize(
    "analyse",
    [
        lambda netlist: rg.circuit.transient(netlist, [1.0]),
        lambda netlist: rg.study(netlist).settling(),
        lambda netlist: rg.study(netlist).noise(),
    ],
)
def test_dynamic_analyses_reject_current_sources_in_a_floating_part(analyse: object) -> None:
    assert callable(analyse)
    with pytest.raises(rg.CircuitError, match="no resistor or voltage source ties these to ground"):
        analyse(floating_loop())
