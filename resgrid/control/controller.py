"""The velocity controller: one call per control period, from a measured configuration to a velocity."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.numbers import NotNegative, Positive, per_axis
from resgrid._internal.validation import checked
from resgrid._internal.values import frozen
from resgrid.control.equipotential import following_velocity
from resgrid.control.escape import RECOVERY, exits
from resgrid.control.external_forces import checked_force
from resgrid.core.cell import Cell
from resgrid.errors import InputError
from resgrid.planning.fields import Field
from resgrid.scene.control import admittance_matrix
from resgrid.scene.mask import Mask
from resgrid.scene.speed_zones import SpeedZones, speed_zones

if TYPE_CHECKING:
    from collections.abc import Callable

    from resgrid.core.frame import Frame

Response = Literal["admittance", "equipotential"]


class Nominal(NamedTuple):
    """The nominal motion at a configuration: the motion without a force on the robot.

    `place`: "free" (free cell with a path to a goal), "goal" (goal cell) or "off" (no path or no current); `velocity`
    (n,): the term ``V0`` of ``V = V0 + A F``, per second, in the coordinates in which the configuration was given
    (world or axis coordinates). It points along the current in a free cell and is 0 in a goal cell. For "off" it points
    to the nearest cell with a path, or is 0 if recovery was not asked for (`Controller.seen`). `longest`: maximum
    duration of a straight step at this velocity, in seconds, infinite except in a free cell.  The step ends just across
    the next cell face with outward current, or half way to a zero of a velocity component: it enters no cell that no
    current enters.
    """

    place: str
    velocity: NDArray[np.float64]
    longest: float


@checked
@frozen
@dataclass(frozen=True, eq=False)
class Controller:
    """Harmonic control of a robot that takes velocity commands (Connolly & Grupen 1992, section 3.4).

    `command` returns ``V = V0 + A F``.  The nominal velocity ``V0`` points along the current of the field, at a given
    speed; the admittance ``A`` responds to the generalised forces on the robot.

    Attributes
    ----------
    field : Field
        The field to follow.
    admittance : ndarray of float64, shape (n, n)
        ``A``, symmetric positive definite: velocity in world coordinates per second for a unit of generalised force.
    speed : float
        Length of ``V0``, in world coordinates per second.
    speed_limits : ndarray of float64, shape (n,)
        Largest speed of each joint or world coordinate, in its unit per second.  A faster command is scaled as a whole,
        so that its direction does not change.
    response : {"admittance", "equipotential"}
        Response to a force: ``V0 + A F``, or motion along the equipotential (equation 1 of the paper) while the force
        lasts.
    threshold : float
        Length of the generalised force, in the unit of the force, above which the response ``"equipotential"`` follows
        the equipotential; up to it the velocity is ``V0 + A F``.
    masks : tuple of Mask
        Masks whose speed limits apply at the measured configuration: percentages of `speed`, or absolute speeds in the
        plane of the first two world coordinates.
    axis_admittance : ndarray of float64, shape (n, n)
        The matrix `admittance` in axis coordinates.

    Examples
    --------
    >>> field = rg.plan(rg.read_scene("examples/scenes/lesson.toml"), k=0.9).field
    >>> controller = rg.control.make_controller(field, speed=0.5)
    >>> velocity = controller.command((0.5, 6.5), (0.0, 0.0))
    >>> float(np.linalg.norm(velocity).round(6))
    0.5
    """

    field: Field
    admittance: NDArray[np.float64]
    speed: Positive
    speed_limits: NDArray[np.float64]
    response: Response = "admittance"
    threshold: NotNegative = 1e-9
    masks: tuple[Mask, ...] = ()

    def __post_init__(self) -> None:
        ndim = self.field.space.ndim
        object.__setattr__(self, "speed", float(self.speed))
        object.__setattr__(self, "admittance", admittance_matrix(self.admittance, ndim))
        limits = per_axis("speed_limits", self.speed_limits, ndim, "above 0", above=0.0, most=np.inf)
        object.__setattr__(self, "speed_limits", limits)

    def command(self, configuration: ArrayLike, force: ArrayLike | None = None) -> NDArray[np.float64]:
        """Return the velocity command for the present moment; the only call that a robot's own control loop needs.

        Parameters
        ----------
        configuration : array_like of float, shape (n,)
            The configuration according to the robot's sensors, in world coordinates.
        force : array_like of float, shape (n,), optional
            Generalised force on the robot (joint torques; for a point or a disc the force in world coordinates),
            without the robot's weight; by default 0.

        Returns
        -------
        ndarray of float64, shape (n,)
            Velocity in world coordinates, per second.  The nominal part is 0 in a goal cell.

        Raises
        ------
        InputError
            If a value is not finite or has another shape, the configuration lies outside the grid or more than 2 cells
            from every cell with a path to a goal, or no current flows in its cell although that cell has a path.
        """
        velocity = self.axis_nominal(self._along_axes(configuration)).velocity
        if force is not None:
            along = self._frame.turned_from_world(checked_force(force, len(self.speed_limits), "the generalised force"))
            if self.response == "equipotential" and math.hypot(*along) > self.threshold:
                velocity = following_velocity(velocity, along)
            else:
                velocity = self.admitting(velocity, along)
        return self._frame.turned_to_world(self.limited(velocity, np.asarray(self._along_axes(configuration))))

    def admitting(self, nominal: NDArray[np.float64], force: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the velocity ``V0 + A F`` (n,) in axis coordinates, per second, with the admittance ``A``.

        `nominal` (n,): nominal velocity ``V0``, per second; `force` (n,): generalised force ``F``; both in axis
        coordinates.  If the sum overflows, the result is a finite velocity along ``A F``.
        """
        admittance = self.axis_admittance
        with np.errstate(over="ignore", invalid="ignore"):
            velocity = nominal + admittance @ force
        if np.isfinite(velocity).all():
            return np.asarray(velocity)
        push = (admittance / np.abs(admittance).max()) @ (force / np.abs(force).max())
        return np.asarray(push * (np.finfo(np.float64).max / len(push)))

    def nominal(self, configuration: ArrayLike) -> Nominal:
        """Return the nominal motion (the motion without a force) at a configuration (n,), both in world coordinates.

        In a cell without a path to a goal, the velocity leads to the nearest cell with a path. The velocity within a
        free cell follows Pollock's interpolation of the face currents and is continuous.  Raises InputError for a
        configuration that is not finite, outside the grid, or too far from every cell with a path to a goal.
        """
        own = self.axis_nominal(self._along_axes(configuration))
        return own._replace(velocity=self._frame.turned_to_world(own.velocity))

    def axis_nominal(self, configuration: ArrayLike) -> Nominal:
        """Return the nominal motion (the motion without a force) at a configuration (n,), both in axis coordinates.

        In a cell without a path to a goal, the velocity leads to the nearest cell with a path. Raises InputError if no
        such cell is within 2 cells.
        """
        seen = self.seen(configuration)
        return Nominal("off", self._recover(np.asarray(configuration)), np.inf) if seen.place == "off" else seen

    def seen(self, configuration: ArrayLike) -> Nominal:
        """Return the nominal motion (the motion without a force) at a configuration (n,), both in axis coordinates.

        The velocity is 0 in a cell without a path to a goal: the robot is not led out of it.  Raises InputError for a
        configuration outside the grid or with values that are not finite.
        """
        try:
            point = np.ascontiguousarray(configuration, dtype=np.float64)
        except (TypeError, ValueError):
            raise InputError(f"a configuration must be numbers, got {configuration!r}") from None
        velocity = np.empty(self.field.space.ndim)
        if point.shape != velocity.shape:
            raise InputError(f"a configuration of this space has {len(velocity)} coordinates, got shape {point.shape}")
        status, length = self._kernel(point, velocity)
        if status == 0:
            return Nominal("free", velocity * self.speed, length / self.speed)
        if status >= len(_PLACES):
            if not np.isfinite(point).all():
                raise InputError(
                    f"the configuration {point.tolist()} is not finite: stop the robot, check its encoders"
                )
            space = self.field.space
            cell, local = space.split(point)  # raises unless the point is outside by rounding only
            within = np.clip(local, space.rounding_errors, 1.0 - space.rounding_errors)
            return self.seen(space.lower + (cell + within) * space.spacing)
        return Nominal(_PLACES[status], velocity, np.inf)

    def limited(self, velocity: NDArray[np.float64], at: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
        """Return a velocity (n,) in axis coordinates, per second, scaled so that every speed limit holds.

        `at` (n,): configuration in axis coordinates, for the limits of masks; None omits these limits.
        """
        size = float(np.abs(velocity).max())
        if size == 0.0:
            return velocity
        direction = velocity / size
        excess = float((np.abs(self._frame.turned_to_world(direction)) / self.speed_limits).max())
        within = direction / excess if size * excess > 1.0 else velocity
        return within if at is None or self._zones is None else self._slowed(within, at)

    def _slowed(self, velocity: NDArray[np.float64], at: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return a velocity (n,), per second, scaled down so that the speed limits of masks hold.

        A relative limit applies to the norm of the whole velocity, an absolute limit to the norm of its first two
        components. `at` (n,): configuration; both vectors are in axis coordinates. Some mask must have a limit.
        """
        assert self._zones is not None
        limits = self._zones.at(self._frame.to_world(at)[np.newaxis])
        whole, plane = float(np.linalg.norm(velocity)), float(np.linalg.norm(velocity[:2]))
        allowed = min(
            float(limits.fraction[0]) * self.speed / whole if limits.fraction[0] < 1 and whole else np.inf,
            float(limits.speed[0]) / plane if plane else np.inf,
        )
        return velocity * allowed if allowed < 1.0 else velocity

    @cached_property
    def _zones(self) -> SpeedZones | None:
        """The speed limits of all masks, which depend on the place; None if no mask has a limit.

        A limit is a fraction of the nominal speed `speed`, or an absolute speed.
        """
        return speed_zones(self.masks)

    def with_field(self, field: Field) -> Controller:
        """Return a copy with another field on the same axes.

        Parameters
        ----------
        field : Field
            The field to follow.

        Returns
        -------
        Controller
            The copy.
        """
        return replace(self, field=field)

    @cached_property
    def axis_admittance(self) -> NDArray[np.float64]:
        """The matrix `admittance` (velocity per generalised force) in axis coordinates, shape (n, n)."""
        # Rotate rows and columns.
        return self._frame.turned_from_world(self._frame.turned_from_world(self.admittance).T).T

    @property
    def _frame(self) -> Frame:
        return self.field.space.frame

    def _along_axes(self, configuration: ArrayLike) -> ArrayLike:
        return configuration if self._frame.is_world else self.field.space.from_world(configuration)

    @cached_property
    def _kernel(self) -> Callable[[NDArray[np.float64], NDArray[np.float64]], tuple[int, float]]:
        """Compiled function ``(point, velocity)``, which writes the unit velocity at a point to `velocity`.

        It returns a status (0: free cell with a path; 1: goal cell; 2: no path or no current; larger: point outside the
        grid or not finite) and the length of the longest straight step, in axis units.
        """
        from resgrid.control.kernels import nominal

        space, flow = self.field.space, self.field.flow
        return partial(nominal, flow, self._served.ravel(), space.lower, space.periodic)

    @cached_property
    def _served(self) -> NDArray[np.bool_]:
        """Mask of goal cells and of free cells with a path to a goal, shape of the space."""
        space = self.field.space
        return np.asarray(space.goal_connected | (space.cell == Cell.GOAL))

    def _recover(self, point: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the velocity (n,) at nominal speed, in axis coordinates, towards the nearest cell with a path.

        `point` (n,): configuration in axis coordinates.  Raises InputError if no such cell is within `RECOVERY` (2)
        cells, or if the point's own cell has a path but no current.
        """
        space = self.field.space
        cell = tuple(space.split(point)[0].tolist())
        if self._served[cell]:
            raise InputError(
                f"no current flows in cell {cell}, although it has a path to a goal: nothing drives it; choose a blend "
                "with k below 1"
            )
        near = exits(space, point)
        if not near:
            kind = "an obstacle cell" if space.cell[cell] == Cell.OBSTACLE else "a cell without a path to a goal"
            raise InputError(
                f"the configuration {space.to_world(point).tolist()} lies in {kind}, {cell}, and no cell with a path "
                f"is within {RECOVERY:g} cells: stop the robot, and move it back along its path"
            )
        offset = near[0][1]
        return np.asarray(offset * (self.speed / np.linalg.norm(offset)))


_PLACES = ("free", "goal", "off")
"""Values of `Nominal.place`; the index is the status that the function `Controller._kernel` returns."""


def make_controller(
    field: Field,
    *,
    speed: Positive | None = None,
    admittance: ArrayLike | None = None,
    speed_limits: ArrayLike | None = None,
    response: Response = "admittance",
    masks: Sequence[Mask] = (),
) -> Controller:
    """Return a controller that follows a field, with defaults for speed, admittance and limits.

    Parameters
    ----------
    field : Field
        The field to follow.
    speed : float, optional
        Nominal speed, in world coordinates per second; by default a twentieth of the longest axis.
    admittance : array_like of float, shape (n, n), (n * n,), (n,) or (), optional
        Velocity per generalised force in world coordinates, as a matrix (flat: row by row), its diagonal, or one number
        for all axes; by default `speed`, so that a unit force changes the velocity by the nominal speed.
    speed_limits : array_like of float, shape (n,) or (), optional
        Largest speed of each joint or world coordinate, per second; one number for all; by default five times the
        nominal speed.
    response : {"admittance", "equipotential"}
        Whether a force adds the velocity admittance times force, or turns the robot along the equipotential.
    masks : sequence of Mask
        Masks whose speed limits apply, such as the masks of the scene; keep-out masks have no effect here.

    Returns
    -------
    Controller
        The controller.

    Raises
    ------
    InputError
        If a value is out of range, or the admittance is not symmetric positive definite.

    Examples
    --------
    >>> field = rg.plan(rg.read_scene("examples/scenes/lesson.toml"), k=0.9).field
    >>> controller = rg.control.make_controller(field, speed=0.5)
    >>> controller.command((0.5, 6.5), (0.0, 0.0)).round(3)
    array([ 0.196, -0.46 ])
    >>> controller.command((0.5, 6.5), (0.0, -0.2)).round(3)
    array([ 0.196, -0.56 ])
    """
    space = field.space
    pace = float((space.upper - space.lower).max()) / 20 if speed is None else speed
    fastest = min(5.0 * float(pace), float(np.finfo(np.float64).max))
    return Controller(
        field=field,
        admittance=admittance_matrix(pace if admittance is None else admittance, space.ndim),
        speed=pace,
        speed_limits=np.asarray(fastest if speed_limits is None else speed_limits),
        response=response,
        masks=tuple(masks),
    )
