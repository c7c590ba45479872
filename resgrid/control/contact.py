"""Rigid contact with friction for a velocity-controlled robot: contact velocities, collision-free steps.

The robot obeys ``qdot = v + A sum_k J_k^T f_k`` with the commanded velocity ``v``, the admittance ``A``, and the
Jacobian ``J_k`` and force ``f_k`` of each contact.  Contact is a complementarity problem at the level of velocities (D.
E. Stewart and J. C. Trinkle, Int. J. Numer. Methods Eng. 39 (1996) 2673; M. Anitescu and F. A. Potra, Nonlinear
Dynamics 14 (1997) 231): it needs no stiffness and is stable at any step.  The ends of axes are contacts of the same
problem. Velocities keep gaps to first order; `SimulatedRobot.move` shortens the step so that no gap closes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.control.contact_forces import contact_forces
from resgrid.control.plant import PAIR, Plant
from resgrid.robots import Pose
from resgrid.robots.geometry import TOUCH

Vector = NDArray[np.float64]

_LOOK = 4.0
"""Largest gap between robot and obstacle for which a search returns a pair of near points.

It is given as a multiple of the largest motion of any point of the robot in one step.
"""
_AT_STOP = 1e-6
"""Largest distance from a mechanical stop at which the robot counts as at the stop, as a fraction of the cell width."""
_LEAST = 1e-3
"""Smallest collision-free fraction of a step for which the step is taken; with a smaller fraction the robot is blocked.

The robot then stays where it is.
"""
_POSES = 50
"""Maximum number of collision tests along one step, each from a later pose of the robot on the step."""
_LIFTS = 3
"""Maximum number of moves that separate a robot at the start from obstacles that it touches."""
_LIFT = 10 * TOUCH
"""Gap at which a robot that touches obstacles at the start is placed, as a fraction of a length.

The length is 1 m plus the largest radius of the robot and of disc obstacles.
"""

KEEP = 0.2
"""Smallest gap between robot and obstacle after a step, as a fraction of the gap at which a contact begins.

If the gap is already smaller before the step, the step may not reduce it.
"""


@dataclass(frozen=True, eq=False)
class ContactSet:
    """Contacts of the robot at one moment, with their forces.

    `pairs` (m,): pairs of points in contact, as records of points, normal and gap (`resgrid.control.plant.PAIR`);
    `force` (m, 2): force on the robot at each contact, in axis coordinates of the workspace, in the unit in which
    admittance times force is a velocity; its generalised force is ``J^T force`` with the Jacobian ``J`` of the point;
    `sticking` (m,): whether the force lies inside the friction cone, and the point does not move; `torque` (ndim,):
    generalised force of all contacts, mechanical stops included; `normal_torque` (ndim,): generalised force of the
    obstacles' normal forces only, which points away from the obstacles in configuration space (the whole force of a
    sticking contact merely balances the drive along the streamline); `velocity` (ndim,): velocity of the robot with
    contacts, in axis coordinates, per second; `solved`: False if rounding, such as between axes of very different
    scales, prevented a solution; velocity and forces are then 0.
    """

    pairs: NDArray[Any]
    force: NDArray[np.float64]
    sticking: NDArray[np.bool_]
    torque: NDArray[np.float64]
    normal_torque: NDArray[np.float64]
    velocity: NDArray[np.float64]
    solved: bool

    @property
    def pressing(self) -> NDArray[np.bool_]:
        """Mask of the contacts whose force is not 0, shape (m,)."""
        return np.asarray(np.any(self.force != 0.0, axis=1))


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Pairs of near points of robot and obstacles, with their relative velocities for unit velocities of the axes.

    `pairs` (n,): records of points, normal and gap (`resgrid.control.plant.PAIR`); `normal_rows, tangent_rows` (n,
    ndim): ``n . J`` and ``t . J``, the velocity of the robot's point along the unit normal ``n`` out of the obstacle
    and along the tangent ``t`` (``n`` turned left), per unit velocity of each axis, with the Jacobian ``J`` of the
    point.
    """

    pairs: NDArray[Any]
    normal_rows: NDArray[np.float64]
    tangent_rows: NDArray[np.float64]

    @property
    def gap(self) -> NDArray[np.float64]:
        """Gaps between robot and obstacle of all pairs, in metres, shape (n,)."""
        return np.asarray(self.pairs["gap"])


def surroundings(pose: Pose, pairs: NDArray[Any]) -> Surroundings:
    """Return pairs of near points with the rows of their contact Jacobians, as Surroundings.

    `pose`: pose of the robot; `pairs` (n,): records of near points at this pose (`resgrid.control.plant.PAIR`).
    """
    from resgrid.control import contact_kernels

    ndim = pose.spin.shape[1]
    normal, tangent = np.empty((len(pairs), ndim)), np.empty((len(pairs), ndim))
    if len(pairs):
        contact_kernels.contact_rows(pairs, pose, normal, tangent)
    return Surroundings(pairs, normal, tangent)


def solve_contacts(
    around: Surroundings,
    touching: NDArray[np.bool_],
    velocity: NDArray[np.float64],
    admittance: NDArray[np.float64],
    friction: float,
    opening: NDArray[np.float64],
    stops: NDArray[np.float64] | None = None,
) -> ContactSet:
    """Compute contact forces and the resulting velocity; return them as a ContactSet of the touching pairs only.

    The forces are those that keep gaps from closing; the velocity also opens gaps at the rates of `opening` if
    possible. `around`: all n pairs of near points; `touching` (n,): mask of the pairs in contact; `velocity` (ndim,):
    command in axis coordinates, per second; `admittance` (ndim, ndim): velocity per generalised force; `friction`:
    friction coefficient; `opening` (n,): smallest rates, in m/s, at which the gaps should grow, 0 for gaps that only
    must not close; `stops` (s, ndim): unit vectors in configuration space away from the mechanical stops that the robot
    is at, None if the robot is at no stop.
    """
    pairs = around.pairs[touching]
    ends = np.empty((0, len(velocity))) if stops is None else stops
    count = len(pairs)
    rows = np.concatenate([around.normal_rows[touching], ends]), np.zeros((count + len(ends), len(velocity)))
    rows[1][:count] = around.tangent_rows[touching]
    target = np.zeros(count + len(ends))
    after, forces, solved = contact_forces(*rows, target, velocity, admittance, friction)
    target[:count] = opening[touching]
    pushed = contact_forces(*rows, target, velocity, admittance, friction) if solved and target.any() else None
    normal = pairs["normal"]
    tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
    own = forces[:count]
    not_moving = np.abs(rows[1][:count] @ after) <= 1e-6 * np.abs(rows[1][:count]) @ np.abs(velocity)
    return ContactSet(
        pairs=pairs,
        force=own[:, :1] * normal + own[:, 1:] * tangent,
        sticking=np.asarray((own[:, 0] > 0.0) & not_moving & (np.abs(own[:, 1]) < friction * own[:, 0])),
        torque=forces[:, 0] @ rows[0] + forces[:, 1] @ rows[1],
        normal_torque=own[:, 0] @ rows[0][:count],
        velocity=pushed[0] if pushed is not None and pushed[2] else after,
        solved=solved,
    )


class SimulatedRobot:
    """The true configuration of a robot, and its collision-free steps.

    Contacts hold gaps to first order only, and the path of a turning link is curved.  Therefore every step is shortened
    to a fraction with proven positive gaps (`Plant.free_fraction`), pose by pose.  A robot that touches an obstacle at
    the start is moved about 1e-8 m away, so that its side of the obstacle is unambiguous.  A robot that is wedged too
    tightly for this motion never moves.

    `plant`: robot and true obstacles; `start` (ndim,): configuration in axis coordinates; `step`: largest motion along
    an axis in one step, in cells; `margin`: gap at which a step towards an obstacle ends and a contact begins, in
    metres; pairs of points with a gap of at most 1.5 times the margin are in contact.
    """

    def __init__(self, plant: Plant, start: Vector, step: float, margin: float) -> None:
        self.plant, self.configuration, self.step, self.margin = plant, start, step, margin
        self._spacing = np.array([axis.spacing for axis in plant.axes])
        self._reach = step * plant.cell_motion
        self._clear, self._pose = 0.0, plant.pose(start)
        ndim = len(start)
        self._nothing = Surroundings(np.empty(0, PAIR), np.empty((0, ndim)), np.empty((0, ndim)))
        size = max([0.0, *self._pose.radius.tolist(), *plant.arrays.discs[:, 2].tolist()])
        self._lift = _LIFT * (1.0 + size)
        self.configuration = self._lifted()

    def _lifted(self) -> Vector:
        """Return the configuration (ndim,), moved about 1e-8 m away from obstacles that touch the robot if possible."""
        none = np.zeros_like(self.configuration)
        for _ in range(_LIFTS):
            around = self._survey()
            if not len(around.gap) or float(around.gap.min()) >= 0.5 * self._lift:
                break
            off = np.maximum(self._lift - around.gap, 0.0)
            away = solve_contacts(around, off > 0.0, none, np.eye(len(none)), 0.0, off, self._stops()).velocity
            self.configuration = self.plant.within_stops(self.configuration + away)
        return self.configuration

    def look(self) -> Surroundings:
        """Return the pairs of near points at the present configuration as Surroundings.

        Each pair has a point of the robot and a point of an obstacle. They are near if their gap is at most four times
        the largest motion of any point of the robot in one step. The result is empty, without a search, while the last
        search proves that no obstacle is in reach of a step.
        """
        return self._nothing if self._clear > 2.0 * self._reach else self._survey()

    def _survey(self) -> Surroundings:
        """Search for near obstacles at the present configuration; return the pairs of near points as Surroundings.

        Points are near if their gap is at most four times the largest motion of any point of the robot in one step.
        """
        pose = self._pose = self.plant.pose(self.configuration)
        pairs = self.plant.near(pose, _LOOK * self._reach)
        self._clear = float(pairs["gap"].min()) if len(pairs) else _LOOK * self._reach
        return surroundings(pose, pairs)

    def contacts(
        self, around: Surroundings, velocity: Vector, admittance: Vector, friction: float, pause: float
    ) -> ContactSet | None:
        """Return the contacts with obstacles and mechanical stops at a commanded velocity; None without contacts.

        `around`: pairs of near points; `velocity` (ndim,): command in axis coordinates, per second; `admittance` (ndim,
        ndim): velocity per generalised force; `friction`: friction coefficient; `pause`: duration of a step, in
        seconds.  A gap below half the margin, the gap at which a contact begins, opens to the margin within about five
        such durations.
        """
        stops = self._stops()
        touching = around.gap <= 1.5 * self.margin
        if not touching.any() and not np.any(stops @ velocity < 0.0):
            return None
        opening = np.where(around.gap < 0.5 * self.margin, (self.margin - around.gap) / (5.0 * pause), 0.0)
        return solve_contacts(around, touching, velocity, admittance, friction, opening, stops)

    def _stops(self) -> Vector:
        """Return unit vectors (s, ndim) in configuration space away from the mechanical stops that the robot is at.

        Mechanical stops are the ends of axes that are not periodic.
        """
        lower, upper = self.plant.stops
        low = self.configuration - lower <= _AT_STOP * self._spacing
        high = upper - self.configuration <= _AT_STOP * self._spacing
        if not (low.any() or high.any()):
            return self._nothing.normal_rows
        return np.concatenate([np.eye(len(low))[low], -np.eye(len(low))[high]])

    def move(
        self, velocity: Vector, longest: float, pause: float, around: Surroundings, keep: float = KEEP
    ) -> tuple[float, Vector]:
        """Take a step; return its duration in seconds and its velocity (ndim,); `pause` and 0 if the robot is blocked.

        `velocity` (ndim,): in axis coordinates, per second; `longest`: maximum duration, in seconds; `pause`: duration
        to return for a blocked robot, in seconds; `around`: pairs of near points; `keep`: smallest gap after the step,
        as a fraction of the margin, the gap at which a contact begins. The step is shortened to its collision-free
        fraction.
        """
        step = self._time_step(velocity, longest, around)
        fraction = self._free(step * velocity, around, keep)
        if fraction < _LEAST:
            return pause, np.zeros_like(velocity)
        self._clear -= self._reach
        self.configuration = self.plant.within_stops(self.configuration + fraction * step * velocity)
        return fraction * step, velocity

    def shaken(self, by: Vector) -> bool:
        """Move by an offset if this motion is free of collisions; return whether the robot moved.

        `by` (ndim,): offset in axis units.
        """
        around = self.look()
        motion = self.plant.within_stops(self.configuration + by) - self.configuration
        if not motion.any() or self._free(motion, around, KEEP) < 1.0:
            return False
        self._clear -= self._reach
        self.configuration = self.configuration + motion
        return True

    def _time_step(self, velocity: Vector, longest: float, around: Surroundings) -> float:
        """Return the duration of a step in seconds, at most `longest`.

        The step ends when an axis has moved by the number of cells in `step`, at a mechanical stop, or when a gap falls
        to the margin, the gap at which a contact begins.  `velocity` (ndim,): in axis coordinates, per second;
        `around`: pairs of near points.
        """
        fastest = float((np.abs(velocity) / self._spacing).max())
        if fastest == 0.0:
            return longest
        step = min(longest, self.step / fastest)
        ahead = np.where(
            velocity > 0.0, self.plant.stops[1] - self.configuration, self.configuration - self.plant.stops[0]
        )
        meets = (ahead > _AT_STOP * self._spacing) & (step * np.abs(velocity) > ahead)
        if meets.any():
            step = float((ahead[meets] / np.abs(velocity[meets])).min())
        closing = -(around.normal_rows @ velocity)
        meets = (around.gap > 1.5 * self.margin) & (step * closing > around.gap - self.margin)
        if meets.any():
            step = float(((around.gap[meets] - self.margin) / closing[meets]).min())
        return step

    def _free(self, motion: Vector, around: Surroundings, keep: float) -> float:
        """Return a fraction (0 to 1) of a motion on which no gap falls below a limit.

        The limit is `keep` times the margin (the gap at which a contact begins), or the smallest gap before the motion
        if that gap is less.  `motion` (ndim,): offset of the configuration, in axis units; `around`: pairs of near
        points; `keep`: fraction of the margin.
        """
        if around is self._nothing:
            return 1.0
        nearest = float(around.gap.min(initial=np.inf))
        if nearest < 0.1 * self._lift:
            return 0.0
        least = min(max(keep * self.margin, 0.5 * self._lift), nearest)
        fraction, pose = 0.0, self._pose
        for _ in range(_POSES):
            more = self.plant.free_fraction(pose, motion, least)
            fraction += more
            if fraction >= 1.0 or more < _LEAST:
                break
            pose = self.plant.pose(self.configuration + fraction * motion)
        return min(fraction, 1.0)
