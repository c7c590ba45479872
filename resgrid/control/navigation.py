"""Motion without contact: along the current, to the goal, back along the trail, out of cells without a path to a goal.

The trail is the list of the true configurations that the robot has passed.  An exit is the cell that the robot
currently moves to in a straight line.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.control.controller import Nominal
from resgrid.control.equipotential import following_velocity
from resgrid.control.escape import CellIndex, exits, goal_offsets
from resgrid.control.run_log import ControlMode, End, TerminationReason
from resgrid.control.state_estimate import LiveMap, Sensor
from resgrid.core.cell import Cell
from resgrid.errors import InputError
from resgrid.planning.streamline import dead_end_reason

Vector = NDArray[np.float64]

STALL_LIMIT = 40.0
"""Smallest distance, in cells, for which a robot counts as stalled.

It is the distance that the robot could have moved at its commanded speeds while it stayed within half a cell.
"""

DITHERS = 10
"""Maximum number of small random motions of a stalled robot; the count restarts after a motion of half a cell."""

SAME = 1e-9
"""Largest distance of two positions that count as equal, as a fraction of the cell width."""


class StallDetector:
    """Detects that a robot stays within half a cell of a place, although its commands would have moved it farther.

    A robot has stalled once the commanded distance since the last restart reaches 40 cells (`STALL_LIMIT`).  `spacing`
    (ndim,): cell widths; `place` (ndim,): position at the start; both in axis units.
    """

    def __init__(self, spacing: Vector, place: Vector) -> None:
        self._spacing = spacing
        self.reset(place)

    def reset(self, place: Vector) -> None:
        """Restart the detection: set the commanded distance and the number of random motions to 0.

        `place` (ndim,): position, in axis units, from which the motion of the robot is measured from now on.
        """
        self._anchor, self.crossed, self._dithers = place, 0.0, 0

    def update(self, place: Vector, cells: float) -> None:
        """Add a commanded distance to the sum, or restart if the robot has moved more than half a cell along an axis.

        `place` (ndim,): present position, in axis units, which is compared with the position at the last restart;
        `cells`: distance that the robot could have moved in the last step, in cells.
        """
        if np.any(np.abs(place - self._anchor) > 0.5 * self._spacing):
            self.reset(place)
        else:
            self.crossed += cells

    @property
    def stalled(self) -> bool:
        """Whether the robot could have moved `STALL_LIMIT` (40) cells since the last restart of the detection."""
        return self.crossed >= STALL_LIMIT * (1.0 - 1e-9)

    def may_dither(self) -> bool:
        """Return whether another small random motion is allowed; if so, count it and set the commanded distance to 0.

        At most 10 random motions (`DITHERS`) are allowed between two restarts of the detection.
        """
        if self._dithers >= DITHERS:
            return False
        self.crossed, self._dithers = 0.0, self._dithers + 1
        return True


class Command(NamedTuple):
    """The velocity command of one step, before contacts and external forces.

    `mode`: kind of motion; `velocity` (ndim,): in axis coordinates, per second; `longest`: maximum duration of the
    step, in seconds.
    """

    mode: ControlMode
    velocity: Vector
    longest: float = np.inf


class Navigator:
    """Chooses the command without contact, and records the trail and the cells that the robot could not reach.

    The trail is the list of the true configurations that the robot has passed.  `live`: map and controller of the
    robot; `sensor`: position sensor; `stall`: stall detector. The attribute `exit` is the cell to which the robot moves
    in a straight line, None for other motions.
    """

    def __init__(self, live: LiveMap, sensor: Sensor, stall: StallDetector) -> None:
        self._live, self._sensor, self._stall = live, sensor, stall
        self._trail: list[Vector] = []
        self._tried: set[CellIndex] = set()
        self._cut_off = False
        self._first: Vector | None = None
        self.exit: CellIndex | None = None

    def choose(self, believed: Vector, configuration: Vector, seen: Nominal, torque: Vector) -> Command | End:
        """Return the command of the next step without contact, or the end of the run.

        `believed` (ndim,): configuration according to the sensor; `configuration` (ndim,): true configuration; `seen`:
        nominal motion at `believed`; `torque` (ndim,): generalised contact force of the last step; all in axis
        coordinates.
        """
        live, controller = self._live, self._live.controller
        if self._first is None:
            self._first = believed
        if seen.place == "goal":
            return self._to_goal(believed)
        if seen.place == "off":
            cell = tuple(live.space.split(believed)[0].tolist())
            if not live.space.goal_connected[cell]:
                return self._recover(believed, configuration)
            if live.grid is not None:
                return Command(ControlMode.WAITING, np.zeros_like(believed))
            return End(TerminationReason.NO_CURRENT, dead_end_reason(controller.field, cell))
        self._tried, self.exit, self._cut_off = set(), None, False
        if controller.response == "equipotential" and torque.any():
            following = following_velocity(seen.velocity, torque)
            return Command(ControlMode.FOLLOWING if following.any() else ControlMode.JAM, following)
        slowed = np.abs(seen.velocity).max() / np.abs(controller.limited(seen.velocity, believed)).max()
        return Command(ControlMode.STREAMLINE, seen.velocity, seen.longest * float(slowed))

    def _to_goal(self, believed: Vector) -> Command | End:
        """Return the command to the goal in the present goal cell or a neighbour cell, or the end of a run at the goal.

        A neighbour cell is tried if the robot could not reach the configuration that solves the goal in its own cell.
        `believed` (ndim,): configuration according to the sensor, in axis coordinates.
        """
        offsets = goal_offsets(self._live.space, believed, sure=self._sensor.exact)
        own = offsets[0][1]
        if np.all(np.abs(own) <= self._sensor.noise + SAME * self._live.spacing):
            return End(TerminationReason.ARRIVED, "the robot is in a goal")
        self.exit = next((cell for cell, _ in offsets if cell not in self._tried), None)
        return self._straight(ControlMode.HOMING, own if self.exit is None else dict(offsets)[self.exit], believed)

    def _recover(self, believed: Vector, configuration: Vector) -> Command | End:
        """Return the command that leads out of a cell without a path to a goal, or the end of a run without way out.

        The robot moves back along its trail (the configurations that it has passed) or, if none of them lies in a cell
        with a path, straight to a near cell with a path. With noise, or with a bias and an empty trail, it moves
        straight to the nearest cell with a path, because the measurement may be wrong.  `believed` (ndim,):
        configuration according to the sensor; `configuration` (ndim,): true configuration; both in axis coordinates.
        """
        if self._cut_off:
            for cell, offset in exits(self._live.space, believed):
                if cell not in self._tried:
                    self.exit = cell
                    return self._straight(ControlMode.RECOVERING, offset, believed)
            if self.exit is not None:  # the robot slid away from the obstacle, and the exit is out of reach
                self.give_up_exit(configuration)
        elif self._sensor.noise.any() or (self._sensor.bias.any() and not self._trail):
            # A wrong belief may place the robot in a cell without a path; moving back would not correct it.
            try:
                return Command(ControlMode.RECOVERING, self._live.controller.axis_nominal(believed).velocity)
            except InputError as error:
                return End(TerminationReason.STALLED, str(error))
        while self._trail:
            offset = self._trail[-1] - configuration
            if np.linalg.norm(offset) > SAME * float(self._live.spacing.min()):
                return self._straight(ControlMode.RETREATING, offset, believed)
            self._trail.pop()
        return self._no_path()

    def _straight(self, mode: ControlMode, offset: Vector, believed: Vector) -> Command:
        """Return the command of a straight motion at nominal speed, whose maximum duration ends at the target.

        `mode`: kind of motion; `offset` (ndim,): vector from the present configuration to the target, not 0; `believed`
        (ndim,): configuration according to the sensor, at which the speed limits apply; both in axis coordinates.
        """
        controller, length = self._live.controller, float(np.linalg.norm(offset))
        velocity = controller.limited(offset * (controller.speed / length), believed)
        return Command(mode, velocity, length / float(np.linalg.norm(velocity)))

    def _no_path(self) -> End:
        """Return the end of a run that has no path to a goal, with a message about the start cell."""
        assert self._first is not None
        space = self._live.space
        cell = tuple(space.split(self._first)[0].tolist())
        if space.cell[cell] != Cell.OBSTACLE:
            message = "the learnt obstacle cells and those of the map separate the start from every goal"
            return End(TerminationReason.NO_PATH, message)
        tried = f"; {len(self._tried)} near cells with a path could not be reached" if self._tried else ""
        message = f"the start's own cell {cell} was learnt to hold an obstacle, and has no path to a goal{tried}"
        return End(TerminationReason.NO_PATH, message)

    def fail(self, mode: ControlMode, configuration: Vector) -> None:
        """Discard the target of a straight motion after a step without progress.

        A target cell is marked as unreachable. On the way back along the trail (the passed configurations), the last
        configuration of the trail is removed. `mode`: kind of motion of the step; `configuration` (ndim,): present true
        configuration, in axis coordinates, at which stall detection may restart.
        """
        if self.exit is not None:
            self.give_up_exit(configuration)
        elif mode is ControlMode.RETREATING:
            self._trail.pop()

    def give_up_exit(self, configuration: Vector) -> None:
        """Mark the exit, the cell to which the robot moves in a straight line, as unreachable.

        If no passed configuration lies in a cell with a path to a goal, stall detection restarts. `configuration`
        (ndim,): present true configuration in axis coordinates, at which it restarts.
        """
        assert self.exit is not None
        self._tried.add(self.exit)
        self.exit = None
        if self._cut_off:
            self._stall.reset(configuration)

    def remember(self, mode: ControlMode, before: Vector, after: Vector, *, pushed: bool) -> None:
        """Append the configuration before a step to the trail, the list of configurations for the way back.

        On the way back a configuration is appended only where an external force pushed the robot off the trail. With an
        inexact sensor, none is appended while the robot leaves a cell without a path (mode `RECOVERING`). `mode`: kind
        of motion of the step; `before, after` (ndim,): true configurations before and after the step, in axis
        coordinates; `pushed`: whether an external force acted in the step.
        """
        away = np.abs(after - self._trail[-1]) if self._trail else np.zeros_like(before)
        pushed_off = mode is ControlMode.RETREATING and pushed and np.any(away > SAME * self._live.spacing)
        unsure = mode is ControlMode.RECOVERING and not self._sensor.exact
        if pushed_off or not (mode is ControlMode.RETREATING or unsure):
            self._trail.append(before)

    def learnt(self, configuration: Vector) -> End | None:
        """Forget the exit and the unreachable cells after a map update; return the end of the run, or None.

        The run ends if no goal cell is left. It also ends if no configuration that the robot has passed, nor the
        present configuration, lies in a cell with a path to a goal or within 2 cells of such a cell.  `configuration`
        (ndim,): present true configuration, in axis coordinates.
        """
        self._tried, self.exit = set(), None
        space = self._live.space
        if not space.goal_count:
            return End(TerminationReason.GOAL_BLOCKED, "every goal cell was learnt to be an obstacle")
        been = self._sensor.believed(np.array([*self._trail, configuration]))
        cells = tuple(space.split(been)[0].T)
        self._cut_off = not np.any(space.goal_connected[cells] | (space.cell[cells] == Cell.GOAL))
        if self._cut_off and not any(exits(space, place) for place in been[::-1]):
            return self._no_path()
        return None
