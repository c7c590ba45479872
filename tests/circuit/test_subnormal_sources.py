"""Circuits whose source voltages are smaller than the smallest normal double, about 2.2e-308 V.

Tests internals: `resgrid.solvers.scaled`.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator

import numpy as np
import pytest
from support.spaces import space_of

import resgrid as rg
from resgrid.solvers.scaled import divided

TINY = (1e-300, 1e-308, 1e-310, 5e-324)
ULP = 5e-324


@pytest.fixture(autouse=True)
def numeric_warnings_are_errors() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        yield


def divider(volts: float, amps: float = 0.0) -> rg.Netlist:
    """Return 1 V across 1 ohm, `volts` across two resistors of 1 ohm in series, and `amps` into their joint."""
    loops = rg.Netlist(
        4, [[1, 2], [2, 3], [3, 0]], [1.0, 1.0, 1.0], source_nodes=[[1, 0], [2, 0]], source_volts=[1.0, volts]
    )
    return loops.replace(current_nodes=[[0, 3]], current_amps=[amps]) if amps else loops


@pytest.mark.parametrize("accuracy", ["direction", "normwise"])
@pytest.mark.parametrize("method", ["direct", "multigrid"])
@pytest.mark.parametrize("volts", [*TINY, *(-each for each in TINY)])
def test_a_large_source_beside_a_tiny_one_keeps_its_current(volts: float, method: str, accuracy: str) -> None:
    """The ratio of the source voltages exceeds the range of a double.

    With currents of both signs, values below 2**-1000 of the largest one may be 0.
    """
    for amps in (0.0, volts):
        floor = 2.0**-1000 if amps else ULP
        point = rg.solve(divider(volts, amps), method=method, accuracy=accuracy)
        np.testing.assert_allclose(point.voltage, [0.0, 1.0, volts, (volts + amps) / 2], rtol=1e-12, atol=floor)
        np.testing.assert_allclose(point.resistor_current[0], 1.0, rtol=1e-12)
        np.testing.assert_allclose(point.resistor_current[1:], [(volts - amps) / 2, (volts + amps) / 2], 1e-12, floor)
        assert point.power == pytest.approx(1.0)
        assert len(repr(point)) > 0


@pytest.mark.parametrize("accuracy", ["direction", "normwise"])
@pytest.mark.parametrize("method", ["direct", "multigrid"])
@pytest.mark.parametrize("volts", TINY)
def test_a_space_with_a_tiny_supply_has_scaled_voltages(volts: float, method: str, accuracy: str) -> None:
    cell = np.zeros((9, 9), dtype=np.uint8)
    cell[2, 3:7] = cell[6, 1] = 1
    cell[7, 7] = 2
    space = space_of(cell)
    for boundary in ("dirichlet", "neumann"):
        unit = rg.solve(rg.compile_space(space, boundary=boundary), method=method)
        netlist = rg.compile_space(space, boundary=boundary, supply=volts)
        if boundary == "neumann" and not netlist.current_amps.any():  # below the smallest double
            with pytest.raises(rg.CircuitError, match="nothing is driven"):
                rg.solve(netlist, method=method, accuracy=accuracy)
            continue
        point = rg.solve(netlist, method=method, accuracy=accuracy)
        feed = len(netlist.current_amps) * 1e4 * ULP if boundary == "neumann" else 0.0
        np.testing.assert_allclose(point.voltage, volts * unit.voltage, rtol=1e-9, atol=20 * feed + ULP)


def test_quotients_beyond_the_range_of_a_double_keep_their_exponent() -> None:
    found = divided(np.array([1.0, -3.0, np.nan, 0.0, 1e308]), 5e-324)
    with np.errstate(divide="ignore"):
        log = np.log2(np.abs(found.hi)) + 256.0 * found.exponent
    np.testing.assert_allclose(log[[0, 1, 4]], [1074.0, 1074.0 + np.log2(3.0), 1074.0 + np.log2(1e308)], rtol=1e-14)
    assert np.isnan(found.hi[2])
    assert found.hi[1] < 0 == found.hi[3]
    np.testing.assert_array_equal(divided(np.array([1.0, np.inf]), -3.0).plain, [-1.0 / 3.0, -np.inf])
