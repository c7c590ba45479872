"""How the robot moves: solid, between mechanical stops, among what is truly there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.control.contact import Surroundings, Touch, surroundings, touch
from resgrid.control.plant import Plant
from resgrid.robots.geometry import TOUCH

Vector = NDArray[np.float64]

_LOOK = 4.0
_AT_STOP = 1e-6
_LEAST = 1e-3
_POSES = 50
_LIFTS = 3
_LIFT = 10 * TOUCH

KEEP = 0.2
"""Gap that no step goes below, in margins, unless the robot starts there."""


class Body:
    """A robot's true configuration, and the steps it can take from there.

    Contacts hold gaps to first order, and a turning link bends towards what it slides along.  So every step is
    shortened to the share of it for which a gap is known to remain (`Plant.free_share`), pose after pose: a robot that
    starts outside of every obstacle never enters one, between two configurations as little as at them.  One that
    touches at the start is lifted off by `_LIFT` (for each metre, and one more, of the largest radius), so that it is
    known on which side it is; wedged so tightly that it cannot be, it never moves.

    `start` (ndim,); `step`: largest motion along an axis in one step, in cells; `margin`: gap at which the robot
    counts as touching, in metres.
    """

    def __init__(self, plant: Plant, start: Vector, step: float, margin: float) -> None:
        self.plant, self.configuration, self.step, self.margin = plant, start, step, margin
        self._spacing = np.array([axis.spacing for axis in plant.axes])
        self._reach = step * plant.cell_motion
        self._clear, self._pose = 0.0, plant.pose(start)
        ndim = len(start)
        self._nothing = Surroundings(np.empty((0, 11)), np.empty((0, ndim)), np.empty((0, ndim)))
        size = max([0.0, *self._pose.radius.tolist(), *plant.arrays.discs[:, 2].tolist()])
        self._lift = _LIFT * (1.0 + size)
        self.configuration = self._lifted()

    def _lifted(self) -> Vector:
        """The configuration, or where something is touched one some 1e-8 m off it, if there is one."""
        none = np.zeros_like(self.configuration)
        for _ in range(_LIFTS):
            around = self._looked()
            if not len(around.gap) or float(around.gap.min()) >= 0.5 * self._lift:
                break
            off = np.maximum(self._lift - around.gap, 0.0)
            away = touch(around, off > 0.0, none, np.eye(len(none)), 0.0, off, self._stops()).velocity
            self.configuration = self.plant.within_stops(self.configuration + away)
        return self.configuration

    def look(self) -> Surroundings | None:
        """What is near enough to be met in this step; None while that is known to be nothing."""
        if self._clear > 2.0 * self._reach:
            return None
        return self._looked()

    def _looked(self) -> Surroundings:
        pose = self._pose = self.plant.pose(self.configuration)
        pairs = self.plant.near(pose, _LOOK * self._reach)
        self._clear = float(pairs[:, 6].min()) if len(pairs) else _LOOK * self._reach
        return surroundings(pose, pairs)

    def touch(
        self, around: Surroundings | None, velocity: Vector, admittance: Vector, friction: float, pause: float
    ) -> Touch | None:
        """Contacts with obstacles and stops at a velocity, if there are any; gaps open within some five pauses."""
        stops = self._stops()
        near = around if around is not None else self._nothing
        touching = near.gap <= 1.5 * self.margin
        if not touching.any() and not np.any(stops @ velocity < 0.0):
            return None
        opening = np.where(near.gap < 0.5 * self.margin, (self.margin - near.gap) / (5.0 * pause), 0.0)
        return touch(near, touching, velocity, admittance, friction, opening, stops)

    def _stops(self) -> Vector:
        """Unit vectors away from the stops that the robot is at, shape (s, ndim)."""
        lower, upper = self.plant.stops
        low = self.configuration - lower <= _AT_STOP * self._spacing
        high = upper - self.configuration <= _AT_STOP * self._spacing
        if not (low.any() or high.any()):
            return self._nothing.normal_rows
        return np.concatenate([np.eye(len(low))[low], -np.eye(len(low))[high]])

    def move(
        self, velocity: Vector, longest: float, pause: float, around: Surroundings | None, keep: float = KEEP
    ) -> tuple[float, Vector]:
        """Take a step; returns how long it lasts, and the velocity: 0 for a pause if it is blocked."""
        step = self._time_step(velocity, longest, around)
        share = 1.0 if around is None else self._free(step * velocity, around, keep)
        if share < _LEAST:
            return pause, np.zeros_like(velocity)
        self._clear -= self._reach
        self.configuration = self.plant.within_stops(self.configuration + share * step * velocity)
        return share * step, velocity

    def shaken(self, by: Vector) -> bool:
        """Move by a small amount, if nothing is in the way; whether it did."""
        around = self.look()
        motion = self.plant.within_stops(self.configuration + by) - self.configuration
        if not motion.any() or (around is not None and self._free(motion, around, KEEP) < 1.0):
            return False
        self._clear -= self._reach
        self.configuration = self.configuration + motion
        return True

    def _time_step(self, velocity: Vector, longest: float, around: Surroundings | None) -> float:
        """Until an axis has moved by a step, or something ahead is met."""
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
        if around is not None and len(around.gap):
            closing = -(around.normal_rows @ velocity)
            meets = (around.gap > 1.5 * self.margin) & (step * closing > around.gap - self.margin)
            if meets.any():
                step = float(((around.gap[meets] - self.margin) / closing[meets]).min())
        return step

    def _free(self, motion: Vector, around: Surroundings, keep: float) -> float:
        """Share of a motion on which no gap falls below what is kept, or below the smallest that there is."""
        nearest = float(around.gap.min(initial=np.inf))
        if nearest < 0.1 * self._lift:
            return 0.0
        least = min(max(keep * self.margin, 0.5 * self._lift), nearest)
        share, pose = 0.0, self._pose
        for _ in range(_POSES):
            more = self.plant.free_share(pose, motion, least)
            share += more
            if share >= 1.0 or more < _LEAST:
                break
            pose = self.plant.pose(self.configuration + share * motion)
        return min(share, 1.0)
