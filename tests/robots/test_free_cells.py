"""Proven free cells of robots: directed cases, random robots, executors, checkpoints and cell centres.

Tests internals: `resgrid.robots.urdf.free_cells`, `resgrid.robots.urdf.collision`.
"""

from __future__ import annotations

from concurrent.futures import Executor, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from support import trees

import resgrid as rg
from resgrid.robots.convex import Body
from resgrid.robots.urdf.collision import CollisionChecker
from resgrid.robots.urdf.free_cells import CellProof, CellVerdict, centre_cells, proof_key, prove_cells
from resgrid.robots.urdf.tree import KinematicTree

FREE, COLLISION, UNDECIDED = CellVerdict


def axes_of(tree: KinematicTree, *cells: int, lower: float = -np.pi, upper: float = np.pi) -> tuple[rg.Axis, ...]:
    """Return an axis for every moving joint, the last number of cells for the remaining joints."""
    counts = [*cells, *[cells[-1]] * len(tree.moving)]
    return tuple(rg.Axis(name, lower, upper, counts[i]) for i, name in enumerate(tree.moving))


def samples(axes: tuple[rg.Axis, ...], cells: NDArray[np.int64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Return one configuration in every cell (n, m); half of them on borders of the cell."""
    place = rng.uniform(size=cells.shape)
    place = np.where(rng.random(cells.shape) < 0.3, np.round(place), place)
    return np.array([axis.lower for axis in axes]) + (cells + place) * [axis.spacing for axis in axes]


def check(tree: KinematicTree, axes: tuple[rg.Axis, ...], proof: CellProof, count: int = 2000) -> None:
    """Assert that no configuration in a free cell collides, and that every cell with a collision has one nearby."""
    rng, checker = np.random.default_rng(0), CollisionChecker(tree)
    free = np.argwhere(proof.verdict == FREE)
    if len(free):
        chosen = free[rng.integers(len(free), size=count)]
        assert not checker.collides(samples(axes, chosen, rng)).any()
    centres = centre_cells(tree, axes)
    assert not (centres & (proof.verdict == FREE)).any()


def planar_arm(*bodies: Body, links: int = 2, length: float = 1.0) -> KinematicTree:
    """Return an arm of bars in the plane z = 0 with revolute joints about z, between obstacles."""
    joints = [(i - 1, trees.pose((length if i else 0.0, 0, 0)), (0, 0, 1)) for i in range(links)]
    bars = [trees.box(f"bar{i}", i, (0.8 * length, 0.1, 0.1), (length / 2, 0, 0)) for i in range(links)]
    pairs = [(i, links + k) for i in range(links) for k in range(len(bodies))]
    pairs += [(i, j) for i in range(links) for j in range(i - 1)]
    return trees.tree(joints, [*bars, *bodies], pairs)


def test_arm_between_obstacles() -> None:
    tree = planar_arm(trees.box("post", -1, (0.3, 0.3, 1), (1.2, 0.6, 0)), trees.ball("ball", -1, 0.3, (-1, -1, 0)))
    axes = axes_of(tree, 40)
    proof = prove_cells(tree, axes)
    counts = proof.counts
    assert sum(counts.values()) == 1600 == proof.verdict.size
    assert counts[FREE] >= 0.98 * (counts[FREE] + counts[UNDECIDED])
    assert 150 < counts[COLLISION] < 400
    assert proof.bounds > 0 < proof.tests
    check(tree, axes, proof, 20_000)


@pytest.mark.parametrize("seed", range(25))
def test_random_robots(seed: int) -> None:
    tree = trees.random_tree(np.random.default_rng(seed))
    axes = axes_of(tree, *(40, 12, 7, 5)[len(tree.moving) - 1 :][:1], lower=-2.0, upper=2.5)
    check(tree, axes, prove_cells(tree, axes, halvings=2))


def test_disc_that_spins_about_its_own_axis_is_proven_with_one_cell() -> None:
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    rim = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(24)])
    disc = trees.mesh("disc", 0, [np.concatenate([rim, np.add(rim, (0, 0, 0.1))])])
    table = trees.box("table", -1, (4, 1, 4), (0, -1.501, 0))
    tree = trees.tree([(-1, trees.pose(), (0, 0, 1))], [disc, table], [(0, 1)])
    proof = prove_cells(tree, axes_of(tree, 1))
    assert proof.verdict.tolist() == [FREE]
    assert proof.bounds == 1


@pytest.mark.parametrize(("gap", "expected"), [(1e-2, FREE), (1e-4, FREE), (1e-6, UNDECIDED), (-1e-6, COLLISION)])
def test_grazing_contact(gap: float, expected: CellVerdict) -> None:
    arm = trees.ball("arm", 0, 0.1, (1, 0, 0))
    wall = trees.box("wall", -1, (1, 1, 1), (0, 0, -0.6 - gap))
    tree = trees.tree([(-1, trees.pose(), (0, 1, 0))], [arm, wall], [(0, 1)], prismatic=[0])
    axes = axes_of(tree, 1, lower=-1.0, upper=1.0)
    sliding = trees.box("sledge", 0, (0.2, 0.2, 0.2), (0, 0, 0))
    level = trees.tree([(-1, trees.pose(), (0, 1, 0))], [sliding, wall], [(0, 1)], prismatic=[0])
    assert prove_cells(level, axes).verdict.tolist() == [expected]


def test_swinging_ball_that_grazes_a_wall() -> None:
    for gap in (1e-3, 1e-4):
        wall = trees.box("wall", -1, (1, 4, 1), (1.6 + gap, 0, 0))
        tree = trees.tree([(-1, trees.pose(), (0, 0, 1))], [trees.ball("arm", 0, 0.1, (1, 0, 0)), wall], [(0, 1)])
        proof = prove_cells(tree, axes_of(tree, 9))
        assert (proof.verdict == FREE).all()


def test_touching_obstacles_and_a_body_between_them() -> None:
    walls = [trees.box("left", -1, (1, 1, 1), (-0.5, 0, 0)), trees.box("right", -1, (1, 1, 1), (0.5, 0, 0))]
    probe = trees.ball("probe", 0, 0.1, (0, 0, 1.2))
    tree = trees.tree([(-1, trees.pose(), (0, 0, 1))], [probe, *walls], [(0, 1), (0, 2)], prismatic=[0])
    axes = axes_of(tree, 16, lower=-1.0, upper=1.0)
    verdict = prove_cells(tree, axes).verdict
    expected = np.where(axes[0].edges[:-1] > -0.6, FREE, COLLISION)
    assert (verdict == expected).all()


def test_joint_limit_on_a_border_of_cells_and_at_the_end_of_the_axis() -> None:
    wall = trees.box("wall", -1, (1, 1, 1), (1.5, 0, 0))
    sledge = trees.box("sledge", 0, (0.2, 0.2, 0.2), (-0.1, 0, 0))
    tree = trees.tree([(-1, trees.pose(), (1, 0, 0))], [sledge, wall], [(0, 1)], prismatic=[0])
    beyond = prove_cells(tree, (rg.Axis("q0", 0.0, 2.0, 8),)).verdict
    assert beyond[:3].tolist() == [FREE] * 3
    assert beyond[4:].tolist() == [COLLISION] * 4
    assert beyond[3] != FREE
    assert prove_cells(tree, (rg.Axis("q0", 0.0, 1.0 - 2e-5, 8),)).verdict.tolist() == [FREE] * 8


def test_pair_behind_the_moving_joints_is_decided_once() -> None:
    far = trees.ball("far", 1, 0.3, (0, 0, 0.1))
    for gap, expected in ((0.1, FREE), (-0.1, COLLISION)):
        near = trees.ball("near", 1, 0.3, (0, 0, 0.7 + gap))
        joints = [(-1, trees.pose(), (0, 0, 1)), (0, trees.pose((1, 0, 0)), (0, 1, 0))]
        tree = trees.tree(joints, [far, near], [(0, 1)])
        proof = prove_cells(tree, axes_of(tree, 5))
        assert (proof.verdict == expected).all()
        assert proof.tests <= 5


def test_pair_of_fewer_joints_is_decided_on_the_grid_of_these_joints() -> None:
    tree = planar_arm(trees.ball("ball", -1, 0.2, (-0.5, 0, 0)), links=3)
    tree = trees.tree(
        [(p, m, d) for p, m, d in zip(tree.parent, tree.placement, tree.direction, strict=True)], tree.bodies, [(0, 3)]
    )
    proof = prove_cells(tree, axes_of(tree, 16))
    assert proof.bounds < 400
    assert (proof.verdict == proof.verdict[:, :1, :1]).all()
    assert set(np.unique(proof.verdict)) >= {FREE, COLLISION}


def test_identical_links_and_branches() -> None:
    places = [(-1, (0, 0, 0)), (-1, (1, 0, 0)), (1, (0.4, 0, 0))]
    joints = [(parent, trees.pose(at), (0, 0, 1)) for parent, at in places]
    bars = [trees.box(f"bar{i}", i, (0.5, 0.06, 0.06), (0.25, 0, 0)) for i in range(3)]
    tree = trees.tree(joints, bars, [(1, 0), (2, 0)])
    axes = axes_of(tree, 12)
    proof = prove_cells(tree, axes)
    counts = proof.counts
    assert counts[FREE] > 0.9 * (counts[FREE] + counts[UNDECIDED])
    assert counts[COLLISION] > 0
    check(tree, axes, proof)


def test_gripper_with_a_joint_that_follows_another_one() -> None:
    joints = [(-1, trees.pose((0, 0, 0)), (0, 1, 0)), (-1, trees.pose((0, 0, 0)), (0, 1, 0))]
    fingers = [trees.box("left", 0, (0.1, 0.1, 0.1)), trees.box("right", 1, (0.1, 0.1, 0.1))]
    tree = trees.tree(
        joints, fingers, [(1, 0)], prismatic=[0, 1], driver=[0, 0], factor=[1.0, -1.0], offset=[0.0, -0.05]
    )
    axes = axes_of(tree, 20, lower=0.0, upper=0.2)
    verdict = prove_cells(tree, axes).verdict  # distance of the centres: 2 q + 0.05, contact at q = 0.025
    edges = axes[0].edges
    assert (verdict[edges[:-1] > 0.0251] == FREE).all()
    assert (verdict[edges[1:] < 0.026] == COLLISION).all()


def test_gap_of_a_mesh_that_is_not_convex() -> None:
    parts = [trees.block((-1, -0.1, -1), (1, 0.1, -0.9)), trees.block((-1, -0.1, 0.9), (1, 0.1, 1)),
             trees.block((-1, -0.1, -1), (-0.9, 0.1, 1))]  # fmt: skip
    frame = trees.mesh("frame", -1, parts)
    bar = trees.box("bar", 0, (0.5, 0.05, 0.05), (0, 0, 0))
    tree = trees.tree([(-1, trees.pose(), (1, 0, 0))], [bar, frame], [(0, 1)], prismatic=[0])
    axes = axes_of(tree, 20, lower=-1.0, upper=1.0)
    verdict = prove_cells(tree, axes).verdict
    assert (verdict[axes[0].edges[:-1] > -0.64] == FREE).all()
    assert (verdict[axes[0].edges[1:] < -0.64] == COLLISION).all()


@pytest.mark.parametrize("links", [1, 2, 3, 4])
def test_one_to_four_joints_and_one_cell_per_axis(links: int) -> None:
    tree = planar_arm(trees.box("post", -1, (0.3, 0.3, 1), (0.35, 0.35, 0)), links=links, length=0.6)
    axes = axes_of(tree, 6)
    proof = prove_cells(tree, axes)
    assert {FREE, COLLISION} <= set(np.unique(proof.verdict))
    check(tree, axes, proof)
    assert prove_cells(tree, axes_of(tree, 1)).verdict.item() == COLLISION
    away = planar_arm(trees.box("post", -1, (0.3, 0.3, 1), (9, 0.6, 0)), links=links, length=0.6)
    away = trees.tree(
        [(p, m, d) for p, m, d in zip(away.parent, away.placement, away.direction, strict=True)], away.bodies,
        [(links - 1, links)],
    )  # fmt: skip
    assert prove_cells(away, axes_of(away, 1)).verdict.item() == FREE


def test_robot_above_a_half_space() -> None:
    tree = trees.tree(
        [(-1, trees.pose((0, 0, 0.5)), (0, 1, 0))],
        [trees.ball("tip", 0, 0.1, (1, 0, 0)), trees.half_space("floor")],
        [(0, 1)],
    )
    axes = axes_of(tree, 64)
    verdict = prove_cells(tree, axes).verdict  # the tip is at z = 0.5 - sin(q), contact at sin(q) = 0.4
    sines = np.sin(np.linspace(axes[0].edges[:-1], axes[0].edges[1:], 50))
    assert (verdict[sines.max(axis=0) < 0.4 - 2e-5] == FREE).all()
    assert (verdict[sines.min(axis=0) > 0.4 + 2e-5] == COLLISION).all()


def test_number_of_cells_that_is_not_a_power_of_two() -> None:
    tree = planar_arm(trees.ball("ball", -1, 0.3, (1, 1, 0)))
    for cells in ((13, 7), (1, 9), (3, 17)):
        axes = axes_of(tree, *cells)
        proof = prove_cells(tree, axes)
        assert proof.verdict.shape == cells
        check(tree, axes, proof)


@pytest.mark.slow
def test_result_does_not_depend_on_the_executor(processes: Executor) -> None:
    tree = planar_arm(trees.box("post", -1, (0.3, 0.3, 1), (1.2, 0.6, 0)), links=2)
    axes = axes_of(tree, 20)
    alone = prove_cells(tree, axes)
    with ThreadPoolExecutor(3) as threads:
        for executor in (threads, processes):
            other = prove_cells(tree, axes, executor=executor)
            assert (other.verdict == alone.verdict).all()
            assert (other.bounds, other.probes, other.tests) == (alone.bounds, alone.probes, alone.tests)


def test_interrupted_run_continues_from_its_checkpoint(tmp_path: Path) -> None:
    tree = planar_arm(trees.box("post", -1, (0.3, 0.3, 1), (1.2, 0.6, 0)), links=2)
    axes, file = axes_of(tree, 20), tmp_path / "cells.jsonl"
    calls: list[tuple[int, int]] = []

    def stop(done: int, total: int) -> None:
        calls.append((done, total))
        if len(calls) == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        prove_cells(tree, axes, progress=stop, checkpoint=file)
    calls.clear()
    lines = file.read_text().count("\n")
    proof = prove_cells(tree, axes, progress=lambda *call: calls.append(call), checkpoint=file)
    assert lines == 6
    assert calls[-1] == (20 + 400, 20 + 400)
    whole = prove_cells(tree, axes)
    assert (proof.verdict == whole.verdict).all()
    assert (proof.bounds, proof.tests) == (whole.bounds, whole.tests)
    with pytest.raises(rg.errors.InputError, match="belongs to another run"):
        prove_cells(tree, axes_of(tree, 21), checkpoint=file)
    text = file.read_text().splitlines()
    file.write_text("\n".join([text[0], text[1].replace('"verdict":"', '"verdict":"9'), *text[2:]]) + "\n")
    with pytest.raises(rg.errors.InputError, match="block 0 of group 0 does not fit the grid"):
        prove_cells(tree, axes, checkpoint=file)


def test_key_of_a_proof_depends_on_its_inputs() -> None:
    tree = planar_arm(trees.box("post", -1, (0.3, 0.3, 1), (1.2, 0.6, 0)), links=2)
    moved = planar_arm(trees.box("post", -1, (0.3, 0.3, 1), (1.2, 0.6, 1e-9)), links=2)
    keys = {
        proof_key(tree, axes_of(tree, 20)), proof_key(moved, axes_of(tree, 20)), proof_key(tree, axes_of(tree, 21)),
        proof_key(tree, axes_of(tree, 20), halvings=2),
    }  # fmt: skip
    assert len(keys) == 4
    assert proof_key(planar_arm(*tree.bodies[2:], links=2), axes_of(tree, 20)) in keys


def test_centres_are_tested_exactly() -> None:
    tree = planar_arm(trees.box("post", -1, (0.3, 0.3, 1), (1.2, 0.6, 0)), links=3)
    axes = axes_of(tree, 9)
    grid = np.stack(np.meshgrid(*(axis.centres for axis in axes), indexing="ij"), axis=-1)
    expected = CollisionChecker(tree).collides(grid.reshape(-1, 3)).reshape(grid.shape[:-1])
    calls: list[tuple[int, int]] = []
    assert (centre_cells(tree, axes, lambda *call: calls.append(call)) == expected).all()
    assert calls[-1][0] == calls[-1][1]


def test_wrong_number_of_axes() -> None:
    tree = planar_arm(links=2)
    with pytest.raises(rg.errors.InputError, match=r"2 moving joints \(q0, q1\), got 1 axes; give one axis for every"):
        prove_cells(tree, axes_of(tree, 3)[:1])
    assert (prove_cells(tree, axes_of(tree, 3)).verdict == FREE).all()
