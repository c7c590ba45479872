"""Potentials over many orders of magnitude: entries by multigrid compared with those by the direct method."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from support.spaces import serpentine, space_of, spaces

import resgrid as rg


def rooms(size: int = 200) -> NDArray[np.uint8]:
    """Rectangular obstacles on a square grid with the goal in a corner."""
    rng, cell = np.random.default_rng(5), np.zeros((size, size), dtype=np.uint8)
    for _ in range(size**2 // 300):
        i, j = rng.integers(8, size, 2)
        cell[i : i + rng.integers(2, 14), j : j + rng.integers(2, 14)] = 1
    cell[0, 0] = 2
    return cell


def with_slits() -> NDArray[np.uint8]:
    """Two rooms joined by a slit of 30 cells, and a dead-end slit of 160 cells."""
    cell = np.ones((63, 172), dtype=np.uint8)
    cell[1:59, 1:60] = cell[1:59, 90:170] = 0
    cell[20, 60:90] = cell[59:61, 10] = cell[61, 10:170] = 0
    cell[1, 1] = 2
    return cell


def volume_maze() -> NDArray[np.uint8]:
    """A corridor of 10 x 10 x 300 cells, over about sixty orders of magnitude."""
    plane = np.pad(serpentine(5, 60, 10), 1, constant_values=1)
    cell = np.pad(np.repeat(np.minimum(plane, 1)[None], 10, axis=0), ((1, 1), (0, 0), (0, 0)), constant_values=1)
    cell[(5, *np.argwhere(plane == 2)[0])] = 2
    return cell


@pytest.mark.parametrize(
    ("cell", "decades"), [(rooms(), 15), (rooms(400), 15), (with_slits(), 90), (volume_maze(), 30)]
)
def test_methods_agree_on_rooms_slits_and_mazes(cell: NDArray[np.uint8], decades: float) -> None:
    fallen = assert_methods_agree(rg.compile_space(space_of(cell), boundary="dirichlet"))
    assert fallen > decades


@settings(max_examples=40)
@given(
    st.one_of(spaces(max_cells=30, dimensions=(2, 2)), spaces(max_cells=10, dimensions=(3, 3))),
    st.sampled_from([{"boundary": "dirichlet"}, {"boundary": "wall", "wall_resistance": 30.0}]),
)
def test_methods_agree_on_random_planes_and_volumes(space: rg.ConfigurationSpace, options: dict[str, object]) -> None:
    try:
        netlist = rg.compile_space(space, **options)  # type: ignore[arg-type]
        rg.solve(netlist, method="direct")
    except rg.CircuitError:
        return
    assert_methods_agree(netlist)


def assert_methods_agree(netlist: rg.Netlist) -> float:
    """Assert equal logarithms of potentials; return the orders of magnitude of the smallest one."""
    one, other = (rg.solve(netlist, method=method).log_drop for method in ("multigrid", "direct"))
    assert one is not None
    assert other is not None
    here = np.isfinite(other)
    np.testing.assert_array_equal(np.isfinite(one), here)
    np.testing.assert_allclose(one[here], other[here], rtol=0, atol=1e-8)
    return float(-other[here].min() / np.log(10.0))
