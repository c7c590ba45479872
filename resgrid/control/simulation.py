"""The type `Simulation`, a robot under harmonic control among its true obstacles, and its builder `simulation`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from annotated_types import Gt, Le
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.numbers import NotNegative, check_whole, per_axis
from resgrid._internal.validation import checked
from resgrid._internal.values import frozen
from resgrid.control.contact import SimulatedRobot
from resgrid.control.controller import Controller, make_controller
from resgrid.control.external_forces import ExternalForce, Force, control_pushes, force_of
from resgrid.control.plant import Plant, plant_of
from resgrid.control.relaxation import Relaxation, RelaxingGrid
from resgrid.control.run_log import End, Run, TerminationReason
from resgrid.control.simulation_loop import Loop
from resgrid.control.state_estimate import LiveMap, Sensor, solve_again
from resgrid.core.cell import Cell
from resgrid.core.lattice import require_square
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.planning.fields import Field
from resgrid.planning.pipeline import require_uniform, scene_wiring, solve_field
from resgrid.planning.trace import one_start
from resgrid.scene import build_space
from resgrid.scene.control import Control
from resgrid.scene.scene import Scene


@checked
@frozen
@dataclass(frozen=True, eq=False)
class Simulation:
    """A controller and the plant (robot and true obstacles) that it moves; `run` simulates one motion.

    Attributes
    ----------
    controller : Controller
        The controller, with the field of the initial map.
    plant : Plant
        The robot and all obstacles, hidden ones included.
    friction : float
        Coefficient mu of Coulomb friction of all contacts.
    learn : bool
        Whether contacts add obstacle cells to the map.  If False, the map never changes, and the robot only slides
        along or sticks to obstacles that the map lacks.
    step : float
        Largest motion along an axis in one step, as a fraction of a cell.  No point of the robot then moves farther
        than this fraction of its largest motion across a cell.
    relaxation : Relaxation or None
        Settling of the grid while the robot follows it; None for a grid that settles at once.
    before : Field or None
        With `relaxation`, the field to which the grid had settled at time 0; None for the field of the controller.
    scene : Scene or None
        The scene of the simulation; None if it was made from a controller and a plant.
    space : ConfigurationSpace
        The map of the robot at the start of a run.
    margin : float
        Gap between robot and obstacle at which a contact begins, in metres.

    Examples
    --------
    >>> simulation = rg.simulation(rg.read_scene("examples/scenes/lesson.toml"), k=0.9)
    >>> run = simulation.run()
    >>> run.ending
    <TerminationReason.ARRIVED: 'arrived'>
    """

    controller: Controller
    plant: Plant
    friction: NotNegative = 0.2
    learn: bool = True
    step: Annotated[float, Gt(0), Le(0.5)] = 0.2
    relaxation: Relaxation | None = None
    before: Field | None = None
    scene: Scene | None = None

    @property
    def space(self) -> ConfigurationSpace:
        """The map of the robot at the start of a run."""
        return self.controller.field.space

    @property
    def margin(self) -> float:
        """Gap between robot and obstacle at which a contact begins, in metres."""
        return MARGIN * self.plant.cell_motion

    def run(
        self,
        start: ArrayLike | None = None,
        *,
        pushes: Sequence[ExternalForce] | Force | None = None,
        bias: ArrayLike | None = None,
        noise: ArrayLike | None = None,
        seed: int | None = None,
        max_steps: int | None = None,
    ) -> Run:
        """Simulate the robot from a start until it arrives, finds that there is no path, or cannot continue.

        With learning, an exact sensor, and external forces that end, a run ends at a goal or with a proof that there is
        no path.  Let F be the set of cells that are not obstacles in the map.  (1) Each update of the map removes at
        least one cell from F, and no cell is ever added, so that there are at most ``|F|`` updates.  (2) After the last
        update the robot follows the current of a harmonic function, which enters no cell twice, so that it reaches a
        goal unless a contact stops it.  Such a contact lies in the closed cell that the robot is in or about to enter,
        both of which are in F.  Therefore the contact proves a new obstacle cell, which contradicts that the update was
        the last.  (Contact begins at a small gap, so that a point on a border between cells may prove no new cell at
        first; a robot that stands still makes a small random motion.)  (3) An update contains only cells in which the
        conservative rule finds a true obstacle (`Plant.proven_cells`), so that a start with a path in the conservative
        map of the true world never loses it.  After an update the robot moves back along its path, which is free, to
        the last cell that still has a path.  That cell exists unless the start's own cell has no path left.  In that
        case the robot tries the cells with a path within 2 cells, straight and one by one.  Only if none can be reached
        does the run end without a path: the start's own cell contains an obstacle, or the obstacle cells separate it
        from every goal.

        The robot is solid: it never enters an obstacle, for any force, step and cell size.  A robot that touches an
        obstacle at the start is moved away by 1e-8 m; a start that is inside by more than 1e-9 m is an error.  The
        robot moves to the configuration in the goal cell that solves the goal, if the space specifies one
        (`ConfigurationSpace.goal_points`); otherwise it stops in the cell, or at its centre with a bias or noise.  It
        stops where it believes that it has arrived; ``arrived`` or ``missed`` follows from the true configuration.

        Parameters
        ----------
        start : array_like of float, shape (n,), optional
            In world coordinates; by default the scene's first start.  The defaults of all other parameters are the
            values in ``scene.control``, or those of `resgrid.control.Control` without a scene.
        pushes : sequence of ExternalForce or callable, optional
            External generalised forces, as a list or a function of time and configuration; ``()`` for none.
        bias : array_like of float, shape () or (n,), optional
            Constant error of the measured configuration, in world coordinates; one number for all.
        noise : array_like of float, shape () or (n,), optional
            Largest magnitude of an additional random error of the measured configuration, in world coordinates; one
            number for all.  The error is uniformly distributed, and new in each step.
        seed : int, optional
            Seed of all random numbers; the same seed gives the same run.
        max_steps : int, optional
            Maximum number of steps.

        Returns
        -------
        Run
            Steps, contacts and map updates of the motion, and the reason for its end.

        Raises
        ------
        InputError
            If the start is not a configuration of the grid, the robot is inside an obstacle there, or a force, bias,
            noise, seed or number of steps is out of range.
        """
        control = Control() if self.scene is None else self.scene.control
        max_steps = control.steps if max_steps is None else max_steps
        seed = control.seed if seed is None else seed
        check_whole("max_steps", max_steps, 1)
        check_whole("seed", seed, 0)
        ndim, rng = self.space.ndim, np.random.default_rng(seed)
        if pushes is None:
            pushes = control_pushes(control, seed, self.space, self.controller.speed)
        bias = per_axis("bias", control.bias if bias is None else bias, ndim, "a finite number")
        noise = per_axis("noise", control.noise if noise is None else noise, ndim, "a finite number")
        sensor = Sensor(self.plant, bias, noise, rng)
        push_at = force_of(pushes, ndim)
        body = SimulatedRobot(self.plant, self._checked_start(start, exact=sensor.exact), self.step, self.margin)
        live = LiveMap(self.controller, self._grid())
        loop = Loop(self.plant, body, sensor, live, push_at, rng, friction=self.friction, learn=self.learn)
        end, goal = loop.run(max_steps), None
        if end.ending is TerminationReason.ARRIVED:
            end, goal = arrival(end, live.space, body.configuration, loop.believed)
        field = live.controller.field
        return loop.recorder.run(end, goal, tuple(loop.lessons), field, live.space, self.plant, self.scene)

    def _checked_start(self, start: ArrayLike | None, *, exact: bool) -> NDArray[np.float64]:
        """Return a start (n,) in axis coordinates; raise InputError if the robot is inside an obstacle there.

        `start` (n,): in world coordinates, None for the first start of the scene; `exact`: whether the sensor is exact;
        an obstacle cell of the map is then accepted, because the run ends there at once.
        """
        if start is None:
            if self.scene is None or not self.scene.starts:
                raise InputError("run() needs a start: give one, or a scene that has starts")
            start = self.scene.starts[0]
        point = one_start(self.space, start, None)
        if exact and self.space.cell[tuple(self.space.split(point)[0].tolist())] == Cell.OBSTACLE:
            return point  # the run ends at once: start_blocked
        if self.plant.axis_penetration(point[np.newaxis])[0] > 0:
            inside = next(
                number
                for number in range(len(self.plant.obstacles))
                if self.plant.only(number).axis_penetration(point[np.newaxis])[0] > 0
            )
            raise InputError(
                f"the start {self.space.to_world(point).tolist()} puts the robot inside "
                f"{self.plant.name_of(inside)}: move the start"
            )
        return point

    def _grid(self) -> RelaxingGrid | None:
        """Return the settling grid at time 0 with the present map; None if it settles at once or carries no current."""
        if self.relaxation is None or not self.controller.field.is_flowing:
            return None
        grid = RelaxingGrid(self.relaxation, self.before or self.controller.field)
        if self.before is not None:
            grid.change(self.space)
        return grid


MARGIN = 5e-3
"""Gap between robot and obstacle at which a contact begins, as a fraction of the robot's largest motion across a cell.

That motion is `Plant.cell_motion`, in metres.
"""


def simulation(
    scene: Scene,
    *,
    k: float | None = None,
    speed: float | None = None,
    admittance: ArrayLike | None = None,
    speed_limits: ArrayLike | None = None,
    response: str | None = None,
    friction: float | None = None,
    learn: bool | None = None,
    step: float | None = None,
    settle: str | None = None,
    pace: float | None = None,
    announce: bool | None = None,
    field: Field | None = None,
) -> Simulation:
    """Create a simulation of a scene, in which hidden obstacles exist but are not in the map.

    Parameters
    ----------
    scene : Scene
        A scene in the plane.  Its ``control`` (`resgrid.control.Control`) gives the value of every parameter that is
        None, except `field`.
    k : float, optional
        Weight of the Dirichlet field, in [0, 1].  Without effect if `field` is given.
    speed : float, optional
        Nominal speed, in world coordinates per second.
    admittance : array_like of float, shape (n, n), (n * n,), (n,) or (), optional
        Velocity per unit force, for n axes: a matrix (flat: row by row), its diagonal, or one number for all axes.
    speed_limits : array_like of float, shape (n,) or (), optional
        Largest speed of each world coordinate, per second.
    response : {"equipotential", "admittance"}, optional
        Whether a contact force turns the robot along the equipotential, or pushes it.
    friction : float, optional
        Coefficient of Coulomb friction of all contacts, at most 1e6.
    learn : bool, optional
        Whether cells in which a contact proves an obstacle become obstacles of the map.
    step : float, optional
        Largest motion along an axis in one step, as a fraction of a cell; at most 0.5.
    settle : {"chip", "jacobi", "sor"}, optional
        Mechanism by which the grid settles while the robot moves: RC transient of a chip, Jacobi sweeps, or successive
        over-relaxation.  If neither this parameter nor the scene gives a mechanism, the grid settles at once, or with
        `announce` as a "chip".
    pace : float, optional
        Number of sweeps, or of time units RC of a chip, while the robot at nominal speed crosses a cell.
    announce : bool, optional
        True: hidden obstacles enter the map at time 0, the grid begins to settle, and contacts do not change the map.
        False: the map lacks hidden obstacles until contacts prove them.
    field : Field, optional
        The field of the scene's map, if it has been solved already; by default the map is solved.

    Returns
    -------
    Simulation
        Controller and plant; its method `run` simulates a motion from a start.

    Raises
    ------
    InputError
        If a value is out of range, or the contacts of the robot cannot be simulated.

    Examples
    --------
    >>> scene = rg.read_scene("examples/scenes/lesson.toml").replace(hidden=(rg.Box((5.0, 2.2), (6.0, 3.0)),))
    >>> run = rg.simulation(scene, k=0.9).run()
    >>> str(run.ending), int(run.learnt.sum())
    ('arrived', 1)
    """
    given: dict[str, Any] = {
        "k": k, "speed": speed, "response": response, "friction": friction, "learn": learn, "step": step,
        "settle": settle, "pace": pace, "announce": announce,
    }  # fmt: skip
    control = replace(scene.control, **{key: value for key, value in given.items() if value is not None})
    plant = plant_of(scene)
    require_uniform(scene, "control")
    require_square(scene.lattice, "control")
    share = control.k if control.k is not None else next(iter(scene.k), None)
    controller = make_controller(
        solve_field(build_space(scene), scene_wiring(scene), share) if field is None else field,
        speed=control.speed,
        admittance=control.admittance if admittance is None else admittance,
        speed_limits=control.speed_limits if speed_limits is None else speed_limits,
        response=control.response,
        masks=scene.mask,
    )
    relaxation = Relaxation(control.settle or "chip", control.pace) if control.settle or control.announce else None
    world = Simulation(controller, plant, control.friction, control.learn, control.step, relaxation, scene=scene)
    return announce_hidden(world, relaxation) if control.announce and relaxation is not None else world


def announce_hidden(sim: Simulation, relaxation: Relaxation) -> Simulation:
    """Return a copy of a simulation whose hidden obstacles enter the map at time 0; then the grid begins to settle.

    Contacts do not change the map of the copy.  `relaxation`: mechanism and speed of settling.  Raise InputError if the
    hidden obstacles cover every goal cell.
    """
    truth = sim.plant.true_space(sim.space)
    if not truth.goal_count:
        raise InputError("the hidden obstacles cover every goal cell: move a goal, or an obstacle")
    field = sim.controller.field
    controller = sim.controller.with_field(solve_again(field, truth))
    return replace(sim, controller=controller, learn=False, relaxation=relaxation, before=field)


def arrival(
    end: End, space: ConfigurationSpace, configuration: NDArray[np.float64], believed: NDArray[np.float64]
) -> tuple[End, int | None]:
    """Return the end of a run whose sensor reports a goal, and the number of the goal region, or None.

    If the true configuration is in no goal cell, the reason of the end is `TerminationReason.MISSED` and the number is
    None; otherwise the result is the argument `end` and the number of the region of that cell.  `space`: map;
    `configuration`, `believed` (ndim,): true configuration, and configuration according to the sensor, in axis
    coordinates.
    """
    region = int(space.goal_region[tuple(space.split(configuration)[0])])
    if region >= 0:
        return end, region
    off = float(np.linalg.norm(believed - configuration))
    return End(
        TerminationReason.MISSED,
        f"the robot believes to be in a goal, but its true configuration is {off:.3g} away from where it believes",
    ), None
