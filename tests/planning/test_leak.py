"""Fields, streamlines, certificates, updates and random walks of circuits with leaks.

Tests internals: `resgrid.planning`.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from support.spaces import serpentine, space_of

import resgrid as rg
from resgrid.planning.changed_fields import KeptCircuit

FREE, OBSTACLE, GOAL = rg.Cell.FREE, rg.Cell.OBSTACLE, rg.Cell.GOAL
LEAKS = (1e-6, 1e-2, 1.0, 1e4)
CIRCUITS: list[dict[str, Any]] = [
    {},
    {"boundary": "neumann"},
    {"boundary": "wall", "wall_resistance": 1e5},
    {"edge": "open"},
    {"k": 0.5},
    {"k": 0.0},
]


def scattered(shape: tuple[int, ...], seed: int, density: float = 0.2) -> rg.ConfigurationSpace:
    rng = np.random.default_rng(seed)
    cell = (rng.random(shape) < density).astype(np.uint8)
    for _ in range(2):
        cell[tuple(rng.integers(0, size) for size in shape)] = GOAL
    return space_of(cell, spacing=tuple(rng.uniform(1.0, 2.0, len(shape))), conductivity=rng.lognormal(size=shape))


@pytest.mark.parametrize("number", range(len(CIRCUITS)))
@pytest.mark.quick_cases(2)
def test_every_start_reaches_a_goal_and_is_certified(number: int) -> None:
    for leak, (seed, shape) in product(LEAKS, enumerate([(30, 25), (9, 8, 7)])):
        space = scattered(shape, seed + 7 * number)
        planner = rg.plan(space, leak=leak, **CIRCUITS[number])
        cells = np.argwhere(space.goal_connected)
        for cell in cells[:: max(1, len(cells) // 25)]:
            path = rg.streamline(planner.field, cell=cell.tolist())
            assert path.outcome is rg.Outcome.REACHED
            rg.certify(path)


@pytest.mark.parametrize("leak", LEAKS)
def test_a_long_corridor_keeps_its_directions_where_the_drop_underflows(leak: float) -> None:
    space = space_of(serpentine(12, 40, 2))
    for boundary in ("dirichlet", "neumann"):
        planner = rg.plan(space, boundary=boundary, leak=leak)
        assert planner.field.log_drop is not None
        path = rg.streamline(planner.field, cell=np.argwhere(space.goal_connected)[-1].tolist())
        assert path.outcome is rg.Outcome.REACHED
        rg.certify(path)
    assert leak < 1e4 or planner.field.log_drop[space.goal_connected].min() < -745.0


def test_the_drop_approaches_the_distance_to_the_goal_for_large_leaks() -> None:
    """Varadhan's formula on the grid: ``-log u`` divided by its rate per cell is the number of steps to the goal."""
    space = space_of(serpentine(5, 12, 1))
    field = rg.plan(space, boundary="neumann", leak=1e12).field
    steps = np.full(space.shape, -1)
    steps[space.cell == GOAL] = 0
    for count in range(1, 200):
        near = [np.roll(steps, shift, axis) == count - 1 for axis in (0, 1) for shift in (-1, 1)]
        steps[np.any(near, axis=0) & (steps < 0) & (space.cell == FREE)] = count
    assert field.log_drop is not None
    rate = np.arccosh(1.0 + 0.5e12)
    np.testing.assert_allclose(-field.log_drop[space.goal_connected] / rate, steps[space.goal_connected], rtol=1e-9)


# Updates of a map.


@pytest.mark.parametrize("number", range(len(CIRCUITS)))
def test_updates_give_the_fields_of_a_fresh_plan(number: int) -> None:
    rng, cell = np.random.default_rng(number), np.zeros((26, 31), dtype=np.uint8)
    cell[:, 15], cell[4, 15], cell[20:22, 25] = OBSTACLE, FREE, GOAL
    options = {"leak": (0.01, 1.0)[number % 2], **CIRCUITS[number]}
    planner = rg.plan(space_of(cell), **options)
    for _ in range(4):
        cell[tuple(rng.integers(0, 13, (2, 8)))] ^= np.uint8(OBSTACLE)
        space = space_of(cell)
        planner, fresh = planner.update(space), rg.plan(space, **options)
        assert planner.replanning is not None
        assert planner.replanning.method == "elimination"
        for one, other in zip(planner.solution.pure.values(), fresh.solution.pure.values(), strict=True):
            np.testing.assert_allclose(one.potential, other.potential, rtol=0, atol=1e-12)
            assert (one.log_drop is None) == (other.log_drop is None)
            if one.log_drop is not None and other.log_drop is not None:
                np.testing.assert_allclose(one.log_drop, other.log_drop, rtol=1e-9, atol=1e-9)
            for axis in range(2):
                np.testing.assert_allclose(one.face_current(axis), other.face_current(axis), rtol=0, atol=1e-11)
        for start in np.argwhere(space.goal_connected)[::80]:
            rg.certify(rg.streamline(planner.field, cell=start.tolist()))


def test_the_check_of_an_update_contains_the_leak(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the wrong leak in the equations, the check of Kirchhoff's current law fails."""
    from resgrid.planning import changed_fields

    space = scattered((20, 20), 3)
    wiring = rg.Wiring(leak=0.3)
    solve = KeptCircuit._between
    monkeypatch.setattr(KeptCircuit, "_between", lambda self, own, low, high: solve(self, own, 1.001 * low, high))
    with pytest.raises(changed_fields.NotSolvedError, match="KCL is violated"):
        KeptCircuit(space.shape).field(space, wiring)


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
def test_warm_starts_include_the_leak(boundary: str) -> None:
    rng, cell = np.random.default_rng(1), np.zeros((70, 60), dtype=np.uint8)
    cell[40, 30] = GOAL
    warm = rg.circuit.WarmStart(boundary=boundary, leak=0.02, supply=2.0, goal_voltage=1.0, rtol=1e-12)
    fresh = []
    for _ in range(4):
        cell[tuple(rng.integers(10, 18, (2, 5)))] ^= np.uint8(OBSTACLE)
        space = space_of(cell)
        point = warm.solve(space)
        fresh.append(point.fresh)
        op = rg.solve(rg.compile_space(space, boundary=boundary, leak=0.02, supply=2.0, goal_voltage=1.0))
        own = space.goal_connected
        np.testing.assert_allclose(point.voltage[own], op.voltage[op.netlist.cells.node[own]], rtol=0, atol=1e-8)
        field = rg.field(point)
        assert field.safe is not None
        assert field.safe[38:43, 27:34].sum() > 30
        rg.certify(rg.streamline(field, cell=(38, 28)))
    assert fresh == [True, False, False, False]


@pytest.mark.parametrize(
    ("boundary", "leak"),
    [
        pytest.param("dirichlet", 1e-3, marks=pytest.mark.slow),
        pytest.param("dirichlet", 0.2, marks=pytest.mark.slow),
        pytest.param("neumann", 1e-3, marks=pytest.mark.slow),
        ("neumann", 0.2),
    ],
)
def test_petsc_includes_the_leak(boundary: str, leak: float) -> None:
    from resgrid.solvers import petsc

    try:
        petsc.find_petsc()
    except rg.ToolMissingError as error:
        pytest.skip(f"{error}")
    space = scattered((30, 24), 2)
    ours = rg.plan(space, boundary=boundary, leak=leak).field
    theirs = rg.plan(space, boundary=boundary, leak=leak, method="petsc", ranks=1).field
    np.testing.assert_allclose(theirs.potential, ours.potential, rtol=0, atol=1e-10)
    assert theirs.safe is not None
    assert ours.log_drop is not None
    assert theirs.safe[space.goal_connected & (ours.log_drop > -10.0)].all()
    for cell in np.argwhere(theirs.safe)[::40]:
        rg.certify(rg.streamline(theirs, cell=cell.tolist()))


# Random walks that a leak kills.


def simulated(cell: NDArray[np.uint8], kill: float, start: tuple[int, int], walks: int, seed: int) -> float:
    """Return the fraction of walks that hit a goal; `kill`: rate of the end, 1 is that of a face."""
    rng = np.random.default_rng(seed)
    padded = np.pad(cell, 1, constant_values=OBSTACLE)
    at, alive, hits = np.tile(np.array(start) + 1, (walks, 1)), np.ones(walks, dtype=bool), 0
    steps = np.array([[1, 0], [-1, 0], [0, 1], [0, -1], [0, 0]])
    chances = np.array([1.0, 1.0, 1.0, 1.0, kill]) / (4.0 + kill)
    while alive.any():
        which = np.flatnonzero(alive)
        jump = rng.choice(5, len(which), p=chances)
        at[which] += steps[jump]
        code = padded[tuple(at[which].T)]
        hits += int(np.count_nonzero((code == GOAL) & (jump < 4)))
        alive[which] = (code == FREE) & (jump < 4)
    return hits / walks


@pytest.mark.parametrize("leak", [0.01, 0.2])
def test_a_simulated_walk_that_the_leak_kills_reaches_the_goal_with_the_probability_of_the_drop(leak: float) -> None:
    cell = np.zeros((8, 7), dtype=np.uint8)
    cell[2:5, 3], cell[6, 5] = OBSTACLE, GOAL
    walks, start = 20_000, (5, 2)
    netlist = rg.compile_space(space_of(cell), leak=leak)
    u = float(rg.planning.collision_probability(netlist).success[start])
    drop = rg.field(rg.solve(netlist)).log_drop
    assert drop is not None
    assert abs(np.exp(drop[start]) - u) < 1e-9
    assert abs(simulated(cell, leak, start, walks, 11) - u) < 4.5 * np.sqrt(u * (1.0 - u) / walks)


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
def test_the_drop_is_the_laplace_transform_of_the_time_to_the_goal(boundary: str) -> None:
    """``-d log u / d (leak D)`` without a leak is the expected time of the walks that hit a goal."""
    space = scattered((12, 11), 4)
    before = rg.planning.collision_probability(rg.compile_space(space, boundary=boundary))
    h = float(space.spacing.min())
    leak = 1e-7
    after = rg.planning.collision_probability(rg.compile_space(space, boundary=boundary, leak=leak))
    own = space.goal_connected
    slope = (before.log_success[own] - after.log_success[own]) / (leak * h**2)
    np.testing.assert_allclose(slope, before.time_given_success[own], rtol=1e-4)
    assert np.all(after.steps[own] < before.steps[own])


def test_hitting_probabilities_of_several_goals_add_up_to_the_drop() -> None:
    space = scattered((14, 10), 6)
    for boundary in ("dirichlet", "neumann"):
        walk = rg.planning.random_walk(rg.compile_space(space, boundary=boundary, leak=0.05))
        hits, whole = rg.planning.hitting_probability(walk), rg.planning.collision_probability(walk)
        own = space.goal_connected
        np.testing.assert_allclose(hits.probability.sum(axis=0)[own], whole.success[own], rtol=1e-10)
        assert whole.success[own].max() < 1.0


@pytest.mark.parametrize("leak", LEAKS)
@pytest.mark.parametrize("periodic", [False, True])
def test_a_leak_ends_walks_that_no_goal_can_end(leak: float, periodic: bool) -> None:
    """Times and numbers of jumps in cut-off cells equal the dense solution; the time is ``1 / (leak h_ref**2)``."""
    rng = np.random.default_rng(3)
    cell = np.zeros((5, 7), dtype=np.uint8)
    cell[:, 2], cell[:, 6], cell[2, 4], cell[0, 0] = OBSTACLE, OBSTACLE, OBSTACLE, GOAL
    axes = [rg.Axis("x", 0.0, 6.0, 5, periodic=periodic), rg.Axis("y", 0.0, 7.0, 7)]
    space = rg.ConfigurationSpace(axes, cell, rng.lognormal(size=cell.shape))
    assert space.conductivity is not None
    found = rg.planning.collision_probability(rg.compile_space(space, boundary="neumann", leak=leak))
    cut_off = (cell == FREE) & ~space.goal_connected
    place = {tuple(each): row for row, each in enumerate(np.argwhere(cut_off).tolist())}
    matrix, h = leak * np.eye(len(place)), space.spacing
    for (i, j), row in place.items():
        for axis, other in ((0, ((i + 1) % 5, j)), (1, (i, j + 1))):
            if other in place and (periodic or other[0] >= i):
                a, b, near = space.conductivity[i, j], space.conductivity[other], place[other]
                weight = 2 * a * b / (a + b) / h[axis] ** 2
                matrix[[row, near], [near, row]] -= weight
                matrix[[row, near], [row, near]] += weight
    ones = np.ones(len(place))
    np.testing.assert_allclose(found.time[cut_off], np.linalg.solve(matrix, ones) / h.min() ** 2, rtol=1e-6)
    np.testing.assert_allclose(found.time[cut_off], 1.0 / (leak * h.min() ** 2), rtol=1e-12)
    np.testing.assert_allclose(found.steps[cut_off], np.linalg.solve(matrix, np.diag(matrix)), rtol=1e-6)
    assert np.all(found.success[cut_off] == 0.0) and np.all(np.isnan(found.time_given_success[cut_off]))


def test_blends_need_fields_with_the_same_leak() -> None:
    space = scattered((8, 8), 0)
    one = rg.field(rg.solve(rg.compile_space(space, leak=0.1)))
    other = rg.field(rg.solve(rg.compile_space(space, boundary="neumann", leak=0.2)))
    with pytest.raises(rg.InputError, match="compile both with the same leak"):
        rg.blend(one, other, 0.5)
