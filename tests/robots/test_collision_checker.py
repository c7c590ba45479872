"""Collision tests and distances of exact solids at single configurations.

Tests internals: `resgrid.robots.urdf.collision`, `resgrid.robots.urdf.exact_solids`.
"""

from __future__ import annotations

import pickle
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from support import trees

import resgrid as rg
from resgrid.robots.convex import Body, Solid
from resgrid.robots.urdf import exact_solids
from resgrid.robots.urdf.collision import CollisionChecker
from resgrid.robots.urdf.tree import KinematicTree


def slide(first: Body, *others: Body) -> KinematicTree:
    """Return a tree in which the first body moves along x, and may collide with all others."""
    bodies = [first, *others]
    return trees.tree([(-1, trees.pose(), (1, 0, 0))], bodies, [(0, i) for i in range(1, len(bodies))], prismatic=[0])


def solid(kind: str, *size: float, at: tuple[float, ...] = (0, 0, 0)) -> Body:
    """Return a cylinder or capsule at rest; its convex cover is not used here."""
    cover = trees.ball("cover", -1, 1.0)
    exact = Solid(kind, size, trees.pose(at), trees.NO_POINTS, trees.NO_TRIANGLES)  # type: ignore[arg-type]
    return Body(kind, -1, exact, cover.hull, cover.pieces)


def test_distances_of_all_kinds_of_solids() -> None:
    tip = trees.ball("tip", 0, 0.1)
    cases = [
        (trees.ball("ball", -1, 0.5, (2, 0, 0)), 1.4),
        (trees.box("box", -1, (1, 1, 1), (2, 0, 0)), 1.4),
        (solid("cylinder", 0.5, 3.0, at=(2, 0, 1)), 1.4),
        (solid("capsule", 0.5, 1.0, at=(2, 0, 0)), 1.4),
        (trees.mesh("mesh", -1, [trees.block((1, -1, -1), (2, 1, 1))]), 0.9),
        (trees.half_space("floor", -0.4), 0.3),
    ]
    for body, expected in cases:
        checker = CollisionChecker(slide(tip, body))
        assert checker.distance([0.0])[0] == pytest.approx(expected, abs=1e-5)
        at = [[0.0], [expected - 1e-4], [expected + 1e-4]] if body.name != "floor" else [[0.0]]
        assert checker.collides(at).tolist() == [False, False, True][: len(at)]
    checker = CollisionChecker(slide(tip, *(body for body, _ in cases)))
    assert checker.distance([[0.0], [3.0]]) == pytest.approx([0.3, 0.3], abs=1e-5)
    assert checker.first_pairs([[-1.0], [2.0]]).tolist() == [-1, 0]
    assert checker.first_pairs([[2.0]], [3, 1]).tolist() == [3]
    assert checker.names(3) == ("tip", "capsule")


def test_interior_of_a_closed_mesh_collides() -> None:
    shell = trees.mesh("shell", -1, [trees.block((-1, -1, -1), (1, 1, 1))])
    checker = CollisionChecker(slide(trees.ball("tip", 0, 0.1), shell))
    assert checker.collides([[0.0], [0.95], [1.2], [-3.0]]).tolist() == [True, True, False, False]
    assert checker.distance([0.0])[0] == 0.0
    around = CollisionChecker(
        trees.tree([(-1, trees.pose(), (1, 0, 0))], [trees.Body("shell", 0, shell.solid, shell.hull, shell.pieces),
                   trees.ball("pin", -1, 0.1)], [(0, 1)], prismatic=[0])
    )  # fmt: skip
    assert around.collides([[0.0], [0.5], [1.2]]).tolist() == [True, True, False]
    opened = Solid("mesh", (), np.eye(4), shell.solid.points, shell.solid.triangles[2:])
    surface = CollisionChecker(slide(trees.ball("tip", 0, 0.1), Body("shell", -1, opened, shell.hull, shell.pieces)))
    assert surface.collides([[0.0]]).tolist() == [False]


def test_threads_and_pickles_give_the_same_results() -> None:
    checker = CollisionChecker(
        slide(trees.ball("tip", 0, 0.1), trees.mesh("wall", -1, [trees.block((1, -1, -1), (2, 1, 1))]))
    )
    values = np.linspace(-1, 3, 400)[:, np.newaxis]
    expected = checker.collides(values)
    with ThreadPoolExecutor(4) as threads:
        for found in threads.map(checker.collides, [values] * 8):
            assert (found == expected).all()
    assert (pickle.loads(pickle.dumps(checker)).collides(values) == expected).all()


def test_tree_without_pairs() -> None:
    checker = CollisionChecker(trees.tree([(-1, trees.pose(), (1, 0, 0))], [trees.ball("tip", 0, 0.1)], []))
    assert not checker.collides([[0.0]]).any()
    assert checker.distance([[0.0]]).tolist() == [np.inf]


def test_wrong_configuration_and_missing_coal(monkeypatch: pytest.MonkeyPatch) -> None:
    checker = CollisionChecker(slide(trees.ball("tip", 0, 0.1), trees.ball("ball", -1, 0.1, (1, 0, 0))))
    with pytest.raises(rg.errors.InputError, match=r"has 1 values \(q0\), got an array of shape \(2, 2\)"):
        checker.collides(np.zeros((2, 2)))
    monkeypatch.setitem(sys.modules, "coal", None)
    exact_solids.coal_module.cache_clear()
    with pytest.raises(rg.errors.ToolMissingError, match=r"need the package coal; install it with: .*pip install"):
        checker.collides([[0.0]])
    exact_solids.coal_module.cache_clear()
