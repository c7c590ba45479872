"""`Arm`, the robot that is a planar arm of one to four links: kinematics, geometry, and cells of its joint space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from math import acos, atan2, ceil, cos, floor, hypot, pi, sin, tau
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.validation import checked
from resgrid.core.axis import Axis, Coordinate, Point
from resgrid.core.cell import MAX_DIMENSIONS
from resgrid.errors import InputError
from resgrid.robots.arm_cells import arm_goal_cells, arm_occupancy
from resgrid.robots.base import Robot
from resgrid.robots.cells import GoalCells, Progress, Sampling
from resgrid.robots.geometry import ArmLinks, Pose, RigidPart
from resgrid.robots.shapes import Shape

_ROUNDING = 1e-12
"""Tolerance for rounding in the inverse kinematics: of sines and cosines, of distances / reach, of angles in rad."""

_MOST_SOLUTIONS = 1_000_000
"""Maximum number of configurations per bend of the elbow that differ by full turns of joints; more raise InputError."""

Angles = Literal["relative", "absolute"]
Length = Annotated[float, Gt(0), Le(1e9)]
Width = Annotated[float, Ge(0), Le(1e9)]
Limits = tuple[float, float]


@checked
@dataclass(frozen=True)
class Arm(Robot):
    """A planar arm with revolute joints; its configuration space has one axis per joint, in radians.

    Link ``i`` is a capsule: all points within half its width of the segment between joints ``i`` and ``i + 1``.  The
    tip (tool point) is the end of the last segment.  Links must not touch obstacles; adjacent links may touch each
    other.

    Parameters
    ----------
    lengths : tuple of float
        Length of each of the one to four links, in metres, above 0.
    widths : tuple of float
        Width of each link, in metres, at least 0; empty means 0 for all.
    limits : tuple of (float, float) or None
        Range of each joint in radians, lower below upper; None for a joint without limits (a periodic axis from -pi to
        pi).  Empty means None for all.
    base : tuple of (float, float)
        Position (x, y) of the first joint, in metres.
    base_angle : float
        Direction of joint angle 0, in radians from the x axis.
    angles : {"relative", "absolute"}
        Joint angles are relative to the previous link (the first one to ``base_angle``), or all to ``base_angle``.
    self_collision : bool
        True: a contact between links that are not adjacent is a collision.  False: links may cross.
    singularity_width : float or None
        Width, in radians of the bend between links, of the virtual obstacle (cells blocked without a collision) along
        the singularities of the Jacobian, where all links are parallel (Connolly & Grupen 1992, section 4).  A width
        of 0 blocks only the cells that contain singular configurations, which still separates the regions on both
        sides.  None: no virtual obstacle, unless ``singularity_cells`` is set.
    singularity_cells : int or None
        The same width as a number of cells, or None.  At most one of the two widths may be set.

    Raises
    ------
    InputError
        If a value is out of range; the message names it.

    Examples
    --------
    >>> arm = rg.Arm(lengths=(1.0, 0.8))
    >>> arm.tip((0.0, np.pi / 2)).round(3)
    array([1. , 0.8])
    >>> arm.inverse((1.0, 0.8)).round(3)
    array([[ 0.   ,  1.571],
           [ 1.349, -1.571]])
    >>> arm.jacobian((0.0, np.pi / 2)).round(3)
    array([[-0.8, -0.8],
           [ 1. ,  0. ]])
    >>> [axis.name for axis in arm.axes(64)]
    ['theta_1', 'theta_2']
    """

    reference = "tip"

    lengths: tuple[Length, ...]
    widths: tuple[Width, ...] = ()
    limits: tuple[Limits | None, ...] = ()
    base: Point = (0.0, 0.0)
    base_angle: Coordinate = 0.0
    angles: Angles = "relative"
    self_collision: bool = False
    singularity_width: Annotated[float, Ge(0), Lt(pi)] | None = None
    singularity_cells: Annotated[int, Ge(1)] | None = None

    def __post_init__(self) -> None:
        count = len(self.lengths)
        if not 1 <= count <= MAX_DIMENSIONS:
            raise InputError(f"an arm has 1 to {MAX_DIMENSIONS} links, got {count}; give each link a length")
        object.__setattr__(self, "widths", tuple(self.widths) or (0.0,) * count)
        object.__setattr__(self, "limits", tuple(self.limits) or (None,) * count)
        for name, values in (("widths", self.widths), ("limits", self.limits)):
            if len(values) != count:
                raise InputError(f"an arm of {count} links needs {count} {name}, got {len(values)}")
        for number, limits in enumerate(self.limits):
            _check_link(number, limits)
        _check_rest(self)

    @property
    def ndim(self) -> int:
        """Number of joints, equal to the number of links."""
        return len(self.lengths)

    @property
    def reach(self) -> float:
        """Largest distance from the base to the tip, in metres: the sum of the lengths."""
        return sum(self.lengths)

    @property
    def remedy(self) -> str:
        """Advice that error messages append if obstacles leave no free cell; empty if all links have width 0."""
        return "make the arm's links thinner" if any(self.widths) else ""

    def axes(self, cells: int | Sequence[int]) -> tuple[Axis, ...]:
        """Return the axes of the configuration space, ``theta_1``, ``theta_2``, ..., with the ranges of the joints.

        `cells`: number of cells of each axis, a single one for all joints or one per joint.
        """
        counts = [cells] * self.ndim if isinstance(cells, int) else list(cells)
        if len(counts) != self.ndim:
            raise InputError(f"an arm of {self.ndim} joints needs {self.ndim} numbers of cells, got {len(counts)}")
        return tuple(
            Axis(f"theta_{number}", *(limits or (-pi, pi)), cells=int(count), periodic=limits is None, unit="rad")
            for number, (limits, count) in enumerate(zip(self.limits, counts, strict=True), 1)
        )

    def implied_axes(self) -> tuple[dict[str, Any], ...]:
        """Return defaults of a scene's axis keys name, lower, upper, periodic and unit, as one dict per joint."""
        axes = self.axes(1)
        return tuple({key: value for key, value in vars(axis).items() if key != "cells"} for axis in axes)

    def axes_on_map(self, axes: Sequence[Axis], headings: int) -> tuple[Axis, ...]:  # noqa: ARG002
        """Raise InputError in every case, because the axes of a map (x and y) are not the axes of the joints."""
        raise InputError("an arm on a map needs a [grid] for its joints")

    def check_axes(self, axes: Sequence[Axis]) -> None:
        """Raise InputError unless every joint has an axis, within the joint's limits, of length 2 pi if periodic."""
        if len(axes) != self.ndim:
            raise InputError(f"an arm of {self.ndim} joints needs {self.ndim} axes, got {len(axes)}")
        for axis, limits in zip(axes, self.limits, strict=True):
            extent = axis.upper - axis.lower
            if axis.periodic and abs(extent - tau) > 1e-9:
                raise InputError(
                    f"axis {axis.name!r}: a periodic joint turns by 2 pi, from {axis.lower:g} to "
                    f"{axis.lower + tau:.15g}, but upper = {axis.upper:g}; leave lower and upper out, or set "
                    "periodic = false"
                )
            if limits and (axis.periodic or axis.lower < limits[0] - 1e-9 or axis.upper > limits[1] + 1e-9):
                raise InputError(
                    f"axis {axis.name!r}: the joint's limits are {list(limits)}, but the axis runs "
                    f"{'round' if axis.periodic else f'from {axis.lower:g} to {axis.upper:g}'}; change one of them"
                )

    def directions(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Return angles (..., n) of the n links from the x axis for joint angles (..., n), both in radians."""
        turned = np.asarray(configurations, dtype=np.float64)
        if turned.shape[-1:] != (self.ndim,):
            raise InputError(f"this arm has {self.ndim} joints, but a configuration has shape {turned.shape}")
        return self.base_angle + (np.cumsum(turned, axis=-1) if self.angles == "relative" else turned)

    def joints(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Return positions (..., n + 1, 2), in metres, of the base, the other joints and the tip (forward kinematics).

        `configurations` (..., n): joint angles in radians.
        """
        directions = self.directions(configurations)
        links = np.stack([np.cos(directions), np.sin(directions)], axis=-1) * np.asarray(self.lengths)[:, None]
        start = np.broadcast_to(np.asarray(self.base, dtype=np.float64), (*directions.shape[:-1], 1, 2))
        return np.concatenate([start, np.asarray(self.base) + np.cumsum(links, axis=-2)], axis=-2)

    def tip(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Return positions of the tip (..., 2), in metres, for joint angles `configurations` (..., n), in radians."""
        return self.joints(configurations)[..., -1, :]

    def jacobian(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Return Jacobians (..., 2, n) of the tip (rows x, y; columns joints), in m/rad, for joint angles (..., n)."""
        places = self.joints(configurations)
        lever = places[..., -1:, :] - places[..., :-1, :] if self.angles == "relative" else np.diff(places, axis=-2)
        return np.stack([-lever[..., 1], lever[..., 0]], axis=-2)

    def inverse(self, point: ArrayLike) -> NDArray[np.float64]:
        """Compute all configurations of a two-link arm that bring the tip to a point (inverse kinematics).

        Parameters
        ----------
        point : array_like of float, shape (2,)
            Position of the tip, in metres.

        Returns
        -------
        ndarray of float64, shape (s, 2)
            Joint angles in radians within the limits, or in [-pi, pi) without limits: two solutions, elbow bent to the
            left first, one if the arm is stretched or folded, none out of reach.  Limits wider than a full turn
            repeat a solution for every turn.  If equal links fold onto the base, link 1 points along ``base_angle``.

        Raises
        ------
        InputError
            If the arm does not have two links, the point is not finite, or the limits admit too many solutions.
        """
        if self.ndim != 2:
            raise InputError(f"inverse kinematics exists only for arms of two links; this arm has {self.ndim}")
        target = np.asarray(point, dtype=np.float64)
        if target.shape != (2,) or not np.isfinite(target).all():
            raise InputError(f"a point of the workspace has two finite coordinates, got {target.tolist()}")
        x, y = (target - self.base).tolist()
        first, second = self.lengths
        # The cosine rule (Craig, Introduction to Robotics, section 4.4).
        cosine = (x * x + y * y - first**2 - second**2) / (2 * first * second)
        if abs(cosine) > 1 + _ROUNDING:
            return np.empty((0, 2))
        bend = acos(max(-1.0, min(1.0, cosine)))
        solutions: list[tuple[float, ...]] = []
        for elbow in (bend, -bend) if sin(bend) > _ROUNDING else (bend,):
            direction = atan2(y, x) if hypot(x, y) > _ROUNDING * self.reach else self.base_angle
            shoulder = direction - atan2(second * sin(elbow), first + second * cos(elbow)) - self.base_angle
            angles = (shoulder, elbow if self.angles == "relative" else shoulder + elbow)
            turned = [_within(angle, limits) for angle, limits in zip(angles, self.limits, strict=True)]
            if len(turned[0]) * len(turned[1]) > _MOST_SOLUTIONS:
                raise InputError(
                    f"the joint limits span too many turns, with more than {_MOST_SOLUTIONS:,} solutions: narrow them"
                )
            solutions += product(*turned)
        return np.array(solutions, dtype=np.float64).reshape(-1, 2)

    def parts(self, configurations: NDArray[np.float64]) -> list[RigidPart]:
        """Return a rigid part per link for m configurations (m, n): m segments, and half the link's width as radius."""
        import shapely

        places = self.joints(configurations)
        return [
            RigidPart(np.asarray(shapely.linestrings(places[:, link : link + 2])), width / 2)
            for link, width in enumerate(self.widths)
        ]

    def travel(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return upper bounds (m,), in metres, of the distance that any point of the arm moves in m straight motions.

        `start, end` (m, n): joint angles, in radians, at the ends of m straight lines in configuration space.
        For a point of link j the bound is the sum over links ``i <= j`` of length times change of direction, plus half
        the width of link j times the change of direction of link j.
        """
        turned = np.abs(self.directions(end) - self.directions(start))
        ends = np.cumsum(turned * np.asarray(self.lengths), axis=1)
        return np.asarray((ends + turned * np.asarray(self.widths) / 2).max(axis=1))

    def pose(self, configuration: NDArray[np.float64]) -> Pose:
        """Return positions and velocities per joint rate of the n links for joint angles `configuration` (n,), in rad.

        Joint i rotates link i, and it rotates (relative angles) or translates (absolute angles) all later links.
        """
        joints, directions = self.joints(configuration), self.directions(configuration)
        radius, part, spin, before, lever = _pose_constants(self)
        count = len(part)
        shift, pivot = np.zeros((count, count, 2)), np.empty((count, count, 2))
        pivot[:] = joints[:-1]
        if self.angles == "absolute":
            along = joints[1:] - joints[:-1]
            shift[:, :, 0] = -before * along[:, 1]
            shift[:, :, 1] = before * along[:, 0]
        segments = np.concatenate([joints[:-1], joints[1:]], axis=1)
        frame = np.concatenate([joints[:-1], directions[:, np.newaxis]], axis=1)
        return Pose(segments, radius, part, frame, shift, spin, pivot, lever)

    def reference_point(self, configurations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return positions of the tip, shape (m, 2), in metres, for joint angles (m, n), in radians."""
        return self.tip(configurations)

    def bare(self, *, self_collision: bool = True) -> Arm:
        """Return the arm without virtual obstacles; `self_collision`: False also ignores contacts between links."""
        collides = self.self_collision and self_collision
        return replace(self, singularity_width=None, singularity_cells=None, self_collision=collides)

    def occupancy(
        self, axes: Sequence[Axis], obstacles: Sequence[Shape], rule: Sampling, progress: Progress | None = None
    ) -> NDArray[np.bool_]:
        """Return the mask, shape of the grid, of cells with possible collisions or in the virtual obstacle.

        With the rule ``"conservative"``, no free cell contains a collision.  With ``"centre"`` only the configuration
        at the centre is tested.  `obstacles`: in metres; `progress`: called as ``progress(done, total)``.
        """
        self.check_axes(axes)
        occupied = arm_occupancy(
            self._links, tuple(axes), obstacles, rule, progress, self_collision=self.self_collision
        )
        return occupied | self.singular_cells(axes)

    def singular_cells(self, axes: Sequence[Axis]) -> NDArray[np.bool_]:
        """Return the mask of cells that are blocked along singularities of the Jacobian (the virtual obstacle).

        The Jacobian of a planar arm loses rank where all links are parallel.  For two links, ``sin(theta_2) = 0``
        (relative angles) or ``sin(theta_2 - theta_1) = 0`` (absolute angles: diagonals of the configuration space).
        With three or more links, the singular set has codimension 2 or more and does not separate regions. The mask has
        the shape of the grid or one that broadcasts to it; all is False if both widths of the obstacle are None.
        """
        cells, singular = self.singularity_cells, np.ones((1,) * self.ndim, dtype=bool)
        if self.singularity_width is None and cells is None:
            return ~singular
        relative = self.angles == "relative"
        grids = np.meshgrid(*(axis.centres for axis in axes), indexing="ij", sparse=True)
        for joint in range(1, self.ndim):
            turning = [axes[joint]] if relative else [axes[joint - 1], axes[joint]]
            bend = grids[joint] if relative else grids[joint] - grids[joint - 1]
            away = np.abs((bend + pi / 2) % pi - pi / 2)
            step = max(axis.spacing for axis in turning)
            extent = sum(axis.spacing for axis in turning) / 2
            width = (self.singularity_width or 0.0) if cells is None else (cells - 1) * step
            # Block cells that meet the strip's interior.  If the singular line runs along a border between cells, block
            # the cells on both sides.  A width counted in cells that cannot be centred on the line gets one more row.
            counted = cells is not None and relative
            reach = width / 2 + extent + (1e-9 if counted else -1e-9) * step
            singular = singular & (away <= max(step / 2 + 1e-9 * step, reach))
        return singular

    def goal_cells(self, axes: Sequence[Axis], region: Shape | Point) -> GoalCells:
        """Return the cells that contain a configuration with the tip in a region, with one configuration per cell.

        `region`: shape or point in the plane, in metres.  Raise InputError if the joint limits or the axes keep the tip
        out of the region.
        """
        self.check_axes(axes)
        goal = arm_goal_cells(self._links, tuple(axes), region)
        if not goal.cells.any():
            ends = "joint limits" if any(self.limits) else "axes of the grid"
            raise InputError(f"the {ends} keep the arm's tip out of this goal; widen them, or move the goal")
        return goal

    @property
    def _links(self) -> ArmLinks:
        """Lengths, half widths and base of the arm as arrays, the input of compiled kernels."""
        return ArmLinks(
            np.array(self.lengths, dtype=np.float64),
            np.array(self.widths, dtype=np.float64) / 2,
            np.array([*self.base, self.base_angle], dtype=np.float64),
            self.angles == "relative",
        )


@cache
def _pose_constants(arm: Arm) -> tuple[NDArray[Any], ...]:
    """Return five read-only arrays that all poses of an arm share.

    Half widths (n,) in metres; link numbers (n,); `spin` (n, n): 1 if the joint (column) rotates the link (row), else
    0; (n, n): 1 for every link (row) and link before it (column), else 0; the field `lever` (n, 2, n) of `Pose`.
    """
    count = arm.ndim
    spin = np.tri(count) if arm.angles == "relative" else np.eye(count)
    lever = np.stack([np.tri(count, k=-1), np.tri(count)], axis=1) * np.asarray(arm.lengths, dtype=np.float64)
    constants = np.asarray(arm.widths, dtype=np.float64) / 2, np.arange(count), spin, np.tri(count, k=-1), lever
    for array in constants:
        array.flags.writeable = False
    return constants


def _within(angle: float, limits: Limits | None) -> list[float]:
    """Return the angles in `limits` equal to `angle` up to full turns, in radians; for None, the one in [-pi, pi)."""
    if limits is None:
        return [(angle + pi) % tau - pi]
    lower, upper = limits
    turns = range(ceil((lower - _ROUNDING - angle) / tau), floor((upper + _ROUNDING - angle) / tau) + 1)
    return [min(max(angle + turn * tau, lower), upper) for turn in turns]


def _check_link(number: int, limits: Limits | None) -> None:
    """Raise InputError unless the limits of joint `number`, in radians, are ascending and at most 1e6 in magnitude."""
    ends = [*(limits or (-pi, pi))]
    if max(map(abs, ends)) > 1e6:
        raise InputError(f"links[{number}]: limits = {ends} must be two angles [lower, upper] in radians")
    if not ends[0] < ends[1]:
        fault = "are reversed: the lower limit comes first" if ends[0] > ends[1] else "leave the joint no room to turn"
        raise InputError(f"links[{number}]: limits = {ends} {fault}; without limits the joint turns all the way round")


def _check_rest(arm: Arm) -> None:
    """Raise InputError unless an arm's ``base``, ``singularity_width`` and ``singularity_cells`` are valid."""
    width, cells = arm.singularity_width, arm.singularity_cells
    if len(arm.base) != 2:
        raise InputError(f"an arm's base needs two coordinates, got {list(arm.base)}")
    if None not in (width, cells):
        raise InputError("give either singularity_width (radians) or singularity_cells, not both")
    if arm.ndim == 1 and (width is not None or cells is not None):
        raise InputError("an arm of one link is singular everywhere; leave out singularity_width and singularity_cells")
