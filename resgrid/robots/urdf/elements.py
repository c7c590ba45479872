"""Parsers of numbers and poses in the XML elements of URDF files."""

from __future__ import annotations

import math
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.robots.solids import rigid_pose


def attribute(element: Element, name: str, place: str) -> str:
    """Return an attribute of an element without blanks around it; raise InputError if it is missing or empty.

    `place`: file and element in messages.
    """
    value = element.get(name, "").strip()
    if not value:
        raise InputError(f'{place}: <{element.tag}> has no attribute {name!r}; add {name}="..."')
    return value


def numbers(text: str, count: int, place: str) -> NDArray[np.float64]:
    """Return the finite numbers (count,) of a text, separated by blanks; raise InputError for other texts.

    `count`: required number of numbers; `place`: file and element, for messages.
    """
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
    """Return an attribute of an element as numbers (count,), or the default for a missing element or attribute.

    `name`: name of the attribute; `default`: text of the default numbers, such as ``"0 0 0"``; `place`: file and
    element, for messages. Raises InputError for a text that is not `count` finite numbers.
    """
    text = default if element is None else element.get(name, default)
    return numbers(text, count, f"{place}: {name}")


def scalar(element: Element, name: str, default: float | None, place: str) -> float:
    """Return an attribute of an element as a number, or the default if the attribute is missing.

    `name`: name of the attribute; `default`: None if the attribute is required; `place`: file and element, for
    messages. Raises InputError for a missing required attribute, and for a text that is no finite number.
    """
    text = attribute(element, name, place) if default is None else element.get(name)
    if text is None:
        assert default is not None
        return default
    return float(numbers(text, 1, f"{place}: {name}")[0])


def origin_of(element: Element, place: str) -> NDArray[np.float64]:
    """Return the pose (4, 4) that the element ``<origin>`` inside an element describes; the identity without one.

    The attributes are ``xyz`` in metres and ``rpy``, roll, pitch and yaw in radians. `place`: file and element, for
    messages.
    """
    origin = element.find("origin")
    position, angles = (vector(origin, name, "0 0 0", f"{place}: origin") for name in ("xyz", "rpy"))
    return rigid_pose(position, angles)
