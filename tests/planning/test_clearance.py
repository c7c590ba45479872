"""Distances of cells from obstacles: pairwise computation compared with the distance transform.

Tests internals: `resgrid.planning`.
"""

from unittest import mock

import numpy as np
from hypothesis import given
from support.spaces import spaces

from resgrid.planning import clearance


@given(spaces())
def test_pairwise_distances_agree_with_those_of_large_spaces(space):
    found = clearance.obstacle_reach(space)
    with mock.patch.object(clearance, "_FEW_PAIRS", -1):
        transformed = clearance.obstacle_reach(space)
    assert (found is None) == (transformed is None)
    if found is not None:
        if space.ndim != 2 or space.periodic.any():  # by a distance transform
            np.testing.assert_allclose(found, transformed, rtol=1e-12)
        else:  # by chains of steps between cells, which are upper bounds
            half = 0.5 * np.linalg.norm(space.spacing)
            assert np.all(found <= transformed * (1.0 + 1e-12))
            assert np.all(transformed - half <= np.sqrt(2.0) * (found - half) + 1e-12 * transformed)
