"""Random shapes in space."""

from __future__ import annotations

from typing import Any

import numpy as np

import resgrid as rg

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
FACES = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
         [1, 5, 7], [1, 7, 3]]  # fmt: skip


def a_shape(kind: str, random: np.random.Generator) -> Any:  # noqa: PLR0911
    """Return a shape of a kind with random position and size."""
    a, b = random.uniform(-0.7, 0.7, (2, 3)).tolist()
    radius = float(random.choice([0.05, 0.15, 0.4]))
    match kind:
        case "cylinder":
            return rg.Cylinder(tuple(a), tuple(b), radius)
        case "upright":
            return rg.Cylinder((0.0, 0.1, -0.5), (0.0, 0.1, 0.5), radius)
        case "capsule":
            return rg.Capsule(tuple(a), tuple(b), radius)
        case "box":
            return rg.OrientedBox(tuple(a), tuple(random.choice([0.1, 0.4, 1.1], 3)), tuple(random.uniform(-3, 3, 3)))
        case "ring":  # a square ring, not convex, its hole along z
            outer, inner = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]), 0.5
            points = np.array([[s * x, s * y, z] for z in (-0.4, 0.4) for s in (1, inner) for x, y in outer])
            quads = [(n, (n + 1) % 4) for n in range(4)]
            faces = [[8 + i, 8 + j, 12 + j, 12 + i] for i, j in quads] + [[j, i, 4 + i, 4 + j] for i, j in quads]
            faces += [[i, j, 8 + j, 8 + i] for i, j in quads] + [[4 + j, 4 + i, 12 + i, 12 + j] for i, j in quads]
            turn = rg.OrientedBox((0, 0, 0), (2.0, 2.0, 2.0), tuple(random.uniform(-3, 3, 3))).corners
            basis = np.column_stack([turn[4] - turn[0], turn[2] - turn[0], turn[1] - turn[0]]) / 2
            triangles = [part for a, b, c, d in faces for part in ([a, b, c], [a, c, d])]
            return rg.Mesh(0.8 * points @ basis.T, np.array(triangles))
        case "crate":  # its faces lie on borders between cells
            return rg.Mesh(CUBE * [0.8, 0.6, 4 / 7] + [-0.4, -0.2, -3 / 7], np.array(FACES))
        case "surface":
            return rg.Mesh(random.uniform(-0.8, 0.8, (9, 3)), random.permutation(9).reshape(3, 3))
    normal = random.normal(size=3)
    return rg.HalfSpace(tuple(normal.tolist()), float(random.uniform(-0.5, 0.5)))
