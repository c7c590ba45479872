"""Trajectories: when a robot is where, and how fast, piece by piece of constant acceleration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.arguments import check_number
from resgrid.errors import InputError

_MOST_SAMPLES = 10_000_000


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A motion: between two knots the acceleration is constant, unless it was resampled.

    Attributes
    ----------
    times : ndarray of float64, shape (n,)
        Ascending from 0, in seconds.
    positions : ndarray of float64, shape (n, ndim)
        World coordinates, continuous across periodic seams.
    velocities : ndarray of float64, shape (n, ndim)
        In the world, per second, just after each knot; 0 at the last.
    accelerations : ndarray of float64, shape (n - 1, ndim)
        In the world, per second squared, between the knots; of a resampled motion, their means.
    motion : Trajectory or None
        Of a resampled motion, the one it was taken from, which it follows between its knots too.
    """

    times: NDArray[np.float64]
    positions: NDArray[np.float64]
    velocities: NDArray[np.float64]
    accelerations: NDArray[np.float64]
    motion: Trajectory | None = None

    def __post_init__(self) -> None:
        for array in (self.times, self.positions, self.velocities, self.accelerations):
            array.flags.writeable = False

    @property
    def duration(self) -> float:
        """Time from start to end, in seconds."""
        return float(self.times[-1])

    def at(self, times: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Positions and velocities at any times; before the start and after the end the robot rests there.

        Parameters
        ----------
        times : array_like of float, shape (m,)
            In seconds.

        Returns
        -------
        positions : ndarray of float64, shape (m, ndim)
        velocities : ndarray of float64, shape (m, ndim)

        Raises
        ------
        InputError
            If the times are not numbers in a row.
        """
        try:
            when = np.atleast_1d(np.asarray(times, dtype=np.float64))
        except (TypeError, ValueError):
            when = np.full(1, np.nan)
        if when.ndim != 1 or np.isnan(when).any():
            raise InputError("a time is not a number, or the times are no row")
        if self.motion is not None:
            return self.motion.at(when)
        if len(self.times) < 2:
            still = np.repeat(self.positions, len(when), axis=0)
            return still, np.zeros_like(still)
        piece = np.clip(np.searchsorted(self.times, when, side="right") - 1, 0, len(self.times) - 2)
        past = np.clip(when, 0.0, self.duration) - self.times[piece]
        step = past[:, np.newaxis]
        velocity = self.velocities[piece] + step * self.accelerations[piece]
        position = self.positions[piece] + step * (self.velocities[piece] + velocity) / 2
        over = when >= self.duration
        position[over] = self.positions[-1]
        velocity[over | (when < 0)] = 0.0
        return position, velocity

    def sample(self, rate: float) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Times a fixed step apart and the end, with positions and velocities there.

        Parameters
        ----------
        rate : float
            Samples a second.

        Returns
        -------
        times : ndarray of float64, shape (m,)
        positions : ndarray of float64, shape (m, ndim)
        velocities : ndarray of float64, shape (m, ndim)

        Raises
        ------
        InputError
            If the rate is not positive, or asks for more than ten million samples.
        """
        check_number("rate", rate, "a positive number of samples a second", above=0.0)
        if rate * self.duration > _MOST_SAMPLES:
            raise InputError(
                f"{rate:g} samples a second for {self.duration:g} s are more than {_MOST_SAMPLES:,}; lower the rate"
            )
        steps = np.arange(int(np.floor(rate * self.duration)) + 1) / rate
        times = np.append(steps[steps < self.duration], self.duration)
        return times, *self.at(times)

    def resampled(self, rate: float) -> Trajectory:
        """The same motion with knots a fixed step apart; as `sample` otherwise.

        Parameters
        ----------
        rate : float
            Knots a second.

        Returns
        -------
        Trajectory
            Positions and velocities are exact at the knots, and `at` any time; accelerations are mean ones.
        """
        times, positions, velocities = self.sample(rate)
        step = np.diff(times)[:, np.newaxis]
        return Trajectory(times, positions, velocities, np.diff(velocities, axis=0) / step, self.motion or self)
