"""Streamlines and blends of fields, compared with closed forms, brute-force clearance and finite differences.

Tests internals: `resgrid.planning.blend`, `resgrid.planning.fields`.
"""

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from support.spaces import space_of, spaces

import resgrid as rg
from resgrid.planning.blend import dirichlet_fraction
from resgrid.planning.fields import undriven_field

BOUNDARIES = [{}, {"boundary": "neumann"}, {"boundary": "wall", "wall_resistance": 2.0}]


def field(space: rg.ConfigurationSpace, **options: object) -> rg.Field:
    try:
        return rg.field(rg.solve(rg.compile_space(space, resistance=1.0, **options)))
    except rg.CircuitError:
        assume(False)
        raise


def room() -> rg.ConfigurationSpace:
    cell = np.zeros((12, 9))
    cell[5, :7] = 1
    cell[1, 2] = cell[10, 1] = 2
    return space_of(cell, spacing=(0.5, 0.25))


@pytest.mark.slow
@settings(max_examples=80)
@given(spaces(), st.sampled_from(BOUNDARIES), st.integers(0, 2**32 - 1))
def test_every_streamline_certifies_and_has_the_outcome_of_its_cell(
    space: rg.ConfigurationSpace, options: dict[str, object], seed: int
) -> None:
    flow = field(space, **options)
    rng = np.random.default_rng(seed)
    points = space.lower + rng.random((20, space.ndim)) * (space.upper - space.lower)
    for point in points:
        path = rg.streamline(flow, point)
        rg.certify(path)
        code = space.cell[tuple(space.locate(point))]
        if code == rg.Cell.OBSTACLE:
            assert path.outcome is rg.Outcome.START_BLOCKED
        elif code == rg.Cell.GOAL:
            assert path.outcome is rg.Outcome.REACHED and path.length == 0.0
        elif not space.goal_connected[tuple(space.locate(point))]:
            assert path.outcome in {rg.Outcome.NO_PATH, rg.Outcome.GOAL_BLOCKED}
        else:
            # A component that touches goals only is flat; a scene's symmetry can make a cell flat.
            assert path.outcome in {rg.Outcome.REACHED, rg.Outcome.NO_CURRENT}


@pytest.mark.slow
@settings(max_examples=60)
@given(spaces(), st.sampled_from([0.0, 0.01, 0.5, 0.99, 1.0]))
def test_blends_reach_a_goal_from_every_connected_cell(space: rg.ConfigurationSpace, k: float) -> None:
    dirichlet, neumann = field(space), field(space, boundary="neumann")
    mixed = rg.blend(dirichlet, neumann, k)
    starts = np.argwhere(space.goal_connected)[:60]
    for cell in starts:
        path = rg.streamline(mixed, cell=cell.tolist())
        rg.certify(path)
        if k < 1.0:
            assert path.outcome is rg.Outcome.REACHED


def test_a_streamline_in_an_open_channel_is_straight() -> None:
    """Between a driven and a goal end the field is uniform: the streamline is a straight line of known duration."""
    cell = np.zeros((11, 3))
    cell[-1] = 2
    cell[0] = 1
    space = space_of(cell, spacing=(2.0, 2.0))
    flow = rg.field(rg.solve(rg.compile_space(space, edge="open", resistance=7.0)))
    path = rg.streamline(flow, (2.0, 1.3))
    rg.certify(path)
    assert np.allclose(path.points[:, 1], 1.3)
    assert path.length == pytest.approx(18.0)
    # grad phi = 1 / (10 spacings of 2): the velocity is 1 / 20.
    assert path.log_duration == pytest.approx(np.log(18.0 * 20.0))
    assert path.clearance == pytest.approx(0.0)
    assert path.goal == 0


def test_streamlines_agrees_with_streamline() -> None:
    space = room()
    flow = field(space)
    rng = np.random.default_rng(0)
    points = space.lower + rng.random((50, 2)) * (space.upper - space.lower)
    many = rg.streamlines(flow, points)
    for k, point in enumerate(points):
        one = rg.streamline(flow, point)
        assert many.outcome[k] == one.outcome
        assert many.goal[k] == (-1 if one.goal is None else one.goal)
        if one.outcome is rg.Outcome.REACHED:
            assert many.length[k] == pytest.approx(one.length)
            assert many.steps[k] == len(one.cells) - 1


def test_clearance_agrees_with_brute_force() -> None:
    rng = np.random.default_rng(4)
    for periodic in ((False, False), (True, False), (True, True)):
        cell = (rng.random((14, 11)) < 0.15).astype(int)
        cell[7, 5] = 2
        space = space_of(cell, periodic=periodic, spacing=(1.0, 0.5))
        flow = field(space, edge="open")
        boxes = np.argwhere(space.cell == rg.Cell.OBSTACLE) * space.spacing
        extent = space.upper - space.lower
        for start in np.argwhere(space.goal_connected)[::9]:
            path = rg.streamline(flow, cell=start.tolist())
            if path.outcome is not rg.Outcome.REACHED:
                continue
            expected = np.inf
            local = path.points / space.spacing - path.cells
            for k in range(len(path.cells) - 1):
                moved = path.cells[k + 1] != path.cells[k]
                end = np.where(moved, 1.0 - local[k + 1], local[k + 1])
                for t in np.linspace(0, 1, 41):
                    p = (path.cells[k] + (1 - t) * local[k] + t * end) * space.spacing
                    d = p - boxes
                    shift = np.where(periodic, extent, np.inf)
                    gap = np.min([np.abs(_outside(d + s * extent, space.spacing)) for s in (-1, 0, 1)], axis=0)
                    plain = np.abs(_outside(d, space.spacing))
                    gap = np.where(np.isfinite(shift), gap, plain)
                    expected = min(expected, np.linalg.norm(gap, axis=1).min())
            assert path.clearance == pytest.approx(expected, abs=0.02)
            assert path.clearance <= expected + 1e-12


def _outside(offset: np.ndarray, size: np.ndarray) -> np.ndarray:
    return np.minimum(offset, 0) + np.maximum(offset - size, 0)


def test_outcomes_are_members_of_outcome_and_bad_starts_raise() -> None:
    cell = np.zeros((7, 7))
    cell[1, 1] = 2
    cell[4, :] = 1
    space = space_of(cell)
    flow = field(space)
    assert rg.streamline(flow, cell=(4, 3)).outcome is rg.Outcome.START_BLOCKED
    assert rg.streamline(flow, cell=(6, 6)).outcome is rg.Outcome.NO_PATH
    assert rg.streamline(flow, cell=(3, 3)).outcome is rg.Outcome.REACHED
    assert rg.streamline(flow, (4.0, 2.5)).outcome is rg.Outcome.REACHED  # on the wall's face: the free side counts
    with pytest.raises(rg.InputError, match="outside the grid"):
        rg.streamline(flow, (9.0, 1.0))
    with pytest.raises(rg.InputError):
        rg.streamline(flow)


def test_an_enclosed_goal_has_the_outcome_goal_blocked() -> None:
    cell = np.zeros((7, 7))
    cell[1:4, 1:4] = 1
    cell[2, 2] = 2
    space = space_of(cell)
    # No current flows in such a circuit, so that the outcome depends on the cells only.
    silent = undriven_field(space, rg.Wiring())
    path = rg.streamline(silent, cell=(0, 0))
    assert path.outcome is rg.Outcome.GOAL_BLOCKED
    rg.certify(path)


def test_only_starts_on_the_driven_current_reach_the_goal() -> None:
    cell = np.zeros((9, 9))
    cell[0, 4] = 2
    cell[4, :] = 1
    cell[4, 4] = 0
    cell[5:, 6] = 1
    cell[7, 6] = 0  # a side room, joined at one cell
    space = space_of(cell)
    flow = rg.field(rg.solve(rg.compile_space(space, boundary="neumann", drive="start", start=(8, 2))))
    path = rg.streamline(flow, cell=(8, 2))
    assert path.outcome is rg.Outcome.REACHED
    rg.certify(path)
    side = rg.streamline(flow, cell=(8, 8))
    assert side.outcome is rg.Outcome.NO_CURRENT
    rg.certify(side)


def test_an_altered_path_fails_the_certificate() -> None:
    space = room()
    flow = field(space)
    path = rg.streamline(flow, cell=(9, 7))
    rg.certify(path)

    def forged(**changes: object) -> rg.Streamline:
        values = {name: getattr(path, name) for name in path.__dataclass_fields__}
        return rg.Streamline(**{**values, **changes})

    cells = path.cells.copy()
    cells[2] = cells[1] + [1, 1]
    points = path.axis_points.copy()
    points[3] += 1e-3
    for broken in (
        {"cells": cells},
        {"axis_points": points},
        {"length": path.length * 1.001},
        {"goal": 1 - path.goal},
        {"cells": path.cells[:-1].copy(), "axis_points": path.axis_points[:-1].copy()},
        {"cells": path.cells[::-1].copy(), "axis_points": path.axis_points[::-1].copy()},
        {"outcome": rg.Outcome.NO_PATH},
        {"outcome": rg.Outcome.NO_CURRENT},
        {"outcome": rg.Outcome.START_BLOCKED},
    ):
        with pytest.raises(rg.CertificateError):
            rg.certify(forged(**broken))


def test_blends_of_incompatible_fields_raise_input_error() -> None:
    space = room()
    dirichlet, neumann = field(space), field(space, boundary="neumann")
    started = field(space, boundary="neumann", drive="start", start=(9, 7))
    with pytest.raises(rg.InputError, match="k = 2"):
        rg.blend(dirichlet, neumann, 2.0)
    with pytest.raises(rg.InputError, match="order"):
        rg.blend(neumann, dirichlet, 0.5)
    with pytest.raises(rg.InputError, match="start-driven"):
        rg.blend(dirichlet, started, 0.5)
    assert rg.blend(dirichlet, started, 0.5, allow_start_drive=True).boundary == "blend"
    with pytest.raises(rg.InputError, match="different spaces"):
        rg.blend(dirichlet, field(space_of(np.where(space.cell == 1, 0, space.cell)), boundary="neumann"), 0.5)
    costly = rg.ConfigurationSpace(space.axes, space.cell, np.where(space.cell == 1, 1.0, 2.0))
    with pytest.raises(rg.InputError, match="different spaces"):
        rg.blend(dirichlet, field(costly, boundary="neumann"), 0.5)
    with pytest.raises(rg.InputError, match="have edges"):
        rg.blend(dirichlet, field(space, boundary="neumann", edge="open"), 0.5)


def test_blended_currents_are_the_weighted_sum() -> None:
    space = room()
    dirichlet, neumann = field(space), field(space, boundary="neumann")
    mixed = rg.blend(dirichlet, neumann, 0.3)
    for axis in range(2):
        expected = 0.3 * dirichlet.face_current(axis) + 0.7 * neumann.face_current(axis)
        assert np.allclose(mixed.face_current(axis), expected, rtol=1e-9, atol=1e-15)
    free = space.goal_connected
    assert np.allclose(mixed.potential[free], 0.3 * dirichlet.potential[free] + 0.7 * neumann.potential[free])
    # Inside, currents are differences of the normalised potential.
    inner = free[:-1] & free[1:]
    drop = (neumann.potential[:-1] - neumann.potential[1:])[inner]
    scale = (space.spacing.min() / space.spacing[0]) ** 2
    assert np.allclose(neumann.face_current(0)[1:-1][inner], drop * scale, rtol=1e-9, atol=1e-14)


@pytest.mark.parametrize("spacing", [(1.0, 1.0), (1.0, 3.0), (4.0, 1.0), (0.5, 0.5)])
def test_dirichlet_share_equals_that_of_central_differences(spacing: tuple[float, float]) -> None:
    """Central differences of the two potentials, where all four neighbours have one."""
    cell = np.zeros((24, 20))
    cell[8:12, 4:14] = 1
    cell[20, 16] = 2
    space = space_of(cell, spacing=spacing, conductivity=np.full((24, 20), 3.0))
    dirichlet, neumann = field(space), field(space, boundary="neumann")
    share = dirichlet_fraction(dirichlet, neumann, 0.9)
    inner = np.zeros(cell.shape, dtype=bool)
    inner[1:-1, 1:-1] = (cell[1:-1, 1:-1] == 0) & (cell[:-2, 1:-1] != 1) & (cell[2:, 1:-1] != 1)
    inner[1:-1, 1:-1] &= (cell[1:-1, :-2] != 1) & (cell[1:-1, 2:] != 1)
    size = [np.hypot(*np.gradient(f.potential, *spacing)) for f in (dirichlet, neumann)]
    expected = 0.9 * size[0] / (0.9 * size[0] + 0.1 * size[1])
    np.testing.assert_allclose(share[inner], expected[inner], rtol=1e-7, atol=1e-9)
    with pytest.raises(rg.InputError, match="in this order"):
        dirichlet_fraction(neumann, dirichlet, 0.9)


@pytest.mark.parametrize("rails", ["merged", "cells"])
@pytest.mark.parametrize(
    "cell", [[2, 0, 2, 1, 0, 1], [[2, 0, 2, 1], [2, 2, 2, 1], [1, 1, 1, 1]]], ids=["line", "plane"]
)
def test_cells_without_contact_to_two_rails_raise_circuit_error(cell: list[object], rails: str) -> None:
    """Adjacent goals and obstacles are rails: currents flow between their sources, but through no free cell."""
    with pytest.raises(rg.CircuitError, match="nothing is driven"):
        rg.field(rg.solve(rg.compile_space(space_of(cell), edge="open", rails=rails)))


def test_a_start_on_a_wall_follows_the_wall() -> None:
    """At the wall the velocity along it is 1e4 times smaller than the one away from it, which is zero on the wall."""
    space = space_of([[0, 0], [2, 2]], spacing=(1.0, 100.0), conductivity=[[1.0, 2.0], [1.0, 1.0]])
    flow = field(space, boundary="neumann")
    path = rg.streamline(flow, (0.0, 50.0))
    np.testing.assert_allclose(path.points, [(0, 50), (0, 100), (1, 100)])
    rg.certify(path)
