"""Pairs of a robot's bodies that are tested for self-collision, and adjacent links, which may touch."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from resgrid.robots.convex import Body
from resgrid.robots.urdf.description import Description


def adjacent_pairs(robot: Description) -> frozenset[frozenset[str]]:
    """Return the pairs of names of links that one joint connects, or a chain of joints through links without geometry.

    These links may touch each other if no SRDF file says otherwise.
    """
    above: dict[str, str] = {}  # the nearest link above with geometry
    for joint in robot.joints.values():
        parent = joint.parent
        above[joint.child] = parent if robot.links[parent] or parent not in above else above[parent]
    return frozenset(frozenset(pair) for pair in above.items())


def self_pairs(bodies: Sequence[Body], links: Sequence[str], allowed: Collection[frozenset[str]]) -> NDArray[np.int64]:
    """Return the indices (p, 2) of the pairs of bodies of a robot that must not touch each other.

    Two bodies that the same joint carries never move relative to each other and are no pair.  The first body of a pair
    moves with a joint.

    `links`: name of the link of every body; `allowed`: pairs of links that may touch each other.
    """
    pairs = [
        (a, b) if bodies[a].joint >= bodies[b].joint else (b, a)
        for a, b in combinations(range(len(bodies)), 2)
        if bodies[a].joint != bodies[b].joint and frozenset((links[a], links[b])) not in allowed
    ]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)
