"""Hidden obstacles that are announced: how the change spreads, and how fast a robot may be while its grid settles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.control.log import Ending, Mode, Run
from resgrid.control.relaxation import TICK, Relaxation, RelaxingGrid
from resgrid.control.simulation import Simulation, announce_hidden
from resgrid.errors import InputError
from resgrid.frozen import frozen, picture_html
from resgrid.space import ConfigurationSpace

BITS = 10
"""Settled means here: every potential is within half a step of a converter of so many bits of its end."""

_LONGEST = 10_000_000
_STEPS = 200


@frozen
@dataclass(frozen=True, eq=False)
class RelaxationSweep:
    """Runs of one robot on grids that settle at different paces.

    `relaxation`: what the runs share; its pace is not used; `settle`: sweeps, or units ``R C``, that the grid takes
    to settle to `BITS` bits after the change; `pace` (n,): sweeps, or units ``R C``, while the robot crosses a cell;
    ascending; `ratio` (n,): speed of the robot against that of settling: cells that it crosses while the grid
    settles, ``settle / pace``; `time, waited` (n,): how long each run took, and how long the robot stood waiting, in
    cells that it could have crossed; `instant`: how long a run takes on a grid that has settled before it begins, in
    cells.
    """

    relaxation: Relaxation
    settle: float
    pace: NDArray[np.float64]
    ratio: NDArray[np.float64]
    ending: tuple[Ending, ...]
    time: NDArray[np.float64]
    waited: NDArray[np.float64]
    instant: float

    @property
    def arrived(self) -> NDArray[np.bool_]:
        """Which runs arrived, shape (n,)."""
        return np.array([ending is Ending.ARRIVED for ending in self.ending])

    @property
    def failing_ratio(self) -> float | None:
        """Smallest ratio at which a run did not arrive; None if all did."""
        failed = self.ratio[~self.arrived]
        return float(failed.min()) if len(failed) else None

    @property
    def safe_ratio(self) -> float | None:
        """Largest ratio up to which all runs arrived; None if the slowest robot did not."""
        limit = self.failing_ratio
        below = self.ratio[self.arrived & (self.ratio < (np.inf if limit is None else limit))]
        return float(below.max()) if len(below) else None


@frozen
@dataclass(frozen=True, eq=False)
class Wavefront:
    """How a change of the map spreads.

    `before, after`: the map that the grid had settled to, and the one it is settling to; `cells` (t,): when: in cells
    that the robot could have crossed; `potential` (t, *shape of the space): at those times; NaN in cells without a
    node; `distance` (t,): largest distance of a potential from its end; `first` as the space: potential before the
    change.
    """

    before: ConfigurationSpace
    after: ConfigurationSpace
    cells: NDArray[np.float64]
    potential: NDArray[np.float64]
    distance: NDArray[np.float64]
    first: NDArray[np.float64]

    _repr_html_ = picture_html


def wavefront(simulation: Simulation, cells: NDArray[np.float64]) -> Wavefront:
    """Follow a change of the map through the grid.

    Parameters
    ----------
    simulation : Simulation
        Of a plane, made with ``announce=True`` and a ``settle``.
    cells : ndarray of float64, shape (t,)
        When to look: in cells that the robot could have crossed since the change, ascending.

    Returns
    -------
    Wavefront

    Raises
    ------
    InputError
        If nothing was announced, or the times do not ascend.
    CircuitError
        If nothing can be driven.

    Examples
    --------
    >>> scene = rg.read_scene("examples/scenes/lesson.toml").replace(hidden=(rg.Box((5.0, 2.2), (6.0, 3.0)),))
    >>> world = rg.simulation(scene, k=1.0, announce=True, settle="sor")
    >>> front = rg.wavefront(world, np.array([0.0, 0.5, 4.0]))
    >>> front.potential[:, 5, 3].round(3)
    array([0.843, 0.945, 0.955])
    """
    when = np.asarray(cells, dtype=np.float64)
    if when.ndim != 1 or not len(when) or not np.isfinite(when).all() or when[0] < 0 or np.any(when[1:] < when[:-1]):
        raise InputError("times of a wavefront must be finite, at least 0 and ascending, in cells crossed")
    grid = _grid_before(simulation)
    first = grid.field.potential
    grid.change(simulation.space)
    frames, distance = [], []
    for step in np.diff(when, prepend=0.0).tolist():
        grid.advance(step)
        frames.append(grid.field.potential)
        distance.append(grid.distance)
    return Wavefront(grid.before.space, simulation.space, when.copy(), np.array(frames), np.array(distance), first)


def settling_time(world: Simulation) -> float:
    """Sweeps, or units ``R C``, until the grid of a world where something was announced has settled.

    A chip's is measured twice, the second time with steps of 1/200 of it: a step h of backward Euler lets
    ``exp(-t / tau)`` take ``h / (2 tau)`` longer, and settling takes some 7 tau.
    """
    if _grid_before(world).relaxation.method != "chip":
        times = np.unique(np.round(1.05 ** np.arange(1.0, 330.0))).astype(np.float64)
        last, spent = _watched(world, 1.0, times[times < _LONGEST])
        if spent > last:
            return max(last, 1.0)
        raise InputError(f"the grid has not settled after {spent:g} sweeps")
    step = 1.0
    while step < _LONGEST:
        last, spent = _watched(world, step / TICK, TICK * np.arange(1.0, 41.0))
        if spent > 2 * last:
            tick = max(last, step) / _STEPS
            return _watched(world, tick / TICK, TICK * np.arange(1.0, 1.25 * _STEPS))[0] + tick / 2
        step *= 2
    raise InputError(f"the grid has not settled after {spent:g} units of R C")


def _watched(world: Simulation, pace: float, cells: NDArray[np.float64]) -> tuple[float, float]:
    """When a grid was seen out of its final band for the last time, and until when it was watched."""
    grid = _grid_before(world, pace)
    grid.change(world.space)
    last, now = 0.0, 0.0
    for time in cells.tolist():
        grid.advance(time - now)
        now = time
        if grid.distance > 0.5 / 2**BITS:
            last = now
        elif now > 2 * last + 40 * TICK:
            break
    return last * pace, now * pace


def _grid_before(world: Simulation, pace: float | None = None) -> RelaxingGrid:
    """The grid as it had settled before something was announced, at a pace of its own."""
    if world.relaxation is None or world.before is None:
        raise InputError("nothing was announced in this simulation: make it with rg.simulation(scene, announce=True)")
    relaxation = world.relaxation if pace is None else replace(world.relaxation, pace=pace)
    return RelaxingGrid(relaxation, world.before)


def relaxation_sweep(
    sim: Simulation,
    start: ArrayLike,
    relaxation: Relaxation,
    ratios: Sequence[float],
    *,
    max_steps: int = 20_000,
    progress: Callable[[int, int], object] | None = None,
) -> RelaxationSweep:
    """Let a robot go while its grid settles, at several ratios of both speeds.  Shapes: `start` (ndim,)."""
    requested = np.sort(np.asarray(ratios, dtype=np.float64))[::-1]
    if requested.ndim != 1 or not len(requested) or not (np.isfinite(requested).all() and requested[-1] > 0):
        raise InputError("ratios must be finite numbers above 0, at least one")
    world = announce_hidden(sim, relaxation)
    settle = settling_time(world)
    cells = sim.controller.speed / float(sim.space.spacing.min())
    instant = replace(world, relaxation=None, before=None).run(start, max_steps=max_steps)
    runs: list[Run] = []
    for number, ratio in enumerate(requested.tolist()):
        paced = replace(world, relaxation=replace(relaxation, pace=settle / ratio))
        runs.append(paced.run(start, max_steps=max_steps))
        if progress is not None:
            progress(number + 1, len(requested))
    waited = [float(np.diff(run.time)[run.mode[:-1] == Mode.WAITING].sum()) for run in runs]
    return RelaxationSweep(
        relaxation=relaxation,
        settle=settle,
        pace=settle / requested,
        ratio=requested.copy(),
        ending=tuple(run.ending for run in runs),
        time=np.array([run.time[-1] for run in runs]) * cells,
        waited=np.array(waited) * cells,
        instant=float(instant.time[-1]) * cells,
    )
