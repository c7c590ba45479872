"""The result of a controlled motion: the type `Run`, the types of its fields, and the recorder of its steps."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.values import frozen, picture_html
from resgrid.control.contact import ContactSet
from resgrid.control.goal_distance import goal_distance
from resgrid.control.plant import PAIR, Plant
from resgrid.core.frame import Frame
from resgrid.core.space import ConfigurationSpace
from resgrid.planning.fields import Field
from resgrid.scene.scene import Scene

Vector = NDArray[np.float64]

_AT_GOAL = 1e-8
"""Largest distance from a goal at which the robot counts as inside the goal, as a fraction of a length.  The length is
the robot's largest motion across a cell (metres) plus the cell diagonal (axis units).
"""


class ControlMode(IntEnum):
    """Mode of the controller in a step.

    Examples
    --------
    >>> scene = rg.read_scene("examples/scenes/lesson.toml").replace(hidden=(rg.Box((5.0, 2.2), (6.0, 3.0)),))
    >>> run = rg.simulation(scene, k=0.9).run()
    >>> [rg.control.ControlMode(mode).name for mode in np.unique(run.mode)]
    ['STREAMLINE', 'LEARNING', 'ARRIVED']
    """

    STREAMLINE = 0
    """The robot followed the current."""
    PUSHED = 1
    """The robot followed the current under an external force."""
    SLIDING = 2
    """The robot slid along an obstacle."""
    STICKING = 3
    """Friction held the robot at an obstacle: the contact force lies inside the friction cone."""
    FOLLOWING = 4
    """The robot responded to a contact force by motion along the equipotential."""
    JAM = 5
    """The contact force lies along the streamline, so that motion along the equipotential is impossible."""
    LEARNING = 6
    """The robot stood still while contacts added obstacle cells to the map, and the field was solved again."""
    RETREATING = 7
    """The robot moved back along its path, to a cell with a path to a goal."""
    RECOVERING = 8
    """The robot left a cell without a path to a goal (after a wrong measurement or a learnt obstacle) for a near cell
    with a path.
    """
    DITHERING = 9
    """The robot made a small random motion because it had made no progress."""
    ARRIVED = 10
    """The robot is in a goal cell, at the configuration that solves the goal if the space specifies one."""
    WAITING = 11
    """The robot stood still where a grid that has not settled has no outward current."""
    HOMING = 12
    """In a goal cell, the robot moved straight to the configuration that solves the goal."""


class TerminationReason(StrEnum):
    """Reason for the end of a controlled motion.

    ``arrived``: the robot is in a goal; ``missed``: the configuration is in a goal according to the sensor, but not in
    truth; ``no_path``: obstacle cells separate the start from every goal; ``no_current``: no current flows in the
    robot's cell, although a path leads to a goal; ``goal_blocked``, ``start_blocked``: obstacles cover every goal, or
    the start; ``jam``: the contact force lies along the streamline, so that the robot cannot evade; ``stalled``: the
    robot stays within half a cell, or has waited too long for a grid to settle; ``out_of_steps``: the maximum number of
    steps was taken; ``entered``: the robot penetrated an obstacle.

    Examples
    --------
    >>> run = rg.simulation(rg.read_scene("examples/scenes/lesson.toml"), k=0.9).run()
    >>> run.ending is rg.control.TerminationReason.ARRIVED
    True
    >>> " ".join(rg.control.TerminationReason)
    'arrived missed no_path no_current goal_blocked start_blocked jam stalled out_of_steps entered'
    """

    ARRIVED = "arrived"
    MISSED = "missed"
    NO_PATH = "no_path"
    NO_CURRENT = "no_current"
    GOAL_BLOCKED = "goal_blocked"
    START_BLOCKED = "start_blocked"
    JAM = "jam"
    STALLED = "stalled"
    OUT_OF_STEPS = "out_of_steps"
    ENTERED = "entered"


class End(NamedTuple):
    """Termination reason of a run (`ending`), and a sentence that explains the reason (`message`)."""

    ending: TerminationReason
    message: str


@frozen
@dataclass(frozen=True, eq=False)
class ContactLog:
    """All contacts of a controlled motion that have a force, one row each.

    The type of `Run.contacts`.  Points, normals and forces are in world coordinates.

    Attributes
    ----------
    step : ndarray of int64, shape (m,)
        Row of the contact in the arrays of `Run`, such as `Run.time`.
    point : ndarray of float64, shape (m, 2)
        Point on the obstacle, in metres.
    normal : ndarray of float64, shape (m, 2)
        Unit normal out of the obstacle.
    force : ndarray of float64, shape (m, 2)
        Force on the robot.  Its unit is that of the scene's admittance: the product of `Control.admittance` and a
        force is a velocity.
    gap : ndarray of float64, shape (m,)
        Distance between robot and obstacle, in metres.
    part : ndarray of int64, shape (m,)
        Index of the rigid part of the robot (the link of an arm).
    body : ndarray of int64, shape (m,)
        Index of the obstacle; the obstacles of the map come first, then hidden ones.
    sticking : ndarray of bool, shape (m,)
        Whether friction holds the contact: the force lies inside the friction cone, and the point does not move.

    Examples
    --------
    >>> scene = rg.read_scene("examples/scenes/lesson.toml").replace(hidden=(rg.Box((5.0, 2.2), (6.0, 3.0)),))
    >>> contacts = rg.simulation(scene, k=0.9).run().contacts
    >>> contacts.step, contacts.normal
    (array([37]), array([[-1.,  0.]]))
    >>> contacts.point.round(2), contacts.sticking
    (array([[5. , 2.8]]), array([False]))
    """

    step: NDArray[np.int64]
    point: NDArray[np.float64]
    normal: NDArray[np.float64]
    force: NDArray[np.float64]
    gap: NDArray[np.float64]
    part: NDArray[np.int64]
    body: NDArray[np.int64]
    sticking: NDArray[np.bool_]


@frozen
@dataclass(frozen=True, eq=False)
class MapUpdate:
    """Obstacle cells that contacts proved and that the map did not contain; one solve follows each update.

    An entry of `Run.lessons`.

    Attributes
    ----------
    step : int
        Row of the update in the arrays of `Run`, such as `Run.time`.
    cells : ndarray of int64, shape (c, ndim)
        Indices of the new obstacle cells, at least one.
    points : ndarray of float64, shape (p, 2)
        Touched points of the obstacle in world coordinates, in metres, computed from the measured configuration.

    Examples
    --------
    >>> scene = rg.read_scene("examples/scenes/lesson.toml").replace(hidden=(rg.Box((5.0, 2.2), (6.0, 3.0)),))
    >>> lesson = rg.simulation(scene, k=0.9).run().lessons[0]
    >>> lesson.step, lesson.cells, lesson.points.round(2)
    (37, array([[5, 2]]), array([[5. , 2.8]]))
    """

    step: int
    cells: NDArray[np.int64]
    points: NDArray[np.float64]


@frozen
@dataclass(frozen=True, eq=False)
class Run:
    """A controlled motion, step by step.

    Attributes
    ----------
    ending : TerminationReason
        Reason for the end of the run.
    message : str
        A sentence on the end.
    goal : int or None
        Number of the goal region, from 0, that contains the true configuration at the end; None if the robot did not
        arrive.
    time : ndarray of float64, shape (n,)
        Time of each row since the start of the run, in seconds.  A row is the beginning of a step; the last row is the
        end of the run.
    configuration, believed : ndarray of float64, shape (n, ndim)
        True configuration, continuous across the seams of periodic axes, and configuration according to the position
        sensor, both in world coordinates.
    velocity : ndarray of float64, shape (n, ndim)
        Velocity of the step that begins at this row, in world coordinates, per second; 0 in the last row.
    mode : ndarray of uint8, shape (n,)
        Values of `ControlMode`.
    torque, push : ndarray of float64, shape (n, ndim)
        Generalised forces on the robot in the step: `torque` is the force of all contacts, `push` the external force.
        For a point or a disc these are forces in world coordinates, for an arm joint torques.
    contacts : ContactLog
        All contacts with a force.
    lessons : tuple of MapUpdate
        Updates of the map with obstacle cells that contacts proved, in order.
    space, field : ConfigurationSpace, Field
        The map at the end of the run, and its field.
    penetration : float
        Largest penetration of the robot into an obstacle, in any row and on the straight lines between rows, by exact
        geometry, in metres.  A run with penetration has the ending ``"entered"``, unless the start was blocked.
    goal_distance : float
        Distance from the nearest goal at the end, 0 inside it.  For a goal in the workspace it is the distance of the
        robot's reference point (the tip of an arm) in metres; for a goal cell or joint angles it is a distance between
        configurations, in axis units; NaN outside all goal cells of a run without a scene.  A robot that does not know
        its configuration exactly may arrive in a goal cell and still be outside the goal.
    unsolved : int
        Number of steps in which the robot stood still, because rounding errors prevented a solution for the contact
        forces.
    scene : Scene or None
        The scene of the motion; None for a simulation that was made without a scene.
    learnt : ndarray of bool, shape of the space
        Mask of the cells that contacts added to the map as obstacles.

    Examples
    --------
    >>> run = rg.simulation(rg.read_scene("examples/scenes/lesson.toml"), k=0.9).run()
    >>> run
    <Run arrived after 21.79 s: 44 rows, 0 contacts, 0 lessons>
    >>> run.configuration[[0, -1]].round(1)
    array([[0.5, 6.5],
           [6. , 2. ]])
    """

    ending: TerminationReason
    message: str
    goal: int | None
    time: NDArray[np.float64]
    configuration: NDArray[np.float64]
    believed: NDArray[np.float64]
    velocity: NDArray[np.float64]
    mode: NDArray[np.uint8]
    torque: NDArray[np.float64]
    push: NDArray[np.float64]
    contacts: ContactLog
    lessons: tuple[MapUpdate, ...]
    space: ConfigurationSpace
    field: Field
    penetration: float
    goal_distance: float = float("nan")
    unsolved: int = 0
    scene: Scene | None = None

    def __repr__(self) -> str:
        counts = f"{len(self.contacts.step)} contacts, {len(self.lessons)} lessons"
        return f"<Run {self.ending} after {self.time[-1]:.4g} s: {len(self.time):,} rows, {counts}>"

    _repr_html_ = picture_html

    @property
    def learnt(self) -> NDArray[np.bool_]:
        """Mask of the cells that contacts added to the map as obstacles, shape of the space."""
        mask = np.zeros(self.space.shape, dtype=np.bool_)
        for lesson in self.lessons:
            mask[tuple(lesson.cells.T)] = True
        return mask


class Recorder:
    """Record of the steps of a run, in axis coordinates; `ndim`: number of axes."""

    def __init__(self, ndim: int) -> None:
        self._ndim = ndim
        self._rows: list[tuple[float, Vector, Vector, Vector, ControlMode, Vector, Vector]] = []
        self._contacts: list[tuple[int, ContactSet]] = []
        self._unsolved = 0

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def last_mode(self) -> ControlMode:
        """Mode of the last recorded step; `STREAMLINE` before the first step."""
        return self._rows[-1][4] if self._rows else ControlMode.STREAMLINE

    def add(
        self, time: float, configuration: Vector, believed: Vector, velocity: Vector, mode: ControlMode,
        contacts: ContactSet | None, push: Vector,
    ) -> None:  # fmt: skip
        """Append one step to the record.

        `time`: beginning of the step, in seconds; `configuration, believed` (ndim,): true configuration, and
        configuration according to the sensor; `velocity` (ndim,): velocity of the step, per second; `mode`: kind of
        motion; `contacts`: contacts, None for none; `push` (ndim,): external generalised force.  All vectors are in
        axis coordinates.
        """
        torque = np.zeros(self._ndim)
        if contacts is not None and contacts.pressing.any():
            torque = contacts.torque
            self._contacts.append((len(self._rows), contacts))
        self._unsolved += contacts is not None and not contacts.solved
        self._rows.append((time, configuration, believed, velocity, mode, torque, push))

    def run(
        self, end: End, goal: int | None, lessons: tuple[MapUpdate, ...], field: Field, space: ConfigurationSpace,
        plant: Plant, scene: Scene | None,
    ) -> Run:  # fmt: skip
        """Return the run with all recorded steps, converted to world coordinates.

        `end`: termination reason and message; `goal`: number of the goal region that the robot reached, or None;
        `lessons`: updates of the map; `field, space`: state of the map at the end of the run; `plant`: robot and true
        obstacles; `scene`: scene of the run, or None.  If the robot penetrated an obstacle, the run ends with `ENTERED`
        instead of `end`, unless its start was blocked.
        """
        frame = space.frame
        time, configuration, believed, velocity, mode, torque, push = zip(*self._rows, strict=True)
        places = np.array(configuration)
        penetration = plant.deepest(places)
        if penetration > 0.0 and end.ending is not TerminationReason.START_BLOCKED:
            end, goal = End(TerminationReason.ENTERED, f"the robot entered an obstacle by {penetration:.3g} m"), None
        away = goal_distance(space, places[-1], scene)
        if not away > _AT_GOAL * (plant.cell_motion + float(np.linalg.norm(space.spacing))):
            away = min(away, 0.0)  # rounding error; keeps NaN
        outside = end.ending is TerminationReason.ARRIVED and away > 0.0
        message = f"the robot is in a goal cell, but {away:.3g} outside the goal itself" if outside else end.message
        unsolved = f"; in {self._unsolved} steps no contact forces were known, and the robot stood still"
        return Run(
            ending=end.ending,
            message=message + (unsolved if self._unsolved else ""),
            goal=goal,
            time=np.array(time),
            configuration=space.to_world(places),
            believed=space.to_world(believed),
            velocity=frame.turned_to_world(velocity),
            mode=np.array(mode, dtype=np.uint8),
            torque=frame.turned_to_world(torque),
            push=frame.turned_to_world(push),
            contacts=self._contact_log(frame),
            lessons=lessons,
            space=space,
            field=field,
            penetration=penetration,
            goal_distance=away,
            unsolved=self._unsolved,
            scene=scene,
        )

    def _contact_log(self, frame: Frame) -> ContactLog:
        """Return all recorded contacts with a force, in world coordinates.

        `frame`: position and direction of the axes in the world.
        """

        def column(name: str, empty: NDArray[Any]) -> NDArray[Any]:
            return np.concatenate([empty, *(getattr(each, name)[each.pressing] for _, each in self._contacts)])

        steps = [np.full(int(contacts.pressing.sum()), step) for step, contacts in self._contacts]
        pairs = column("pairs", np.empty(0, PAIR))
        return ContactLog(
            step=np.concatenate([np.empty(0, dtype=np.int64), *steps]),
            point=frame.to_world(pairs["point"]),
            normal=frame.turned_to_world(pairs["normal"]),
            force=frame.turned_to_world(column("force", np.empty((0, 2)))),
            gap=pairs["gap"],
            part=pairs["part"],
            body=pairs["body"],
            sticking=column("sticking", np.empty(0, dtype=np.bool_)),
        )
