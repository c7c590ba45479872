"""The loop of a simulation: sense, choose a mode, resolve contacts, step, learn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.arguments import check_whole
from resgrid.control.beginning import checked_start, live_grid, static_ending
from resgrid.control.contact import Touch
from resgrid.control.controller import Nominal
from resgrid.control.equipotential import following_velocity
from resgrid.control.exits import way_to_goal, ways_home, ways_out
from resgrid.control.learning import INSIDE, learn, proven_cells
from resgrid.control.log import Ending, Lesson, Mode, Run
from resgrid.control.motion import KEEP, Body
from resgrid.control.patience import LONGEST, Patience
from resgrid.control.pushes import Force, Push, force_of
from resgrid.control.recorder import Recorder
from resgrid.control.simulation import believed_offsets
from resgrid.errors import InputError
from resgrid.space import Cell

if TYPE_CHECKING:
    from resgrid.control.simulation import Simulation

Vector = NDArray[np.float64]

_SAME = 1e-9
_NO_WAY = 0.1


class Choice(NamedTuple):
    """What the robot would do if nothing touched it.

    `velocity` (ndim,): without forces; `longest`: for how long at most, in seconds.
    """

    mode: Mode
    velocity: Vector
    longest: float = np.inf


class Loop:
    """State of one run; everything it is made from stays as it is."""

    def __init__(
        self, simulation: Simulation, start: ArrayLike, pushes: Sequence[Push] | Force | None, bias: ArrayLike,
        noise: ArrayLike, seed: int, max_steps: int,
    ) -> None:  # fmt: skip
        space = simulation.space
        self.simulation, self.plant, self.controller = simulation, simulation.plant, simulation.controller
        self.bias = space.frame.turned_from_world(believed_offsets(bias, space.ndim, "bias"))
        self.noise = believed_offsets(noise, space.ndim, "noise")
        check_whole("max_steps", max_steps, 1)
        check_whole("seed", seed, 0)
        self.push_at, self.max_steps = force_of(pushes, space.ndim), max_steps
        self.rng = np.random.default_rng(seed)
        self.body = Body(self.plant, checked_start(simulation, start), simulation.step, simulation.margin)
        self.believed = self.plant.within_stops(self.configuration + self.bias)
        self.space, self.lessons = space, list[Lesson]()
        self.spacing = space.spacing
        self.time, self.torque = 0.0, np.zeros(space.ndim)
        self.trail: list[Vector] = []
        self.lost, self.tried = False, set[tuple[int, ...]]()
        self.exit: tuple[int, ...] | None = None
        self.barren: Vector | None = None
        self.patience = Patience(space.spacing, self.configuration)
        self.pace = float(np.minimum(self.controller.speed, self.controller.speed_limits).max() / space.spacing.min())
        self.recorder = Recorder(space.ndim)
        self.grid = live_grid(simulation)
        self.grid_time = 0.0
        if self.grid is not None:
            self.controller = self.controller.with_field(self.grid.field)
        self.ending = static_ending(space, self.believed) if self.exact else None

    @property
    def configuration(self) -> Vector:
        """Where the robot truly is."""
        return self.body.configuration

    @property
    def exact(self) -> bool:
        """Whether the robot knows where it is."""
        return not (self.bias.any() or self.noise.any())

    def run(self) -> Run:
        """Step until the run ends."""
        while self.ending is None:
            if len(self.recorder) >= self.max_steps:
                self.ending = (Ending.OUT_OF_STEPS, f"no goal reached after {self.max_steps} steps")
            else:
                self._advance()
        return self._result()

    def _sense(self) -> Vector:
        believed = self.configuration + self.bias
        if self.noise.any():
            error = self.noise * self.rng.uniform(-1.0, 1.0, len(self.noise))
            believed = believed + self.space.frame.turned_from_world(error)
        return self.plant.within_stops(believed)

    def _settle(self) -> None:
        """Read the grid anew where it has moved since the last step."""
        if self.grid is None:
            return
        crossed = (self.time - self.grid_time) * self.controller.speed / float(self.spacing.min())
        self.grid_time = self.time
        if self.grid.advance(crossed):
            self.controller = self.controller.with_field(self.grid.field)

    def _advance(self) -> None:
        self._settle()
        believed = self.believed = self._sense()
        seen = self.controller.seen(believed)
        force = self.push_at(self.time, self.space.to_world(self.configuration))
        push = self.space.frame.turned_from_world(force)
        chosen = self._choose(believed, seen)
        if chosen is None:
            return
        mode, longest, pushed = chosen.mode, chosen.longest, bool(push.any())
        pace = self._pace(seen.velocity if seen.velocity.any() else chosen.velocity)
        pause = self.simulation.step / pace
        velocity = chosen.velocity
        if pushed:
            velocity = self.controller.given_way(velocity, push)
            mode, longest = Mode.PUSHED if mode is Mode.STREAMLINE else mode, pause
        velocity = self.controller.limited(velocity)
        around = self.body.look()
        # The way back has been taken before: nothing is in it, however near it leads past things.
        back, felt = mode is Mode.RETREATING and not pushed, None
        if not back:
            felt = self._touch(around, velocity, pause)
        if felt is not None:
            velocity = felt.velocity
            if felt.pressing.any():
                if self.simulation.learn and self._learn(felt, believed, push, pause):
                    return
                mode, longest = _contact_mode(mode, felt), pause
        before = self.configuration
        elapsed, velocity = self.body.move(velocity, min(longest, pause), pause, around, 0.0 if back else KEEP)
        if felt is not None and felt.pressing.any():
            self.torque = felt.normal_torque
        elif mode is not Mode.JAM or velocity.any():
            self.torque = np.zeros_like(velocity)
        self.recorder.add(self.time, before, believed, velocity, mode, felt, push)
        self._remember(mode, pushed, before)
        if not pushed and not _leads_on(velocity, chosen.velocity):
            self._go_elsewhere(mode)
        self.time += elapsed
        self._watch(mode, elapsed * pace, pushed, seen)

    def _go_elsewhere(self, mode: Mode) -> None:
        """What was chosen leads nowhere: a cell beside that cannot be reached, or a place that was touched itself."""
        if self.exit is not None:
            self._give_up_exit()
        elif mode is Mode.RETREATING:
            self.trail.pop()

    def _give_up_exit(self) -> None:
        assert self.exit is not None
        self.tried.add(self.exit)
        self.exit = None
        if self.lost:
            self.patience.renew(self.configuration)

    def _pace(self, velocity: Vector) -> float:
        """Cells that are crossed in a second at a velocity, as fast as the limits allow."""
        fastest = float((np.abs(self.controller.limited(velocity)) / self.spacing).max())
        return fastest if fastest > 0.0 else self.pace

    def _choose(self, believed: Vector, seen: Nominal) -> Choice | None:
        """What to do without contact; None where the run ends."""
        if seen.place == "goal":
            return self._home(believed)
        if seen.place == "off":
            if self.grid is not None and self.space.goal_connected[tuple(self.space.split(believed)[0])]:
                return Choice(Mode.WAITING, np.zeros_like(believed))
            return self._way_back(believed)
        self.tried, self.exit, self.lost = set(), None, False
        if self.controller.response == "equipotential" and self.torque.any():
            following = following_velocity(seen.velocity, self.torque)
            return Choice(Mode.FOLLOWING if following.any() else Mode.JAM, following)
        slowed = np.abs(seen.velocity).max() / np.abs(self.controller.limited(seen.velocity)).max()
        return Choice(Mode.STREAMLINE, seen.velocity, seen.longest * float(slowed))

    def _home(self, believed: Vector) -> Choice | None:
        """Straight to what solves the goal: in its own goal cell or, if that is obstructed, in one beside."""
        ways = ways_home(self.space, believed)
        own = ways[0][1]
        if np.all(np.abs(own) <= self.noise + _SAME * self.spacing):
            self.ending = (Ending.ARRIVED, "the robot is in a goal")
            return None
        self.exit = next((at for at, _ in ways if at not in self.tried), None)
        return self._straight(Mode.HOMING, own if self.exit is None else dict(ways)[self.exit])

    def _straight(self, mode: Mode, way: Vector) -> Choice:
        length = float(np.linalg.norm(way))
        velocity = self.controller.limited(way * (self.controller.speed / length))
        return Choice(mode, velocity, length / float(np.linalg.norm(velocity)))

    def _recover(self, believed: Vector) -> Choice | None:
        """Wrong belief may put the robot into a cell without a path, and no way back leads out of a mistake."""
        try:
            return Choice(Mode.RECOVERING, self.controller.axis_nominal(believed).velocity)
        except InputError as error:
            self.ending = (Ending.STALLED, str(error))
            return None

    def _way_back(self, believed: Vector) -> Choice | None:
        """Back the way it came; but if no cell of it has a path any more, out to a cell beside that has one."""
        if self.lost:
            for at, way in ways_out(self.space, believed):
                if at not in self.tried:
                    self.exit = at
                    return self._straight(Mode.RECOVERING, way)
            if self.exit is not None:  # Out of reach by now: it slid off what was in the way.
                self._give_up_exit()
        elif self.noise.any() or (self.bias.any() and not self.trail):
            return self._recover(believed)
        while self.trail:
            way = self.trail[-1] - self.configuration
            if np.linalg.norm(way) > _SAME * float(self.spacing.min()):
                return self._straight(Mode.RETREATING, way)
            self.trail.pop()
        self.ending = (Ending.NO_PATH, self._why_no_path())
        return None

    def _why_no_path(self) -> str:
        first = self.recorder.first_believed if len(self.recorder) else self.believed
        cell = tuple(self.space.split(first)[0].tolist())
        if self.space.cell[cell] != Cell.OBSTACLE:
            return "the obstacle cells learnt, with those of the map, separate the start from every goal"
        tried = f", and {len(self.tried)} beside it that have one could not be reached" if self.tried else ""
        return f"the start's own cell {cell} holds an obstacle, as was learnt, and so has no path to a goal{tried}"

    def _touch(self, around: object, velocity: Vector, pause: float) -> Touch | None:
        """Contacts, and the velocity with them, slowed down as a whole where it is faster than the limits."""
        felt = self.body.touch(around, velocity, self.controller.axis_admittance, self.simulation.friction, pause)  # type: ignore[arg-type]
        if felt is None:
            return None
        limited = self.controller.limited(felt.velocity)
        size = float(np.abs(felt.velocity).max())
        return felt if limited is felt.velocity else felt.slowed(float(np.abs(limited).max()) / size)

    def _remember(self, mode: Mode, pushed: bool, before: Vector) -> None:
        """Keep the way back: every configuration that was left, so that each step of it has been taken before."""
        away = np.abs(self.configuration - self.trail[-1]) if self.trail else np.zeros_like(before)
        pushed_off = mode is Mode.RETREATING and pushed and np.any(away > _SAME * self.spacing)
        unsure = mode is Mode.RECOVERING and not self.exact
        if pushed_off or not (mode is Mode.RETREATING or unsure):
            self.trail.append(before)

    def _watch(self, mode: Mode, cells: float, pushed: bool, seen: Nominal) -> None:
        """Notice that the robot does not get anywhere."""
        if pushed:
            self.patience.renew(self.configuration)
            return
        self.patience.wait(self.configuration, cells)
        if self.grid is not None and not self.grid.settled and mode in {Mode.WAITING, Mode.STREAMLINE}:
            self._lose_patience()
        elif self.patience.lost and self.exit is not None:
            self._give_up_exit()
        elif self.patience.lost:
            if self.simulation.learn and self.patience.shake():
                self._dither()
            elif mode is Mode.JAM:
                self.ending = (
                    Ending.JAM,
                    "the contact force lies along the streamline, which following cannot overcome",
                )
            else:
                self.ending = (Ending.STALLED, self._why_stalled(seen))

    def _why_stalled(self, seen: Nominal) -> str:
        stood = f"the robot has stayed within half a cell while it could have crossed {LONGEST:g}"
        if seen.place != "goal":
            return stood
        away = np.linalg.norm(way_to_goal(self.space, self.believed))
        return f"in a goal cell, {away:.3g} from the configuration that solves the goal, {stood}"

    def _lose_patience(self) -> None:
        assert self.simulation.settling is not None
        patience = self.simulation.settling.patience
        if self.patience.crossed >= patience:
            self.ending = (
                Ending.STALLED, f"the unsettled grid leads nowhere from here, and {patience:g} cells' time of waiting "
                "has not changed that: let the grid settle faster, or move more slowly",
            )  # fmt: skip

    def _dither(self) -> None:
        before, none = self.configuration, np.zeros(self.space.ndim)
        self.torque = none
        if self.body.shaken(self.rng.uniform(-0.1, 0.1, self.space.ndim) * self.spacing):
            motion = self.configuration - before
            size = float(np.abs(motion).max())
            velocity = self.controller.limited(motion * (self.controller.speed / size))
            self.recorder.add(self.time, before, self._sense(), velocity, Mode.DITHERING, None, none)
            self.time += size / float(np.abs(velocity).max())
            self.trail.append(before)

    def _learn(self, felt: Touch, believed: Vector, push: Vector, pause: float) -> bool:
        """Mark what the contacts prove; whether that was anything new."""
        pressing = felt.pressing
        inner = felt.point + INSIDE * self.plant.cell_motion * felt.inward
        points = inner[pressing]
        if not self.exact:
            true, seen = self.plant.pose(self.configuration), self.plant.pose(believed)
            points = np.array([true.carried(p, int(m), seen) for p, m in zip(points, felt.part[pressing], strict=True)])
        if self.barren is not None and np.array_equal(points, self.barren):
            return False
        proven = np.zeros(self.space.shape, dtype=np.bool_)
        for point in points:
            proven |= proven_cells(self.plant.robot, self.space.axes, point, self.plant.itself)
        new = proven & (self.space.cell != Cell.OBSTACLE)
        if not new.any():
            self.barren = points
            return False
        self.lessons.append(Lesson(len(self.recorder), np.argwhere(new), self.space.frame.to_world(points)))
        none = np.zeros(self.space.ndim)
        self.recorder.add(self.time, self.configuration, believed, none, Mode.LEARNING, felt, push)
        self.space = learn(self.space, new)
        self.time += pause
        self.torque = none
        self.patience.renew(self.configuration)
        self.tried, self.exit = set(), None
        self._resolve()
        return True

    def _resolve(self) -> None:
        """Solve the changed map, unless what is left of it has no path from any place the robot has been, or beside."""
        if not self.space.goal_count:
            self.ending = (Ending.GOAL_BLOCKED, "every goal cell was learnt to be obstacle")
            return
        been = self.plant.within_stops(np.array([*self.trail, self.configuration]) + self.bias)
        cells = tuple(self.space.split(been)[0].T)
        self.lost = not np.any(self.space.goal_connected[cells] | (self.space.cell[cells] == Cell.GOAL))
        if self.lost and not any(ways_out(self.space, place) for place in been[::-1]):
            self.ending = (Ending.NO_PATH, self._why_no_path())
            return
        if self.grid is None:
            self.controller = self.controller.with_field(self.simulation.resolve(self.space))
            return
        self.grid.change(self.space)
        self.controller = self.controller.with_field(self.grid.field)

    def _result(self) -> Run:
        assert self.ending is not None
        believed = self.believed
        arrived = self.ending[0] is Ending.ARRIVED
        none = np.zeros(self.space.ndim)
        mode = Mode.ARRIVED if arrived else self.recorder.last_mode
        self.recorder.add(self.time, self.configuration, believed, none, mode, None, none)
        goal = int(self.space.goal_region[tuple(self.space.split(believed)[0])]) if arrived else None
        lessons, scene = tuple(self.lessons), self.simulation.scene
        return self.recorder.run(self.ending, goal, lessons, self.space, self.controller.field, self.plant, scene)


def _leads_on(velocity: Vector, chosen: Vector) -> bool:
    """Whether a velocity still has a part of what was chosen."""
    size = float(np.abs(chosen).max())
    return size > 0.0 and float((velocity / size) @ (chosen / size)) > _NO_WAY


def _contact_mode(mode: Mode, felt: Touch) -> Mode:
    if mode in {Mode.RETREATING, Mode.JAM, Mode.FOLLOWING, Mode.RECOVERING, Mode.HOMING}:
        return mode
    return Mode.STICKING if felt.sticking.any() else Mode.SLIDING
