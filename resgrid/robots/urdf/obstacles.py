"""Addition of obstacle bodies to a robot's kinematic tree, with the pairs that collision tests must check."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace

import numpy as np

from resgrid.errors import InputError, suggestion
from resgrid.robots.convex import Body
from resgrid.robots.urdf.contact import touch
from resgrid.robots.urdf.tree import KinematicTree


def with_obstacles(tree: KinematicTree, bodies: Sequence[Body], mounted: Sequence[str] = ()) -> KinematicTree:
    """Return a tree with additional bodies of the surroundings and their pairs with the bodies of the robot.

    Parameters
    ----------
    tree : KinematicTree
        Robot, possibly with other surroundings.
    bodies : sequence of Body
        Bodies that do not move (joint -1).
    mounted : sequence of str
        Links of the robot that may touch these bodies.

    Raises
    ------
    InputError
        If a mounted link is unknown, a body of the surroundings moves with a joint, or a body touches a link that never
        moves and is not mounted.
    ToolMissingError
        If coal, which tests contact with links that never move, is not installed.
    """
    check_links(mounted, tree.tools, "mounted", "robot")
    for body in bodies:
        if body.joint != -1:
            raise InputError(f"{body.name}: a body of the surroundings has joint {body.joint}; it needs joint -1")
    robots = [index for index in range(len(tree.bodies)) if _is_of_robot(tree, index)]
    pairs = [tree.pairs]
    for index in robots:
        body = tree.bodies[index]
        if _link_of(body, tree.tools) in mounted:
            continue
        if body.joint >= 0:
            others = np.arange(len(tree.bodies), len(tree.bodies) + len(bodies))
            pairs.append(np.column_stack([np.full(len(others), index), others]))
        else:
            _check_apart(body, bodies, tree.tools)
    return replace(tree, bodies=(*tree.bodies, *bodies), pairs=np.concatenate(pairs).astype(np.int64))


def check_links(links: Sequence[str], known: Collection[str], key: str, place: str) -> None:
    """Raise InputError unless all names are links of a robot; `key`, `place`: argument and place in the message."""
    if isinstance(links, str):
        raise InputError(f"{place}: {key} = {links!r} must be a list of links: [{links!r}]")
    for link in links:
        if link not in known:
            hint = suggestion(link, known) or f"links of the robot: {', '.join(known)}"
            raise InputError(f"{place}: {key} names an unknown link {link!r}; {hint}")


def _is_of_robot(tree: KinematicTree, index: int) -> bool:
    """Return whether a body belongs to a link of the robot, not to the surroundings; `index`: index of the body."""
    body = tree.bodies[index]
    return body.joint >= 0 or _link_of(body, tree.tools) in tree.tools


def _link_of(body: Body, links: Iterable[str]) -> str:
    """Return the name of a body without the number of a link with several bodies: ``"hand"`` for ``"hand[1]"``.

    The result is a link if the body belongs to the robot. A body that has the name of a link keeps its name. `links`:
    names of the links.
    """
    if body.name in links:
        return body.name
    link, bracket, number = body.name.rpartition("[")
    return link if bracket and number.removesuffix("]").isdecimal() else body.name


def _check_apart(body: Body, obstacles: Iterable[Body], links: Iterable[str]) -> None:
    """Raise InputError if a body of a link that never moves touches one of the `obstacles`.

    `links`: names of the links of the robot, for the message.
    """
    for obstacle in obstacles:
        if touch(body, obstacle):
            link = _link_of(body, links)
            raise InputError(
                f"link {link!r}, which does not move, touches {obstacle.name}: no motion can separate them; allow the"
                f" contact with mounted = [{link!r}], or move the obstacle"
            )
