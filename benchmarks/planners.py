"""Section: comparison of planners on scenes with narrow passages, and on MovingAI maps if available.

Figures of every query: success (a path through free cells only), length relative to the shortest path over eight
neighbours, clearance, probability of collision if the whole path is displaced at random, and the time of the first
query and of a thousand further queries to the same goal.  The environment variable MOVINGAI names the folder of maps.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from benchmarks.planners_contenders import CONTENDERS, Contender, Points, networkx_astar
from benchmarks.rows import Row, Scale, Spread

CASES = Path(os.environ.get("MOVINGAI", Path(__file__).resolve().parents[2] / "shared" / "cases" / "movingai"))
MAPS = ("arena", "den312d", "room-32-32-4", "random-32-32-20")
NOISE, SHIFTS, STEP = 0.3, 400, 0.05  # cells
UNITS = {
    "success": "share",
    "length": "x shortest",
    "least clearance": "cells",
    "mean clearance": "cells",
    "collision": f"share, noise of {NOISE} cells",
    "first query": "s of a processor",
    "1,000 more": "s of a processor",
}


@dataclass(frozen=True)
class Task:
    """A map (true in free cells), a start and a goal."""

    free: NDArray[np.bool_]
    start: tuple[int, int]
    goal: tuple[int, int]


def planners(scale: Scale) -> list[Row]:
    """Section: every contender on every group of tasks; contenders that are not installed are omitted and listed."""
    size, most = {"tiny": (24, 1), "full": (160, 6)}.get(scale.name, (80, 3))
    groups = {"narrow passages": list(narrow(size, scale.seed))}
    if CASES.is_dir() and scale.name != "tiny":
        groups["MovingAI maps"] = list(movingai(most))
    return [row for name, tasks in groups.items() for row in _group(name, tasks)]


def _group(group: str, tasks: list[Task]) -> Iterator[Row]:
    for contender, (prepare, count) in CONTENDERS.items():
        try:
            prepare(np.ones((5, 5), bool), (4, 4))((0, 0))  # compiles kernels and imports libraries
            found = [measure(task, prepare, count) for task in tasks]
        except ImportError as missing:
            yield Row(f"{group}: success", None, None, "share", contender, f"not installed: {missing.name}")
            continue
        for metric, unit in UNITS.items():
            values = [figures[metric] for figures in found if metric in figures]
            spread = Spread(float(np.mean(values)), min(values), max(values)) if values else None
            note = f"{len(tasks)} queries" + (f"; from {count} starts" if metric == "1,000 more" else "")
            yield Row(f"{group}: {metric}", None, spread, unit, contender, note)


def measure(task: Task, prepare: Contender, count: int) -> dict[str, float]:
    """Return the figures of a contender on one task; figures of the path are absent if there is no path."""
    begin = time.process_time()
    query = prepare(task.free, task.goal)
    points = query(task.start)
    figures = {"first query": time.process_time() - begin}
    cells = np.argwhere(_component(task))
    starts = [tuple(cell) for cell in cells[:: max(1, len(cells) // count)][:count].tolist()]
    begin = time.process_time()
    for start in starts:
        query(start)
    figures["1,000 more"] = (time.process_time() - begin) / len(starts) * 1000
    return figures | path_figures(points, task)


def path_figures(points: Points, task: Task) -> dict[str, float]:
    """Return success, length, clearance and probability of collision of a path; only the first without success."""
    places = None if points is None else _places(points)
    figures = {"success": float(places is not None and _is_free(places, task.free).all())}
    if points is None or places is None or not figures["success"]:
        return figures
    shortest = networkx_astar(task.free, task.goal)(task.start)
    assert shortest is not None
    clearance = _clearance(places, task.free)
    shifts = np.random.default_rng(0).normal(0.0, NOISE, (SHIFTS, 2))
    hit = [not _is_free(places + shift, task.free).all() for shift in shifts]
    return figures | {
        "length": _length(points) / _length(shortest),
        "least clearance": float(clearance.min()),
        "mean clearance": float(clearance.mean()),
        "collision": float(np.mean(hit)),
    }


def narrow(size: int, seed: int) -> Iterator[Task]:
    """Return three tasks with narrow passages: a door, a bent corridor, a field of pillars."""
    n = size
    door = np.ones((n, n), bool)
    door[n // 2 - 1 : n // 2 + 1] = False
    door[n // 2 - 1 : n // 2 + 1, n // 5 : n // 5 + 2] = True
    yield Task(door, (2, n - 3), (n - 3, n - 3))
    bent = np.ones((n, n), bool)
    for number, row in enumerate(range(n // 6, n - 3, n // 6)):
        bent[:, row : row + 2] = False
        bent[slice(n - 4, n - 2) if number % 2 else slice(2, 4), row : row + 2] = True
    yield Task(bent, (2, 2), (n // 2, n - 2))
    pillars = np.random.default_rng(seed + 7).random((n, n)) > 0.22
    label, _ = ndimage.label(pillars)
    largest = label == np.argmax(np.bincount(label[pillars]))
    inside = np.argwhere(largest)
    yield Task(largest, tuple(inside[0].tolist()), tuple(inside[-1].tolist()))


def movingai(most: int) -> Iterator[Task]:
    """Return the longest queries of the scenario files in the folder of the maps."""
    import resgrid as rg

    for name in MAPS:
        free = rg.build_space(rg.read_scene(CASES / f"{name}.map"), require_goal=False).cell == rg.Cell.FREE
        (file,) = (found for found in CASES.glob(f"{name}*.scen"))
        queries = sorted(rg.maps.read_movingai_scenarios(file), key=lambda query: -query.optimal_length)
        for query in queries[:most]:
            yield Task(free, query.start, query.goal)


def _component(task: Task) -> NDArray[np.bool_]:
    label, _ = ndimage.label(task.free)
    return np.asarray(label == label[task.goal])


def _length(points: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _places(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points along a polyline, at most `STEP` apart."""
    pieces = [
        a + np.linspace(0.0, 1.0, 2 + int(np.linalg.norm(b - a) / STEP))[:, np.newaxis] * (b - a)
        for a, b in pairwise(points)
    ]
    return np.concatenate([points[:1], *pieces])


def _is_free(places: NDArray[np.float64], free: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return whether points lie in free cells; on a border one free cell is sufficient."""
    allowed = np.zeros(len(places), bool)
    for nudge in (-1e-9, 1e-9):
        cell = np.floor(places + nudge).astype(int)
        inside = np.all((cell >= 0) & (cell < free.shape), axis=1)
        allowed[inside] |= free[tuple(cell[inside].T)]
    return allowed


def _clearance(places: NDArray[np.float64], free: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the distances to the nearest obstacle square or the edge."""
    solid = np.pad(~free, 1, constant_values=True)
    border = solid & ndimage.binary_dilation(~solid, np.ones((3, 3)))
    corner = np.argwhere(border) - 1.0
    return np.array([_nearest(place, corner) for place in places[::4]])


def _nearest(place: NDArray[np.float64], corner: NDArray[np.float64]) -> float:
    """Return the distance of a point to the nearest unit square, given by lower corners."""
    outside = np.maximum(np.maximum(corner - place, place - corner - 1.0), 0.0)
    return float(np.linalg.norm(outside, axis=1).min())
