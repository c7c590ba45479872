"""The loop of a simulation: sense, choose a mode, resolve contacts, step, learn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.control.contact import Surroundings, Touch, surroundings, touch
from resgrid.control.controller import Nominal
from resgrid.control.equipotential import following_velocity
from resgrid.control.learning import INSIDE, learn, proven_cells
from resgrid.control.log import Ending, Lesson, Mode, Run
from resgrid.control.pushes import Force, Push, force_of
from resgrid.control.recorder import Recorder
from resgrid.control.simulation import believed_offsets
from resgrid.errors import InputError
from resgrid.planning.trace import one_start
from resgrid.space import Cell

if TYPE_CHECKING:
    from resgrid.control.settling import LiveGrid
    from resgrid.control.simulation import Simulation

Vector = NDArray[np.float64]

_PATIENCE = 200
_DITHERS = 10
_LOOK = 4.0
_SAME = 1e-9


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
        self.push_at, self.max_steps = force_of(pushes, space.ndim), max_steps
        self.rng = np.random.default_rng(seed)
        self.configuration = _checked_start(simulation, start)
        self.believed = self.plant.within_stops(self.configuration + self.bias)
        self.space, self.lessons = space, list[Lesson]()
        self.spacing = space.spacing
        self.time, self.torque = 0.0, np.zeros(space.ndim)
        self.trail: list[Vector] = []
        self.barren: Vector | None = None
        self.anchor, self.waited, self.dithers = self.configuration, 0, 0
        self.reach = simulation.step * self.plant.cell_motion
        self.longest = simulation.step * float(space.spacing.min()) / self.controller.speed
        self.clear = 0.0
        self.recorder = Recorder(space.ndim)
        self.grid = _live_grid(simulation)
        self.grid_time = 0.0
        if self.grid is not None:
            self.controller = self.controller.with_field(self.grid.field)
        self.ending: tuple[Ending, str] | None = _static_ending(self)

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
        if seen.place == "goal":
            self.ending = (Ending.ARRIVED, "the robot is in a goal")
            return
        force = self.push_at(self.time, self.space.to_world(self.configuration))
        push = self.space.frame.turned_from_world(force)
        chosen = self._choose(believed, seen)
        if chosen is None:
            return
        mode, velocity, longest = chosen
        if push.any():
            velocity = velocity + self.controller.axis_admittance @ push
            mode, longest = Mode.PUSHED if mode is Mode.STREAMLINE else mode, self.longest
        velocity = self._stopped(self.controller.limited(velocity))
        around = self._look()
        # The way back has been taken before: nothing is in it, however near it leads past things.
        felt = None if mode is Mode.RETREATING and not push.any() else self._touch(around, velocity)
        if felt is not None and felt.pressing.any():
            if self.simulation.learn and self._learn(felt, believed, push):
                return
            mode, longest = _contact_mode(mode, felt), self.longest
        self._move(believed, mode, velocity, longest, around, felt, push)

    def _choose(self, believed: Vector, seen: Nominal) -> tuple[Mode, Vector, float] | None:
        """Mode, velocity without forces, and the longest time step for it."""
        if seen.place == "off":
            if self.grid is not None and self.space.goal_connected[tuple(self.space.split(believed)[0])]:
                return Mode.WAITING, np.zeros_like(believed), self.longest
            unsure = self.noise.any() or (self.bias.any() and not self.trail)
            return self._recover(believed) if unsure else self._retreat()
        if self.controller.response == "equipotential" and self.torque.any():
            following = following_velocity(seen.velocity, self.torque)
            return (Mode.FOLLOWING if following.any() else Mode.JAM), following, self.longest
        return Mode.STREAMLINE, seen.velocity, min(self.longest, seen.longest)

    def _recover(self, believed: Vector) -> tuple[Mode, Vector, float] | None:
        """Wrong belief may put the robot into a cell without a path, and no way back leads out of a mistake."""
        try:
            return Mode.RECOVERING, self.controller.axis_nominal(believed).velocity, self.longest
        except InputError as error:
            self.ending = (Ending.STALLED, str(error))
            return None

    def _retreat(self) -> tuple[Mode, Vector, float] | None:
        while self.trail:
            way = self.trail[-1] - self.configuration
            length = float(np.linalg.norm(way))
            if length > _SAME * float(self.spacing.min()):
                speed = self.controller.speed
                return Mode.RETREATING, way * (speed / length), length / speed
            self.trail.pop()
        self.ending = (Ending.NO_PATH, "no cell that the robot came through has a path to a goal any more")
        return None

    def _stopped(self, velocity: Vector) -> Vector:
        """No motion beyond the mechanical stops."""
        held = self.plant.within_stops(self.configuration + velocity * 1e-6 * self.longest)
        beyond = (held - self.configuration) * velocity < 0.5e-6 * self.longest * velocity**2
        return np.where(beyond, 0.0, velocity)

    def _look(self) -> Surroundings | None:
        """What is near enough to be met in this step; None while that is known to be nothing."""
        if self.clear > 2.0 * self.reach:
            return None
        pose = self.plant.pose(self.configuration)
        pairs = self.plant.near(pose, _LOOK * self.reach)
        self.clear = float(pairs[:, 6].min()) if len(pairs) else _LOOK * self.reach
        return surroundings(pose, pairs)

    def _touch(self, around: Surroundings | None, velocity: Vector) -> Touch | None:
        if around is None:
            return None
        margin = self.simulation.margin
        touching = around.gap <= 1.5 * margin
        if not touching.any():
            return None
        opening = np.where(around.gap < 0.5 * margin, (margin - around.gap) / (5.0 * self.longest), 0.0)
        return touch(around, touching, velocity, self.controller.axis_admittance, self.simulation.friction, opening)

    def _move(
        self, believed: Vector, mode: Mode, velocity: Vector, longest: float, around: Surroundings | None,
        felt: Touch | None, push: Vector,
    ) -> None:  # fmt: skip
        if felt is not None:
            velocity = self._stopped(felt.velocity)
        step = self._time_step(velocity, longest, around)
        after = self.plant.within_stops(self.configuration + step * velocity)
        for _ in range(40):
            if around is None or self._is_clear(after):
                break
            step /= 2
            after = self.plant.within_stops(self.configuration + step * velocity)
        else:
            after, velocity, step = self.configuration, np.zeros_like(velocity), self.longest
        self.torque = felt.normal_torque if felt is not None and felt.pressing.any() else np.zeros_like(velocity)
        self._record(believed, velocity, mode, felt, push)
        self._remember(mode, push, after)
        self.configuration = after
        self.time += step
        self.clear -= self.reach
        self._watch(after, mode, bool(push.any()))

    def _time_step(self, velocity: Vector, longest: float, around: Surroundings | None) -> float:
        fastest = float((np.abs(velocity) / self.spacing).max())
        step = min(longest, self.simulation.step / fastest) if fastest > 0 else longest
        if around is not None and len(around.gap):
            margin, closing = self.simulation.margin, -(around.normal_rows @ velocity)
            meets = (closing > 0.0) & (around.gap > 1.5 * margin)
            if meets.any():
                step = min(step, float(((around.gap[meets] - margin) / closing[meets]).min()))
        return step

    def _is_clear(self, configuration: Vector) -> bool:
        pairs = self.plant.near(self.plant.pose(configuration), self.simulation.margin, facing=False)
        return not len(pairs) or float(pairs[:, 6].min()) >= min(0.2 * self.simulation.margin, 0.999 * self.clear)

    def _remember(self, mode: Mode, push: Vector, after: Vector) -> None:
        """Keep the way back: every configuration that was left, so that each step of it has been taken before."""
        away = np.abs(after - self.trail[-1]) if self.trail else np.zeros_like(after)
        pushed_off = mode is Mode.RETREATING and push.any() and np.any(away > _SAME * self.spacing)
        if mode not in {Mode.RETREATING, Mode.RECOVERING} or pushed_off:
            self.trail.append(self.configuration)

    def _watch(self, after: Vector, mode: Mode, pushed: bool) -> None:
        """Notice that the robot has stayed within half a cell for long."""
        if pushed or np.any(np.abs(after - self.anchor) > 0.5 * self.spacing):
            self.anchor, self.waited, self.dithers = after, 0, 0
            return
        self.waited += 1
        if self.grid is not None and not self.grid.settled and mode in {Mode.WAITING, Mode.STREAMLINE}:
            self._lose_patience()
            return
        if self.waited < _PATIENCE:
            return
        if self.dithers < _DITHERS and self.simulation.learn:
            self.waited, self.dithers = 0, self.dithers + 1
            self._dither()
        elif mode is Mode.JAM:
            self.ending = (Ending.JAM, "the contact force lies along the streamline, which following cannot overcome")
        else:
            self.ending = (Ending.STALLED, f"the robot has stayed within half a cell for {_PATIENCE} steps")

    def _lose_patience(self) -> None:
        assert self.simulation.settling is not None
        patience = self.simulation.settling.patience
        if self.waited * self.simulation.step >= patience:
            self.ending = (
                Ending.STALLED, f"the unsettled grid leads nowhere from here, and {patience:g} cells' time of waiting "
                "has not changed that: let the grid settle faster, or move more slowly",
            )  # fmt: skip

    def _dither(self) -> None:
        shaken = self.configuration + self.rng.uniform(-0.1, 0.1, self.space.ndim) * self.space.spacing
        shaken = self.plant.within_stops(shaken)
        self.clear = 0.0
        if self.plant.axis_penetration(shaken)[0] == 0 and self._is_clear(shaken):
            self._record(self._sense(), np.zeros(self.space.ndim), Mode.DITHERING, None, np.zeros(self.space.ndim))
            self.trail.append(self.configuration)
            self.configuration = shaken

    def _learn(self, felt: Touch, believed: Vector, push: Vector) -> bool:
        """Mark what the contacts prove; whether that was anything new."""
        pressing = felt.pressing
        inner = felt.point + INSIDE * self.plant.cell_motion * felt.inward
        points = inner[pressing]
        if self.bias.any() or self.noise.any():
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
        self._record(believed, np.zeros(self.space.ndim), Mode.LEARNING, felt, push)
        self.space = learn(self.space, new)
        self.time += self.longest
        self.torque = np.zeros(self.space.ndim)
        self.anchor, self.waited, self.dithers = self.configuration, 0, 0
        self._resolve()
        return True

    def _resolve(self) -> None:
        """Solve the changed map, unless what is left of it has no path from any place the robot has been."""
        if not self.space.goal_count:
            self.ending = (Ending.GOAL_BLOCKED, "every goal cell was learnt to be obstacle")
            return
        been, _ = self.space.split(self.plant.within_stops(np.array([*self.trail, self.configuration]) + self.bias))
        connected = self.space.goal_connected | (self.space.cell == Cell.GOAL)
        if not connected[tuple(been.T)].any():
            self.ending = (
                Ending.NO_PATH, "the obstacle cells learnt, with those of the map, separate the start from every goal"
            )  # fmt: skip
            return
        if self.grid is None:
            self.controller = self.controller.with_field(self.simulation.resolve(self.space))
            return
        self.grid.change(self.space)
        self.controller = self.controller.with_field(self.grid.field)

    def _code(self, believed: Vector) -> int:
        return int(self.space.cell[tuple(self.space.split(believed)[0])])

    def _record(self, believed: Vector, velocity: Vector, mode: Mode, felt: Touch | None, push: Vector) -> None:
        self.recorder.add(self.time, self.configuration, believed, velocity, mode, felt, push)

    def _result(self) -> Run:
        assert self.ending is not None
        believed = self.believed
        arrived = self.ending[0] is Ending.ARRIVED
        none = np.zeros(self.space.ndim)
        self._record(believed, none, Mode.ARRIVED if arrived else self.recorder.last_mode, None, none)
        goal = int(self.space.goal_region[tuple(self.space.split(believed)[0])]) if arrived else None
        return self.recorder.run(self.ending, goal, tuple(self.lessons), self.space, self.controller.field, self.plant)


def _live_grid(simulation: Simulation) -> LiveGrid | None:
    """The grid at time 0, already on the rails of the map as it is now."""
    if simulation.settling is None:
        return None
    from resgrid.control.settling import LiveGrid, check_same_grid

    before = simulation.before if simulation.before is not None else simulation.space
    check_same_grid(before, simulation.space)
    grid = LiveGrid(simulation.settling, before)
    if before is not simulation.space:
        grid.change(simulation.space)
    return grid


def _contact_mode(mode: Mode, felt: Touch) -> Mode:
    if mode in {Mode.RETREATING, Mode.JAM, Mode.FOLLOWING, Mode.RECOVERING}:
        return mode
    return Mode.STICKING if felt.sticking.any() else Mode.SLIDING


def _checked_start(simulation: Simulation, start: ArrayLike) -> Vector:
    point = one_start(simulation.space, start, None)
    if simulation.plant.axis_penetration(point[np.newaxis])[0] > 0:
        inside = next(
            number
            for number in range(len(simulation.plant.obstacles))
            if simulation.plant.only(number).axis_penetration(point[np.newaxis])[0] > 0
        )
        raise InputError(
            f"the start {simulation.space.to_world(point).tolist()} puts the robot inside "
            f"{simulation.plant.name_of(inside)}: move the start"
        )
    return point


def _static_ending(loop: Loop) -> tuple[Ending, str] | None:
    """What the map alone decides, where belief is exact."""
    if loop.bias.any() or loop.noise.any():
        return None
    believed = loop.plant.within_stops(loop.configuration + loop.bias)
    code = loop._code(believed)
    cell = tuple(loop.space.split(believed)[0].tolist())
    if code == Cell.OBSTACLE:
        return Ending.START_BLOCKED, f"the start's cell {cell} is an obstacle in the map"
    if code == Cell.FREE and not loop.space.goal_connected[cell]:
        if not loop.space.goal_connected.any():
            return Ending.GOAL_BLOCKED, "in the map no free cell has a path to a goal"
        return Ending.NO_PATH, f"in the map the start's cell {cell} has no path to a goal"
    return None
