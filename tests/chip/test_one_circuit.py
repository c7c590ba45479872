"""Flat netlists and chips built by effects, against dense solutions of the circuit that the documentation defines."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.spaces import space_of

import resgrid as rg

R, WALL, VOLTS = 1e3, 3e3, 2.0
SWITCHES = {
    "obstacle_switch_on": 20.0,
    "obstacle_switch_off": 1e7,
    "goal_switch_on": 30.0,
    "goal_switch_off": 2e7,
    "internodal_switch_on": 50.0,
    "internodal_switch_off": 4e7,
}
WIRINGS = ["dirichlet", "wall", "uniform", "start"]

Scene = tuple[rg.ConfigurationSpace, dict[str, Any]]


def random_scene(number: int, wiring: str) -> Scene:
    """Return a small random grid with several goals, and its options of compile_space."""
    rng = np.random.default_rng((number, WIRINGS.index(wiring)))
    shape = tuple(rng.integers(1, (9, 5, 4)[ndim] + 1) for ndim in [rng.integers(0, 3)] for _ in range(ndim + 1))
    cell = rng.choice(3, shape, p=(0.55, 0.25, 0.2)).astype(np.uint8)
    cell.flat[rng.integers(cell.size)] = 2
    periodic = tuple(bool(ring) for ring in rng.random(cell.ndim) < 0.3)
    space = space_of(
        cell,
        periodic=periodic,
        spacing=tuple(rng.choice([0.5, 1.0, 3.0], cell.ndim)),
        conductivity=10.0 ** rng.uniform(-1, 1, shape) if rng.random() < 0.5 else None,
    )
    options: dict[str, Any] = {"edge": ["obstacle" if closed else "open" for closed in rng.random(cell.ndim) < 0.6]}
    options["boundary"] = wiring if wiring in ("dirichlet", "wall") else "neumann"
    if options["boundary"] == "neumann":
        options["drive"] = wiring
    served = np.argwhere(space.goal_connected)
    if wiring == "start":
        options["start"] = tuple(served[rng.integers(len(served))].tolist()) if len(served) else (0,) * cell.ndim
    return space, options


def contacts(space: rg.ConfigurationSpace, options: dict[str, Any]) -> Iterator[tuple[Any, Any, float, bool]]:
    """Yield two neighbours (None beyond the edge), the ohms between them, and whether one is insulating."""
    width, shape, wall = space.spacing, space.shape, WALL if options["boundary"] == "wall" else 0.0
    neumann = options["boundary"] == "neumann"
    for here in product(*map(range, shape)):
        for axis, size in enumerate(shape):
            ring = space.axes[axis].periodic
            for step in (1, -1):
                there: Any = tuple((i + step) % size if ring and a == axis else i + step * (a == axis)
                                   for a, i in enumerate(here))  # fmt: skip
                inside = 0 <= there[axis] < size
                if (inside and step < 0) or (ring and size == 1):
                    continue
                if not inside and (neumann or options["edge"][axis] == "open"):
                    continue
                there = there if inside else None
                pair = [here] if there is None else [here, there]
                codes = [int(space.cell[one]) for one in pair] + [1] * (there is None)
                counted = [one for one in pair if space.cell[one] == 0] if codes.count(0) == 1 else pair
                c = np.ones(shape) if space.conductivity is None else space.conductivity
                ohms = R * (width[axis] / width.min()) ** 2 * float(np.mean([1 / c[one] for one in counted]))
                walled = (codes[0] == 1) != (codes[1] == 1)
                yield here, there, ohms + wall * walled, neumann and any(is_insulating(space, one) for one in pair)


def is_insulating(space: rg.ConfigurationSpace, cell: Any) -> bool:
    """Return whether a Neumann boundary insulates the cell: an obstacle, or a free cell without a path to a goal."""
    return bool(space.cell[cell] == 1 or (space.cell[cell] == 0 and not space.goal_connected[cell]))


def dense_reference(
    space: rg.ConfigurationSpace, options: dict[str, Any], switches: dict[str, float]
) -> tuple[Any, float]:
    """Return the voltage of every cell (NaN without a node) and the power; no switches means an ideal chip."""
    cells = {cell: number for number, cell in enumerate(product(*map(range, space.shape)))}
    high, low = len(cells), len(cells) + 1
    neumann, driven = options["boundary"] == "neumann", options.get("drive") == "uniform"
    elements = []
    for here, there, ohms, opened in contacts(space, options):
        if opened and not switches:
            continue
        extra = switches.get(f"internodal_switch_{'off' if opened else 'on'}", 0.0) if there is not None else 0.0
        elements.append((cells[here], high if there is None else cells[there], ohms + extra))
    volts = {high: 0.0 if driven else VOLTS, low: 0.0}
    for cell, number in cells.items():
        tied = cell == options.get("start") if neumann else space.cell[cell] == 1
        for rail, name, closed in ((high, "obstacle", tied), (low, "goal", space.cell[cell] == 2)):
            if switches:
                elements.append((number, rail, switches[f"{name}_switch_{'on' if closed else 'off'}"]))
            elif closed:
                volts[number] = volts[rail]
    injected = [
        number for cell, number in cells.items() if driven and space.cell[cell] == 0 and not is_insulating(space, cell)
    ]
    count = len(cells) + 2
    matrix, current = np.zeros((count, count)), np.zeros(count)
    for a, b, ohms in elements:
        matrix[[a, b, a, b], [a, b, b, a]] += np.array([1, 1, -1, -1]) / ohms
    current[injected] = VOLTS / R / max(len(injected), 1)
    known = np.array(sorted(volts))
    inner = np.array([n for n in range(len(cells)) if n not in volts and matrix[n, n] > 0], dtype=int)
    found = np.full(count, np.nan)
    found[known] = [volts[n] for n in known]
    right = current[inner] - matrix[np.ix_(inner, known)] @ found[known]
    found[inner] = np.linalg.solve(matrix[np.ix_(inner, inner)], right)
    power = sum((found[a] - found[b]) ** 2 / ohms for a, b, ohms in elements if a != b)
    return found[: len(cells)].reshape(space.shape), power


def assert_agrees(netlist: rg.Netlist, space: rg.ConfigurationSpace, expected: tuple[Any, float]) -> None:
    point, (volts, power) = rg.solve(netlist), expected
    node = netlist.cells.node
    has_node = node >= 0
    scale = max(VOLTS, float(np.nanmax(np.abs(volts))))
    np.testing.assert_allclose(point.voltage[node[has_node]], volts[has_node], rtol=0, atol=1e-9 * scale)
    assert has_node[(space.cell == 0) & space.goal_connected].all()
    assert point.power == pytest.approx(power, rel=1e-8, abs=1e-12 * scale**2 / R)


@pytest.mark.parametrize("wiring", WIRINGS)
def test_a_seed_draws_the_same_mismatch_in_analyses_netlists_and_decks(wiring: str, tmp_path: Path) -> None:
    drawn = rg.spice.analyses.MismatchAnalysis(0.4, seed=7)
    for number in range(20):
        space, options = random_scene(number, wiring)
        if not (space.goal_connected & (space.cell == 0)).any():
            continue
        wall = WALL if wiring == "wall" else None
        chip = rg.Chip(resistance=R, supply=VOLTS, wall_resistance=WALL, mismatch=0.4, seed=7)
        flat = rg.compile_space(space, **options, resistance=R, supply=VOLTS, wall_resistance=wall, rails="cells")
        made = rg.chip.build_chip(flat, chip)
        np.testing.assert_array_equal(drawn.apply(flat).conductance, made.conductance)
        if number < 4:
            switched = rg.Chip(**vars(chip) | SWITCHES)
            netlist = rg.chip.build_chip(flat, switched)
            written = rg.write_spice(netlist, tmp_path / "a.cir", form="cells", chip=switched)
            assert rg.check_deck(written.path).agrees


@pytest.mark.parametrize("wiring", WIRINGS)
@pytest.mark.quick_cases(2)
def test_flat_netlists_and_chips_equal_the_dense_circuit_of_the_definition(wiring: str) -> None:
    compared = touching = 0
    for number in range(100):
        space, options = random_scene(number, wiring)
        if not space.goal_connected.any():
            continue
        chip = rg.Chip(resistance=R, supply=VOLTS, wall_resistance=WALL)
        wall = WALL if wiring == "wall" else None
        flat = rg.compile_space(space, **options, resistance=R, supply=VOLTS, wall_resistance=wall, rails="cells")
        ideal = dense_reference(space, options, {})
        try:
            assert_agrees(flat, space, ideal)
        except rg.CircuitError:
            continue  # everything is on one rail
        assert_agrees(rg.chip.build_chip(flat, chip), space, ideal)
        real = dense_reference(space, options, SWITCHES)
        assert_agrees(rg.chip.build_chip(flat, rg.Chip(**vars(chip) | SWITCHES)), space, real)
        compared += 1
        touching += any(there is not None and {space.cell[here], space.cell[there]} == {1, 2}
                        for here, there, *_ in contacts(space, options))  # fmt: skip
    assert compared >= 60
    assert touching >= 40
