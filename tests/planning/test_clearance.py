"""Distances of cells from obstacles: pairwise computation compared with the distance transform.

Tests internals: `resgrid.planning`.
"""

from unittest import mock

import numpy as np
from hypothesis import given
from support.spaces import spaces

from resgrid.planning import clearance


@given(spaces())
def test_pairwise_distances_equal_the_distance_transform(space):
    found = clearance.obstacle_reach(space)
    with mock.patch.object(clearance, "_FEW_PAIRS", -1):
        transformed = clearance.obstacle_reach(space)
    assert (found is None) == (transformed is None)
    if found is not None:
        np.testing.assert_allclose(found, transformed, rtol=1e-12)
