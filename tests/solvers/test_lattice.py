"""Slots of cells in red-black arrays, compared with their indices.

Tests internals: `resgrid.solvers.multigrid.red_black`.
"""

import numpy as np
from hypothesis import given, strategies as st

from resgrid.solvers.multigrid.red_black import RedBlackLayout

LATTICES = st.builds(RedBlackLayout, st.lists(st.integers(1, 6), min_size=2, max_size=4).map(tuple), st.integers(0, 3))


@given(LATTICES)
def test_every_cell_has_its_own_slot_in_the_array_of_its_colour(lattice: RedBlackLayout) -> None:
    index = np.indices(lattice.shape).reshape(len(lattice.shape), -1)
    slot = lattice.cells.ravel()
    black = index.sum(axis=0) % 2 == 1
    np.testing.assert_array_equal(slot >= lattice.slots, black)
    assert len(np.unique(slot)) == index.shape[1]
    for colour in range(2):
        here = slot[black == colour] - colour * lattice.slots
        assert np.all((here >= lattice.margin) & (here < lattice.first_extra))
        np.testing.assert_array_equal(np.stack(lattice.cells_at(colour, here)), index[:, black == colour])


@given(LATTICES)
def test_slot_distances_identify_common_faces(lattice: RedBlackLayout) -> None:
    index = np.indices(lattice.shape).reshape(len(lattice.shape), -1)
    slot, red = lattice.cells.ravel(), index.sum(axis=0) % 2 == 0
    away = (slot[~red] - lattice.slots)[np.newaxis, :] - slot[red][:, np.newaxis]
    step = index[:, ~red][:, np.newaxis, :] - index[:, red][:, :, np.newaxis]
    for side, distance in enumerate(lattice.distance.tolist()):
        shares = (step[side // 2] == (1 if side % 2 else -1)) & (np.abs(step).sum(axis=0) == 1)
        np.testing.assert_array_equal(away == distance, shares)


@given(LATTICES)
def test_no_face_points_outside_the_array(lattice: RedBlackLayout) -> None:
    assert lattice.margin + lattice.distance.min() >= 0
    assert lattice.first_extra + lattice.extras + lattice.distance.max() <= lattice.slots


@given(LATTICES)
def test_at_slots_writes_values_to_their_slots_only(lattice: RedBlackLayout) -> None:
    values = np.arange(1, 1 + np.prod(lattice.shape), dtype=np.int32).reshape(lattice.shape)
    at_slots = lattice.at_slots(values)
    np.testing.assert_array_equal(at_slots.ravel()[lattice.cells], values)
    assert np.count_nonzero(at_slots) == values.size
