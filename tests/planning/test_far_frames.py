"""Maps far from the world's origin, where rounding errors are those of world coordinates: paths must certify again."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import ArrayLike

import resgrid as rg


def space_in_frame(frame: rg.Frame, cell: ArrayLike, width: float = 0.05) -> rg.ConfigurationSpace:
    """Space of cells in a frame; a third dimension of `cell` is the heading."""
    code = np.array(cell, dtype=np.uint8)
    turns = [(0.0, float(code.shape[2]) * width)] if code.ndim == 3 else []
    ends = [(0.0, code.shape[0] * width), (0.0, code.shape[1] * width), *turns]
    axes = [
        rg.Axis(name, *end, cells, periodic=name == "heading")
        for name, end, cells in zip(("x", "y", "heading"), ends, code.shape, strict=False)
    ]
    return rg.ConfigurationSpace(axes, code, frame=frame)


def check_round_trips(space: rg.ConfigurationSpace, path: rg.Streamline) -> None:
    rg.certify(path)
    narrow = 0.2 * float(space.spacing.min())
    for each in (path, rg.shortcut(path, rounds=40), rg.shortcut(path, clearance=narrow, rounds=40)):
        rg.certify_collision_free(each)
        rg.certify_collision_free(rg.Polyline(rg.planning.unwrap(each), space))


frames = st.builds(
    rg.Frame,
    x=st.floats(-1e7, 1e7),
    y=st.floats(-1e7, 1e7),
    yaw=st.sampled_from([0.0, 0.3, np.pi / 4, np.pi / 2]) | st.floats(-4, 4),
)


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(frames, st.integers(0, 2**32 - 1), st.sampled_from(["dirichlet", "neumann"]))
def test_starts_on_cell_borders_have_paths_that_certify_again(frame, seed, boundary) -> None:
    rng = np.random.default_rng(seed)
    cell = (rng.random((9, 7)) < 0.2).astype(np.uint8)
    cell[rng.integers(9), rng.integers(7)] = rg.Cell.GOAL
    space = space_in_frame(frame, cell)
    planner = rg.plan(space, boundary=boundary)
    for _ in range(6):
        number, local = rng.integers(0, space.shape), rng.choice([0.0, 1.0, 0.3], 2)
        touching = {
            tuple(np.clip(number + step, 0, np.array(space.shape) - 1).tolist())
            for step in (
                (dx, dy) for dx in _steps_to_touching_cells(local[0]) for dy in _steps_to_touching_cells(local[1])
            )
        }
        path = planner.path(space.to_world(space.lower + (number + local) * space.spacing))
        blocked = all(cell[each] == rg.Cell.OBSTACLE for each in touching)
        assert (path.outcome is rg.Outcome.START_BLOCKED) == blocked
        if path.outcome is rg.Outcome.REACHED:
            check_round_trips(space, path)


def _steps_to_touching_cells(local: float) -> tuple[int, ...]:
    """Steps to the cells along an axis that contain a local position of a cell."""
    return {0.0: (-1, 0), 1.0: (0, 1)}.get(local, (0,))


def test_paths_of_a_turning_robot_far_from_the_origin_certify_again() -> None:
    cell = np.zeros((6, 5, 8), dtype=np.uint8)
    cell[2:4, 1:4, :6], cell[5, 4, 2] = rg.Cell.OBSTACLE, rg.Cell.GOAL
    space = space_in_frame(rg.Frame(5e5, 5.4e6, 2.0, turning_length=0.4), cell)
    planner = rg.plan(space, boundary="neumann")
    for corner in ((0.0, 0.0, 0.0), (0.0, 0.25, 0.1), (0.15, 0.05, 0.4)):
        check_round_trips(space, planner.path(space.to_world(corner)))


def test_a_controller_commands_motion_at_cell_borders() -> None:
    cell = np.zeros((8, 6), dtype=np.uint8)
    cell[7, 5] = rg.Cell.GOAL
    space = space_in_frame(rg.Frame(5e5, 5.4e6, 0.3), cell)
    controller = rg.control.make_controller(rg.plan(space, boundary="neumann").field)
    for x in np.linspace(0.0, 0.35, 40):
        assert np.linalg.norm(controller.command(space.to_world((x, 0.3)))) > 0
        assert np.linalg.norm(controller.command(space.to_world((x, 0.0)))) > 0


def test_a_start_and_a_goal_on_cell_borders_have_a_path() -> None:
    frame = rg.Frame(5e5, 5.4e6, 0.3)
    space = space_in_frame(frame, [[0, 0], [0, 2]])
    for x in np.linspace(0.0, 0.1, 25):
        start, goal = (tuple(space.to_world(place).tolist()) for place in ((x, 0.1), (0.1, x)))
        assert space.locate(start)[1] == 1
        scene = rg.Scene(space.axes, goals=(rg.GoalPoint(goal),), starts=(start,), frame=frame)
        assert rg.plan(scene, boundary="neumann").paths()[0].outcome is rg.Outcome.REACHED


def test_cells_below_the_rounding_error_raise_input_error() -> None:
    with pytest.raises(rg.InputError, match="so far from the world's origin"):
        space_in_frame(rg.Frame(1e15, 0.0, 0.1), [[0, 2]])
    np.testing.assert_array_equal(space_in_frame(rg.Frame(yaw=0.3), [[0, 2]]).rounding, 1e-9)
    assert 1e-8 < space_in_frame(rg.Frame(5e5, 5.4e6, 0.3), [[0, 2]]).rounding.max() < 1e-6
