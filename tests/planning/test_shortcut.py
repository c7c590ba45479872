"""Shortcuts, compared with rational arithmetic over every cell and with dense points along each segment.

Tests internals: `resgrid.core.regions`, `resgrid.planning`, `resgrid.planning.streamline`.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from support.spaces import serpentine, space_of, spaces

import resgrid as rg
from resgrid.core.regions import label_regions
from resgrid.planning import kernels
from resgrid.planning.streamline import length_of


def touched_exactly(start: list[float], end: list[float], shape: tuple[int, ...]) -> set[tuple[int, ...]]:
    """Closed cells that meet a closed segment, by clipping against every cell in rational arithmetic."""
    cells = set()
    for cell in product(*(range(-1, n + 1) for n in shape)):
        low, high = Fraction(0), Fraction(1)
        for a, b, i in zip(map(Fraction, start), map(Fraction, end), cell, strict=True):
            if a == b:
                if not i <= a <= i + 1:
                    low, high = Fraction(1), Fraction(0)
                continue
            enter, leave = sorted([(i - a) / (b - a), (i + 1 - a) / (b - a)])
            low, high = max(low, enter), min(high, leave)
        if low <= high:
            cells.add(cell)
    return cells


@st.composite
def segments(draw: st.DrawFn) -> tuple[list[float], list[float], tuple[int, ...]]:
    ndim = draw(st.integers(1, 4))
    shape = tuple(draw(st.integers(1, 4 if ndim < 4 else 2)) for _ in range(ndim))
    ends = [[draw(st.integers(0, 4 * n)) / 4 for n in shape] for _ in range(2)]
    return ends[0], ends[1], shape


@given(segments(), st.data())
@settings(max_examples=150)
def test_a_segment_is_free_exactly_if_all_touched_cells_are_free(case, data: st.DataObject) -> None:
    """Ends lie on quarters of cells, so that segments often meet corners and borders."""
    start, end, shape = case
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    touched = touched_exactly(start, end, shape)
    free = rng.random(shape) < 0.9
    expected = all(all(0 <= i < n for i, n in zip(c, shape, strict=True)) and free[c] for c in touched)
    arguments = np.array(shape, dtype=np.int64), np.zeros(len(shape), dtype=bool), 1e-9
    assert kernels.segment_is_free(np.array(start), np.array(end), free.ravel(), *arguments) == expected
    for cell in touched:
        if all(0 <= i < n for i, n in zip(cell, shape, strict=True)):
            only = np.ones(shape, dtype=bool)
            only[cell] = False
            assert not kernels.segment_is_free(np.array(start), np.array(end), only.ravel(), *arguments)


def dirichlet(space: rg.ConfigurationSpace) -> rg.Field:
    return rg.field(rg.solve(rg.compile_space(space)))


def points_along(points: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    share = np.linspace(0, 1, count)[:, np.newaxis]
    return np.concatenate([a + share * (b - a) for a, b in pairwise(points)])


@given(spaces(max_cells=12, conductive=False), st.data())
@settings(max_examples=40)
def test_shortcuts_are_free_shorter_and_keep_both_ends(space: rg.ConfigurationSpace, data: st.DataObject) -> None:
    reachable = np.argwhere(space.goal_connected)
    if not len(reachable):
        return
    field = rg.field(rg.solve(rg.compile_space(space, boundary="neumann")))
    cell = reachable[data.draw(st.integers(0, len(reachable) - 1))]
    path = rg.streamline(field, cell=cell.tolist())
    short = rg.shortcut(path, rounds=30)
    way = rg.planning.unwrap(path)
    np.testing.assert_array_equal(short.points[[0, -1]], way[[0, -1]])
    assert length_of(short.points) <= path.length * (1 + 1e-12)
    assert short.length >= np.linalg.norm(way[-1] - way[0]) * (1 - 1e-12)
    inside = points_along(short.points, 200)
    inside = inside[1:-1] if len(inside) else short.points
    turned = np.where(space.periodic, np.mod(inside - space.lower, space.upper - space.lower) + space.lower, inside)
    # A point on a border may touch an obstacle only along a segment of the streamline; nudged inwards it is free.
    cells = np.floor((turned - space.lower) / space.spacing).astype(int) % space.shape
    on_border = np.any(np.abs((turned - space.lower) / space.spacing % 1 - 0.5) > 0.5 - 1e-6, axis=1)
    assert np.all((space.cell[tuple(cells.T)] != rg.Cell.OBSTACLE) | on_border)


def test_a_shortcut_without_obstacles_is_one_segment() -> None:
    cell = np.zeros((30, 20), dtype=np.uint8)
    cell[28, 18] = rg.Cell.GOAL
    field = dirichlet(space_of(cell))
    path = rg.streamline(field, start=(1.5, 1.5))
    short = rg.shortcut(path)
    assert len(short.points) == 2
    assert short.length == pytest.approx(float(np.linalg.norm(path.points[-1] - path.points[0])))
    assert short.original is path


def test_segments_that_touch_a_corner_of_an_obstacle_are_rejected() -> None:
    cell = np.zeros((4, 4), dtype=np.uint8)
    cell[1, 1] = rg.Cell.OBSTACLE
    space = space_of(cell)
    rg.certify_collision_free(rg.Polyline([(0.5, 2.6), (3.0, 3.5)], space))
    with pytest.raises(rg.CertificateError, match=r"segment 0 touches cell \(1, 1\)"):
        rg.certify_collision_free(rg.Polyline([(0.5, 2.5), (2.5, 0.5), (3.5, 0.5)], replace_cell(space, (2, 2))))
    with pytest.raises(rg.CertificateError, match=r"\(1, 1\)"):
        rg.certify_collision_free(rg.Polyline([(0.5, 2.5), (1.5, 1.5)], space))
    with pytest.raises(rg.CertificateError, match="outside"):
        rg.certify_collision_free(rg.Polyline([(0.5, 0.5), (-0.5, 3.5)], space))
    rg.certify_collision_free(rg.Polyline([(1.0, 0.2), (1.0, 1.0)], space_of(np.zeros((4, 4), dtype=np.uint8))))
    rg.certify_collision_free(
        rg.Polyline([(0.2, 1.0), (1.0, 1.8)], space)
    )  # within one closed cell, though it ends on the obstacle's side


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1), st.integers(2, 4))
@settings(max_examples=40)
def test_certified_polylines_never_join_cells_without_a_common_face(seed: int, ndim: int) -> None:
    """Walks over centres, faces, edges and corners of cells, each step within one closed free cell."""
    rng = np.random.default_rng(seed)
    shape = (4,) * ndim if ndim < 4 else (3,) * 4
    space = space_of(rng.random(shape) < 0.5, periodic=tuple(rng.random(ndim) < 0.3))
    region = label_regions(space.cell != rg.Cell.OBSTACLE, space.periodic)
    free = np.argwhere(region > 0)
    if not len(free):
        return
    cell = free[rng.integers(len(free))]
    way, passed = [cell + 0.5], 0
    for _ in range(12):
        way.append(cell + rng.choice([0.0, 0.5, 1.0], ndim, p=[0.4, 0.2, 0.4]))
        adjacent = np.array([c for c in np.ndindex(*shape) if region[c] and np.all(np.abs(way[-1] - c - 0.5) <= 0.5)])
        cell = adjacent[rng.integers(len(adjacent))] if len(adjacent) else cell
        way.append(cell + 0.5)
        try:
            rg.certify_collision_free(rg.Polyline(way, space))
        except rg.CertificateError:
            break
        passed += 1
        assert region[tuple(np.floor(way[0]).astype(int))] == region[tuple(cell)]
    cells = [np.floor(point).astype(int) for point in way[::2]]
    if passed < 12 and all(np.abs(a - b).sum() <= 1 for a, b in pairwise(cells)):
        raise AssertionError("a way through faces was refused")


@pytest.mark.parametrize("knot", [(2.0, 2.0, 1.5), (2.0, 2.0, 1.0)], ids=["edge", "corner"])
def test_polylines_through_the_common_edge_of_two_blocks_are_rejected(knot: tuple[float, float, float]) -> None:
    """Two blocks with one common edge: the two free quarters at the edge are different regions."""
    cell = np.zeros((4, 4, 4), dtype=np.uint8)
    cell[:2, 2:], cell[2:, :2] = rg.Cell.OBSTACLE, rg.Cell.OBSTACLE
    space = space_of(cell)
    along = (2.0, 2.0, knot[2] + 0.5)
    rg.certify_collision_free(rg.Polyline([(1.5, 1.5, 1.5), knot, along, (1.5, 1.5, 1.5)], space))
    with pytest.raises(rg.CertificateError, match="corner or edge"):
        rg.certify_collision_free(rg.Polyline([(1.5, 1.5, 1.5), knot, (2.5, 2.5, 1.5)], space))
    with pytest.raises(rg.CertificateError, match="corner or edge"):
        rg.certify_collision_free(rg.Polyline([(1.5, 1.5, 1.5), knot, along, (2.5, 2.5, 1.5)], space))


def test_a_polyline_through_a_corner_of_three_free_cells_is_valid() -> None:
    """At the inner corner of an L the third cell connects both neighbours through faces."""
    rg.certify_collision_free(rg.Polyline([(0.5, 0.5), (1.0, 1.0), (1.5, 1.5)], space_of([[0, 0], [1, 0]])))
    with pytest.raises(rg.CertificateError, match="corner or edge"):
        rg.certify_collision_free(rg.Polyline([(0.5, 0.5), (1.0, 1.0), (1.5, 1.5)], space_of([[0, 1], [1, 0]])))
    ring = space_of([[0, 1], [1, 0]], periodic=(True, True))
    with pytest.raises(rg.CertificateError, match="corner or edge"):
        rg.certify_collision_free(rg.Polyline([(0.5, 0.5), (0.0, 0.0), (-0.5, -0.5)], ring))


def test_polylines_outside_the_grid_or_of_excessive_length_are_rejected() -> None:
    space = space_of(np.zeros((3, 3)), periodic=(True, False))
    rg.certify_collision_free(rg.Polyline([(-40.0, 1.0), (80.0, 2.0)], space))
    with pytest.raises(rg.CertificateError, match="point 1 lies outside"):
        rg.certify_collision_free(rg.Polyline([(0.0, 1.0), (0.0, 1e12)], space))
    with pytest.raises(rg.InputError, match="longer than"):
        rg.certify_collision_free(rg.Polyline([(0.0, 1.0), (1e12, 1.0)], space))


def replace_cell(space: rg.ConfigurationSpace, cell: tuple[int, int]) -> rg.ConfigurationSpace:
    code = space.cell.copy()
    code[cell] = rg.Cell.OBSTACLE
    return rg.ConfigurationSpace(space.axes, code)


def test_a_shortcut_keeps_the_requested_clearance() -> None:
    cell = np.zeros((40, 30), dtype=np.uint8)
    cell[20, :22], cell[38, 2] = rg.Cell.OBSTACLE, rg.Cell.GOAL
    field = dirichlet(space_of(cell))
    path = rg.streamline(field, start=(2.5, 14.5))
    bold, usual, careful = (rg.shortcut(path, clearance=clearance) for clearance in (0.0, None, 1.5))
    assert path.length > careful.length >= usual.length > bold.length
    assert usual.clearance >= path.clearance / 2
    assert bold.clearance < 0.5
    assert careful.clearance >= min(path.clearance, 1.5) - 1e-9


@given(spaces(), st.integers(0, 2**32 - 1))
@settings(max_examples=40)
def test_a_shortcut_keeps_half_of_the_clearance_by_default(space: rg.ConfigurationSpace, pick: int) -> None:
    free = np.argwhere(space.goal_connected)
    if not len(free):
        return
    path = rg.plan(space, boundary="neumann").path(cell=free[pick % len(free)].tolist())
    if path.outcome is not rg.Outcome.REACHED:
        return
    short = rg.shortcut(path, rounds=30)
    assert short.clearance >= path.clearance / 2 * (1 - 1e-9) or np.isinf(path.clearance)


def test_equal_seeds_give_equal_shortcuts_in_a_maze() -> None:
    space = space_of(serpentine(6, 14, 2))
    field = dirichlet(space)
    free = np.argwhere(space.goal_connected)
    path = rg.streamline(field, cell=free[-1].tolist())
    first, again = rg.shortcut(path, seed=3), rg.shortcut(path, seed=3)
    np.testing.assert_array_equal(first.points, again.points)
    assert first.length < path.length
    rg.certify_collision_free(first)


def test_shortcuts_cross_seams() -> None:
    cell = np.zeros((20, 12), dtype=np.uint8)
    cell[10, :], cell[2, 6] = rg.Cell.OBSTACLE, rg.Cell.GOAL
    space = space_of(cell, periodic=(True, False))
    path = rg.streamline(dirichlet(space), start=(15.5, 4.5))
    short = rg.shortcut(path)
    assert len(short.points) == 2
    assert short.points[-1, 0] == pytest.approx(22.0, abs=0.51)
    rg.certify_collision_free(short)


def test_shortcuts_of_failed_paths_and_invalid_options_raise() -> None:
    cell = np.zeros((3, 3), dtype=np.uint8)
    cell[1, :], cell[2, 2] = rg.Cell.OBSTACLE, rg.Cell.GOAL
    field = dirichlet(space_of(cell))
    with pytest.raises(rg.InputError, match="no_path"):
        rg.shortcut(rg.streamline(field, cell=(0, 0)))
    path = rg.streamline(field, cell=(2, 0))
    with pytest.raises(rg.InputError, match="clearance = nan"):
        rg.shortcut(path, clearance=float("nan"))
    for wrong in ({"rounds": -1}, {"rounds": 2_000_000}, {"rounds": 1.5}, {"seed": -1}, {"clearance": "wide"}):
        with pytest.raises(rg.InputError, match=next(iter(wrong))):
            rg.shortcut(path, **wrong)
    with pytest.raises(rg.InputError, match="must be a Streamline"):
        rg.shortcut(path.points)
    goal = rg.shortcut(rg.streamline(field, cell=(2, 2)))
    assert (len(goal.points), goal.length) == (1, 0.0)
