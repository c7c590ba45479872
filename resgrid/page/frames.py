"""Frames: a drawing solved, and what the page shows of it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.solve import solve
from resgrid.errors import AccuracyError, InputError
from resgrid.io.paths import ADVICE
from resgrid.page.drawing import Drawing
from resgrid.planning.certify import certify
from resgrid.planning.fields import Field
from resgrid.planning.road import Solution, Work, solve_problem
from resgrid.planning.streamline import Outcome, Streamline
from resgrid.planning.trace import follow, start_points
from resgrid.space import Cell

_NONE = 65535
_DECADES = 6.0
_ROUGH = partial(solve, accuracy="normwise", rtol=1e-6)


@dataclass(frozen=True, eq=False)
class Frame:
    """A drawing that was solved: direction-safe with certified paths, or while somebody draws in haste.

    `paths`: one for each start, None where a hasty field shows no way; `seconds`: that it took.
    """

    drawing: Drawing
    solution: Solution
    paths: tuple[Streamline | None, ...]
    exact: bool
    seconds: float

    @property
    def field(self) -> Field:
        """The field that is shown."""
        return self.solution.fields[0]


def solve_drawing(drawing: Drawing, *, exact: bool) -> Frame:
    """Solve a drawing and follow the current from its starts; exact paths are certified."""
    began = time.perf_counter()
    if not (drawing.cell == Cell.GOAL).any():
        raise InputError("there is no goal: set one with the goal tool")
    if drawing.driven and not len(drawing.starts):
        raise InputError("there is no start to drive the grid: set one, or choose the uniform drive")
    solution = solve_problem(drawing.problem, work=Work(solve if exact else _ROUGH))
    points = start_points(drawing.space, drawing.starts) if len(drawing.starts) else ()
    paths = tuple(_path(field, points[number], exact) for field, number in solution.tasks)
    return Frame(drawing, solution, paths, exact, time.perf_counter() - began)


def _path(field: Field, point: NDArray[np.float64], exact: bool) -> Streamline | None:
    try:
        path = follow(field, point)
    except AccuracyError:
        if exact:
            raise
        return None
    if exact:
        certify(path)
    return path


def describe(frame: Frame) -> tuple[dict[str, Any], list[bytes]]:
    """The head of a frame, and its body: lines of paths, picture, face currents and speeds.

    The lines are float32 (points, 2), in cells from the lower corner, continuous across seams; the picture is uint16
    (nx, ny), `_NONE` where nothing is shown; currents are int8 (nx, ny, 4) through the lower and the upper face across
    each axis, as shares of the cell's largest; speeds are uint8 (nx, ny).
    """
    field = frame.field
    lines = [_line(path) for path in frame.paths]
    head = {
        "exact": frame.exact,
        "paths": [_path_head(path, len(line)) for path, line in zip(frame.paths, lines, strict=True)],
        "seconds": frame.seconds,
        "methods": sorted({op.method for op in frame.solution.operating_points.values()}),
        "cells": int((frame.drawing.cell == Cell.FREE).sum()),
        "cut_off": int(((frame.drawing.cell == Cell.FREE) & ~field.space.goal_connected).sum()),
        "flat": list(frame.solution.flat),
    }
    scale, picture = _picture(field)
    currents, speed = _currents(field)
    body = [np.concatenate(lines or [np.empty((0, 2))]).astype("<f4"), picture, currents, speed]
    return head | {"scale": scale}, [part.tobytes() for part in body]


def _line(path: Streamline | None) -> NDArray[np.float64]:
    if path is None or path.outcome not in {Outcome.REACHED, Outcome.NO_CURRENT}:
        return np.empty((0, 2))
    return (path.line - path.space.lower) / path.space.spacing


def _path_head(path: Streamline | None, points: int) -> dict[str, Any]:
    if path is None:
        return {"outcome": None, "points": 0, "message": "too flat for a quick solve: the path comes when you let go"}
    head = {"outcome": str(path.outcome), "points": points, "goal": path.goal, "cells": len(path.cells)}
    if path.outcome is Outcome.REACHED:
        return head | {"length": path.length, "clearance": path.clearance}
    return head | {"message": ADVICE[path.outcome].replace("use --drive uniform", "choose the uniform drive")}


def _picture(field: Field) -> tuple[dict[str, Any], NDArray[np.uint16]]:
    """Decades of the drop from the obstacle rail where it has a logarithm, else the height above the goals."""
    shown = (field.space.cell == Cell.GOAL) | field.space.goal_connected
    if field.log_drop is not None:
        kind, value = "decades", np.where(field.space.cell == Cell.GOAL, 0.0, field.log_drop / np.log(10.0))
    else:
        kind, value = "height", np.where(field.space.cell == Cell.GOAL, 0.0, field.potential)
    shown = shown & np.isfinite(value)
    low, high = (float(value[shown].min()), float(value[shown].max())) if shown.any() else (0.0, 0.0)
    share = (value - low) / (high - low) if high > low else np.zeros_like(value)
    picture = np.where(shown, np.rint(np.where(shown, share, 0.0) * (_NONE - 1)), _NONE)
    return {"kind": kind, "low": low, "high": high}, picture.astype("<u2")


def _currents(field: Field) -> tuple[NDArray[np.int8], NDArray[np.uint8]]:
    """Face currents of every cell relative to its largest, and how fast the page moves dots there."""
    log_current, direction = (
        np.stack([part for axis in range(2) for part in _sides(values[axis], axis)], axis=-1)
        for values in (field.face_log_current, field.face_direction)
    )
    largest = log_current.max(axis=-1)
    flowing = np.isfinite(largest) & (field.space.cell == Cell.FREE)
    below = np.where(flowing[..., None], log_current - np.where(flowing, largest, 0.0)[..., None], -np.inf)
    shares = np.rint(127.0 * direction * np.exp(below.astype(np.float32))).astype(np.int8)
    decades = largest / np.log(10.0)
    top = np.quantile(decades[flowing], 0.98) if flowing.any() else 0.0
    speed = np.clip(1.0 + (np.where(flowing, decades, top) - top) / _DECADES, 0.2, 1.0)
    return shares, np.where(flowing, np.rint(255.0 * speed), 0).astype(np.uint8)


def _sides(faces: NDArray[Any], axis: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Values of the lower and of the upper face of every cell, both (nx, ny)."""
    along = np.moveaxis(faces, axis, 0)
    return np.moveaxis(along[:-1], 0, axis), np.moveaxis(along[1:], 0, axis)


def probe(frame: Frame, cell: Sequence[int]) -> dict[str, Any]:
    """What is known of a cell: volts, the current through each of its faces in amperes, and converter bits."""
    space, drawing = frame.field.space, frame.drawing
    index = (int(cell[0]), int(cell[1]))
    if not all(0 <= part < size for part, size in zip(index, space.shape, strict=True)):
        raise InputError(f"there is no cell {list(index)}")
    wiring = frame.field.wiring
    unit = abs(wiring.supply) / wiring.resistance
    direction, log_current = frame.field.faces_of(np.array([index]))
    phi = float(frame.field.potential[index])
    drop = None if frame.field.log_drop is None else float(frame.field.log_drop[index]) / np.log(10.0)
    return {
        "cell": list(index),
        "centre": space.axis_centre(index).tolist(),
        "kind": Cell(int(drawing.cell[index])).name.lower(),
        "conductivity": drawing.palette[int(drawing.level[index])],
        "potential": phi,
        "volts": wiring.goal_voltage + phi * wiring.supply,
        "drop_decades": drop,
        "amperes": (unit * direction[:, 0].T * np.exp(log_current[:, 0].T)).ravel().tolist(),
        "bits": _bits(frame, index),
        "exact": frame.exact,
    }


def _bits(frame: Frame, index: tuple[int, ...]) -> float | None:
    """Converter bits that tell a cell's lowest neighbour from itself; None for blends, which are no circuit."""
    from resgrid.chip.precision import analyse_precision

    points = frame.solution.operating_points
    if len(points) != 1 or frame.drawing.cell[index] != Cell.FREE:
        return None
    return float(analyse_precision(next(iter(points.values()))).cell_bits[index])
