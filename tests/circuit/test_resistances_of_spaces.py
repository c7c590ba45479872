"""Effective resistances of compiled spaces: islands, boundary conditions, lattices, chips and rejected uses."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import csgraph
from support.spaces import space_of

import resgrid as rg

Matrix = NDArray[np.float64]


def dense_laplacian(space: rg.ConfigurationSpace, edges: list[str], **wiring: float | str) -> tuple[Matrix, Matrix]:
    """Laplacian matrix of a space, cell by cell, and the row of every cell, -1 for open obstacles.

    The last row is the wire that all rails form when sources are set to zero.
    """
    code, shape, rail = space.cell, space.shape, space.cell.size
    is_open, wall = wiring["boundary"] == "neumann", float(wiring.get("wall_resistance", 0.0))
    c = np.ones(shape) if space.conductivity is None else space.conductivity
    row = np.arange(rail).reshape(shape)
    row[code == rg.Cell.GOAL] = rail
    row[code == rg.Cell.OBSTACLE] = -1 if is_open else rail
    matrix = np.zeros((rail + 1, rail + 1))

    def join(a: int, b: int, siemens: float) -> None:
        if a != b and min(a, b) >= 0:
            matrix[[a, b], [a, b]] += siemens
            matrix[[a, b], [b, a]] -= siemens

    for cell in itertools.product(*map(range, shape)):
        free = code[cell] == rg.Cell.FREE
        for axis, size in enumerate(shape):
            unit = (space.spacing.min() / space.spacing[axis]) ** 2 / float(wiring["resistance"])
            ends = [place for place in (0, size - 1) if cell[axis] == place]
            if not space.axes[axis].periodic and edges[axis] == "obstacle" and not is_open and free:
                for _ in ends if size > 1 else (0, 0):
                    join(row[cell], rail, 1 / (1 / (unit * c[cell]) + wall))
            last = cell[axis] == size - 1
            if last and (size == 1 or not space.axes[axis].periodic):
                continue
            other = (*cell[:axis], (cell[axis] + 1) % size, *cell[axis + 1 :])
            values = [c[place] for place in (cell, other) if code[place] == rg.Cell.FREE]
            if values:
                ohms = 1 / (unit * len(values) / sum(1 / value for value in values))
                join(row[cell], row[other], 1 / (ohms + wall * ((code[cell] == 1) != (code[other] == 1))))
        if free:
            join(row[cell], rail, float(wiring["leak"]) * space.spacing.min() ** 2 / float(wiring["resistance"]))
    return matrix, row


def random_space(rng: np.random.Generator) -> rg.ConfigurationSpace:
    """Space of one to three axes with islands of free cells and up to two goal cells."""
    ndim = int(rng.integers(1, 4))
    shape = tuple(rng.integers(1, {1: 25, 2: 8, 3: 5}[ndim], ndim, endpoint=True).tolist())
    cell = (rng.random(shape) < rng.uniform(0.0, 0.6)).astype(np.uint8)
    cell.flat[rng.integers(0, cell.size, int(rng.integers(0, 3)))] = rg.Cell.GOAL
    periodic, spacing = tuple((rng.random(ndim) < 0.3).tolist()), tuple(rng.uniform(0.5, 3.0, ndim).tolist())
    conductivity = np.exp(rng.normal(0.0, 1.5, shape)) if rng.random() < 0.5 else None
    return space_of(cell, periodic=periodic, spacing=spacing, conductivity=conductivity)


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann", "wall"])
@pytest.mark.parametrize("rails", ["merged", "cells"])
@pytest.mark.parametrize("seed", range(5))
def test_resistances_of_random_spaces_are_those_of_the_pseudo_inverse(seed: int, rails: str, boundary: str) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(8):
        space, edges = random_space(rng), rng.choice(["obstacle", "open"], 3).tolist()
        wiring = {"boundary": boundary, "resistance": 10 ** rng.uniform(0, 4), "leak": float(rng.choice([0, 0, 0.3]))}
        if boundary == "wall":
            wiring["wall_resistance"] = 10 ** rng.uniform(-1, 3)
        netlist = rg.compile_space(space, edge=edges[: space.ndim], rails=rails, drive="none", **wiring)
        matrix, row = dense_laplacian(space, edges, **wiring)
        cells = [tuple(cell) for cell in rng.permutation(np.argwhere(row >= 0))[:8].tolist()]
        if len(cells) < 2:
            continue
        found = rg.effective_resistance(netlist, terminals=cells, cells=True).matrix
        rows = [int(row[cell]) for cell in cells]
        part = csgraph.connected_components(matrix, directed=False)[1][rows]
        inverse = np.linalg.pinv(matrix, hermitian=True)[np.ix_(rows, rows)]
        expected = np.diag(inverse)[:, None] + np.diag(inverse) - 2 * inverse
        expected[part[:, None] != part] = np.inf
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12 * np.abs(inverse).max())


def test_islands_are_part_of_a_circuit_without_a_drive() -> None:
    """Cells on the side without a goal have the resistances of that side alone."""
    cell = np.zeros((7, 5), dtype=np.uint8)
    cell[3] = rg.Cell.OBSTACLE
    alone = rg.compile_space(space_of(cell[:3]), boundary="neumann", drive="none")
    expected = rg.effective_resistance(alone, [((0, 0), (1, 4))], cells=True).resistance[0]
    cell[6, 2] = rg.Cell.GOAL
    netlist = rg.compile_space(space_of(cell), boundary="neumann", drive="none")
    found = rg.effective_resistance(netlist, [((0, 0), (1, 4)), ((0, 0), (6, 4))], cells=True).resistance
    assert found[0] == pytest.approx(expected, rel=1e-14) and found[1] == np.inf
    assert rg.circuit.pair_currents(netlist, (0, 0), (1, 4), cells=True).resistance == pytest.approx(expected)
    with pytest.raises(rg.CircuitError, match="their effective resistance is infinite"):
        rg.circuit.pair_currents(netlist, (0, 0), (6, 4), cells=True)
    for lattice in ("square8", "hexagonal"):
        sites = rg.compile_space(space_of(cell), boundary="neumann", drive="none", lattice=lattice)
        ohms = rg.effective_resistance(sites, [("n_0_0", "n_1_4"), ("n_0_0", "n_6_4")]).resistance
        assert 0 < ohms[0] < np.inf and ohms[1] == np.inf


def test_a_free_cell_that_a_drive_leaves_out_is_named_with_the_remedy() -> None:
    space = space_of([[0, 0], [1, 1], [0, 2]])
    netlist = rg.compile_space(space, boundary="neumann")
    mask = np.zeros(space.shape, dtype=np.bool_)
    mask[0, 1] = True
    for terminal in ((0, 1), mask):
        with pytest.raises(rg.InputError, match=r"cell \(0, 1\) is free, but has no path to a goal.*drive = 'none'"):
            rg.effective_resistance(netlist, [(terminal, (2, 0))], cells=True)
    kept = rg.compile_space(space, boundary="neumann", drive="none")
    assert rg.effective_resistance(kept, [(mask, (2, 0))], cells=True).resistance[0] == np.inf


def test_computations_of_currents_reject_a_circuit_without_a_drive() -> None:
    space, words = space_of([[0, 0], [1, 1], [0, 2]]), "leave out drive = 'none'"
    netlist = rg.compile_space(space, boundary="neumann", drive="none")
    with pytest.raises(rg.CircuitError, match=words):
        rg.solve(netlist)
    with pytest.raises(rg.InputError, match=words):
        rg.plan(space, boundary="neumann", drive="none")
    with pytest.raises(rg.InputError, match=words):
        rg.circuit.WarmStart(boundary="neumann", drive="none")
    with pytest.raises(rg.InputError, match=words):
        rg.study(space, boundary="neumann", drive="none")
    with pytest.raises(rg.ResgridError, match=words):
        rg.hardware.build_board(space_of(np.pad(space.cell, 1)), boundary="neumann", drive="none")
    with pytest.raises(rg.InputError, match=words):
        rg.hardware.build_layout(space, "toy:poly", boundary="neumann", drive="none")


@pytest.mark.parametrize(
    ("chip", "island"),
    [
        (rg.Chip(mismatch=0.05, seed=3), np.inf),
        (rg.Chip(mismatch=0.05, seed=3, goal_switch_on=100.0, rail_resistance=5.0), np.inf),
        (rg.Chip(mismatch=0.05, seed=3, readout=rg.chip.Readout(input_resistance=1e8)), 1e8),
    ],
)
def test_a_chip_without_a_drive_is_the_same_chip(chip: rg.Chip, island: float) -> None:
    """Mismatch of the goal-connected cells does not depend on the drive; the islands have resistors of their own."""
    cell = np.zeros((7, 5), dtype=np.uint8)
    cell[3], cell[6, 2] = rg.Cell.OBSTACLE, rg.Cell.GOAL
    driven, undriven = (
        rg.chip.build_chip(rg.compile_space(space_of(cell), boundary="neumann", rails="cells", drive=drive), chip)
        for drive in ("uniform", "none")
    )
    pairs = [((4, 0), (6, 2)), ((4, 4), (5, 1))]
    expected = rg.effective_resistance(driven, pairs, cells=True).resistance
    found = rg.effective_resistance(undriven, [*pairs, ((0, 0), (1, 4)), ((0, 0), (6, 4))], cells=True).resistance
    np.testing.assert_allclose(found[:2], expected, rtol=1e-4 if np.isfinite(island) else 1e-12)
    assert 0 < found[2] < 1e5 and (found[3] == island if island == np.inf else found[3] < island)
