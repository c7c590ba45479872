"""Joint values (moving joints, mimic joints that follow them, locked joints), their checks, and the poses of links."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.numbers import is_number
from resgrid.core.cell import MAX_DIMENSIONS
from resgrid.errors import InputError, suggestion
from resgrid.robots.urdf.description import Description, Joint

_MOVABLE = ("revolute", "continuous", "prismatic")
"""Joint types of the URDF format with one degree of freedom; other joints always have the identity as motion."""


@dataclass(frozen=True)
class JointValue:
    """The value of a joint: ``factor`` times the value of the moving joint ``driver``, plus ``offset``.

    `driver`: index of the moving joint, in the order of the axes; None for a joint whose value is always `offset`;
    `factor`: 1 for a moving joint itself, 0 without a driver; `offset`: in radians or metres.
    """

    driver: int | None
    factor: float
    offset: float


def check_moving(robot: Description, moving: Sequence[str]) -> None:
    """Raise InputError unless `moving` names one to four independent joints of the robot that can move.

    Such a joint is revolute, continuous or prismatic, no mimic joint, named once, and has a range unless continuous.
    """
    names = [name for name, joint in robot.joints.items() if joint.kind in _MOVABLE and joint.mimic is None]
    known = f"joints that can move: {', '.join(names) or 'none'}"
    if isinstance(moving, str) or not 1 <= len(moving) <= MAX_DIMENSIONS:
        given = repr(moving) if isinstance(moving, str) else f"{len(moving)} joints"
        raise InputError(f"{robot.file}: moving must name 1 to {MAX_DIMENSIONS} joints, got {given}; {known}")
    repeated = [name for name, count in Counter(moving).items() if count > 1]
    if repeated:
        raise InputError(f"{robot.file}: moving names joint {repeated[0]!r} more than once; name every joint once")
    for name in moving:
        joint = _joint(robot, name, "moving")
        place = f"{robot.file}: moving joint {name!r}"
        if joint.mimic is not None:
            raise InputError(f"{place} follows joint {_leader(robot, name)!r}; name its driver instead")
        if joint.kind not in _MOVABLE:
            raise InputError(f"{place} is {joint.kind} and cannot move as one axis; {known}")
        if joint.kind != "continuous" and joint.limits is None:
            raise InputError(f'{place} has no limits; add <limit lower="..." upper="..."/>, or make it continuous')
        if joint.limits is not None and joint.limits[0] == joint.limits[1]:
            raise InputError(
                f"{place} has the range {joint.limits[0]!r} to {joint.limits[1]!r}; widen it, or leave it out"
            )


def range_of(joint: Joint) -> tuple[float, float]:
    """Return the lower and upper limit of a moving joint in radians or metres; -pi and pi for a continuous one."""
    return joint.limits or (-np.pi, np.pi)


def joint_values(robot: Description, moving: Sequence[str], at: Mapping[str, float]) -> dict[str, JointValue]:
    """Return the value of every joint, by name.

    Mimic joints follow their driver through any chain of mimic joints, also if the driver is locked.  Other joints are
    locked at the value in `at`, by default at 0 or at the limit that is closest to 0.

    Parameters
    ----------
    robot : Description
        Links and joints.
    moving : sequence of str
        Names of the moving joints, in the order of the axes.
    at : mapping of str to float
        Values of locked joints, in radians or metres.

    Raises
    ------
    InputError
        If `at` names a joint that is unknown, moves, follows another one or has no value, or a value outside limits.
    """
    for name, value in at.items():
        _check_locked(robot, name, value, moving)
    return {name: _value(robot, joint, moving, at) for name, joint in robot.joints.items()}


def _value(robot: Description, joint: Joint, moving: Sequence[str], at: Mapping[str, float]) -> JointValue:
    """Return the value of one joint as a function of the moving joints.

    `moving`: names of the moving joints, in the order of the axes; `at`: values of locked joints by name.
    """
    if joint.kind not in _MOVABLE:
        return JointValue(None, 0.0, 0.0)
    if joint.mimic is not None:
        driver, factor, offset = joint.mimic
        leader = _value(robot, robot.joints[driver], moving, at)
        if leader.driver is None or not factor * leader.factor:
            return JointValue(None, 0.0, factor * leader.offset + offset)
        return JointValue(leader.driver, factor * leader.factor, factor * leader.offset + offset)
    if joint.name in moving:
        return JointValue(list(moving).index(joint.name), 1.0, 0.0)
    default = 0.0 if joint.limits is None else float(np.clip(0.0, *joint.limits))
    return JointValue(None, 0.0, float(at.get(joint.name, default)))


def _check_locked(robot: Description, name: str, value: float, moving: Sequence[str]) -> None:
    """Raise InputError unless the joint `name` can be locked at `value`, in radians or metres.

    It must exist, have one degree of freedom, neither move nor follow another joint, and have the value in its range.
    `moving`: names of the moving joints.
    """
    joint, place = _joint(robot, name, "at"), f"{robot.file}: at: joint {name!r}"
    if name in moving:
        raise InputError(f"{place} is one of the moving joints; remove it from one of the two")
    if joint.mimic is not None:
        raise InputError(f"{place} follows joint {_leader(robot, name)!r}; give the value of its driver instead")
    if joint.kind not in _MOVABLE:
        raise InputError(f"{place} is {joint.kind} and has no value; remove it")
    if not is_number(value):
        raise InputError(f"{place} = {value!r} must be a finite number")
    if joint.limits is not None and not joint.limits[0] <= value <= joint.limits[1]:
        raise InputError(f"{place} = {value!r} lies outside its limits, {joint.limits[0]!r} to {joint.limits[1]!r}")


def _joint(robot: Description, name: str, key: str) -> Joint:
    """Return a joint by name; raise InputError with a suggestion otherwise; `key`: name of the argument in messages."""
    if name not in robot.joints:
        hint = suggestion(name, robot.joints) or f"joints of the file: {', '.join(robot.joints) or 'none'}"
        raise InputError(f"{robot.file}: {key} names an unknown joint {name!r}; {hint}")
    return robot.joints[name]


def _leader(robot: Description, name: str) -> str:
    """Return the name of the independent joint at the end of a chain of mimic joints that begins with joint `name`."""
    while (mimic := robot.joints[name].mimic) is not None:
        name = mimic[0]
    return name


def frames_of(
    robot: Description, values: Mapping[str, JointValue], base: NDArray[np.float64]
) -> dict[str, tuple[str | None, NDArray[np.float64]]]:
    """Return, for every link, the name of the joint whose frame carries it, and the link's pose (4, 4) in this frame.

    The joint is the nearest one towards the root that moves, or follows a moving joint; None for a link that does not
    move, whose pose is in the world. `values`: values of all joints; `base`: pose (4, 4) of the root link in the world.
    """
    frames: dict[str, tuple[str | None, NDArray[np.float64]]] = {robot.root: (None, base)}
    for joint in robot.joints.values():
        carrier, pose = frames[joint.parent]
        value = values[joint.name]
        if value.driver is None:
            frames[joint.child] = carrier, pose @ joint.placement @ locked_motion(joint, value.offset)
        else:
            frames[joint.child] = joint.name, np.eye(4)
    return frames


def locked_motion(joint: Joint, value: float) -> NDArray[np.float64]:
    """Return the transformation (4, 4) of a joint at a `value` in radians or metres.

    It is a rotation by Rodrigues' formula, a translation of a prismatic joint, or the identity for joints without one
    degree of freedom.
    """
    motion = np.eye(4)
    if joint.kind == "prismatic":
        motion[:3, 3] = value * joint.axis
    elif joint.kind in _MOVABLE:
        x, y, z = joint.axis
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        motion[:3, :3] += np.sin(value) * cross + 2 * np.sin(value / 2) ** 2 * (cross @ cross)
    return motion
