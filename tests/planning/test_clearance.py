"""How far cells are from obstacles, found pair by pair and by a distance transform.

Tests internals: `resgrid.planning`.
"""

from unittest import mock

import numpy as np
from hypothesis import given
from support.spaces import spaces

from resgrid.planning import clearance


@given(spaces())
def test_the_reach_is_the_same_however_it_is_found(space):
    found = clearance.obstacle_reach(space)
    with mock.patch.object(clearance, "_FEW_PAIRS", -1):
        transformed = clearance.obstacle_reach(space)
    assert (found is None) == (transformed is None)
    if found is not None:
        np.testing.assert_allclose(found, transformed, rtol=1e-12)
