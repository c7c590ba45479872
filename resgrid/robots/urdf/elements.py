"""Numbers and poses in the elements of URDF files."""

from __future__ import annotations

import math
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError


def attribute(element: Element, name: str, place: str) -> str:
    """Return an attribute of an element without blanks around it; raise InputError if it is missing or empty.

    `place`: file and element in messages.
    """
    value = element.get(name, "").strip()
    if not value:
        raise InputError(f'{place}: <{element.tag}> has no attribute {name!r}; add {name}="..."')
    return value


def numbers(text: str, count: int, place: str) -> NDArray[np.float64]:
    """Return the finite numbers (count,) of a text; raise InputError for other texts; `place`: as in messages."""
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.full(0, math.nan)
    if len(values) != count or not np.isfinite(values).all():
        unexpanded = "; the file still contains xacro macros: convert it with xacro first" if "$" in text else ""
        words = "a finite number" if count == 1 else f"{count} finite numbers"
        raise InputError(f"{place} = {text!r} must be {words}{unexpanded}")
    return values


def vector(element: Element | None, name: str, default: str, place: str, count: int = 3) -> NDArray[np.float64]:
    """Return an attribute of an element as numbers (count,), or the default for a missing element or attribute."""
    text = default if element is None else element.get(name, default)
    return numbers(text, count, f"{place}: {name}")


def scalar(element: Element, name: str, default: float | None, place: str) -> float:
    """Return an attribute of an element as a number; without a default the attribute is required."""
    text = attribute(element, name, place) if default is None else element.get(name)
    if text is None:
        assert default is not None
        return default
    return float(numbers(text, 1, f"{place}: {name}")[0])


def origin_of(element: Element, place: str) -> NDArray[np.float64]:
    """Return the pose (4, 4) that the ``<origin>`` of an element describes; the identity without one."""
    origin = element.find("origin")
    return pose(vector(origin, "xyz", "0 0 0", f"{place}: origin"), vector(origin, "rpy", "0 0 0", f"{place}: origin"))


def pose(position: NDArray[np.float64], angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the pose (4, 4) of a position (3,) in metres and of roll, pitch and yaw (3,) in radians.

    The rotation is ``Rz(yaw) Ry(pitch) Rx(roll)``: turns about the fixed axes x, y and z, in this order.
    """
    (cr, cp, cy), (sr, sp, sy) = np.cos(angles), np.sin(angles)
    result = np.eye(4)
    result[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    result[:3, 3] = position
    return result
