"""What a robot does while nothing touches it: follow the current, head for the goal, go back, leave lost cells."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.control.controller import Nominal, following_velocity
from resgrid.control.escape import CellIndex, exits, goal_offsets
from resgrid.control.run_log import ControlMode, End, TerminationReason
from resgrid.control.state_estimate import LiveMap, Sensor
from resgrid.core.space import Cell
from resgrid.errors import InputError

Vector = NDArray[np.float64]

LONGEST = 40.0
"""Cells that a robot could have crossed while it stayed within half a cell: then it stands."""

_FLAT = (
    "no current flows here, although a path leads to a goal: nothing drives these cells; open the obstacles (k below "
    "1), or let the edge count as an obstacle (edge = 'obstacle')"
)

DITHERS = 10
"""How often it is shaken before it is given up."""

SAME = 1e-9
"""Share of a cell within which two places are one."""


class StallDetector:
    """Notices that a robot stays within half a cell, by what it could have crossed at the speed of its command.

    `spacing, place` (ndim,).
    """

    def __init__(self, spacing: Vector, place: Vector) -> None:
        self._spacing = spacing
        self.renew(place)

    def renew(self, place: Vector) -> None:
        """Begin anew here."""
        self._anchor, self.crossed, self._dithers = place, 0.0, 0

    def wait(self, place: Vector, cells: float) -> None:
        """The robot is here, and could have crossed so many cells since it was asked last."""
        if np.any(np.abs(place - self._anchor) > 0.5 * self._spacing):
            self.renew(place)
        else:
            self.crossed += cells

    @property
    def lost(self) -> bool:
        """Whether the robot has stood for long."""
        return self.crossed >= LONGEST * (1.0 - 1e-9)

    def shake(self) -> bool:
        """Whether it may be shaken once more."""
        if self._dithers >= DITHERS:
            return False
        self.crossed, self._dithers = 0.0, self._dithers + 1
        return True


class Command(NamedTuple):
    """What the robot would do if nothing touched it.

    `velocity` (ndim,): without forces; `longest`: for how long at most, in seconds.
    """

    mode: ControlMode
    velocity: Vector
    longest: float = np.inf


class Navigator:
    """Chooses what to do, and remembers the way back and the cells that could not be reached."""

    def __init__(self, live: LiveMap, sensor: Sensor, patience: StallDetector) -> None:
        self._live, self._sensor, self._patience = live, sensor, patience
        self._trail: list[Vector] = []
        self._tried: set[CellIndex] = set()
        self._lost = False
        self._first: Vector | None = None
        self.exit: CellIndex | None = None

    def choose(self, believed: Vector, configuration: Vector, seen: Nominal, torque: Vector) -> Command | End:
        """What to do without contact, or how the run ends."""
        live, controller = self._live, self._live.controller
        if self._first is None:
            self._first = believed
        if seen.place == "goal":
            return self._home(believed)
        if seen.place == "off":
            if live.space.goal_connected[tuple(live.space.split(believed)[0])]:
                waits = live.grid is not None
                return (
                    Command(ControlMode.WAITING, np.zeros_like(believed))
                    if waits
                    else End(TerminationReason.NO_CURRENT, _FLAT)
                )
            return self._recover(believed, configuration)
        self._tried, self.exit, self._lost = set(), None, False
        if controller.response == "equipotential" and torque.any():
            following = following_velocity(seen.velocity, torque)
            return Command(ControlMode.FOLLOWING if following.any() else ControlMode.JAM, following)
        slowed = np.abs(seen.velocity).max() / np.abs(controller.limited(seen.velocity)).max()
        return Command(ControlMode.STREAMLINE, seen.velocity, seen.longest * float(slowed))

    def _home(self, believed: Vector) -> Command | End:
        """Straight to what solves the goal: in its own goal cell or, if that is obstructed, in one beside."""
        offsets = goal_offsets(self._live.space, believed, sure=self._sensor.exact)
        own = offsets[0][1]
        if np.all(np.abs(own) <= self._sensor.noise + SAME * self._live.spacing):
            return End(TerminationReason.ARRIVED, "the robot is in a goal")
        self.exit = next((cell for cell, _ in offsets if cell not in self._tried), None)
        return self._straight(ControlMode.HOMING, own if self.exit is None else dict(offsets)[self.exit])

    def _recover(self, believed: Vector, configuration: Vector) -> Command | End:
        """Back the way it came; but if no cell of it has a path any more, out to a cell beside that has one."""
        if self._lost:
            for cell, offset in exits(self._live.space, believed):
                if cell not in self._tried:
                    self.exit = cell
                    return self._straight(ControlMode.RECOVERING, offset)
            if self.exit is not None:  # Out of reach by now: it slid off what was in its way.
                self.give_up_exit(configuration)
        elif self._sensor.noise.any() or (self._sensor.bias.any() and not self._trail):
            # Wrong belief may put the robot into a cell without a path, and no way back leads out of a mistake.
            try:
                return Command(ControlMode.RECOVERING, self._live.controller.axis_nominal(believed).velocity)
            except InputError as error:
                return End(TerminationReason.STALLED, str(error))
        while self._trail:
            offset = self._trail[-1] - configuration
            if np.linalg.norm(offset) > SAME * float(self._live.spacing.min()):
                return self._straight(ControlMode.RETREATING, offset)
            self._trail.pop()
        return self._no_path()

    def _straight(self, mode: ControlMode, offset: Vector) -> Command:
        controller, length = self._live.controller, float(np.linalg.norm(offset))
        velocity = controller.limited(offset * (controller.speed / length))
        return Command(mode, velocity, length / float(np.linalg.norm(velocity)))

    def _no_path(self) -> End:
        assert self._first is not None
        space = self._live.space
        cell = tuple(space.split(self._first)[0].tolist())
        if space.cell[cell] != Cell.OBSTACLE:
            message = "the obstacle cells learnt, with those of the map, separate the start from every goal"
            return End(TerminationReason.NO_PATH, message)
        tried = f", and {len(self._tried)} beside it that have one could not be reached" if self._tried else ""
        message = f"the start's own cell {cell} holds an obstacle, as was learnt, and so has no path to a goal{tried}"
        return End(TerminationReason.NO_PATH, message)

    def fail(self, mode: ControlMode, configuration: Vector) -> None:
        """What was chosen leads nowhere: a cell beside that cannot be reached, or a place that was touched itself."""
        if self.exit is not None:
            self.give_up_exit(configuration)
        elif mode is ControlMode.RETREATING:
            self._trail.pop()

    def give_up_exit(self, configuration: Vector) -> None:
        """Try another cell than the one it is on its way to."""
        assert self.exit is not None
        self._tried.add(self.exit)
        self.exit = None
        if self._lost:
            self._patience.renew(configuration)

    def remember(self, mode: ControlMode, before: Vector, after: Vector, *, pushed: bool) -> None:
        """Keep the way back: every configuration that was left, so that each step of it has been taken before."""
        away = np.abs(after - self._trail[-1]) if self._trail else np.zeros_like(before)
        pushed_off = mode is ControlMode.RETREATING and pushed and np.any(away > SAME * self._live.spacing)
        unsure = mode is ControlMode.RECOVERING and not self._sensor.exact
        if pushed_off or not (mode is ControlMode.RETREATING or unsure):
            self._trail.append(before)

    def learnt(self, configuration: Vector) -> End | None:
        """Look at a changed map: an end where neither a place the robot has been at nor one beside has a path left."""
        self._tried, self.exit = set(), None
        space = self._live.space
        if not space.goal_count:
            return End(TerminationReason.GOAL_BLOCKED, "every goal cell was learnt to be obstacle")
        been = self._sensor.believed(np.array([*self._trail, configuration]))
        cells = tuple(space.split(been)[0].T)
        self._lost = not np.any(space.goal_connected[cells] | (space.cell[cells] == Cell.GOAL))
        if self._lost and not any(exits(space, place) for place in been[::-1]):
            return self._no_path()
        return None
