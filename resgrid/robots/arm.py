"""A planar arm of one to four links: its geometry and its kinematics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, pi, tau
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.doors import checked
from resgrid.errors import InputError
from resgrid.robots.protocol import GoalCells, Progress, Sampling
from resgrid.robots.shapes import Point, Shape
from resgrid.space import MAX_DIMENSIONS, Axis

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

Angles = Literal["relative", "absolute"]
Limits = tuple[float, float]


@checked
@dataclass(frozen=True)
class Arm:
    """A planar arm with revolute joints; its configuration space has one axis per joint, in radians.

    Link ``i`` is a capsule: all points within half its width of the segment between joints ``i`` and ``i + 1``.  The
    end effector, or tip, is the end of the last segment.  Every link may touch nothing but the links beside it.

    Parameters
    ----------
    lengths : tuple of float
        Length of each of the one to four links, above 0.
    widths : tuple of float
        Their widths, at least 0; empty means 0 for all.
    limits : tuple of (float, float) or None
        Range of each joint in radians, lower below upper; None for a joint that turns all the way round (a periodic
        axis from -pi to pi).  Empty means None for all.
    base : tuple of (float, float)
        Where the first joint is.
    base_angle : float
        Direction from which angles count, in radians.
    angles : {"relative", "absolute"}
        Whether an angle counts from the link before, or all count from the base's direction.
    self_collision : bool
        Whether links that are not neighbours must keep apart.
    singularity_width : float or None
        Width, in radians, of the virtual obstacle along the singularities of the Jacobian, where all links are
        parallel and the tip cannot move along them (Connolly & Grupen 1992, section 4).  None: no such obstacle.  A
        width of 0 blocks the cells that the singularity runs through, just enough to part the bands.
    singularity_cells : int or None
        The same width, in cells; at most one of the two may be given.

    Raises
    ------
    InputError
        If a value is impossible; the message names it.
    """

    lengths: tuple[float, ...]
    widths: tuple[float, ...] = ()
    limits: tuple[Limits | None, ...] = ()
    base: Point = (0.0, 0.0)
    base_angle: float = 0.0
    angles: Angles = "relative"
    self_collision: bool = False
    singularity_width: float | None = None
    singularity_cells: int | None = None

    def __post_init__(self) -> None:
        count = len(self.lengths)
        if not 1 <= count <= MAX_DIMENSIONS:
            raise InputError(f"an arm has 1 to {MAX_DIMENSIONS} links, got {count}; give each link a length")
        object.__setattr__(self, "widths", tuple(self.widths) or (0.0,) * count)
        object.__setattr__(self, "limits", tuple(self.limits) or (None,) * count)
        for name, values in (("widths", self.widths), ("limits", self.limits)):
            if len(values) != count:
                raise InputError(f"an arm of {count} links needs {count} {name}, got {len(values)}")
        for number, (length, width, limits) in enumerate(zip(self.lengths, self.widths, self.limits, strict=True)):
            _check_link(number, length, width, limits)
        _check_rest(self)

    @property
    def ndim(self) -> int:
        """Number of joints."""
        return len(self.lengths)

    @property
    def reach(self) -> float:
        """Largest distance from the base to the tip."""
        return sum(self.lengths)

    @property
    def shortest_reach(self) -> float:
        """Smallest distance from the base to the tip, with full turns."""
        return max(0.0, 2 * max(self.lengths) - self.reach)

    def axes(self, cells: int | Sequence[int]) -> tuple[Axis, ...]:
        """Axes of the configuration space, as the joints' limits say.

        Parameters
        ----------
        cells : int or sequence of int
            Number of cells, for all joints or for each.

        Returns
        -------
        tuple of Axis
            ``theta_1``, ``theta_2``, ... in radians.

        Raises
        ------
        InputError
            If there are not as many numbers as joints.
        """
        counts = [cells] * self.ndim if isinstance(cells, int) else list(cells)
        if len(counts) != self.ndim:
            raise InputError(f"an arm of {self.ndim} joints needs {self.ndim} numbers of cells, got {len(counts)}")
        return tuple(
            Axis(f"theta_{number}", *(limits or (-pi, pi)), cells=int(count), periodic=limits is None, unit="rad")
            for number, (limits, count) in enumerate(zip(self.limits, counts, strict=True), 1)
        )

    def check_axes(self, axes: Sequence[Axis]) -> None:
        """Refuse axes that are not this arm's joints.

        Parameters
        ----------
        axes : sequence of Axis

        Raises
        ------
        InputError
            If their number differs, a periodic one is not a full turn, or one leaves its joint's limits.
        """
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
        """Direction of every link.

        Parameters
        ----------
        configurations : array_like of float, shape (..., n)
            Joint angles, in radians.

        Returns
        -------
        ndarray of float64, shape (..., n)
            Angles from the x axis, in radians.

        Raises
        ------
        InputError
            If there are not n angles.
        """
        turned = np.asarray(configurations, dtype=np.float64)
        if turned.shape[-1:] != (self.ndim,):
            raise InputError(f"this arm has {self.ndim} joints, but a configuration has shape {turned.shape}")
        return self.base_angle + (np.cumsum(turned, axis=-1) if self.angles == "relative" else turned)

    def joints(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Forward kinematics: where the joints are, and the tip.

        Parameters
        ----------
        configurations : array_like of float, shape (..., n)
            Joint angles, in radians.

        Returns
        -------
        ndarray of float64, shape (..., n + 1, 2)
            The base, the other joints, and the tip.

        Raises
        ------
        InputError
            If there are not n angles.
        """
        directions = self.directions(configurations)
        links = np.stack([np.cos(directions), np.sin(directions)], axis=-1) * np.asarray(self.lengths)[:, None]
        start = np.broadcast_to(np.asarray(self.base, dtype=np.float64), (*directions.shape[:-1], 1, 2))
        return np.concatenate([start, np.asarray(self.base) + np.cumsum(links, axis=-2)], axis=-2)

    def tip(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Forward kinematics of the tip alone; as `joints`, shape (..., 2)."""
        return self.joints(configurations)[..., -1, :]

    def jacobian(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Velocity of the tip for unit velocities of the joints.

        Parameters
        ----------
        configurations : array_like of float, shape (..., n)
            Joint angles, in radians.

        Returns
        -------
        ndarray of float64, shape (..., 2, n)

        Raises
        ------
        InputError
            If there are not n angles.
        """
        places = self.joints(configurations)
        lever = places[..., -1:, :] - places[..., :-1, :] if self.angles == "relative" else np.diff(places, axis=-2)
        return np.stack([-lever[..., 1], lever[..., 0]], axis=-2)

    def inverse(self, point: ArrayLike) -> NDArray[np.float64]:
        """Inverse kinematics of an arm with two links.

        Parameters
        ----------
        point : array_like of float, shape (2,)
            Where the tip shall be.

        Returns
        -------
        ndarray of float64, shape (s, 2)
            All configurations that bring it there within the limits: with none, or less than a turn of them, no
            configuration, one (stretched or folded) or two, the elbow turning left (from the first link to the
            second) first; where limits are wider than a turn each comes once for every turn that fits.  A joint
            without limits is told from -pi to pi.  Where every direction would do (equal links folded back onto the
            base) the one along ``base_angle`` stands for all.

        Raises
        ------
        InputError
            If the arm has not two links, the point is not finite, or the limits leave more than a million solutions.
        """
        from resgrid.robots.arm_inverse import inverse_of_two_links

        return inverse_of_two_links(self, point)

    def link_shapes(self, configuration: ArrayLike) -> list[BaseGeometry]:
        """The links as shapely geometry: polygons, or segments where the width is 0.

        Parameters
        ----------
        configuration : array_like of float, shape (n,)
            Joint angles, in radians.

        Returns
        -------
        list of shapely geometry
            One per link; the round ends are polygons of 32 edges a half-circle, inside the circle.

        Raises
        ------
        InputError
            If there are not n angles.
        """
        import shapely

        places = self.joints(np.asarray(configuration, dtype=np.float64).reshape(-1))
        segments = [shapely.LineString(places[i : i + 2]) for i in range(self.ndim)]
        return [
            segment.buffer(width / 2, quad_segs=16) if width else segment
            for segment, width in zip(segments, self.widths, strict=True)
        ]

    def shapes_at(self, configuration: ArrayLike) -> list[BaseGeometry]:
        """The same as `link_shapes`, for those who know any robot."""
        return self.link_shapes(configuration)

    def occupancy(
        self, axes: Sequence[Axis], obstacles: Sequence[Shape], rule: Sampling, progress: Progress | None = None
    ) -> NDArray[np.bool_]:
        """Cells in which a link may touch an obstacle; see `resgrid.robots.arm_cells.arm_occupancy`."""
        from resgrid.robots.arm_cells import arm_occupancy

        return arm_occupancy(self, tuple(axes), obstacles, rule, progress)

    def goal_cells(self, axes: Sequence[Axis], region: Shape | Point) -> GoalCells:
        """Cells that hold a configuration with the tip in a region; see `resgrid.robots.arm_cells.arm_goal_cells`."""
        from resgrid.robots.arm_cells import arm_goal_cells

        return arm_goal_cells(self, tuple(axes), region)


def _check_link(number: int, length: float, width: float, limits: Limits | None) -> None:
    if not (isfinite(length) and 0 < length <= 1e9):
        raise InputError(f"links[{number}]: length = {length} must be above 0 and finite")
    if not (isfinite(width) and 0 <= width <= 1e9):
        raise InputError(f"links[{number}]: width = {width} must be at least 0 and finite")
    if limits is None:
        return
    if len(limits) != 2 or not all(map(isfinite, limits)) or max(map(abs, limits)) > 1e6:
        raise InputError(f"links[{number}]: limits = {list(limits)} must be two angles [lower, upper] in radians")
    if not limits[0] < limits[1]:
        raise InputError(f"links[{number}]: limits = {list(limits)} are reversed: the lower limit comes first")


def _check_rest(arm: Arm) -> None:
    if len(arm.base) != 2 or not all(isfinite(value) and abs(value) <= 1e9 for value in (*arm.base, arm.base_angle)):
        raise InputError(f"an arm's base needs two finite coordinates and a finite angle, got {list(arm.base)}")
    if arm.angles not in ("relative", "absolute"):
        raise InputError(f"angles = {arm.angles!r} is unknown: it may be 'relative' or 'absolute'")
    if arm.singularity_width is not None and arm.singularity_cells is not None:
        raise InputError("give either singularity_width (radians) or singularity_cells, not both")
    if arm.singularity_width is not None and not 0 <= arm.singularity_width < pi:
        raise InputError(f"singularity_width = {arm.singularity_width} must be from 0 up to pi (radians)")
    if arm.singularity_cells is not None and arm.singularity_cells < 1:
        raise InputError(f"singularity_cells = {arm.singularity_cells} must be at least 1")
    if arm.ndim == 1 and (arm.singularity_width is not None or arm.singularity_cells is not None):
        raise InputError("an arm of one link is singular everywhere; leave out singularity_width and singularity_cells")
