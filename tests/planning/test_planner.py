"""The planner, compared with its stages: compile, solve, blend, streamline; clearance as a function of k.

Tests internals: `resgrid.planning`.
"""

import pickle
from pathlib import Path

import numpy as np
import pytest
from support.spaces import space_of
from support.verdicts import check_verdicts

import resgrid as rg
from resgrid.planning import pipeline


def two_goal_room() -> rg.ConfigurationSpace:
    cell = np.zeros((40, 30), dtype=np.uint8)
    cell[12:14, :20], cell[26:28, 10:], cell[18:22, 12:15] = 1, 1, 1
    cell[3, 4], cell[36, 25] = 2, 2
    return space_of(cell, spacing=(0.5, 0.5))


def test_a_planner_agrees_with_its_stages() -> None:
    space = two_goal_room()
    first = rg.field(rg.solve(rg.compile_space(space)))
    second = rg.field(rg.solve(rg.compile_space(space, boundary="neumann")))
    planner = rg.plan(space, k=0.5)
    assert planner.k == 0.5 and planner.space is space
    for k in (0.0, 0.3, 1.0):
        expected = rg.streamline(rg.blend(first, second, k), (8.0, 7.0))
        found = planner.at(k).path((8.0, 7.0))
        np.testing.assert_array_equal(found.points, expected.points)
    starts = [(1.0, 14.0), (8.0, 7.0), (19.0, 1.0), (6.5, 1.0)]
    paths, ends = planner.paths(starts), planner.ends(starts)
    assert [path.outcome for path in paths] == ends.outcome.tolist()
    assert [path.outcome for path in paths] == [rg.Outcome.REACHED] * 3 + [rg.Outcome.START_BLOCKED]
    assert rg.basins(planner.field)[3, 5] == 0 and rg.basins(planner.field)[36, 24] == 1
    for path in paths:
        rg.certify(path)
    assert planner.path(cell=(0, 0)).outcome is rg.Outcome.REACHED
    assert rg.find_blocking_obstacles(planner.space, cell=(0, 0)).separating == ()


def test_all_blends_of_a_planner_need_two_solves(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []
    solve = pipeline.SolveOptions.solve

    def counted(work: pipeline.SolveOptions, netlist: rg.Netlist, stage: str) -> rg.OperatingPoint:
        calls.append(netlist.cells.wiring.boundary)
        return solve(work, netlist, stage)

    monkeypatch.setattr(pipeline.SolveOptions, "solve", counted)
    planner = rg.plan(two_goal_room(), k=1.0)
    planner.paths([(1.0, 14.0), (8.0, 7.0)])
    rg.planning.clearance_curve(planner, (0.0, 0.2, 1.0), [(1.0, 14.0)])
    assert calls == ["dirichlet", "neumann"]
    rg.plan(two_goal_room()).paths([(1.0, 14.0)] * 3)
    assert calls[2:] == ["dirichlet"]


def test_scene_values_replace_omitted_options(scenes: Path) -> None:
    scene = rg.read_scene(scenes / "rooms.toml")
    planner = rg.plan(scene)
    assert planner.k == scene.k[0] and len(planner.scene_starts) == len(scene.starts)
    assert planner.field.edge == scene.edge
    assert {path.outcome for path in planner.paths()} == {rg.Outcome.REACHED}
    walled = rg.plan(scene, boundary="wall", wall_resistance=1e5)
    assert walled.field.boundary == "wall" and len(walled.solution.pure) == 1


def test_mean_clearance_grows_with_k() -> None:
    """No step decreases by more than half a cell, and the ends of the curve differ clearly."""
    space = two_goal_room()
    curve = rg.planning.clearance_curve(rg.plan(space, k=1.0), (0.0, 0.01, 0.1, 0.5, 0.9, 0.99, 1.0))
    assert np.all(np.diff(curve.mean) > -0.25)
    assert curve.mean[-1] > curve.mean[0] + 0.1
    assert curve.counted.all() and len(curve.starts) == 200
    assert curve.clearance.shape == (7, 200) and curve.mean_length.min() > 1.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["problem_a", "problem_b"])
def test_mean_clearance_of_the_1992_arms_grows_with_k(name: str, scenes: Path) -> None:
    """Section 3.3 of the paper on its own problems: mean clearance must not fall by more than half a cell."""
    scene = rg.read_scene(scenes / f"{name}.toml")
    planner = rg.plan(scene, k=1.0)
    half = 0.5 * planner.space.spacing.min()
    curve = rg.planning.clearance_curve(planner)
    assert np.all(np.diff(curve.mean) > -half) and curve.mean[-1] > curve.mean[0] + half
    walls = rg.planning.clearance_curve(planner, starts=curve.starts, wall_resistances=(0.0, 1e4, 1e5, 1e6, np.inf))
    np.testing.assert_allclose(walls.mean[[0, -1]], curve.mean[[-1, 0]], rtol=1e-9)
    assert np.all(np.diff(walls.mean) < half)
    for k in (0.0, 0.5, 1.0):
        check_verdicts(planner.at(k).field)


def test_wall_resistance_0_and_infinity_equal_k_1_and_k_0() -> None:
    """The wall resistance interpolates between Dirichlet and Neumann conditions, as k does."""
    space = two_goal_room()
    starts = [(1.0, 14.0), (8.0, 7.0), (19.0, 1.0), (9.0, 12.0)]
    walls = rg.planning.clearance_curve(rg.plan(space), starts=starts, wall_resistances=(0.0, 1e4, 1e5, 1e6, np.inf))
    blends = rg.planning.clearance_curve(rg.plan(space, k=1.0), (1.0, 0.0), starts)
    np.testing.assert_allclose(walls.clearance[[0, -1]], blends.clearance, rtol=1e-9)
    np.testing.assert_allclose(walls.length[[0, -1]], blends.length, rtol=1e-9)
    assert np.all(np.diff(walls.mean) < 0.25)


def test_starts_without_a_path_are_not_counted() -> None:
    cell = np.zeros((9, 9))
    cell[4], cell[1, 1] = 1, 2
    space = space_of(cell)
    curve = rg.planning.clearance_curve(rg.plan(space, k=0.5), (0.0, 1.0), [(7.0, 1.0), (3.5, 7.5)])
    assert curve.counted.tolist() == [False, True] and np.isnan(curve.clearance[:, 0]).all()
    np.testing.assert_array_equal(curve.mean, curve.clearance[:, 1])
    with pytest.raises(rg.InputError, match="no start reaches a goal"):
        rg.planning.clearance_curve(rg.plan(space, k=0.5), (0.0, 1.0), [(7.0, 1.0)])


def test_invalid_arguments_raise_input_error() -> None:
    space = two_goal_room()
    with pytest.raises(rg.InputError, match=r"k = 1\.5"):
        rg.plan(space, k=1.5)
    with pytest.raises(rg.InputError, match="on the rail"):
        rg.plan(space, k=0.5, boundary="neumann")
    with pytest.raises(rg.InputError, match="boundary = 'soft'"):
        rg.plan(space, boundary="soft")
    with pytest.raises(rg.InputError, match=r"where = 'rooms\.toml' must be a ConfigurationSpace"):
        rg.plan("rooms.toml")
    planner = rg.plan(space)
    with pytest.raises(rg.InputError, match="one circuit was solved"):
        planner.at(0.5)
    with pytest.raises(rg.InputError, match="2 coordinates"):
        planner.paths([(1.0, 2.0, 3.0)])
    with pytest.raises(rg.InputError, match="must be numbers"):
        planner.ends([("a", "b")])
    with pytest.raises(rg.InputError, match="outside the grid"):
        planner.paths([(1.0, np.nan)])
    with pytest.raises(rg.InputError, match="out of range"):
        rg.planning.clearance_curve(planner, wall_resistances=[-1.0])
    with pytest.raises(rg.InputError, match="at least one"):
        rg.planning.clearance_curve(planner, wall_resistances=[])
    assert planner.paths([]) == [] and len(planner.ends([]).goal) == 0


def test_paths_share_one_field_in_memory_and_when_pickled() -> None:
    planner = rg.plan(two_goal_room())
    paths = planner.paths(planner.space.centre(np.argwhere(planner.space.goal_connected)[:300]))
    assert all(path.field is planner.field for path in paths)
    again = pickle.loads(pickle.dumps(paths))
    assert all(path.field is again[0].field for path in again)
    for path in again[::60]:
        rg.certify(path)
    numbers = sum(path.axis_points.nbytes + path.cells.nbytes for path in paths)
    fields = len(pickle.dumps(planner.field))
    assert len(pickle.dumps(paths)) < 1.2 * numbers + fields + 500 * len(paths)
    assert fields < 1.2 * len(pickle.dumps(planner.space)) + 40 * planner.space.cell.size + 2000
