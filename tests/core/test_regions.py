"""Numbers of faces against counted indices; connected regions found by two methods.

Tests internals: `resgrid.core`, `resgrid.core.regions`.
"""

import sys
from unittest import mock

import numpy as np
from hypothesis import given, strategies as st

from resgrid.core import regions
from resgrid.core.regions import by_axis, crossed_faces, face_counts, face_shape, label_regions

SHAPES = st.lists(st.integers(1, 5), min_size=1, max_size=4).map(tuple)


@given(SHAPES)
def test_faces_are_numbered_axis_by_axis(shape: tuple[int, ...]) -> None:
    shapes = [(*shape[:axis], cells + 1, *shape[axis + 1 :]) for axis, cells in enumerate(shape)]
    assert [face_shape(shape, axis) for axis in range(len(shape))] == shapes
    expected = [(axis, index) for axis, faces in enumerate(shapes) for index in np.ndindex(faces)]
    assert sum(face_counts(shape)) == len(expected)
    across, index = crossed_faces(np.arange(-1, len(expected)), shape)
    assert across[0] == -1
    assert list(zip(across[1:].tolist(), map(tuple, index[1:].tolist()), strict=True)) == expected
    for axis, part in enumerate(by_axis(np.arange(len(expected)), shape)):
        assert [(axis, at) for at in np.ndindex(part.shape)] == [expected[number] for number in part.ravel()]


@given(SHAPES, st.data(), st.booleans())
def test_small_and_large_grid_methods_find_the_same_regions(
    shape: tuple[int, ...], data: st.DataObject, corners: bool
) -> None:
    mask = np.random.default_rng(data.draw(st.integers(0, 2**31))).random(shape) < 0.6
    rings = data.draw(st.lists(st.booleans(), min_size=len(shape), max_size=len(shape)))
    with mock.patch.dict(sys.modules):
        sys.modules.pop("scipy.ndimage", None)
        in_python = label_regions(mask, rings, corners=corners)
    with mock.patch.object(regions, "_SMALL", 0):
        np.testing.assert_array_equal(in_python, label_regions(mask, rings, corners=corners))
