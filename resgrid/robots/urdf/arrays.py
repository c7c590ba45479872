"""Kinematic trees, convex pieces and pairs of bodies as flat arrays for the kernels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull, QhullError

from resgrid.errors import InputError
from resgrid.robots.convex import Body, ConvexPiece
from resgrid.robots.urdf.tree import KinematicTree

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]


LOOSE = 0.8
"""Fraction of the hull's volume below which the pieces of a body replace the hull from the start."""


BALL_STEPS = 50
"""Number of steps of the search for a small ball around a piece."""


class TreeArrays(NamedTuple):
    """Joints and convex pieces of a tree, input of the kernels.

    `parent, driver` (k,); `rotation` (k, 3, 3), `translation` (k, 3): placement of a joint in its parent's frame;
    `direction` (k, 3); `prismatic` (k,); `factor, offset` (k,): see `KinematicTree`.
    `x, y, z` (v,): points of all pieces, in metres, in the frame of the body's joint; `first` (p + 1,): piece i owns
    the points ``first[i] .. first[i + 1] - 1``; `radius` (p,): of the pieces, in metres; `centre` (p, 3), `reach` (p,):
    ball around a piece; `joint` (p,): joint that moves a piece, -1 for the world; `flat` (p,): whether a piece is a
    half-space; `normal` (p, 3): its unit normal, which points out of it.
    `chain` (pairs, 2, longest): joints between the common ancestor and the first and the second body of a pair, the
    nearest to the ancestor first, padded by -1.
    """

    parent: Integers
    driver: Integers
    rotation: Floats
    translation: Floats
    direction: Floats
    prismatic: Flags
    factor: Floats
    offset: Floats
    x: Floats
    y: Floats
    z: Floats
    first: Integers
    radius: Floats
    centre: Floats
    reach: Floats
    joint: Integers
    flat: Flags
    normal: Floats
    chain: Integers


@dataclass(frozen=True, eq=False)
class ProofArrays:
    """Arrays of a tree, with the pieces of every body and the joints on which every pair depends.

    Attributes
    ----------
    tree : TreeArrays
        Input of the kernels.
    hull : ndarray of int64, shape (bodies,)
        Index of the piece that contains a whole body.
    spans : ndarray of int64, shape (bodies, 2)
        First index, and last index plus 1, of the pieces whose union contains a body.
    is_loose : ndarray of bool, shape (bodies,)
        Whether the pieces of a body are much smaller than the hull, so that proofs start with the pieces.
    drivers : tuple of tuple of int
        For every pair: sorted indices of the moving joints that change the relative pose of its bodies.
    """

    tree: TreeArrays
    hull: Integers
    spans: Integers
    is_loose: Flags
    drivers: tuple[tuple[int, ...], ...]


def proof_arrays(tree: KinematicTree) -> ProofArrays:
    """Return the arrays of a tree; raise InputError for a half-space that moves, or a point that is not finite."""
    pieces: list[ConvexPiece] = []
    joints: list[int] = []
    hull, spans = [], []
    for body in tree.bodies:
        own = body.pieces or (body.hull,)
        spans.append((len(pieces), len(pieces) + len(own)))
        is_whole = len(own) == 1 and own[0] is body.hull
        hull.append(len(pieces) if is_whole else len(pieces) + len(own))
        pieces += own if is_whole else (*own, body.hull)
        joints += [body.joint] * (len(pieces) - len(joints))
        if body.joint >= 0 and any(piece.normal is not None for piece in pieces[spans[-1][0] :]):
            raise InputError(f"{body.name} is a half-space and moves with a joint; use a box in its place")
        if not all(np.isfinite(piece.points).all() and piece.radius >= 0 for piece in pieces[spans[-1][0] :]):
            raise InputError(f"{body.name} has a point that is not finite; check its mesh, its pose and its sizes")
    chains = [pair_chains(tree, int(a), int(b)) for a, b in tree.pairs]
    drivers = tuple(tuple(sorted({int(tree.driver[j]) for side in sides for j in side})) for sides in chains)
    arrays = _tree_arrays(tree, pieces, joints, chains)
    is_loose = np.array([_is_loose(body) for body in tree.bodies], dtype=np.bool_)
    return ProofArrays(arrays, np.array(hull, np.int64), np.array(spans, np.int64).reshape(-1, 2), is_loose, drivers)


def _is_loose(body: Body) -> bool:
    """Return whether the pieces of a body have less than a fraction of `LOOSE` of the volume of its hull."""
    if len(body.pieces) < 2 or body.hull.normal is not None:
        return False
    return sum(map(_volume, body.pieces)) < LOOSE * _volume(body.hull)


def _volume(piece: ConvexPiece) -> float:
    """Return the volume of the core of a piece in cubic metres; 0 if the core is flat."""
    try:
        return float(ConvexHull(piece.points).volume)
    except (QhullError, ValueError):
        return 0.0


def pair_chains(tree: KinematicTree, first: int, second: int) -> tuple[list[int], list[int]]:
    """Return the joints between the common ancestor and each of two bodies, the nearest to the ancestor first."""
    ancestors = [_ancestors(tree, tree.bodies[body].joint) for body in (first, second)]
    common = set(ancestors[0]) & set(ancestors[1])
    one, other = ([joint for joint in reversed(side) if joint not in common] for side in ancestors)
    return one, other


def _ancestors(tree: KinematicTree, joint: int) -> list[int]:
    """Return a joint and the joints that carry it, the nearest to the world last."""
    found = []
    while joint >= 0:
        found.append(joint)
        joint = int(tree.parent[joint])
    return found


def _tree_arrays(
    tree: KinematicTree, pieces: list[ConvexPiece], joints: list[int], chains: list[tuple[list[int], list[int]]]
) -> TreeArrays:
    """Return the input of the kernels; `joints` (p,): joints of the pieces; `chains`: of every pair."""
    longest = max((len(side) for sides in chains for side in sides), default=0)
    chain = np.full((len(chains), 2, max(longest, 1)), -1, dtype=np.int64)
    for row, sides in enumerate(chains):
        for side, path in enumerate(sides):
            chain[row, side, : len(path)] = path
    centre, reach = zip(*(_ball(piece) for piece in pieces), strict=True) if pieces else ((), ())
    points = np.concatenate([np.zeros((0, 3)), *(piece.points for piece in pieces)])
    return TreeArrays(
        parent=_integers(tree.parent),
        driver=_integers(tree.driver),
        rotation=_floats(tree.placement[:, :3, :3]),
        translation=_floats(tree.placement[:, :3, 3]),
        direction=_floats(tree.direction),
        prismatic=_flags(tree.is_prismatic),
        factor=_floats(tree.factor),
        offset=_floats(tree.offset),
        x=_floats(points[:, 0]),
        y=_floats(points[:, 1]),
        z=_floats(points[:, 2]),
        first=_integers([0, *np.cumsum([len(piece.points) for piece in pieces])]),
        radius=_floats([piece.radius for piece in pieces]),
        centre=_floats(centre).reshape(-1, 3),
        reach=_floats(reach),
        joint=_integers(joints),
        flat=_flags([piece.normal is not None for piece in pieces]),
        normal=_floats([np.zeros(3) if piece.normal is None else piece.normal for piece in pieces]).reshape(-1, 3),
        chain=chain,
    )


def _floats(values: ArrayLike) -> Floats:
    """Return a writable copy in C order, so that kernels are compiled for one memory layout only."""
    return np.array(values, dtype=np.float64, order="C")


def _integers(values: ArrayLike) -> Integers:
    """Return a writable copy in C order, so that kernels are compiled for one memory layout only."""
    return np.array(values, dtype=np.int64, order="C")


def _flags(values: ArrayLike) -> Flags:
    """Return a writable copy in C order, so that kernels are compiled for one memory layout only."""
    return np.array(values, dtype=np.bool_, order="C")


def _ball(piece: ConvexPiece) -> tuple[Floats, float]:
    """Return centre (3,) and radius, in metres, of a ball around a piece; the radius of a half-space is infinite."""
    if piece.normal is not None:
        return np.asarray(piece.points[0]), np.inf
    centre = (piece.points.min(axis=0) + piece.points.max(axis=0)) / 2
    for step in range(2, 2 + (BALL_STEPS if len(piece.points) > 8 else 0)):  # Badoiu and Clarkson (2003)
        offset = piece.points - centre
        centre = centre + offset[np.argmax((offset * offset).sum(axis=1))] / step
    return centre, float(np.linalg.norm(piece.points - centre, axis=1).max()) * (1 + 1e-12) + piece.radius
