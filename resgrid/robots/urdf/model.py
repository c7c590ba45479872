"""Reader of a URDF file as a kinematic tree: moving and locked joints, bodies, and pairs that may collide."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.numbers import check_number, check_whole, is_number
from resgrid.errors import InputError
from resgrid.robots.convex import Body
from resgrid.robots.solids import rigid_pose
from resgrid.robots.urdf.description import Description, read_description
from resgrid.robots.urdf.geometry import robot_bodies
from resgrid.robots.urdf.joint_values import JointValue, check_moving, frames_of, joint_values, range_of
from resgrid.robots.urdf.obstacles import check_links, with_obstacles
from resgrid.robots.urdf.pairs import adjacent_pairs, self_pairs
from resgrid.robots.urdf.srdf import disabled_pairs
from resgrid.robots.urdf.tree import KinematicTree

__all__ = ["read_tree", "with_obstacles"]


def read_tree(
    file: str | os.PathLike[str],
    moving: Sequence[str],
    at: Mapping[str, float] | None = None,
    *,
    packages: Iterable[str | os.PathLike[str]] = (),
    srdf: str | os.PathLike[str] | None = None,
    base: Sequence[float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    padding: float = 0.0,
    mounted: Sequence[str] = (),
    pieces: int = 4,
) -> KinematicTree:
    """Return the kinematic tree of a robot from its URDF file, with pairs of its bodies that must not touch each other.

    Parameters
    ----------
    file : str or path
        URDF file.
    moving : sequence of str
        Names of one to four revolute, continuous or prismatic joints, in the order of the axes.
    at : mapping of str to float, optional
        Values of other joints, in radians or metres.  Without a value a joint is locked at 0, or at its limit closest
        to 0.  Mimic joints follow their drivers, without regard to limits of their own, as in ROS; floating and planar
        joints are locked at the identity.
    packages : iterable of str or path
        Folders to search for ``package://`` addresses.
    srdf : str or path, optional
        SRDF file, whose disabled pairs of links may touch each other.  Without one, links that one joint connects may
        touch each other.
    base : sequence of six float
        Pose of the root link in the world: x, y, z in metres, then roll, pitch and yaw in radians.
    padding : float
        Distance in metres, at least 0, by which the convex pieces of the robot's bodies are enlarged; the exact solids
        are not.
    mounted : sequence of str
        Links that may touch the surroundings; here only their names are checked.
    pieces : int
        Maximum number of convex pieces that cover a mesh.

    Returns
    -------
    KinematicTree
        Tree without surroundings; see `with_obstacles`.

    Raises
    ------
    InputError
        If a file is missing or invalid, or an argument does not suit the robot.
    ToolMissingError
        If a mesh of the robot is a PLY file, and trimesh is not installed.
    """
    check_number("padding", padding, "a number of metres, at least 0", least=0)
    check_whole("pieces", pieces, 1)
    path, folders = Path(file), [Path(each) for each in packages]
    robot = read_description(path)
    check_moving(robot, moving)
    values = joint_values(robot, moving, at or {})
    carriers = frames_of(robot, values, _base_pose(base))
    allowed = adjacent_pairs(robot) if srdf is None else disabled_pairs(Path(srdf), robot.links)
    check_links(mounted, robot.links, "mounted", str(path))
    names = [name for name, value in values.items() if value.driver is not None]
    number: dict[str | None, int] = {None: -1, **{name: index for index, name in enumerate(names)}}
    frames = {link: (number[joint], placement) for link, (joint, placement) in carriers.items()}
    bodies, owners = robot_bodies(robot, frames, folders, padding, pieces)
    pairs = self_pairs(bodies, owners, allowed)
    return _assembled(robot, moving, {name: values[name] for name in names}, frames, bodies, pairs)


def _base_pose(base: Sequence[float]) -> NDArray[np.float64]:
    """Return the pose (4, 4) of six numbers: x, y, z in metres, then roll, pitch and yaw in radians.

    Raises InputError unless there are six finite numbers.
    """
    if isinstance(base, str) or len(base) != 6 or not all(map(is_number, base)):
        raise InputError(f"base = {base!r} must be six finite numbers: x, y, z, roll, pitch, yaw")
    given = np.array(base, dtype=np.float64)
    return rigid_pose(given[:3], given[3:])


def _assembled(
    robot: Description,
    moving: Sequence[str],
    values: Mapping[str, JointValue],
    frames: Mapping[str, tuple[int, NDArray[np.float64]]],
    bodies: Sequence[Body],
    pairs: NDArray[np.int64],
) -> KinematicTree:
    """Return the kinematic tree of a robot, without surroundings.

    `moving`: names of the moving joints, in the order of the axes; `values`: values of the joints that move or follow a
    moving joint, in the order of the tree; `frames`: for every link, the index of the joint whose frame carries it (-1
    for none) and its pose (4, 4) in this frame; `bodies`: bodies of all links; `pairs` (p, 2): indices of the pairs of
    bodies that must not touch each other.
    """
    axes = [robot.joints[name] for name in moving]
    joints = [robot.joints[name] for name in values]
    carriers = [frames[joint.parent] for joint in joints]
    return KinematicTree(
        moving=tuple(moving),
        lower=np.array([range_of(joint)[0] for joint in axes]),
        upper=np.array([range_of(joint)[1] for joint in axes]),
        velocity=np.array([joint.velocity for joint in axes]),
        is_continuous=np.array([joint.kind == "continuous" for joint in axes]),
        names=tuple(values),
        parent=np.array([parent for parent, _ in carriers], dtype=np.int64),
        placement=np.array([own @ joint.placement for joint, (_, own) in zip(joints, carriers, strict=True)]),
        direction=np.array([joint.axis for joint in joints]),
        is_prismatic=np.array([joint.kind == "prismatic" for joint in joints]),
        driver=np.array([value.driver for value in values.values()], dtype=np.int64),
        factor=np.array([value.factor for value in values.values()]),
        offset=np.array([value.offset for value in values.values()]),
        bodies=tuple(bodies),
        pairs=pairs,
        tools=dict(frames),
    )
