"""External generalised forces on a moving robot: the type, random forces, forces of a scene, and the sum of forces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.numbers import Count, Natural, NotNegative, Positive
from resgrid._internal.validation import checked
from resgrid._internal.values import frozen
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.scene.control import Control

Force = Callable[[float, NDArray[np.float64]], ArrayLike]
"""Function from a time in seconds and a configuration (ndim,) to a generalised force (ndim,).

For a point or a disc, configuration and force are in world coordinates; for an arm they are joint angles and torques.
"""


@checked
@frozen
@dataclass(frozen=True, eq=False)
class ExternalForce:
    """A constant generalised force during an interval of time.

    Attributes
    ----------
    start, duration : float
        Start time and duration of the force, in seconds.
    force : ndarray of float64, shape (ndim,)
        Generalised force on the robot (joint torques for an arm).  Its unit is that of the scene's admittance: the
        product of `Control.admittance` and a force is a velocity.

    Raises
    ------
    InputError
        If a number is not finite, or the duration is not above 0.

    Examples
    --------
    >>> push = rg.control.ExternalForce(start=1.0, duration=0.5, force=(0.0, 0.2))
    >>> run = rg.simulation(rg.read_scene("examples/scenes/lesson.toml"), k=0.9).run(pushes=[push])
    >>> str(run.ending), rg.control.ControlMode.PUSHED in run.mode
    ('arrived', True)
    """

    start: NotNegative
    duration: Positive
    force: NDArray[np.float64]

    def __post_init__(self) -> None:
        force = np.array(self.force, dtype=np.float64)
        force.flags.writeable = False
        object.__setattr__(self, "force", force)
        if force.ndim != 1 or not np.isfinite(force).all():
            raise InputError(f"a push needs a finite force, one entry per axis, got {force.tolist()}")


def random_forces(
    seed: Natural, ndim: Count, *, until: NotNegative, size: float, duration: Positive, count: Natural = 8
) -> list[ExternalForce]:
    """Return forces in random directions, with start times distributed uniformly from 0 to `until`.

    Parameters
    ----------
    seed : int
        Seed of the random numbers.
    ndim : int
        Number of axes.
    until : float
        Upper limit of the start times, in seconds.
    size : float
        Euclidean norm of each generalised force; only the direction is random.
    duration : float
        Duration of each force, in seconds.
    count : int
        Number of forces.

    Returns
    -------
    list of ExternalForce
        The forces, in order of their start times.

    Raises
    ------
    InputError
        If a number is out of range.

    Examples
    --------
    >>> pushes = rg.control.random_forces(seed=0, ndim=2, until=10.0, size=0.2, duration=0.5, count=3)
    >>> [round(float(np.linalg.norm(push.force)), 9) for push in pushes]
    [0.2, 0.2, 0.2]
    """
    rng = np.random.default_rng(seed)
    starts = np.sort(rng.uniform(0.0, until, count))
    forces = rng.normal(size=(count, ndim))
    forces *= size / np.linalg.norm(forces, axis=1, keepdims=True)
    return [ExternalForce(float(start), duration, force) for start, force in zip(starts, forces, strict=True)]


def control_pushes(control: Control, seed: int, space: ConfigurationSpace, speed: float) -> list[ExternalForce]:
    """Return the external forces of a ``[control]`` table of a scene: the listed ones, then the random ones.

    Random forces start within the time in which the robot could move along the whole longest axis, and each lasts a
    twentieth of this time.  `control`: the table; `seed`: seed of the random forces; `space`: gives the axes; `speed`:
    nominal speed, in world coordinates per second.
    """
    pushes = [ExternalForce(start, duration, np.array(force)) for start, duration, *force in control.push]
    until = float((space.upper - space.lower).max()) / speed
    if control.pushes and control.push_size:
        count, size = control.pushes, control.push_size
        pushes += random_forces(seed, space.ndim, until=until, size=size, duration=until / 20, count=count)
    return pushes


def force_of(pushes: Sequence[ExternalForce] | Force, ndim: int) -> Force:
    """Return external forces as one function from a time (s) and a configuration (ndim,) to a force (ndim,).

    A force acts from its start time until its duration has passed. `pushes`: list of forces, which are added where they
    act at the same time, or a function of time and configuration; `ndim`: number of axes.  A force of another shape or
    a force that is not finite raises InputError: in a list at once, from a function when the result calls it.
    """
    if callable(pushes):
        return lambda time, configuration: checked_force(pushes(time, configuration), ndim, f"the push at {time:g} s")
    schedule = list(pushes)
    for push in schedule:
        checked_force(push.force, ndim, f"the push at {push.start:g} s")

    def total(time: float, _configuration: NDArray[np.float64]) -> NDArray[np.float64]:
        force = np.zeros(ndim)
        for push in schedule:
            if push.start <= time < push.start + push.duration:
                force += push.force
        return force

    return total


def checked_force(force: ArrayLike, ndim: int, name: str) -> NDArray[np.float64]:
    """Return a generalised force as an array (ndim,); raise InputError for another shape or values that are not finite.

    `name`: name of the force for the message.
    """
    try:
        tau = np.asarray(force, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name} must be numbers, got {force!r}") from None
    if tau.shape != (ndim,):
        raise InputError(f"{name} has shape {tau.shape}, but there are {ndim} axes")
    if not np.isfinite(tau).all():
        raise InputError(f"{name} is not finite: {tau.tolist()}; stop the robot, check the sensor")
    return tau
