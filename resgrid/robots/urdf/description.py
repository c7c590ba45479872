"""URDF files as links and joints, before any decision about which joints move.

The parser reads the elements that matter for kinematics and collisions and ignores all others (inertia, visuals,
transmissions, Gazebo).  It needs no other package, so that a file that a C++ library rejects gives one clear message.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.files import read_bytes
from resgrid.errors import InputError, suggestion
from resgrid.robots.urdf.elements import attribute, origin_of, scalar, vector

MAX_BYTES = 1 << 28
"""Maximum size of a URDF or SRDF file, in bytes; larger files raise InputError."""

JointKind = Literal["revolute", "continuous", "prismatic", "fixed", "floating", "planar"]
"""Joint types of the URDF format; other types raise InputError."""

SHAPES = ("box", "cylinder", "sphere", "capsule", "mesh")
"""Names of the geometry elements that a collision element may contain; each contains exactly one."""


@dataclass(frozen=True, eq=False)
class Geometry:
    """A collision geometry of a link.

    `shape`: name of the element, an entry of `SHAPES`; `size`: lengths in metres: three sides of a box; radius and
    length of a cylinder; radius and length of the straight part of a capsule; radius of a sphere; empty for a mesh;
    `placement` (4, 4): pose in the link's frame; `mesh`: address of the mesh file as written, empty for other shapes;
    `scale`: factors on the coordinates of the mesh file along its axes, possibly negative.
    """

    shape: str
    size: tuple[float, ...]
    placement: NDArray[np.float64]
    mesh: str = ""
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint of the URDF file.

    `name, kind`: name and type; `parent, child`: names of the links that it connects; `placement` (4, 4): pose of the
    joint's frame in the parent link's frame at the joint value 0; `axis` (3,): unit vector along the axis, in the
    joint's frame; `limits`: lower and upper limit in radians or metres, None without limits; `velocity`: speed limit in
    rad/s or m/s, infinite without one; `mimic`: name of the driving joint, factor and offset of a joint with the value
    ``factor * driver + offset``, None for an independent joint.
    """

    name: str
    kind: JointKind
    parent: str
    child: str
    placement: NDArray[np.float64]
    axis: NDArray[np.float64]
    limits: tuple[float, float] | None
    velocity: float
    mimic: tuple[str, float, float] | None


@dataclass(frozen=True, eq=False)
class Description:
    """The content of a URDF file.

    `file`: path of the file; `root`: name of the link that is no joint's child; `links`: collision geometries of every
    link, by name; `joints`: joints by name, parents before children.
    """

    file: Path
    root: str
    links: Mapping[str, tuple[Geometry, ...]]
    joints: Mapping[str, Joint]


def read_description(file: Path) -> Description:
    """Return the links and joints of a URDF file.

    Parameters
    ----------
    file : Path
        Path of the file.

    Returns
    -------
    Description
        Links with their collision geometries, and joints sorted from the root outwards.

    Raises
    ------
    InputError
        If the file is missing, is not XML or not a robot, has an invalid element, or its links and joints form no tree.
    """
    robot = read_robot(file)
    links: dict[str, tuple[Geometry, ...]] = {}
    _check_unique("link", (attribute(link, "name", f"{file}: a link") for link in robot.findall("link")), file)
    _check_unique("joint", (attribute(joint, "name", f"{file}: a joint") for joint in robot.findall("joint")), file)
    for link in robot.findall("link"):
        name = link.get("name", "").strip()
        links[name] = tuple(_geometry(each, f"{file}: link {name!r}") for each in link.findall("collision"))
    if not links:
        raise InputError(f"{file}: the robot has no links; is it the right file?")
    joints = [_joint(each, str(file)) for each in robot.findall("joint")]
    root, order = _sorted_joints(links, joints, file)
    _check_mimics(order, file)
    return Description(file, root, links, order)


def read_robot(file: Path) -> Element:
    """Return the root element ``<robot>`` of a URDF or SRDF file.

    Raises InputError for a file that is missing, too large or not XML, has another root element, or has xacro macros.
    """
    data = read_bytes(file, MAX_BYTES)
    try:
        robot = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError) as error:  # LookupError: an unknown encoding
        raise InputError(f"{file}: this is not valid XML ({error}); repair the file") from None
    if robot.tag != "robot":
        raise InputError(f"{file}: the file describes no robot: its element is <{robot.tag}>, not <robot>")
    macros = [each.tag for each in robot.iter() if isinstance(each.tag, str) and "xacro" in each.tag]
    if macros:
        raise InputError(f"{file}: the file contains xacro macros; convert it first: xacro {file.name} > robot.urdf")
    return robot


def _check_unique(kind: str, names: Iterable[str], file: Path) -> None:
    """Raise InputError if two elements have the same name; `kind`: "link" or "joint", for the message."""
    repeated = [name for name, count in Counter(names).items() if count > 1]
    if repeated:
        raise InputError(f"{file}: {kind} {repeated[0]!r} is defined more than once; give every {kind} its own name")


def _geometry(collision: Element, place: str) -> Geometry:
    """Return the geometry of a collision element; raise InputError unless it contains one valid geometry.

    `place`: file and link, for messages.
    """
    parent = collision.find("geometry")
    found = [] if parent is None else [each for each in parent if isinstance(each.tag, str)]
    if len(found) != 1 or found[0].tag not in SHAPES:
        tags = ", ".join(f"<{each.tag}>" for each in found) or "nothing"
        raise InputError(f"{place}: <collision> contains {tags}; it needs one of {', '.join(SHAPES)}")
    shape, placement = found[0], origin_of(collision, place)
    place = f"{place}: {shape.tag}"
    if shape.tag == "mesh":
        x, y, z = vector(shape, "scale", "1 1 1", place).tolist()
        if not x * y * z:
            raise InputError(f"{place}: scale = {shape.get('scale')!r} must not contain 0")
        return Geometry("mesh", (), placement, attribute(shape, "filename", place), (x, y, z))
    if shape.tag == "box":
        size = tuple(vector(shape, "size", attribute(shape, "size", place), place).tolist())
    else:
        names = ("radius",) if shape.tag == "sphere" else ("radius", "length")
        size = tuple(scalar(shape, name, None, place) for name in names)
    if min(size) < 0 or not max(size):
        raise InputError(f"{place}: lengths {' '.join(map(repr, size))} must not be negative, and not all of them 0")
    return Geometry(shape.tag, size, placement)


def _joint(element: Element, file: str) -> Joint:
    """Return the joint that an element ``<joint>`` describes.

    Raises InputError for an unknown type, a missing link, a reversed range, a zero axis or text that is no number.
    """
    name = attribute(element, "name", f"{file}: a joint")
    place = f"{file}: joint {name!r}"
    kind = attribute(element, "type", place)
    if kind not in get_args(JointKind):
        hint = suggestion(kind, get_args(JointKind)) or f"known types: {', '.join(get_args(JointKind))}"
        raise InputError(f"{place}: unknown type {kind!r}; {hint}")
    ends = []
    for tag in ("parent", "child"):
        end = element.find(tag)
        if end is None:
            raise InputError(f'{place}: no element <{tag}>; add <{tag} link="..."/>')
        ends.append(attribute(end, "link", place))
    axis = vector(element.find("axis"), "xyz", "1 0 0", f"{place}: axis")
    length = float(np.linalg.norm(axis))
    if kind in ("revolute", "continuous", "prismatic") and not length:
        raise InputError(f"{place}: axis = 0 0 0 has no direction; give a vector that is not zero")
    limits, velocity = _limits(element.find("limit"), kind, place)
    return Joint(
        name, kind, ends[0], ends[1], origin_of(element, place), axis / (length or 1.0),  # type: ignore[arg-type]
        limits, velocity, _mimic(element.find("mimic"), place),
    )  # fmt: skip


def _limits(limit: Element | None, kind: str, place: str) -> tuple[tuple[float, float] | None, float]:
    """Return the range of a joint in radians or metres, None without one, and its speed limit in rad/s or m/s.

    The speed limit is infinite without the element, without its attribute ``velocity`` and for 0, which some files use
    for an unknown limit. Only revolute and prismatic joints have a range. `limit`: element ``<limit>`` or None; `kind`:
    type of the joint; `place`: file and joint, for messages.
    """
    if limit is None:
        return None, float("inf")
    velocity = scalar(limit, "velocity", 0.0, place)
    if velocity < 0:
        raise InputError(f"{place}: velocity = {velocity!r} must not be negative")
    limits = None
    if kind in ("revolute", "prismatic") and (limit.get("lower") is not None or limit.get("upper") is not None):
        lower, upper = scalar(limit, "lower", 0.0, place), scalar(limit, "upper", 0.0, place)
        if lower > upper:
            raise InputError(
                f"{place}: the limits are reversed: lower = {lower!r} lies above upper = {upper!r}; swap them"
            )
        limits = lower, upper
    return limits, velocity or float("inf")


def _mimic(mimic: Element | None, place: str) -> tuple[str, float, float] | None:
    """Return driving joint, factor and offset of an element ``<mimic>``; None without this element.

    The defaults are 1 for the factor and 0 for the offset. `place`: file and joint, for messages.
    """
    if mimic is None:
        return None
    place = f"{place}: mimic"
    driver = attribute(mimic, "joint", place)
    return driver, scalar(mimic, "multiplier", 1.0, place), scalar(mimic, "offset", 0.0, place)


def _sorted_joints(links: Iterable[str], joints: list[Joint], file: Path) -> tuple[str, dict[str, Joint]]:
    """Return the root link, and the joints by name, parents before children; raise InputError if they form no tree."""
    links = list(links)
    by_parent: dict[str, list[Joint]] = {}
    above: dict[str, Joint] = {}
    for joint in joints:
        for end in (joint.parent, joint.child):
            if end not in links:
                hint = suggestion(end, links) or "define the link, or correct the name"
                raise InputError(f"{file}: joint {joint.name!r} refers to link {end!r}, which does not exist; {hint}")
        if joint.child in above:
            other = above[joint.child].name
            raise InputError(
                f"{file}: link {joint.child!r} is the child of two joints, {other!r} and {joint.name!r}: kinematic"
                " loops are not supported; remove one of the joints"
            )
        above[joint.child] = joint
        by_parent.setdefault(joint.parent, []).append(joint)
    roots = [link for link in links if link not in above]
    if not roots:
        raise InputError(f"{file}: every link is the child of a joint: the joints form a kinematic loop; open the loop")
    reached: dict[str, Joint] = {}
    stack = [roots[0]]
    while stack:
        for joint in by_parent.get(stack.pop(), ()):
            reached[joint.name] = joint
            stack.append(joint.child)
    if len(roots) > 1:
        raise InputError(f"{file}: several root links: {', '.join(roots[:6])}; connect them by joints")
    lost = [joint.name for joint in joints if joint.name not in reached]
    if lost:
        raise InputError(
            f"{file}: joints {', '.join(lost[:6])} form a kinematic loop without the root {roots[0]!r}; open it"
        )
    return roots[0], reached


def _check_mimics(joints: Mapping[str, Joint], file: Path) -> None:
    """Raise InputError if a mimic joint follows an unknown joint, or follows itself through a chain of joints."""
    for joint in joints.values():
        chain = [joint.name]
        while (mimic := joints[chain[-1]].mimic) is not None:
            if mimic[0] not in joints:
                hint = suggestion(mimic[0], joints) or "correct the name"
                raise InputError(f"{file}: joint {chain[-1]!r} mimics {mimic[0]!r}, which does not exist; {hint}")
            if mimic[0] in chain:
                raise InputError(
                    f"{file}: mimic joints follow each other: {' -> '.join([*chain, mimic[0]])}; remove a mimic"
                )
            chain.append(mimic[0])
