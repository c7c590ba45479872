"""Section: plans on a map with moving boxes and flickering cells, frame by frame, in comparison with D* Lite.

Every contender gets the same frames: a map of free cells, of which at most 1 % change, a start and a goal.  Figures:
processor time of a frame, success (a path through free cells only), length relative to the shortest path over eight
neighbours, clearance, and probability of collision if the whole path is displaced at random.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from benchmarks.planners import NOISE, Task, path_figures
from benchmarks.planners_contenders import Points
from benchmarks.rows import Row, Scale, Spread

Free = NDArray[np.bool_]
Step = Callable[[Free], Points]
"""Function that plans on the next frame, and returns the points of the path in cells, or None."""
Contender = Callable[[Free, tuple[int, int], tuple[int, int]], Step]

BOXES, FLICKER, EVERY = 5, 0.002, 50
"""Number of moving boxes, fraction of flickering cells, and interval of the frames whose paths are measured."""

_STEPS = [step for step in product((-1, 0, 1), repeat=2) if any(step)]


def replanning(scale: Scale) -> list[Row]:
    """Section: every contender on the frames of three maps; the first frame, with its setup, is a row of its own."""
    size, count = {"tiny": (40, 8), "full": (256, 500)}.get(scale.name, (256, 200))
    rows: list[Row] = []
    for name, make in MAPS.items():
        free = make(size, np.random.default_rng(scale.seed + 11))
        start, goal = ends_of(free)
        for contender, prepare in CONTENDERS.items():
            few = count if contender in _FAST else max(count // 20, 5)
            pictures = frames(free, start, goal, few, np.random.default_rng(scale.seed + 12))
            rows += _contender_rows(f"{name}, {size}^2", contender, prepare, pictures, start, goal)
    return rows


def _contender_rows(
    name: str, contender: str, prepare: Contender, pictures: Iterator[Free], start: tuple[int, int],
    goal: tuple[int, int],
) -> Iterator[Row]:  # fmt: skip
    try:
        seconds, figures = measure(prepare, pictures, start, goal)
    except ImportError as missing:
        yield Row(f"{name}: a frame", None, None, "ms of a processor", contender, f"not installed: {missing.name}")
        return
    times = 1e3 * np.array(seconds[2:])  # the second frame compiles the kernels of the update
    late = f"95 %: {np.quantile(times, 0.95):.1f} ms; {len(times)} frames, first {1e3 * seconds[0]:.0f} ms"
    yield Row(
        f"{name}: a frame", None, Spread(float(np.median(times)), float(times.min()), float(times.max())),
        "ms of a processor", contender, late,
    )  # fmt: skip
    units = {"success": "share", "length": "x shortest", "least clearance": "cells", "mean clearance": "cells",
             "collision": f"share, noise of {NOISE} cells"}  # fmt: skip
    for metric, unit in units.items():
        values = [found[metric] for found in figures if metric in found]
        spread = Spread(float(np.mean(values)), min(values), max(values)) if values else None
        yield Row(f"{name}: {metric}", None, spread, unit, contender, f"{len(values)} frames")


def measure(
    prepare: Contender, pictures: Iterator[Free], start: tuple[int, int], goal: tuple[int, int]
) -> tuple[list[float], list[dict[str, float]]]:
    """Return the processor seconds of every frame, and figures of the paths of every `EVERY`-th frame."""
    seconds, figures, step = [], [], None
    for number, free in enumerate(pictures):
        begin = time.process_time()
        step = prepare(free, start, goal) if step is None else step
        points = step(free)
        seconds.append(time.process_time() - begin)
        if number % EVERY == 1:
            figures.append(path_figures(points, Task(free, start, goal)))
    return seconds, figures


def frames(
    free: Free, start: tuple[int, int], goal: tuple[int, int], count: int, rng: np.random.Generator
) -> Iterator[Free]:
    """Yield `count` frames: boxes move by one cell or none, other cells flicker; start and goal stay free."""
    size, side = np.array(free.shape), max(3, len(free) // 18)
    place, way = rng.uniform(0, size - side, (BOXES, 2)), rng.uniform(-1.0, 1.0, (BOXES, 2))
    for _ in range(count):
        frame = free.copy()
        place += way
        way = np.where((place < 0) | (place > size - side), -way, way)
        for x, y in np.clip(place, 0, size - side).astype(int).tolist():
            frame[x : x + side, y : y + side] = False
        flicker = rng.integers(0, size, (int(FLICKER * free.size), 2))
        frame[tuple(flicker.T)] ^= True
        for x, y in (start, goal):
            frame[max(x - 2, 0) : x + 3, max(y - 2, 0) : y + 3] = True
        yield frame


def rooms(size: int, rng: np.random.Generator) -> Free:
    """Return a map of rooms, with doors in every wall between two rooms."""
    free = np.ones((size, size), bool)
    lines = range(size // 6, size - 4, size // 6)
    for line in lines:
        free[line : line + 2], free[:, line : line + 2] = False, False
    door = max(3, size // 24)
    for line in lines:
        for room in range(0, size - door, size // 6):
            at = room + int(rng.integers(3, size // 6 - door + 2))
            free[line : line + 2, at : at + door] = free[at : at + door, line : line + 2] = True
    return free


def pillars(size: int, rng: np.random.Generator) -> Free:
    """Return an open map with single blocked cells."""
    return np.asarray(rng.random((size, size)) > 0.06)


def caves(size: int, rng: np.random.Generator) -> Free:
    """Return a map of winding free regions: smooth noise below a threshold, its largest component."""
    noise = ndimage.gaussian_filter(rng.standard_normal((size, size)), max(size / 40, 3.0))
    free = noise < np.quantile(noise, 0.65)
    label, _ = ndimage.label(free)
    return np.asarray(label == np.argmax(np.bincount(label[free])))


MAPS: dict[str, Callable[[int, np.random.Generator], Free]] = {"rooms": rooms, "pillars": pillars, "caves": caves}


def ends_of(free: Free) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return the first and the last free cell that is some cells away from the edge."""
    inside = np.zeros_like(free)
    inside[4:-4, 4:-4] = free[4:-4, 4:-4]
    cells = np.argwhere(inside).tolist()
    return tuple(cells[0]), tuple(cells[-1])


def resgrid_update(free: Free, start: tuple[int, int], goal: tuple[int, int]) -> Step:
    """Update a planner with every frame; return certified streamlines."""
    import resgrid as rg

    planner = rg.plan(rg.ConfigurationSpace.from_array(_codes(free, goal), unit="cell"))

    def step(frame: Free) -> Points:
        nonlocal planner
        planner = planner.update(_codes(frame, goal))
        return _certified(planner, start, goal)

    return step


def resgrid_fresh(free: Free, start: tuple[int, int], goal: tuple[int, int]) -> Step:
    """Plan on every frame without reuse; return certified streamlines."""
    import resgrid as rg

    del free

    def step(frame: Free) -> Points:
        planner = rg.plan(rg.ConfigurationSpace.from_array(_codes(frame, goal), unit="cell"))
        return _certified(planner, start, goal)

    return step


def _codes(free: Free, goal: tuple[int, int]) -> NDArray[np.uint8]:
    codes = (~free).astype(np.uint8)
    codes[goal] = 2
    return codes


def _certified(planner: object, start: tuple[int, int], goal: tuple[int, int]) -> Points:
    import resgrid as rg

    assert isinstance(planner, rg.planning.Planner)
    path = planner.path(cell=start)
    rg.certify(path)
    return np.vstack([path.points, np.add(goal, 0.5)]) if path.outcome == rg.Outcome.REACHED else None


def dstar_lite(free: Free, start: tuple[int, int], goal: tuple[int, int]) -> Step:
    """Repair the shortest path over eight neighbours by D* Lite of the package `pathplanning` (C++)."""
    from pathplanning.planners.search.dstar_lite import DStarLitePlanner
    from pathplanning.spaces.grid2d import Grid2DSearchSpace

    everywhere = Grid2DSearchSpace(*free.shape)
    everywhere.set_occupancy(np.zeros(free.shape[::-1], dtype=bool))
    planner, last = DStarLitePlanner(everywhere, start, goal), np.ones_like(free)

    def step(frame: Free) -> Points:
        nonlocal last
        changed = np.argwhere(frame != last)
        planner.update_edges(_edges(frame, changed))
        last = frame
        found = planner.plan()
        return found.path + 0.5 if found.success else None

    return step


def _edges(free: Free, changed: NDArray[np.int64]) -> list[tuple[tuple[int, int], tuple[int, int], float | None]]:
    """Return the edges near changed cells: infinite if they touch a blocked cell, else None, which restores the length.

    A diagonal touches the two cells beside it, so that no path cuts a corner.
    """
    updates = {}
    for x, y in changed.tolist():
        ends = [((x, y), (x + dx, y + dy)) for dx, dy in _STEPS]
        ends += [((x + dx, y), (x, y + dy)) for dx, dy in product((-1, 1), repeat=2)]
        for (u, v), (p, q) in ends:
            if min(u, p) >= 0 and max(u, p) < free.shape[0] and min(v, q) >= 0 and max(v, q) < free.shape[1]:
                cost = None if free[u, v] and free[p, q] and free[u, q] and free[p, v] else np.inf
                updates[(u, v), (p, q)] = updates[(p, q), (u, v)] = cost
    return [(*edge, cost) for edge, cost in updates.items()]


CONTENDERS: dict[str, Contender] = {
    "resgrid, update": resgrid_update,
    "resgrid, fresh plan": resgrid_fresh,
    "pathplanning D* Lite": dstar_lite,
}
_FAST = {"resgrid, update", "pathplanning D* Lite"}
