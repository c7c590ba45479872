"""The operating point of a normwise answer: currents wait until they are asked for, and are the right ones."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

import resgrid as rg
from resgrid.netlist import Netlist
from resgrid.nodal.operating_point import Ammeters
from tests.circuits import dense_solution, ladder, random_grid


@pytest.mark.parametrize("netlist", [ladder(), random_grid(1), random_grid(2, drive=False)])
def test_normwise_readings_are_those_of_a_dense_solution(netlist: Netlist) -> None:
    point, expected = rg.solve(netlist, accuracy="normwise"), dense_solution(netlist)
    for name in ("voltage", "resistor_current", "source_current"):
        np.testing.assert_allclose(getattr(point, name), getattr(expected, name), rtol=1e-9, atol=1e-15)
    assert point.power == pytest.approx(expected.power, rel=1e-12)
    assert point.kcl_residual < 1e-10
    np.testing.assert_array_equal(point.resistor_direction, np.sign(point.resistor_current))
    np.testing.assert_allclose(np.exp(point.resistor_log_current), np.abs(point.resistor_current), rtol=1e-12)


def test_normwise_readings_are_taken_once_and_shared_by_copies() -> None:
    point = rg.solve(random_grid(3), accuracy="normwise")
    assert isinstance(point.ammeters, Ammeters)
    assert "readings" not in vars(point.ammeters)
    copy = replace(point, iterations=7)
    assert copy.resistor_current is point.resistor_current
    assert not point.resistor_current.flags.writeable
    assert not point.voltage.flags.writeable


@pytest.mark.parametrize("asked", [False, True])
def test_a_point_survives_pickling(asked: bool) -> None:
    point = rg.solve(random_grid(4), accuracy="normwise")
    if asked:
        assert point.power > 0
    again = pickle.loads(pickle.dumps(point))
    np.testing.assert_array_equal(again.resistor_current, point.resistor_current)
    assert again.power == point.power


def test_currents_of_a_loop_of_sources_warn_at_once() -> None:
    netlist = Netlist(3, [[2, 0]], [1e-3], source_nodes=[[1, 0], [2, 1], [2, 0]], source_volts=[1.0, 1.0, 2.0])
    with pytest.warns(UserWarning, match="form loops"):
        point = rg.solve(netlist.replace(resistor_nodes=[[2, 0]]), accuracy="normwise")
    assert np.all(np.isnan(point.source_current))
