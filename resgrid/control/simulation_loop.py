"""The loop of a simulation: sense, choose a mode, resolve contacts, step, learn."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.control.contact import KEEP, Body, ContactSet, Surroundings
from resgrid.control.controller import Nominal
from resgrid.control.escape import goal_offset
from resgrid.control.external_forces import Force
from resgrid.control.navigation import LONGEST, Navigator, StallDetector
from resgrid.control.plant import INSIDE, Plant
from resgrid.control.run_log import ControlMode, End, MapUpdate, Recorder, TerminationReason
from resgrid.control.state_estimate import LiveMap, Sensor
from resgrid.core.space import Cell

Vector = NDArray[np.float64]

_LEADS = 0.1
_HUGE = 1e100


class Loop:
    """One run while it lasts: what is true (the body), what the robot knows (sensor, map), what it does (navigator)."""

    def __init__(
        self, plant: Plant, body: Body, sensor: Sensor, live: LiveMap, push_at: Force, rng: np.random.Generator, *,
        friction: float, learn: bool,
    ) -> None:  # fmt: skip
        self.plant, self.body, self.sensor, self.live = plant, body, sensor, live
        self.push_at, self.rng, self.friction, self.learns = push_at, rng, friction, learn
        self.patience = StallDetector(live.spacing, body.configuration)
        self.navigator = Navigator(live, sensor, self.patience)
        self.recorder, self.lessons = Recorder(len(live.spacing)), list[MapUpdate]()
        self.believed = sensor.believed(body.configuration)
        self.time, self.torque = 0.0, np.zeros(len(live.spacing))
        self._barren: Vector | None = None

    def run(self, max_steps: int) -> End:
        """Step until the run ends."""
        end = self._map_alone() if self.sensor.exact else None
        while end is None:
            if len(self.recorder) >= max_steps:
                end = End(TerminationReason.OUT_OF_STEPS, f"no goal reached after {max_steps} steps")
            else:
                end = self._advance()
        still = np.zeros_like(self.torque)
        mode = ControlMode.ARRIVED if end.ending is TerminationReason.ARRIVED else self.recorder.last_mode
        self.recorder.add(self.time, self.body.configuration, self.believed, still, mode, None, still)
        return end

    def _map_alone(self) -> End | None:
        """What the map alone decides, where belief is exact."""
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
        """One step, or the end."""
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
        # The way back has been taken before: nothing is in it, however near it leads past things.
        back = mode is ControlMode.RETREATING and not pushed
        contacts = None if back else self._contacts(around, velocity, pause)
        pressed = contacts is not None and bool(contacts.pressing.any())
        if contacts is not None:
            velocity = contacts.velocity
            if pressed:
                if self.learns and (proven := self._proven(contacts, believed)) is not None:
                    return self._learn(*proven, contacts, push, pause)
                mode, longest = _contact_mode(mode, contacts), pause
        velocity = controller.limited(velocity)
        elapsed, velocity = body.move(velocity, min(longest, pause), pause, around, 0.0 if back else KEEP)
        if contacts is not None and pressed:
            self.torque = contacts.normal_torque
        elif mode is not ControlMode.JAM or velocity.any():
            self.torque = np.zeros_like(velocity)
        self.recorder.add(self.time, before, believed, velocity, mode, contacts, push)
        self.navigator.remember(mode, before, body.configuration, pushed=pushed)
        if not pushed and not _leads_on(velocity, chosen.velocity):
            self.navigator.fail(mode, body.configuration)
        self.time += elapsed
        return self._watch(mode, elapsed * pace, pushed, seen)

    def _pace(self, velocity: Vector) -> float:
        """Cells that are crossed in a second at a velocity, as fast as the limits allow."""
        controller, spacing = self.live.controller, self.live.spacing
        fastest = float((np.abs(controller.limited(velocity)) / spacing).max())
        if fastest > 0.0:
            return fastest
        return float(np.minimum(controller.speed, controller.speed_limits).max() / spacing.min())

    def _contacts(self, around: Surroundings, velocity: Vector, pause: float) -> ContactSet | None:
        """Contacts at a velocity before speed limits, which will slow all of it down, opening gaps included."""
        controller = self.live.controller
        limited = controller.limited(velocity)
        scale = 1.0 if limited is velocity else float(np.abs(velocity).max() / np.abs(limited).max())
        if scale >= _HUGE:
            velocity, scale = limited, 1.0
        return self.body.contacts(around, velocity, controller.axis_admittance, self.friction, pause / scale)

    def _watch(self, mode: ControlMode, cells: float, pushed: bool, seen: Nominal) -> End | None:
        """Notice that the robot does not get anywhere."""
        patience, place, grid = self.patience, self.body.configuration, self.live.grid
        if pushed:
            patience.renew(place)
            return None
        patience.wait(place, cells)
        if grid is not None and not grid.settled and mode in {ControlMode.WAITING, ControlMode.STREAMLINE}:
            limit = grid.relaxation.patience
            message = (
                f"the unsettled grid leads nowhere from here, and {limit:g} cells' time of waiting has not changed "
                "that: let the grid settle faster, or move more slowly"
            )
            return End(TerminationReason.STALLED, message) if patience.crossed >= limit else None
        if not patience.lost:
            return None
        if self.navigator.exit is not None:
            self.navigator.give_up_exit(place)
        elif self.learns and patience.shake():
            self._dither()
        else:
            return self._stuck(mode, seen)
        return None

    def _stuck(self, mode: ControlMode, seen: Nominal) -> End:
        if mode is ControlMode.JAM:
            return End(
                TerminationReason.JAM, "the contact force lies along the streamline, which following cannot overcome"
            )
        stood = f"the robot has stayed within half a cell while it could have crossed {LONGEST:g}"
        if seen.place != "goal":
            return End(TerminationReason.STALLED, stood)
        away = np.linalg.norm(goal_offset(self.live.space, self.believed))
        return End(
            TerminationReason.STALLED,
            f"in a goal cell, {away:.3g} from the configuration that solves the goal, {stood}",
        )

    def _dither(self) -> None:
        """Shake the robot loose by a small random step, if nothing is in its way."""
        before, none = self.body.configuration, np.zeros_like(self.torque)
        self.torque = none
        if self.body.shaken(self.rng.uniform(-0.1, 0.1, len(none)) * self.live.spacing):
            controller, motion = self.live.controller, self.body.configuration - before
            size = float(np.abs(motion).max())
            velocity = controller.limited(motion * (controller.speed / size))
            believed = self.sensor.sense(self.body.configuration)
            self.recorder.add(self.time, before, believed, velocity, ControlMode.DITHERING, None, none)
            self.time += size / float(np.abs(velocity).max())
            self.navigator.remember(ControlMode.DITHERING, before, self.body.configuration, pushed=False)

    def _proven(self, contacts: ContactSet, believed: Vector) -> tuple[NDArray[np.bool_], Vector] | None:
        """Cells that the contacts prove to be obstacle and the map does not show, and where; None if there are none."""
        pairs = contacts.pairs[contacts.pressing]
        points = pairs["point"] + INSIDE * self.plant.cell_motion * pairs["inward"]
        if not self.sensor.exact:
            true, thought = self.plant.pose(self.body.configuration), self.plant.pose(believed)
            points = np.array([true.carried(p, int(m), thought) for p, m in zip(points, pairs["part"], strict=True)])
        if self._barren is not None and np.array_equal(points, self._barren):
            return None
        proven = np.zeros(self.live.space.shape, dtype=np.bool_)
        for point in points:
            proven |= self.plant.proven_cells(point)
        new = proven & (self.live.space.cell != Cell.OBSTACLE)
        if new.any():
            return new, points
        self._barren = points
        return None

    def _learn(
        self, cells: NDArray[np.bool_], points: Vector, contacts: ContactSet, push: Vector, pause: float
    ) -> End | None:
        """Stand still, mark cells, and solve the changed map, unless it has no path from any place of the way back."""
        place, none = self.body.configuration, np.zeros_like(self.torque)
        world = self.live.space.frame.to_world(points)
        self.lessons.append(MapUpdate(len(self.recorder), np.argwhere(cells), world))
        self.recorder.add(self.time, place, self.believed, none, ControlMode.LEARNING, contacts, push)
        self.live.mark(cells)
        self.time += pause
        self.torque = none
        self.patience.renew(place)
        end = self.navigator.learnt(place)
        if end is None:
            self.live.solve()
        return end


def _leads_on(velocity: Vector, chosen: Vector) -> bool:
    """Whether a velocity still has a part of what was chosen."""
    size = float(np.abs(chosen).max())
    return size > 0.0 and float((velocity / size) @ (chosen / size)) > _LEADS


def _contact_mode(mode: ControlMode, contacts: ContactSet) -> ControlMode:
    if mode in {
        ControlMode.RETREATING,
        ControlMode.JAM,
        ControlMode.FOLLOWING,
        ControlMode.RECOVERING,
        ControlMode.HOMING,
    }:
        return mode
    return ControlMode.STICKING if contacts.sticking.any() else ControlMode.SLIDING
