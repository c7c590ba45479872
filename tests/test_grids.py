"""Slabs against indices counted one by one."""

from unittest import mock

import numpy as np
from hypothesis import given, strategies as st

from resgrid import grids
from resgrid.grids import face_counts, faces_ahead, label_regions, places_in_slab
from resgrid.netlist import face_shape

SHAPES = st.lists(st.integers(1, 5), min_size=1, max_size=4).map(tuple)


@given(SHAPES, st.data())
def test_faces_are_numbered_as_in_an_array_of_faces(shape: tuple[int, ...], data: st.DataObject) -> None:
    axis, ahead = data.draw(st.integers(0, len(shape) - 1)), data.draw(st.integers(0, 1))
    here = np.arange(np.prod(shape))
    index = list(np.unravel_index(here, shape))
    index[axis] = index[axis] + ahead
    expected = np.ravel_multi_index(tuple(index), face_shape(shape, axis))
    np.testing.assert_array_equal(faces_ahead(here, shape, axis, ahead), expected)


@given(SHAPES)
def test_all_faces_are_counted(shape: tuple[int, ...]) -> None:
    assert face_counts(shape) == tuple(np.zeros(face_shape(shape, axis)).size for axis in range(len(shape)))


@given(SHAPES, st.data())
def test_places_are_those_kept(shape: tuple[int, ...], data: st.DataObject) -> None:
    axis = data.draw(st.integers(0, len(shape) - 1))
    start = data.draw(st.integers(0, shape[axis] - 1))
    stop = data.draw(st.integers(start + 1, shape[axis]))
    kept = np.random.default_rng(data.draw(st.integers(0, 99))).random(shape) < 0.5
    inside = np.zeros(shape, dtype=bool)
    cut = (slice(None),) * axis + (slice(start, stop),)
    inside[cut] = kept[cut]
    np.testing.assert_array_equal(places_in_slab(kept[cut], shape, axis, (start, stop)), np.flatnonzero(inside))


@given(SHAPES, st.data(), st.booleans())
def test_regions_are_the_same_however_they_are_found(
    shape: tuple[int, ...], data: st.DataObject, corners: bool
) -> None:
    mask = np.random.default_rng(data.draw(st.integers(0, 2**31))).random(shape) < 0.6
    rings = data.draw(st.lists(st.booleans(), min_size=len(shape), max_size=len(shape)))
    walked = label_regions(mask, rings, corners=corners)
    with mock.patch.object(grids, "_SMALL", 0):
        np.testing.assert_array_equal(walked, label_regions(mask, rings, corners=corners))
