"""The simulation loop: sense, choose a mode, resolve contacts, step, learn."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.control.contact import KEEP, ContactSet, SimulatedRobot, Surroundings
from resgrid.control.controller import Nominal
from resgrid.control.escape import goal_offset
from resgrid.control.external_forces import Force
from resgrid.control.navigation import STALL_LIMIT, Navigator, StallDetector
from resgrid.control.plant import INSIDE, Plant
from resgrid.control.run_log import ControlMode, End, MapUpdate, Recorder, TerminationReason
from resgrid.control.state_estimate import LiveMap, Sensor
from resgrid.core.cell import Cell

Vector = NDArray[np.float64]

_PROGRESS = 0.1
"""Limit of the scalar product of a step's velocity and its command; a step with a larger product counts as progress.

Both vectors are divided by the largest component of the command.
"""
_HUGE = 1e100
"""Smallest factor between a command and its limited value for which contacts are solved for the limited command.

With a smaller factor, contacts are solved for the command before the speed limits.
"""


class Loop:
    """State of one simulation run: the true body, the sensor and map of the robot, its navigator, and the records.

    `plant`: robot and true obstacles; `body`: true configuration; `sensor`: position sensor; `live`: the robot's map
    and controller; `push_at`: external generalised force as a function of time (s) and configuration; `rng`: random
    generator of the small random motions; `friction`: friction coefficient; `learn`: whether contacts add obstacle
    cells to the map.
    """

    def __init__(
        self, plant: Plant, body: SimulatedRobot, sensor: Sensor, live: LiveMap, push_at: Force,
        rng: np.random.Generator, *, friction: float, learn: bool,
    ) -> None:  # fmt: skip
        self.plant, self.body, self.sensor, self.live = plant, body, sensor, live
        self.push_at, self.rng, self.friction, self.learns = push_at, rng, friction, learn
        self.stall = StallDetector(live.spacing, body.configuration)
        self.navigator = Navigator(live, sensor, self.stall)
        self.recorder, self.lessons = Recorder(len(live.spacing)), list[MapUpdate]()
        self.believed = sensor.believed(body.configuration)
        self.time, self.torque = 0.0, np.zeros(len(live.spacing))
        self._known_points: Vector | None = None

    def run(self, max_steps: int) -> End:
        """Take time steps until the run ends, at most `max_steps`; return the reason and the message of the end."""
        end = self._end_by_map() if self.sensor.exact else None
        while end is None:
            if len(self.recorder) >= max_steps:
                end = End(TerminationReason.OUT_OF_STEPS, f"no goal reached after {max_steps} steps")
            else:
                end = self._advance()
        still = np.zeros_like(self.torque)
        mode = ControlMode.ARRIVED if end.ending is TerminationReason.ARRIVED else self.recorder.last_mode
        self.recorder.add(self.time, self.body.configuration, self.believed, still, mode, None, still)
        return end

    def _end_by_map(self) -> End | None:
        """Return the end of the run if the map decides it at the start, else None.

        Reasons: the start is an obstacle cell, all goals are blocked, or no path leads from the start to a goal.
        """
        space = self.live.space
        cell = tuple(space.split(self.believed)[0].tolist())
        if space.cell[cell] == Cell.OBSTACLE:
            return End(TerminationReason.START_BLOCKED, f"the start's cell {cell} is an obstacle in the map")
        if space.cell[cell] != Cell.FREE or space.goal_connected[cell]:
            return None
        if not space.goal_connected.any():
            return End(TerminationReason.GOAL_BLOCKED, "in the map no free cell has a path to a goal")
        return End(TerminationReason.NO_PATH, f"in the map the start's cell {cell} has no path to a goal")

    def _advance(self) -> End | None:
        """Take one time step: sense, choose a command, resolve contacts, move; return the end of the run, or None."""
        body, before = self.body, self.body.configuration
        self.live.read(self.time)
        believed = self.believed = self.sensor.sense(before)
        controller, frame = self.live.controller, self.live.space.frame
        seen = controller.seen(believed)
        push = frame.turned_from_world(self.push_at(self.time, self.live.space.to_world(before)))
        chosen = self.navigator.choose(believed, before, seen, self.torque)
        if isinstance(chosen, End):
            return chosen
        mode, longest, pushed = chosen.mode, chosen.longest, bool(push.any())
        pace = self._pace(seen.velocity if seen.velocity.any() else chosen.velocity)
        pause, velocity = body.step / pace, chosen.velocity
        if pushed:
            velocity = controller.admitting(velocity, push)
            mode, longest = ControlMode.PUSHED if mode is ControlMode.STREAMLINE else mode, pause
        around = body.look()
        # The robot has moved along this path before, so that it is free, however small the gaps are.
        on_trail = mode is ControlMode.RETREATING and not pushed
        contacts = None if on_trail else self._contacts(around, velocity, pause)
        pressed = contacts is not None and bool(contacts.pressing.any())
        if contacts is not None:
            velocity = contacts.velocity
            if pressed:
                if self.learns and (proven := self._proven_cells(contacts, believed)) is not None:
                    return self._learn(*proven, contacts, push, pause)
                mode, longest = _contact_mode(mode, contacts), pause
        velocity = controller.limited(velocity, believed)
        elapsed, velocity = body.move(velocity, min(longest, pause), pause, around, 0.0 if on_trail else KEEP)
        if contacts is not None and pressed:
            self.torque = contacts.normal_torque
        elif mode is not ControlMode.JAM or velocity.any():
            self.torque = np.zeros_like(velocity)
        self.recorder.add(self.time, before, believed, velocity, mode, contacts, push)
        self.navigator.remember(mode, before, body.configuration, pushed=pushed)
        if not pushed and not _makes_progress(velocity, chosen.velocity):
            self.navigator.fail(mode, body.configuration)
        self.time += elapsed
        return self._check_progress(mode, elapsed * pace, pushed, seen)

    def _pace(self, velocity: Vector) -> float:
        """Return the largest axis component of a velocity after its reduction to the speed limits, in cells per second.

        `velocity` (ndim,): in axis coordinates, per second.  For a velocity of 0 the result is that of the nominal
        speed of the controller, or of the largest speed limit if this is lower.
        """
        controller, spacing = self.live.controller, self.live.spacing
        fastest = float((np.abs(controller.limited(velocity, self.believed)) / spacing).max())
        if fastest > 0.0:
            return fastest
        return float(np.minimum(controller.speed, controller.speed_limits).max() / spacing.min())

    def _contacts(self, around: Surroundings, velocity: Vector, pause: float) -> ContactSet | None:
        """Return the contacts and their forces at a commanded velocity, or None without contacts.

        The speed limits later divide the whole velocity by a factor, and with it the rates at which gaps open.
        Therefore the contacts are computed for a duration that is shorter by this factor. `around`: pairs of near
        points; `velocity` (ndim,): command in axis coordinates, per second, before the speed limits; `pause`: duration
        of the step, in seconds.
        """
        controller = self.live.controller
        limited = controller.limited(velocity, self.believed)
        scale = 1.0 if limited is velocity else float(np.abs(velocity).max() / np.abs(limited).max())
        if scale >= _HUGE:
            velocity, scale = limited, 1.0
        return self.body.contacts(around, velocity, controller.axis_admittance, self.friction, pause / scale)

    def _check_progress(self, mode: ControlMode, cells: float, pushed: bool, seen: Nominal) -> End | None:
        """Return the end of a run that makes no progress, else None.

        A robot has stalled if it stays within half a cell although it could have crossed 40 cells. It then gives up its
        target cell or, with learning, makes a small random motion, at most ten times; otherwise the run ends. A run
        also ends if the robot has waited too long for a grid to settle. `mode`: kind of motion of the step; `cells`:
        distance that the step could have covered, in cells; `pushed`: whether an external force acted; `seen`: nominal
        motion at the measured configuration.
        """
        stall, place, grid = self.stall, self.body.configuration, self.live.grid
        if pushed:
            stall.reset(place)
            return None
        stall.update(place, cells)
        if grid is not None and not grid.settled and mode in {ControlMode.WAITING, ControlMode.STREAMLINE}:
            limit = grid.relaxation.patience
            message = (
                f"the unsettled grid has no path from here, after a waiting time of {limit:g} cells; let the grid "
                "settle faster, or move more slowly"
            )
            return End(TerminationReason.STALLED, message) if stall.crossed >= limit else None
        if not stall.stalled:
            return None
        if self.navigator.exit is not None:
            self.navigator.give_up_exit(place)
        elif self.learns and stall.may_dither():
            self._dither()
        else:
            return self._end_of_stall(mode, seen)
        return None

    def _end_of_stall(self, mode: ControlMode, seen: Nominal) -> End:
        """Return the end of a stalled run; its message depends on the mode and on the place (goal cell or not).

        `mode`: kind of motion of the last step; `seen`: nominal motion at the measured configuration.
        """
        if mode is ControlMode.JAM:
            return End(
                TerminationReason.JAM,
                "the contact force lies along the streamline, which equipotential following cannot resolve",
            )
        stood = f"the robot has stayed within half a cell while it could have crossed {STALL_LIMIT:g}"
        if seen.place != "goal":
            return End(TerminationReason.STALLED, stood)
        away = np.linalg.norm(goal_offset(self.live.space, self.believed))
        return End(
            TerminationReason.STALLED,
            f"in a goal cell, {away:.3g} from the configuration that solves the goal, {stood}",
        )

    def _dither(self) -> None:
        """Move the robot by a random offset and record the step, unless the motion would meet an obstacle.

        The offset is at most 0.1 cell per axis.
        """
        before, none = self.body.configuration, np.zeros_like(self.torque)
        self.torque, believed = none, self.sensor.sense(before)
        if self.body.shaken(self.rng.uniform(-0.1, 0.1, len(none)) * self.live.spacing):
            controller, motion = self.live.controller, self.body.configuration - before
            size = float(np.abs(motion).max())
            velocity = controller.limited(motion * (controller.speed / size))
            self.recorder.add(self.time, before, believed, velocity, ControlMode.DITHERING, None, none)
            self.time += size / float(np.abs(velocity).max())
            self.navigator.remember(ControlMode.DITHERING, before, self.body.configuration, pushed=False)

    def _proven_cells(self, contacts: ContactSet, believed: Vector) -> tuple[NDArray[np.bool_], Vector] | None:
        """Return the mask of new obstacle cells that contacts prove, and the touched points; None without a new cell.

        The mask has the shape of the space, the points the shape (p, 2), in metres, in axis coordinates of the
        workspace. `contacts`: contacts with forces; `believed` (ndim,): configuration according to the sensor, in axis
        coordinates.
        """
        pairs = contacts.pairs[contacts.pressing]
        points = pairs["point"] + INSIDE * self.plant.cell_motion * pairs["inward"]
        if not self.sensor.exact:
            true, thought = self.plant.pose(self.body.configuration), self.plant.pose(believed)
            points = np.array([true.carried(p, int(m), thought) for p, m in zip(points, pairs["part"], strict=True)])
        if self._known_points is not None and np.array_equal(points, self._known_points):
            return None
        proven = np.zeros(self.live.space.shape, dtype=np.bool_)
        for point in points:
            proven |= self.plant.proven_cells(point)
        new = proven & (self.live.space.cell != Cell.OBSTACLE)
        if new.any():
            return new, points
        self._known_points = points
        return None

    def _learn(
        self, cells: NDArray[np.bool_], points: Vector, contacts: ContactSet, push: Vector, pause: float
    ) -> End | None:
        """Stand still for a step, mark cells as obstacles, and solve the new map; return the end of the run, or None.

        The run ends if no goal cell is left, or if neither the trail (the configurations that the robot has passed) nor
        the present configuration is in a cell with a path to a goal or within 2 cells of such a cell.  `cells`: mask of
        the new obstacle cells (shape of the space); `points` (p, 2): touched points, in metres; `contacts`: contacts of
        the step; `push` (ndim,): external generalised force; `pause`: duration of the step, in seconds.
        """
        place, none = self.body.configuration, np.zeros_like(self.torque)
        world = self.live.space.frame.to_world(points)
        self.lessons.append(MapUpdate(len(self.recorder), np.argwhere(cells), world))
        self.recorder.add(self.time, place, self.believed, none, ControlMode.LEARNING, contacts, push)
        self.live.mark(cells)
        self.time += pause
        self.torque = none
        self.stall.reset(place)
        end = self.navigator.learnt(place)
        if end is None:
            self.live.solve()
        return end


def _makes_progress(velocity: Vector, chosen: Vector) -> bool:
    """Return whether the scalar product of the velocity of a step and its command exceeds a limit.

    Both vectors are divided by the largest component of the command; the limit is 0.1.  `velocity` (ndim,): velocity of
    the step; `chosen` (ndim,): command without contacts and external force; both in axis coordinates, per second.
    """
    size = float(np.abs(chosen).max())
    return size > 0.0 and float((velocity / size) @ (chosen / size)) > _PROGRESS


def _contact_mode(mode: ControlMode, contacts: ContactSet) -> ControlMode:
    """Return the mode to record for a step with contact forces: `STICKING` if friction holds a contact, else `SLIDING`.

    `mode`: mode without contacts; it is returned for jams and for motions along equipotentials, along the trail or to a
    target.  `contacts`: contacts of the step.
    """
    if mode in {
        ControlMode.RETREATING,
        ControlMode.JAM,
        ControlMode.FOLLOWING,
        ControlMode.RECOVERING,
        ControlMode.HOMING,
    }:
        return mode
    return ControlMode.STICKING if contacts.sticking.any() else ControlMode.SLIDING
