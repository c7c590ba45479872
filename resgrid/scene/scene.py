"""The scene: everything a person says about a robot, its surroundings and the chip, before it is cut into cells."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.doors import checked
from resgrid.errors import InputError
from resgrid.frame import Frame
from resgrid.frozen import frozen, picture_html
from resgrid.robots import Box, PointRobot, Robot, Sampling, Shape
from resgrid.robots.shapes import Point
from resgrid.scene.chip import Chip
from resgrid.space import Axis


@checked
@dataclass(frozen=True)
class GoalPoint:
    """A goal that is the cell around a point, in world coordinates; for an arm, the cells that bring its tip there."""

    point: Point


@checked
@dataclass(frozen=True)
class GoalCell:
    """A goal that is one cell, by its index."""

    cell: tuple[int, ...]


@checked
@dataclass(frozen=True)
class GoalJoints:
    """A goal in configuration space: a box of configurations, or the cell around a single one.

    Attributes
    ----------
    lower, upper : tuple of float
        Corners, in world coordinates (of an arm its angles); equal for a single configuration.
    """

    lower: Point
    upper: Point

    def __post_init__(self) -> None:
        Box(self.lower, self.upper)


Goal = Shape | GoalPoint | GoalCell | GoalJoints


@checked
@dataclass(frozen=True)
class CostArea:
    """A region that conducts better (above 1) or worse (below 1): streamlines prefer what conducts."""

    shape: Shape
    conductivity: float


@frozen
@dataclass(frozen=True, eq=False)
class MapCells:
    """What was read from a map file.

    Attributes
    ----------
    cell : ndarray of uint8
        `resgrid.space.Cell` codes on the scene's axes, before obstacles grow by the robot's radius.
    table : mapping
        The ``[map]`` table it came from; ``file`` is an absolute path.
    """

    cell: NDArray[np.uint8]
    table: Mapping[str, Any]


@checked
@dataclass(frozen=True, eq=False)
class Scene:
    """A robot in its surroundings, and the chip that is to guide it.

    Attributes
    ----------
    axes : tuple of Axis
        The grid, one to four axes.
    title : str
        For pictures and decks.
    robot : Robot
        Says which cells are free.
    obstacles : tuple of Shape
        In world coordinates.
    hidden : tuple of Shape
        Obstacles that stand there but are missing from the map: sampling leaves them out, control meets them.
    goals : tuple of Shape, GoalPoint, GoalCell or GoalJoints
        Places for the robot's reference point (an arm's tip) in world coordinates; cells; or configurations.
    starts : tuple of tuple of float
        Start configurations, in world coordinates: for an arm its angles.
    areas : tuple of CostArea
        Regions of configuration space with another conductivity (for points and discs that is the world); later ones
        cover earlier ones.
    map : MapCells or None
        Cells read from a map file.
    frame : Frame
        From space to world coordinates.
    boundary : {"dirichlet", "neumann", "wall"}
        What obstacles are.
    drive : {"uniform", "start"} or None
        What drives the grid where obstacles are open; None means uniform there and nothing elsewhere.
    edge : tuple of {"obstacle", "open", "periodic"}
        What the border of the grid is, per axis.
    k : tuple of float
        Blends asked for, each in [0, 1]: the share of the Dirichlet field.  Empty: no blend, ``boundary`` decides.
    chip : Chip
        Component values.
    sampling : {"conservative", "centre"}
        Whether a cell is free when all of it is, or when its centre is.
    source : str or None
        The file it came from.
    """

    axes: tuple[Axis, ...]
    title: str = ""
    robot: Robot = field(default_factory=PointRobot)
    obstacles: tuple[Shape, ...] = ()
    hidden: tuple[Shape, ...] = ()
    goals: tuple[Goal, ...] = ()
    starts: tuple[Point, ...] = ()
    areas: tuple[CostArea, ...] = ()
    map: MapCells | None = None
    frame: Frame = field(default_factory=Frame)
    boundary: str = "dirichlet"
    drive: str | None = None
    edge: tuple[str, ...] = ()
    k: tuple[float, ...] = ()
    chip: Chip = field(default_factory=Chip)
    sampling: Sampling = "conservative"
    source: str | None = None

    def __post_init__(self) -> None:
        if not self.edge:
            object.__setattr__(self, "edge", tuple("periodic" if axis.periodic else "obstacle" for axis in self.axes))

    def __repr__(self) -> str:
        cells = " x ".join(str(axis.cells) for axis in self.axes)
        parts = ("obstacles", "hidden", "goals", "starts")
        counts = ", ".join(f"{len(getattr(self, part))} {part}" for part in parts if getattr(self, part))
        source = "" if self.map is None else ", map"
        return f"<Scene {self.title!r}: {type(self.robot).__name__} on {cells} cells{source}, {counts or 'empty'}>"

    _repr_html_ = picture_html

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return len(self.axes)

    def replace(self, **changes: Any) -> Scene:
        """The same scene with other values, checked like a scene file.

        Parameters
        ----------
        **changes
            New values of the attributes.

        Returns
        -------
        Scene

        Raises
        ------
        InputError
            If there is no such attribute, or a value does not fit.
        """
        from resgrid.scene.build import rebuilt

        names = [attribute.name for attribute in dataclasses.fields(self)]
        for name in changes:
            if name not in names:
                near = get_close_matches(name, names, 1)
                hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(names)}"
                raise InputError(f"a scene has no {name!r}; {hint}")
        return rebuilt(dataclasses.replace(self, **changes))
