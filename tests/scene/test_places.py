"""Nearest allowed cells on grids with periodic axes, compared with exhaustive search.

Tests internals: `resgrid.scene.nearest_place`.
"""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings, strategies as st

import resgrid as rg
from resgrid.scene.nearest_place import nearest_cell


@given(st.integers(0, 2**32 - 1), st.integers(1, 3))
@settings(max_examples=150)
def test_the_nearest_cell_equals_that_of_exhaustive_search(seed: int, ndim: int) -> None:
    rng = np.random.default_rng(seed)
    axes = [
        rg.Axis(
            name, 0.0, float(rng.uniform(0.5, 3.0)), int(rng.integers(1, 40 if ndim < 3 else 12)), bool(rng.integers(2))
        )
        for name in "xyz"[:ndim]
    ]
    shape = tuple(axis.cells for axis in axes)
    allowed = rng.random(shape) < rng.choice([0.0, 0.005, 0.1, 0.9])
    cell = tuple(int(rng.integers(size)) for size in shape)
    found = nearest_cell(allowed, cell, axes)
    places = np.argwhere(allowed)
    if not len(places):
        assert found is None
        return
    assert found is not None and allowed[found]

    def apart(place: np.ndarray) -> np.ndarray:
        steps = np.abs(place - np.array(cell))
        around = np.where([axis.periodic for axis in axes], np.array(shape) - steps, steps)
        return np.linalg.norm(np.minimum(steps, around) * [axis.spacing for axis in axes], axis=-1)

    assert apart(np.array(found)) <= apart(places).min() * (1 + 1e-12)
