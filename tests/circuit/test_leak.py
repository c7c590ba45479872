"""Leaks to the obstacle rail: exact solutions of the screened Poisson equation, mpmath, ngspice, and messages.

Tests internals: `resgrid.circuit.equations`, `resgrid.solvers`.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest
from numpy.typing import NDArray
from support.spaces import space_of

import resgrid as rg
from resgrid.circuit.equations import assemble
from resgrid.solvers.decay_estimate import estimate_decades
from resgrid.solvers.laplacian import conductance_statistics

FREE, OBSTACLE, GOAL = rg.Cell.FREE, rg.Cell.OBSTACLE, rg.Cell.GOAL
LEAKS = (1e-9, 0.03, 2.0, 1e5)


def log_drop_of(space: rg.ConfigurationSpace, **options: Any) -> NDArray[np.float64]:
    found = rg.field(rg.solve(rg.compile_space(space, **options))).log_drop
    assert found is not None
    return found


# Exact solutions on rectangles.  The first column holds goals (u = 1) and obstacles (u = 0).  Along y the drop is a sum
# of modes of the edge's rule, and each mode decays along x as sinh or cosh of ``rate (distance from the far edge)``.


def modes(rule: str, n: int) -> list[tuple[mpmath.mpf, list[mpmath.mpf]]]:
    """Return pairs of ``2 - 2 cos(angle)`` and an orthonormal mode (n,) along an axis with n cells."""
    pi, found = mpmath.pi, []
    for m in range(n):
        if rule == "obstacle":
            angle = pi * (m + 1) / (n + 1)
            shape = [mpmath.sin(angle * (j + 1)) for j in range(n)]
        elif rule == "open":
            angle = pi * m / n
            shape = [mpmath.cos(angle * (j + mpmath.mpf(1) / 2)) for j in range(n)]
        else:  # periodic: cosines, then sines
            angle = 2 * pi * ((m + 1) // 2) / n
            shape = [(mpmath.sin if m % 2 == 0 and m else mpmath.cos)(angle * j) for j in range(n)]
        norm = mpmath.sqrt(mpmath.fsum(value**2 for value in shape))
        found.append((2 - 2 * mpmath.cos(angle), [value / norm for value in shape]))
    return found


def exact_rectangle(
    goal: list[int], width: int, spacing: tuple[float, float], rules: tuple[str, str], leak: float, c: float
) -> NDArray[np.float64]:
    """Return log u (width, n) of the rectangle right of a column with ``u = goal``, by the closed form."""
    hx, hy = map(mpmath.mpf, spacing)
    n, total = len(goal), [[mpmath.mpf(0)] * len(goal) for _ in range(width)]
    for eigenvalue, mode in modes(rules[1], n):
        weight = mpmath.fsum(value for value, is_goal in zip(mode, goal, strict=True) if is_goal)
        rate = mpmath.acosh(1 + hx**2 / 2 * (eigenvalue / hy**2 + mpmath.mpf(leak) / mpmath.mpf(c)))
        fall: Callable[[mpmath.mpf], mpmath.mpf] = mpmath.sinh if rules[0] == "obstacle" else mpmath.cosh
        end = mpmath.mpf(width + 1) if rules[0] == "obstacle" else mpmath.mpf(2 * width + 1) / 2
        for i in range(width):
            ratio = fall(rate * (end - i - 1)) / fall(rate * end)
            for j in range(n):
                total[i][j] += weight * mode[j] * ratio
    return np.array([[float(mpmath.log(value)) for value in row] for row in total])


@pytest.mark.parametrize("leak", LEAKS)
@pytest.mark.parametrize(
    "rules", [("obstacle", "obstacle"), ("open", "obstacle"), ("obstacle", "open"), ("open", "periodic")]
)
def test_the_drop_on_a_rectangle_is_the_closed_form(rules: tuple[str, str], leak: float) -> None:
    goal, spacing, c = [1, 0, 1, 1, 0, 1, 0], (0.7, 1.3), 2.5
    cell = np.zeros((12, len(goal)), dtype=np.uint8)
    cell[0] = np.where(goal, GOAL, OBSTACLE)
    space = space_of(
        cell, spacing=spacing, periodic=(False, rules[1] == "periodic"), conductivity=np.full(cell.shape, c)
    )
    edge = tuple("open" if rule == "periodic" else rule for rule in rules)
    with mpmath.workdps(60):
        exact = exact_rectangle(goal, 11, spacing, rules, leak, c)
    for method in ("direct", "multigrid"):
        netlist = rg.compile_space(space, edge=edge, leak=leak, resistance=123.0, supply=-3.0, goal_voltage=0.5)
        op = rg.solve(netlist, method=method)
        found = rg.field(op)
        assert found.log_drop is not None
        np.testing.assert_allclose(found.log_drop[1:], exact, rtol=1e-12, atol=1e-12 if method == "direct" else 1e-8)
        np.testing.assert_allclose(
            1.0 - found.potential[1:], np.exp(exact), rtol=0, atol=1e-12 if method == "direct" else 1e-8
        )


@pytest.mark.parametrize("leak", LEAKS)
def test_open_obstacles_with_a_leak_have_the_closed_form_of_a_cosh(leak: float) -> None:
    cell = np.zeros((30, 5), dtype=np.uint8)
    cell[0] = GOAL
    cell[:, 3:] = OBSTACLE
    found = rg.field(rg.solve(rg.compile_space(space_of(cell), boundary="neumann", leak=leak)))
    assert found.log_drop is not None
    assert np.isnan(found.log_drop[cell == OBSTACLE]).all()
    with mpmath.workdps(40):
        rate = mpmath.acosh(1 + mpmath.mpf(leak) / 2)
        fall = [mpmath.log(mpmath.cosh(rate * (29.5 - i)) / mpmath.cosh(rate * 29.5)) for i in range(30)]
    np.testing.assert_allclose(found.log_drop[:, 0], [float(value) for value in fall], rtol=1e-12, atol=1e-12)
    height = np.array([-float(mpmath.expm1(value)) for value in fall])
    np.testing.assert_allclose(found.potential[:, 0], height, rtol=1e-10, atol=0)  # accurate near the goal, too


# Any space: a second assembly from the definitions, solved with 50 digits.


def by_mpmath(space: rg.ConfigurationSpace, wiring: rg.Wiring) -> NDArray[np.float64]:
    """Return log u of the goal-connected free cells, by LU factorization of the definitions; NaN elsewhere."""
    wiring = wiring.on(space)
    cells = [tuple(map(int, cell)) for cell in np.argwhere(space.goal_connected)]
    number = {cell: row for row, cell in enumerate(cells)}
    c = np.ones(space.shape) if space.conductivity is None else space.conductivity
    h = [mpmath.mpf(float(width)) for width in space.spacing]
    matrix, rhs = mpmath.zeros(len(cells)), mpmath.zeros(len(cells), 1)
    for cell, row in number.items():
        matrix[row, row] += mpmath.mpf(wiring.leak) * min(h) ** 2
        for axis, side in product(range(space.ndim), (-1, 1)):
            other = list(cell)
            other[axis] += side
            inside = 0 <= other[axis] < space.shape[axis] or space.periodic[axis]
            other[axis] %= space.shape[axis]
            there = tuple(other)
            code = space.cell[there] if inside else OBSTACLE
            if not inside and (wiring.edge[axis] == "open" or wiring.boundary == "neumann"):
                continue
            if code == OBSTACLE and wiring.boundary == "neumann":
                continue
            mine, its = mpmath.mpf(float(c[cell])), mpmath.mpf(float(c[there]))
            g = (min(h) / h[axis]) ** 2 * (2 * mine * its / (mine + its) if inside and code == FREE else mine)
            if code == OBSTACLE and wiring.wall_resistance:
                g = 1 / (1 / g + mpmath.mpf(wiring.wall_resistance) / mpmath.mpf(wiring.resistance))
            matrix[row, row] += g
            if code == FREE:
                matrix[row, number[there]] -= g
            elif code == GOAL:
                rhs[row] += g
    drop = mpmath.lu_solve(matrix, rhs)
    found = np.full(space.shape, np.nan)
    for cell, row in number.items():
        found[cell] = float(mpmath.log(drop[row]))
    return found


CIRCUITS: list[dict[str, Any]] = [
    {},
    {"boundary": "neumann"},
    {"boundary": "wall", "wall_resistance": 3e4},
    {"edge": "open"},
    {"rails": "cells"},
    {"boundary": "neumann", "rails": "cells"},
]


@pytest.mark.parametrize("leak", [1e-3, 1.0, 1e70])
@pytest.mark.parametrize("number", range(len(CIRCUITS)))
@pytest.mark.quick_cases(6)
def test_the_drop_is_componentwise_accurate_below_the_range_of_doubles(number: int, leak: float) -> None:
    rng = np.random.default_rng(number)
    shape = [(5, 5), (4, 3, 4), (8, 4)][number % 3]
    cell = (rng.random(shape) < 0.15).astype(np.uint8)
    cell[0, 0] = GOAL
    widths, rings = tuple(rng.uniform(0.5, 2.0, len(shape))), (False, *(number % 2 == 1,) * (len(shape) - 1))
    space = space_of(cell, spacing=widths, periodic=rings, conductivity=rng.lognormal(size=shape))
    wiring = rg.Wiring(leak=leak, **CIRCUITS[number])
    with mpmath.workdps(50 if leak < 1e10 else 900):
        exact = by_mpmath(space, wiring)
    found = log_drop_of(space, wiring=wiring)
    own = space.goal_connected
    np.testing.assert_allclose(found[own], exact[own], rtol=1e-12, atol=1e-12)
    if leak == 1e70:
        assert found[own].min() < np.log(1e-300)


def test_methods_and_threads_agree_with_leaks_on_larger_grids() -> None:
    rng = np.random.default_rng(5)
    for shape in ((90, 80), (13, 14, 15)):
        cell = (rng.random(shape) < 0.1).astype(np.uint8)
        cell[tuple(size // 2 for size in shape)] = GOAL
        space = space_of(cell, conductivity=rng.lognormal(0.0, 0.5, shape))
        for boundary, leak in product(("dirichlet", "neumann"), (1e-4, 0.1, 30.0)):
            netlist = rg.compile_space(space, boundary=boundary, leak=leak)
            one, other = (rg.field(rg.solve(netlist, method=method)) for method in ("direct", "multigrid"))
            assert one.log_drop is not None
            assert other.log_drop is not None
            own = space.goal_connected
            np.testing.assert_allclose(one.log_drop[own], other.log_drop[own], rtol=0, atol=2e-8)


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
def test_the_estimate_that_chooses_the_method_contains_the_leak(boundary: str) -> None:
    cell = np.zeros((50, 50), dtype=np.uint8)
    cell[0, 0] = GOAL
    for leak in (0.1, 1.0, 30.0):
        netlist = rg.compile_space(space_of(cell), boundary=boundary, leak=leak)
        laplacian = assemble(netlist).laplacian.with_rows()
        found = rg.field(rg.solve(netlist)).log_drop
        assert found is not None
        fall = -np.sort(found.ravel())[50] / np.log(10.0)  # one node in 50 is left out
        assert 0.7 < estimate_decades(laplacian, conductance_statistics(laplacian)) / fall < 1.3


def test_a_leak_of_zero_changes_nothing() -> None:
    space = rg.build_space(rg.read_scene("examples/scenes/lesson.toml"))
    for options in ({}, {"boundary": "neumann"}, {"rails": "cells"}):
        one, other = rg.compile_space(space, **options), rg.compile_space(space, leak=0.0, **options)
        for name in ("resistor_nodes", "conductance", "source_nodes", "source_volts", "current_nodes", "current_amps"):
            assert np.array_equal(getattr(one, name), getattr(other, name))
        assert (one.cells.leak_cell == -1).all()


@pytest.mark.parametrize("options", CIRCUITS)
def test_the_leaks_are_the_last_resistors_one_for_each_free_node(options: dict[str, Any]) -> None:
    space = rg.build_space(rg.read_scene("examples/scenes/rooms.toml"))
    plain = rg.compile_space(space, **options)
    netlist = rg.compile_space(space, leak=0.25, **options)
    cells, count = netlist.cells, len(netlist.cells.free_node)
    extra = slice(len(netlist.conductance) - count, None)
    assert len(netlist.conductance) == len(plain.conductance) + count
    assert np.array_equal(netlist.conductance[: extra.start], plain.conductance)
    assert np.array_equal(netlist.resistor_nodes[extra, 0], cells.free_node)
    assert (netlist.resistor_nodes[extra, 1] == cells.obstacle_node).all()
    h = float(space.spacing.min())
    np.testing.assert_allclose(netlist.conductance[extra], 0.25 * h**2 / cells.wiring.resistance, rtol=1e-15)
    assert np.array_equal(cells.node.ravel()[cells.leak_cell[extra]], cells.free_node)
    assert (cells.leak_cell[: extra.start] == -1).all()
    assert netlist.node_name(cells.obstacle_node) == "obstacle"


def test_a_leak_drives_a_grid_that_no_obstacle_touches() -> None:
    cell = np.zeros((6, 6), dtype=np.uint8)
    cell[0, 0] = GOAL
    space = space_of(cell)
    with pytest.raises(rg.CircuitError, match="nothing is driven"):
        rg.compile_space(space, edge="open") and rg.solve(rg.compile_space(space, edge="open"))
    planner = rg.plan(space, edge="open", leak=1e-3)
    path = planner.path((5.5, 5.5))
    assert path.outcome is rg.Outcome.REACHED
    rg.certify(path)


def test_components_without_a_goal_have_no_drop() -> None:
    cell = np.array([[2, 0, 0, 1, 0, 0]], dtype=np.uint8)
    found = log_drop_of(space_of(cell), leak=0.1, edge="open")
    assert np.isneginf(found[0, 3:]).all()
    opened = log_drop_of(space_of(cell), leak=0.1, boundary="neumann")
    assert np.isnan(opened[0, 3:]).all()


def test_messages_name_the_contradiction_and_a_remedy() -> None:
    with pytest.raises(rg.InputError, match="must be finite and not negative"):
        rg.Wiring(leak=-1.0)
    with pytest.raises(rg.InputError, match="must be a finite number"):
        rg.Wiring(leak=float("nan"))
    with pytest.raises(rg.InputError, match="leave out drive and start, or set leak = 0"):
        rg.Wiring("neumann", drive="uniform", leak=1.0)
    with pytest.raises(rg.InputError, match="leave out drive and start, or set leak = 0"):
        rg.Wiring("neumann", drive="start", start=(0, 0), leak=1.0)
    with pytest.raises(rg.InputError, match="choose another leak"):
        rg.compile_space(space_of([2, 0, 0]), leak=5e-324)
    with pytest.raises(rg.InputError, match="leak = 1e\\+300 with cells 1 wide"):
        rg.compile_space(space_of([2, 0, 0]), leak=1e300, resistance=1e-200)


def test_options_turn_a_leak_on_and_off() -> None:
    wiring = rg.Wiring("neumann")
    assert wiring.drive == "uniform"
    leaking = rg.circuit.WarmStart(wiring, leak=2.0).wiring
    assert (leaking.drive, leaking.leak, leaking.is_driven, leaking.is_open) == (None, 2.0, False, True)
    assert rg.circuit.WarmStart(leaking, leak=0.0).wiring.drive == "uniform"
    assert rg.Wiring(leak=2.0).opened().drive is None


@pytest.mark.slow
def test_ngspice_agrees_on_decks_with_leaks(tmp_path: Path) -> None:
    space = rg.build_space(rg.read_scene("examples/scenes/lesson.toml"))
    for number, (options, leak) in enumerate(product(CIRCUITS, (0.02, 5.0))):
        op = rg.solve(rg.compile_space(space, leak=leak, **options))
        file = tmp_path / f"leak_{number}.cir"
        rg.write_spice(op, file)
        check = rg.check_deck(file)
        assert check.agrees
        assert check.verified
        read = rg.solve(rg.read_spice(file))
        assert abs(read.power - op.power) <= 1e-12 * abs(op.power)
