"""Small spaces for tests: random spaces, corridors and mazes."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from numpy.typing import ArrayLike

import resgrid as rg


def space_of(
    cell: ArrayLike,
    *,
    periodic: tuple[bool, ...] | None = None,
    spacing: tuple[float, ...] | None = None,
    conductivity: ArrayLike | None = None,
) -> rg.ConfigurationSpace:
    """Return a space with the given cells and its lower corner at the origin."""
    code = np.asarray(cell, dtype=np.uint8)
    ring = periodic or (False,) * code.ndim
    width = spacing or (1.0,) * code.ndim
    axes = [
        rg.Axis("xyzw"[a], 0.0, n * h, n, p) for a, (n, h, p) in enumerate(zip(code.shape, width, ring, strict=True))
    ]
    return rg.ConfigurationSpace(axes, code, conductivity)


def serpentine(legs: int, leg: int, width: int) -> np.ndarray:
    """Return the cells of a serpentine corridor with the goal at its first end."""
    cell = np.ones((legs * (width + 1) + 1, leg + 2), dtype=np.uint8)
    for k in range(legs):
        first = k * (width + 1) + 1
        cell[first : first + width, 1 : 1 + leg] = 0
        if k + 1 < legs:
            turn = slice(1 + leg - width, 1 + leg) if k % 2 == 0 else slice(1, 1 + width)
            cell[first + width, turn] = 0
    cell[1, 1] = 2
    return cell


@st.composite
def spaces(
    draw: st.DrawFn, max_cells: int = 9, conductive: bool = True, dimensions: tuple[int, int] = (1, 4)
) -> rg.ConfigurationSpace:
    """Draw a random space of one to four dimensions (or as given) with at least one goal cell and one free cell."""
    ndim = draw(st.integers(*dimensions))
    limit = {1: 30, 2: max_cells, 3: 5, 4: 3}[ndim]
    shape = tuple(draw(st.integers(2, limit)) for _ in range(ndim))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    cell = (rng.random(shape) < draw(st.sampled_from([0.0, 0.1, 0.3, 0.5]))).astype(np.uint8)
    goals = draw(st.integers(1, 3))
    cell.flat[rng.choice(cell.size, goals)] = 2
    if not np.any(cell == 0):
        cell.flat[int(np.argmax(cell != 2)) if np.any(cell != 2) else 0] = 0
        if not np.any(cell == 2):
            cell.flat[-1] = 2
    conductivity = 10.0 ** rng.uniform(-2, 2, shape) if conductive and draw(st.booleans()) else None
    return space_of(
        cell,
        periodic=tuple(draw(st.booleans()) for _ in range(ndim)),
        spacing=tuple(draw(st.sampled_from([0.5, 1.0, 2.0])) for _ in range(ndim)),
        conductivity=conductivity,
    )


def rough_space(shape: tuple[int, ...], periodic: bool = False, seed: int = 0) -> rg.ConfigurationSpace:
    """A small space with obstacles, two goals, unequal cells and a conductivity map."""
    rng = np.random.default_rng(seed)
    cell = (rng.random(shape) < 0.15).astype(np.uint8)
    cell[(0,) * len(shape)] = rg.Cell.GOAL
    cell[tuple(size // 2 for size in shape)] = rg.Cell.GOAL
    cell[tuple(size // 2 - 1 for size in shape)] = rg.Cell.FREE
    axes = [rg.Axis("xyz"[n], 0.0, 1.0 + n, size, periodic=periodic and n == 0) for n, size in enumerate(shape)]
    return rg.ConfigurationSpace(axes, cell, conductivity=rng.uniform(0.2, 5.0, shape))
