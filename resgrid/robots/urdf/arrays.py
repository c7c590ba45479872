"""Kinematic trees, convex pieces and pairs of bodies as flat arrays, the input of the compiled kernels."""

from __future__ import annotations

from collections.abc import Sequence
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
"""Ratio of the summed volume of a body's convex pieces to the volume of its hull; below this ratio a body is loose.

Proofs for a loose body start with its pieces; proofs for other bodies start with the hull.
"""


BALL_STEPS = 50
"""Number of steps of the search for a small ball around a piece with more than 8 points.

The ball around a smaller piece is centred in the piece's bounding box.
"""


class TreeArrays(NamedTuple):
    """The k joints and p convex pieces of a kinematic tree, input of the kernels.

    Joints: `parent` (k,): joint whose frame carries a joint, -1 for the world; `driver` (k,): index of the moving joint
    (axis of the space) that determines a joint's value; `factor, offset` (k,): the value is ``factor *
    configuration[driver] + offset``, in radians or metres; `rotation` (k, 3, 3), `translation` (k, 3): pose of a
    joint's frame in its parent's frame at the value 0, in metres; `direction` (k, 3): unit vector along the joint's
    axis, in its own frame; `prismatic` (k,): whether the joint translates.

    Pieces: `x, y, z` (v,): points of all pieces, in metres, in the frame of the body's joint; `first` (p + 1,): piece i
    owns the points ``first[i] .. first[i + 1] - 1``; `radius` (p,): distance in metres from the hull of these points up
    to which space belongs to the piece; `centre` (p, 3), `reach` (p,): centre and radius of a ball around the piece, in
    metres; `joint` (p,): joint that moves the piece, -1 for none; `flat` (p,): whether the piece is a half-space;
    `normal` (p, 3): unit normal of the half-space, which points out of it; 0 for other pieces.

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
        Joints, convex pieces and chains of joints, the input of the kernels.
    hull : ndarray of int64, shape (bodies,)
        Index of the piece that is the convex hull of the body, with padding.
    spans : ndarray of int64, shape (bodies, 2)
        First index, and last index plus 1, of the pieces whose union contains a body.
    is_loose : ndarray of bool, shape (bodies,)
        Whether the pieces of a body have less than `LOOSE` of the volume of its hull, so that proofs start with them.
    drivers : tuple of tuple of int
        For every pair: sorted indices of the moving joints that change the relative pose of its bodies.
    """

    tree: TreeArrays
    hull: Integers
    spans: Integers
    is_loose: Flags
    drivers: tuple[tuple[int, ...], ...]


def proof_arrays(tree: KinematicTree) -> ProofArrays:
    """Return the arrays of a tree for the kernels.

    Raises InputError for a half-space that moves or is the first body of a pair, for a body without points, and for
    values that are not finite.
    """
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
        _check_pieces(body, pieces[spans[-1][0] :])
    for first, second in tree.pairs:
        if tree.bodies[first].hull.normal is not None:
            raise InputError(
                f"{tree.bodies[first].name} is a half-space; put it second in its pair with {tree.bodies[second].name}"
            )
    if not all(np.isfinite(values).all() for values in (tree.placement, tree.direction, tree.factor, tree.offset)):
        raise InputError("a joint has a pose, an axis or a factor that is not finite; check the file of the robot")
    chains = [pair_chains(tree, int(a), int(b)) for a, b in tree.pairs]
    drivers = tuple(tuple(sorted({int(tree.driver[j]) for side in sides for j in side})) for sides in chains)
    arrays = _tree_arrays(tree, pieces, joints, chains)
    is_loose = np.array([_is_loose(body) for body in tree.bodies], dtype=np.bool_)
    return ProofArrays(arrays, np.array(hull, np.int64), np.array(spans, np.int64).reshape(-1, 2), is_loose, drivers)


def _check_pieces(body: Body, pieces: Sequence[ConvexPiece]) -> None:
    """Raise InputError for a half-space that moves with a joint, and for a piece without points or with invalid values.

    Invalid are coordinates and radii that are not finite, and negative radii. `pieces`: all pieces of `body`.
    """
    if body.joint >= 0 and any(piece.normal is not None for piece in pieces):
        raise InputError(f"{body.name} is a half-space and moves with a joint; use a box in its place")
    for piece in pieces:
        is_finite = np.isfinite(piece.points).all() and np.isfinite(piece.radius) and piece.radius >= 0.0
        if not len(piece.points) or not is_finite:
            raise InputError(
                f"{body.name} has no points, or a point that is not finite; check its mesh, its pose and its sizes"
            )


def _is_loose(body: Body) -> bool:
    """Return whether the summed volume of a body's convex pieces is below `LOOSE` (0.8) times the volume of its hull.

    False for a body with a single piece, and for a half-space.
    """
    if len(body.pieces) < 2 or body.hull.normal is not None:
        return False
    return sum(map(_volume, body.pieces)) < LOOSE * _volume(body.hull)


def _volume(piece: ConvexPiece) -> float:
    """Return the volume of the convex hull of a piece's points in cubic metres, without the radius; 0 if it is flat."""
    try:
        return float(ConvexHull(piece.points).volume)
    except (QhullError, ValueError):
        return 0.0


def pair_chains(tree: KinematicTree, first: int, second: int) -> tuple[list[int], list[int]]:
    """Return the joints between the common ancestor and each of two bodies, the nearest to the ancestor first.

    The common ancestor is the last joint that carries both bodies, or the world. `first, second`: indices of the
    bodies. The two lists of joint indices contain the joint of the respective body and exclude the ancestor.
    """
    ancestors = [_ancestors(tree, tree.bodies[body].joint) for body in (first, second)]
    common = set(ancestors[0]) & set(ancestors[1])
    one, other = ([joint for joint in reversed(side) if joint not in common] for side in ancestors)
    return one, other


def _ancestors(tree: KinematicTree, joint: int) -> list[int]:
    """Return the indices of a joint and of the joints that carry it, the nearest to the world last; [] for -1."""
    found = []
    while joint >= 0:
        found.append(joint)
        joint = int(tree.parent[joint])
    return found


def _tree_arrays(
    tree: KinematicTree, pieces: list[ConvexPiece], joints: list[int], chains: list[tuple[list[int], list[int]]]
) -> TreeArrays:
    """Return the joints and pieces of a tree as arrays for the kernels.

    `pieces`: convex pieces of all bodies; `joints`: index of the joint that moves each piece, -1 for none; `chains`:
    for every pair of bodies, the joints between the common ancestor and each body (see `pair_chains`).
    """
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
        normal=_floats([_unit(piece.normal) for piece in pieces]).reshape(-1, 3),
        chain=chain,
    )


def _floats(values: ArrayLike) -> Floats:
    """Return a writable float64 copy in C order, so that kernels are compiled for one memory layout only."""
    return np.array(values, dtype=np.float64, order="C")


def _integers(values: ArrayLike) -> Integers:
    """Return a writable int64 copy in C order, so that kernels are compiled for one memory layout only."""
    return np.array(values, dtype=np.int64, order="C")


def _flags(values: ArrayLike) -> Flags:
    """Return a writable bool copy in C order, so that kernels are compiled for one memory layout only."""
    return np.array(values, dtype=np.bool_, order="C")


def _unit(normal: Floats | None) -> Floats:
    """Return the unit vector (3,) along the normal (3,) of a half-space; zeros for None (a piece of another kind)."""
    return np.zeros(3) if normal is None else np.asarray(normal / np.linalg.norm(normal))


def _ball(piece: ConvexPiece) -> tuple[Floats, float]:
    """Return centre (3,) and radius, in metres, of a ball around a piece; the radius of a half-space is infinite."""
    if piece.normal is not None:
        return np.asarray(piece.points[0]), np.inf
    centre = (piece.points.min(axis=0) + piece.points.max(axis=0)) / 2
    for step in range(2, 2 + (BALL_STEPS if len(piece.points) > 8 else 0)):  # Badoiu and Clarkson (2003)
        offset = piece.points - centre
        centre = centre + offset[np.argmax((offset * offset).sum(axis=1))] / step
    return centre, float(np.linalg.norm(piece.points - centre, axis=1).max()) * (1 + 1e-12) + piece.radius
