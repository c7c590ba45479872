"""Bounds on the distance of convex pieces that move with the joints, against distances by coal at many configurations.

Tests internals: `resgrid.robots.urdf.box_kernels`, `resgrid.robots.urdf.arrays`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from support import trees

import resgrid as rg
from resgrid.robots.urdf.arrays import proof_arrays
from resgrid.robots.urdf.tree import KinematicTree


def bound(tree: KinematicTree, lower: NDArray[np.float64], upper: NDArray[np.float64], margin: float = 0.0) -> Any:
    """Return boxes with all pairs as items, and the findings about them."""
    from resgrid.robots.urdf.box_kernels import Boxes, Findings, bound_boxes, new_work

    arrays, (boxes, joints) = proof_arrays(tree), lower.shape
    items = np.tile(np.column_stack([np.arange(len(tree.pairs)), arrays.hull[tree.pairs]]), (boxes, 1))
    count = len(items)
    given = Boxes(
        lower.copy(), upper.copy(), np.arange(boxes + 1) * len(tree.pairs), items, np.tile([0.0, 0.0, 1.0], (count, 1))
    )
    found = Findings(
        np.ones(count, bool), np.zeros(count, bool), np.zeros((boxes, joints)), np.zeros((boxes, joints)),
        np.full(boxes, -1), np.zeros(2, np.int64),
    )  # fmt: skip
    bound_boxes(given, np.zeros(joints), margin, 1, arrays.tree, found, new_work(arrays.tree, joints))
    return given, found


@pytest.mark.parametrize("seed", range(40))
def test_proven_pieces_stay_apart(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tree = trees.random_tree(rng)
    count, joints = 5, len(tree.moving)
    centre = rng.uniform(-3, 3, (count, joints))
    half = rng.choice([0.02, 0.2, 1.0, 3.0], (count, 1)) * rng.random((count, joints))
    boxes, found = bound(tree, centre - half, centre + half)
    is_open = found.is_open.reshape(count, -1)
    for box, pair in np.argwhere(~is_open):
        places = rng.uniform(-1, 1, (40, joints))
        places[:16] = np.sign(places[:16])
        assert trees.PieceDistance(tree, pair)(centre[box] + places * half[box]).min() > 0.0
    for box in np.flatnonzero(found.probe_item >= 0):
        pair = boxes.items[found.probe_item[box], 0]
        assert trees.PieceDistance(tree, pair)(found.probe[box : box + 1])[0] < 1e-6
        assert (np.abs(found.probe[box] - centre[box]) <= half[box] * (1 + 1e-12)).all()


@pytest.mark.parametrize("seed", range(20))
def test_bound_of_a_single_configuration_is_the_distance(seed: int) -> None:
    rng = np.random.default_rng(1000 + seed)
    tree = trees.random_tree(rng)
    values = rng.uniform(-3, 3, (1, len(tree.moving)))
    for pair in range(len(tree.pairs)):
        distance = trees.PieceDistance(tree, pair)(values)[0]
        for factor in (0.99, 1.01):
            margin = factor * distance + 1e-6 * (factor - 1)
            if distance > 1e-3:
                _, found = bound(tree, values, values, margin)
                assert found.is_open[pair] == (factor > 1)


@pytest.mark.slow
def test_bound_of_one_joint_is_nearly_the_smallest_distance_of_its_motion() -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        arm = trees.ball("arm", 0, 0.05, rng.normal(0, 1, 3))
        wall = trees.ball("wall", -1, 0.05, rng.normal(0, 1, 3))
        tree = trees.tree([(-1, trees.pose(), trees.unit(rng))], [arm, wall], [(0, 1)])
        half = rng.uniform(0, 0.3)
        smallest = trees.PieceDistance(tree, 0)(np.linspace(-half, half, 2001)[:, np.newaxis]).min()
        if smallest > 0.01:
            _, found = bound(tree, np.array([[-half]]), np.array([[half]]), 0.85 * smallest - 0.002)
            assert not found.is_open[0]


def test_disc_that_spins_about_its_own_axis_next_to_a_table_is_proven_in_one_box() -> None:
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    rim = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(24)])
    disc = trees.mesh("disc", 0, [np.concatenate([rim, np.add(rim, (0, 0, 0.1))])])
    table = trees.box("table", -1, (4, 1, 4), (0, -1.501, 0))
    tree = trees.tree([(-1, trees.pose(), (0, 0, 1))], [disc, table], [(0, 1)])
    _, found = bound(tree, np.full((1, 1), -np.pi), np.full((1, 1), np.pi), 1e-5)
    assert not found.is_open[0]


def test_invalid_bodies_are_rejected() -> None:
    joints = [(-1, trees.pose(), (0, 0, 1))]
    floor = trees.half_space("floor")
    moving = trees.Body("lid", 0, floor.solid, floor.hull, floor.pieces)
    with pytest.raises(rg.errors.InputError, match="lid is a half-space and moves with a joint; use a box"):
        proof_arrays(trees.tree(joints, [moving, trees.ball("ball", -1, 1.0)], [(0, 1)]))
    broken = trees.ball("ball", 0, 1.0, (0, np.nan, 0))
    with pytest.raises(rg.errors.InputError, match="ball has no points, or a point that is not finite"):
        proof_arrays(trees.tree(joints, [broken, floor], [(0, 1)]))
    fine = trees.ball("ball", 0, 1.0)
    empty = trees.Body("ball", 0, fine.solid, trees.ConvexPiece(np.zeros((0, 3))), ())
    with pytest.raises(rg.errors.InputError, match="ball has no points, or a point that is not finite"):
        proof_arrays(trees.tree(joints, [empty, floor], [(0, 1)]))
    with pytest.raises(rg.errors.InputError, match="floor is a half-space; put it second in its pair with ball"):
        proof_arrays(trees.tree(joints, [fine, floor], [(1, 0)]))
    with pytest.raises(rg.errors.InputError, match="a joint has a pose, an axis or a factor that is not finite"):
        proof_arrays(trees.tree(joints, [fine, floor], [(0, 1)], offset=[np.inf]))
