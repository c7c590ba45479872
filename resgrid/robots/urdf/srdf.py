"""Reader of SRDF files: the pairs of links whose collisions are disabled."""

from __future__ import annotations

from collections.abc import Collection
from itertools import combinations
from pathlib import Path

from resgrid.errors import InputError, suggestion
from resgrid.robots.urdf.description import read_robot
from resgrid.robots.urdf.elements import attribute

_MAX_LISTED = 5
"""Largest number of unknown links that an error message lists."""


def disabled_pairs(file: Path, links: Collection[str]) -> frozenset[frozenset[str]]:
    """Return the pairs of links whose collisions an SRDF file disables.

    ``<disable_default_collisions link="...">`` disables all pairs of a link, and ``<enable_collisions>`` enables a pair
    again, as in MoveIt.

    Parameters
    ----------
    file : Path
        Path of the SRDF file.
    links : collection of str
        Names of the links of the robot.

    Raises
    ------
    InputError
        If the file is missing or not an SRDF file, or names links in these elements that the robot does not have.
    """
    robot = read_robot(file)
    tags = ("disable_collisions", "enable_collisions")
    pairs = {
        tag: {
            frozenset(attribute(each, key, f"{file}: <{tag}>") for key in ("link1", "link2"))
            for each in robot.findall(tag)
        }
        for tag in tags
    }
    passive = {attribute(each, "link", f"{file}: <{each.tag}>") for each in robot.findall("disable_default_collisions")}
    named = set().union(*pairs[tags[0]], *pairs[tags[1]], passive)
    unknown = sorted(named - set(links))
    if unknown:
        listed = ", ".join(map(repr, unknown[:_MAX_LISTED])) + ", ..." * (len(unknown) > _MAX_LISTED)
        hint = suggestion(unknown[0], links)
        raise InputError(
            f"{file}: this is the SRDF of another robot: the URDF has no link {listed}"
            + (
                f"; {hint}"
                if hint and len(unknown) == 1
                else "; give the SRDF that belongs to the URDF, or remove their pairs"
            )
        )
    defaults = {frozenset(pair) for pair in combinations(links, 2) if passive.intersection(pair)}
    return frozenset((defaults - pairs[tags[1]]) | pairs[tags[0]])
