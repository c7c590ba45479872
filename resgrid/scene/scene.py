"""The `Scene` class: a robot, its surroundings and the chip, in world coordinates, before discretisation."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Annotated, Any

from annotated_types import Ge, Le

from resgrid._internal.validation import checked
from resgrid._internal.values import picture_html
from resgrid.core.axis import Axis, Point
from resgrid.core.frame import Frame
from resgrid.core.lattice import LatticeName
from resgrid.core.wiring import Boundary, Drive, EdgeRule
from resgrid.errors import InputError, suggestion
from resgrid.robots import PointRobot, Robot, Sampling, Shape
from resgrid.scene.chip import Chip
from resgrid.scene.consistency import inconsistencies
from resgrid.scene.control import Control
from resgrid.scene.goals import CostArea, Goal, GoalCell, GoalPoint
from resgrid.scene.maps.arrays import MapCells
from resgrid.scene.maps.formats import read_map
from resgrid.scene.mask import Mask
from resgrid.scene.messages import report
from resgrid.scene.quantities import Listed, Quantity
from resgrid.scene.toml_lines import Path
from resgrid.scene.world_coordinates import cell_centre

IN_FILES = ("title", "boundary", "drive", "leak", "lattice", "sampling", "k", "mask", "chip", "control")
"""Attributes of `Scene` that are keys of a scene file with the same name and form."""

LISTS = {"obstacle": "obstacles", "hidden": "hidden", "goal": "goals", "area": "areas"}
"""Keys of a scene file that are lists of tables, mapped to the attributes of `Scene` that hold the values of these
tables."""


@checked
@dataclass(frozen=True, eq=False)
class Scene:
    """A robot, its surroundings, and the chip that computes its field.

    Attributes
    ----------
    axes : tuple of Axis
        The grid, one to four axes.
    title : str
        Title of pictures and decks.
    robot : Robot
        Robot, whose shape decides which cells are free.
    obstacles : tuple of Shape
        Obstacles, in world coordinates.
    hidden : tuple of Shape
        Real obstacles that are missing from the map: the configuration space ignores them, control collides with them.
    goals : tuple of Shape, GoalPoint, GoalCell, GoalJoints or GoalPose
        Goals: places of the robot's reference point (an arm's tip) in world coordinates, cells, or configurations.
    starts : tuple of tuple of float
        Start configurations, in world coordinates; of an arm its joint values, in radians or metres.
    areas : tuple of CostArea
        Regions of configuration space with a conductivity other than 1 (for points and discs, regions of the world).
        Where regions overlap, the last one applies.
    mask : tuple of Mask
        Masks over the world, with keep-out areas or speed limits.
    map : MapCells or None
        Cells read from a map file; None without a map.
    frame : Frame
        Transformation from the coordinates of the space to world coordinates.
    boundary : {"dirichlet", "neumann", "wall"}
        Boundary condition at obstacles: tied to the obstacle rail, open, or in contact through a series resistance.
    drive : {"uniform", "start"} or None
        Drive of a grid with open obstacles: a uniform current into all free cells, or a start cell tied to the high
        rail.  Default: uniform with open obstacles and no leak, otherwise no drive.
    leak : float
        Leak of every free cell to the obstacle rail, in 1 / (unit of the axes)^2: 1 / (screening length)^2, or 0 for no
        leak.  Open obstacles then need no drive.
    lattice : {"square", "square8", "cube26", "hexagonal"}
        Neighbours of a node: face neighbours of cells; also those across corners in the plane (8), or across edges and
        corners in space (26); or the six neighbours of a triangular lattice in the plane.  Paths of the last three run
        from node to node.
    edge : tuple of {"obstacle", "open", "periodic"}
        Boundary condition at the border of the grid: one for all axes, or one per axis; by default obstacle.  Periodic
        axes have no border.
    k : tuple of float
        Weights of the Dirichlet field in blends with the Neumann field, each in [0, 1].  Empty: no blend, the field of
        ``boundary``.
    chip : Chip
        Component values and imperfections of the chip.
    control : Control
        Parameters of robot control.
    sampling : {"conservative", "centre"}
        Criterion of a free cell: every configuration of the cell is free of collision, or its centre is.
    source : str or None
        Name of the scene file or text, for messages; None for a scene that was built in Python.

    Raises
    ------
    InputError
        If values are out of range or inconsistent.  The message lists all problems by key path.

    Examples
    --------
    >>> axes = (rg.Axis("x", 0.0, 4.0, 4), rg.Axis("y", 0.0, 3.0, 3))
    >>> wall, goal = rg.Box((1.0, 0.0), (2.0, 2.0)), rg.GoalPoint((3.5, 0.5))
    >>> scene = rg.Scene(axes, obstacles=(wall,), goals=(goal,), starts=((0.5, 0.5),))
    >>> rg.build_space(scene).cell
    array([[0, 0, 0],
           [1, 1, 0],
           [0, 0, 0],
           [2, 0, 0]], dtype=uint8)
    >>> str(rg.plan(scene).paths()[0].outcome)
    'reached'
    """

    axes: tuple[Axis, ...]
    title: str = ""
    robot: Robot = field(default_factory=PointRobot)
    obstacles: tuple[Shape, ...] = ()
    hidden: tuple[Shape, ...] = ()
    goals: tuple[Goal, ...] = ()
    starts: tuple[Point, ...] = ()
    areas: tuple[CostArea, ...] = ()
    mask: tuple[Mask, ...] = ()
    map: MapCells | None = None
    frame: Frame = field(default_factory=Frame)
    boundary: Boundary = "dirichlet"
    drive: Drive | None = None
    leak: Annotated[float, Ge(0), Quantity("1/m^2")] = 0.0
    lattice: LatticeName = "square"
    edge: tuple[EdgeRule, ...] = ()
    k: Annotated[tuple[Annotated[float, Ge(0), Le(1)], ...], Listed()] = ()
    chip: Chip = field(default_factory=Chip)
    control: Control = field(default_factory=Control)
    sampling: Sampling = "conservative"
    source: str | None = None

    def __post_init__(self) -> None:
        for name in ("axes", "obstacles", "hidden", "goals", "areas", "mask", "edge", "k"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        object.__setattr__(self, "starts", tuple(tuple(start) for start in self.starts))
        rules = self.edge or ("obstacle",)
        if len(rules) in (1, len(self.axes)):
            each = rules * len(self.axes) if len(rules) == 1 else rules
            edge = ("periodic" if axis.periodic else rule for axis, rule in zip(self.axes, each, strict=True))
            object.__setattr__(self, "edge", tuple(edge))
        if self.map is not None:  # the map's cells have the frame of the space
            frame = dataclasses.replace(self.frame, turning_length=None)
            object.__setattr__(self, "map", dataclasses.replace(self.map, frame=frame))
        lists = LISTS | {"starts": "starts"}
        values: dict[Path, Any] = {
            (key, number): value for key, name in lists.items() for number, value in enumerate(getattr(self, name))
        }
        names, has_wall = [axis.name for axis in self.axes], self.chip.wall_resistance is not None
        problems = inconsistencies(self, self.robot, self.axes, names, values, has_wall=has_wall)
        if problems:
            raise InputError(report(problems, self.source or "scene"))

    def __repr__(self) -> str:
        cells = " x ".join(str(axis.cells) for axis in self.axes)
        parts = ("obstacles", "hidden", "goals", "starts")
        sizes = {part: len(getattr(self, part)) for part in parts}
        counts = ", ".join(f"{n} {part if n > 1 else part.removesuffix('s')}" for part, n in sizes.items() if n)
        source = "" if self.map is None else ", map"
        return f"<Scene {self.title!r}: {type(self.robot).__name__} on {cells} cells{source}, {counts or 'empty'}>"

    _repr_html_ = picture_html

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return len(self.axes)

    def replace(self, **changes: Any) -> Scene:
        """Return a copy of the scene with some attributes replaced.

        Parameters
        ----------
        **changes
            New values of the attributes.  ``goal`` and ``start`` replace all goals or starts by one place or a list of
            places: a point in world coordinates, a `GoalCell`, or, for goals, a `GoalJoints`, a `GoalPose` or a shape.
            ``k`` and ``edge`` may be single values.  If the axes are those of the map, a new ``robot`` also sets axes
            and frame, unless ``axes`` is given.

        Returns
        -------
        Scene
            The changed scene.

        Raises
        ------
        InputError
            If an attribute is unknown, or a value is invalid.

        Examples
        --------
        >>> scene = rg.Scene((rg.Axis("x", 0.0, 4.0, 4), rg.Axis("y", 0.0, 3.0, 3)))
        >>> scene.replace(goal=(3.5, 0.5), boundary="neumann").goals
        (GoalPoint(point=(3.5, 0.5)),)
        """
        check_attributes(changes)
        robot = changes.get("robot")
        if isinstance(robot, Robot) and self.map is not None and "axes" not in changes:
            has_own = (
                robot.base is not None and self.axes[: len(self.map.axes)] != self.map.axes
            )  # joint axes of an arm
            if not has_own:
                cells = changes.get("map", self.map)
                if robot.extent > cells.extent:  # obstacles around the cropped map that the smaller robot did not need
                    cells = changes["map"] = read_map(cells.table, robot.extent)
                changes["axes"], changes["frame"] = cells.space_of(robot)
        axes, frame = changes.get("axes", self.axes), changes.get("frame", self.frame)
        if not (isinstance(axes, list | tuple) and all(isinstance(axis, Axis) for axis in axes)):
            return dataclasses.replace(self, axes=axes)  # raises InputError
        if "goal" in changes:
            goals = _places("goal", changes.pop("goal"))
            changes["goals"] = tuple(GoalPoint(goal) if isinstance(goal, tuple) else goal for goal in goals)
        if "start" in changes:
            starts = _places("start", changes.pop("start"))
            changes["starts"] = tuple(start_point(start, tuple(axes), frame) for start in starts)
        if isinstance(changes.get("k"), int | float):
            changes["k"] = (changes["k"],)
        if isinstance(changes.get("edge"), str):
            changes["edge"] = (changes["edge"],)
        elif "axes" in changes and "edge" not in changes:
            rules = {axis.name: rule for axis, rule in zip(self.axes, self.edge, strict=True) if rule != "periodic"}
            changes["edge"] = tuple(rules.get(axis.name, "obstacle") for axis in axes)
        return dataclasses.replace(self, **changes)


def check_attributes(names: Iterable[str], *also: str) -> None:
    """Raise InputError unless all `names` are attributes of a scene, ``goal``, ``start``, or among the names `also`."""
    known = [*(attribute.name for attribute in dataclasses.fields(Scene)), "goal", "start", *also]
    for name in names:
        if name not in known:
            hint = suggestion(name, known) or f"its attributes are {', '.join(known)}"
            raise InputError(f"a scene has no attribute {name!r}; {hint}")


def start_point(start: GoalPoint | GoalCell | Point, axes: tuple[Axis, ...], frame: Frame, key: str = "start") -> Point:
    """Return the world coordinates of a start: its point, or the centre of its cell.

    `axes`, `frame`: axes of the space, and the transformation from axis units to the world; `key`: key path of the
    start, for messages.
    """
    if isinstance(start, GoalCell):
        return cell_centre(axes, frame, start.cell, key)
    return start.point if isinstance(start, GoalPoint) else start


def _places(key: str, given: Any) -> list[Any]:
    """Return one place or a list of places as a list, in which points are tuples; other places are unchanged.

    `given`: the place or places, where a list of numbers is one point; `key`: "goal" or "start", for messages.
    """
    if isinstance(given, Goal):
        return [given]
    entries = given.tolist() if hasattr(given, "tolist") else given
    if not isinstance(entries, list | tuple) or not entries:
        raise InputError(f"{key} = {given!r} must be a list of numbers, a goal, or a list of these")
    if isinstance(entries[0], int | float):
        return [tuple(entries)]
    return [place for entry in entries for place in _places(key, entry)]
