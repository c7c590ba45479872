"""Fields of warm-started cell voltages, compared face by face with the field of the solved netlist."""

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

import resgrid as rg

WIRINGS = (
    {"boundary": "dirichlet"},
    {"boundary": "dirichlet", "edge": "open", "supply": -3.0, "goal_voltage": 1.0},
    {"boundary": "neumann", "resistance": 1e3, "supply": -2.0},
    {"boundary": "wall", "wall_resistance": 3e5},
)


@pytest.mark.parametrize("wiring", WIRINGS, ids=lambda wiring: wiring["boundary"])
@settings(max_examples=40, deadline=None)
@given(data=st.data(), shape=array_shapes(min_dims=1, max_dims=3, min_side=1, max_side=7))
@pytest.mark.quick_cases(1)
def test_warm_start_currents_equal_those_of_the_netlist(wiring, data, shape):
    cell = data.draw(arrays(np.uint8, shape, elements=st.sampled_from([0, 0, 0, 1, 2])))
    rings = data.draw(st.lists(st.booleans(), min_size=len(shape), max_size=len(shape)))
    cost = data.draw(st.none() | arrays(float, shape, elements=st.floats(0.1, 10.0)))
    assume((cell == rg.Cell.GOAL).any())
    axes = [rg.Axis(f"q{a}", 0.0, 1.0 + a, n, periodic=rings[a]) for a, n in enumerate(shape)]
    space = rg.ConfigurationSpace(axes, cell, conductivity=cost)
    try:
        expected = rg.field(rg.solve(rg.compile_space(space, **wiring)))
    except rg.CircuitError:
        with pytest.raises(rg.CircuitError):
            rg.field(rg.circuit.WarmStart(**wiring).solve(space))
        return
    field = rg.field(rg.circuit.WarmStart(rtol=1e-12, **wiring).solve(space))
    shown = space.goal_connected | (cell == rg.Cell.GOAL)
    np.testing.assert_allclose(field.potential[shown], expected.potential[shown], atol=1e-9)
    scale = max(np.abs(expected.face_current(axis)).max() for axis in range(space.ndim))
    for axis in range(space.ndim):
        np.testing.assert_allclose(field.face_current(axis), expected.face_current(axis), rtol=0.0, atol=1e-9 * scale)


@pytest.mark.parametrize("start", [(0, 3), (7, 3)], ids=["far from the goal", "next to the goal"])
def test_a_driving_start_has_potential_1_and_the_netlists_currents(start: tuple[int, int]):
    cell = np.zeros((9, 7), dtype=np.uint8)
    cell[8, 3] = rg.Cell.GOAL
    space = rg.ConfigurationSpace([rg.Axis("x", 0.0, 9.0, 9), rg.Axis("y", 0.0, 7.0, 7)], cell)
    wiring = {"boundary": "neumann", "drive": "start", "start": start}
    field = rg.field(rg.circuit.WarmStart(rtol=1e-12, **wiring).solve(space))
    expected = rg.field(rg.solve(rg.compile_space(space, **wiring)))
    assert field.potential[start] == 1.0
    for axis in range(2):
        np.testing.assert_allclose(field.face_current(axis), expected.face_current(axis), atol=1e-9)
