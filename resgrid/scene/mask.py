"""The type `Mask`: a ROS map whose pixels are keep-out weights or speed limits, as in Nav2's costmap filters."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le

from resgrid._internal.validation import checked
from resgrid.errors import InputError
from resgrid.scene.maps.ros_header import NEWEST, Dialect

_OF_KIND = {"lethal": "keepout", "least_conductivity": "keepout", "inflate": "keepout",
            "unit": "speed", "base": "speed", "multiplier": "speed"}  # fmt: skip
"""Keys of a ``[[mask]]`` table that only one kind of mask accepts, mapped to this kind."""


@checked
@dataclass(frozen=True)
class Mask:
    """A ROS map over the world with keep-out areas or speed limits, such as a mask of a costmap filter of Nav2.

    The mask has a resolution, an origin and a rotation of its own.  The rules of its ``map.yaml`` convert pixels to
    occupancies in percent, 0 to 100 (only ``mode: scale`` and ``mode: raw`` give values in between).  Unknown pixels,
    and the world outside the mask, have no effect.

    Attributes
    ----------
    file : str
        The ``map.yaml`` of the mask, relative to the scene's folder.
    kind : {"keepout", "speed"}
        Meaning of the occupancies: `keepout` (forbidden places and weights) or `speed` (limits of the robot's speed).
    dialect : {"nav2", "nav2-jazzy", "ros1"}
        ROS map reader whose rules convert pixels to occupancies: Nav2 since 2025, Nav2 until Jazzy, or ROS 1.
    lethal : int
        Smallest occupancy of a forbidden pixel (keepout).
    least_conductivity : float
        Relative conductivity c of a place whose occupancy is just below `lethal` (without costs: 1); a place of
        occupancy p below `lethal` has at most the conductivity c ** (p / lethal) (keepout).
    inflate : bool
        Whether the whole robot stays out of forbidden pixels; if false (the default, as in Nav2), only its reference
        point does (keepout).
    unit : {"percent", "m/s"}
        Unit of the limits `base + multiplier * occupancy`: percent of the robot's largest speed, or units of the world
        per second (speed).
    base, multiplier : float
        Coefficients of the limits, in `unit`.  A pixel has no limit if its occupancy is 0, or if its limit is 0,
        negative, or above 100 percent (speed).

    Raises
    ------
    InputError
        If a value is out of range, or a key belongs to the other kind.

    Examples
    --------
    >>> rg.Mask("zones.yaml", "speed", unit="m/s", multiplier=0.01).kind
    'speed'
    """

    file: str
    kind: Literal["keepout", "speed"]
    dialect: Dialect = NEWEST
    lethal: Annotated[int, Ge(1), Le(100)] = 100
    least_conductivity: Annotated[float, Gt(0), Le(1)] = 0.1
    inflate: bool = False
    unit: Literal["percent", "m/s"] = "percent"
    base: float = 0.0
    multiplier: float = 1.0

    def __post_init__(self) -> None:
        if not self.file:
            raise InputError("file: the name of the mask's map.yaml is empty")
        for item in fields(self):
            kind = _OF_KIND.get(item.name, self.kind)
            if kind != self.kind and getattr(self, item.name) != item.default:
                raise InputError(f"{item.name} belongs to masks of kind {kind!r}, not {self.kind!r}; remove it")
